"""The page: the scene, the panels and, if it may command, the handles, at a fixed rate whatever the topics' rate is."""

from __future__ import annotations

import collections
import logging
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import viser
import viser.uplot

from wbc_controller.apps.page import panels
from wbc_controller.apps.page.controls import Controls
from wbc_controller.apps.page.drawing import GROUPS, Drawing
from wbc_controller.apps.page.handles import Handles
from wbc_controller.apps.page.meshes import Mesh
from wbc_controller.apps.page.moment import Moment, Robot
from wbc_controller.apps.page.sending import Said, Sender
from wbc_controller.apps.page.shove import KEY, Shoves
from wbc_controller.controller.visualization.scene import friction_used
from wbc_controller.records import Array

_log = logging.getLogger(__name__)

#: Moments drawn per second, and of these those after which the panels and the plots are written.
RATE, _PANELS, _PLOTS = 30.0, 6, 15
#: Wall time between two logged errors of drawing, s.
_QUIET = 10.0
#: Wall time between two looks whether anybody has come, s.
_IDLE = 0.05
#: Time that the plots show, s, and their points per second.
_SHOWN, _POINTS = 12.0, 10.0
#: Lines of what was sent.
_LINES = 12
#: Widths of the panels, px.
_LEFT, _RIGHT = 330, 290
_HELP = f"""<div style="font-size:12px;line-height:1.5;padding:2px 10px 8px">
<b>Drag a handle</b> to send a setpoint: hands, feet, the centre of mass. A pale one belongs to a task that is off;
dragging switches it on.<br><b>{KEY.capitalize()} + drag on a link</b> of a simulated robot pulls on it; letting go
shoves it, there and so hard.</div>"""


class Source(Protocol):
    """Where moments come from."""

    def moment(self) -> Moment:
        """The newest moment."""
        ...

    def look(self) -> Sequence[str]:
        """Read what changes slowly; gives sentences of refusals since the last look."""
        ...


class TimeLine(Protocol):
    """Where one is in a recording."""

    def show(self) -> None:
        """Follow the time."""
        ...


@dataclass(frozen=True, slots=True)
class Commands:
    """What a page needs to command.

    Attributes:
        sender: sends requests.
        is_mock: whether the robot is a mock robot, as far as is known.
    """

    sender: Sender
    is_mock: Callable[[], bool]


