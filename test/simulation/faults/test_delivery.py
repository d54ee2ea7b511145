"""Arrival of messages under each delivery fault."""

import numpy as np
import pytest
from stepping import has_faults

from wbc_controller.simulation.faults import messages
from wbc_controller.simulation.faults.catalogue import kinds_of


@pytest.mark.parametrize(
    ("kind", "given", "arrivals"),
    [
        ("message_delay", {"delay": 0.006}, [[], [], [], *[[n] for n in range(7)]]),
        ("message_growing_delay", {"growth": 1.0}, [[0], [], [1], [], [2], [], [3], [], [4], []]),
        ("message_dropout", {}, [[]] * 10),
        ("message_dropout", {"stream": "odom"}, [[n] for n in range(10)]),  # the joint states are left alone
        ("message_loss", {"share": 1.0}, [[]] * 10),
        ("message_duplication", {"gap": 0.0}, [[n, n] for n in range(10)]),
        ("message_duplication", {"gap": 0.004}, [[0], [1], *[[n - 2, n] for n in range(2, 10)]]),
        ("message_reordering", {"share": 1.0, "periods": 2}, [[], [], *[[n] for n in range(8)]]),
        ("message_replay", {"length": 0.006}, [[0], [1], [2], [0], [1], [2], [0], [1], [2], [0]]),
        ("message_queue", {}, [[]] * 10),
        ("message_queue", {"duration": 0.009}, [[], [], [], [], [], [0, 1, 2, 3, 4, 5], [6]]),
        ("message_delay", {"delay": 0.006, "duration": 0.004}, [[], [], [2], [0, 3], [1, 4], [5]]),
        ("command_loss", {"share": 1.0}, [[]] * 5),
        ("command_delay", {"delay": 0.004}, [[], [], [0], [1], [2]]),
        ("command_twice", {"gap": 0.002}, [[0], [0, 1], [1, 2], [2, 3], [3, 4]]),
    ],
)
def test_messages_arrive_as_the_fault_says(bench, kind, given, arrivals):
    command = kind.startswith("command")
    bench.plan(kind, **{"duration": 1.0, **({} if command else {"stream": "joint_states"}), **given})
    assert bench.arrivals(messages.COMMAND if command else "joint_states", len(arrivals)) == arrivals


def test_shares_and_streams_of_delivery_faults(bench):
    assert {kind.kind() for kind in kinds_of(messages) if kind.place != "stamps and clock"} == {
        "message_delay", "message_growing_delay", "message_jitter", "message_loss", "message_dropout",
        "message_duplication", "message_reordering", "message_replay", "message_queue", "command_loss", "command_delay",
        "command_twice",
    }  # fmt: skip
    bench.plan("message_dropout", stream="both", duration=1.0)
    assert bench.arrivals("joint_states", 3) == bench.arrivals("odom", 3) == [[]] * 3
    assert bench.arrivals("imu", 3) == [[0], [1], [2]]
    bench.faults.clear()
    bench.plan("message_loss", stream="odom", share=0.3, duration=10.0)
    assert 0.63 < np.mean([bool(numbers) for numbers in bench.arrivals("odom", 600)]) < 0.77


def test_jitter_delays_within_its_bound_and_lets_messages_overtake(bench):
    bench.plan("message_jitter", stream="odom", jitter=0.02, duration=10.0)
    arrived = bench.arrivals("odom", 200)
    delays = [period - number for period, numbers in enumerate(arrived) for number in numbers]
    assert min(delays) >= 0
    assert 8 <= max(delays) <= 10
    order = [number for numbers in arrived for number in numbers]
    assert order != sorted(order)


def test_messages_are_delivered_where_no_new_one_is_sent(bench):
    bench.plan("message_delay", stream="odom", delay=0.004, duration=0.002)
    assert bench.arrivals("odom", 1) == [[]]
    assert bench.arrivals("odom", 3, messages=False) == [[], [0], []]
    assert not has_faults(bench.faults)


def test_clear_ends_all_and_loses_what_is_on_its_way(bench):
    bench.plan("message_delay", stream="odom", delay=0.004, duration=10.0)
    bench.plan("joint_noise", start=1.0)
    bench.arrivals("odom", 2)
    bench.faults.clear()
    assert not has_faults(bench.faults)
    assert bench.arrivals("odom", 3) == [[0], [1], [2]]
