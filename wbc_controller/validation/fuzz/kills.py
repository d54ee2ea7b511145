"""Kills, hang-ups and stops of processes."""

import signal
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wbc_controller.errors import WbcError
from wbc_controller.validation.fuzz.robot_processes import RobotProcesses

#: Signals that end or stop a process.
METHODS: Mapping[str, signal.Signals] = {"kill": signal.SIGKILL, "hang up": signal.SIGHUP, "stop": signal.SIGSTOP}
_STOP_DURATION = (0.03, 3.0)  # s, on a logarithmic scale
_KILL_TIME = (0.3, 1.0)  # after the activation, s
_ATTEMPTS = 10  # per kill; stalls of the machine may cause a fault before
_LATENESS_DELAY = 0.1  # until the lateness of a stall is known, s
SLACK = 0.01  # of the guard's bound, s
_OBSERVATION_TIME = 0.6  # after the last event, s


@dataclass(frozen=True, slots=True)
class KillTrial:
    """One kill."""

    victim: str  # `controller` or `mock`
    method: str  # key in `METHODS`
    stopped: float  # duration of a stop, s; 0 for an end
    gap: float  # longest time of constant nonzero torques, s
    bound: float  # bound from the guard or the controller, s
    stale: float  # largest age of a later state, s, except one in transit
    timeout: float  # largest configured age, s
    late: float  # s
    sentence: str  # later state of the controller or the guard
    state_correct: bool

    @property
    def failed(self) -> bool:
        """True if a requirement is violated, apart from the machine's lateness."""
        slack = SLACK + 2.0 * self.late
        return not (self.gap <= self.bound + slack and self.stale <= self.timeout + slack and self.state_correct)


def kill_trials(robot: str, folder: Path, trials: int, *, domain: int, seed: int = 0) -> Iterator[KillTrial]:
    """Kill, hang up and stop controller and mock robot at random times; raise `WbcError` if no restart succeeds."""
    rng = np.random.default_rng(seed)
    with RobotProcesses(robot, folder, domain, {"safety.activation_ramp": 0.1, "safety.damping_time": 0.5}) as nodes:
        nodes.start_and_wait("mock", "guard", "controller")
        for _ in range(trials):
            for victim in ("controller", "mock"):
                for method in METHODS:
                    yield _kill_once(nodes, victim, method, rng)


def summary(trials: Sequence[KillTrial]) -> Iterator[str]:
    """Yield a line for each process and signal."""
    for victim, method in dict.fromkeys((trial.victim, trial.method) for trial in trials):
        own = [trial for trial in trials if (trial.victim, trial.method) == (victim, method)]
        gaps = sorted(1e3 * trial.gap for trial in own)
        yield (
            f"{victim:10} {method:8} passed {sum(not t.failed for t in own)} of {len(own)}; constant torques for a "
            f"median of {gaps[len(gaps) // 2]:.1f} ms, maximum {gaps[-1]:.1f} (allowed "
            f"{1e3 * own[0].bound:.0f}, lateness of the machine {1e3 * max(t.late for t in own):.0f})"
        )


def _kill_once(nodes: RobotProcesses, victim: str, method: str, rng: np.random.Generator) -> KillTrial:
    moment = float(rng.uniform(*_KILL_TIME))
    stopped = float(np.exp(rng.uniform(*np.log(_STOP_DURATION)))) if method == "stop" else 0.0
    _stand(nodes, moment)
    nodes.lateness.worst = 0.0
    process = nodes.processes[victim]
    killed_at = time.monotonic()
    process.send_signal(METHODS[method])
    if method == "stop":
        time.sleep(stopped)
        process.send_signal(signal.SIGCONT)
    time.sleep(_OBSERVATION_TIME)
    gap, stale = _longest_hold(nodes, killed_at), _stalest(nodes, killed_at)
    time.sleep(_LATENESS_DELAY)  # the lateness after a stall is known only now
    late, settings = nodes.lateness.worst, nodes.settings
    patience = settings.guard.patience if victim == "controller" else settings.safety.state_timeout
    sentence, state_correct = _sentence(nodes, victim, method, stopped, late, killed_at)
    if method != "stop":
        nodes.stop(victim)
        nodes.clear(victim)
        nodes.start_and_wait(victim)
    nodes.activate()
    nodes.wait_for_torques(time.monotonic())
    bound, timeout = 1.0 / settings.control.rate + patience, settings.safety.state_timeout
    return KillTrial(victim, method, stopped, gap, bound, stale, timeout, late, sentence, state_correct)


def _stand(nodes: RobotProcesses, seconds: float) -> None:
    for _ in range(_ATTEMPTS):
        nodes.activate()
        nodes.until(lambda: nodes.state_of("guard") == "watching", "the guard's watching state")
        time.sleep(seconds)
        if nodes.state_of("controller") == "active" and nodes.state_of("guard") == "watching":
            return
    raise WbcError(f"machine too slow: no standing robot for {seconds:.1f} s in {_ATTEMPTS} attempts")


def _longest_hold(nodes: RobotProcesses, since: float) -> float:
    times, torques = nodes.efforts(since - 0.1)
    ends = np.append(times, time.monotonic())[1:]
    changed = np.diff(torques, axis=0, prepend=np.nan).any(axis=1)  # True for the first torques
    began = np.maximum.accumulate(np.where(changed, times, -np.inf))
    return float((ends - began)[torques.any(axis=1)].max(initial=0.0))


def _stalest(nodes: RobotProcesses, since: float) -> float:
    """Return the second largest age of a state with a solution, s; one message may be in transit at a stop."""
    states = nodes.messages_since("mock/joint_states", since - 0.5)
    arrivals = {(content.header.stamp.sec, content.header.stamp.nanosec): when for when, content in states}
    ages = [0.0, 0.0]
    for when, content in nodes.messages_since("controller/joint_commands", since):
        stamp = content.header.stamp
        solved = np.isfinite(content.position).all()
        if solved and (stamp.sec, stamp.nanosec) in arrivals:
            ages.append(when - arrivals[stamp.sec, stamp.nanosec])
    return sorted(ages)[-2]


def _sentence(
    nodes: RobotProcesses, victim: str, method: str, stopped: float, late: float, since: float
) -> tuple[str, bool]:
    settings, timeout = nodes.settings, nodes.settings.safety.state_timeout
    guard = [str(content.data) for _, content in nodes.messages_since("guard/state", since)]
    took_over = next((state for state in guard if "COMMANDS_STOPPED" in state), "")
    state = nodes.state_of("controller")
    if victim == "controller":
        if method == "hang up":  # the process ends with zeros; no takeover is required
            return state, state.startswith("stopped") and nodes.processes[victim].wait(10.0) == 0
        long = stopped == 0.0 or stopped > settings.guard.patience + 1.0 / settings.control.rate + SLACK + 2.0 * late
        back = method == "kill" or stopped < timeout or state == "active" or "STALE_INPUT" in state
        return took_over or state, (bool(took_over) or not long) and back
    silent = stopped == 0.0 or stopped > timeout + SLACK + 2.0 * late
    return state, "STALE_INPUT: joint_states is" in state or "STALE_INPUT: odom is" in state or not silent
