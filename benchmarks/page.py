"""Measure cycle times with and without the page, its drawing rate, and the growth of its memory.

A mock robot, whose simulated time waits for a late controller, sways on its controller, which records every cycle.
Browsers without a screen open `wbc view`, which is halted in every other block. The browsers use idle processor time
only, as if on another computer. Run: python benchmarks/page.py [ROBOT] [--minutes M] [--browsers N] [--scheduling fifo]
"""

import argparse
import contextlib
import os
import re
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "test/support"))

from browser import Browser

from wbc_controller.apps.page.page_service import free_domain
from wbc_controller.apps.terminal.request_parser import parse_request
from wbc_controller.apps.terminal.session import Session
from wbc_controller.middleware.stamps import time_of
from wbc_controller.nodes.processes import Processes, memory, processor_time
from wbc_controller.recording.recording_file import Recording

#: Duration of a block, s, and its unmeasured beginning. The page disconnects a browser after 3 s of silence.
BLOCK, SETTLE = 2.0, 0.3
#: Loading time of the meshes, s.
LOADING = 10.0
#: Sway requests, one per block in turn.
SWAY = [["com", "20mm", side] for side in ("right", "left", "left", "right")]
PATIENCE = 120.0
#: Scheduling class of the browsers: idle processor time only, as if they were on another computer.
BROWSERS = os.SCHED_IDLE
#: Settings that keep the robot in motion.
CHANGES = {"tasks.com.setpoint_duration": BLOCK}


def measure(robot: str, minutes: float, count: int, scheduling: str, folder: Path) -> list[tuple[str, np.ndarray]]:
    """Run the blocks, print the results of the page, and return the cycle times, s, by kind of block."""
    os.environ |= {"ROS_DOMAIN_ID": str(free_domain()), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    changes = CHANGES | {"control.realtime.scheduling": scheduling}
    recording = folder / "page.mcap"
    windows: dict[str, list[tuple[int, int]]] = {"without": [], "with": []}
    rates: list[float] = []
    with (
        contextlib.closing(
            Processes(robot, folder, int(os.environ["ROS_DOMAIN_ID"]), changes, own_sessions=True)
        ) as processes,
        Session(processes.settings, patience=PATIENCE) as session,
    ):
        processes.start("mock", "--patient")
        processes.start("controller", "--activate", "--use-sim-time", "--record", str(recording))
        session.listen("controller", "state")
        session.listen("mock", "clock")
        session.until(lambda: session.mode().startswith("active"), "the controller did not become active", PATIENCE)
        time.sleep(processes.settings.safety.activation_ramp)
        session.execute(parse_request(["release"], processes.settings))
        command = [sys.executable, "-u", "-m", "wbc_controller", "view", str(processes.configuration), "--port", "0"]
        view = processes.launch("view", command)
        processes.until(lambda: "page: " in processes.log("view"), "the page", patience=PATIENCE)
        port = int(re.search(r"page: http://[^:]+:(\d+)", processes.log("view"))[1])
        with scheduling_class(BROWSERS):
            browsers = [Browser(port) for _ in range(count)]
        time.sleep(LOADING)
        first, used = memory(view.pid), processor_time(view.pid)
        for block in range(round(60.0 * minutes / BLOCK)):
            kind = "with" if block % 2 else "without"
            view.send_signal(signal.SIGCONT if kind == "with" else signal.SIGSTOP)
            session.execute(parse_request(SWAY[block % len(SWAY)], processes.settings))
            time.sleep(SETTLE)
            before, began, begin = [Counter(each.moved) for each in browsers], time.monotonic(), simulated_time(session)
            time.sleep(BLOCK - SETTLE)
            seconds = time.monotonic() - began
            windows[kind].append((begin, simulated_time(session)))
            if kind == "with":
                rates += [
                    max((each.moved - old).values(), default=0) / seconds
                    for each, old in zip(browsers, before, strict=True)
                ]
        view.send_signal(signal.SIGCONT)
        last, used = memory(view.pid), processor_time(view.pid) - used
        mode = session.mode()
        if mode != "active":
            raise SystemExit(f"the robot did not stand until the end: {mode}")
        for each in browsers:
            each.close()
    print(f"{robot}, {minutes:g} min, {count} browsers, scheduling class of the loop: {scheduling}")
    slow = np.quantile(rates, 0.05)
    print(f"drawn states per second: median {np.median(rates):.1f}, at least {slow:.1f} in 95 % of the blocks")
    print(f"memory of the page: {first / 1024:.1f} MB at the start, {last / 1024:.1f} MB at the end")
    print(f"processor time of the page: {100.0 * used / (30.0 * minutes):.0f} % of one processor")
    return loop_times(recording, windows)


@contextlib.contextmanager
def scheduling_class(number: int) -> Iterator[None]:
    """Run in a scheduling class without priorities, which threads started meanwhile inherit."""
    before = os.sched_getscheduler(0)
    os.sched_setscheduler(0, number, os.sched_param(0))
    try:
        yield
    finally:
        os.sched_setscheduler(0, before, os.sched_param(0))


def simulated_time(session: Session) -> int:
    """Return the newest simulated time, ns."""
    return time_of(session.newest("mock", "clock").clock, "clock")


def loop_times(recording: Path, windows: dict[str, list[tuple[int, int]]]) -> list[tuple[str, np.ndarray]]:
    """Return the cycle times within the windows, s."""
    cycles = [(each.time, each.scalar("seconds/total")) for each in Recording(recording).cycles()]
    times, seconds = (np.array(column) for column in zip(*cycles, strict=True))
    found = []
    for kind, spans in windows.items():
        inside = np.zeros(len(times), dtype=bool)
        for begin, end in spans:
            inside |= (times >= begin) & (times < end)
        found.append((kind, seconds[inside & np.isfinite(seconds)]))
    return found


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robot", nargs="?", default="g1")
    parser.add_argument("--minutes", type=float, default=10.0, help="total duration, half of it with the page")
    parser.add_argument("--browsers", type=int, default=3, help="number of open pages")
    parser.add_argument("--scheduling", default="other", help="control.realtime.scheduling of the controller")
    parser.add_argument("--keep", type=Path, help="folder of the recording and logs; by default deleted")
    words = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="wbc_page_") as folder:
        found = measure(words.robot, words.minutes, words.browsers, words.scheduling, words.keep or Path(folder))
    print(f"\n{'the loop, us':14}{'cycles':>9}{'median':>9}{'p99':>9}{'p99.9':>9}")
    for kind, seconds in found:
        print(
            f"{kind:14}{len(seconds):9}" + "".join(f"{1e6 * np.quantile(seconds, q):9.0f}" for q in (0.5, 0.99, 0.999))
        )


if __name__ == "__main__":
    main()
