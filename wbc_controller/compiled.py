"""Compiling functions to machine code, once per machine.

Numba compiles what `compiled` decorates for the types that are given, and for no others: a call with other types raises
a TypeError (`arguments`), so that nothing is ever compiled in a control cycle. The machine code is kept beside the
source, or, where that folder is read-only, in the user's cache folder; the environment variable ``NUMBA_CACHE_DIR``
names another one. It is made anew where a file of that folder, Numba, or the processor is another one.

Without ``fastmath`` sums are taken in the order in which they are written: the same bits in every run.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any, TypeVar

import numba
import numpy as np
from numba import types
from numba.core.caching import InTreeCacheLocator, UserProvidedCacheLocator, UserWideCacheLocator
from numba.extending import intrinsic

from wbc_controller.arguments import Borrowed, BorrowedBytes

_log = logging.getLogger(__name__)
_Function = TypeVar("_Function", bound=Callable[..., Any])

INTEGER, FLAG, NUMBER = types.int64, types.boolean, types.float64
#: Arrays that are only read: without gaps, row by row, and any, as they lie in messages, too.
VECTOR = Borrowed(types.float64, 1, "C", readonly=True)
ROWS = Borrowed(types.float64, 2, "C", readonly=True)
ANY_VECTOR = Borrowed(types.float64, 1, "A", readonly=True, aligned=False)
ANY_MATRIX = Borrowed(types.float64, 2, "A", readonly=True, aligned=False)
INDICES = Borrowed(types.int64, 1, "C", readonly=True)
SIGN_ROWS = Borrowed(types.int8, 2, "C", readonly=True)
#: A `bytes` object.
BYTES = BorrowedBytes(types.uint8, 1, "C", readonly=True)
#: Arrays that are written.
VECTOR_OUT = Borrowed(types.float64, 1, "C")
ROWS_OUT = Borrowed(types.float64, 2, "C")
ANY_MATRIX_OUT = Borrowed(types.float64, 2, "A")

#: The most entries that a table has.
_MOST_ENTRIES = 32
#: Kinds of numbers of the arrays in a table; 0 is an integer in place of an array.
_NUMBERS, _INTEGERS, _SMALL_INTEGERS = 1, 2, 3
_KINDS = {np.dtype(np.float64): _NUMBERS, np.dtype(np.int64): _INTEGERS, np.dtype(np.int8): _SMALL_INTEGERS}
#: What `Bound` gives.
TABLE = Borrowed(types.int64, 1, "C", readonly=True)


@cache
def _hash(files: tuple[tuple[Path, int, int], ...]) -> str:
    """A hash of what is in files, by path, time and size."""
    return sha256(b"".join(sha256(path.read_bytes()).digest() for path, _, _ in files)).hexdigest()


class _WholeFolder:
    """Where compiled code is kept: it is that of all modules beside its own, as it contains functions of theirs."""

    _py_file: str

    def get_disambiguator(self) -> str:
        """Part of the files' names: older code cannot read what the types of arguments are in newer files."""
        return f"{super().get_disambiguator()}-borrowed"  # type: ignore[misc]  # of the locator beside it

    def get_source_stamp(self) -> str:
        paths = sorted({Path(self._py_file), *Path(__file__).parent.rglob("*_kernels.py")})
        return _hash(tuple((path, path.stat().st_mtime_ns, path.stat().st_size) for path in paths))


class AsTold(_WholeFolder, UserProvidedCacheLocator):  # type: ignore[misc]  # Numba has no types
    """In the folder that ``NUMBA_CACHE_DIR`` names."""


class BesideTheSource(_WholeFolder, InTreeCacheLocator):  # type: ignore[misc]
    """In ``__pycache__``."""


class OfTheUser(_WholeFolder, UserWideCacheLocator):  # type: ignore[misc]
    """In the user's cache folder."""


_LOCATORS = ",".join(f"{__name__}.{kind.__name__}" for kind in (AsTold, BesideTheSource, OfTheUser))
_pending: list[tuple[Any, tuple[types.Type, ...]]] = []
_nowhere_kept: list[str] = []  # why functions cannot be kept for the next start


def compiled(*arguments: types.Type) -> Callable[[_Function], _Function]:
    """Compile a function for arguments of these types, when `compile_all` is called.

    Until then its name in its module is Numba's dispatcher, of which `as_part` makes parts of others. From then on it
    is the machine code, which takes arguments by position alone.

    Args:
        *arguments: the types of its arguments, in order.
    """

    def register(function: _Function) -> _Function:
        others, numba.config.CACHE_LOCATOR_CLASSES = numba.config.CACHE_LOCATOR_CLASSES, _LOCATORS
        try:
            dispatcher = numba.njit(cache=True, error_model="numpy")(function)
        except RuntimeError as error:  # no folder to keep it in can be written
            _nowhere_kept.append(str(error))
            dispatcher = numba.njit(error_model="numpy")(function)
        finally:
            numba.config.CACHE_LOCATOR_CLASSES = others
        _pending.append((dispatcher, arguments))
        return dispatcher  # type: ignore[no-any-return]

    return register


#: A function that compiled functions call; it becomes a part of them.
part: Callable[[_Function], _Function] = numba.njit(error_model="numpy")


_plain: dict[Any, Any] = {}  # the Python function of each machine code


def as_part(function: _Function) -> _Function:
    """A compiled function as a part of others."""
    plain: _Function = _plain.get(function) or function.py_func  # type: ignore[attr-defined]  # of Numba's dispatcher
    return part(plain)


