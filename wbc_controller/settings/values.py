"""Kinds of values that settings have: units, ranges, and what every section of a file has in common."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Discriminator, Field, Tag


def _finite(value: float) -> float:
    if not math.isfinite(value):
        raise ValueError("must be finite")
    return value


Finite = Annotated[float, AfterValidator(_finite)]
Positive = Annotated[Finite, Field(gt=0.0)]
NonNegative = Annotated[Finite, Field(ge=0.0)]
Vector3 = Annotated[list[Finite], Field(min_length=3, max_length=3)]
#: Gains of at most this size are accepted: more is a mistaken unit.
Gain = Annotated[NonNegative, Field(le=1.0e5)]
NUMBER, LIST = "(number)", "(list)"  # in the places of errors; no key of a file is written so
#: One number, or a list with one for each axis.
Gains = Annotated[
    Annotated[Gain, Tag(NUMBER)] | Annotated[list[Gain], Tag(LIST)],
    Discriminator(lambda value: LIST if isinstance(value, list) else NUMBER),
]


class Section(BaseModel):
    """A section of a configuration file: unknown keys are errors, and nothing changes once it is read."""

    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True)

    #: The keys that may be changed while the controller runs.
    live: ClassVar[tuple[str, ...]] = ()
