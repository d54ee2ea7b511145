"""Keyboard of `wbc drive`."""

import contextlib
import os
import select
import termios
import time
import tty
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import click

from wbc_controller.apps.terminal.session import Session
from wbc_controller.middleware.codec import encode, velocity_message

PERIOD = 0.1  # time between two messages, s
#: Direction forward, to the left and turning, by key.
DIRECTIONS: Mapping[str, tuple[int, int, int]] = {
    "u": (1, 0, 1), "i": (1, 0, 0), "o": (1, 0, -1),
    "j": (0, 0, 1), "l": (0, 0, -1),
    "m": (-1, 0, -1), ",": (-1, 0, 0), ".": (-1, 0, 1),
    "U": (1, 1, 0), "I": (1, 0, 0), "O": (1, -1, 0),
    "J": (0, 1, 0), "L": (0, -1, 0),
    "M": (-1, 1, 0), "<": (-1, 0, 0), ">": (-1, -1, 0),
    "w": (1, 0, 0), "a": (0, 1, 0), "s": (-1, 0, 0), "d": (0, -1, 0),
    "\x1b[A": (1, 0, 0), "\x1b[B": (-1, 0, 0), "\x1b[C": (0, 0, -1), "\x1b[D": (0, 0, 1),
}  # fmt: skip
_FASTER = {"q": 1.1, "z": 1.0 / 1.1}  # change of both speeds by key
_ARROW = 3  # characters of an arrow key: escape, '[' or 'O', letter
_ACKNOWLEDGMENT = 1.0  # longest wait for that of the last message, s
KEYS = """\
   u i o     forward: and left, straight, and right        w or up      forward
   j k l     turn left, stop, turn right                   s or down    backward
   m , .     backward: and right, straight, and left       a, d         to the left, to the right
   shift: sideways in place of turning                     left, right  turn
   q, z: 10 % faster, slower     any other key: stop       Ctrl-C: stop and exit
"""


@dataclass(frozen=True, slots=True)
class Drive:
    """Direction and speeds."""

    speed: float  # m/s
    turn_rate: float  # rad/s
    direction: tuple[int, int, int] = (0, 0, 0)

    @property
    def velocity(self) -> tuple[float, float, float]:
        """Velocity forward and to the left, m/s, and turning rate, rad/s."""
        forward, left, turning = self.direction
        return self.speed * forward, self.speed * left, self.turn_rate * turning

    def after(self, keys: str) -> "Drive":
        """Return the state after pressed keys; an unknown key stops."""
        drive = self
        while keys:
            length = _ARROW if keys[:2] in ("\x1b[", "\x1bO") else 1
            key, keys = keys[:length].replace("\x1bO", "\x1b["), keys[length:]
            if key in _FASTER:
                drive = replace(drive, speed=drive.speed * _FASTER[key], turn_rate=drive.turn_rate * _FASTER[key])
            else:
                drive = replace(drive, direction=DIRECTIONS.get(key, (0, 0, 0)))
        return drive


@contextlib.contextmanager
def single_keys(terminal: int) -> Iterator[None]:
    """Pass on each key of a terminal without echo."""
    before = termios.tcgetattr(terminal)
    tty.setcbreak(terminal)
    try:
        yield
    finally:
        termios.tcsetattr(terminal, termios.TCSADRAIN, before)
        click.echo()


def publish_velocities(session: Session, drive: Drive, terminal: int) -> None:
    """Publish the velocity until the input ends, then zero."""
    publish, due = session.open("controller", "cmd_vel"), time.monotonic()
    status: dict[str, str] = {}
    try:
        while True:
            publish(encode(velocity_message(drive.velocity)))
            for newest in session.statuses():
                status = {value.key: value.value for value in newest.values}
            forward, left, turning = drive.velocity
            parts = [f"forward {forward:.2f}, left {left:.2f} m/s, turn {turning:.2f} rad/s", session.mode()]
            if "walking/phase" in status:
                parts.append(f"{status['walking/phase']}, {status['walking/steps']} steps")
            click.echo(f"\r{' | '.join(parts)}\x1b[K", nl=False)
            due = max(due + PERIOD, time.monotonic())
            while (remaining := due - time.monotonic()) > 0.0:
                if select.select([terminal], [], [], remaining)[0]:
                    pressed = os.read(terminal, 64)
                    if not pressed:
                        return
                    drive = drive.after(pressed.decode(errors="replace"))
    finally:
        publish(encode(velocity_message((0.0, 0.0, 0.0))))
        publish.wait_for_acknowledgment(_ACKNOWLEDGMENT)
