"""The page: scene, panels and, if it may command, handles and controls, drawn at a fixed rate."""

from __future__ import annotations

import collections
import logging
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np
import viser
import viser.uplot

from wbc_controller.apps.page import panels
from wbc_controller.apps.page.camera import camera
from wbc_controller.apps.page.controls import Controls
from wbc_controller.apps.page.drawing import GROUPS, Drawing
from wbc_controller.apps.page.handles import Handles
from wbc_controller.apps.page.link_pushes import KEY, LinkPushes
from wbc_controller.apps.page.meshes import Mesh
from wbc_controller.apps.page.playback import TimeLine
from wbc_controller.apps.page.request_sender import RequestSender
from wbc_controller.apps.page.snapshot import Robot, Snapshot
from wbc_controller.controller.visualization.scene import friction_used

_log = logging.getLogger(__name__)

#: Snapshots drawn per second, and numbers of snapshots between two updates of the panels and of the plots.
RATE, _PANELS, _PLOTS = 30.0, 6, 15
#: Wall time between two logged errors of drawing, s.
_QUIET = 10.0
#: Period of the check for an open page, s of wall time.
_IDLE = 0.05
#: Time range of the plots, s, and their points per second.
_SHOWN, _POINTS = 12.0, 10.0
#: Number of requests listed.
_LINES = 12
#: Widths of the panels, px.
_LEFT, _RIGHT = 330, 290
_HELP = f"""<div style="font-size:12px;line-height:1.5;padding:2px 10px 8px">
<b>Drag a handle</b> to send a setpoint: hands, feet, the centre of mass. A pale one belongs to a disabled task;
dragging enables it.<br><b>{KEY.capitalize()} + drag on a link</b> of a simulated robot pulls on it; releasing
it pushes the link.</div>"""


class SnapshotSource(Protocol):
    """Source of snapshots: the topics of a robot, or a recording."""

    def snapshot(self) -> Snapshot:
        """Return the newest snapshot."""
        ...

    def read_status(self) -> Sequence[str]:
        """Read the status of the nodes; return the refusals since the last call."""
        ...


