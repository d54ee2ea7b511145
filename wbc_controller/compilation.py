"""Compilation of kernels with Numba, cached on disk.

A kernel is a function in a file `*_kernels.py`, compiled for the types of its annotations:

::

    class Bounds(Struct):
        lower: Vector
        upper: Vector

    @compiled
    def clip(bounds: Bounds, values: Vector, out: OutVector) -> None: ...

Kernels are compiled on import; a call with other types raises a TypeError. Of concurrent processes one compiles.
Without ``fastmath`` all runs give the same bits.

``NUMBA_DISABLE_JIT=1`` turns kernels into Python functions, for breakpoints and coverage. ``NUMBA_BOUNDSCHECK=1`` adds
bounds checks. ``NUMBA_CACHE_DIR`` is the cache folder; default: the package's ``__pycache__``, or the user's cache
folder if the package is read-only.
"""

import contextlib
import inspect
import logging
import os
import threading
import time
from collections.abc import Callable, Iterator
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, TypeAlias, TypeVar, get_type_hints

import numba
import numpy as np
import numpy.typing as npt
from numba import types
from numba.experimental import structref

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

_Reals: TypeAlias = npt.NDArray[np.float64]
_Integers: TypeAlias = npt.NDArray[np.int64]
#: Input arrays, with their types in Numba: contiguous, strided, integers.
Vector: TypeAlias = Annotated[_Reals, types.Array(types.float64, 1, "C", readonly=True)]
Matrix: TypeAlias = Annotated[_Reals, types.Array(types.float64, 2, "C", readonly=True)]
StridedVector: TypeAlias = Annotated[_Reals, types.Array(types.float64, 1, "A", readonly=True, aligned=False)]
Indices: TypeAlias = Annotated[_Integers, types.Array(types.int64, 1, "C", readonly=True)]
IndexMatrix: TypeAlias = Annotated[_Integers, types.Array(types.int64, 2, "C", readonly=True)]
#: Output arrays.
OutIndices: TypeAlias = Annotated[_Integers, types.Array(types.int64, 1, "C")]
OutVector: TypeAlias = Annotated[_Reals, types.Array(types.float64, 1, "C")]
OutMatrix: TypeAlias = Annotated[_Reals, types.Array(types.float64, 2, "C")]
Signs: TypeAlias = Annotated[npt.NDArray[np.int8], types.Array(types.int8, 2, "C")]

if TYPE_CHECKING:
    from typing_extensions import dataclass_transform

    _Proxy = object
else:
    #: Without compilation the proxy would recurse endlessly.
    _Proxy = object if numba.config.DISABLE_JIT else structref.StructRefProxy

    def dataclass_transform(**_):
        """Return a decorator without effect."""
        return lambda cls: cls


_log = logging.getLogger(__name__)
_Function = TypeVar("_Function", bound=Callable[..., Any])
_PACKAGE = Path(__file__).resolve().parent
_SCALARS = {float: types.float64, complex: types.complex128, int: types.int64, bool: types.boolean}
_SLOW = 1.0  # compilation time that causes a warning, s
_compiled_names: list[str] = []  # compiled or loaded functions

#: Decorator of a function compiled into its callers.
part: Callable[[_Function], _Function] = numba.njit(error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)


@part
def copy(values: _Reals, out: _Reals) -> None:
    """Copy a vector, (n,), to the beginning of another one, without a check of sizes.

    A slice assignment checks them, but compiles for seconds.
    """
    for i in range(len(values)):
        out[i] = values[i]


@part
def copy_rows(values: _Reals, out: _Reals) -> None:
    """Copy a matrix, (m, n), as `copy`."""
    for i in range(len(values)):
        for j in range(values.shape[1]):
            out[i, j] = values[i, j]


def compiled(function: _Function) -> _Function:
    """Compile a function for the types of its annotations: numbers, arrays and structs."""
    if numba.config.DISABLE_JIT:
        return function
    hints = get_type_hints(function, include_extras=True)
    arguments = [hints[name] for name in inspect.signature(function).parameters]
    for argument in arguments:
        if isinstance(argument, type) and issubclass(argument, Struct):
            argument._allocator()
    dispatcher: _Function = _compile(function, [_numba_type(argument) for argument in arguments])
    return dispatcher


