"""The control loop: inputs, controller, outputs."""

import gc
import logging
import math
import re
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from wbc_controller.controller.controller import Controller
from wbc_controller.controller.report import CycleInputs, CycleReport, LatchedInputs
from wbc_controller.controller.result import CycleResult
from wbc_controller.errors import TransportError
from wbc_controller.inverse_dynamics.references.changes import SetSlippingContacts
from wbc_controller.nodes.clock import Clock
from wbc_controller.nodes.inputs import Inputs
from wbc_controller.nodes.outputs import Outputs
from wbc_controller.nodes.ownership import Ownership
from wbc_controller.nodes.takeover import Takeover
from wbc_controller.records import IN_CONTROL, Array, AuditReport, Fault, Mode
from wbc_controller.safety.bring_up import BringUpWatch
from wbc_controller.safety.checks import stale_inputs
from wbc_controller.safety.model_audit import ModelAudit

_log = logging.getLogger(__name__)

_WARNING_PERIOD = 1.0  # between two equal log messages, s
_MAX_MESSAGES = 20  # log messages in that time
#: Numbers and quoted names of a message, which may change from cycle to cycle.
_FIGURES = re.compile(r"[-+\d.e]*\d[-+\d.e]*|'[^']*'")
_SWITCH_INTERVAL = 5.0e-4  # longest wait of the loop for another thread, s
_RATE_LIMITED = (*IN_CONTROL, Mode.DAMPING)  # modes without zero torques at once
_ROUNDING = 1.0e-6  # of clock times, s
_CANCEL_ACTIVATION = ("damp", "reset")  # requests that cancel an activation in the same cycle


