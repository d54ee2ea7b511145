"""Types of values, and the base class of sections."""

import re
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Discriminator, Field, FiniteFloat, Tag, model_validator


def _name(value: str) -> str:
    if not (re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", value) and len(value) <= _LONGEST_NAME):
        shown = f"the name {value!r}" if len(value) <= _LONGEST_NAME else f"a name of {len(value)} characters"
        valid = f"use letters, digits and underscores, no leading digit, at most {_LONGEST_NAME} characters"
        raise ValueError(f"{shown} is not valid in a ROS topic: {valid}")
    return value


_LONGEST_NAME = 100  # longest name of a task or contact, characters; ROS topics have at most 247
Name = Annotated[str, AfterValidator(_name)]  # name of a task, contact or loop, part of topic names
Finite = FiniteFloat
Positive = Annotated[Finite, Field(gt=0.0)]
NonNegative = Annotated[Finite, Field(ge=0.0)]
Vector3 = Annotated[list[Finite], Field(min_length=3, max_length=3)]
Gain = Annotated[NonNegative, Field(le=1.0e5)]  # larger values are likely in another unit
NUMBER, LIST = "(number)", "(list)"  # tags in locations of pydantic errors
#: One number, or a list with one per axis.
Gains = Annotated[
    Annotated[Gain, Tag(NUMBER)] | Annotated[list[Gain], Tag(LIST)],
    Discriminator(lambda value: LIST if isinstance(value, list) else NUMBER),
]


def key(default: Any, description: str, **constraints: Any) -> Any:
    """Define a key with a default; constraints of pydantic's `Field`."""
    return Field(default, description=description, **constraints)


def axes_mask(count: int, description: str) -> Any:
    """Define a list of booleans, one per axis, True by default."""
    return key([True] * count, description, min_length=count, max_length=count)


def ordered(lower: str, upper: str) -> Any:
    """Return a validator of sections in which one key must be below another one."""

    def check(section: "Section") -> "Section":
        low, high = getattr(section, lower), getattr(section, upper)
        if not (low < high):
            raise ValueError(f"{upper} = {high}: must be above {lower} = {low}")
        return section

    return model_validator(mode="after")(check)


class Section(BaseModel):
    """Section of a configuration file, immutable, without unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True)

    live: ClassVar[tuple[str, ...]] = ()  # keys that may change while the controller runs
    #: Smaller ranges of live keys while the controller runs; None is the configured value.
    live_ranges: ClassVar[Mapping[str, tuple[float | None, float | None]]] = {}
