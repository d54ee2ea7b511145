"""Plausibility of single samples."""

import math

import numpy as np

from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.records import Array, Fault
from wbc_controller.safety import plausibility_kernels as kernels
from wbc_controller.safety.plausibility import AXES, joint_speed_limits, wrap_hint
from wbc_controller.settings.service import SafetySettings

#: Setting of the position tolerance, by setting of the speed.
_MISMATCH = {
    "max_joint_speed": "joint_mismatch", "max_base_speed": "base_mismatch", "max_base_turn": "base_turn_mismatch",
}  # fmt: skip
#: Velocity change by an impact, as a share of the largest velocity; a joint may bounce off its stop.
_JOINT_STEP, _BASE_STEP = 1.5, 0.25
SEQUENCE = 3  # number of consecutive rejections that is a fault


class SampleCheck:
    """Comparison of each sample with the last accepted one."""

    def __init__(self, names: tuple[str, ...], keys: tuple[str, ...], memory: kernels.SampleMemory) -> None:
        """Start a check; `names` and `keys` (settings of the speeds) appear in messages, (n,)."""
        self.rejected = self.in_row = 0
        self.reason = ""
        self._names, self._keys, self._memory = names, keys, memory
        self._stamp = 0

    @classmethod
    def of_joints(cls, model: RobotModel, settings: SafetySettings, *, measured: bool) -> "SampleCheck":
        """Return the check of joint states; `measured` is False for computed velocities."""
        n, fastest = model.nj, joint_speed_limits(model, settings.max_joint_speed)
        memory = _memory(n, settings, fastest, np.full(n, settings.joint_mismatch), _JOINT_STEP, measured)
        return cls(tuple(f"joint {name!r}" for name in model.joints), ("max_joint_speed",) * n, memory)

    @classmethod
    def of_base(cls, settings: SafetySettings) -> "SampleCheck":
        """Return the check of odometry."""
        fastest = np.repeat([settings.max_base_speed, settings.max_base_turn], 3)
        tolerance = np.repeat([settings.base_mismatch, settings.base_turn_mismatch], 3)
        memory = _memory(7, settings, fastest, tolerance, _BASE_STEP, measured=True)
        return cls(AXES, ("max_base_speed",) * 3 + ("max_base_turn",) * 3, memory)

    def check(self, stamp: int, position: Array, velocity: Array) -> str:
        """Return the reason to reject a sample, or ""; stamp in ns; velocities are empty if not measured."""
        elapsed = 1.0e-9 * (stamp - self._stamp) if self._stamp else math.nan
        found = kernels.compare_sample(self._memory, position, velocity, elapsed)
        if found < 0:
            self._stamp, self.in_row = stamp, 0
            return ""
        self.rejected += 1
        self.in_row += 1
        self.reason = self._sentence(*divmod(found, 1000), position, velocity, elapsed)
        return self.reason

    def restart(self) -> None:
        """Accept any next sample."""
        self._stamp = self.in_row = 0

    def fault(self, topic: str) -> Fault | None:
        """Return the fault of consecutive rejections, or None."""
        if self.in_row < SEQUENCE:
            return None
        return Fault("IMPLAUSIBLE_STATE", f"{topic}: {self.in_row} consecutive messages rejected: {self.reason}")

    def _sentence(self, kind: int, i: int, position: Array, velocity: Array, elapsed: float) -> str:
        memory, name = self._memory, self._names[i] if i < len(self._names) else "the base's orientation"
        if kind == kernels.SAMPLE_LARGE:
            limit = f"limit {memory.magnitude:g} rad or m, safety.max_magnitude"
            return f"{name} is at {position[i]:.3g} ({limit})"
        unit = "m/s" if self._keys[i] == "max_base_speed" else "rad/s"
        if kind == kernels.SAMPLE_FAST:
            key = f"limit {memory.fastest[i]:.3g}, safety.{self._keys[i]}"
            return f"{name} has the velocity {velocity[i]:.3g} {unit} ({key})"
        since = f"within {1e3 * elapsed:.3g} ms"
        if kind != kernels.SAMPLE_JUMP:
            before = memory.velocity[i]
            return f"the velocity of {name} changes from {before:.3g} to {velocity[i]:.3g} {unit} {since}"
        change = float(memory.change[i])
        hint = "" if memory.floating else wrap_hint(change)
        limit = f"limit {memory.tolerance[i]:.3g}, safety.{_MISMATCH[self._keys[i]]}"
        jump = f"{change:.3g} {unit.removesuffix('/s')} {since}"
        return f"{name} jumps by {jump}, inconsistent with its velocity ({limit}){hint}"


def _memory(
    size: int, settings: SafetySettings, fastest: Array, tolerance: Array, velocity_step: float, measured: bool
) -> kernels.SampleMemory:
    n = len(fastest)
    return kernels.SampleMemory(
        floating=size != n,
        measured=measured,
        magnitude=settings.max_magnitude,
        fastest=fastest,
        velocity_step=velocity_step * fastest,
        tolerance=tolerance,
        position=np.zeros(size),
        velocity=np.zeros(n),
        change=np.zeros(n),
    )