class Bound:
    """Numbers and arrays that a compiled function works on in every cycle, in a table.

    Arguments are collected by Python and compared with their types in every call. A table holds the addresses of arrays
    that stay for good, and beside each the array's size and type. `vector`, `matrix`, `indices` and `signs` make arrays
    of them again, and compare the size and type with what the compiled function expects. The arrays live as long as the
    table's owner.

    Attributes:
        table: integers as they are, and addresses of arrays, in the order given; in its second half, for each of these
            entries, 4 times the number of elements plus the kind of number, 0 for an integer, (2 * `_MOST_ENTRIES`,).
    """

    def __init__(self, *parts: int | np.ndarray) -> None:
        """Make a table.

        Raises:
            ValueError: if an array does not lie in memory row by row, or there are more parts than a table has entries.
            TypeError: if an array holds other numbers than compiled functions read.
        """
        if len(parts) > _MOST_ENTRIES:
            raise ValueError(f"a table of {len(parts)} parts; it has at most {_MOST_ENTRIES} entries")
        self._arrays = tuple(part for part in parts if isinstance(part, np.ndarray))
        self.table = np.zeros(2 * _MOST_ENTRIES, dtype=np.int64)
        for i, part in enumerate(parts):
            if not isinstance(part, np.ndarray):
                self.table[i] = part
                continue
            if not part.flags.c_contiguous:
                raise ValueError(f"an array of shape {part.shape} does not lie in memory row by row")
            if part.dtype not in _KINDS:
                raise TypeError(f"an array of {part.dtype}; compiled functions read float64, int64 and int8")
            self.table[i] = part.__array_interface__["data"][0]
            self.table[_MOST_ENTRIES + i] = 4 * part.size + _KINDS[part.dtype]
        self.table.setflags(write=False)


def _pointer(kind: types.Type) -> Any:
    """A function that turns an address into a pointer to numbers of a kind."""

    @intrinsic  # type: ignore[untyped-decorator]  # Numba has no types
    def pointer(typing_context: Any, address: Any) -> Any:
        def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return builder.inttoptr(arguments[0], context.get_value_type(signature.return_type))

        return types.CPointer(kind)(types.int64), code

    return pointer


_to_numbers, _to_indices, _to_signs = _pointer(types.float64), _pointer(types.int64), _pointer(types.int8)


@part
def _require(table: np.ndarray, entry: int, size: int, kind: int) -> None:
    """Require an entry of a table to be an array of a size and a kind of numbers.

    Raises:
        ValueError: if it is another array, or an integer.
    """
    if table[_MOST_ENTRIES + entry] != 4 * size + kind:
        raise ValueError("an array in a table has another size or type than the compiled function expects")


@part
def vector(table: np.ndarray, entry: int, size: int) -> Any:
    """Numbers at an entry of a table, (size,)."""
    _require(table, entry, size, _NUMBERS)
    return numba.carray(_to_numbers(table[entry]), (size,))


@part
def matrix(table: np.ndarray, entry: int, rows: int, columns: int) -> Any:
    """Numbers at an entry of a table, (rows, columns)."""
    _require(table, entry, rows * columns, _NUMBERS)
    return numba.carray(_to_numbers(table[entry]), (rows, columns))


@part
def first_rows(table: np.ndarray, entry: int, rows: int, columns: int) -> Any:
    """Numbers at an entry of a table, of which there may be more rows, (rows, columns)."""
    if table[_MOST_ENTRIES + entry] < 4 * rows * columns + _NUMBERS:
        raise ValueError("an array in a table has fewer rows than the compiled function expects")
    return numba.carray(_to_numbers(table[entry]), (rows, columns))


@part
def indices(table: np.ndarray, entry: int, size: int) -> Any:
    """Integers at an entry of a table, (size,)."""
    _require(table, entry, size, _INTEGERS)
    return numba.carray(_to_indices(table[entry]), (size,))


@part
def table_at(table: np.ndarray, entry: int) -> Any:
    """A table at an entry of another one."""
    _require(table, entry, 2 * _MOST_ENTRIES, _INTEGERS)
    return numba.carray(_to_indices(table[entry]), (2 * _MOST_ENTRIES,))


@part
def signs(table: np.ndarray, entry: int, rows: int, columns: int) -> Any:
    """Small integers at an entry of a table, (rows, columns)."""
    _require(table, entry, rows * columns, _SMALL_INTEGERS)
    return numba.carray(_to_signs(table[entry]), (rows, columns))


def compile_all() -> None:
    """Compile the registered functions, or load what was compiled before; say so if it takes long."""
    started, missing = time.monotonic(), bool(_nowhere_kept)
    slp, numba.config.SLP_VECTORIZE = numba.config.SLP_VECTORIZE, 1  # vectors of sums that stand side by side
    if _nowhere_kept:
        _log.warning("compiled at every start: %s; NUMBA_CACHE_DIR can name a folder", _nowhere_kept[0])
        _nowhere_kept.clear()
    for count, (dispatcher, arguments) in enumerate(_pending, 1):
        dispatcher.compile(arguments)
        # Python calls the machine code itself: it sees what it is given, and Numba's dispatcher would do so again.
        (found,) = dispatcher.overloads.values()
        dispatcher.py_func.__globals__[dispatcher.py_func.__name__] = found.entry_point
        _plain[found.entry_point] = dispatcher.py_func
        if sum(dispatcher.stats.cache_misses.values()):
            name = dispatcher.py_func.__name__
            if not missing:
                _log.warning("the controller's arithmetic is compiled for this processor, once: some seconds")
            missing = True
            _log.warning("compiled %s, %d of %d", name, count, len(_pending))
    if missing:
        _log.warning("compiled all in %.1f s", time.monotonic() - started)
    _pending.clear()
    numba.config.SLP_VECTORIZE = slp
