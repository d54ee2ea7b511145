"""The calls on the path of a joint state to the torque message equal the documented ones.

`data_path.DEFINITION` defines the path. The data are tracked by object identity: the serialized message, then every
object returned by a function with the data in its arguments or callees. Objects are bytes, arrays, tuples, lists,
dataclasses, and objects of `inverse_dynamics` with their attributes.
"""

import dataclasses
import inspect
import sys
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import numpy as np
from data_path import MOST_CALLS, PATH

import wbc_controller
from wbc_controller.middleware.transports.memory import MemoryTransport
from wbc_controller.records import Mode

ROOT = Path(wbc_controller.__file__).parent
TRANSPORTS = "middleware/transports/"


@dataclasses.dataclass
class _Call:
    """An active call: its frame, the function's name, and whether it has the data and is on the path."""

    frame: FrameType
    name: str
    has_data: bool
    on_path: bool = False


class DataPath:
    """Tracks the data of one message by object identity through the calls of the package.

    Attributes:
        calls: names of the functions on the path by first call; complete after the cycle.
    """

    def __init__(self, payload: bytes) -> None:
        self.calls: list[str] = []
        self._data = {id(payload): payload}  # keeps the objects, so that no other object gets their identity
        self._active: list[_Call] = []
        self._began: list[str] = []
        self._found: set[str] = set()
        self._sent = False

    def profile(self, frame: FrameType, event: str, value: Any) -> None:
        """Process an event of `sys.setprofile`."""
        code = frame.f_code
        file = Path(code.co_filename)
        if self._sent or event not in ("call", "return") or not file.is_relative_to(ROOT):
            return
        if file.name.endswith("_kernels.py"):  # compiled: its frame has no variables
            return
        if event == "call":
            name = f"{file.relative_to(ROOT).as_posix()}:{code.co_qualname}"
            has_data = any(self._is_data(frame.f_locals[each]) for each in _arguments(code))
            self._began.append(name)
            self._active.append(_Call(frame, name, has_data))
            if has_data and name.startswith(TRANSPORTS):
                self._end()
        elif self._active and self._active[-1].frame is frame:
            call = self._active.pop()
            makes = (call.has_data or self._is_data(value)) and self._add(value)
            stores = call.has_data and value is None and _returns_nothing(file, code.co_qualname)
            if makes and self._active:
                self._active[-1].has_data = True
            if makes or stores or call.on_path:
                self._found.add(call.name)
                if self._active:
                    self._active[-1].on_path = True

    def _end(self) -> None:
        """End at the call of the transport that sends the torque message."""
        self._sent = True
        self._found.update(call.name for call in self._active[1:])  # the first call is the loop's
        self.calls = [name for name in dict.fromkeys(self._began) if name in self._found and not _is_omitted(name)]

    def _is_data(self, value: Any) -> bool:
        return id(value) in self._data or (isinstance(value, tuple | list) and any(id(v) in self._data for v in value))

    def _add(self, value: Any) -> bool:
        """Add the data in a value; return whether there are any."""
        if isinstance(value, bytes) or (isinstance(value, np.ndarray) and value.size):
            found = True
        elif isinstance(value, tuple | list):
            found = any([self._add(part) for part in value])
        elif dataclasses.is_dataclass(value):
            found = any([self._add(getattr(value, field.name)) for field in dataclasses.fields(value)])
        else:
            found = _is_own(value)
            if found:
                self._data |= {id(part): part for part in getattr(value, "__dict__", {}).values() if _is_own(part)}
        if found:
            self._data[id(value)] = value
        return found


def _is_own(value: Any) -> bool:
    return type(value).__module__.startswith("wbc_controller.inverse_dynamics")


def _is_omitted(name: str) -> bool:
    """Return whether a function is part of the transport, a constructor or a comprehension."""
    return name.startswith(TRANSPORTS) or name.rpartition(".")[2].startswith(("__", "<"))


def _arguments(code: CodeType) -> tuple[str, ...]:
    """Return the names of a function's arguments, without ``self``."""
    count = code.co_argcount + code.co_kwonlyargcount + bool(code.co_flags & inspect.CO_VARARGS)
    names = code.co_varnames[:count]
    return names[1:] if names[:1] == ("self",) else names


def _returns_nothing(file: Path, qualified_name: str) -> bool:
    function: Any = sys.modules[".".join(["wbc_controller", *file.relative_to(ROOT).with_suffix("").parts])]
    for name in qualified_name.split("."):
        function = getattr(function, name, None)
    return getattr(function, "__annotations__", {}).get("return", "") in (None, "None")


def test_a_joint_state_passes_the_documented_calls(bench):
    robot = bench("g1")
    received: list[bytes] = []
    (topic,) = [topic for topic in robot.topics if topic.key == "joint_states"]
    MemoryTransport(robot.bus).subscribe(topic, received.append)
    robot.cycle(3)
    robot.activate()
    robot.cycle(20)
    robot.give_state()
    path = DataPath(received[-1])
    sys.setprofile(path.profile)
    try:
        report = robot.loop.cycle()
    finally:
        sys.setprofile(None)
    assert report.mode is Mode.ACTIVE
    assert path.calls == list(PATH), "edit docs/data_path.py, then run: make docs"
    assert len(PATH) <= MOST_CALLS
