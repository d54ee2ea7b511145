"""Draft, check and try configurations of `wbc new` for the robots of example-robot-data.

Each file is used unedited, first checked, then tried in the mock robot. A legged robot stays for 5 s, sways to both
sides, squats, and withstands a push at the base by a tenth of its weight times one second. With the section `walking`,
it walks forward at its largest speed for 8 s, and stops. An arm holds its posture for 5 s, moves all joints to one side
("sway") and the other ("squat"), and withstands a push at its last link.

    python benchmarks/new_robots.py                 the table of docs/benchmarks.md, as Markdown
    python benchmarks/new_robots.py g1 panda        some robots, by a part of the name
"""

import sys
from collections.abc import Iterable
from dataclasses import astuple, dataclass

import numpy as np

import wbc_controller as wbc
from wbc_controller.apps.new.draft import new_configuration
from wbc_controller.apps.new.notes import Draft
from wbc_controller.errors import WbcError
from wbc_controller.records import Array
from wbc_controller.settings import Settings

FOLDER = "package://example-robot-data/robots/"
#: URDF, and SRDF if the robot has one.
ROBOTS: dict[str, tuple[str, str]] = {
    "A1": ("a1_description/urdf/a1.urdf", "a1_description/srdf/a1.srdf"),
    "Alex, upper body": ("alex_description/urdf/alex_nub_hands.urdf", ""),
    "Alexander, lower body": ("alexander_description/urdf/alexander_v1.lowerBodyOnly.urdf", ""),
    "Allegro hand": ("allegro_hand_description/urdf/allegro_left_hand.urdf", ""),
    "ANYmal B": ("anymal_b_simple_description/robots/anymal.urdf", "anymal_b_simple_description/srdf/anymal.srdf"),
    "ANYmal B with an arm": ("anymal_b_simple_description/robots/anymal-kinova.urdf", ""),
    "ANYmal C": ("anymal_c_simple_description/urdf/anymal.urdf", "anymal_c_simple_description/srdf/anymal.srdf"),
    "B1": ("b1_description/urdf/b1.urdf", ""),
    "B1 with an arm": ("b1_description/urdf/b1-z1.urdf", "b1_description/srdf/b1-z1.srdf"),
    "Baxter": ("baxter_description/urdf/baxter.urdf", ""),
    "Bolt": ("bolt_description/robots/bolt.urdf", "bolt_description/srdf/bolt.srdf"),
    "Centauro": ("centauro_description/urdf/centauro.urdf", "centauro_description/srdf/centauro.srdf"),
    "Double pendulum": ("double_pendulum_description/urdf/double_pendulum.urdf", ""),
    "Finger": ("finger_edu_description/robots/finger_edu.urdf", "finger_edu_description/srdf/finger_edu.srdf"),
    "G1": ("g1_description/urdf/g1_29dof_rev_1_0.urdf", ""),
    "G1 with hands": ("g1_description/urdf/g1_29dof_with_hand_rev_1_0.urdf", ""),
    "Go1": ("go1_description/urdf/go1.urdf", "go1_description/srdf/go1.srdf"),
    "Go2": ("go2_description/urdf/go2.urdf", ""),
    "Human": ("human_description/robots/human.urdf", ""),
    "HyQ": ("hyq_description/robots/hyq_no_sensors.urdf", "hyq_description/srdf/hyq.srdf"),
    "iCub": ("icub_description/robots/icub_reduced.urdf", "icub_description/srdf/icub.srdf"),
    "Kinova": ("kinova_description/robots/kinova.urdf", "kinova_description/srdf/kinova.srdf"),
    "Laikago": ("laikago_description/urdf/laikago.urdf", ""),
    "Panda": ("panda_description/urdf/panda.urdf", ""),
    "PR2": ("pr2_description/urdf/pr2.urdf", ""),
    "Romeo": ("romeo_description/urdf/romeo_small.urdf", "romeo_description/srdf/romeo_small.srdf"),
    "Simple humanoid": ("simple_humanoid_description/urdf/simple_humanoid.urdf", ""),
    "SO-100": ("so_arm_description/urdf/so100.urdf", ""),
    "Solo 8": ("solo_description/robots/solo.urdf", ""),
    "Solo 12": ("solo_description/robots/solo12.urdf", ""),
    "Talos": ("talos_data/robots/talos_reduced.urdf", "talos_data/srdf/talos.srdf"),
    "Talos, no SRDF": ("talos_data/robots/talos_reduced.urdf", ""),
    "TIAGo": ("tiago_description/robots/tiago_no_hand.urdf", ""),
    "UR5": ("ur_description/urdf/ur5_robot.urdf", ""),
    "xArm 7": ("xarm_description/urdf/xarm7.urdf", ""),
    "Z1": ("z1_description/urdf/z1.urdf", ""),
}
#: Trials in order: methods, and columns of the table.
TRIED = ("stands", "sway", "squat", "push", "walk")
STAND = 5.0
#: Motion of the centre of mass sideways and down, as a share of its height, and of an arm's joints, rad.
SWAY, SQUAT, SWING = 0.04, 0.08, 0.1
#: Time of a motion, and of rest after it and after a push, s.
MOVE, REST = 1.0, 1.5
#: Change of the free robot's speed by a push, m/s, and duration of the push, s.
PUSH, PUSH_SECONDS = 0.1, 0.1
#: Time of a walk, and until the speed is reached, s.
WALK, REACHED = 8.0, 4.0
#: Largest error of the centre of mass, as a share of its height, and of an arm's joints, rad.
NEAR, NEAR_JOINT = 0.02, 0.02


