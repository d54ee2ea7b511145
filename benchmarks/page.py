"""What the page costs the loop, how fast it draws, and whether its memory grows: with it and without it, in turn.

A mock robot sways on its controller, which records every cycle. Browsers without a screen look at `wbc view`,
which is halted in every other block. They get the time that nobody else wants, as if they were on another computer.
Run: python benchmarks/page.py [ROBOT] [--minutes M] [--browsers N] [--scheduling fifo]
"""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import signal
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "test/support"))

from browser import Browser

from wbc_controller.apps.page.play import free_domain
from wbc_controller.apps.terminal.request_parser import parse_request
from wbc_controller.apps.terminal.session import Session
from wbc_controller.nodes.processes import Processes, memory, processor_time, until
from wbc_controller.recording.recording_file import Recording

#: Duration of a block, s, and what of its beginning is not looked at. The page drops a browser that is silent for 3 s.
BLOCK, SETTLE = 2.0, 0.3
#: Time for all meshes to come, s.
LOADING = 10.0
#: Words that the robot sways by, one per block in turn: with the page and without it to both sides.
SWAY = [["com", "20mm", side] for side in ("right", "left", "left", "right")]
PATIENCE = 120.0
#: A robot that is late is measured too, and moves for all of a block: the page sends what moves.
CHANGES = {"safety.state_timeout": 1.0, "mock.command_timeout": 1.0, "tasks.com.setpoint_duration": BLOCK}


def measure(robot: str, minutes: float, count: int, scheduling: str, folder: Path) -> list[tuple[str, np.ndarray]]:
    """Run the blocks, print what the page did, and give the times of the loop's cycles in s, by kind of block."""
    os.environ |= {"ROS_DOMAIN_ID": str(free_domain()), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    changes = CHANGES | {"control.realtime.scheduling": scheduling}
    recording = folder / "page.mcap"
    windows: dict[str, list[tuple[int, int]]] = {"without": [], "with": []}
    drawn: list[float] = []
    with (
        contextlib.closing(
            Processes(robot, folder, int(os.environ["ROS_DOMAIN_ID"]), changes, own_sessions=True)
        ) as processes,
        Session(processes.settings, patience=PATIENCE) as session,
    ):
        processes.start("mock")
        processes.start("controller", "--activate", "--record", str(recording))
        session.listen("controller", "state")
        session.until(lambda: session.mode().startswith("active"), "the controller is not active", PATIENCE)
        time.sleep(processes.settings.safety.activation_ramp)
        session.execute(parse_request(["release"], processes.settings))
        command = [sys.executable, "-u", "-m", "wbc_controller", "view", str(processes.configuration), "--port", "0"]
        view = processes.launch("view", command)
        until(lambda: "page: " in processes.log("view"), "the page", patience=PATIENCE)
        port = int(re.search(r"page: http://[^:]+:(\d+)", processes.log("view"))[1])
        # Of this thread, which gives it to those that it starts: each browser's.
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
        browsers = [Browser(port) for _ in range(count)]
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        time.sleep(LOADING)
        first, used = memory(view.pid), processor_time(view.pid)
        for block in range(round(60.0 * minutes / BLOCK)):
            kind = "with" if block % 2 else "without"
            view.send_signal(signal.SIGCONT if kind == "with" else signal.SIGSTOP)
            session.execute(parse_request(SWAY[block % len(SWAY)], processes.settings))
            time.sleep(SETTLE)
            before, begin = [Counter(each.moved) for each in browsers], time.time_ns()
            time.sleep(BLOCK - SETTLE)
            end = time.time_ns()
            windows[kind].append((begin, end))
            if kind == "with":
                seconds = 1e-9 * (end - begin)
                drawn += [
                    max((each.moved - old).values(), default=0) / seconds
                    for each, old in zip(browsers, before, strict=True)
                ]
        view.send_signal(signal.SIGCONT)
        last, used = memory(view.pid), processor_time(view.pid) - used
        mode = session.mode()
        if mode != "active":
            raise SystemExit(f"the robot has not stood to the end: {mode}")
        for each in browsers:
            each.close()
    print(f"{robot}, {minutes:g} min, {count} browsers, the loop's scheduling class: {scheduling}")
    slow = np.quantile(drawn, 0.05)
    print(f"states drawn per second: {np.median(drawn):.1f} in the median, {slow:.1f} or more in 95 % of the blocks")
    print(f"the page's process: {first / 1024:.1f} MB at the beginning, {last / 1024:.1f} MB at the end")
    print(f"it used {100.0 * used / (30.0 * minutes):.0f} % of one processor")
    return loop_times(recording, windows)


def loop_times(recording: Path, windows: dict[str, list[tuple[int, int]]]) -> list[tuple[str, np.ndarray]]:
    """The times of the cycles within the windows, s."""
    cycles = [(each.time, each.number_of("seconds/total")) for each in Recording(recording).cycles()]
    times, seconds = (np.array(column) for column in zip(*cycles, strict=True))
    found = []
    for kind, spans in windows.items():
        inside = np.zeros(len(times), dtype=bool)
        for begin, end in spans:
            inside |= (times >= begin) & (times < end)
        found.append((kind, seconds[inside & np.isfinite(seconds)]))
    return found


def main() -> None:
    """Measure, and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robot", nargs="?", default="g1")
    parser.add_argument("--minutes", type=float, default=10.0, help="duration, half of it with the page")
    parser.add_argument("--browsers", type=int, default=3, help="number of pages that are open")
    parser.add_argument("--scheduling", default="other", help="control.realtime.scheduling of the controller")
    parser.add_argument("--keep", type=Path, help="folder for the recording and the logs; removed where none is given")
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
