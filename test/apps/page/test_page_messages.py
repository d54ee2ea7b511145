"""Allow-list and rate limit of messages."""

import dataclasses
import typing
from types import SimpleNamespace

import browser
import msgspec
import pytest
import viser
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from viser import _messages as viser_messages

from wbc_controller.apps.page.page_messages import COMMANDING, WATCHING, AllowList
from wbc_controller.apps.page.server import RateLimit

CAMERA = {"type": "ViewerCameraMessage", **browser.CAMERA}
DRAG = {
    "type": "TransformControlsUpdateMessage", "name": "/handles/com", "wxyz": (1, 0, 0, 0), "position": (0, 0, 0.6),
}  # fmt: skip
PULL = {
    "type": "SceneNodeDragMessage", "phase": "update", "name": "/robot/1/m1", "instance_index": None,
    "start_position": (0, 0, 1), "start_screen_pos": (0.5, -0.1), "end_position": (0.1, 0, 1),
    "end_screen_pos": (1.2, 0.5), "button": "left", "modifier": "shift", "owner": "",
}  # fmt: skip
WATCHERS, COMMANDERS = ({each.__name__ for each in typing.get_args(union)} for union in (WATCHING, COMMANDING))


def fault(message, *, commands=True, gui=None):
    """Return the fault of a message to a page with the controls of `gui`."""
    allowed = AllowList(commands=commands)
    allowed.gui = gui
    return allowed.fault(msgspec.msgpack.encode(message))


@pytest.fixture(scope="module")
def gui():
    """Yield a control of each kind on the page, and a text field, on a server of viser."""
    server = viser.ViserServer("127.0.0.1", 0, verbose=False)
    yield SimpleNamespace(
        api=server.gui,
        button=server.gui.add_button("STOP"),
        switch=server.gui.add_checkbox("left_foot", True),
        slider=server.gui.add_slider("weight", 0.0, 4.0, 0.02, 1.0),
        choice=server.gui.add_dropdown("Speed", ("1 ×", "4 ×")),
        text=server.gui.add_text("name", ""),
    )
    server.stop()


def test_allowed_types():
    assert {"ViewerCameraMessage", "GuiUpdateMessage"} == WATCHERS
    drags = {f"TransformControls{part}Message" for part in ("DragStart", "Update", "DragEnd")}
    assert drags | {"SceneNodeDragMessage", "GuiButtonHoldMessage"} == COMMANDERS - WATCHERS


@pytest.mark.parametrize("allowed", typing.get_args(COMMANDING))
def test_fields_agree_with_viser(allowed):
    theirs = dataclasses.fields(getattr(viser_messages, allowed.__name__))
    assert [field.name for field in theirs] == list(allowed.__struct_fields__)


@pytest.mark.parametrize(("commands", "allowed"), [(False, WATCHERS), (True, COMMANDERS)])
def test_all_other_messages_of_viser_are_refused(commands, allowed):
    others = {each.__name__ for each in viser_messages.Message.get_subclasses()} - allowed
    assert {"ShareUrlRequest", "ShareUrlDisconnect", "FileTransferStartUpload", "GuiFormDirtyMessage"} <= others
    for name in others:
        assert fault({"type": name}, commands=commands) == f"Invalid value '{name}' - at `$.type`: {{'type': '{name}'}}"


@pytest.mark.parametrize("message", [DRAG, PULL, {"type": "TransformControlsDragStartMessage", "name": "/handles/com"}])
def test_read_only_page_cannot_drag(message):
    assert [fault(CAMERA), fault(CAMERA, commands=False), fault(message)] == ["", "", ""]
    assert fault(message, commands=False).startswith(f"Invalid value '{message['type']}' - at `$.type`")


NAN, INFINITE = float("nan"), float("inf")
BAD = [
    (DRAG, {"position": (0, 0)}, "Expected `array` of length 3, got 2 - at `$.position`"),
    (DRAG, {"position": (0, 0, NAN)}, "- at `$.position[2]`"),
    (DRAG, {"position": (0, 0, INFINITE)}, "- at `$.position[2]`"),
    (DRAG, {"position": (0, 0, 2**63)}, "- at `$.position[2]`"),
    (DRAG, {"position": None}, "- at `$.position`"),
    (DRAG, {"wxyz": (0, 0, 0, 0)}, "`wxyz` has the norm 0; required: 1"),
    (DRAG, {"wxyz": (NAN, 0, 0, 0)}, "- at `$.wxyz[0]`"),
    (DRAG, {"wxyz": (1, 0, 0)}, "Expected `array` of length 4, got 3 - at `$.wxyz`"),
    (DRAG, {"name": "/" * 501}, "- at `$.name`"),
    (DRAG, {"excluded_self_client": 0}, "Object contains unknown field `excluded_self_client`"),
    (CAMERA, {"fov": NAN}, "- at `$.fov`"),
    (CAMERA, {"image_width": 10**6}, "- at `$.image_width`"),
    (PULL, {"phase": "begin"}, "- at `$.phase`"),
    (PULL, {"instance_index": 0}, "- at `$.instance_index`"),
    (PULL, {"end_position": (0, NAN, 0)}, "- at `$.end_position[1]`"),
    (PULL, {"modifier": "alt"}, "- at `$.modifier`"),
]


