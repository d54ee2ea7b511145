"""Kills of processes: the controller or the mock robot is killed, hung up or stopped for a while.

What counts is what arrives for the joints: after the last command, the guard's torques within its bound; no torques
that were computed from an old state; and afterwards everything can go on.
"""

import signal
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wbc_controller.errors import WbcError
from wbc_controller.validation.fuzz import DOMAIN
from wbc_controller.validation.fuzz.robot_processes import RobotProcesses

#: Ways to end or stop a process.
WAYS: Mapping[str, signal.Signals] = {"kill": signal.SIGKILL, "hang up": signal.SIGHUP, "stop": signal.SIGSTOP}
#: Time for which a stopped process stands still, s; drawn so that short and long ones are equally frequent.
_STOPPED = (0.03, 3.0)
#: Moment of the kill after the activation, s.
_MOMENT = (0.3, 1.0)
#: How often the robot is activated for it, at most: where the machine stalls, a fault comes before the kill.
_ATTEMPTS = 10
#: Time after which what was late until now has been seen, s.
_SETTLED = 0.1
#: What a machine that is never late may add to the guard's bound, s.
SLACK = 0.01
#: Time for which the joints are watched after the last event, s.
_WATCH = 0.6


@dataclass(frozen=True, slots=True)
class KillTrial:
    """One kill."""

    victim: str  # `controller` or `mock`
    way: str  # key in `WAYS`
    stopped: float  # time for which the process stood still, s; 0 if it ended
    gap: float  # longest time for which the last torques stayed in force at the joints, s; 0 where they were zero
    bound: float  # that which the guard or the controller allows, s
    # largest age of a state from which torques were computed that came afterwards, s; without the one message that was
    # on its way to the middleware when the process was stopped
    stale: float
    timeout: float  # that which the configuration allows, s
    late: float  # lateness of the machine meanwhile, s
    sentence: str  # state of the controller or of the guard afterwards
    right: bool  # whether it is the right one
    restarted: bool  # whether the robot could be activated again

    @property
    def held(self) -> bool:
        """Whether all held that must hold, beside the lateness of the machine."""
        slack = SLACK + 2.0 * self.late
        fresh = self.stale <= self.timeout + slack
        return self.gap <= self.bound + slack and fresh and self.right and self.restarted


def kill_trials(
    robot: str,
    folder: Path,
    trials: int,
    *,
    domain: int = DOMAIN,
    seed: int = 0,
    progress: Callable[[KillTrial], None] = lambda trial: None,
) -> list[KillTrial]:
    """Kill, hang up and stop the controller and the mock robot at random moments.

    Raises:
        WbcError: if a process does not do what it should.
    """
    rng, done = np.random.default_rng(seed), []
    with RobotProcesses(robot, folder, domain, {"safety.activation_ramp": 0.1, "safety.damping_time": 0.5}) as nodes:
        nodes.start_and_wait("mock", "guard", "controller")
        for _ in range(trials):
            for victim in ("controller", "mock"):
                for way in WAYS:
                    trial = _kill_once(nodes, victim, way, rng)
                    done.append(trial)
                    progress(trial)
    return done


def _kill_once(nodes: RobotProcesses, victim: str, way: str, rng: np.random.Generator) -> KillTrial:
    moment = float(rng.uniform(*_MOMENT))
    stopped = float(np.exp(rng.uniform(*np.log(_STOPPED)))) if way == "stop" else 0.0
    _stand(nodes, moment)
    nodes.lateness.forget()
    process = nodes.processes[victim]
    struck = time.monotonic()
    process.send_signal(WAYS[way])
    if way == "stop":
        time.sleep(stopped)
        process.send_signal(signal.SIGCONT)
    time.sleep(_WATCH)
    gap, stale = _longest_hold(nodes, struck), _stalest(nodes, struck)
    time.sleep(_SETTLED)  # where all stood still just now, the lateness is known only after this
    late, settings = nodes.lateness.worst, nodes.settings
    patience = settings.guard.patience if victim == "controller" else settings.safety.state_timeout
    sentence, right = _sentence(nodes, victim, way, stopped, late, struck)
    return KillTrial(
        victim=victim,
        way=way,
        stopped=stopped,
        gap=gap,
        bound=1.0 / settings.control.rate + patience,
        stale=stale,
        timeout=settings.safety.state_timeout,
        late=late,
        sentence=sentence,
        right=right,
        restarted=_restart(nodes, victim, way),
    )


def _stand(nodes: RobotProcesses, seconds: float) -> None:
    """Let the robot stand for a while: again where the machine was so late meanwhile that the controller damps."""
    for _ in range(_ATTEMPTS):
        nodes.activate()
        nodes.until(lambda: nodes.said("guard") == "watching", "the guard to watch")
        time.sleep(seconds)
        if nodes.said("controller") == "active" and nodes.said("guard") == "watching":
            return
    raise WbcError(f"the machine was too late for the robot to stand for {seconds:.1f} s")


def _longest_hold(nodes: RobotProcesses, since: float) -> float:
    """Longest time for which torques that are not zero stayed as they were at the joints, s."""
    times, torques = nodes.efforts(since - 0.1)
    times = np.append(times, time.monotonic())
    longest, began = 0.0, times[0]
    for i in range(len(torques)):
        if i and (torques[i] != torques[i - 1]).any():
            began = times[i]
        if torques[i].any():
            longest = max(longest, float(times[i + 1] - began))
    return longest


def _stalest(nodes: RobotProcesses, since: float) -> float:
    """Age of the oldest state but one from which a solution came, by the arrival of the state, s.

    Between its last look at the ages and the write, a process can be stopped as anywhere: it sends that one message
    when it goes on.
    """
    states = nodes.heard("mock/joint_states", since - 0.5)
    came = {(content.header.stamp.sec, content.header.stamp.nanosec): when for when, content in states}
    ages = [0.0, 0.0]
    for when, content in nodes.heard("controller/joint_commands", since):
        stamp = content.header.stamp
        solved = np.isfinite(content.position).all()
        if solved and (stamp.sec, stamp.nanosec) in came:
            ages.append(when - came[stamp.sec, stamp.nanosec])
    return sorted(ages)[-2]


def _sentence(
    nodes: RobotProcesses, victim: str, way: str, stopped: float, late: float, since: float
) -> tuple[str, bool]:
    """What the controller or the guard has said since a moment, and whether it says what happened."""
    settings = nodes.settings
    guard = [str(content.data) for _, content in nodes.heard("guard/state", since)]
    took_over = next((said for said in guard if "COMMANDS_STOPPED" in said), "")
    said = nodes.said("controller")
    if victim == "controller":
        if way == "hang up":  # it ends with zeros, and nobody has to take over
            return said, said.startswith("stopped") and nodes.processes[victim].wait(10.0) == 0
        long = stopped == 0.0 or stopped > settings.guard.patience + 1.0 / settings.control.rate + SLACK + 2.0 * late
        back = way == "kill" or stopped < settings.safety.state_timeout or said == "active" or "STALE_INPUT" in said
        return took_over or said, (bool(took_over) or not long) and back
    silent = stopped == 0.0 or stopped > settings.safety.state_timeout + SLACK + 2.0 * late
    return said, "STALE_INPUT: joint_states is" in said or "STALE_INPUT: odom is" in said or not silent


def _restart(nodes: RobotProcesses, victim: str, way: str) -> bool:
    """Start again what has ended; whether the robot can be activated."""
    if way != "stop":
        nodes.stop(victim)
        nodes.forget(victim)
        nodes.start_and_wait(victim)
    nodes.activate()
    nodes.wait_for_torques(time.monotonic())
    return True
