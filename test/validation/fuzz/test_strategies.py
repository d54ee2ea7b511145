"""Strategies: all kinds of hostile values occur, messages stay well-formed, draws are reproducible."""

import os
import signal

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from wbc_controller.errors import InputRefused
from wbc_controller.middleware.codec import decode, encode
from wbc_controller.recording.mcap_file import Topic
from wbc_controller.validation.fuzz import strategies
from wbc_controller.validation.fuzz.fuzz_commands import fuzz
from wbc_controller.validation.fuzz.hostile_recordings import hostile_messages
from wbc_controller.validation.fuzz.target import valid_message
from wbc_controller.validation.fuzz.values import FLOATS, SCALARS

TYPES = (
    "sensor_msgs/msg/JointState", "nav_msgs/msg/Odometry", "trajectory_msgs/msg/JointTrajectory", "std_msgs/msg/Bool",
    "trajectory_msgs/msg/MultiDOFJointTrajectory", "std_msgs/msg/Float64MultiArray", "geometry_msgs/msg/WrenchStamped",
)  # fmt: skip


def values(strategy, count):
    return [strategies.draw_by_key(strategy, number) for number in range(count)]


@pytest.mark.parametrize("type_name", TYPES)
def test_hostile_messages_are_well_formed(type_name):
    content = valid_message(type_name, ("a", "b"), "world", 7)
    before = encode(content)
    payloads = [encode(each) for each in values(strategies.hostile(content, ("a", "b")), 100)]
    assert encode(content) == before
    assert sum(payload != before for payload in payloads) > (25 if type_name.endswith("Bool") else 70)
    for payload in payloads:
        decode(payload, type_name)


def test_fields_contain_all_hostile_numbers_and_sequences_change():
    content = valid_message("std_msgs/msg/Float64", (), "", 0)
    found = {repr(each.data) for each in values(strategies.hostile(content, ()), 500)}
    assert found == set(map(repr, FLOATS))  # as text, because -0 equals 0 and NaN nothing
    content = valid_message("sensor_msgs/msg/JointState", "abc", "", 7)
    names = [tuple(each.name) for each in values(strategies.hostile(content, ()), 300)]
    assert {("c", "b", "a"), ("a", "b"), ()} <= set(names)
    assert max(map(len, names)) > 10


@settings(database=None)
@given(strategies.mutated_bytes(encode(valid_message("sensor_msgs/msg/JointState", ("a", "b"), "world", 7))))
def test_mutated_bytes_are_read_or_refused(payload):
    try:
        content = decode(payload, "sensor_msgs/msg/JointState")
    except InputRefused:
        return
    assert len(encode(content)) <= len(payload) + 64


def test_texts_are_mutated_scaled_and_encoded():
    text = "{tasks: {com: {weight: 5.0}}}\n{contacts: 3}"
    made = values(strategies.mutated_text(text, SCALARS), 200)
    assert made == values(strategies.mutated_text(text, SCALARS), 200)
    assert sum(each != text for each in made) > 150
    assert len(set(made)) > 80
    weights = {yaml.safe_load(text)["weight"] for text in values(strategies.scaled_text("{weight: 5.0, a1: 2}"), 200)}
    assert {-5.0, 0, 5000, 5.0, 2.5} <= weights
    assert strategies.draw_by_key(strategies.scaled_text("no number")) == "no number"
    made = values(strategies.encoded("é" * 20), 300)
    assert made.count(("é" * 20).encode()) > 230
    assert len(set(made)) > 3


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_during_a_draw_ends_the_command(number, tmp_path, monkeypatch):
    monkeypatch.setenv("HYPOTHESIS_STORAGE_DIRECTORY", str(tmp_path))
    before, numbers = signal.signal(number, signal.SIG_DFL), [number]

    def interrupted():
        while numbers:
            os.kill(os.getpid(), numbers.pop())

    try:
        fuzz.callback()
        with pytest.raises(KeyboardInterrupt):
            strategies.draw_by_key(st.builds(interrupted), 0)
    finally:
        signal.signal(number, before)


def test_an_event_that_is_no_text_any_more_is_changed_again():
    events = Topic(1, "/recording/events", "std_msgs/msg/String", "string data")
    broken = b"\x00\x01\x00\x00\x02\x00\x00\x00\x80\x00"
    with pytest.raises(InputRefused, match="utf-8"):
        decode(broken, events.type)
    drawn = [strategies.draw_by_key(hostile_messages([(events, 0, broken)]), number) for number in range(20)]
    assert any(payload != broken for messages in drawn for _, _, payload in messages)
