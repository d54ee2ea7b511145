"""The cycles of a recording as arrays."""

from __future__ import annotations

import numpy as np

from wbc_controller.recording.cycle_layout import MODES, STAGES
from wbc_controller.recording.recording_file import RecordedCycle, Recording
from wbc_controller.records import Array

#: Columns of ``audit``.
AUDIT_COLUMNS = ("energy", "throughput", "force", "torque", "warnings")


def audited(cycle: RecordedCycle) -> Array:
    """Return the audit of a cycle, (5,), with the columns of `AUDIT_COLUMNS`; NaN without an audit."""
    number, values = cycle.number_of, cycle.values
    force, torque = np.linalg.norm(values["audit/force"]), np.max(np.abs(values["audit/torques"]))
    return np.array([number("audit/energy"), number("audit/throughput"), force, torque, number("audit/warnings")])


def cycle_arrays(recorded: Recording) -> dict[str, Array]:
    """Return the cycles that sent a command, as arrays.

    Returns:
        ``number`` (n,), consecutive unless cycles were dropped; ``stamp`` (n,) in ns; ``tau`` (n, na) in N·m; ``mode``
        (n,); ``seconds/<stage>`` (n,) in s, NaN in cycles without the stage; ``q`` (n, nq); ``v`` (n, nv);
        ``force/<contact>`` (n, k) in N and N·m in the solution, NaN without one; ``disturbance`` (n, nv) in N and N·m;
        ``audit`` (n, 5) with the columns of `AUDIT_COLUMNS`: energy residual and throughput in W, unexplained force in
        N, largest unexplained joint torque in N·m, and number of warnings. Empty if no command was sent.
    """
    rows: dict[str, list[object]] = {}
    for cycle in recorded.cycles():
        if not cycle.number_of("has_command") or np.isnan(cycle.number_of("seconds/total")):  # computed, but not sent
            continue
        values, number = cycle.values, cycle.number_of
        row = {
            "number": int(number("number")),
            "stamp": cycle.stamp,
            "tau": values["tau"],
            "q": values["q"],
            "v": values["v"],
            "disturbance": values["disturbance"],
            **{name: value for name, value in values.items() if name.startswith("force/")},
            "mode": MODES[int(number("mode"))].value,
            "audit": audited(cycle),
            **{f"seconds/{stage}": number(f"seconds/{stage}") for stage in STAGES},
        }
        for name, value in row.items():
            rows.setdefault(name, []).append(value)
    return {name: np.array(values) for name, values in rows.items()}
