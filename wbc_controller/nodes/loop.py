"""The control loop: in each cycle it latches the inputs, runs the controller and publishes the result."""

from __future__ import annotations

import gc
import logging
import math
import re
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence

from wbc_controller.controller.controller import Controller
from wbc_controller.controller.report import CycleInputs, CycleReport, LatchedInputs
from wbc_controller.controller.result import CycleResult
from wbc_controller.errors import TransportError
from wbc_controller.estimation.base_estimator import BaseEstimator
from wbc_controller.nodes.clock import Clock
from wbc_controller.nodes.inputs import Inputs
from wbc_controller.nodes.outputs import Outputs
from wbc_controller.nodes.ownership import Ownership
from wbc_controller.records import AuditReport, Fault, Mode
from wbc_controller.safety.bring_up import BringUpWatch
from wbc_controller.safety.checks import stale_inputs
from wbc_controller.safety.model_audit import ModelAudit

_log = logging.getLogger(__name__)

#: Time for which a logged sentence is not repeated, s.
_SILENCE = 1.0
#: Largest number of sentences that are logged in that time.
_MOST_SAID = 20
#: Figures and quoted names in a sentence, which may change from cycle to cycle.
_FIGURES = re.compile(r"[-+\d.e]*\d[-+\d.e]*|'[^']*'")
#: Longest time for which the interpreter leaves another thread running while the loop waits for it, s.
_SWITCH_INTERVAL = 5.0e-4
#: Modes in which the torques follow the references, or hold.
_UNDER_CONTROL = (Mode.ACTIVE, Mode.HOLDING)
#: Rounding of the times of a clock, s.
_ROUNDING = 1.0e-6
#: Requests that undo an activation in the same cycle.
_WITHDRAWN = ("damp", "reset")


