"""Real processes: 12 s of controller, mock robot and guard without memory growth or faults."""

import numpy as np
import pytest
from domains import own_domain

from wbc_controller.validation.fuzz import soak

#: Duration and period of the checks here, s; `wbc fuzz soak` takes half an hour.
SECONDS, PERIOD = 12.0, 0.25
#: Largest growth of the memory within 4.5 s, kB; up to 84 without a leak.
GROWTH = 200


@pytest.mark.live
def test_memory_is_flat_and_no_fault_occurs(forks, tmp_path, monkeypatch):
    monkeypatch.setattr(soak, "_CHECK_PERIOD", PERIOD)
    result = soak.soak("go2", tmp_path, SECONDS, domain=own_domain())
    print(result.memory, result.faults, result.rate, result.late)
    assert result.own_faults == []
    for name in ("controller", "mock", "guard"):
        assert result.flat(name), (name, result.memory[name])
        assert result.growth(name) <= GROWTH, (name, result.memory[name])
    assert result.rate > 50.0  # 500 on an idle machine


def test_growing_memory_and_own_faults_are_found():
    rng = np.random.default_rng(0)
    flat = (100_000 + rng.integers(0, 500, 60)).tolist()
    warm_up = [90_000 + 1000 * min(i, 20) for i in range(60)]
    result = soak.SoakResult(60.0, {"flat": flat, "warm-up": warm_up, "leak": [100_000 + 100 * i for i in range(60)]})
    assert [name for name in result.memory if not result.flat(name)] == ["leak"]
    faults = [("damping STALE_INPUT: …", 0.03, 0.05), ("damping FALLEN: …", 0.001, 0.05)]
    assert soak.SoakResult(faults=faults).own_faults == ["damping FALLEN: …"]
