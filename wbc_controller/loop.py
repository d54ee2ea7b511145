"""The loop: read, decide, write. One way through, once per cycle."""

from __future__ import annotations

import dataclasses
import gc
import logging
import math
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor

from wbc_controller.clock import Clock
from wbc_controller.core.controller import Controller
from wbc_controller.core.references import Change, ReferenceBoard
from wbc_controller.diagnostics.audit import ModelAudit
from wbc_controller.errors import ConfigurationError, InputRefused, NoSolution
from wbc_controller.inputs import Inputs, Latched
from wbc_controller.outputs import Outputs
from wbc_controller.records import CycleReport, Fault, JointCommand, Mode, References, RobotState, Solution
from wbc_controller.safety.checks import stale_inputs
from wbc_controller.safety.supervisor import Supervisor
from wbc_controller.tuner import ChangeSettings, Tuner

_log = logging.getLogger(__name__)

#: Least time between two explanations of why there is no solution, s: each takes several periods.
_EXPLAIN_PAUSE = 1.0
#: Time for which a sentence that was logged is not logged again, s.
_SILENCE = 1.0


class ControlLoop:
    """Owns the stages of a cycle and calls them in order.

    Attributes:
        supervisor: the safety supervisor.
        tuner: takes changes of the settings.
        observers: called with the report of every cycle.
    """

    def __init__(
        self,
        controller: Controller,
        board: ReferenceBoard,
        supervisor: Supervisor,
        inputs: Inputs,
        outputs: Outputs,
        audit: ModelAudit,
        tuner: Tuner,
        clock: Clock,
        *,
        timer: Callable[[], float] = time.perf_counter,
        observers: Sequence[Callable[[CycleReport], None]] = (),
    ) -> None:
        """Make a loop.

        Args:
            controller: solves the quadratic program.
            board: what the commands have set.
            supervisor: makes the commands.
            inputs: what comes in.
            outputs: what goes out.
            audit: compares the model with the motion.
            tuner: takes changes of the settings.
            clock: measures ages and durations.
            timer: gives seconds, for the stage times.
            observers: called with the report of every cycle.
        """
        self.supervisor = supervisor
        self.tuner = tuner
        self.observers = tuple(observers)
        self._controller = controller
        self._board = board
        self._inputs = inputs
        self._outputs = outputs
        self._audit = audit
        self._clock = clock
        self._live = tuner.newest
        self._timer = timer
        self._cycle = 0
        self._deadlines_missed = 0
        self._activate_when_fresh = False
        self._said: dict[str, float] = {}
        self._references: References | None = None  # of the present cycle, where it is solved
        self._explained = -math.inf
        # It takes several periods to explain a failure: another thread does, and the commands go on.
        self._explaining = ThreadPoolExecutor(max_workers=1, thread_name_prefix="explain")
        self._explanation: Future[NoSolution] | None = None

    def cycle(self) -> CycleReport:
        """Run one cycle."""
        started = self._timer()
        now = self._clock.now()
        latched = self._inputs.latch()
        refused = list(latched.refused)
        trouble = self._clock.trouble()
        problem = Fault("CLOCK", trouble) if trouble else None
        problem = problem or stale_inputs(latched.ages, self._live.state_timeout, latched.notes)
        read = self._timer()
        starts = self._take_requests(latched, now, problem, refused)
        changes = self._take_settings(latched, refused)
        outcome = self._references = None
        if problem is None and self.supervisor.solving:
            outcome = self._compute(latched.state, changes, now, starts, refused)
        computed = self._timer()
        was_active = self.supervisor.mode is Mode.ACTIVE
        fresh = latched.ages["joint_states"] <= self._live.state_timeout
        command = self.supervisor.step(now, latched.state, latched.joint_velocity if fresh else None, problem, outcome)
        if changes and outcome is None:
            mode = self.supervisor.mode
            words = "'activate'" if mode is Mode.INACTIVE else "'reset' and 'activate'"
            refused.append(
                f"{len(changes)} task or contact commands: the controller is {mode.value}; send {words} first"
            )
        self._take_explanation()
        supervised = self._timer()
        solution = outcome if isinstance(outcome, Solution) else None
        stages = {"read": read - started, "compute": computed - read, "supervise": supervised - computed}
        if solution is not None:
            stages |= {f"compute/{name}": seconds for name, seconds in solution.stage_seconds.items()}
        report = self._report(latched, command, solution, refused, stages)
        self._outputs.publish_command(report)
        stages["write"] = self._timer() - supervised
        stages["total"] = self._timer() - started
        if isinstance(outcome, NoSolution) and was_active:
            self._explain(outcome, now)
        report = self._audited(report, latched.state)
        stages["audit"] = self._timer() - started - stages["total"]
        self._outputs.publish_status(report, now, self._clock.stamp())
        self._outputs.publish_markers(now, latched.state, self._references, solution)
        self._say(report, now)
        for observer in self.observers:
            observer(report)
        self._cycle += 1
        return report

    def _explain(self, failure: NoSolution, now: float) -> None:
        """Begin to find out which constraints conflict, when the robot has its torques already."""
        # Once per failure: while holding, the sentence of its first cycle stays in force.
        if self._explanation is None and now - self._explained >= _EXPLAIN_PAUSE:
            self._explained = now
            self._explanation = self._explaining.submit(failure.explained)

    def _take_explanation(self) -> None:
        """Say which constraints conflict, when that has been found out."""
        if self._explanation is None or not self._explanation.done():
            return
        explanation, self._explanation = self._explanation, None
        try:
            failure = explanation.result()
        except Exception:
            _log.exception("why there was no solution could not be found out")
            return
        self.supervisor.explain(failure)
        _log.warning("NO_SOLUTION: %s", failure)

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
        audit = self._audit.look(state, self._controller.dynamics, report.solution, report.command)
        return dataclasses.replace(report, audit=audit)

    def _report(
        self,
        latched: Latched,
        command: JointCommand | None,
        solution: Solution | None,
        refused: list[str],
        stages: dict[str, float],
    ) -> CycleReport:
        return CycleReport(
            cycle=self._cycle,
            stamp=latched.state.stamp if latched.state is not None else 0,
            mode=self.supervisor.mode,
            fault=self.supervisor.fault,
            command=command,
            solution=solution,
            ages=latched.ages,
            refused=tuple(refused),
            stage_seconds=stages,
            deadlines_missed=self._deadlines_missed,
        )

    def _take_requests(self, latched: Latched, now: float, problem: Fault | None, refused: list[str]) -> bool:
        """Hand the requests to the supervisor; say whether the controller starts from the present state."""
        starts = False
        words = latched.commands
        if self._activate_when_fresh and problem is None:
            self._activate_when_fresh = False
            words = ("activate", *words)
        for word in words:
            try:
                starts = self.supervisor.request(word, now, problem) or starts
            except InputRefused as refusal:
                refused.append(str(refusal))
                continue
            _log.info("command %r: now %s", word, self.supervisor.mode.value)
        return starts

    def _take_settings(self, latched: Latched, refused: list[str]) -> list[tuple[Change, ...]]:
        """Go over to changed settings; give the changes of references that are left to be applied."""
        left = []
        for changes in latched.changes:
            references = tuple(change for change in changes if not isinstance(change, ChangeSettings))
            if not references or self.supervisor.solving:  # all or nothing: references need an active controller
                try:
                    for change in changes:
                        if isinstance(change, ChangeSettings):
                            self.tuner.accept(change.settings, "update")
                except ConfigurationError as error:
                    refused.append(str(error))
                    continue
            if references:
                left.append(references)
        live = self.tuner.newest
        if live is not self._live:
            followed = self.supervisor.solving and latched.state is not None
            time = seconds(latched.state) if followed and latched.state is not None else None
            self._board.replan(live.board, self._controller.dynamics, time)
            self.supervisor.limits = live.supervisor
            self._live = live
        return left

    def _compute(
        self,
        state: RobotState | None,
        changes: Sequence[tuple[Change, ...]],
        now: float,
        starts: bool,
        refused: list[str],
    ) -> Solution | NoSolution | Fault:
        if state is None:
            return Fault("NO_STATE", "no state has arrived")
        try:
            if starts:
                self._controller.dynamics.update(state.q, state.v)
                self._board.reset(self._controller.dynamics, seconds(state))
            for each in changes:
                try:
                    self._board.apply(each, self._controller.dynamics, seconds(state))
                except InputRefused as refusal:
                    refused.append(str(refusal))
            references = self._references = self._board.sample(seconds(state))
            before = self.supervisor.torques_before(now)
            return self._controller.solve(state, references, before, False)
        except NoSolution as failure:
            return failure
        except Exception as error:
            # A defect must end in damping with a reason, never in a process that dies with torques applied.
            _log.exception("the controller failed")
            return Fault("INTERNAL_ERROR", f"{type(error).__name__}: {error}")

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
        command = self.supervisor.shut_down(self._clock.now())
        report = self._report(self._inputs.latch(), command, None, [], {})
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
        timeout = self._live.state_timeout
        return max(period, min(timeout - self._inputs.age_of_joint_states(), timeout))


def seconds(state: RobotState) -> float:
    """Time of a state on the clock of the states, s."""
    return state.stamp * 1.0e-9
