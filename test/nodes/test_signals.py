"""Shutdown on a signal."""

import os
import signal
import subprocess
import sys
import threading

import pytest
from busy import patience
from domains import own_domain
from waiting import until

from wbc_controller.nodes.signals import set_by_signals

#: Main thread that waits for the event in a loop, with a signal at any moment.
WAITING = """
import os, signal, threading, time
from wbc_controller.nodes.signals import set_by_signals
for _ in range(60):
    stop = threading.Event()
    with set_by_signals(stop):
        threading.Timer(0.001, os.kill, (os.getpid(), signal.SIGINT)).start()
        while not stop.wait(0.0):
            pass
"""


#: Command with a child process that is terminated.
STARTED = """
import signal, sys, time
from wbc_controller.nodes.signals import exit_by_signals
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # the tests may run under nohup, which has processes go on
exit_by_signals()
try:
    print("started", flush=True)
    time.sleep(60.0)
finally:
    print("ended what was started", flush=True)
"""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_terminated_command_stops_its_children(number):
    process = subprocess.Popen([sys.executable, "-c", STARTED], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "started\n"
    process.send_signal(number)
    assert process.communicate(timeout=patience(60.0))[0] == "ended what was started\n"
    assert process.returncode == 128 + number


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_sets_the_event_and_the_handlers_come_back(number):
    before = signal.signal(number, signal.default_int_handler)
    try:
        stop = threading.Event()
        with set_by_signals(stop):
            assert not stop.is_set()
            os.kill(os.getpid(), number)
            assert stop.wait(patience(5.0))
        assert signal.getsignal(number) is signal.default_int_handler
    finally:
        signal.signal(number, before)
    assert not [thread for thread in threading.enumerate() if thread.name == "signals"]


def test_a_signal_in_the_midst_of_the_waiting_does_not_hang():
    subprocess.run([sys.executable, "-c", WAITING], timeout=patience(30.0), check=True)


def test_a_process_under_nohup_continues():
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        stop = threading.Event()
        with set_by_signals(stop):
            os.kill(os.getpid(), signal.SIGHUP)
            assert not stop.wait(0.2)
            os.kill(os.getpid(), signal.SIGTERM)
            assert stop.wait(patience(5.0))
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)


@pytest.mark.live
def test_the_end_of_the_terminal_ends_each_process_and_the_controller_with_zero_torques(tmp_path):
    from wbc_controller.validation.fuzz.robot_processes import RobotProcesses

    changes = {"safety.state_timeout": 0.5, "guard.patience": 0.4, "mock.command_timeout": 1.0}  # for a busy computer
    with RobotProcesses("go2", tmp_path, own_domain(), changes) as processes:
        for name, *options in (("mock",), ("guard",), ("controller", "--activate")):
            processes.start(name, *options)
        processes.wait_for_torques(since=0.0)
        until(lambda: len(processes.messages["controller/effort"]) > 50 and processes.state_of("guard") == "watching")
        for name in ("controller", "guard", "mock"):
            assert processes.stop(name, signal.SIGHUP) == 0
            if name == "controller":
                until(lambda: not processes.newest("controller/joint_commands").effort.any(), patience=5.0)
            assert "Traceback" not in processes.log(name)
        assert not processes.newest("controller/effort").data.any()
