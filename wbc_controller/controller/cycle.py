"""Control cycle: requests, changes, quadratic program, supervisor."""

import logging
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from wbc_controller.controller.build.estimation import make_model_error
from wbc_controller.controller.build.program import make_qp
from wbc_controller.controller.build.robot import make_model
from wbc_controller.controller.build.safety import make_supervisor_limits
from wbc_controller.controller.build.walking import make_walker
from wbc_controller.controller.check.preflight import check_qp
from wbc_controller.controller.explanation import FailureExplanation
from wbc_controller.controller.live_settings import LiveSettings
from wbc_controller.controller.memory import CycleRecord, restore_state, save_state
from wbc_controller.controller.report import CycleInputs
from wbc_controller.controller.result import CycleResult
from wbc_controller.controller.walker_commands import command_walker, prepare_gait
from wbc_controller.errors import ConfigurationError, InputRefused, MethodError, NoSolution
from wbc_controller.inverse_dynamics.contacts import Contact
from wbc_controller.inverse_dynamics.limits import RowLimit
from wbc_controller.inverse_dynamics.references.board import ReferenceBoard
from wbc_controller.inverse_dynamics.references.changes import Change, WalkingChange
from wbc_controller.inverse_dynamics.robot.model import RobotModel
from wbc_controller.inverse_dynamics.tasks import Task
from wbc_controller.records import ChangeSettings, Fault, Mode, Reference, References, RobotState, Solution
from wbc_controller.safety.supervisor import Supervisor
from wbc_controller.settings import Settings
from wbc_controller.settings.config import Config, load
from wbc_controller.walking.walker import Walker

_log = logging.getLogger(__name__)


