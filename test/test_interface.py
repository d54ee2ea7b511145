"""Every command, option, key of the configuration and topic of commit d8d35bb still exists."""

import json
from pathlib import Path

import pytest
from interface import interface

BEFORE = json.loads((Path(__file__).parent / "support" / "interface_of_d8d35bb.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize("part", BEFORE)
def test_nothing_is_missing(part):
    assert len(BEFORE[part]) > 60
    assert sorted(set(BEFORE[part]) - set(interface()[part])) == []
