"""Mutations: they change what they are given, in every way that they have, and follow from the generator alone."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

from wbc_controller.errors import InputRefused
from wbc_controller.middleware.codec import decode, encode
from wbc_controller.validation.fuzz.contents import hostile, ordinary
from wbc_controller.validation.fuzz.mutations import encoded, mutated_bytes, mutated_text, scaled
from wbc_controller.validation.fuzz.values import FLOATS, SCALARS, TEXTS

TYPES = (
    "sensor_msgs/msg/JointState",
    "nav_msgs/msg/Odometry",
    "trajectory_msgs/msg/JointTrajectory",
    "trajectory_msgs/msg/MultiDOFJointTrajectory",
    "std_msgs/msg/Float64MultiArray",
    "geometry_msgs/msg/WrenchStamped",
    "std_msgs/msg/Bool",
)


@pytest.mark.parametrize("type_name", TYPES)
def test_hostile_messages_are_well_formed_and_other_than_the_ordinary_one(type_name):
    rng, content = np.random.default_rng(0), ordinary(type_name, ("a", "b"), "world", 7)
    before = encode(content)
    payloads = [encode(hostile(rng, content, ("a", "b"))) for _ in range(200)]
    assert encode(content) == before
    assert sum(payload != before for payload in payloads) > (50 if type_name.endswith("Bool") else 150)
    for payload in payloads:
        decode(payload, type_name)


def test_hostile_fields_reach_every_hostile_number():
    rng, content = np.random.default_rng(0), ordinary("std_msgs/msg/Float64", (), "", 0)
    seen = {repr(hostile(rng, content, ()).data) for _ in range(2000)}  # as text, since -0 is 0 and NaN is nothing
    assert seen == {repr(value) for value in FLOATS}


def test_mutated_bytes_are_refused_or_read_and_never_raise_anything_else():
    rng = np.random.default_rng(0)
    payload = encode(ordinary("sensor_msgs/msg/JointState", ("a", "b"), "world", 7))
    read = 0
    for _ in range(500):
        try:
            decode(mutated_bytes(rng, payload), "sensor_msgs/msg/JointState")
        except InputRefused:
            continue
        read += 1
    assert 50 < read < 450


def test_a_mutated_text_is_another_one_and_follows_from_the_seed():
    text = "{tasks: {com: {weight: 5.0}}}\n{contacts: 3}"
    made = [mutated_text(np.random.default_rng(seed), text, SCALARS) for seed in range(300)]
    assert made == [mutated_text(np.random.default_rng(seed), text, SCALARS) for seed in range(300)]
    assert sum(each != text for each in made) > 250
    assert len(set(made)) > 150


def test_a_scaled_text_keeps_its_form():
    made = {scaled(np.random.default_rng(seed), "{weight: 5.0, a1: 2}") for seed in range(200)}
    weights = {yaml.safe_load(text)["weight"] for text in made}
    assert {-5.0, 0, 5000, 5.0, 2.5} <= weights
    assert scaled(np.random.default_rng(0), "no number") == "no number"


def test_encodings_other_than_utf_8_occur():
    made = [encoded(np.random.default_rng(seed), "é" * 20) for seed in range(300)]
    assert made.count(("é" * 20).encode()) > 250
    assert len(set(made)) > 3


def test_every_hostile_text_and_value_fits_into_a_message():
    for text in (*TEXTS, *SCALARS):
        assert text.encode() is not None
