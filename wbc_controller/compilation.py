"""Compilation of kernels with Numba: explicit types from annotations, structs of named arrays, a cache on disk.

A kernel is a function in a file `*_kernels.py`. Its annotations are the types that it is compiled for:

::

    class Bounds(Struct):
        lower: Vector
        upper: Vector

    @compiled
    def clip(bounds: Bounds, values: Vector, out: OutVector) -> None: ...

It is compiled when its module is imported, never later: a call with other types raises a TypeError. Sums are taken in
the order in which they are written (no ``fastmath``), so that every run gives the same bits.

With ``NUMBA_DISABLE_JIT=1`` kernels are Python functions and structs plain objects, for breakpoints and coverage.
``NUMBA_BOUNDSCHECK=1`` adds bounds checks. ``NUMBA_CACHE_DIR`` names a folder for the compiled code; by default it is
in the package's ``__pycache__``, or, if that is read-only, in the user's cache folder.
"""

from __future__ import annotations

import inspect
import logging
import os
import time
from collections.abc import Callable
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias, TypeVar, get_type_hints

import numba
import numpy as np
from numba import types
from numba.experimental import structref

if TYPE_CHECKING:
    import numpy.typing as npt
    from typing_extensions import dataclass_transform

    Vector: TypeAlias = npt.NDArray[np.float64]
    Matrix: TypeAlias = Vector
    StridedVector: TypeAlias = Vector
    StridedMatrix: TypeAlias = Vector
    OutVector: TypeAlias = Vector
    OutMatrix: TypeAlias = Vector
    OutStridedMatrix: TypeAlias = Vector
    Indices: TypeAlias = npt.NDArray[np.int64]
    IndexMatrix: TypeAlias = Indices
    OutIndices: TypeAlias = Indices
    Signs: TypeAlias = npt.NDArray[np.int8]
    _Proxy = object
else:
    #: Arrays that a kernel reads: contiguous; with any strides; integers; signs.
    Vector = types.Array(types.float64, 1, "C", readonly=True)
    Matrix = types.Array(types.float64, 2, "C", readonly=True)
    StridedVector = types.Array(types.float64, 1, "A", readonly=True, aligned=False)
    StridedMatrix = types.Array(types.float64, 2, "A", readonly=True, aligned=False)
    Indices = types.Array(types.int64, 1, "C", readonly=True)
    IndexMatrix = types.Array(types.int64, 2, "C", readonly=True)
    #: Arrays that a kernel writes.
    OutIndices = types.Array(types.int64, 1, "C")
    OutVector = types.Array(types.float64, 1, "C")
    OutMatrix = types.Array(types.float64, 2, "C")
    OutStridedMatrix = types.Array(types.float64, 2, "A")
    Signs = types.Array(types.int8, 2, "C")

    #: A proxy owns memory that Numba allocates. Without compilation it would call itself endlessly.
    _Proxy = object if numba.config.DISABLE_JIT else structref.StructRefProxy

    def dataclass_transform(**_):
        """Return the decorator of type checkers."""
        return lambda cls: cls


_log = logging.getLogger(__name__)
_Function = TypeVar("_Function", bound=Callable[..., Any])
_PACKAGE = Path(__file__).resolve().parent
_SCALARS = {float: types.float64, int: types.int64, bool: types.boolean}

#: A function that kernels call. It is compiled as a part of them.
part: Callable[[_Function], _Function] = numba.njit(error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)


def compiled(function: _Function) -> _Function:
    """Compile a function for the types of its annotations: numbers, the arrays above, and structs."""
    if numba.config.DISABLE_JIT:
        return function
    hints = get_type_hints(function)
    arguments = [hints[name] for name in inspect.signature(function).parameters]
    for argument in arguments:
        if isinstance(argument, type) and issubclass(argument, Struct):
            argument._allocator()
    dispatcher: _Function = _compile(function, [_numba_type(argument) for argument in arguments])
    return dispatcher


