"""Buttons, switches and sliders: each sends a request of `wbc send`."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

import viser

from wbc_controller.apps.page.request_sender import RequestSender
from wbc_controller.apps.page.snapshot import Robot, Snapshot
from wbc_controller.settings import Settings

#: Time for which a control that a user has moved does not follow the controller, s.
_OWN = 2.0
#: Largest value of a slider for a weight or a gain, as a multiple of the configured one.
_RANGE = 4.0
#: Faults of the mock robot with a slider: label, largest value, step, unit, and the beginning of the fault's YAML.
_FAULTS: tuple[tuple[str, float, float, str, Callable[[float], str]], ...] = (
    ("Sensor noise", 0.01, 0.0005, "rad",
     lambda value: f"{{kind: joint_noise, sigma: {max(value, 1e-5):g}, velocity_sigma: {max(10.0 * value, 1e-4):g}"),
    ("Delay of states", 60.0, 2.0, "ms", lambda value: f"{{kind: message_delay, delay: {1e-3 * value:g}"),
    ("Delay of torques", 20.0, 2.0, "ms", lambda value: f"{{kind: command_delay, delay: {1e-3 * value:g}"),
)  # fmt: skip
#: Largest friction of the mock robot's floor on the slider; the fault `slippery_floor` takes up to it.
_SLIPPERY = 0.5
#: Duration of a fault of the mock robot, s.
_DURATION = 3600.0


class Controls:
    """The controls on the page's panel, shared by all pages.

    User input is read, and the controller's values are shown, on the server's event loop. On any other thread a control
    could be set back to the controller's value before the user's value is read.
    """

    def __init__(self, server: viser.ViserServer, robot: Robot, sender: RequestSender) -> None:
        self._gui, self._settings, self._sender = server.gui, robot.settings, sender
        self._loop = server.get_event_loop()
        self._touched: dict[int, float] = {}
        self._tasks: dict[str, tuple[Any, Any | None]] = {}
        self._contacts: dict[str, Any] = {}
        self._modes()
        self._mock = self._gui.add_folder("Simulated robot", visible=False)
        with self._mock:
            self._hoist()
            self._fault_controls()
        with self._gui.add_folder("Contacts", expand_by_default=False):
            for name, contact in robot.settings.contacts.items():
                self._contacts[name] = self._switch(name, contact.enabled, "contact", name)
        with self._gui.add_folder("Tasks", expand_by_default=False):
            for name in robot.settings.tasks:
                self._task(name, robot.settings)

    def show(self, snapshot: Snapshot, mock: bool) -> None:
        """Follow the controller, except controls that a user has just moved; `mock` is True for a mock robot."""
        self._mock.visible = mock
        if snapshot.references is not None and snapshot.status is not None:
            self._loop.call_soon_threadsafe(self._show, snapshot, snapshot.status.values)

    def _show(self, snapshot: Snapshot, values: Mapping[str, str]) -> None:
        for name, (switch, slider) in self._tasks.items():
            weight = float(values.get(f"task_weight/{name}", "nan"))
            if weight == weight:
                self._follow(switch, weight > 0.0)
                if slider is not None and weight > 0.0:
                    self._follow(slider, min(weight, slider.max))
        for name, switch in self._contacts.items():
            self._follow(switch, name in snapshot.forces)

    def _modes(self) -> None:
        for label, word, color, hint in (
            ("STOP", "estop", "red", "Zero torque at once: the robot falls."),
            ("Activate", "activate", "green", "The controller takes the robot: torques are ramped in."),
            ("Deactivate", "deactivate", "gray", "Torques are ramped out."),
            ("Damp", "damp", "gray", "The joints are damped: the robot sinks down."),
            ("Reset", "reset", "gray", "Out of a fault, or a stop."),
            ("Record", "record", "gray", "The last seconds are written to a file, for wbc view and wbc replay."),
        ):
            button = self._gui.add_button(label, color=color, hint=f"{hint} wbc send {word}")  # type: ignore[arg-type]
            button.on_click(self._says(word))

    def _says(self, word: str) -> Callable[[Any], None]:
        return lambda event: self._sender.say(word)

    def _hoist(self) -> None:
        for word, hint in (("hold", "The hoist lifts it to its start."), ("release", "The hoist lets go.")):
            self._gui.add_button(word.capitalize(), color="gray", hint=hint).on_click(self._says(word))

    def _fault_controls(self) -> None:
        """Add the controls of faults; each change sends all faults together, as the mock robot's topic expects."""
        as_built = self._gui.add_checkbox("Slippery floor", False)
        friction = self._gui.add_slider("Its friction", 0.0, _SLIPPERY, 0.01, 0.2)
        sliders = [
            (self._gui.add_slider(f"{label} [{unit}]", 0.0, most, step, 0.0), fault)
            for label, most, step, unit, fault in _FAULTS
        ]

        async def changed(event: Any) -> None:
            if event.client_id is None:
                return
            faults = [fault(slider.value) for slider, fault in sliders if slider.value > 0.0]
            if as_built.value:
                faults.append(f"{{kind: slippery_floor, friction: {friction.value:g}")
            listed = ", ".join(f"{fault}, duration: {_DURATION:g}}}" for fault in faults)
            self._sender.drag("faults", event.client_id, ["fault", f"[{listed}]" if faults else "clear"])

        controls: list[Any] = [as_built, friction, *(slider for slider, _ in sliders)]
        for control in controls:
            control.on_update(changed)

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

        async def switched(event: Any) -> None:
            if event.client_id is not None:
                self._touched[id(switch)] = time.monotonic()
                self._sender.say(*words, "on" if switch.value else "off")

        switch.on_update(switched)
        return switch

    def _slider(self, label: str, value: float, task: str, request: Callable[[str], list[str]]) -> Any | None:
        """Add a slider whose values are sent by a request; None without a positive value to begin with."""
        if not value > 0.0:
            return None
        slider = self._gui.add_slider(label, 0.0, _RANGE * value, value / 50.0, value)

        async def moved(event: Any) -> None:
            if event.client_id is not None:
                self._touched[id(slider)] = time.monotonic()
                self._sender.drag(f"{label} {task}", event.client_id, request(f"{slider.value:.6g}"))

        slider.on_update(moved)
        return slider

    def _follow(self, control: Any, value: Any) -> None:
        if time.monotonic() - self._touched.get(id(control), -_OWN) >= _OWN and control.value != value:
            control.value = value
