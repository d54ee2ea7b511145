"""Buttons, switches and sliders: each sends what `wbc send` would."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import viser

from wbc_controller.apps.page.moment import Moment, Robot
from wbc_controller.apps.page.sending import Sender
from wbc_controller.apps.terminal.status_view import Heard
from wbc_controller.settings import Settings

#: Time for which a switch or slider that a user has moved does not follow what the controller says, s.
_OWN = 2.0
#: Largest value of a slider for a weight or a gain, as a multiple of the configured one.
_RANGE = 4.0
#: What can be wrong with the mock robot, by slider: label, largest value, step, unit, faults for a value.
_TROUBLES: tuple[tuple[str, float, float, str, Callable[[float], str]], ...] = (
    ("Sensor noise", 0.01, 0.0005, "rad",
     lambda value: f"{{kind: joint_noise, sigma: {max(value, 1e-5):g}, velocity_sigma: {max(10.0 * value, 1e-4):g}"),
    ("Delay of states", 60.0, 2.0, "ms", lambda value: f"{{kind: message_delay, delay: {1e-3 * value:g}"),
    ("Delay of torques", 20.0, 2.0, "ms", lambda value: f"{{kind: command_delay, delay: {1e-3 * value:g}"),
)  # fmt: skip
#: Range of the slider for the friction of the mock robot's floor; the fault `slippery_floor` takes these values.
_SLIPPERY = 0.5
#: Longest time that a fault of the mock robot lasts, s.
_LASTS = 3600.0


class Controls:
    """The controls on the page's panel, shared by all pages.

    What users have set is read, and what the controller says is shown, on the server's event loop. On any other thread
    the controls could be set back to what the controller says before the user's value has been read.
    """

    def __init__(self, server: viser.ViserServer, robot: Robot, sender: Sender) -> None:
        """Put them into the panel.

        Args:
            server: whose page it is.
            robot: the robot.
            sender: sends what they ask for.
        """
        self._gui, self._settings, self._sender = server.gui, robot.settings, sender
        self._loop = server.get_event_loop()
        self._touched: dict[int, float] = {}
        self._tasks: dict[str, tuple[Any, Any | None]] = {}
        self._contacts: dict[str, Any] = {}
        self._modes()
        self._mock = self._gui.add_folder("Simulated robot", visible=False)
        with self._mock:
            self._hoist()
            self._trouble()
        with self._gui.add_folder("Contacts", expand_by_default=False):
            for name, contact in robot.settings.contacts.items():
                self._contacts[name] = self._switch(name, contact.enabled, "contact", name)
        with self._gui.add_folder("Tasks", expand_by_default=False):
            for name in robot.settings.tasks:
                self._task(name, robot.settings)

    def show(self, moment: Moment, mock: bool) -> None:
        """Follow what the controller says, soon, where no user has just asked for something else.

        Args:
            moment: the newest.
            mock: whether the robot is a mock robot.
        """
        self._mock.visible = mock
        if moment.references is not None and moment.heard is not None:
            self._loop.call_soon_threadsafe(self._show, moment, moment.heard)

    def _show(self, moment: Moment, heard: Heard) -> None:
        values = heard.values
        for name, (switch, slider) in self._tasks.items():
            weight = float(values.get(f"task_weight/{name}", "nan"))
            if weight == weight:
                self._follow(switch, weight > 0.0)
                if slider is not None and weight > 0.0:
                    self._follow(slider, min(weight, slider.max))
        for name, switch in self._contacts.items():
            self._follow(switch, name in moment.forces)

    def _modes(self) -> None:
        stop = self._gui.add_button("STOP", color="red", hint="Zero torque at once: the robot falls. wbc send estop")
        stop.on_click(self._says("estop"))
        for label, word, hint in (
            ("Activate", "activate", "The controller takes the robot: torques are ramped in."),
            ("Deactivate", "deactivate", "Torques are ramped out."),
            ("Damp", "damp", "The joints are damped: the robot sinks down."),
            ("Reset", "reset", "Out of a fault, or a stop."),
            ("Record", "record", "The last seconds are written to a file, for wbc view and wbc replay."),
        ):
            color: Any = "green" if word == "activate" else "gray"
            button = self._gui.add_button(label, color=color, hint=f"{hint} wbc send {word}")
            button.on_click(self._says(word))

    def _says(self, word: str) -> Callable[[Any], None]:
        return lambda event: self._sender.say(word)

    def _hoist(self) -> None:
        for label, word, hint in (
            ("Hold", "hold", "The hoist lifts it to where it began."),
            ("Release", "release", "The hoist lets go."),
        ):
            self._gui.add_button(label, color="gray", hint=hint).on_click(self._says(word))

    def _trouble(self) -> None:
        """Sliders for what is wrong with the mock robot: the faults on its topic are always all of them together."""
        as_built = self._gui.add_checkbox("Slippery floor", False)
        friction = self._gui.add_slider("Its friction", 0.0, _SLIPPERY, 0.01, 0.2)
        sliders = [
            (self._gui.add_slider(f"{label} [{unit}]", 0.0, most, step, 0.0), fault)
            for label, most, step, unit, fault in _TROUBLES
        ]

        async def changed(event: Any) -> None:
            if event.client_id is None:
                return
            faults = [fault(slider.value) for slider, fault in sliders if slider.value > 0.0]
            if as_built.value:
                faults.append(f"{{kind: slippery_floor, friction: {friction.value:g}")
            listed = ", ".join(f"{fault}, duration: {_LASTS:g}}}" for fault in faults)
            self._sender.drag("faults", event.client_id, ["fault", f"[{listed}]" if faults else "clear"])

        controls: list[Any] = [as_built, friction, *(slider for slider, _ in sliders)]
        for control in controls:
            control.on_update(changed)

    def _task(self, name: str, settings: Settings) -> None:
        task = settings.tasks[name]
        with self._gui.add_folder(name, expand_by_default=False):
            switch = self._switch("on", task.enabled, "task", name)
            slider = self._slider("weight", task.weight, "weight", name, name)
            stiffness = getattr(task, "stiffness", None)
            if isinstance(stiffness, float) and stiffness > 0.0:
                self._gain("stiffness", stiffness, name)
        self._tasks[name] = switch, slider

    def _switch(self, label: str, on: bool, *words: str) -> Any:
        switch = self._gui.add_checkbox(label, on)

        async def switched(event: Any) -> None:
            if event.client_id is not None:
                self._touched[id(switch)] = time.monotonic()
                self._sender.say(*words, "on" if switch.value else "off")

        switch.on_update(switched)
        return switch

    def _slider(self, label: str, value: float, first: str, subject: str, key: str) -> Any | None:
        if not value > 0.0:
            return None
        slider = self._gui.add_slider(label, 0.0, _RANGE * value, value / 50.0, value)

        async def moved(event: Any) -> None:
            if event.client_id is not None:
                self._touched[id(slider)] = time.monotonic()
                self._sender.drag(f"{first} {key}", event.client_id, [first, subject, f"{slider.value:.6g}"])

        slider.on_update(moved)
        return slider

    def _gain(self, label: str, value: float, task: str) -> None:
        slider = self._gui.add_slider(label, 0.0, _RANGE * value, value / 50.0, value)

        async def moved(event: Any) -> None:
            if event.client_id is not None:
                text = f"{{tasks: {{{task}: {{{label}: {slider.value:.6g}}}}}}}"
                self._sender.drag(f"{label} {task}", event.client_id, ["update", text])

        slider.on_update(moved)

    def _follow(self, control: Any, value: Any) -> None:
        if time.monotonic() - self._touched.get(id(control), -_OWN) >= _OWN and control.value != value:
            control.value = value
