"""Memory and times of processes from /proc, and waiting for a condition."""

import mmap
import os
import signal
import subprocess
import sys
import time
from contextlib import closing

import pytest
from busy import patience
from waiting import has_ended, until

from wbc_controller.errors import WbcError
from wbc_controller.nodes.processes import Processes, memory, processor_time, waiting_times


def test_processor_time_and_memory_are_those_of_the_process():
    before, began = processor_time(os.getpid()), time.process_time()
    while time.process_time() - began < 0.2:
        pass
    assert processor_time(os.getpid()) - before == pytest.approx(0.2, abs=0.05)
    before = processor_time(os.getpid())
    time.sleep(0.3)
    assert processor_time(os.getpid()) - before <= 0.1
    before = memory(os.getpid())
    with mmap.mmap(-1, 200_000_000) as reserved:
        assert memory(os.getpid()) - before < 20_000
        reserved[:50_000_000] = b"x" * 50_000_000
        assert 40_000 < memory(os.getpid()) - before < 120_000  # written configuration, and its source


def test_two_busy_processes_on_one_processor_wait_for_it():
    one = min(os.sched_getaffinity(0))
    command = [sys.executable, "-c", f"import os\nos.sched_setaffinity(0, {{{one}}})\nwhile True: pass"]
    busy = [subprocess.Popen(command) for _ in range(2)]
    try:
        until(lambda: all(max(waiting_times(process.pid).values()) > 0.05 for process in busy), "both to wait")
    finally:
        for process in busy:
            process.kill()
            process.wait()


def test_a_timeout_has_the_condition_and_details(tmp_path):
    asked, processes = [], Processes("go2", tmp_path, 0)
    processes.details = lambda: "; it said 'ebb'"
    with pytest.raises(WbcError, match=r"timeout of 0\.05 s while waiting for the tide; it said 'ebb'"):
        processes.until(lambda: False, "the tide", lambda: asked.append(1), 0.05)
    assert asked == [1]


def test_an_ended_process_ends_the_wait(tmp_path):
    processes = Processes("go2", tmp_path, 0)
    processes.launch("sleeper", [sys.executable, "-c", "print('no bed'); exit(2)"]).wait()
    with pytest.raises(WbcError, match=r"^the sleeper ended with exit status 2:\nno bed$"):
        processes.until(lambda: False, "the morning", lambda: pytest.fail("it was asked"))


@pytest.mark.parametrize(("own_sessions", "stopped"), [(False, False), (True, True)])
def test_processes_end_with_their_killed_parent(tmp_path, own_sessions, stopped):
    script = (
        "import sys, time, pathlib\n"
        "from wbc_controller.nodes.processes import Processes\n"
        f"processes = Processes('go2', pathlib.Path(sys.argv[1]), 0, own_sessions={own_sessions})\n"
        "started = processes.launch('sleeper', [sys.executable, '-c', 'import time; time.sleep(60)'])\n"
        "print(started.pid, flush=True)\n"
        "time.sleep(60)\n"
    )
    parent = subprocess.Popen([sys.executable, "-c", script, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    child = int(parent.stdout.readline())
    assert (os.getsid(child) == child) is own_sessions
    if stopped:
        os.kill(child, signal.SIGSTOP)
    parent.kill()
    parent.wait()
    until(lambda: has_ended(child), "the process to end", patience=5.0)


def test_a_process_hears_a_hang_up_also_under_nohup(tmp_path):
    ours = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    processes = Processes("go2", tmp_path, 0)
    try:
        process = processes.launch("sleeper", [sys.executable, "-c", "import time; time.sleep(60)"])
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
        process.send_signal(signal.SIGHUP)
        assert process.wait(patience(30.0)) == -signal.SIGHUP
    finally:
        signal.signal(signal.SIGHUP, ours)
        processes.close()


@pytest.mark.parametrize(
    ("mode", "sent"), [("inactive", ["activate"]), ("", ["reset", "activate"]), ("fault ESTOP", ["reset", "activate"])]
)
def test_the_activation_resets_faults(tmp_path, mode, sent):
    modes, words = [mode], []

    def send(word):
        words.append(word)
        if word == "activate":
            modes.append("active")

    with closing(Processes("go2", tmp_path, 0)) as processes:
        processes.until_active(lambda: modes[-1], send)
    assert words == sent
