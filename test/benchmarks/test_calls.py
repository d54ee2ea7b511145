"""Time of a call of a compiled function, by kind of arguments."""

import calls
import pytest


def test_all_kinds_of_arguments_are_timed(monkeypatch):
    found = calls.measure(cold=3, rounds=1)
    assert list(found) == ["arguments", "struct", "struct and array"]
    assert all(seconds > 0.0 for pair in found.values() for seconds in pair)
    monkeypatch.setattr("sys.argv", ["calls.py", "--fast"])
    with pytest.raises(SystemExit, match="unknown argument '--fast'"):
        calls.main()
