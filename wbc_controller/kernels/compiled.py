"""Compiling functions to machine code, once per machine.

Numba compiles what `compiled` decorates for the types that are given, and for no others: a call with other types raises
a TypeError, so that nothing is ever compiled in a control cycle. The machine code is kept beside the source, or, where
that folder is read-only, in the user's cache folder; the environment variable ``NUMBA_CACHE_DIR`` names another one. It
is made anew where the source, Numba, or the processor is another one. Numba looks only at the file of the function for
that, so a compiled function calls no other than those of its own file; after a change of options or types in this file,
remove ``__pycache__``.

Without ``fastmath`` sums are taken in the order in which they are written: the same bits in every run.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Any, TypeVar

import numba
from numba import types

_log = logging.getLogger(__name__)
_Function = TypeVar("_Function", bound=Callable[..., Any])

INTEGER, FLAG, NUMBER = types.int64, types.boolean, types.float64
#: Arrays that are only read: without gaps, row by row, and any.
VECTOR = types.Array(types.float64, 1, "C", readonly=True)
ROWS = types.Array(types.float64, 2, "C", readonly=True)
ANY_VECTOR = types.Array(types.float64, 1, "A", readonly=True)
ANY_MATRIX = types.Array(types.float64, 2, "A", readonly=True)
INDICES = types.Array(types.int64, 1, "C", readonly=True)
SIGNS = types.Array(types.int8, 1, "C", readonly=True)
SIGN_ROWS = types.Array(types.int8, 2, "C", readonly=True)
#: A `bytes` object; nothing else that holds bytes is accepted.
BYTES = types.Bytes(types.uint8, 1, "C", readonly=True)
#: Arrays that are written.
VECTOR_OUT = types.Array(types.float64, 1, "C")
ROWS_OUT = types.Array(types.float64, 2, "C")
ANY_VECTOR_OUT = types.Array(types.float64, 1, "A")
ANY_MATRIX_OUT = types.Array(types.float64, 2, "A")

_pending: list[tuple[Any, tuple[types.Type, ...]]] = []
_nowhere_kept: list[str] = []  # why functions cannot be kept for the next start


def compiled(*arguments: types.Type) -> Callable[[_Function], _Function]:
    """Compile a function for arguments of these types, when `compile_all` is called.

    Args:
        *arguments: the types of its arguments, in order.
    """

    def register(function: _Function) -> _Function:
        try:
            dispatcher = numba.njit(cache=True, error_model="numpy")(function)
        except RuntimeError as error:  # no folder to keep it in can be written
            _nowhere_kept.append(str(error))
            dispatcher = numba.njit(error_model="numpy")(function)
        _pending.append((dispatcher, arguments))
        return dispatcher  # type: ignore[no-any-return]

    return register


#: A function that compiled functions of its file call; it becomes a part of them.
part: Callable[[_Function], _Function] = numba.njit(error_model="numpy")


def compile_all() -> None:
    """Compile the registered functions, or load what was compiled before; say so if it takes long."""
    started, missing = time.monotonic(), bool(_nowhere_kept)
    if _nowhere_kept:
        _log.warning("compiled at every start: %s; NUMBA_CACHE_DIR can name a folder", _nowhere_kept[0])
    for count, (dispatcher, arguments) in enumerate(_pending, 1):
        dispatcher.compile(arguments)
        dispatcher.disable_compile()
        if sum(dispatcher.stats.cache_misses.values()):
            name = dispatcher.py_func.__name__
            if not missing:
                _log.warning("the controller's arithmetic is compiled for this processor, once: some seconds")
            missing = True
            _log.warning("compiled %s, %d of %d", name, count, len(_pending))
    if missing:
        _log.warning("compiled all in %.1f s", time.monotonic() - started)
    _pending.clear()
