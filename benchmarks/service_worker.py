"""Whole cycle of a supplied robot, from input to output messages, on the code in the folder of the command line.

The controller is that of `wbc run` with audit, status and markers, on the memory transport and in one thread. The
state's message is made before the cycle, and output messages are not decoded. The folder is this repository or another
commit; both contain the test bench that builds the loop. `serving.py` contains the protocol.
"""

import importlib.util
import logging
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from serving import describe, serve, take_code_from

#: Stages in the reports of every commit since d8d35bb.
STAGES = ("read", "compute", "supervise", "write", "audit")
#: Number of cycles for the activation ramp, the bring-up and all first calls.
WARM_UP = 3000


class Service:
    """A controller on the test bench."""

    def __init__(self, scene: dict[str, Any]) -> None:
        spec = importlib.util.spec_from_file_location("conftest", Path(sys.argv[1]) / "test" / "conftest.py")
        if spec is None or spec.loader is None:
            raise FileNotFoundError(f"{sys.argv[1]}: test/conftest.py is missing")
        self._conftest = importlib.util.module_from_spec(spec)
        sys.path.insert(0, str(Path(sys.argv[1]) / "test" / "support"))
        spec.loader.exec_module(self._conftest)
        logging.getLogger("wbc_controller").setLevel(logging.ERROR)
        bench = self._bench = self._conftest.Bench(scene["robot"])
        bench.q = np.array(scene["q"])
        bench.activate()
        bench.cycle(WARM_UP)
        parts = (*STAGES, "status and markers", "processor")
        self.hello = describe("", (0, 0, 0), (0, bench.model.na, 0), parts)

    def cycle(self, q: np.ndarray, v: np.ndarray, reference: np.ndarray) -> np.ndarray:
        """Answer one state.

        Raises:
            SystemExit: if the controller is no longer active.
        """
        del reference
        bench, make, encode = self._bench, self._conftest.MAKE, self._conftest.encode
        bench.clock.time += bench.period
        model, stamp = bench.model, bench.time
        odom = encode(make.odom(pose=q[:7], twist=v[:6], child=model.base_link, time=stamp))
        joints = encode(make.joint_state(model.joints, q[model.q_index], v[model.v_index], time=stamp))
        processor, started = time.process_time(), time.perf_counter()
        bench.send_bytes("odom", odom)
        bench.send_bytes("joint_states", joints)
        report = bench.loop.cycle()
        seconds, processor = time.perf_counter() - started, time.process_time() - processor
        if report.mode.value != "active" or report.command is None:
            raise SystemExit(f"the controller is {report.mode.value}: {report.fault}")
        for payloads in bench._payloads.values():
            payloads.clear()
        bench.reports.clear()
        stages = [report.stage_seconds[stage] for stage in STAGES]
        return np.concatenate([report.command.tau, stages, [seconds - sum(stages), processor, seconds]])


if __name__ == "__main__":
    take_code_from(sys.argv[1])
    serve(Service)
