"""Benchmark of the page for a few seconds."""

import os

import pytest

pytest.importorskip("viser", reason="the page requires viser: pip install 'wbc_controller[view]'")

import page

pytestmark = pytest.mark.live


def test_loop_is_measured_with_and_without_the_page(forks, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(page, "LOADING", 0.3)
    monkeypatch.setattr(page, "BLOCK", 1.2)
    monkeypatch.setattr(page, "BROWSERS", os.SCHED_OTHER)  # a busy computer has no idle time: the page drops them
    found = dict(page.measure("go2", 2 * page.BLOCK / 60.0, 2, "other", tmp_path))
    assert "2 browsers" in capsys.readouterr().out
    for seconds in found.values():  # one block each; a busy computer slows the simulated time
        assert 10 < seconds.size < 2 * 500 * page.BLOCK
        assert (seconds > 0.0).all()
    assert set(found) == {"with", "without"}


def test_a_process_returns_to_its_scheduling_class_after_an_error():
    """Idle threads get no time on a busy computer: the following tests of this process waited in vain."""

    def fail():
        with page.scheduling_class(os.SCHED_IDLE):
            assert os.sched_getscheduler(0) == os.SCHED_IDLE
            raise ConnectionError

    before = os.sched_getscheduler(0)
    with pytest.raises(ConnectionError):
        fail()
    assert os.sched_getscheduler(0) == before
