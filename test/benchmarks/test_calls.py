"""What a call of a compiled function takes, by two ways."""

import calls
import numpy as np
import pytest


def test_both_ways_are_timed_and_differ_in_what_they_say_of_other_types():
    found = calls.measure(cold=3, rounds=1)
    assert list(found) == ["Numba's dispatcher", "as kernels are called"]
    assert all(seconds > 0.0 for pair in found.values() for seconds in pair)
    wrong = [np.zeros((2, 2))] * 5 + [1.0, np.zeros(1)]
    for call, sentence in ((calls.dispatched, "No matching definition"), (calls.touch, "with 1 axes")):
        with pytest.raises(TypeError, match=sentence):
            call(*wrong)


def test_no_arguments_are_taken(monkeypatch):
    monkeypatch.setattr("sys.argv", ["calls.py", "--fast"])
    with pytest.raises(SystemExit, match="'--fast': no arguments are taken"):
        calls.main()
