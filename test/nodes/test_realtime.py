"""Real time: system calls, refusals, and real effects if permitted."""

import contextlib
import errno
import os
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest
from pages import page
from refusals import refusal

if not sys.platform.startswith("linux"):
    pytest.skip("scheduling is Linux's", allow_module_level=True)

import resource

from wbc_controller.errors import ConfigurationError
from wbc_controller.middleware.transports.memory import MemoryBus, MemoryTransport
from wbc_controller.nodes import realtime
from wbc_controller.nodes.controller_service import run_controller
from wbc_controller.nodes.realtime import apply_realtime, describe_scheduling, lower_thread_priority
from wbc_controller.settings.config import load
from wbc_controller.settings.service import RealtimeSettings

THERE = sorted(os.sched_getaffinity(0))
ONE = THERE[-1]
NOWHERE = 1000


@pytest.fixture
def restored():
    """Restore the scheduling of all threads of this process."""
    processors, kind, priority = os.sched_getaffinity(0), os.sched_getscheduler(0), os.sched_getparam(0)
    yield
    for thread in realtime._threads():
        with contextlib.suppress(ProcessLookupError):  # it has ended
            os.sched_setaffinity(thread, processors)
            os.sched_setscheduler(thread, kind, priority)


@pytest.fixture
def calls(monkeypatch):
    """Record the system calls without executing them."""
    asked = []
    for name in ("sched_setaffinity", "sched_setscheduler"):
        monkeypatch.setattr(os, name, lambda *words, name=name: asked.append((name, *words)))
    monkeypatch.setattr(realtime, "_mlockall", lambda flags: asked.append(("mlockall", flags)) or 0)
    monkeypatch.setattr(realtime, "_locked_memory_limit", lambda: None)
    return asked


@pytest.fixture
def other_thread():
    """Another thread of this process, in which functions run."""
    with ThreadPoolExecutor(1) as pool:
        yield lambda function: pool.submit(function).result()


def scheduling_of_a_new_thread():
    """Return affinity and class of a thread that the calling thread starts."""
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(lambda: (os.sched_getaffinity(0), os.sched_getscheduler(0))).result()


def test_no_system_calls_by_default(calls, monkeypatch):
    apply_realtime(load("go2").settings.control.realtime)
    assert calls == []
    monkeypatch.delattr(os, "sched_setscheduler")
    apply_realtime(RealtimeSettings())


def test_every_thread_gets_the_class_and_the_priority_and_all_memory_is_locked(calls, other_thread):
    other = other_thread(threading.get_native_id)
    apply_realtime(RealtimeSettings(scheduling="rr", priority=17))
    assert {name for name, *_ in calls} == {"sched_setscheduler"}
    assert {thread for _, thread, _, _ in calls} >= {os.getpid(), other}
    assert {(kind, parameter.sched_priority) for _, _, kind, parameter in calls} == {(os.SCHED_RR, 17)}
    calls.clear()
    apply_realtime(RealtimeSettings(lock_memory=True))
    assert calls == [("mlockall", 3)]  # MCL_CURRENT | MCL_FUTURE


def test_a_thread_that_has_ended_meanwhile_is_passed_over(monkeypatch):
    asked = []

    def schedule(thread, kind, parameter):
        asked.append(thread)
        if thread == 7:
            raise ProcessLookupError(errno.ESRCH, "No such process")

    monkeypatch.setattr(os, "sched_setscheduler", schedule)
    monkeypatch.setattr(realtime, "_threads", lambda: [5, 7, 9])
    apply_realtime(RealtimeSettings(scheduling="fifo"))
    assert asked == [5, 7, 9]


@pytest.fixture
def waking(monkeypatch, tmp_path):
    """A file instead of the device."""
    file, opened = tmp_path / "cpu_dma_latency", []
    file.touch()
    monkeypatch.setattr(realtime, "_LATENCY_DEVICE", file)
    monkeypatch.setattr(realtime, "_latency_file", opened)
    yield file
    for number in opened:
        os.close(number)