@dataclass
class Row:
    """A line of the table."""

    robot: str
    kind: str = ""
    joints: str = ""
    feet: str = ""
    check: str = ""
    stands: str = ""
    sway: str = ""
    squat: str = ""
    push: str = ""
    walk: str = ""
    to_do: str = ""

    def markdown(self) -> str:
        """Return the line."""
        return f"| {' | '.join(astuple(self))} |"


HEADER = """| Robot | Base | Joints | Feet | Check | Stands 5 s | Sway | Squat | Push | Walk | To fill in |
|---|---|---|---|---|---|---|---|---|---|---|"""


def run(robot: str) -> Row:
    """Draft, check and try one robot."""
    urdf, srdf = ROBOTS[robot]
    row = Row(robot)
    try:
        draft = new_configuration(FOLDER + urdf, srdf=FOLDER + srdf if srdf else None)
    except WbcError as error:
        row.check, row.to_do = "no", first_sentence(error)
        return row
    values = draft.values
    row.kind, row.joints = values["robot"]["base"], str(len(values["robot"]["joints"]))
    row.feet = feet_of(draft)
    row.to_do = ", ".join(dict.fromkeys(f"`{note.key}`" for note in draft.notes if note.origin == "missing"))
    try:
        settings = draft.settings
        wbc.check(settings)
    except WbcError as error:
        row.check, row.to_do = "no", first_sentence(error)
        return row
    row.check = "ok"
    floating = row.kind == "floating"
    try:
        trial = Standing(settings) if floating else Holding(settings)
        for column in TRIED:
            setattr(row, column, getattr(trial, column)())
    except WbcError as error:
        column = next(column for column in TRIED if not getattr(row, column))
        setattr(row, column, f"no: {first_sentence(error)}")
    return row


def feet_of(draft: Draft) -> str:
    """Return the number of feet by kind."""
    kinds = [contact["type"] for contact in draft.values.get("contacts", {}).values()]
    return ", ".join(f"{kinds.count(kind)} {kind}" for kind in dict.fromkeys(kinds)) or "none"


def first_sentence(error: WbcError) -> str:
    """Return the text of an error, shortened for the table."""
    text = str(error).splitlines()[0].removeprefix("a dictionary: ")
    return (text if len(text) <= 160 else text[:157] + "…").replace("|", "/")


class Trial:
    """A robot in the mock robot, and a task with its reference at rest."""

    task: str
    rest: Array

    def __init__(self, settings: Settings) -> None:
        """Let the robot hold its posture."""
        self.robot = wbc.Simulation(settings)
        self.model = self.robot.controller.model

    def _off(self, goal: Array) -> str:
        raise NotImplementedError

    def _to(self, goal: Array) -> str:
        self.robot.controller.set(self.task, goal, duration=MOVE)
        self.robot.run(MOVE + 0.5)
        return self._off(goal)

    def _through(self, goals: Iterable[Array]) -> str:
        """Move through all goals, and return the first failure."""
        return next((one for one in [self._to(goal) for goal in goals] if one != "yes"), "yes")

    def _push_at(self, link: str) -> str:
        force = np.array([0.0, PUSH * self.model.mass / PUSH_SECONDS, 0.0, 0.0, 0.0, 0.0])
        self.robot.plant.push(link, force, PUSH_SECONDS)
        self.robot.run(PUSH_SECONDS + REST)
        return self._off(self.rest)

    def stands(self) -> str:
        """Hold the posture for 5 s."""
        self.robot.run(STAND)
        return self._off(self.rest)


