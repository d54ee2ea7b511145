"""Saved state of a controller: a restored controller continues bit for bit."""

import importlib
import itertools
import pkgutil

import numpy as np
import pinocchio as pin
import pytest

import wbc_controller
from wbc_controller.controller.cycle import ControlCycle
from wbc_controller.controller.report import CycleInputs
from wbc_controller.inverse_dynamics.references import changes as kinds
from wbc_controller.recording.json_records import from_json, to_json
from wbc_controller.records import ChangeSettings, Fault, Mode, RobotState, frozen

#: Cycles of a run, of continuations, and between saved states.
CYCLES, LENGTH, EVERY = 300, 25, 20

ESTIMATED = {"base_state": "imu"}  # with torque filter, disturbance observer and contact forces
FRICTION = {
    "estimation": {"disturbance": "always", "torque_filter": "always"},
    "robot": {"friction": {"FL_calf_joint": {"dry": 0.5, "viscous": 0.1}}},
    "limits": {"torque_speed": {"enabled": True}},
}
CASES = {
    "plain": ("go2", {}),
    "imu": ("go2", {"estimation": ESTIMATED}),
    "friction": ("go2", FRICTION),
    "levels": ("g1", {"estimation": ESTIMATED, "tasks": {"posture": {"level": 1}}}),
}


class RandomRun:
    """Inputs of random motion, with requests, changes, input faults and infeasible problems."""

    def __init__(self, controller: ControlCycle, stance: np.ndarray, seed: int) -> None:
        self.controller = controller
        self.rng = np.random.default_rng(seed)
        self.now, self.stamp = 10.0, 5_000_000_000
        self.q, self.v = stance.copy(), np.zeros(controller.model.nv)

    def chance(self, share: float) -> bool:
        return bool(self.rng.random() < share)

    def inputs(self) -> CycleInputs:
        rng, controller, model = self.rng, self.controller, self.controller.model
        elapsed = controller.period * float(rng.choice([1.0, 0.3, 2.0], p=[0.9, 0.05, 0.05]))
        self.now, self.stamp = self.now + elapsed, self.stamp + round(1.0e9 * elapsed)
        joints = 0.1 * rng.normal(size=model.nv)
        joints[: model.nv - model.nj] *= 0.1
        self.v = 0.8 * self.v + 0.2 * joints
        self.q = pin.integrate(model.pinocchio, self.q, elapsed * self.v)
        jump = 2.0 if self.chance(0.004) else 0.0
        state = RobotState(self.stamp, frozen(self.q), frozen(self.v + jump))
        return CycleInputs(
            now=self.now,
            state=state,
            joint_velocity=None if self.chance(0.05) else frozen(state.v[model.v_index]),
            problem=Fault("STALE_INPUT", "odom is late") if self.chance(0.005) else None,
            requests=self.requests(),
            changes=tuple((self.change(),) for _ in range(int(rng.integers(1, 3)) if self.chance(0.1) else 0)),
        )

    def requests(self) -> tuple[str, ...]:
        mode = self.controller.mode
        if mode is Mode.INACTIVE:
            return ("activate",)
        if mode in (Mode.STOPPED, Mode.FAULT) or (mode is Mode.DAMPING and self.chance(0.02)):
            return ("reset",)
        return (str(self.rng.choice(["deactivate", "damp", "estop"])),) if self.chance(0.01) else ()

    def change(self) -> object:
        rng, controller = self.rng, self.controller
        task, contact = str(rng.choice(list(controller.tasks))), str(rng.choice(list(controller.contacts)))
        position = controller.dynamics.com + 0.02 * rng.normal(size=3)
        force = 1.0e4 if self.chance(0.5) else 0.0  # infeasible at first
        gain = float(rng.uniform(50.0, 150.0))
        made = [
            kinds.SetSetpoint("com", frozen(position), float(rng.choice([0.0, 0.1]))),
            kinds.SetWeight(task, float(rng.uniform(0.0, 20.0))),
            kinds.EnableTask(task, self.chance(0.7)),
            kinds.EnableContact(contact, self.chance(0.8)),
            kinds.SetExternalWrench(controller.model.base_link, frozen([0.0, 0.0, -force, 0.0, 0.0, 0.0])),
            kinds.SetSlippingContacts((contact,) if self.chance(0.5) else ()),
            kinds.Walk(frozen([0.2, 0.0, 0.1]) if self.chance(0.7) else None),
            ChangeSettings({"tasks": {"com": {"stiffness": gain}}}),
        ]
        if controller.walker is not None:
            steps = kinds.WalkFootsteps(frozen([[0.1, 0.12, 0.0], [0.2, -0.12, 0.0]]))
            made += [kinds.WalkTo(frozen([1.0, 0.5, 0.3])), steps]
        return made[int(rng.integers(len(made)))]


