"""The loop: read, decide, write. One way through, once per cycle."""

from __future__ import annotations

import dataclasses
import gc
import logging
import math
import threading
import time
from collections.abc import Callable, Sequence

from wbc_controller.control.controller import Controller
from wbc_controller.control.result import CycleResult
from wbc_controller.diagnostics.audit import ModelAudit
from wbc_controller.records import CycleReport, Fault, RobotState
from wbc_controller.safety.checks import stale_inputs
from wbc_controller.service.clock import Clock
from wbc_controller.service.inputs import Inputs, Latched
from wbc_controller.service.outputs import Outputs

_log = logging.getLogger(__name__)

#: Time for which a sentence that was logged is not logged again, s.
_SILENCE = 1.0


class ControlLoop:
    """Owns the ends of a cycle, and hands what comes in to the controller and its answer to what goes out.

    Attributes:
        controller: decides.
        observers: called with the report of every cycle.
    """

    def __init__(
        self,
        controller: Controller,
        inputs: Inputs,
        outputs: Outputs,
        audit: ModelAudit,
        clock: Clock,
        *,
        timer: Callable[[], float] = time.perf_counter,
        observers: Sequence[Callable[[CycleReport], None]] = (),
    ) -> None:
        """Make a loop.

        Args:
            controller: decides.
            inputs: what comes in.
            outputs: what goes out.
            audit: compares the model with the motion.
            clock: measures ages and durations.
            timer: gives seconds, for the stage times.
            observers: called with the report of every cycle.
        """
        self.controller = controller
        self.observers = tuple(observers)
        self._inputs = inputs
        self._outputs = outputs
        self._audit = audit
        self._clock = clock
        self._timer = timer
        self._cycle = 0
        self._deadlines_missed = 0
        self._activate_when_fresh = False
        self._said: dict[str, float] = {}

    def cycle(self) -> CycleReport:
        """Run one cycle."""
        started = self._timer()
        now = self._clock.now()
        latched = self._inputs.latch()
        timeout = self.controller.state_timeout
        trouble = self._clock.trouble()
        problem = Fault("CLOCK", trouble) if trouble else None
        problem = problem or stale_inputs(latched.ages, timeout, latched.notes)
        requests = latched.commands
        if self._activate_when_fresh and problem is None:
            self._activate_when_fresh = False
            requests = ("activate", *requests)
        fresh = latched.ages["joint_states"] <= timeout
        stages = {"read": self._timer() - started}
        result = self.controller.cycle(
            now,
            latched.state,
            latched.joint_velocity if fresh else None,
            problem=problem,
            requests=requests,
            changes=latched.changes,
        )
        stages |= result.stage_seconds
        decided = self._timer()
        report = self._report(latched, result, stages)
        self._outputs.publish_command(report)
        stages["write"] = self._timer() - decided
        stages["total"] = self._timer() - started
        self.controller.explain_failure(now)
        report = self._audited(report, latched.state)
        stages["audit"] = self._timer() - started - stages["total"]
        self._outputs.publish_status(report, now, self._clock.stamp())
        self._outputs.publish_markers(now, latched.state, result.references, result.solution)
        self._say(report, now)
        for observer in self.observers:
            observer(report)
        self._cycle += 1
        return report

    def _say(self, report: CycleReport, now: float) -> None:
        """Log what was refused and why a mode was left; of what recurs in every cycle, one line per second."""
        sentences = [f"refused {sentence}" for sentence in report.refused]
        if report.fault is not None:
            sentences.append(f"{report.mode.value}: {report.fault.code}: {report.fault.sentence}")
        for sentence in sentences:
            topic = sentence[:60]  # the rest may hold figures that change from cycle to cycle
            if not (now - self._said.get(topic, -math.inf) < _SILENCE):
                self._said[topic] = now
                _log.warning("%s", sentence)

    def _audited(self, report: CycleReport, state: RobotState | None) -> CycleReport:
        """Hold the motion against the model, when the robot has its torques already."""
        if state is None:
            return report
        audit = self._audit.look(state, self.controller.qp.dynamics, report.solution, report.command)
        return dataclasses.replace(report, audit=audit)

    def _report(self, latched: Latched, result: CycleResult, stages: dict[str, float]) -> CycleReport:
        return CycleReport(
            cycle=self._cycle,
            stamp=latched.state.stamp if latched.state is not None else 0,
            mode=result.mode,
            fault=result.fault,
            command=result.command,
            solution=result.solution,
            ages=latched.ages,
            refused=(*latched.refused, *result.refused),
            stage_seconds=stages,
            deadlines_missed=self._deadlines_missed,
        )

    def run(self, stop: threading.Event, period: float, *, triggered: bool, activate: bool = False) -> None:
        """Run cycles until stopped.

        Args:
            stop: ends the loop.
            period: time between cycles, s.
            triggered: run one cycle for each joint state, and at the period where none come; otherwise run on absolute
                deadlines.
            activate: activate as soon as the inputs are fresh, without a command.
        """
        self._activate_when_fresh = activate
        try:
            self._run(stop, period, triggered=triggered)
        finally:
            self._shut_down()

    def wake(self) -> None:
        """End the waiting for a joint state, so that a loop that was told to stop does so at once."""
        self._inputs.arrived.set()

    def _shut_down(self) -> None:
        report = self._report(self._inputs.latch(), self.controller.shut_down(self._clock.now()), {})
        self._outputs.publish_command(report)
        self._outputs.publish_status(report, self._clock.now(), self._clock.stamp())

    def _run(self, stop: threading.Event, period: float, *, triggered: bool) -> None:
        gc.collect()
        gc.freeze()  # what was built at start-up is never garbage: collections in mid-run stay short
        deadline = self._clock.now() + period
        while not stop.is_set():
            if triggered:
                self._inputs.arrived.wait(self._patience(period))
                self._inputs.arrived.clear()
                self.cycle()
                continue
            self.cycle()
            now = self._clock.now()
            if now > deadline:
                missed = int((now - deadline) / period) + 1
                self._deadlines_missed += missed
                deadline += missed * period  # stay on the grid: lateness does not add up
            self._clock.wait(stop, deadline - now if deadline > now else 0.0)
            deadline += period

    def _patience(self, period: float) -> float:
        """How long to wait for a joint state: until the last one is stale, then one period at a time."""
        timeout = self.controller.state_timeout
        return max(period, min(timeout - self._inputs.age_of_joint_states(), timeout))