def test_the_wakeup_latency_can_be_requested_again(waking):
    assert "cpu_dma_latency" not in describe_scheduling()
    for latency in (0, 20):
        apply_realtime(RealtimeSettings(cpu_dma_latency=latency))
        assert waking.read_bytes()[-4:] == latency.to_bytes(4, sys.byteorder)
    (number,) = realtime._latency_file
    assert not os.get_inheritable(number)  # the request must not survive the controller in the recorder's process
    for process in (0, os.getpid()):
        assert describe_scheduling(process).endswith(", cpu_dma_latency held")
    assert "held" not in describe_scheduling(os.getppid())


def test_a_refused_wakeup_latency_has_the_remedy(waking, monkeypatch):
    monkeypatch.setattr(realtime, "_LATENCY_DEVICE", waking / "nowhere")
    with pytest.raises(
        ConfigurationError,
        match=r'cpu_dma_latency = 0: refused by the system \(Not a directory: .*KERNEL=="nowhere", GROUP="realtime".*'
        r"rules\.d/99-realtime\.rules.*--device .*nowhere\); see docs/real_time\.md",
    ):
        apply_realtime(RealtimeSettings(cpu_dma_latency=0))


@pytest.mark.parametrize(
    ("setting", "held", "refused"),
    [
        ("cpu_dma_latency=0", "cpu_dma_latency held", "cpu_dma_latency = 0: refused by the system"),
        ("lock_memory=True", "memory locked", "lock_memory = true: the process may lock"),
    ],
)
def test_it_applies_for_real_or_is_refused(setting, held, refused):
    script = (
        "from wbc_controller.nodes.realtime import apply_realtime, describe_scheduling\n"
        "from wbc_controller.settings.service import RealtimeSettings\n"
        f"apply_realtime(RealtimeSettings({setting}))\n"
        "print(describe_scheduling())"
    )
    ran = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    may = {"memory locked": realtime._locked_memory_limit() is None}
    if may.get(held, os.access(realtime._LATENCY_DEVICE, os.R_OK | os.W_OK)):
        assert ran.stdout.rstrip().endswith(f", {held}"), ran.stderr
    else:
        assert f"ConfigurationError: control.realtime.{refused}" in ran.stderr


def test_a_refused_class_has_the_remedy(monkeypatch):
    def refuse(*words):
        raise PermissionError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    with pytest.raises(
        ConfigurationError,
        match=r"control\.realtime\.scheduling = fifo, priority = 30: .*not permitted.*rtprio 30.*LimitRTPRIO=30.*"
        r"CAP_SYS_NICE; see docs/real_time\.md",
    ):
        apply_realtime(RealtimeSettings(scheduling="fifo", priority=30))


def test_memory_that_may_not_be_locked_whole_is_not_locked_in_part(calls, monkeypatch):
    """Below its limit mlockall succeeds, and a later allocation fails."""
    monkeypatch.setattr(realtime, "_locked_memory_limit", lambda: 8 << 20)
    with pytest.raises(ConfigurationError, match=r"lock_memory = true: the process may lock only 8192 kB\. Allow"):
        apply_realtime(RealtimeSettings(lock_memory=True))
    assert calls == []


@pytest.mark.parametrize(
    ("number", "said"), [(errno.ENOMEM, "not enough memory"), (errno.EPERM, "Operation not permitted")]
)
def test_a_refused_memory_lock_has_the_reason(calls, monkeypatch, number, said):
    monkeypatch.setattr(realtime, "_mlockall", lambda flags: number)
    with pytest.raises(ConfigurationError, match=f"refused by the system \\({said}\\).*memlock unlimited"):
        apply_realtime(RealtimeSettings(lock_memory=True))


@pytest.mark.parametrize(("limit", "capabilities", "free"), [
    (resource.RLIM_INFINITY, "0", True), (1 << 20, "0000000000004000", True), (1 << 20, "ffffffffffffbfff", False),
])  # fmt: skip
def test_the_limit_of_locked_memory_holds_without_the_capability(monkeypatch, limit, capabilities, free):
    monkeypatch.setattr(resource, "getrlimit", lambda which: (limit, limit))
    monkeypatch.setattr(realtime, "_status", lambda field: capabilities)
    assert realtime._locked_memory_limit() == (None if free else limit)