def outputs(controller: ControlCycle, result: object) -> tuple[object, ...]:
    """All values that must be equal bit for bit."""
    command, solution, model_error = result.command, result.solution, controller.model_error
    return (
        result.mode,
        result.fault and (result.fault.code, result.fault.sentence),
        command and (command.tau.tobytes(), command.q_desired.tobytes(), command.v_desired.tobytes()),
        solution and (solution.v_dot.tobytes(), solution.relaxed, solution.iterations),
        result.refused,
        (controller.board.slipping, model_error.unloaded_contacts, model_error.observer.at_bound),
    )


def differences(a: object, b: object) -> list[str]:
    """Names of differing parts of two saved states."""
    texts = to_json(a), to_json(b)
    if texts[0] == texts[1]:
        return []
    a, b = map(from_json, texts)
    if isinstance(a, dict) and isinstance(b, dict) and a.keys() == b.keys():
        return [f"{key}/{each}" if each else str(key) for key in a for each in differences(a[key], b[key])]
    return [] if to_json(a) == to_json(b) else [""]


def classes_with_state() -> set[type]:
    """Classes with `STATE_FIELDS`."""
    found: set[type] = set()
    for module in pkgutil.walk_packages(wbc_controller.__path__, "wbc_controller."):
        if module.name.split(".")[1] in ("safety", "estimation", "inverse_dynamics", "walking", "controller"):
            content = vars(importlib.import_module(module.name)).values()
            found |= {each for each in content if isinstance(each, type) and hasattr(each, "STATE_FIELDS")}
    return found


def objects_with_state(owner: object) -> list[object]:
    """An object and its stateful parts."""
    fields = [getattr(owner, name) for name in type(owner).STATE_FIELDS]
    parts = [part for part in fields if hasattr(type(part), "STATE_FIELDS")]
    return [owner, *(each for part in parts for each in objects_with_state(part))]


def parts_with_state(controller: ControlCycle) -> list[object]:
    owners = (controller.board, controller.supervisor, controller.model_error, controller.walker)
    return [part for owner in owners if owner is not None for part in objects_with_state(owner)]


def shared_arrays(controller: ControlCycle) -> list[str]:
    """Names of writable arrays shared by attributes."""
    arrays = [
        (f"{type(part).__name__}.{name}", getattr(part, name))
        for part in parts_with_state(controller)
        for name in type(part).STATE_FIELDS
        if isinstance(getattr(part, name), np.ndarray)
    ]
    pairs = itertools.permutations(arrays, 2)
    return [name for (name, array), (_, other) in pairs if array.flags.writeable and np.shares_memory(array, other)]


@pytest.mark.parametrize(("case", "seed"), [("plain", 5), ("imu", 3), ("friction", 3), ("levels", 3)])
def test_a_restored_controller_continues_bit_for_bit(robot_of, stance_of, changed, case, seed):
    name, changes = CASES[case]
    settings, model = robot_of(name)
    quick = {"activation_ramp": 0.02, "hold_time": 0.01, "damping_time": 0.05}
    settings = changed(settings, {"safety": quick, **changes})
    original = ControlCycle(settings, model=model, preflight=False)
    run = RandomRun(original, stance_of(name), seed)
    inputs, results, saved = [], [], {}
    for i in range(CYCLES):
        if i % EVERY == 0:
            memory = original.memory()
            saved[i] = original.live.settings, memory, to_json(memory)
            assert not shared_arrays(original)
        inputs.append(run.inputs())
        results.append(outputs(original, original.cycle(inputs[-1])))
    assert {Mode.ACTIVE, Mode.HOLDING, Mode.DAMPING, Mode.FAULT} <= {mode for mode, *_ in results}
    restored = ControlCycle(settings, model=model, preflight=False)
    for i, (live, memory, text) in saved.items():
        assert to_json(memory) == text, "a later cycle changed a saved state"
        if i % (3 * EVERY):  # the others continue after other cycles
            restored = ControlCycle(settings, model=model, preflight=False)
        restored.recall(memory if i % (2 * EVERY) else from_json(text), live)
        assert differences(restored.memory(), from_json(text)) == []
        for k in range(i, min(i + LENGTH, CYCLES)):
            if k in saved and k > i:
                assert differences(restored.memory(), from_json(saved[k][2])) == [], f"saved in cycle {i}, now {k}"
            assert outputs(restored, restored.cycle(inputs[k])) == results[k], f"saved in cycle {i}, now {k}"


def test_every_class_with_a_saved_state_is_part_of_a_controller(robot_of, changed):
    found: set[type] = set()
    for name, changes in CASES.values():
        settings, model = robot_of(name)
        controller = ControlCycle(changed(settings, changes), model=model, preflight=False)
        found |= {type(part) for part in parts_with_state(controller)}
    assert found == classes_with_state()
