"""The page: scene, panels, handles and controls."""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
import viser
import viser.uplot

from wbc_controller.apps.page import panels
from wbc_controller.apps.page.controls import Controls
from wbc_controller.apps.page.drawing import GROUPS, CameraFollower, Drawing, camera
from wbc_controller.apps.page.handles import KEY, KINDS, Handle, LinkPushes
from wbc_controller.apps.page.playback import Playback, TimeLine
from wbc_controller.apps.page.request_sender import RequestSender
from wbc_controller.apps.page.snapshot import Robot, Snapshot
from wbc_controller.apps.page.topic_source import TopicSource
from wbc_controller.controller.visualization.geometry import Part
from wbc_controller.controller.visualization.scene import friction_used

_log = logging.getLogger(__name__)

#: Snapshots drawn per second, and snapshots per update of the panels and of the plots.
RATE, _PANELS, _PLOTS = 30.0, 6, 15
_LOG_PERIOD = 10.0  # wall time, s
_IDLE = 0.05  # period of the check for pages, wall time, s
_PLOT_TIME, _PLOT_RATE = 12.0, 10.0  # time range, s, and points per second
_MAX_REQUESTS = 12
_LEFT, _RIGHT = 330, 290  # px
_HELP = f"""<div style="font-size:12px;line-height:1.5;padding:2px 10px 8px">
<b>Drag a handle</b> to send a setpoint for a hand, a foot or the centre of mass. Dragging a pale handle enables its
task.<br><b>{KEY.capitalize()} + drag a link</b> of a simulated robot to draw a force; its release pushes the
link.</div>"""


