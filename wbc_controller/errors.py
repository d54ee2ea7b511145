"""Exceptions of the package.

::

    WbcError
    ├── ConfigurationError      invalid robot file, model or command line (exit status 2)
    │   └── MethodError         a method of a task, contact or limit failed
    ├── InputRefused            refused message or command; the controller keeps running
    ├── NoSolution              no usable solution of the quadratic program
    └── TransportError          the middleware cannot start or open a topic
"""

import difflib
import reprlib
from collections.abc import Callable, Collection, Iterable
from typing import Any


class WbcError(Exception):
    """Base class of the package's exceptions."""


class ConfigurationError(WbcError):
    """Invalid configuration. The message names file, key, value and valid values."""


class MethodError(ConfigurationError):
    """Exception or invalid return value of a method of a task, contact or limit; fault ``METHOD_FAILED``."""


class InputRefused(WbcError):
    """Refused message or command. ``str()`` is one sentence."""


class NoSolution(WbcError):
    """No usable solution of the quadratic program."""

    def __init__(
        self,
        message: str,
        status: str,
        problem: Any,
        infeasibility: Any = None,
        search: Callable[[], Any] | None = None,
    ) -> None:
        """Create the exception; `search` finds the conflicting constraints."""
        super().__init__(message)
        self.status = status  # of the solver
        self.problem = problem  # the solver's input (`formulation.problem.QuadraticProgram`)
        self.infeasibility = infeasibility  # conflict (`records.Infeasibility`); None before the search or without one
        self._search = search

    def explained(self) -> "NoSolution":
        """Return this error with the conflicting constraints. Takes several periods; thread-safe."""
        if self._search is None:
            return self
        why = self._search()
        because = why.sentence if why is not None else "the constraints are feasible; the solver failed"
        return NoSolution(f"{self}; {because}", self.status, self.problem, why)


class TransportError(WbcError):
    """The middleware cannot start, or cannot open a topic."""


def require_known(
    names: str | Iterable[Any],
    choices: Collection[str],
    before: str,
    after: str = "",
    error: type[WbcError] = ConfigurationError,
) -> None:
    """Raise an error for the first unknown name: ``<before> 'cmo'<after>; did you mean 'com'? Valid: com, posture``."""
    for name in (names,) if isinstance(names, str) else names:
        if not isinstance(name, str):
            raise error(f"{before} {reprlib.repr(name)}{after}; {valid_choices('', choices)}")
        if name not in choices:
            raise error(f"{before} {name!r}{after}; {valid_choices(name, choices)}")


def valid_choices(value: str, choices: Iterable[str]) -> str:
    """List valid values and the most similar one: ``did you mean 'com'? Valid: com, posture``."""
    names = sorted(choices)
    close = difflib.get_close_matches(value, names, n=1, cutoff=0.5)
    hint = f"did you mean {close[0]!r}? " if close else ""
    return f"{hint}Valid: {', '.join(names) if names else '(none)'}"