class ControlLoop:
    """Passes the latched inputs to the controller and its result to the outputs, once per cycle.

    Args:
        ownership: finds other publishers on the topics.
        timer: returns seconds, for the stage times.
        observers: called with the report of every cycle.
    """

    def __init__(
        self,
        controller: Controller,
        inputs: Inputs,
        outputs: Outputs,
        audit: ModelAudit,
        bring_up: BringUpWatch,
        ownership: Ownership,
        clock: Clock,
        *,
        timer: Callable[[], float] = time.perf_counter,
        observers: Sequence[Callable[[CycleReport], None]] = (),
    ) -> None:
        self.controller = controller
        self.observers = tuple(observers)
        self._inputs = inputs
        self._outputs = outputs
        self._audit, self._bring_up = audit, bring_up
        self._ownership = ownership
        inputs.shared = lambda: ownership.shared
        self._clock = clock
        self._timer = timer
        self._cycle = 0
        self._deadlines_missed = 0
        self._due = -math.inf  # when `run_due` waits no longer
        self._fresh_until = -math.inf  # when the newest joint states become stale, s on the clock
        self._activate_when_fresh = False
        self._waits_for: tuple[str, ...] = ()
        self._said: dict[str, float] = {}
        self._mode_said = controller.mode

    @property
    def estimator(self) -> BaseEstimator | None:
        """The estimator of the base; None if its state is measured."""
        return self._inputs.estimator

    def cycle(self) -> CycleReport:
        """Run one cycle."""
        timer, clock, controller, outputs = self._timer, self._clock, self.controller, self._outputs
        started = timer()
        latched = self._inputs.latch(controller.holding, controlled=controller.mode in _UNDER_CONTROL)
        timeout, ages, stall = controller.state_timeout, latched.ages, latched.clock_stall
        now = clock.now()
        self._fresh_until = now + timeout - ages["joint_states"]
        now += stall  # during a stall of the simulated clock, the timestamps of the states count
        trouble = clock.trouble()
        if trouble:
            self._inputs.restart()
        elif not (stall <= timeout):
            trouble = self._clock_stall(stall, timeout)
        requests, waiting, before = latched.requests.commands, self._activate_when_fresh, controller.mode
        if "reset" in requests and self._takes_reset(requests):
            self._inputs.restart_estimate()
            ages = self._inputs.ages()
        problem = Fault("CLOCK", trouble) if trouble else self._inputs.fault(ages, timeout) or self._bring_up.fault
        if not trouble and (problem is not None or before not in _UNDER_CONTROL):
            coarse = self._coarse_clock(stall, timeout)
            problem = Fault("CLOCK", coarse) if coarse else problem
        self._ownership.refresh(now)
        refused: tuple[str, ...] = ()
        if requests or self._activate_when_fresh:
            requests, refused = self._requests(requests, problem)
        read = timer() - started
        given = CycleInputs(
            now=now,
            state=latched.state,
            joint_velocity=latched.joint_velocity if ages["joint_states"] <= timeout else None,
            problem=problem,
            requests=requests,
            changes=latched.requests.changes,
        )
        result = controller.cycle(given)
        late = None
        clock.refresh()
        passed = max(0.0, clock.now() - now)
        if result.solution is not None and not max(ages.values()) + passed <= timeout:
            late = stale_inputs(self._inputs.ages(), timeout)
        if late is not None:  # the process was stopped in mid-cycle: its torques must not be sent
            withdrawn: tuple[str, ...] = ()
            if before not in _UNDER_CONTROL:  # nothing has been sent yet: a refusal is enough
                withdrawn, self._activate_when_fresh = _WITHDRAWN, waiting
                refused += (f"command 'activate' is refused: when the torques were computed, {late.sentence}",)
            again = CycleInputs(
                now=now + passed, state=latched.state, joint_velocity=None, problem=late, requests=withdrawn
            )
            result = controller.cycle(again)
        decided = timer()
        outputs.publish_command(result)
        sent = timer()
        self._inputs.compare_odometry(controller.holding, controlled=controller.mode in _UNDER_CONTROL)
        controller.explain_failure(now)
        state, solution, references = result.state, result.solution, result.references
        audit = None
        if state is not None:
            # While it is not active, the supervisor may have refused the very state.
            trusted = solution if result.mode is Mode.ACTIVE else None
            audit = self._audit.check(state, controller.qp.dynamics, trusted, result.command)
            # Impacts of the feet are not explained by torques, and zero torque would drop a robot that walks.
            walks = controller.walker is not None and controller.walker.moves
            explained = None if walks else trusted
            self._bring_up.check(
                state, controller.qp.dynamics, explained, result.command, controller.qp.contact_jacobian
            )
        stages = {
            "read": read,
            **result.stage_seconds,
            "write": sent - decided,
            "total": sent - started,
            "audit": timer() - sent,
        }
        report = self._report(latched, result, stages, refused, audit)
        outputs.publish_status(report, now, clock.stamp())
        outputs.publish_tasks(now, latched.state, controller.qp.dynamics, references, solution)
        outputs.publish_markers(now, latched.state, references, solution)
        outputs.compose()
        if self._said or report.refused or report.fault is not None or report.mode is not self._mode_said:
            self._say(report, now)
        for observer in self.observers:
            observer(report)
        self._cycle += 1
        return report

    def _clock_stall(self, stall: float, timeout: float) -> str:
        """Return the reason why ages cannot be measured during a stall of the clock: it is too coarse, or has stopped.

        Args:
            stall: advance of the stamps of the states since the clock moved, s.
            timeout: limit of the ages, s.
        """
        step = self._clock.resolution()
        if stall <= 2.0 * step < math.inf:  # its next message may just be late
            return _coarse_sentence(step, timeout, "state_timeout")
        return f"the clock has stood still for {1e3 * stall:.0f} ms of the states' time (limit {1e3 * timeout:.0f} ms)"

    def _coarse_clock(self, stall: float, timeout: float) -> str | None:
        """Return a sentence if the clock's steps are too coarse for ages and stamps, or unknown in a stall; else None.

        Between two times of a synchronized clock, the stamps of the states are ahead of it by up to one step.
        """
        step, limit, key = self._clock.resolution(), timeout, "state_timeout"
        tolerance = self._inputs.clock_tolerance
        if tolerance is not None and tolerance < timeout:
            limit, key = tolerance, "clock_tolerance"
        if math.isinf(step) and stall > 0.0:
            return (
                f"the step of the clock is unknown: it has shown one time only, and the states' stamps have advanced "
                f"by {1e3 * stall:.0f} ms since then"
            )
        return _coarse_sentence(step, limit, key) if limit + _ROUNDING < step < math.inf else None

    def _takes_reset(self, words: tuple[str, ...]) -> bool:
        """Return whether the supervisor accepts the first 'reset' of some requests: it does unless it is in control."""
        return self.controller.mode not in _UNDER_CONTROL or "damp" in words[: words.index("reset")]

    def _requests(self, words: tuple[str, ...], problem: Fault | None) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Return the requests for the controller, and a sentence for each one refused because of another owner."""
        if self._activate_when_fresh and any(word != "activate" for word in words):
            _log.warning("command %r: the activation at the start is cancelled", words[0])
            self._activate_when_fresh = False
        contested = self._ownership.contested
        if contested:
            if self._activate_when_fresh and contested != self._waits_for:
                self._waits_for = contested
                _log.warning("the activation at the start waits: %s", "; ".join(contested))
            sentence = f"command 'activate' is refused: {'; '.join(contested)}"
            return tuple(word for word in words if word != "activate"), (sentence,) * words.count("activate")
        if self._activate_when_fresh and problem is None and math.isfinite(self._clock.resolution()):
            self._activate_when_fresh = False
            words = ("activate", *words)
        return words, ()

    def _say(self, report: CycleReport, now: float) -> None:
        """Log refusals, faults and modes: refusals that recur in every cycle once per second, a fault once."""
        if any(not (0.0 <= now - at < _SILENCE) for at in self._said.values()):
            self._said = {topic: at for topic, at in self._said.items() if 0.0 <= now - at < _SILENCE}
        for refused in report.refused:
            self._log(logging.WARNING, f"refused {refused}", now)
        if report.fault is not None:
            said = f"{report.mode.value}: {report.fault.code}: {report.fault.sentence}"
            topic = self._log(logging.WARNING, said, now)
            if topic in self._said:
                self._said[topic] = now  # silent for as long as it lasts
        elif self._mode_said is Mode.HOLDING is not report.mode:  # it may hold and follow in turn
            self._log(logging.INFO, f"mode: {report.mode.value}", now)
        elif report.mode is not self._mode_said:
            _log.info("mode: %s", report.mode.value)
        self._mode_said = report.mode

    def _log(self, level: int, sentence: str, now: float) -> str:
        """Log a sentence unless its topic has been logged within the last second; returns the topic."""
        topic = _FIGURES.sub("#", sentence)[:60]  # figures may change from cycle to cycle
        if topic not in self._said and len(self._said) < _MOST_SAID:
            self._said[topic] = now
            _log.log(level, "%s", sentence)
        return topic

    def _report(
        self,
        latched: LatchedInputs,
        result: CycleResult,
        stages: Mapping[str, float],
        refused: tuple[str, ...] = (),
        audit: AuditReport | None = None,
    ) -> CycleReport:
        return CycleReport(
            cycle=self._cycle,
            inputs=latched,
            result=result,
            refused=latched.refused + refused + result.refused,
            stage_seconds=stages,
            deadlines_missed=self._deadlines_missed,
            audit=audit,
            contested=self._ownership.contested,
            shared=self._ownership.shared,
        )

    def run(self, stop: threading.Event, period: float, *, triggered: bool, activate: bool = False) -> None:
        """Run cycles until stopped.

        Args:
            period: time between cycles, s.
            triggered: run one cycle for each joint state, and once they are stale one cycle per period; otherwise run
                on absolute deadlines.
            activate: activate as soon as the inputs are fresh and the robot has no other owner, without a command.
        """
        self._activate_when_fresh = activate
        switch_interval = sys.getswitchinterval()
        sys.setswitchinterval(_SWITCH_INTERVAL)
        self._inputs.begin()
        self._inputs.requests.start_reader()
        try:
            self._ownership.start(stop)
            self._run(stop, period, triggered=triggered)
        finally:
            self._inputs.requests.stop_reader()
            self._ownership.stop()
            sys.setswitchinterval(switch_interval)
            self._shut_down()

    def run_due(self, now: float, period: float) -> bool:
        """Run the triggered cycle if one is due, as `run` does, in simulated time.

        Args:
            now: simulated time, s; the loop may use another clock.
            period: time between cycles, s.

        Returns:
            True if a cycle was due.
        """
        if not self._inputs.wait(0.0) and now < self._due:
            return False
        self._guarded_cycle()
        self._due = now + self._patience(period)
        return True

    def wake(self) -> None:
        """Interrupt the wait for a joint state, so that a loop ends at once when its `stop` event is set."""
        self._inputs.wake()

    def _shut_down(self) -> None:
        result = self.controller.shut_down(self._clock.now())
        self._outputs.publish_command(result)
        report = self._report(self._inputs.latch(), result, {})
        self._outputs.publish_status(report, self._clock.now(), self._clock.stamp())
        self._outputs.finish()

    def _run(self, stop: threading.Event, period: float, *, triggered: bool) -> None:
        gc.collect()
        gc.freeze()  # objects from start-up live for the whole run: excluding them keeps later collections short
        deadline = self._clock.now() + period
        while not stop.is_set():
            if triggered:
                self._guarded_wait(stop, period)
                self._guarded_cycle()
                continue
            self._guarded_cycle()
            now = self._clock.now()
            if now > deadline:
                missed = int((now - deadline) / period) + 1
                self._deadlines_missed += missed
                deadline += missed * period  # deadlines stay on their grid, so that lateness does not accumulate
            try:
                self._clock.wait(stop, deadline - now if deadline > now else 0.0)
            except TransportError as error:
                self.controller.fail(error)
                stop.wait(period)
            deadline += period

    def _guarded_wait(self, stop: threading.Event, period: float) -> None:
        """Wait for the next joint state; if the transport fails, the next cycles damp."""
        try:
            self._inputs.wait(self._patience(period))
        except TransportError as error:
            self.controller.fail(error)
            stop.wait(period)

    def _guarded_cycle(self) -> None:
        """Run one cycle; an exception leads to zero torques now, and to damping with a fault."""
        try:
            self.cycle()
        except Exception as error:
            self.controller.fail(error)
            self._outputs.publish_zeros()

    def _patience(self, period: float) -> float:
        """Return the time to wait for the next joint state, s: until the last one is stale, then one period."""
        return max(period, min(self._fresh_until - self._clock.now(), self.controller.state_timeout))


def _coarse_sentence(step: float, limit: float, key: str) -> str:
    """Return a sentence on a clock whose step, s, is above a limit, s, of the settings."""
    return (
        f"the clock moves in steps of {1e3 * step:.0f} ms, too coarse to measure ages up to {1e3 * limit:.0f} ms "
        f"(safety.{key}): publish it at the rate of the states"
    )
