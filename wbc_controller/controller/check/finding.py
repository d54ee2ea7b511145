"""What a check of a configuration finds."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Finding:
    """The result of one check.

    Attributes:
        subject: subject of the check.
        text: result of the check.
    """

    subject: str
    text: str
