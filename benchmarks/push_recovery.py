"""Measure the largest push that a standing Talos withstands without a step, by bisection, in each direction.

The simulation in MuJoCo runs at 1 kHz, with a known true state. A force acts for 0.1 s at the origin of its base.
Success: no fall, no corner of a sole moved by more than 1 cm, and after 5 s no coordinate faster than 0.05 (m/s, rad/s)
and the centre of mass within 1 cm of its start. Contacts return to their initial places with CONTACT_STIFFNESS, because
unloaded feet slide by about 0.1 mm. The result with tsid's tasks depends on the weight of the posture, which stiffens
hips and torso. Our limits of joint positions and velocities are off with these tasks, because tsid has none.

    python benchmarks/push_recovery.py                 tsid, ours with the same tasks, and with those of docs/balance.md
    python benchmarks/push_recovery.py tsid balance    some of them

Reference: the impulse m ω d that moves a linear inverted pendulum to the edge of the support, with ω = √(g / c_z) and
the distance d from the centre of mass to the edge.
"""

import math
import re
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from contestants import Contestant, rival
from our_cycle import Cycle, Stopped, parse_settings
from scenes import WEIGHTS as USUAL_WEIGHTS
from scenes import content_of, message, tasks

from wbc_controller.controller.build.robot import make_model
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array
from wbc_controller.settings import Settings
from wbc_controller.simulation.plant import Plant

#: Unit vectors in base axes at the start: x forward, y left.
DIRECTIONS = {"sideways": (0.0, 1.0), "forward": (1.0, 0.0), "backward": (-1.0, 0.0)}
PUSH_SECONDS = 0.1
#: Start of the push, and time limit of the recovery, s.
PUSH_AT, END = 0.5, 5.5
LIFTED, SLID, AT_REST, BACK = 0.01, 0.01, 0.05, 0.01
#: Stiffness of the contacts, 1/s².
CONTACT_STIFFNESS = 1000.0
#: Weights of tsid's tasks, also in ours.
WEIGHTS = USUAL_WEIGHTS | {"posture": 0.003}
#: Range of the impulses, and resolution, N·s.
LOWEST, HIGHEST, RESOLUTION = 10.0, 90.0, 0.25

#: Frame of the task `waist`.
WAIST = "base_link"

Torques = Callable[[Array, Array], Array]


