"""Types of setting values, with their ranges, and the base class of every section of a file."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Discriminator, Field, Tag


def _finite(value: float) -> float:
    if not math.isfinite(value):
        raise ValueError("must be finite")
    return value


def _name(value: str) -> str:
    if not (re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", value) and len(value) <= _LONGEST_NAME):
        shown = f"the name {value!r}" if len(value) <= _LONGEST_NAME else f"a name of {len(value)} characters"
        raise ValueError(
            f"{shown} cannot be part of a ROS topic's: it takes letters, digits and underscores, no digit in front, "
            f"and at most {_LONGEST_NAME} characters"
        )
    return value


#: Longest name of a task or contact, in characters; a ROS topic's whole name has at most 247.
_LONGEST_NAME = 100
#: Name of a task, contact or loop, which stands in topics.
Name = Annotated[str, AfterValidator(_name)]
Finite = Annotated[float, AfterValidator(_finite)]
Positive = Annotated[Finite, Field(gt=0.0)]
NonNegative = Annotated[Finite, Field(ge=0.0)]
Vector3 = Annotated[list[Finite], Field(min_length=3, max_length=3)]
#: A gain; larger ones are refused as a mistaken unit.
Gain = Annotated[NonNegative, Field(le=1.0e5)]
NUMBER, LIST = "(number)", "(list)"  # tags in the locations of pydantic's errors; not keys of a file
#: One number, or a list with one for each axis.
Gains = Annotated[
    Annotated[Gain, Tag(NUMBER)] | Annotated[list[Gain], Tag(LIST)],
    Discriminator(lambda value: LIST if isinstance(value, list) else NUMBER),
]


def axes_mask(count: int, description: str) -> Any:
    """Define a list of switches, one per axis, all on by default."""
    return Field([True] * count, min_length=count, max_length=count, description=description)


class Section(BaseModel):
    """A section of a configuration file: unknown keys are errors, and its values are frozen."""

    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True)

    #: The keys that may be changed while the controller runs.
    live: ClassVar[tuple[str, ...]] = ()
    #: For live keys whose whole range is safe only at rest: the range while the controller runs. None stands for the
    #: value that the controller was configured with, which always stays possible.
    live_ranges: ClassVar[Mapping[str, tuple[float | None, float | None]]] = {}
