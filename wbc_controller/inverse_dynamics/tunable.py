"""Attributes whose changes have to be known before the next cycle, and hardly ever come."""

from __future__ import annotations

from typing import Any, Generic, TypeVar, overload

_Value = TypeVar("_Value")


class Tunable(Generic[_Value]):
    """An attribute of tasks or contacts that may be set between two cycles.

    A program is laid out and weighed once for all cycles in which nothing of the kind happens. To look at every
    attribute of every task and contact would take longer than to compute with them: this counts how often any was set.

    Attributes:
        changes: how often one has been set, of all objects.
    """

    changes = 0

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = f"_{name}"

    @overload
    def __get__(self, instance: None, owner: type) -> Tunable[_Value]: ...
    @overload
    def __get__(self, instance: Any, owner: type) -> _Value: ...
    def __get__(self, instance: Any, owner: type) -> Tunable[_Value] | _Value:
        if instance is None:
            return self
        value: _Value = getattr(instance, self._name)
        return value

    def __set__(self, instance: Any, value: _Value) -> None:
        setattr(instance, self._name, value)
        Tunable.changes += 1
