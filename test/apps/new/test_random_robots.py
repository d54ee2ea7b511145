"""Agreement of `wbc new`, `wbc check`, the mock robot and the demo on random robots.

``RANDOM_ROBOTS=1000 pytest test/apps/new/test_random_robots.py`` tests more of them, with whole demos.
"""

import os
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from random_robots import RandomRobot

import wbc_controller as wbc
from wbc_controller.apps.demo.derived_scenario import derived_scenario
from wbc_controller.apps.demo.run import run_demo
from wbc_controller.apps.new.draft import TITLE, new_configuration
from wbc_controller.errors import ConfigurationError, WbcError
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array
from wbc_controller.settings.config import load

#: Number of robots; by default an arm with a mistake, bipeds that stand and cannot stand, a quadruped, and two arms.
ROBOTS = int(os.environ.get("RANDOM_ROBOTS", "0"))
SEEDS = range(ROBOTS) if ROBOTS else (0, 2, 5, 8, 9)
#: One robot in so many gets the whole demo.
_DEMOS = 25
#: Parts of the demos of some robots; None for the whole demo.
_PARTS: dict[int, tuple[str, ...] | None] = {
    27: ("shove forward",),  # soles that tip under a push, which looked like inverted axes of the odometry
    309: None,  # a biped whose unloaded foot spins at 49 rad/s without rotor inertia
    425: ("shove left",),  # a gripper too weak to stop within its short range after the pushes of other arms
    700_150: ("shove left", "reach"),  # a short arm, which a strong posture task pulled back
    910_225: ("reach",),  # an arm on a fixed base that dropped while the torques ramped in, and needed 3 s to return
}
#: Robots in equilibrium on a line between two feet; with an arm that dropped while the torques ramped in, sliding on a
#: biped whose legs lost their load to stop it; with a posture within `limits.position_margin` of its limits.
_OTHERS = (910_337, 910_500, 910_747)
#: Duration of standing, s; largest displacement of the centre of mass as a share of its height, at least in m, and of
#: the joints of an arm, rad or m.
_STAND, _NEAR, _NEAR_SMALL, _NEAR_JOINT = 1.0, 0.02, 0.005, 0.02


def outcome(seed: int, folder: Path) -> tuple[str, str]:
    """Return the kind of a robot, and "stands" or the message of its refusal, the same from all readers."""
    robot = RandomRobot(seed, folder)
    urdf, path = folder / "robot.urdf", folder / "robot.yaml"
    urdf.write_text(robot.text, encoding="utf-8")
    try:
        draft = new_configuration(str(urdf))
    except ConfigurationError as error:
        return robot.kind, f"refused: {_sentence(error)}"
    path.write_text(draft.to_yaml(TITLE), encoding="utf-8")
    settings = load(path).settings
    assert settings == draft.settings
    try:
        wbc.check(settings)
    except ConfigurationError as error:
        message = _sentence(error)
        with pytest.raises(WbcError) as other:
            run_demo(str(path), folder, lockstep=True)
        assert _sentence(other.value).removeprefix(f"{path}: ") == message
        return robot.kind, f"not standing: {message}"
    simulation = wbc.Simulation(settings)
    model, before = simulation.controller.model, simulation.plant.state()[0]
    simulation.run(_STAND)
    assert not simulation.plant.fallen
    if model.floating_base:
        start, end = (_com(model, q) for q in (before, simulation.plant.state()[0]))
        assert np.linalg.norm(end - start) <= max(_NEAR * start[2], _NEAR_SMALL), f"{np.linalg.norm(end - start)} m"
    else:
        assert np.abs(simulation.plant.state()[0] - before).max() <= _NEAR_JOINT
    derived_scenario(settings, model)
    # The audit reports unmeasured feet, which touch away from their contact.
    measured = not any(note.key.startswith("contacts") for note in draft.notes if note.origin == "missing")
    if (seed % _DEMOS == 0 or seed in _PARTS) and measured:
        assert run_demo(str(path), folder, lockstep=True)
    return robot.kind, f"stands, {settings.robot.base}"


def _com(model: RobotModel, q: Array) -> Array:
    return np.array(pin.centerOfMass(model.pinocchio, model.pinocchio.createData(), np.array(q)))


def _sentence(error: WbcError) -> str:
    message = str(error).removeprefix("a dictionary: ").removeprefix("the draft: ")
    assert "\n" not in message, message
    assert 10 < len(message) < 900
    return message


@pytest.mark.parametrize("seed", [*SEEDS, *_PARTS, *_OTHERS])
def test_new_check_mock_robot_and_demo_agree(seed, tmp_path, shorten_demos):
    parts = _PARTS.get(seed, ())
    if not ROBOTS and parts is not None:
        shorten_demos(*parts)
    kind, found = outcome(seed, tmp_path)
    print(kind, found)
