"""Finding of the pre-flight check."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Finding:
    """Subject and result of a check."""

    subject: str
    text: str
