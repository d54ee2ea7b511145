"""What docs/limits.md shows runs."""

import pytest
from pages import page, snippets

from wbc_controller.settings.limits import LimitSettings

BLOCKS = snippets(page("limits"))


@pytest.mark.parametrize("block", BLOCKS, ids=lambda block: "+".join(block["limits"]))
def test_snippets_of_the_page(bench, block):
    robot = bench("g1", block)
    for key, value in block["limits"].items():
        given = getattr(robot.settings.limits, key)
        assert (given.model_dump(include=set(value)) if isinstance(value, dict) else given) == value
    robot.activate()
    report = robot.cycle(20)
    assert report.solution is not None
    assert not report.solution.relaxed


def test_the_page_shows_every_key():
    assert {key for block in BLOCKS for key in block["limits"]} == set(LimitSettings.model_fields)