def balance_tasks() -> dict[str, Any]:
    """Return the tasks of docs/balance.md."""
    page = Path(__file__).resolve().parents[1] / "docs" / "balance.md"
    blocks = re.findall(r"```yaml\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    return dict(yaml.safe_load(blocks[0])["tasks"])


def talos(its_tasks: Mapping[str, Any], **sections: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of Talos at 1 kHz, as plain values."""
    return content_of("talos", its_tasks, sections, contact_stiffness=CONTACT_STIFFNESS)


class Stand:
    """Talos in the simulator, on its feet."""

    def __init__(self, settings: Settings, model: RobotModel) -> None:
        """Place the robot, held by the hoist."""
        self.settings, self.model = settings, model
        self.plant = Plant(model, settings)
        self.start, _ = self.plant.state()
        self._view = Cycle(settings, model).controller
        self._dynamics = self._view.dynamics
        self.com = self._measure()[0]
        self.lifted = self.slid = 0.0

    def _measure(self) -> tuple[Array, Array]:
        """Return centre of mass, (3,), and corners of the soles, (n, 3), in the world."""
        self._dynamics.update(*self.plant.state())
        corners = [contact.points(self._dynamics) for contact in self._view.contacts.values()]
        return np.array(self._dynamics.com), np.concatenate(corners)

    def bound(self, direction: tuple[float, float]) -> float:
        """Return m ω d of the pendulum in a direction, N·s."""
        com, corners = self._measure()
        edge = float(np.max((corners - com)[:, :2] @ direction))
        return self.model.mass * math.sqrt(self.model.gravity / float(com[2])) * edge

    def outcome(self, torques: Torques, direction: tuple[float, float], impulse: float) -> str:
        """Push the robot, and return the reason of a failure; empty for success."""
        plant = self.plant
        force = np.zeros(6)
        force[:2] = impulse / PUSH_SECONDS * np.array(direction)
        corners = None
        while plant.time < END:
            q, v = plant.state()
            try:
                plant.apply(torques(q, v))
            except Stopped as stop:
                return f"at {plant.time:.2f} s {stop}"
            if plant.held and plant.time >= 0.1:
                plant.hold(False, ramp=0.1)
            if corners is None and plant.time >= PUSH_AT:
                corners = self._measure()[1]
                plant.push(self.model.base_link, force, PUSH_SECONDS)
            plant.step()
            if plant.fallen:
                return f"fell at {plant.time:.2f} s"
            if corners is not None and plant.stamp % 10_000_000 == 0:
                com, now = self._measure()
                moved = now - corners
                self.lifted = max(self.lifted, float(np.max(moved[:, 2])))
                self.slid = max(self.slid, float(np.max(np.linalg.norm(moved[:, :2], axis=1))))
                if not (self.lifted <= LIFTED and self.slid <= SLID):
                    return f"foot motion at {plant.time:.2f} s"
                settled = np.max(np.abs(v)) <= AT_REST and np.linalg.norm(com - self.com) <= BACK
                if settled and plant.time > PUSH_AT + 1.0:
                    return ""
        return "not at rest in the end"


def ours(settings: Settings, model: RobotModel, q: Array) -> Torques:
    """Return the commands of our controller and supervisor."""
    cycle = Cycle(settings, model)
    references = cycle.start(q)
    return lambda q, v: cycle.step(cycle.state(q, v), references).tau


def tsids(process: Contestant, model: RobotModel, com: Array) -> Torques:
    """Return the commands of tsid; without a solution, the last one."""
    to_command = model.v_index - 6
    reference = np.concatenate([com, np.zeros(6)])
    last = np.zeros(model.na)

    def torques(q: Array, v: Array) -> Array:
        nonlocal last
        tau = process.solve(np.concatenate([q, v, reference])).tau[0]
        if np.isfinite(tau).all():
            last = tau[to_command]
        return last

    return torques


def limit(
    settings: Settings, model: RobotModel, direction: tuple[float, float], make: Callable[[Stand], Torques]
) -> tuple[float, Stand | None, str]:
    """Return the largest impulse without a failure, N·s, the robot after it, and the failure of the next larger one."""
    low, high, last, why = LOWEST, HIGHEST, None, ""
    while high - low > RESOLUTION:
        middle = 0.5 * (low + high)
        stand = Stand(settings, model)
        outcome = stand.outcome(make(stand), direction, middle)
        if outcome:
            high, why = middle, outcome
        else:
            low, last = middle, stand
    return low, last, why


def main(chosen: list[str]) -> None:
    """Print the table."""
    content = talos(tasks(WAIST, WEIGHTS), limits={"position": False, "velocity": False})
    settings = parse_settings(content, "push_recovery.py")
    model = make_model(settings)
    stand = Stand(settings, model)
    rivals: dict[str, float] = {}
    print(
        f"{model.mass:.1f} kg, centre of mass {1e3 * stand.com[2]:.0f} mm high; impulses in N·s over {PUSH_SECONDS} s"
    )
    print(f"{'':10}{'direction':12}{'m ω d':>8}{'max.':>8}{'of tsid':>9}{'slid':>9}{'lifted':>9}   failure")
    with rival("tsid", message(content, settings, model, stand.start, WEIGHTS, WAIST)) as process:
        controllers: dict[str, tuple[Settings, Callable[[Stand], Torques]]] = {
            "tsid": (settings, lambda stand: tsids(process, model, stand.com)),
            "same": (settings, lambda stand: ours(stand.settings, model, stand.start)),
            "balance": (
                parse_settings(talos(balance_tasks()), "push_recovery.py"),
                lambda stand: ours(stand.settings, model, stand.start),
            ),
        }
        for name in chosen or controllers:
            for direction, vector in DIRECTIONS.items():
                held, last, why = limit(controllers[name][0], model, vector, controllers[name][1])
                rivals.setdefault(direction, held if name == "tsid" else math.nan)
                moved = f"{1e3 * last.slid:6.1f} mm{1e3 * last.lifted:6.1f} mm" if last is not None else ""
                print(
                    f"{name:10}{direction:12}{stand.bound(vector):8.1f}{held:8.1f}{held / rivals[direction]:9.2f}"
                    f"{moved}   {why}",
                    flush=True,
                )


if __name__ == "__main__":
    main(sys.argv[1:])