@dataclass_transform(kw_only_default=True)
class Struct(_Proxy):
    """Named numbers, arrays and structs, which kernels read as attributes. Subclasses annotate the fields.

    Arrays are shared with the caller. Kernels may write into those of the `Out…` types; no field can be set again.
    """

    NumbaType: ClassVar[Any]
    numba_type: ClassVar[Any]
    _numba_type_: ClassVar[Any]
    _fields: ClassVar[dict[str, Any]]
    _allocate: ClassVar[Any] = None

    def __init_subclass__(cls) -> None:
        """Make the Numba type of the fields."""
        hints = get_type_hints(cls)
        cls._fields = {name: _numba_type(hints[name]) for name in cls.__annotations__}
        # As an attribute of the class it can be found by name, which the cache on disk requires.
        names = {"__module__": cls.__module__, "__qualname__": f"{cls.__qualname__}.NumbaType"}
        cls.NumbaType = structref.register(type(cls.__name__, (types.StructRef,), names))
        cls.numba_type = cls._numba_type_ = cls.NumbaType(list(cls._fields.items()))  # an attribute: faster calls
        if not numba.config.DISABLE_JIT:
            structref.define_boxing(cls.NumbaType, cls)

    if not TYPE_CHECKING:

        def __new__(cls, **fields):
            """Make a struct.

            Raises:
                TypeError: if a field is missing or unknown, or an array has another type than its annotation.
            """
            if fields.keys() != cls._fields.keys():
                raise TypeError(f"{cls.__name__} takes the fields {[*cls._fields]}, got {[*fields]}")
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
                raise AttributeError(f"{type(self).__name__}.{name} cannot be set again; make a new struct")
            super().__setattr__(name, value)

    @classmethod
    def _allocator(cls) -> Any:
        """Return the compiled function that allocates a struct from its fields."""
        if cls._allocate is None:
            name, fields = f"allocate_{cls.__name__}", ", ".join(cls._fields)
            lines = [f"def {name}({fields}):", "    struct = new(kind)"]
            lines += [f"    struct.{field} = {field}" for field in cls._fields] + ["    return struct"]
            scope = {"__name__": cls.__module__, "new": structref.new, "kind": cls.numba_type}
            # The file's name is that of the struct's module, next to which Numba caches the machine code.
            exec(compile("\n".join(lines), inspect.getfile(cls), "exec"), scope)  # noqa: S102 - no input from outside
            cls._allocate = _compile(scope[name], list(cls._fields.values()))
        return cls._allocate


def _numba_type(annotation: Any) -> Any:
    """Return the Numba type of an annotation."""
    if isinstance(annotation, type) and issubclass(annotation, Struct):
        return annotation.numba_type
    return _SCALARS.get(annotation, annotation)


def _require_array(name: str, array: Any, kind: Any) -> None:
    """Require an array of the type of a field.

    Raises:
        TypeError: if it is something else.
    """
    found = isinstance(array, np.ndarray) and array.ndim == kind.ndim and array.dtype == str(kind.dtype)
    if not (found and (kind.layout == "A" or array.flags.c_contiguous) and (array.flags.writeable or not kind.mutable)):
        layout = "strided" if kind.layout == "A" else "contiguous"
        raise TypeError(
            f"{name} takes a {layout} {'writable ' if kind.mutable else ''}{kind.dtype} array of {kind.ndim} axes, got "
            f"{describe(array)}"
        )


def describe(array: Any) -> str:
    """Describe an array in an error message."""
    if not isinstance(array, np.ndarray):
        return repr(array)
    flags = [name for name in ("c_contiguous", "writeable") if not getattr(array.flags, name)]
    return f"{array.dtype} of shape {array.shape}" + (f", not {' and not '.join(flags)}" if flags else "")


def _compile(function: Any, signature: list[Any]) -> Any:
    """Compile a function for one signature, or load its code from the cache; log a warning if that takes long."""
    started, former, folder = time.monotonic(), numba.config.CACHE_DIR, _cache_folder()
    numba.config.CACHE_DIR = str(folder or "")
    try:
        dispatcher = numba.njit(tuple(signature), cache=folder is not None, error_model="numpy", no_cfunc_wrapper=True)(
            function
        )
    finally:
        numba.config.CACHE_DIR = former
    if folder is None or sum(dispatcher.stats.cache_misses.values()):
        _announce()
        _log.info("compiled %s in %.1f s", function.__name__, time.monotonic() - started)
    return dispatcher


@cache
def _cache_folder() -> Path | None:
    """Return the folder of the compiled code, named by the sources of all kernels; None if none is writable.

    Numba compares only the file of a function with its cached code, which also contains functions of other files.
    """
    sources = sorted([Path(__file__), *_PACKAGE.rglob("*_kernels.py")])
    name = f"kernels-{sha256(b''.join(path.read_bytes() for path in sources)).hexdigest()[:12]}"
    name += "-boundscheck" * bool(numba.config.BOUNDSCHECK)
    given = numba.config.CACHE_DIR
    candidates = [Path(given)] if given else [_PACKAGE / "__pycache__", Path.home() / ".cache" / "wbc_controller"]
    for folder in candidates:
        if _is_writable(folder):
            return folder / name
    _log.warning("kernels are compiled at every start: %s is not writable; set NUMBA_CACHE_DIR", candidates[-1])
    return None


def _is_writable(folder: Path) -> bool:
    """Make a folder, and return True if files can be written into it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK)


@cache
def _announce() -> None:
    """Log once that the kernels are compiled."""
    _log.warning("the kernels are compiled for this processor, once: about half a minute")
