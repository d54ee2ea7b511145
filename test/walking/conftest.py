"""Short preparation of trials."""

import pytest


@pytest.fixture
def short_rest(monkeypatch: pytest.MonkeyPatch) -> dict[str, float]:
    """Shorten the rest after the release; return settings of a short settling and activation."""
    monkeypatch.setattr("wbc_controller.validation.accuracy.estimation_trial._REST_TIME", 0.3)
    return {"estimation.settling": 0.1, "safety.activation_ramp": 0.1}
