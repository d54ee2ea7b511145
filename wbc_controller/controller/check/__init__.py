"""Pre-flight check of a configuration."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Finding:
    """Subject and result of a check."""

    subject: str
    text: str
