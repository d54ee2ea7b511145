"""The exceptions of this package.

::

    WbcError
    ├── ConfigurationError      a robot file, model or command line that cannot be used (exit status 2)
    │   └── MethodError         a method of a task, contact or limit has failed
    ├── InputRefused            one message or command was not accepted; the controller keeps running
    ├── NoSolution              the quadratic program has no usable solution; carries the problem and the reason
    └── TransportError          the middleware could not be started, or a topic could not be opened

Exceptions of other libraries are translated where they are caught.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable
from typing import Any


class WbcError(Exception):
    """Base of all exceptions of this package."""


class ConfigurationError(WbcError):
    """A configuration that cannot be used.

    The message names the file, the key, the value found there, and the valid ones.
    """


class MethodError(ConfigurationError):
    """A method of a task, contact or limit has raised an exception or returned an invalid value.

    The message names the object, its class and the method. While a controller is made it is an error of the
    configuration; in a running controller it leads to damping with the fault ``METHOD_FAILED``.
    """


class InputRefused(WbcError):
    """A message or command that was not accepted; ``str()`` is one readable sentence."""


class NoSolution(WbcError):
    """The quadratic program has no usable solution.

    Attributes:
        status: status that the solver returned.
        problem: the problem as it was given to the solver (`formulation.problem.QuadraticProgram`).
        infeasibility: the conflicting constraints (`records.Infeasibility`); None if they have not been searched for,
            or if none conflict.
    """

    def __init__(
        self,
        message: str,
        status: str,
        problem: Any,
        infeasibility: Any = None,
        search: Callable[[], Any] | None = None,
    ) -> None:
        """Make the exception; `search` finds the conflicting constraints if they are not known yet."""
        super().__init__(message)
        self.status = status
        self.problem = problem
        self.infeasibility = infeasibility
        self._search = search

    def explained(self) -> NoSolution:
        """Return this error with the conflicting constraints named; takes several periods, callable from any thread."""
        if self._search is None:
            return self
        why = self._search()
        because = why.sentence if why is not None else "they do not conflict: it is the solver that failed"
        return NoSolution(f"{self}; {because}", self.status, self.problem, why)


class TransportError(WbcError):
    """The middleware could not be started, or a topic could not be opened."""


def valid_choices(value: str, choices: Iterable[str]) -> str:
    """List the valid values, and the one that was probably meant: ``did you mean 'com'? Valid: com, posture``."""
    names = sorted(choices)
    close = difflib.get_close_matches(value, names, n=1, cutoff=0.5)
    hint = f"did you mean {close[0]!r}? " if close else ""
    return f"{hint}Valid: {', '.join(names) if names else '(none)'}"
