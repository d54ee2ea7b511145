"""Every command, option, key of the configuration, topic and Python name of the last release still exists."""

import json
from pathlib import Path

import pytest
from interface import interface

BEFORE = json.loads((Path(__file__).parent / "support/interface_of_0.1.0.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize("part", BEFORE)
def test_nothing_is_missing(part):
    assert len(BEFORE[part]) > 60
    assert sorted(set(BEFORE[part]) - set(interface()[part])) == []
