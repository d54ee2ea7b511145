"""Our worker: `Cycle` on the code in the folder of the command line.

`serving.py` contains the protocol. The folder is this repository or another commit.
"""

import dataclasses
import sys
import time
from typing import Any

import numpy as np
from serving import describe, serve, take_code_from


class Ours:
    """Controller and supervisor; each state has its references."""

    def __init__(self, scene: dict[str, Any]) -> None:
        from our_cycle import Cycle, make_model, parse_settings  # from the chosen code

        settings = parse_settings(scene["settings"], "the comparison's settings")
        self.model = make_model(settings)
        if list(self.model.pinocchio.names)[2:] != scene["joints"]:
            raise ValueError(f"joints {list(self.model.pinocchio.names)[2:]}, expected {scene['joints']}")
        q, v = np.array(scene["q"]), np.zeros(self.model.nv)
        trial = Cycle(settings, self.model)
        rest = trial.start(q)
        trial.step(trial.state(q, v), rest)
        problem = trial.controller.formulation.build(trial.state(q, v), rest).problem
        self._stages = list(trial.solution.stage_seconds) if trial.solution is not None else []
        self.contacts = list(trial.controller.contacts)
        forces = sum(contact.size for contact in trial.controller.contacts.values())
        counts = problem.n, len(problem.b), len(problem.upper)
        self.hello = describe("", counts, (self.model.nv, self.model.na, forces), (*self._stages, "supervise"))
        self._cycle = Cycle(settings, self.model)
        self._references = self._cycle.start(q)

    def cycle(self, q: np.ndarray, v: np.ndarray, reference: np.ndarray) -> np.ndarray:
        """Answer one state."""
        cycle = self._cycle
        com = dataclasses.replace(
            self._references.tasks["com"],
            position=_fixed(reference[:3]),
            velocity=_fixed(reference[3:6]),
            acceleration=_fixed(reference[6:]),
        )
        references = dataclasses.replace(self._references, tasks={**self._references.tasks, "com": com})
        state = cycle.state(q, v)
        failures = cycle.failures
        started = time.perf_counter()
        command = cycle.answer(state, references)
        seconds = time.perf_counter() - started
        cycle.active(command)
        solution = cycle.solution
        if solution is None or cycle.failures > failures:
            return np.full(sum(self.hello["sizes"]) + len(self._stages) + 2, np.nan)
        parts = [solution.stage_seconds[stage] for stage in self._stages]
        forces = [solution.forces[name] for name in self.contacts]
        return np.concatenate([solution.v_dot, solution.tau, *forces, parts, [seconds - sum(parts), seconds]])


def _fixed(values: np.ndarray) -> np.ndarray:
    copy = values.copy()
    copy.setflags(write=False)
    return copy


if __name__ == "__main__":
    take_code_from(sys.argv[1])
    serve(Ours)