class Page:
    """Page for any number of browsers; `shown` counts drawn snapshots with a new state."""

    def __init__(
        self, server: viser.ViserServer, robot: Robot, meshes: Sequence[Part], source: TopicSource | Playback
    ) -> None:
        self.shown, self._stamp = 0, -1
        self.server, self._robot, self._source = server, robot, source
        self._is_mock: Callable[[], bool] | None = None
        self.time_line: TimeLine | None = None  # of a recording
        self._requests: deque[tuple[str, bool]] = deque(maxlen=_MAX_REQUESTS)
        self._history: deque[tuple[float, float, float, float]] = deque(maxlen=int(_PLOT_TIME * _PLOT_RATE))
        gui = server.gui
        gui.configure_theme(
            show_logo=False, show_share_button=False, control_width="medium", brand_color=(34, 139, 230)
        )
        gui.set_panel_label(robot.model.name)
        server.scene.set_up_direction("+z")
        server.scene.add_grid(
            "/floor", infinite_grid=True, fade_distance=12.0, cell_size=0.25, section_size=1.0, shadow_opacity=0.2,
            cell_color=(222, 226, 230), section_color=(190, 196, 203),
        )  # fmt: skip
        at_start = server.initial_camera
        at_start.position, at_start.look_at, at_start.fov = camera(robot, meshes)
        self._follower = CameraFollower()
        self.drawing = Drawing(server, robot, meshes)
        self.drawing.set_shadows(False)
        panel = gui.add_panel()
        with panel.add_tab("Controller"):
            self._controller_html = gui.add_html("")
        with panel.add_tab("Torques"):
            self._torques = gui.add_html("")
        with panel.add_tab("Plots"):
            self._plots = self._make_plots(gui)
        panel.dock_left()
        panel.set_width(_LEFT)
        gui.main_panel.dock_right()
        gui.main_panel.set_width(_RIGHT)

    def enable_commands(self, sender: RequestSender, is_mock: Callable[[], bool]) -> None:
        """Add the controls, before `run`."""
        self._is_mock = is_mock
        server, robot, gui = self.server, self._robot, self.server.gui
        self._controls = Controls(server, robot, sender)
        tasks = robot.settings.tasks
        self._handles = [Handle(server, robot, name, sender) for name, task in tasks.items() if task.type in KINDS]
        self._pushes = LinkPushes(server, robot, self.drawing, sender)
        with gui.add_folder("Handles"):
            gui.add_html(_HELP)
            hint = "Show rings on the handles of poses and orientations."
            rings = gui.add_checkbox("Rotation rings", False, hint=hint)

            @rings.on_update
            async def _(event: Any) -> None:
                for handle in self._handles:
                    handle.show_rings(rings.value)

        with gui.add_folder("Requests"):
            self._request_list = gui.add_html(panels.request_list(()))

        @server.on_client_disconnect
        async def _(client: Any) -> None:
            sender.drop_drags(client.client_id)
            self._pushes.end_drags(client.client_id)
            for handle in self._handles:
                handle.end_drags(client.client_id)

    def add_view_options(self) -> None:
        """Add the switches of the scene, below the controls."""
        gui = self.server.gui

        def add_switch(label: str, on: bool, changed: Callable[[bool], None], hint: str | None = None) -> None:
            box = gui.add_checkbox(label, on, hint=hint)
            box.on_update(lambda event: changed(box.value))

        with gui.add_folder("Show", expand_by_default=self._is_mock is None):
            for group, label in GROUPS.items():
                add_switch(label, True, partial(self.drawing.set_visible, group))
            hint = "Move the camera with a robot that walks."
            add_switch("Follow the robot", True, partial(setattr, self._follower, "on"), hint)
            add_switch("Translucent robot", False, self.drawing.set_translucent)
            add_switch("Shadows", False, self.drawing.set_shadows, "Shadows and reflections; requires a GPU.")
        if self._is_mock is None and self.time_line is None:
            gui.add_html('<div style="font-size:12px;padding:4px 10px;opacity:.7">This page is read-only. '
                         "Start it with --command to send requests.</div>")  # fmt: skip

    def report(self, words: str, error: str) -> None:
        """List a request and its error, empty after success; from any thread."""
        if words or error:
            self._requests.appendleft((": ".join(filter(None, (words, error))), not error))

    def run(self, stop: threading.Event) -> None:
        """Draw snapshots until the event is set; errors are logged."""
        due, count, logged = time.monotonic(), 0, -float("inf")
        while not stop.is_set():
            if not self.server.get_clients():
                stop.wait(_IDLE)
                continue
            try:
                self._draw(count)
            except Exception:
                if time.monotonic() - logged >= _LOG_PERIOD:
                    logged = time.monotonic()
                    _log.exception(
                        "drawing of a snapshot failed; further drawing errors are not logged for %g s", _LOG_PERIOD
                    )
            count += 1
            due = max(due + 1.0 / RATE, time.monotonic() - 1.0 / RATE)
            stop.wait(max(0.0, due - time.monotonic()))

    def _draw(self, count: int) -> None:
        snapshot = self._source.snapshot()
        self.drawing.show(snapshot)
        if self._robot.model.floating_base:
            self._follower.follow(self.server.get_clients(), snapshot.q[:2])
        if self._is_mock is not None:
            for handle in self._handles:
                handle.show(snapshot)
        if self.time_line is not None:
            self.time_line.show()
        if count % _PANELS == 0:
            for refusal in self._source.read_status():
                self.report("refused", refusal)
            self._controller_html.content = panels.controller_panel(self._robot, snapshot)
            self._torques.content = panels.torque_panel(self._robot, snapshot)
            if self._is_mock is not None:
                self._pushes.enabled = self._is_mock()
                self._controls.show(snapshot, self._pushes.enabled)
                self._request_list.content = panels.request_list(list(self._requests))
        if count % int(RATE / _PLOT_RATE) == 0:
            self._record_history(snapshot)
        if count % _PLOTS == 0:
            self._plot()
        if snapshot.stamp != self._stamp:
            self.shown, self._stamp = self.shown + 1, snapshot.stamp

    def _record_history(self, snapshot: Snapshot) -> None:
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
        scale, time_series = viser.uplot.Scale, viser.uplot.Series(label="time relative to now, s")

        def plot(title: str, height: int, y: Any, *lines: tuple[str, str]) -> Any:
            series = (time_series, *(viser.uplot.Series(label=label, stroke=color, width=2) for label, color in lines))
            data, scales = (np.zeros(1),) * len(series), {"x": scale(time=False, auto=True), "y": y}
            return gui.add_uplot(data, series, scales=scales, height=height, padding=(12, 24, 0, 0), title=title)

        lines = (("largest torque, % of limit", "#228be6"), ("friction used, %", "#f08c00"))
        limits = plot("Use of limits", 230, scale(range=(0.0, 100.0)), *lines)
        return limits, plot("Cycle time", 200, scale(auto=True), ("cycle time, ms", "#7950f2"))

    def _plot(self) -> None:
        if len(self._history) > 1:
            time, torque, friction, cycle = np.array(self._history).T
            shares, cycles = self._plots
            shares.data = (time - time[-1], torque, friction)
            cycles.data = (time - time[-1], cycle)
