"""Invented outcomes of trials, for tests of reports."""

import dataclasses
from typing import Any

from wbc_controller.validation.campaign.results import Outcome


def outcome(kind: str = "kick", seed: int = 0, **changes: Any) -> Outcome:
    values: dict[str, Any] = {
        "robot": "go2", "kind": kind, "seed": seed, "parameters": {"speed": 0.5}, "deadline": None,
        "result": "survived", "code": "", "sentence": "", "after": None, "moved": 0.03, "longest": 0.002,
        "violations": {},
    }  # fmt: skip
    return Outcome(**{**values, **changes})


def repeatable(outcome):
    """Return the values that are identical in a repeated trial: without processor times and texts."""
    values = {**dataclasses.asdict(outcome), "violations": sorted(outcome.violations)}
    return {key: value for key, value in values.items() if key not in ("longest", "sentence")}