@pytest.mark.parametrize(("message", "change", "reason"), BAD)
def test_each_field_is_checked(message, change, reason):
    said = fault(message | change)
    assert reason in said
    assert f"'type': '{message['type']}'" in said


@pytest.mark.parametrize("field", sorted(set(PULL) - {"type", "owner"}))
def test_missing_fields_are_refused(field):
    assert f"missing required field `{field}`" in fault({key: value for key, value in PULL.items() if key != field})


@pytest.mark.parametrize(
    "payload",
    [
        b"",
        b"\xa2\xff\xfe",  # invalid UTF-8
        b"\xdd\xff\xff\xff\xff",  # an array of 4 294 967 295 elements without content
        b"\x91" * 4000 + b"\xc0",  # 4 000 levels
        b"\x81\xa4type" * 600 + b"\xc0",
        "a text message",
        msgspec.msgpack.encode([1, 2]),
        msgspec.msgpack.encode({"type": ["GuiUpdateMessage"]}),
    ],
)
def test_invalid_payloads(payload):
    assert AllowList(commands=True).fault(payload) != ""


@hypothesis_settings(max_examples=300, derandomize=True)
@given(
    st.binary(max_size=100)
    | st.builds(
        lambda message, at, byte: message[:at] + byte + message[at + 1 :],
        st.sampled_from([msgspec.msgpack.encode(each) for each in (CAMERA, DRAG, PULL)]),
        st.integers(0, 200),
        st.binary(max_size=2),
    )
)
def test_any_payload_is_checked_without_an_exception(payload):
    if not AllowList(commands=True).fault(payload):
        assert msgspec.msgpack.decode(payload)["type"] in COMMANDERS


def value_fault(gui, control, updates):
    message = {"type": "GuiUpdateMessage", "uuid": getattr(control, "_impl", control).uuid, "updates": updates}
    return fault(message, commands=False, gui=gui.api)


@pytest.mark.parametrize(
    ("name", "valid", "invalid"),
    [
        ("button", [True], [False, 1, "STOP", 1.0]),
        ("switch", [True, False], [1, 0.0, "off"]),
        ("slider", [0, 4, 1.5, 4.004], [True, "1", -0.1, 4.1, NAN, INFINITE, 1e300, 2**63]),
        ("choice", ["1 ×", "4 ×"], ["2 ×", "", 1, True]),
        ("text", [], ["a text", True]),
    ],
)
def test_values_of_controls(gui, name, valid, invalid):
    control = getattr(gui, name)
    assert [value_fault(gui, control, {"value": value}) for value in valid] == [""] * len(valid)
    assert "" not in [value_fault(gui, control, {"value": value}) for value in invalid]


@pytest.mark.parametrize("update", [{}, *({name: []} for name in ("update_cb", "removed", "is_button", "props")),
                                    {"value": True, "removed": True}, {"value": None}, None, []])  # fmt: skip
def test_only_values_of_controls_can_change(gui, update):
    assert value_fault(gui, gui.button, update) != ""


def test_held_buttons_and_refused_values(gui):
    held = gui.api.add_button("Walk")
    held.on_hold(lambda event: None, callback_hz=10.0)

    def hold_fault(control, frequency):
        message = {"type": "GuiButtonHoldMessage", "uuid": control._impl.uuid, "frequency": frequency}
        return fault(message, gui=gui.api)

    assert hold_fault(held, 10.0) == ""
    for control, frequency in ((held, 50.0), (held, NAN), (held, 1.0e3), (gui.button, 10.0), (gui.slider, 10.0)):
        assert "GuiButtonHoldMessage" in hold_fault(control, frequency)
    said = value_fault(gui, gui.slider, {"value": 7.5})
    assert said == "GuiUpdateMessage: updates.value of 'weight': 7.5; valid: 0 to 4"
    assert value_fault(gui, SimpleNamespace(uuid="none"), {"value": True}) == "GuiUpdateMessage: unknown control 'none'"


def test_burst_and_rate_limit():
    rate_limit = RateLimit(rate=100.0, burst=5.0)
    assert [rate_limit.wait(10.0) for _ in range(8)] == pytest.approx([0, 0, 0, 0, 0, 0.01, 0.02, 0.03])
    assert [rate_limit.wait(20.0) for _ in range(6)] == pytest.approx([0, 0, 0, 0, 0, 0.01])
    rate_limit = RateLimit(rate=100.0, burst=5.0)
    assert {rate_limit.wait(0.01 * i) for i in range(1000)} == {0.0}
