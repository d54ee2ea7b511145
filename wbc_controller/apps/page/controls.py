"""Controls that send requests of `wbc send`."""

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import viser

from wbc_controller.apps.page.request_sender import RequestSender
from wbc_controller.apps.page.snapshot import Robot, Snapshot
from wbc_controller.apps.terminal.request_parser import Request
from wbc_controller.middleware.codec import velocity_message
from wbc_controller.settings import Settings
from wbc_controller.settings.walking import WalkingSettings

_OVERRIDE_TIME = 2.0  # after user input, without updates from the controller, s
_SLIDER_RANGE = 4.0  # maximum of a slider, as a multiple of the configured value
#: Faults of the mock robot with a slider: label, maximum, step, unit and beginning of the YAML.
_FAULTS: tuple[tuple[str, float, float, str, Callable[[float], str]], ...] = (
    ("Sensor noise", 0.01, 0.0005, "rad",
     lambda value: f"{{kind: joint_noise, sigma: {max(value, 1e-5):g}, velocity_sigma: {max(10.0 * value, 1e-4):g}"),
    ("Delay of states", 60.0, 2.0, "ms", lambda value: f"{{kind: message_delay, delay: {1e-3 * value:g}"),
    ("Delay of torques", 20.0, 2.0, "ms", lambda value: f"{{kind: command_delay, delay: {1e-3 * value:g}"),
)  # fmt: skip
_MODE_BUTTONS = (
    ("estop", "red", "Zero torque immediately; the robot falls."),
    ("activate", "green", "Start control and ramp the torques up."),
    ("deactivate", "gray", "Ramp the torques down."),
    ("damp", "gray", "Damp the joints; the robot sinks."),
    ("reset", "gray", "Leave a fault or a stop."),
    ("record", "gray", "Write the last seconds to a file for wbc view and wbc replay."),
)
_MAX_FRICTION = 0.5  # maximum of the slider of `slippery_floor`
_DURATION = 3600.0  # s
_WALK_RATE = 10.0  # messages per second of a held button
#: Label, first value, and default maximum of each slider, m/s or rad/s.
_SLIDERS = (("Forward [m/s]", 0.2, 0.5), ("To the left [m/s]", 0.0, 0.3), ("Turn left [rad/s]", 0.0, 0.5))


