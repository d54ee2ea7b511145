"""What compiled functions take from Python: arrays and bytes, seen to be of their type, then read in place.

Numba's dispatcher looks up the type of each argument and what was compiled for it, and its runtime counts each array.
That takes five times as long as the call itself (``python benchmarks/calls.py``). A function that is compiled for one
type of each argument needs none of it: its arguments are compared with these types, and borrowed, as the caller holds
them until it returns.
"""

from __future__ import annotations

import ctypes
import sys
from typing import Any

import llvmlite.binding  # part of Numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.datamodel import models, register_default
from numba.extending import NativeValue, unbox
from numba.np import numpy_support
from numba.np.arrayobj import populate_array

_FLAG, _BYTE, _INT, _LONG = ir.IntType(1), ir.IntType(8), ir.IntType(32), ir.IntType(64)
_POINTER = _BYTE.as_pointer()
#: Where Python and NumPy keep the fields of their objects, bytes: part of their stable binary interfaces.
_TYPE, _SIZE, _CONTENT = 8, 16, 32  # the type of all objects; size and content of `bytes`
_DATA, _NDIM, _SHAPE, _STRIDES, _DTYPE, _FLAGS = 16, 24, 32, 40, 56, 64  # of an array
_ORDER, _NUMBER = 26, 28  # of its dtype
#: Flags of an array.
_ROW_BY_ROW, _ALIGNED, _WRITEABLE = 0x0001, 0x0100, 0x0400
#: Name by which machine code finds NumPy's class of arrays.
_NDARRAY = "wbc_controller_ndarray"
llvmlite.binding.add_symbol(_NDARRAY, id(np.ndarray))


class Borrowed(types.Array):  # type: ignore[misc]  # Numba has no types
    """Type of an array that a caller from Python holds."""


class BorrowedBytes(types.Bytes):  # type: ignore[misc]
    """Type of a `bytes` object that a caller from Python holds; nothing else that holds bytes is accepted."""


register_default(Borrowed)(models.ArrayModel)
register_default(BorrowedBytes)(models.ArrayModel)


def see_fields() -> None:
    """See that objects have their fields where compiled functions read them.

    Raises:
        ImportError: where this build of Python or release of NumPy has them elsewhere.
    """
    array, content = np.zeros((2, 3)), b"four"
    own, its, text = id(array), id(array.dtype), id(content)
    read, pointer, number = ctypes.c_int.from_address, ctypes.c_void_p.from_address, ctypes.c_ssize_t.from_address
    shape, strides = (pointer(own + place).value or own for place in (_SHAPE, _STRIDES))
    found = (
        [pointer(each + _TYPE).value for each in (own, text)],
        [pointer(own + _DATA).value, pointer(own + _DTYPE).value],
        [read(own + _NDIM).value, read(own + _FLAGS).value, read(its + _NUMBER).value],
        [number(place + 8 * i).value for place in (shape, strides) for i in range(2)],
        ctypes.string_at(its + _ORDER, 1),
        [number(text + _SIZE).value, ctypes.string_at(text + _CONTENT, 4)],
    )
    expected = (
        [id(np.ndarray), id(bytes)],
        [array.__array_interface__["data"][0], its],
        [2, array.flags.num, array.dtype.num],
        [*array.shape, *array.strides],
        b"=",
        [4, content],
    )
    if found != expected:
        raise ImportError(
            f"Python {sys.version} with NumPy {np.__version__} keeps arrays in another way than compiled functions "
            f"read them: {found} was found, expected {expected}"
        )


see_fields()


class _Object:
    """Reads the fields of a Python object in machine code."""

    def __init__(self, c: Any, address: Any) -> None:
        self._builder, self._first = c.builder, c.builder.bitcast(address, _POINTER)

    def place(self, offset: int) -> Any:
        """Address of a field."""
        return self._builder.gep(self._first, [_LONG(offset)])

    def read(self, offset: int, kind: Any = _POINTER) -> Any:
        """A field."""
        return self._builder.load(self._builder.bitcast(self.place(offset), kind.as_pointer()))

    def has(self, offset: int, number: Any) -> Any:
        """Whether a field is a number."""
        return self._builder.icmp_signed("==", self.read(offset, number.type), number)

    def is_a(self, name: str) -> Any:
        """Whether its type is the one with a name."""
        module = self._builder.module
        its = module.globals.get(name) or ir.GlobalVariable(module, _BYTE, name)
        return self._builder.icmp_unsigned("==", self.read(_TYPE), self._builder.bitcast(its, _POINTER))


def _refuse(c: Any, wrong: Any, what: str, obj: Any) -> None:
    """Raise a TypeError where something is wrong with an argument."""
    with c.builder.if_then(wrong, likely=False):
        c.pyapi.err_format("PyExc_TypeError", f"a compiled function takes {what}; it was given %R", obj)


@unbox(Borrowed)  # type: ignore[untyped-decorator]
def _array(kind: Borrowed, obj: Any, c: Any) -> NativeValue:
    """Borrow an array."""
    builder, array, dtype = c.builder, _Object(c, obj), numpy_support.as_dtype(kind.dtype)
    native = c.context.make_array(kind)(c.context, builder)
    asked = {_ALIGNED: kind.aligned, _ROW_BY_ROW: kind.layout == "C", _WRITEABLE: kind.mutable}
    flags = _INT(sum(flag for flag, wanted in asked.items() if wanted))
    accepted = cgutils.alloca_once_value(builder, _FLAG(0))
    with builder.if_then(array.is_a(_NDARRAY), likely=True):
        its = _Object(c, array.read(_DTYPE))
        right = [
            its.has(_NUMBER, _INT(dtype.num)),
            its.has(_ORDER, _BYTE(ord(dtype.byteorder))),
            array.has(_NDIM, _INT(kind.ndim)),
            builder.icmp_signed("==", builder.and_(array.read(_FLAGS, _INT), flags), flags),
        ]
        right = builder.and_(builder.and_(*right[:2]), builder.and_(*right[2:]))
        builder.store(right, accepted)
        with builder.if_then(right, likely=True):
            sizes = ir.ArrayType(_LONG, kind.ndim)
            shape, strides = (_Object(c, array.read(place)).read(0, sizes) for place in (_SHAPE, _STRIDES))
            data = builder.bitcast(array.read(_DATA), native.data.type)
            populate_array(native, data, shape, strides, dtype.itemsize, None)
    wrong = builder.not_(builder.load(accepted))
    words = {_ALIGNED: "aligned", _ROW_BY_ROW: "row by row", _WRITEABLE: "to be written"}
    what = ", ".join(word for flag, word in words.items() if asked[flag])
    _refuse(c, wrong, f"an array of {dtype} with {kind.ndim} axes{', ' * bool(what)}{what}", obj)
    return NativeValue(native._getvalue(), is_error=wrong)


@unbox(BorrowedBytes)  # type: ignore[untyped-decorator]
def _bytes(kind: BorrowedBytes, obj: Any, c: Any) -> NativeValue:
    """Borrow bytes."""
    builder, content = c.builder, _Object(c, obj)
    native = c.context.make_array(kind)(c.context, builder)
    right = content.is_a("PyBytes_Type")
    with builder.if_then(right, likely=True):
        data = builder.bitcast(content.place(_CONTENT), native.data.type)
        populate_array(native, data, [content.read(_SIZE, _LONG)], [_LONG(1)], 1, None)
    wrong = builder.not_(right)
    _refuse(c, wrong, "bytes", obj)
    return NativeValue(native._getvalue(), is_error=wrong)