class ControlCycle:
    """References, quadratic program and supervisor of one robot, called once per period.

    Attributes:
        model: of the robot.
        dynamics: of the last cycle; at first in the nominal posture with the base at 0.
        tasks: by name.
        contacts: by name.
        limits: row limits by kind: ``self_collision`` and the user's limits.
        period: configured, 1 / ``control.rate``, s.
        walker: step planner, or None without a section ``walking``.
        holding: loaded contacts of the last cycle; without a solution the ones enabled at activation.
    """

    def __init__(
        self,
        config: Config | Settings | Mapping[str, Any] | str | Path,
        *,
        tasks: Iterable[Callable[[RobotModel], Task]] = (),
        contacts: Iterable[Callable[[RobotModel], Contact]] = (),
        limits: Iterable[Callable[[RobotModel], RowLimit]] = (),
        preflight: bool = True,
        model: RobotModel | None = None,
        timer: Callable[[], float] = time.perf_counter,
    ) -> None:
        """Build all objects.

        Args:
            config: a configuration, or an argument of `load`.
            tasks: classes or functions that return a user's `Task` for the model; its attributes apply.
            contacts: the same for a `Contact`.
            limits: the same for a `RowLimit`.
            preflight: check that the robot can stand.
            model: by default from the configuration.
            timer: clock of the stage times, s.

        Raises:
            ConfigurationError: if the configuration is invalid, or a method of a user object fails.
        """
        self.config = load(config)
        settings = self.config.settings
        try:
            model = make_model(settings, self.config.urdf) if model is None else model
            self.qp = make_qp(settings, model, timer, tasks=tasks, contacts=contacts, limits=limits)
            self.model_error = make_model_error(settings, model, self.qp.contacts)
            self.live = LiveSettings(settings, self.qp)  # current settings
            if preflight:
                check_qp(settings, self.qp, ReferenceBoard(self.live.newest.board))
        except ConfigurationError as error:
            raise ConfigurationError(self.config.with_source(str(error))) from error
        qp = self.qp
        self.model, self.dynamics = model, qp.dynamics
        self.tasks, self.contacts = qp.tasks, qp.contacts
        self.limits: Mapping[str, RowLimit] = {limit.kind: limit for limit in qp.formulation.row_limits}
        self.period = qp.formulation.period
        self._live = self.live.newest
        self.board = ReferenceBoard(self._live.board)
        self.supervisor = Supervisor(model, make_supervisor_limits(settings, model))
        self.walker = make_walker(settings, self.qp)
        if self.walker is not None:
            prepare_gait(self.walker, self.qp, self._live.board)
        self._command_timeout = 0.0 if settings.walking is None else settings.walking.command_timeout
        self.holding = self._enabled_contacts()
        self._timer = timer
        self._commands: list[Change] = []  # applied in the next cycle
        self._streamed: dict[str, Reference] = {}  # streamed references of the next cycle
        self._explanation = FailureExplanation()
        self._defect: Fault | None = None  # outside the cycle
        self.cycle_records: list[CycleRecord] | None = None  # for a recorder, which empties the list
        self._solution: Solution | None = None
        self._changed_outside = False  # state changed between two cycles

    @property
    def mode(self) -> Mode:
        """Mode of the supervisor."""
        return self.supervisor.mode

    @property
    def fault(self) -> Fault | None:
        """Latched fault, or None."""
        return self.supervisor.fault

    @property
    def is_walking(self) -> bool:
        """True while the controller is active and the robot walks or is about to."""
        return self.supervisor.solving and self.walker is not None and self.walker.moves

    @property
    def state_timeout(self) -> float:
        """Largest age of a state, s."""
        return self._live.settings.safety.state_timeout

    def cycle(self, inputs: CycleInputs) -> CycleResult:
        """Run one cycle: requests, changes, quadratic program, supervisor."""
        started = self._timer()
        now, state, problem = inputs.now, inputs.state, inputs.problem or self._defect
        self._defect = None
        refused: list[str] = []
        supervisor = self.supervisor
        if inputs.torques_sent is not None:
            supervisor.torques_sent = inputs.torques_sent
        starts = self._handle_requests(inputs.requests, now, problem, refused) if inputs.requests else False
        remaining: list[tuple[Change, ...]] = []
        if inputs.changes or self.live.newest is not self._live:
            try:
                remaining = self._accept_changes(inputs.changes, state, refused)
            except Exception as error:
                problem = _defect(error)
        outcome: Solution | NoSolution | Fault | None = None
        references: References | None = None
        if problem is None and supervisor.solving:
            outcome, references = self._compute(inputs, remaining, starts, refused)
        computed = self._timer()
        was_active = supervisor.mode is Mode.ACTIVE
        command = supervisor.step(now, state, inputs.joint_velocity, problem, outcome)
        solution = outcome if isinstance(outcome, Solution) else None
        if state is not None and not self.model_error.is_idle:
            whole = command is not None and supervisor.torques_before(now) is not None
            tau = command.tau if command is not None and whole else None
            self.model_error.record_command(state, solution, tau, self.qp.dynamics, self.qp.contact_jacobian)
        if remaining and outcome is None:
            mode, words = self.mode.value, "'activate'" if self.mode is Mode.INACTIVE else "'reset' and 'activate'"
            refused.append(f"{len(remaining)} task or contact commands: the controller is {mode}; send {words} first")
        if references is not None and supervisor.solving:
            unloaded = self.model_error.unloaded_contacts
            self.holding = tuple(name for name, on in references.contacts.items() if on > 0.0 and name not in unloaded)
        else:
            self.holding = self._enabled_contacts()
        self._explanation.failure = outcome if isinstance(outcome, NoSolution) and was_active else None
        explained = self._explanation.take()
        if explained is not None:
            supervisor.explain(explained)
            _log.warning("NO_SOLUTION: %s", explained)
        stages = {"compute": computed - started, "supervise": self._timer() - computed}
        if solution is not None:
            stages |= {f"compute/{stage}": duration for stage, duration in solution.stage_seconds.items()}
        result = CycleResult(
            qp=self.qp,
            time=now,
            mode=supervisor.mode,
            fault=supervisor.fault,
            command=command,
            solution=solution,
            state=state,
            references=references,
            refused=tuple(refused),
            stage_seconds=stages,
        )
        if self.cycle_records is not None:
            given = inputs if problem is inputs.problem else replace(inputs, problem=problem)
            self.cycle_records.append(
                CycleRecord(inputs=given, live=self._live, result=result, changed_outside=self._changed_outside)
            )
            self._changed_outside = False
        return result

    def memory(self) -> dict[str, Any]:
        """Return the state between cycles, by part; ``qp`` is None if the solver's warm start is not accessible."""
        self._update_contact_forces()
        return {
            "walker": None if self.walker is None else save_state(self.walker),
            "qp": self.qp.memory(),
            "board": save_state(self.board),
            "supervisor": save_state(self.supervisor),
            "model_error": save_state(self.model_error),
        }

    def recall(self, memory: Mapping[str, Any], settings: Settings) -> None:
        """Restore the result of `memory` of a controller with the same configuration, and its settings."""
        self.live.replace_all(settings)
        self._live = self.live.newest
        self.board, self._solution = ReferenceBoard(self._live.board), None
        self.supervisor = Supervisor(self.model, self.supervisor.limits)
        restore_state(self.board, memory["board"])
        restore_state(self.supervisor, memory["supervisor"])
        self.model_error.observer.limits = self._live.disturbance
        restore_state(self.model_error, memory["model_error"])
        if self.walker is not None:
            restore_state(self.walker, memory["walker"])
        if memory["qp"] is not None:
            self.qp.recall(memory["qp"])

    def _enabled_contacts(self) -> tuple[str, ...]:
        return tuple(name for name, contact in self._live.board.contacts.items() if contact.enabled)

    def fail(self, error: Exception) -> None:
        """Damp from the next cycle on, after an error outside the cycle."""
        self._changed_outside = True
        self._defect = _defect(error)

    def shut_down(self, now: float) -> CycleResult:
        """Return a last result with zero torque; `now` in s."""
        self._changed_outside = True
        command = self.supervisor.shut_down(now)
        return CycleResult(qp=self.qp, time=now, mode=self.mode, fault=self.fault, command=command)

    def explain_failure(self, now: float) -> None:
        """Search conflicting constraints on a thread after the first failure; a later cycle reports them."""
        self._explanation.begin(now)

    def _handle_requests(self, requests: Sequence[str], now: float, problem: Fault | None, refused: list[str]) -> bool:
        """Pass requests to the supervisor; return True if the controller starts from the present state."""
        starts = False
        for i, word in enumerate(requests):
            if "estop" in requests[:i]:  # zero torque must be sent before the torques stop
                refused.append(f"command {word!r} is refused in the cycle of an emergency stop; send it again")
                continue
            try:
                starts = self._request(word, now, problem) or starts
                _log.info("command %r accepted", word)
            except InputRefused as refusal:
                refused.append(str(refusal))
        return starts

    def _request(self, word: str, now: float, problem: Fault | None) -> bool:
        if word == "deactivate" and self.walker is not None and self.walker.moves and self.supervisor.solving:
            self.walker.leave()
            return False
        return self.supervisor.request(word, now, problem)

    def _accept_changes(
        self, changes: Iterable[Sequence[Change | ChangeSettings]], state: RobotState | None, refused: list[str]
    ) -> list[tuple[Change, ...]]:
        remaining = []
        for each in changes:
            references = tuple(change for change in each if not isinstance(change, ChangeSettings))
            if not references or self.supervisor.solving:  # references require an active controller
                try:
                    for change in each:
                        if isinstance(change, ChangeSettings):
                            self.live.accept(change.settings, "update")
                except ConfigurationError as error:
                    refused.append(str(error))
                    continue
            if references:
                remaining.append(references)
        if state is not None and self.live.newest is not self._live and self.supervisor.solving:
            self.qp.formulation.prepare(state)  # for anchors of contacts
        self._apply_live_settings(seconds(state) if state is not None else None)
        return remaining

    def _update_contact_forces(self) -> None:
        """Pass the contact forces of the last solution to the board, for the ramps of contacts."""
        if self._solution is not None:
            self.board.forces = self._solution.forces

    def _apply_live_settings(self, time: float | None) -> None:
        newest = self.live.newest
        if newest is not self._live:
            self._update_contact_forces()
            self.board.replan(newest.board, self.qp.dynamics, time if self.supervisor.solving else None)
            self.model_error.observer.limits = newest.disturbance
            self._live = newest

    def _compute(
        self, inputs: CycleInputs, changes: Iterable[tuple[Change, ...]], starts: bool, refused: list[str]
    ) -> tuple[Solution | NoSolution | Fault, References | None]:
        """Apply sets of changes, sample the references, and solve; `starts`: the controller starts from this state."""
        state, references = inputs.state, None
        if state is None:
            return Fault("NO_STATE", "no state received"), None
        try:
            if starts:
                self._start(state)
            elif changes or self.board.slipping or self.is_walking:
                self.qp.formulation.prepare(state)  # anchors and steps begin at the present state
            if changes:
                self._update_contact_forces()
            for each in changes:
                try:
                    self._apply(each, seconds(state))
                except InputRefused as refusal:
                    refused.append(str(refusal))
            self.board.anchor_slipping_contacts(self.qp.dynamics)
            walker = self.walker
            steps = self._walk(walker, inputs, seconds(state)) if walker is not None and walker.moves else {}
            references = self.board.sample(seconds(state))
            if steps or self._streamed:
                references = replace(references, tasks={**references.tasks, **steps, **self._streamed})
                self._streamed = {}
            if not self.model_error.is_idle:
                references = self._add_disturbance(state, references, refused)
            self._solution = self.qp.solve(state, references, self.supervisor.torques_before(inputs.now), False)
            if walker is not None:
                if not walker.moves and walker.fall_prediction.is_due(seconds(state)):
                    active = [name for name, activation in references.contacts.items() if activation > 0.0]
                    walker.watch_standing(seconds(state), self.qp.dynamics, active)
                if walker.fall_prediction.sentence:
                    return Fault("FALLING", walker.fall_prediction.sentence), references
            return self._solution, references
        except NoSolution as failure:
            return failure, references
        except Exception as error:
            return _defect(error), references

    def _start(self, state: RobotState) -> None:
        self.qp.dynamics.update(state.q, state.v)
        self.board.reset(self.qp.dynamics, seconds(state))
        self._solution = None
        self.model_error.restart()
        if self.walker is not None:
            self.walker.reset()

    def _apply(self, changes: Sequence[Change], time: float) -> None:
        """Apply a set of changes of references, all or none, or raise `InputRefused`."""
        for change in changes:  # first: the board refuses no change of a set with a walking command
            if isinstance(change, WalkingChange):
                command_walker(self.walker, change, self.qp.dynamics, time + self._command_timeout)
        self.board.apply([each for each in changes if not isinstance(each, WalkingChange)], self.qp.dynamics, time)

    def _walk(self, walker: Walker, inputs: CycleInputs, time: float) -> Mapping[str, Reference]:
        """Update the walker at the time of the state, s; return the references of its tasks."""
        board, dynamics = self.board, self.qp.dynamics
        orientations = {name: board.present(name, time).position for name in walker.tasks.orientations}
        decision = walker.update(time, dynamics, orientations, inputs.touching)
        if decision.changes:
            self._update_contact_forces()
        board.apply(decision.changes, dynamics, time)
        if walker.leaving and not walker.moves:
            walker.leaving = False
            self.supervisor.request("deactivate", inputs.now, None)
        return decision.references

    def _add_disturbance(self, state: RobotState, references: References, refused: list[str]) -> References:
        unloaded = self.model_error.unloaded_contacts
        disturbance = self.model_error.update(state)
        if self.model_error.unloaded_contacts is not unloaded:
            refused += [
                f"contact {name!r} is unloaded according to the robot's motion: excluded from the base estimate"
                for name in self.model_error.unloaded_contacts
                if name not in unloaded
            ]
        return replace(references, disturbance=disturbance)


def _defect(error: Exception) -> Fault:
    """Convert an exception to a fault, so that the robot is damped."""
    _log.exception("the controller failed")
    if isinstance(error, MethodError):
        return Fault("METHOD_FAILED", str(error))
    return Fault("INTERNAL_ERROR", f"{type(error).__name__}: {error}")


def seconds(state: RobotState) -> float:
    """Return the timestamp of a state, s."""
    return state.stamp * 1.0e-9
