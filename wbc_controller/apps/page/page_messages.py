"""The messages that a browser may send to the page's server: an allow-list of types, fields and values.

Each class below describes one of viser's messages, with viser's name and field names. A message that matches none of
them is dropped before viser decodes it: viser applies any attribute that a message names, and forwards it to all pages.
"""

from __future__ import annotations

import math
import reprlib
from typing import Annotated, Any, Literal

import msgspec
import viser

#: Largest message of a browser, bytes; a larger one ends its connection. The page's own have less than 1 000.
LARGEST = 4096
#: Difference of the norm of a quaternion from 1 that is accepted.
_NORM_TOLERANCE = 1.0e-3
#: Errors of the decoder: other types or values, invalid UTF-8, and too many levels.
_UNDECODABLE = (msgspec.MsgspecError, ValueError, RecursionError)

#: A coordinate, m. NaN lies outside both bounds.
_Length = Annotated[float, msgspec.Meta(ge=-1.0e6, le=1.0e6)]
_Point = tuple[_Length, _Length, _Length]
#: Component of a unit quaternion (w, x, y, z).
_Component = Annotated[float, msgspec.Meta(ge=-1.001, le=1.001)]
_Quaternion = tuple[_Component, _Component, _Component, _Component]
#: Coordinate on the screen, as a share of the picture; outside the picture, it is beyond 0 to 1.
_Share = Annotated[float, msgspec.Meta(ge=-1.0e9, le=1.0e9)]
_Screen = tuple[_Share, _Share]
_Distance = Annotated[float, msgspec.Meta(gt=0.0, le=1.0e9)]
_Pixels = Annotated[int, msgspec.Meta(ge=0, le=100_000)]
_Name = Annotated[str, msgspec.Meta(max_length=500)]
_Value = bool | Annotated[float, msgspec.Meta(ge=-1.0e9, le=1.0e9)] | Annotated[str, msgspec.Meta(max_length=500)]


class _Message(msgspec.Struct, tag_field="type", tag=True, forbid_unknown_fields=True):
    def __post_init__(self) -> None:
        """Check the norm of the quaternion, if the message has one."""
        wxyz = getattr(self, "wxyz", None)
        if wxyz is not None and not abs(math.hypot(*wxyz) - 1.0) <= _NORM_TOLERANCE:
            raise ValueError(f"`wxyz` has the norm {math.hypot(*wxyz):g}, not 1")


class ViewerCameraMessage(_Message):
    """The camera of the page; lengths in m, angles in rad."""

    wxyz: _Quaternion
    position: _Point
    fov: Annotated[float, msgspec.Meta(gt=0.0, lt=math.pi)]
    near: _Distance
    far: _Distance
    image_height: _Pixels
    image_width: _Pixels
    look_at: _Point
    up_direction: _Point


class _Updates(msgspec.Struct, forbid_unknown_fields=True):
    value: _Value


class GuiUpdateMessage(_Message):
    """A button is pressed, or a switch, slider or drop-down list has a new value; nothing else of it may change."""

    uuid: _Name
    updates: _Updates


class TransformControlsDragStartMessage(_Message):
    """A handle is gripped."""

    name: _Name
    owner: Literal[""] = ""


class TransformControlsUpdateMessage(_Message):
    """A handle is dragged; its pose in the world, in m."""

    name: _Name
    wxyz: _Quaternion
    position: _Point
    owner: Literal[""] = ""


class TransformControlsDragEndMessage(_Message):
    """A handle is released."""

    name: _Name
    owner: Literal[""] = ""


class SceneNodeDragMessage(_Message):
    """A link is pulled on; positions in the world, in m."""

    phase: Literal["start", "update", "end"]
    name: _Name
    instance_index: None
    start_position: _Point
    start_screen_pos: _Screen
    end_position: _Point
    end_screen_pos: _Screen
    button: Literal["left"]
    modifier: Literal["shift"]
    owner: Literal[""] = ""


#: Messages of a page that watches, and of one that may command.
WATCHING = ViewerCameraMessage | GuiUpdateMessage
COMMANDING = (
    WATCHING
    | TransformControlsDragStartMessage
    | TransformControlsUpdateMessage
    | TransformControlsDragEndMessage
    | SceneNodeDragMessage
)


class AllowList:
    """Decides whether a message may reach viser."""

    def __init__(self, *, commands: bool) -> None:
        """Compile the list; `commands` is True if the page may command."""
        self._decoder: msgspec.msgpack.Decoder[Any] = msgspec.msgpack.Decoder(COMMANDING if commands else WATCHING)
        #: The controls of the page; None while the server is being opened, when no control exists.
        self.gui: viser.GuiApi | None = None

    def fault(self, payload: bytes | str) -> str:
        """Return the reason why a message is refused, with its type, field and value; empty if it is allowed."""
        if isinstance(payload, str):
            return f"a text message, not binary: {reprlib.repr(payload)}"
        try:
            message = self._decoder.decode(payload)
        except _UNDECODABLE as error:
            return f"{error}: {_excerpt(payload)}"
        if isinstance(message, GuiUpdateMessage):
            return self._value_fault(message.uuid, message.updates.value)
        return ""

    def _value_fault(self, uuid: str, value: bool | float | str) -> str:
        """Return the reason why a control may not have this value; empty if it may."""
        control: Any = None if self.gui is None else self.gui._gui_input_handle_from_uuid.get(uuid)
        match control:
            case None:
                return f"GuiUpdateMessage: unknown control {reprlib.repr(uuid)}"
            case viser.GuiButtonHandle():
                valid, wanted = value is True, "True"
            case viser.GuiCheckboxHandle():
                valid, wanted = isinstance(value, bool), "True or False"
            case viser.GuiSliderHandle():
                # The browser rounds to the decimals of the step.
                margin = 0.5 * 10.0**-control.precision
                valid = type(value) is float and control.min - margin <= value <= control.max + margin
                wanted = f"{control.min:g} to {control.max:g}"
            case viser.GuiDropdownHandle():
                valid, wanted = value in control.options, f"one of {reprlib.repr(control.options)}"
            case _:
                valid, wanted = False, "no value: this control takes no input"
        if valid:
            return ""
        return f"GuiUpdateMessage: updates.value of {control.label!r}: {reprlib.repr(value)}; valid: {wanted}"


def _excerpt(payload: bytes) -> str:
    """A message for the log, with every long part shortened."""
    excerpt = reprlib.Repr()
    excerpt.maxdict, excerpt.maxlevel, excerpt.maxstring = 12, 3, 60
    try:
        message = msgspec.msgpack.decode(payload)
    except _UNDECODABLE:
        message = payload
    return excerpt.repr(message)[:500]