class Standing(Trial):
    """A legged robot."""

    task = "com"

    def __init__(self, settings: Settings) -> None:
        """Let the robot stand."""
        super().__init__(settings)
        self.rest = self._com()
        lowest = min(
            float(contact.points(self.robot.controller.dynamics)[:, 2].min())
            for contact in self.robot.controller.contacts.values()
        )
        self.height = float(self.rest[2]) - lowest

    def _com(self) -> Array:
        self.robot.controller.dynamics.update(*self.robot.plant.state())
        return np.array(self.robot.controller.dynamics.com)

    def _off(self, goal: Array) -> str:
        if self.robot.plant.fallen:
            return "no: fallen"
        off = float(np.linalg.norm(self._com() - goal))
        return "yes" if off <= NEAR * self.height else f"no: {1e3 * off:.0f} mm off"

    def sway(self) -> str:
        """Move the centre of mass to the left, to the right and back."""
        return self._through(self.rest + np.array([0.0, side * SWAY * self.height, 0.0]) for side in (1.0, -1.0, 0.0))

    def squat(self) -> str:
        """Move the centre of mass down and up."""
        return self._through(self.rest - np.array([0.0, 0.0, down * SQUAT * self.height]) for down in (1.0, 0.0))

    def push(self) -> str:
        """Push to the side."""
        return self._push_at(self.model.base_link)

    def walk(self) -> str:
        """Walk forward at the largest speed, and stop."""
        robot = wbc.Simulation(self.robot.controller.config)
        walker = robot.controller.walker
        if walker is None:
            return "–"
        asked = walker.gait.speed[0]
        robot.controller.walk(asked)
        robot.run(REACHED)
        (start, _), begun = robot.plant.state(), robot.time
        robot.run(WALK - REACHED)
        (end, _), ended = robot.plant.state(), robot.time
        robot.controller.stand()
        robot.run(REACHED)
        if robot.plant.fallen or walker.moves:
            return "no: it did not stop"
        return f"{np.linalg.norm((end - start)[:2]) / (ended - begun):.2f}, {asked:.2f} m/s"


class Holding(Trial):
    """A robot on a fixed base."""

    task = "posture"

    def __init__(self, settings: Settings) -> None:
        """Let the robot hold its posture."""
        super().__init__(settings)
        model = self.model
        self.rest = np.array(model.posture)
        room = np.minimum(model.position_upper - self.rest, self.rest - model.position_lower)
        speed = self.robot.controller.config.settings.limits.velocity_scale * model.velocity_limits
        # A quintic has at most 1.875 times its mean speed.
        self.swing = np.minimum.reduce([np.full(model.nj, SWING), np.maximum(room - 0.03, 0.0), 0.2 * speed * MOVE])

    def _off(self, goal: Array) -> str:
        off = float(np.abs(self.robot.plant.state()[0][self.model.q_index] - goal).max())
        return "yes" if off <= NEAR_JOINT else f"no: {off:.3f} rad off"

    def sway(self) -> str:
        """Move all joints to one side."""
        return self._to(self.rest + self.swing)

    def squat(self) -> str:
        """Move all joints to the other side, and back."""
        result = self._to(self.rest - self.swing)
        return result if result != "yes" else self._to(self.rest)

    def push(self) -> str:
        """Push at the last link."""
        return self._push_at(str(self.model.pinocchio.names[int(self.model.pinocchio.njoints) - 1]))

    def walk(self) -> str:
        """Return that an arm does not walk."""
        return "–"


def main(chosen: list[str]) -> None:
    """Print the table."""
    print(HEADER)
    for robot in ROBOTS:
        if not chosen or any(part.lower() in robot.lower() for part in chosen):
            print(run(robot).markdown(), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