class Controls:
    """Controls of the panel, shared by all pages, on the server's event loop."""

    def __init__(self, server: viser.ViserServer, robot: Robot, sender: RequestSender) -> None:
        self._gui, self._sender = server.gui, sender
        self._loop = server.get_event_loop()
        self._touched: dict[int, float] = {}
        self._tasks: dict[str, tuple[Any, Any | None]] = {}
        self._contacts: dict[str, Any] = {}
        for word, color, hint in _MODE_BUTTONS:
            self._add_button(word, color, f"{hint} wbc send {word}")
        if robot.settings.walking is not None:
            _add_walk_controls(server, robot.settings.walking, sender)
        self._mock = self._gui.add_folder("Simulated robot", visible=False)
        with self._mock:
            self._add_button("hold", "gray", "Lift the robot to its start pose.")
            self._add_button("release", "gray", "Release the hoist.")
            self._add_fault_controls()
        with self._gui.add_folder("Contacts", expand_by_default=False):
            for name, contact in robot.settings.contacts.items():
                self._contacts[name] = self._switch(name, contact.enabled, "contact", name)
        with self._gui.add_folder("Tasks", expand_by_default=False):
            for name in robot.settings.tasks:
                self._task(name, robot.settings)

    def show(self, snapshot: Snapshot, mock: bool) -> None:
        """Set the controls to the controller's values, except after user input."""
        self._mock.visible = mock
        if snapshot.references is not None and snapshot.status is not None:
            self._loop.call_soon_threadsafe(self._show, snapshot, snapshot.status.values)

    def _show(self, snapshot: Snapshot, values: Mapping[str, str]) -> None:
        for name, (switch, slider) in self._tasks.items():
            weight = float(values.get(f"task_weight/{name}", "nan"))
            if weight == weight:
                self._set_unless_touched(switch, weight > 0.0)
                if slider is not None and weight > 0.0:
                    self._set_unless_touched(slider, min(weight, slider.max))
        for name, switch in self._contacts.items():
            self._set_unless_touched(switch, name in snapshot.forces)

    def _add_button(self, word: str, color: Any, hint: str) -> None:
        button = self._gui.add_button("STOP" if word == "estop" else word.capitalize(), color=color, hint=hint)
        button.on_click(lambda event: self._sender.send_words(word))

    def _add_fault_controls(self) -> None:
        slippery = self._gui.add_checkbox("Slippery floor", False)
        friction = self._gui.add_slider("Floor friction", 0.0, _MAX_FRICTION, 0.01, 0.2)
        sliders = [
            (self._gui.add_slider(f"{label} [{unit}]", 0.0, most, step, 0.0), fault)
            for label, most, step, unit, fault in _FAULTS
        ]

        def send(client: int) -> None:
            faults = [fault(slider.value) for slider, fault in sliders if slider.value > 0.0]
            if slippery.value:
                faults.append(f"{{kind: slippery_floor, friction: {friction.value:g}")
            listed = ", ".join(f"{fault}, duration: {_DURATION:g}}}" for fault in faults)
            self._sender.drag("faults", client, ["fault", f"[{listed}]" if faults else "clear"])

        controls: list[Any] = [slippery, friction, *(slider for slider, _ in sliders)]
        for control in controls:
            self._on_input(control, send)

    def _task(self, name: str, settings: Settings) -> None:
        task = settings.tasks[name]
        stiffness = getattr(task, "stiffness", None)
        with self._gui.add_folder(name, expand_by_default=False):
            switch = self._switch("on", task.enabled, "task", name)
            weight = self._slider("weight", task.weight, name, lambda value: ["weight", name, value])
            if isinstance(stiffness, float):
                update = "{{tasks: {{{}: {{stiffness: {}}}}}}}"
                self._slider("stiffness", stiffness, name, lambda value: ["update", update.format(name, value)])
        self._tasks[name] = switch, weight

    def _switch(self, label: str, on: bool, *words: str) -> Any:
        switch = self._gui.add_checkbox(label, on)
        self._on_input(switch, lambda client: self._sender.send_words(*words, "on" if switch.value else "off"))
        return switch

    def _slider(self, label: str, value: float, task: str, request: Callable[[str], list[str]]) -> Any | None:
        if not value > 0.0:
            return None
        slider = self._gui.add_slider(label, 0.0, _SLIDER_RANGE * value, value / 50.0, value)
        key = f"{label} {task}"
        self._on_input(slider, lambda client: self._sender.drag(key, client, request(f"{slider.value:.6g}")))
        return slider

    def _on_input(self, control: Any, send: Callable[[int], None]) -> None:
        """Call a function with the client at each input of a user."""

        async def changed(event: Any) -> None:
            if event.client_id is not None:
                self._touched[id(control)] = time.monotonic()
                send(event.client_id)

        control.on_update(changed)

    def _set_unless_touched(self, control: Any, value: Any) -> None:
        untouched = time.monotonic() - self._touched.get(id(control), -_OVERRIDE_TIME) >= _OVERRIDE_TIME
        if untouched and control.value != value:
            control.value = value


def _add_walk_controls(server: viser.ViserServer, settings: WalkingSettings, sender: RequestSender) -> None:
    """Add the folder `Walking`. A released button and a closed page send nothing: the robot stops by its timeout."""
    gui, sliders = server.gui, []
    with gui.add_folder("Walking"):
        walk = gui.add_button("Walk", color="green", hint="Hold to walk at this velocity; release to stop.")
        stand = gui.add_button("Stand", color="gray", hint="Stop after the next steps.")
        limits = settings.max_speed, settings.max_side_speed, settings.max_turn_rate
        for (label, first, default), limit in zip(_SLIDERS, limits, strict=True):
            most = default if limit is None else limit
            sliders.append(gui.add_slider(label, -most, most, 0.01, min(first, most)))

    async def held(event: Any) -> None:
        sender.drag("walk", event.client_id, _walk_request([slider.value for slider in sliders], "walk"))

    walk.on_hold(held, callback_hz=_WALK_RATE)
    stand.on_click(lambda event: sender.request(_walk_request((0.0, 0.0, 0.0), "the robot stops walking")))


def _walk_request(velocity: Sequence[float], summary: str) -> Request:
    return Request("controller", "cmd_vel", "", summary, lambda _: velocity_message(velocity))