class Page:
    """The page of one robot, for any number of browsers.

    Attributes:
        shown: number of drawn snapshots with a new state.
    """

    def __init__(self, server: viser.ViserServer, robot: Robot, meshes: Sequence[Mesh], source: SnapshotSource) -> None:
        self.shown, self._stamp = 0, -1
        self.server, self._robot, self._source = server, robot, source
        self._is_mock: Callable[[], bool] | None = None
        self._time_line: TimeLine | None = None
        self._requests: collections.deque[tuple[str, bool]] = collections.deque(maxlen=_LINES)
        self._requests_changed = False
        self._history: collections.deque[tuple[float, float, float, float]] = collections.deque(
            maxlen=int(_SHOWN * _POINTS)
        )
        gui = server.gui
        gui.configure_theme(
            show_logo=False, show_share_button=False, control_width="medium", brand_color=(34, 139, 230)
        )
        gui.set_panel_label(robot.model.name)
        self._set_up_scene(server, robot, meshes)
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

    def _set_up_scene(self, server: viser.ViserServer, robot: Robot, meshes: Sequence[Mesh]) -> None:
        scene = server.scene
        scene.set_up_direction("+z")
        scene.add_grid(
            "/floor", infinite_grid=True, fade_distance=12.0, cell_size=0.25, section_size=1.0, shadow_opacity=0.2,
            cell_color=(222, 226, 230), section_color=(190, 196, 203),
        )  # fmt: skip
        position, look_at, fov = camera(robot, meshes)
        server.initial_camera.position = position
        server.initial_camera.look_at = look_at
        server.initial_camera.fov = fov

    def command(self, sender: RequestSender, is_mock: Callable[[], bool]) -> None:
        """Let the page command; before `run`. `is_mock` returns True if the robot is known to be a mock robot."""
        self._is_mock = is_mock
        gui = self.server.gui
        self._controls = Controls(self.server, self._robot, sender)
        self._handles = Handles(self.server, self._robot, sender)
        self._pushes = LinkPushes(self.server, self._robot, self.drawing, sender)
        with gui.add_folder("Handles"):
            gui.add_html(_HELP)
            turn = gui.add_checkbox("Turn, too", False, hint="Rings on the handles of poses and orientations.")
            turn.on_update(lambda event: self._handles.turn(turn.value))
        with gui.add_folder("Sent"):
            self._sent = gui.add_html(panels.sent(()))

        @self.server.on_client_disconnect
        async def _(client: Any) -> None:
            sender.forget(client.client_id)
            self._handles.let_go(client.client_id)
            self._pushes.let_go(client.client_id)

    def play(self, time_line: TimeLine) -> None:
        """Show the time of a recording; before `run`."""
        self._time_line = time_line

    def view_options(self) -> None:
        """Add the switches of the scene; last, so that they are below the controls."""
        gui = self.server.gui
        with gui.add_folder("Show", expand_by_default=self._is_mock is None):
            for group, label in GROUPS.items():
                box = gui.add_checkbox(label, True)
                box.on_update(self._toggles(group))
            through = gui.add_checkbox("See through it", False, hint="A translucent robot.")
            through.on_update(lambda event: self.drawing.see_through(through.value))
            fine = gui.add_checkbox("Shadows", False, hint="Shadows and reflections: for browsers with a GPU.")
            fine.on_update(lambda event: self.drawing.fine(fine.value))
        if self._is_mock is None and self._time_line is None:
            gui.add_html('<div style="font-size:12px;padding:4px 10px;opacity:.7">This page watches. '
                         "Start it with --command to command.</div>")  # fmt: skip

    def _toggles(self, group: str) -> Callable[[Any], None]:
        return lambda event: self.drawing.toggle(group, event.target.value)

    def report(self, words: str, error: str) -> None:
        """List a request by its words, with its error, empty if it was sent; from any thread."""
        if words or error:
            self._requests.appendleft((": ".join(filter(None, (words, error))), not error))
            self._requests_changed = True

    def run(self, stop: threading.Event) -> None:
        """Draw until the event is set, while a page is open; after an error, log it and draw the next snapshot."""
        due, count, logged = time.monotonic(), 0, -float("inf")
        while not stop.is_set():
            if not self.server.get_clients():
                stop.wait(_IDLE)
                continue
            try:
                self._draw(count)
            except Exception:
                if time.monotonic() - logged >= _QUIET:
                    logged = time.monotonic()
                    _log.exception("could not draw a snapshot; the next errors are not logged for %g s", _QUIET)
            count += 1
            due = max(due + 1.0 / RATE, time.monotonic() - 1.0 / RATE)
            stop.wait(max(0.0, due - time.monotonic()))

    def _draw(self, count: int) -> None:
        snapshot = self._source.snapshot()
        self.drawing.show(snapshot)
        if self._is_mock is not None:
            self._handles.show(snapshot)
        if self._time_line is not None:
            self._time_line.show()
        if count % _PANELS == 0:
            for refusal in self._source.read_status():
                self.report("refused", refusal)
            self._now.content = panels.now(self._robot, snapshot)
            self._torques.content = panels.torques(self._robot, snapshot)
            if self._is_mock is not None:
                self._pushes.enabled = self._is_mock()
                self._controls.show(snapshot, self._pushes.enabled)
                if self._requests_changed:
                    self._requests_changed = False
                    self._sent.content = panels.sent(list(self._requests))
        if count % int(RATE / _POINTS) == 0:
            self._remember(snapshot)
        if count % _PLOTS == 0:
            self._plot()
        if snapshot.stamp != self._stamp:
            self.shown, self._stamp = self.shown + 1, snapshot.stamp

    def _remember(self, snapshot: Snapshot) -> None:
        robot = self._robot
        weight = robot.model.mass * robot.model.gravity
        used = [share for share in friction_used(robot.contacts, snapshot.forces, weight).values() if share >= 0.0]
        shares = panels.effort_shares(robot, snapshot.torques) if snapshot.torques is not None else np.zeros(1)
        cycle = float("nan")
        if snapshot.status is not None:
            cycle = 1e-3 * float(snapshot.status.values.get("time/total/median", "nan").partition(" ")[0])
        row = (1e-9 * snapshot.stamp, 100.0 * float(np.abs(shares).max()), 100.0 * max(used, default=0.0), cycle)
        if self._history and row[0] < self._history[-1][0]:
            self._history.clear()  # the robot's clock was reset
        self._history.append(row)

    def _make_plots(self, gui: viser.GuiApi) -> tuple[Any, Any]:
        """Add the plots of the limits and of the cycle time; returns their handles."""
        scale, time_series = viser.uplot.Scale, viser.uplot.Series(label="s, now at 0")

        def plot(title: str, height: int, y: Any, *lines: tuple[str, str]) -> Any:
            series = [viser.uplot.Series(label=label, stroke=color, width=2) for label, color in lines]
            return gui.add_uplot(
                (np.zeros(1),) * (1 + len(lines)),
                (time_series, *series),
                scales={"x": scale(time=False, auto=True), "y": y},
                height=height,
                padding=(12, 24, 0, 0),
                title=title,
            )

        lines = (("largest torque, % of its limit", "#228be6"), ("friction used, %", "#f08c00"))
        limits = plot("Against the limits", 230, scale(range=(0.0, 100.0)), *lines)
        return limits, plot("Cycle time", 200, scale(auto=True), ("cycle time, ms", "#7950f2"))

    def _plot(self) -> None:
        if len(self._history) > 1:
            time, torque, friction, cycle = np.array(self._history).T
            shares, cycles = self._plots
            shares.data = (time - time[-1], torque, friction)
            cycles.data = (time - time[-1], cycle)
