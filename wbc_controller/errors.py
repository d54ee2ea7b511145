"""Every exception that this package raises on purpose.

::

    WbcError
    ├── ConfigurationError      a robot file, model or command line that cannot be used (exit status 2)
    ├── InputRefused            one message or command was not accepted; everything else goes on
    ├── NoSolution              the quadratic program has no usable answer; carries the problem, and why
    └── TransportError          the middleware could not be started, or a topic could not be opened

Errors of other libraries are translated where they enter.
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


class InputRefused(WbcError):
    """A message that was not accepted. ``str()`` is one sentence for a person to read."""


class NoSolution(WbcError):
    """The quadratic program has no usable answer.

    Attributes:
        status: what the solver said.
        problem: the problem as it was given to the solver (`core.problem.QuadraticProgram`).
        infeasibility: which constraints conflict (`records.Infeasibility`); None where that was not asked, or where
            they do not.
    """

    def __init__(
        self,
        message: str,
        status: str,
        problem: Any,
        infeasibility: Any = None,
        search: Callable[[], Any] | None = None,
    ) -> None:
        """Say what failed.

        Args:
            message: for a person to read.
            status: what the solver said.
            problem: the problem as it was given to the solver.
            infeasibility: which constraints conflict, where that is known.
            search: finds that out, where it is not.
        """
        super().__init__(message)
        self.status = status
        self.problem = problem
        self.infeasibility = infeasibility
        self._search = search

    def explained(self) -> NoSolution:
        """Find out which constraints conflict, and say it. It takes several periods, and any thread may do it."""
        if self._search is None:
            return self
        why = self._search()
        because = why.sentence if why is not None else "they do not conflict: it is the solver that failed"
        return NoSolution(f"{self}; {because}", self.status, self.problem, why)


class TransportError(WbcError):
    """The middleware could not be started, or a topic could not be opened."""


def valid_choices(value: str, choices: Iterable[str]) -> str:
    """Say which values are valid, and which one was probably meant.

    Args:
        value: the value that was refused.
        choices: the valid values.

    Returns:
        A clause to end an error message with, such as ``did you mean 'com'? Valid: com, posture``.
    """
    names = sorted(choices)
    close = difflib.get_close_matches(value, names, n=1, cutoff=0.5)
    hint = f"did you mean {close[0]!r}? " if close else ""
    return f"{hint}Valid: {', '.join(names) if names else '(none)'}"
