"""Allow-list of messages from a browser.

Each class describes one of viser's messages, with its names. Others are dropped before viser decodes them, because
viser applies any attribute in a message and forwards it to all pages.
"""

import math
import reprlib
from typing import Annotated, Any, Literal

import msgspec
import viser

#: Largest message of a browser, bytes; a larger one ends its connection. The page's own messages have less than 1000.
MAX_MESSAGE_SIZE = 4096
_NORM_TOLERANCE = 1.0e-3  # accepted difference of a quaternion's norm from 1
#: Decoding errors: invalid types, values or UTF-8, and excessive nesting.
_UNDECODABLE = (msgspec.MsgspecError, ValueError, RecursionError)

_Length = Annotated[float, msgspec.Meta(ge=-1.0e6, le=1.0e6)]  # coordinate, m; NaN violates both bounds
_Point = tuple[_Length, _Length, _Length]
_Component = Annotated[float, msgspec.Meta(ge=-1.001, le=1.001)]  # component of a unit quaternion (w, x, y, z)
_Quaternion = tuple[_Component, _Component, _Component, _Component]
#: Screen coordinate as a share of the picture, beyond 0 to 1 outside it.
_Share = Annotated[float, msgspec.Meta(ge=-1.0e9, le=1.0e9)]
_Screen = tuple[_Share, _Share]
_Distance = Annotated[float, msgspec.Meta(gt=0.0, le=1.0e9)]
_Pixels = Annotated[int, msgspec.Meta(ge=0, le=100_000)]
_Name = Annotated[str, msgspec.Meta(max_length=500)]
_Value = bool | Annotated[float, msgspec.Meta(ge=-1.0e9, le=1.0e9)] | Annotated[str, msgspec.Meta(max_length=500)]


class _Message(msgspec.Struct, tag_field="type", tag=True, forbid_unknown_fields=True):
    def __post_init__(self) -> None:
        wxyz = getattr(self, "wxyz", None)
        if wxyz is not None and not abs(math.hypot(*wxyz) - 1.0) <= _NORM_TOLERANCE:
            raise ValueError(f"`wxyz` has the norm {math.hypot(*wxyz):g}; required: 1")


class ViewerCameraMessage(_Message):
    """Camera of the page; lengths in m, angles in rad."""

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
    """Press of a button, or new value of a control."""

    uuid: _Name
    updates: _Updates


class GuiButtonHoldMessage(_Message):
    """Held button, repeated at a frequency, Hz."""

    uuid: _Name
    frequency: Annotated[float, msgspec.Meta(gt=0.0, le=100.0)]


class TransformControlsDragStartMessage(_Message):
    """Start of a drag of a handle."""

    name: _Name
    owner: Literal[""] = ""


class TransformControlsUpdateMessage(_Message):
    """Drag of a handle; pose in the world, m."""

    name: _Name
    wxyz: _Quaternion
    position: _Point
    owner: Literal[""] = ""


class TransformControlsDragEndMessage(TransformControlsDragStartMessage):
    """End of a drag of a handle."""


class SceneNodeDragMessage(_Message):
    """Pull on a link, with positions in the world, m."""

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


#: Messages of a read-only page, and of a page that may command.
WATCHING = ViewerCameraMessage | GuiUpdateMessage
COMMANDING = (
    WATCHING
    | GuiButtonHoldMessage
    | TransformControlsDragStartMessage
    | TransformControlsUpdateMessage
    | TransformControlsDragEndMessage
    | SceneNodeDragMessage
)


class AllowList:
    """Allow-list of messages to viser."""

    def __init__(self, *, commands: bool) -> None:
        self._decoder: msgspec.msgpack.Decoder[Any] = msgspec.msgpack.Decoder(COMMANDING if commands else WATCHING)
        self.gui: viser.GuiApi | None = None  # None before they exist

    def fault(self, payload: bytes | str) -> str:
        """Return the reason for a refusal; empty if the message is allowed."""
        if isinstance(payload, str):
            return f"text message {reprlib.repr(payload)}; valid: binary messages"
        try:
            message = self._decoder.decode(payload)
        except _UNDECODABLE as error:
            return f"{error}: {_excerpt(payload)}"
        if isinstance(message, GuiUpdateMessage):
            return self._value_fault(message.uuid, message.updates.value)
        if isinstance(message, GuiButtonHoldMessage):
            control = self._control(message.uuid)
            if not isinstance(control, viser.GuiButtonHandle) or message.frequency not in control._hold_callback_freqs:
                return f"GuiButtonHoldMessage: no button {reprlib.repr(message.uuid)} with this frequency"
        return ""

    def _control(self, uuid: str) -> Any:
        return None if self.gui is None else self.gui._gui_input_handle_from_uuid.get(uuid)

    def _value_fault(self, uuid: str, value: bool | float | str) -> str:
        control = self._control(uuid)
        match control:
            case None:
                return f"GuiUpdateMessage: unknown control {reprlib.repr(uuid)}"
            case viser.GuiButtonHandle():
                valid, valid_values = value is True, "True"
            case viser.GuiCheckboxHandle():
                valid, valid_values = isinstance(value, bool), "True or False"
            case viser.GuiSliderHandle():
                # The browser rounds to the decimals of the step.
                margin = 0.5 * 10.0**-control.precision
                valid = type(value) is float and control.min - margin <= value <= control.max + margin
                valid_values = f"{control.min:g} to {control.max:g}"
            case viser.GuiDropdownHandle():
                valid, valid_values = value in control.options, f"one of {reprlib.repr(control.options)}"
            case _:
                valid, valid_values = False, "none, this control takes no input"
        if valid:
            return ""
        return f"GuiUpdateMessage: updates.value of {control.label!r}: {reprlib.repr(value)}; valid: {valid_values}"


def _excerpt(payload: bytes) -> str:
    excerpt = reprlib.Repr()
    excerpt.maxdict, excerpt.maxlevel, excerpt.maxstring = 12, 3, 60
    try:
        message = msgspec.msgpack.decode(payload)
    except _UNDECODABLE:
        message = payload
    return excerpt.repr(message)[:500]