def test_another_operating_system_is_refused(monkeypatch):
    monkeypatch.delattr(os, "sched_setscheduler")
    monkeypatch.delattr(os, "sched_getscheduler")
    with pytest.raises(ConfigurationError, match=f"control.realtime: not supported on {sys.platform}; requires Linux"):
        apply_realtime(RealtimeSettings(lock_memory=True))
    assert describe_scheduling() == ""


def test_present_and_later_threads_get_the_affinity(restored, other_thread):
    other = other_thread(threading.get_native_id)
    apply_realtime(RealtimeSettings(affinity=[ONE, ONE]))
    for thread in (0, other):
        assert os.sched_getaffinity(thread) == {ONE}
    assert other_thread(scheduling_of_a_new_thread)[0] == {ONE}
    assert describe_scheduling().endswith(f" on processor {ONE}")


@pytest.mark.parametrize("affinity", [[NOWHERE], [ONE, NOWHERE]])
def test_a_missing_processor_is_refused_without_changes(restored, affinity):
    os.sched_setaffinity(0, [ONE])
    refused, _, valid = refusal(apply_realtime, RealtimeSettings(affinity=affinity)).partition("; valid:")
    assert refused == f"control.realtime.affinity = {affinity}: processor {NOWHERE} is not available"
    assert f" {', '.join(map(str, THERE))};" in valid
    assert os.sched_getaffinity(0) == {ONE}


def test_fifo_holds_for_all_threads_and_for_later_ones(restored, other_thread):
    """With real effect if permitted, otherwise with a real refusal."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    except PermissionError:
        with pytest.raises(ConfigurationError, match="refused by the system"):
            apply_realtime(RealtimeSettings(scheduling="fifo", priority=1))
        return
    other = other_thread(threading.get_native_id)
    apply_realtime(RealtimeSettings(scheduling="fifo", priority=2))
    for thread in (0, other):
        assert os.sched_getscheduler(thread) == os.SCHED_FIFO
    assert other_thread(scheduling_of_a_new_thread)[1] == os.SCHED_FIFO
    assert describe_scheduling().startswith("fifo 2 on ")


@pytest.mark.parametrize(("name", "priority", "then"), [("fifo", 7, 6), ("rr", 7, 6), ("fifo", 1, 1), ("other", 0, 0)])
def test_a_thread_that_computes_can_stand_behind_all_others(monkeypatch, name, priority, then):
    number, asked = getattr(os, realtime._CLASSES[name]), [priority]
    monkeypatch.setattr(os, "sched_getscheduler", lambda thread: number)
    monkeypatch.setattr(os, "sched_getparam", lambda thread: os.sched_param(priority))

    def schedule(thread, kind, parameter):
        assert (thread, kind) == (0, number)  # only the calling thread, in its class
        asked.append(parameter.sched_priority)

    monkeypatch.setattr(os, "sched_setscheduler", schedule)
    lower_thread_priority()
    assert asked[-1] == then


def test_the_scheduling_is_in_the_diagnostics(bench):
    controller = bench("go2")
    controller.cycle()
    assert controller.values["scheduling"] == describe_scheduling()
    assert controller.values["scheduling"].startswith(("other on processor", "fifo", "rr"))


def test_a_controller_runs_on_its_configured_processors_or_does_not_start(restored):
    stop = threading.Event()
    settings = load("go2").replace({"control.realtime.affinity": [ONE]}).settings
    seen = []

    class Looks(MemoryTransport):
        def advertise(self, endpoint):
            seen.append(os.sched_getaffinity(0))
            stop.set()
            return super().advertise(endpoint)

    run_controller(settings, Looks(MemoryBus()), stop)
    assert set(map(frozenset, seen)) == {frozenset([ONE])}
    opened, transport = [], MemoryTransport(MemoryBus())
    transport.advertise = opened.append
    settings = load("go2").replace({"control.realtime.affinity": [NOWHERE]}).settings
    with pytest.raises(ConfigurationError, match=f"affinity = \\[{NOWHERE}\\]"):
        run_controller(settings, transport, threading.Event())
    assert opened == []


def test_the_page_of_the_refusals_has_all_keys():
    text = page("real_time")
    for key in RealtimeSettings.model_fields:
        assert f"`{key}" in text or f"{key}:" in text, key