@dataclass_transform(kw_only_default=True)
class Struct(_Proxy):
    """Immutable record of numbers, arrays and structs for kernels. Kernels may write into arrays of `Out…` types."""

    NumbaType: ClassVar[Any]
    _numba_type_: ClassVar[Any]  # read by Numba
    _fields: ClassVar[dict[str, Any]]
    _allocate: ClassVar[Any] = None

    def __init_subclass__(cls) -> None:
        """Create the Numba type."""
        hints = get_type_hints(cls, include_extras=True)
        cls._fields = {name: _numba_type(hints[name]) for name in cls.__annotations__}
        # The cache on disk finds the type by its qualified name.
        names = {"__module__": cls.__module__, "__qualname__": f"{cls.__qualname__}.NumbaType"}
        cls.NumbaType = structref.register(type(cls.__name__, (types.StructRef,), names))
        cls._numba_type_ = cls.NumbaType(list(cls._fields.items()))
        if not numba.config.DISABLE_JIT:
            structref.define_boxing(cls.NumbaType, cls)

    if not TYPE_CHECKING:

        def __new__(cls, **fields):
            """Create a struct, or raise a TypeError for missing, unknown or wrong fields."""
            if fields.keys() != cls._fields.keys():
                raise TypeError(f"{cls.__name__} has the fields {[*cls._fields]}, got {[*fields]}")
            for name, kind in cls._fields.items():
                if isinstance(kind, types.Array):
                    _require_array(f"{cls.__name__}.{name}", fields[name], kind)
            if numba.config.DISABLE_JIT:
                struct = object.__new__(cls)
            else:
                struct = cls._allocator()(*(fields[name] for name in cls._fields))
            struct.__dict__.update(fields)
            return struct

        def __setattr__(self, name, value):
            if name in self._fields:
                raise AttributeError(f"{type(self).__name__}.{name} is read-only; create a new struct")
            super().__setattr__(name, value)

    @classmethod
    def _allocator(cls) -> Any:
        if cls._allocate is None:
            name, fields = f"allocate_{cls.__name__}", ", ".join(cls._fields)
            lines = [f"def {name}({fields}):", "    struct = new(kind)"]
            lines += [f"    struct.{field} = {field}" for field in cls._fields] + ["    return struct"]
            scope = {"__name__": cls.__module__, "new": structref.new, "kind": cls._numba_type_}
            # Numba derives the cache path from the file name: that of the struct's module.
            exec(compile("\n".join(lines), inspect.getfile(cls), "exec"), scope)  # noqa: S102 - no input from outside
            cls._allocate = _compile(scope[name], list(cls._fields.values()))
        return cls._allocate


def _numba_type(annotation: Any) -> Any:
    if isinstance(annotation, type) and issubclass(annotation, Struct):
        return annotation._numba_type_
    return annotation.__metadata__[0] if hasattr(annotation, "__metadata__") else _SCALARS.get(annotation, annotation)


def _require_array(name: str, array: Any, kind: Any) -> None:
    found = isinstance(array, np.ndarray) and array.ndim == kind.ndim and array.dtype == str(kind.dtype)
    if not (found and (kind.layout == "A" or array.flags.c_contiguous) and (array.flags.writeable or not kind.mutable)):
        layout, got = "strided" if kind.layout == "A" else "contiguous", repr(array)
        if isinstance(array, np.ndarray):
            flags = [name for name in ("c_contiguous", "writeable") if not getattr(array.flags, name)]
            got = f"{array.dtype} of shape {array.shape}" + (f", not {' and not '.join(flags)}" if flags else "")
        expected = f"a {layout} {'writable ' if kind.mutable else ''}{kind.dtype} array with {kind.ndim} axes"
        raise TypeError(f"{name} must be {expected}, got {got}")


def _compile(function: Any, signature: list[Any]) -> Any:
    folder = _cache_folder()
    with _compilation_lock(folder, function.__name__):
        started, former = time.monotonic(), numba.config.CACHE_DIR
        numba.config.CACHE_DIR = str(folder or "")
        try:
            options = {"cache": folder is not None, "error_model": "numpy", "no_cfunc_wrapper": True}
            dispatcher = numba.njit(tuple(signature), **options)(function)
        finally:
            numba.config.CACHE_DIR = former
    _compiled_names.append(function.__name__)
    if folder is None or sum(dispatcher.stats.cache_misses.values()):
        _warn_once("compiling the kernels for this processor (once, 15 to 60 s of processor time)")
        seconds = time.monotonic() - started
        level = logging.WARNING if seconds >= _SLOW else logging.INFO
        _log.log(
            level, "compiled %s in %.1f s (%d of about %d)", function.__name__, seconds, len(_compiled_names), _total()
        )
    return dispatcher


@contextlib.contextmanager
def _compilation_lock(folder: Path | None, name: str) -> Iterator[None]:
    """Hold the lock of a function's compilation; wait for another process that holds it."""
    with contextlib.ExitStack() as stack:
        if folder is not None and fcntl is not None:
            try:
                folder.mkdir(exist_ok=True)
                file = stack.enter_context((folder / f"{name}.lock").open("w"))
                try:
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError:
                    # A process that loads a compiled function holds the lock for milliseconds only.
                    note = threading.Timer(_SLOW, _warn_once, ["waiting for another process that compiles the kernels"])
                    note.daemon = True
                    note.start()
                    fcntl.flock(file, fcntl.LOCK_EX)
                    note.cancel()
            except OSError as error:  # a read-only folder, or a network file system without locks
                _log.debug("%s is compiled without a lock: %s", name, error)
        yield  # closing the file releases the lock


@cache
def _cache_folder() -> Path | None:
    """Return the cache folder, with a hash of all kernel files in its name, or None if no candidate is writable."""
    sources = sorted([Path(__file__), *_PACKAGE.rglob("*_kernels.py")])
    name = f"kernels-{sha256(b''.join(path.read_bytes() for path in sources)).hexdigest()[:12]}"
    name += "-boundscheck" * bool(numba.config.BOUNDSCHECK)
    given = numba.config.CACHE_DIR
    candidates = [Path(given)] if given else [_PACKAGE / "__pycache__", Path.home() / ".cache" / "wbc_controller"]
    for folder in candidates:
        with contextlib.suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            if os.access(folder, os.W_OK):
                return folder / name
    _log.warning("%s is not writable: kernels are compiled at every start; set NUMBA_CACHE_DIR", candidates[-1])
    return None


@cache
def _warn_once(message: str) -> None:
    _log.warning(message)


@cache
def _total() -> int:
    texts = [path.read_text(encoding="utf-8") for path in _PACKAGE.rglob("*_kernels.py")]
    return sum(text.count("\n@compiled\n") + text.count("(Struct):\n") for text in texts)