class Page:
    """The page of one robot, for as many browsers as come.

    Attributes:
        shown: number of moments with a new state that were drawn.
    """

    def __init__(self, server: viser.ViserServer, robot: Robot, meshes: Sequence[Mesh], source: Source) -> None:
        """Set up the scene and the panels.

        Args:
            server: the server.
            robot: the robot.
            meshes: what it looks like.
            source: where moments come from.
        """
        self.shown, self._stamp = 0, -1
        self.server, self._robot, self._source = server, robot, source
        self._commands: Commands | None = None
        self._line: TimeLine | None = None
        self._said: collections.deque[tuple[str, bool]] = collections.deque(maxlen=_LINES)
        self._unread = False
        self._history: collections.deque[tuple[float, float, float, float]] = collections.deque(
            maxlen=int(_SHOWN * _POINTS)
        )
        gui = server.gui
        gui.configure_theme(
            show_logo=False, show_share_button=False, control_width="medium", brand_color=(34, 139, 230)
        )
        gui.set_panel_label(robot.model.name)
        self._look_of(server, robot)
        self.drawing = Drawing(server, robot, meshes)
        self.drawing.fine(False)
        panel = gui.add_panel()
        with panel.add_tab("Controller"):
            self._now = gui.add_html("")
        with panel.add_tab("Torques"):
            self._torques = gui.add_html("")
        with panel.add_tab("Plots"):
            self._plots = self._make_plots(gui)
        panel.dock_left()
        panel.set_width(_LEFT)
        gui.main_panel.dock_right()
        gui.main_panel.set_width(_RIGHT)

    def _look_of(self, server: viser.ViserServer, robot: Robot) -> None:
        """The floor, the light, and where the camera is at first: as far as the robot is high."""
        scene = server.scene
        scene.set_up_direction("+z")
        scene.add_grid(
            "/floor", infinite_grid=True, fade_distance=12.0, cell_size=0.25, section_size=1.0, shadow_opacity=0.2,
            cell_color=(222, 226, 230), section_color=(190, 196, 203),
        )  # fmt: skip
        position, look_at, fov = camera(robot)
        server.initial_camera.position = position
        server.initial_camera.look_at = look_at
        server.initial_camera.fov = fov

    def command(self, commands: Commands) -> None:
        """Let the page command; before `run`."""
        self._commands = commands
        gui = self.server.gui
        self._controls = Controls(self.server, self._robot, commands.sender)
        self._handles = Handles(self.server, self._robot, commands.sender)
        self._shoves = Shoves(self.server, self._robot, self.drawing, commands.sender)
        with gui.add_folder("Handles"):
            gui.add_html(_HELP)
            turn = gui.add_checkbox("Turn, too", False, hint="Rings on the handles of poses and orientations.")
            turn.on_update(lambda event: self._handles.turn(turn.value))
        with gui.add_folder("Sent"):
            self._sent = gui.add_html(panels.sent(()))

        @self.server.on_client_disconnect
        async def _(client: Any) -> None:
            commands.sender.forget(client.client_id)
            self._handles.let_go(client.client_id)
            self._shoves.let_go(client.client_id)

    def play(self, line: TimeLine) -> None:
        """Show the time of a recording; before `run`."""
        self._line = line

    def view_options(self) -> None:
        """The switches for what is shown; last, so that they stand below what commands."""
        gui = self.server.gui
        with gui.add_folder("Show", expand_by_default=self._commands is None):
            for group, label in GROUPS.items():
                box = gui.add_checkbox(label, True)
                box.on_update(self._toggles(group))
            through = gui.add_checkbox("See through it", False, hint="A translucent robot.")
            through.on_update(lambda event: self.drawing.see_through(through.value))
            fine = gui.add_checkbox("Shadows", False, hint="Shadows and reflections: for browsers with a GPU.")
            fine.on_update(lambda event: self.drawing.fine(fine.value))
        if self._commands is None and self._line is None:
            gui.add_html('<div style="font-size:12px;padding:4px 10px;opacity:.7">This page watches. '
                         "Start it with --command to command.</div>")  # fmt: skip

    def _toggles(self, group: str) -> Callable[[Any], None]:
        return lambda event: self.drawing.toggle(group, event.target.value)

    def told(self, said: Said) -> None:
        """Take note of what came of a request; from any thread."""
        if said.error:
            self._note(f"{said.sentence}: {said.error}" if said.sentence else said.error, done=False)
        elif said.sentence:
            self._note(said.sentence, done=True)

    def _note(self, text: str, *, done: bool) -> None:
        self._said.appendleft((text, done))
        self._unread = True

    def run(self, stop: threading.Event) -> None:
        """Draw until the event is set, while a page is open; log an error of one moment, and draw the next."""
        due, count, logged = time.monotonic(), 0, -float("inf")
        while not stop.is_set():
            if not self.server.get_clients():
                stop.wait(_IDLE)
                continue
            try:
                self._step(count)
            except Exception:
                if time.monotonic() - logged >= _QUIET:
                    logged = time.monotonic()
                    _log.exception("could not draw a moment; the next errors are not logged for %g s", _QUIET)
            count += 1
            due = max(due + 1.0 / RATE, time.monotonic() - 1.0 / RATE)
            stop.wait(max(0.0, due - time.monotonic()))

    def _step(self, count: int) -> None:
        moment = self._source.moment()
        self._draw(moment, count)
        if moment.stamp != self._stamp:
            self.shown, self._stamp = self.shown + 1, moment.stamp

    def _draw(self, moment: Moment, count: int) -> None:
        self.drawing.show(moment)
        if self._commands is not None:
            self._handles.show(moment)
        if self._line is not None:
            self._line.show()
        if count % _PANELS == 0:
            for sentence in self._source.look():
                self._note(f"refused: {sentence}", done=False)
            self._now.content = panels.now(self._robot, moment)
            self._torques.content = panels.torques(self._robot, moment)
            if self._commands is not None:
                mock = self._commands.is_mock()
                self._shoves.enabled = mock
                self._controls.show(moment, mock)
                if self._unread:
                    self._unread = False
                    self._sent.content = panels.sent(list(self._said))
        if count % int(RATE / _POINTS) == 0:
            self._remember(moment)
        if count % _PLOTS == 0:
            self._plot()

    def _remember(self, moment: Moment) -> None:
        robot = self._robot
        weight = robot.model.mass * robot.model.gravity
        used = [share for share in friction_used(robot.contacts, moment.forces, weight).values() if share >= 0.0]
        shares = panels.effort_shares(robot, moment.torques) if moment.torques is not None else np.zeros(1)
        cycle = float("nan")
        if moment.heard is not None:
            cycle = 1e-3 * float(moment.heard.values.get("time/total/median", "nan").partition(" ")[0])
        row = (1e-9 * moment.stamp, 100.0 * float(np.abs(shares).max()), 100.0 * max(used, default=0.0), cycle)
        if self._history and row[0] < self._history[-1][0]:
            self._history.clear()  # the robot's clock began anew
        self._history.append(row)

    def _make_plots(self, gui: viser.GuiApi) -> tuple[Any, Any]:
        empty = np.zeros(1)
        series = viser.uplot.Series
        shares = gui.add_uplot(
            (empty, empty, empty),
            (
                series(label="s, now at 0"),
                series(label="largest torque, % of its limit", stroke="#228be6", width=2),
                series(label="friction used, %", stroke="#f08c00", width=2),
            ),
            scales={"x": viser.uplot.Scale(time=False, auto=True), "y": viser.uplot.Scale(range=(0.0, 100.0))},
            height=230,
            padding=(12, 24, 0, 0),
            title="Against the limits",
        )
        cycle = gui.add_uplot(
            (empty, empty),
            (series(label="s, now at 0"), series(label="cycle time, ms", stroke="#7950f2", width=2)),
            scales={"x": viser.uplot.Scale(time=False, auto=True), "y": viser.uplot.Scale(auto=True)},
            height=200,
            padding=(12, 24, 0, 0),
            title="Cycle time",
        )
        return shares, cycle

    def _plot(self) -> None:
        if len(self._history) > 1:
            time, torque, friction, cycle = np.array(self._history).T
            shares, cycles = self._plots
            shares.data = (time - time[-1], torque, friction)
            cycles.data = (time - time[-1], cycle)


def camera(robot: Robot) -> tuple[Array, Array, float]:
    """Where the camera is at first and what it looks at, (3,) each in m, and its vertical angle of view, rad."""
    dynamics = robot.dynamics
    frames = range(1, len(robot.model.pinocchio.frames))
    lowest = min(float(dynamics.placement(frame).translation[2]) for frame in frames)
    height = max(0.5, 1.45 * float(dynamics.com[2] - lowest))
    return height * np.array([1.7, -1.5, 1.15]), height * np.array([0.0, 0.0, 0.5]), 0.75
