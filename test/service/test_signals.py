"""Ending on a signal."""

import os
import signal
import subprocess
import sys
import threading

import pytest

from wbc_controller.service.signals import set_by_signals

#: Main thread that waits for the event again and again, as loops with a period do; a signal at any moment of it.
WAITING = """
import os, signal, threading, time
from wbc_controller.service.signals import set_by_signals
for _ in range(60):
    stop = threading.Event()
    with set_by_signals(stop):
        threading.Timer(0.001, os.kill, (os.getpid(), signal.SIGINT)).start()
        while not stop.wait(0.0):
            pass
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_sets_the_event_and_the_handlers_come_back(number):
    before = signal.getsignal(number)
    stop = threading.Event()
    with set_by_signals(stop):
        assert not stop.is_set()
        os.kill(os.getpid(), number)
        assert stop.wait(5.0)
    assert signal.getsignal(number) is before
    assert not [thread for thread in threading.enumerate() if thread.name == "signals"]


def test_a_signal_in_the_midst_of_the_waiting_does_not_hang():
    subprocess.run([sys.executable, "-c", WAITING], timeout=30, check=True)
