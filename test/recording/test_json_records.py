"""Records to JSON and back, bit for bit."""

import json
import math
import struct
from typing import Any, TypeVar, get_origin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typing_extensions import TypeAliasType

from wbc_controller.inverse_dynamics.references.changes import SetSetpoint, SetTrajectory
from wbc_controller.inverse_dynamics.references.trajectories import Knot, SoftRamp, Trajectory
from wbc_controller.recording import json_records
from wbc_controller.recording.json_records import from_json, to_json
from wbc_controller.records import ChangeSettings, Fault, Mode

FLOATS = st.floats(width=64)


@given(FLOATS)
def test_every_double(value):
    back = from_json(to_json(value))
    assert math.isnan(back) if math.isnan(value) else struct.pack("<d", back) == struct.pack("<d", value)


@given(st.lists(FLOATS, max_size=8))
def test_every_array(values):
    array = np.array(values)
    back = from_json(to_json(array))
    assert back.tobytes() == array.tobytes()
    assert back.dtype == array.dtype


def test_a_matrix_comes_back_in_the_order_of_its_memory():
    rows = np.arange(6.0).reshape(2, 3)
    for array in (rows, np.asfortranarray(rows), rows[:, 1:], rows[:1]):
        back = from_json(to_json(array))
        np.testing.assert_array_equal(back, array)
        assert back.flags.f_contiguous == array.flags.f_contiguous


@given(
    st.recursive(
        st.none() | st.booleans() | st.integers() | st.text() | FLOATS.filter(math.isfinite),
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
        max_leaves=8,
    )
)
def test_every_tree(tree):
    assert from_json(to_json(tree)) == tree


def test_records_are_kept_and_invalid_ones_refused():
    knot = Knot(1.5, np.array([1.0, -0.0]), np.zeros(2), np.ones(2))
    said = [
        SetTrajectory("com", None, (knot, knot)), SetSetpoint("com", np.array([0.1]), None, "world"),
        ChangeSettings({"tasks": {"com": {"weight": 2}}}), Fault("A", "b"), Mode.FAULT,
        SoftRamp(0.0, 1.0, 2.0, -math.inf),
    ]  # fmt: skip
    back = from_json(to_json(said))
    assert to_json(back) == to_json(said)
    assert [type(each) for each in back] == [type(each) for each in said]
    assert isinstance(back[0].points, tuple)
    assert back[2:] == said[2:]
    line = Trajectory([knot, Knot(2.5, np.array([3.0, 1.0]), np.zeros(2), np.ones(2))])
    again = from_json(to_json({"a": line}))["a"]
    assert again.sample(2.0).position.tobytes() == line.sample(2.0).position.tobytes()
    with pytest.raises(TypeError, match="a recording cannot contain a object"):
        to_json(object())
    for text in (json.dumps({"$record": "Path"}), json.dumps({"$array": "AA==", "type": "<f8", "shape": [1]}), "{"):
        with pytest.raises(ValueError, match=r"not a value|cannot reshape|buffer size|Expecting"):
            from_json(text)


def test_array_types_of_new_versions_of_numpy(monkeypatch):
    """From NumPy 2.5 on, `NDArray` is a type alias on Python 3.12 and later; recordings could not be read there."""
    T = TypeVar("T", bound=np.generic)
    alias = TypeAliasType("NDArray", np.ndarray[Any, np.dtype[T]], type_params=(T,))[np.float64]
    assert get_origin(alias) is not np.ndarray
    monkeypatch.setattr(json_records, "Array", alias)
    json_records.require_types({"q": np.zeros(2)}, {"q": alias}, "state")
    with pytest.raises(ValueError, match="state: 'q' is 'long'"):
        json_records.require_types({"q": "long"}, {"q": alias}, "state")
