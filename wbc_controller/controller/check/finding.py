"""What a check of a configuration finds."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Finding:
    """The subject of a check, and its result in words."""

    subject: str
    text: str