class ControlLoop:
    """Loop of inputs, controller and outputs.

    `timer` measures the stages, and `observers` receive every report. A triggered loop runs one cycle per joint state,
    and per period, s, after they are stale; another one keeps absolute deadlines.
    """

    def __init__(
        self,
        controller: Controller,
        inputs: Inputs,
        outputs: Outputs,
        ownership: Ownership,
        takeover: Takeover,
        clock: Clock,
        *,
        timer: Callable[[], float] = time.perf_counter,
        observers: Sequence[Callable[[CycleReport], None]] = (),
    ) -> None:
        self.controller = controller
        self.observers = tuple(observers)
        self._inputs = inputs
        self.estimator = inputs.estimator  # of the base; None for odometry
        self._outputs = outputs
        self._takeover = takeover
        self._torques_sent: Array | None = None  # (na,) in N·m, if not those of the last result
        settings, model, self.period = controller.config.settings, controller.model, controller.period
        safety = settings.safety
        self._audit = ModelAudit(model, settings.audit, self.period)
        self._bring_up = BringUpWatch(model, safety.bring_up_time, safety.bring_up_speed, self.period)
        self._ownership = ownership
        inputs.shared = lambda: ownership.shared
        self._clock = clock
        self._timer = timer
        self.triggered = settings.control.trigger == "joint_states"
        self._cycle = 0
        self._deadlines_missed = 0
        self._cycle_due = -math.inf  # next `run_due` without a joint state, s
        self._fresh_until = -math.inf  # end of validity of the newest joint states, s
        self._activate_when_fresh = False
        self._logged_contention: tuple[str, ...] = ()
        self._logged: dict[str, float] = {}
        self._logged_mode = controller.mode

    def cycle(self) -> CycleReport:
        """Run one cycle."""
        timer, clock, controller, outputs = self._timer, self._clock, self.controller, self._outputs
        started = timer()
        controlled, walking = controller.mode in IN_CONTROL, controller.is_walking
        latched = self._inputs.latch(controller.holding, controlled=controlled, walking=walking)
        timeout, ages, stall = controller.state_timeout, latched.ages, latched.clock_stall
        now = clock.now()
        self._fresh_until = now + timeout - ages["joint_states"]
        now += stall  # during a stall of the simulated clock, the stamps of the states advance
        clock_fault = clock.clock_fault()
        if clock_fault:
            self._inputs.restart()
        elif not (stall <= timeout):
            clock_fault = self._clock_stall(stall, timeout)
        requests, waiting, before = latched.requests.commands, self._activate_when_fresh, controller.mode
        if "reset" in requests and (before not in IN_CONTROL or "damp" in requests[: requests.index("reset")]):
            self._inputs.restart_estimator()
            ages = self._inputs.ages()
        problem = None if clock_fault else self._inputs.fault(ages, timeout) or self._bring_up.fault
        if not clock_fault and (problem is not None or before not in IN_CONTROL):
            clock_fault = self._coarse_clock(stall, timeout)
        if clock_fault:
            problem = Fault("CLOCK", clock_fault)
        self._ownership.refresh(now)
        refused: tuple[str, ...] = ()
        if requests or self._activate_when_fresh:
            requests, refused = self._filter_requests(requests, problem)
        slips = self._changed_slips() if problem is None and not requests and before in IN_CONTROL else ()
        read, torques_sent = timer() - started, controller.supervisor.torques_sent
        inputs = CycleInputs(
            now=now,
            state=latched.state,
            joint_velocity=latched.joint_velocity if ages["joint_states"] <= timeout else None,
            problem=problem,
            requests=requests,
            changes=latched.requests.changes + slips,
            touching=latched.touching,
            torques_sent=self._torques_sent,
        )
        result = controller.cycle(inputs)
        late = None
        clock.refresh()
        passed = max(0.0, clock.now() - now)
        if result.solution is not None and not max(ages.values()) + passed <= timeout:
            late = stale_inputs(self._inputs.ages(), timeout)
        if late is not None:  # the process was stopped during the cycle: its torques must not be sent
            withdrawn: tuple[str, ...] = ()
            if before not in IN_CONTROL:  # no torques were sent yet
                withdrawn, self._activate_when_fresh = _CANCEL_ACTIVATION, waiting
                refused += (f"command 'activate' is refused: after the computation of the torques, {late.sentence}",)
            inputs = CycleInputs(
                now=now + passed,
                state=latched.state,
                joint_velocity=None,
                problem=late,
                requests=withdrawn,
                torques_sent=torques_sent,
            )
            result = controller.cycle(inputs)
        decided = timer()
        self._torques_sent = None
        if result.command is not None and result.mode in _RATE_LIMITED:
            guard_torques = self._takeover.torques(decided)
            if guard_torques is not None:
                command = controller.supervisor.continue_from(guard_torques, result.command)
                result, self._torques_sent = replace(result, command=command), command.tau
        outputs.publish_command(result)
        sent = timer()
        if result.command is not None:
            self._takeover.record_command(sent, result.command.stamp)
        self._inputs.compare_odometry(controller.holding, controlled=controller.mode in IN_CONTROL)
        controller.explain_failure(now)
        state, qp, audit = result.state, controller.qp, None
        if state is not None:
            # The supervisor of an inactive controller may have refused this state.
            trusted = result.solution if result.mode is Mode.ACTIVE else None
            audit = self._audit.check(state, qp.dynamics, trusted, result.command)
            # Torques do not explain impacts of the feet, and zero torque would drop a walking robot.
            explained = None if controller.is_walking else trusted
            self._bring_up.check(state, qp.dynamics, explained, result.command, qp.contact_jacobian)
        stages = {"read": read, **result.stage_seconds, "write": sent - decided, "total": sent - started}
        stages["audit"] = timer() - sent
        report = self._report(latched, result, stages, refused, audit)
        outputs.publish_report(report, now, clock.stamp())
        if self._logged or report.refused or report.fault is not None or report.mode is not self._logged_mode:
            self._log_changes(report, now)
        for observer in self.observers:
            observer(report)
        self._cycle += 1
        return report

    def _changed_slips(self) -> tuple[tuple[SetSlippingContacts], ...]:
        """Return a change if the estimate has other slipping contacts than the controller."""
        slipping = () if self.estimator is None else self.estimator.slipping
        return () if slipping == self.controller.board.slipping else ((SetSlippingContacts(slipping),),)

    def _clock_stall(self, stall: float, timeout: float) -> str:
        step = self._clock.resolution()
        if stall <= 2.0 * step < math.inf:  # the next clock message may be late
            return _coarse_clock_message(step, timeout, "state_timeout")
        return f"the clock stopped for {1e3 * stall:.0f} ms of the states' time (limit {1e3 * timeout:.0f} ms)"

    def _coarse_clock(self, stall: float, timeout: float) -> str | None:
        step, limit, key = self._clock.resolution(), timeout, "state_timeout"
        tolerance = self._inputs.clock_tolerance  # stamps lead a synchronized clock by up to one step
        if tolerance is not None and tolerance < timeout:
            limit, key = tolerance, "clock_tolerance"
        if math.isinf(step) and stall > 0.0:
            return (
                f"the step of the clock is unknown: only one time was received, and the stamps of the states advanced "
                f"by {1e3 * stall:.0f} ms since then"
            )
        return _coarse_clock_message(step, limit, key) if limit + _ROUNDING < step < math.inf else None

    def _filter_requests(
        self, requests: tuple[str, ...], problem: Fault | None
    ) -> tuple[tuple[str, ...], tuple[str, ...]]:
        if self._activate_when_fresh and any(word != "activate" for word in requests):
            _log.warning("command %r cancels the activation at the start", requests[0])
            self._activate_when_fresh = False
        contested = self._ownership.contested
        if contested:
            if self._activate_when_fresh and contested != self._logged_contention:
                self._logged_contention = contested
                _log.warning("the activation at the start waits: %s", "; ".join(contested))
            sentence = f"command 'activate' is refused: {'; '.join(contested)}"
            return tuple(word for word in requests if word != "activate"), (sentence,) * requests.count("activate")
        if self._activate_when_fresh and problem is None and math.isfinite(self._clock.resolution()):
            self._activate_when_fresh = False
            requests = ("activate", *requests)
        return requests, ()

    def _log_changes(self, report: CycleReport, now: float) -> None:
        self._logged = {topic: at for topic, at in self._logged.items() if 0.0 <= now - at < _WARNING_PERIOD}
        for refused in report.refused:
            self._log(logging.WARNING, f"refused {refused}", now)
        if report.fault is not None:
            message = f"{report.mode.value}: {report.fault.code}: {report.fault.sentence}"
            topic = self._log(logging.WARNING, message, now)
            if topic in self._logged:
                self._logged[topic] = now  # no repetition while it lasts
        elif self._logged_mode is Mode.HOLDING is not report.mode:  # modes may alternate
            self._log(logging.INFO, f"mode: {report.mode.value}", now)
        elif report.mode is not self._logged_mode:
            _log.info("mode: %s", report.mode.value)
        self._logged_mode = report.mode

    def _log(self, level: int, sentence: str, now: float) -> str:
        topic = _FIGURES.sub("#", sentence)[:60]
        if topic not in self._logged and len(self._logged) < _MAX_MESSAGES:
            self._logged[topic] = now
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

    def run(self, stop: threading.Event, *, activate: bool = False) -> None:
        """Run cycles until stopped; `activate` once the inputs are fresh, unless the robot has another owner."""
        self._activate_when_fresh = activate
        switch_interval = sys.getswitchinterval()
        sys.setswitchinterval(_SWITCH_INTERVAL)
        self._inputs.discard_pending()
        self._inputs.requests.start_reader()
        try:
            self._ownership.start(stop)
            self._run(stop)
        finally:
            self._inputs.requests.stop_reader()
            self._ownership.stop()
            sys.setswitchinterval(switch_interval)
            self._shut_down()

    def run_due(self, now: float) -> bool:
        """Run a triggered cycle if due at a simulated time, s; return True if due."""
        if not self._inputs.wait(0.0) and now < self._cycle_due:
            return False
        self._guarded_cycle()
        self._cycle_due = now + self._wait_time()
        return True

    def wake(self) -> None:
        """Interrupt the wait for a joint state, for an immediate stop."""
        self._inputs.wake()

    def _shut_down(self) -> None:
        result = self.controller.shut_down(self._clock.now())
        self._outputs.publish_command(result)
        report = self._report(self._inputs.latch(), result, {})
        self._outputs.publish_report(report, self._clock.now(), self._clock.stamp())
        self._outputs.finish()

    def _run(self, stop: threading.Event) -> None:
        gc.collect()
        gc.freeze()  # shortens later collections
        period = self.period
        deadline = self._clock.now() + period
        while not stop.is_set():
            if self.triggered:
                self._guarded_wait(stop, lambda: self._inputs.wait(self._wait_time()))
                self._guarded_cycle()
                continue
            self._guarded_cycle()
            now = self._clock.now()
            if now > deadline:
                missed = int((now - deadline) / period) + 1
                self._deadlines_missed += missed
                deadline += missed * period  # on the original grid, so that delays do not accumulate
            self._guarded_wait(stop, partial(self._clock.wait, stop, max(deadline - now, 0.0)))
            deadline += period

    def _guarded_wait(self, stop: threading.Event, wait: Callable[[], object]) -> None:
        try:
            wait()
        except TransportError as error:
            self.controller.fail(error)
            stop.wait(self.period)

    def _guarded_cycle(self) -> None:
        try:
            self.cycle()
        except Exception as error:
            self.controller.fail(error)
            self._outputs.publish_zeros()
            supervisor = self.controller.supervisor
            supervisor.torques_sent = np.zeros_like(supervisor.torques_sent)
            self._torques_sent = None

    def _wait_time(self) -> float:
        """Return the longest wait for the next joint state, s: until the last one is stale, then one period."""
        return max(self.period, min(self._fresh_until - self._clock.now(), self.controller.state_timeout))


def _coarse_clock_message(step: float, limit: float, key: str) -> str:
    return (
        f"the clock advances in steps of {1e3 * step:.0f} ms, too coarse for ages up to {1e3 * limit:.0f} ms "
        f"(safety.{key}): publish it at the rate of the states"
    )
