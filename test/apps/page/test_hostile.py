"""Hostile browsers on the real server: the STOP buttons and handles of all other pages keep working."""

import logging
import threading
from contextlib import closing, suppress
from unittest.mock import Mock

import msgspec
import numpy as np
import pytest
from browser import Browser
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from page_rig import Rig
from websockets.exceptions import ConnectionClosed, InvalidStatus

from wbc_controller.apps.page.page_messages import MAX_MESSAGE_SIZE
from wbc_controller.apps.page.server import MAX_PAGES

pytestmark = pytest.mark.live


@pytest.fixture(scope="module")
def rig():
    with Rig(commands=True) as made:
        made.shared = []
        made.server.request_share_url = lambda: made.shared.append(1)  # in place of a tunnel by a public server
        yield made


@pytest.fixture
def pages(rig):
    """Yield a user's page and a hostile page."""
    made = [rig.open_page(), rig.open_page()]
    yield made
    for page in made:
        page.close()
    made[0].until(lambda: not rig.server.get_clients())


def press_stop(rig, page):
    """Press STOP on a page, and wait until it is sent."""
    rig.sent.clear()
    page.set("STOP", True)
    page.until(lambda: rig.said() == ["estop"])


def check_pages(rig, pages):
    """Check that STOP works on each page, snapshots are drawn, and each handle has a finite position."""
    for page in pages:
        press_stop(rig, page)
    drawn = rig.page.shown
    pages[0].until(lambda: rig.page.shown >= drawn + 2)
    for page in pages:
        values = [props.get("value", 0.0) for props in page.controls.values()]
        assert np.isfinite([value for value in values if not isinstance(value, str)]).all()
        handles = [name for name in page.positions if name.startswith("/handles")]
        assert "/handles/com" in handles
        for name in handles:
            assert np.isfinite(page.positions[name]).tolist() == [True] * 3
            assert np.linalg.norm(page.turns.get(name, (1.0, 0.0, 0.0, 0.0))) == pytest.approx(1.0, abs=2e-3)
    assert rig.thread.is_alive()
    assert rig.shared == []


def drag(**fields):
    place = {"name": "/handles/com", "wxyz": (1.0, 0.0, 0.0, 0.0), "position": (0.02, 0.0, 0.6)}
    return {"type": "TransformControlsUpdateMessage", **place, **fields}


def update(page, label="STOP", **updates):
    return {"type": "GuiUpdateMessage", "uuid": page.uuid(label), "updates": updates}


def test_large_message_ends_only_its_connection(rig, pages):
    user, hostile = pages
    hostile.say("GuiUpdateMessage", uuid="a" * MAX_MESSAGE_SIZE, updates={"value": True})
    user.until(lambda: len(rig.server.get_clients()) == 1)
    check_pages(rig, [user])


_scalars = st.one_of(
    st.none(), st.booleans(), st.integers(-(2**63), 2**64 - 1), st.floats(), st.text(max_size=8), st.binary(max_size=8)
)
_values = st.recursive(
    _scalars,
    lambda inner: st.lists(inner, max_size=5) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=8,
)
_FIELDS = ["value", "update_cb", "sync_cb", "removed", "uuid", "props", "is_button", "name", "position", "wxyz", "type"]
_numbers = st.lists(st.one_of(st.floats(), st.integers(-9, 9)), max_size=5)
_drags = st.fixed_dictionaries({"wxyz": _numbers | _values, "position": _numbers | _values})
_changes = st.dictionaries(st.sampled_from(_FIELDS), _values, max_size=2)


# Websockets uses `random` on another thread for its pings.
@pytest.mark.filterwarnings("ignore:Do not use the `random` module inside strategies")
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=30, derandomize=True)
@given(data=st.data())
def test_stop_and_handles_remain_for_other_pages(rig, pages, data):
    hostile = pages[1]
    kind = data.draw(st.sampled_from(["update", "drag", "any", "bytes"]))
    label = data.draw(st.sampled_from(["STOP", "weight", "left_foot", "Rotation rings"]))
    if kind == "bytes":
        payload = data.draw(st.binary(max_size=200))
    elif kind == "any":
        payload = msgspec.msgpack.encode(data.draw(_values))
    elif kind == "drag":
        payload = msgspec.msgpack.encode(drag(**data.draw(_drags)) | data.draw(_changes))
    else:
        payload = msgspec.msgpack.encode(update(hostile, label, **data.draw(_changes)) | data.draw(_changes))
    hostile.send(payload)
    check_pages(rig, pages)


def test_flood_delays_no_other_page(rig, pages):
    user, hostile = pages
    ended = threading.Event()

    def flood():
        with suppress(ConnectionClosed):  # disconnected without an answer to the pings
            while not ended.is_set():
                hostile.drag("com", "update", (np.nan, 0.0, 0.0))

    thread = threading.Thread(target=flood)
    thread.start()
    try:
        for _ in range(5):
            press_stop(rig, user)
    finally:
        ended.set()
        hostile.cut()
        thread.join()
    check_pages(rig, [user])


def test_first_dropped_message_of_a_page_is_logged(rig, pages, caplog):
    with caplog.at_level(logging.WARNING, "wbc_controller.apps.page.server"):
        for _ in range(3):
            pages[1].send(msgspec.msgpack.encode(drag(position=(0.25, 0.5))))
        check_pages(rig, pages)
    (record,) = caplog.records
    assert "message dropped: Expected `array` of length 3, got 2 - at `$.position`: " in record.getMessage()
    assert "'position': [0.25, 0.5]" in record.getMessage()
    assert "'type': 'TransformControlsUpdateMessage'" in record.getMessage()


def test_number_of_pages_is_limited(rig):
    opened_pages = [Browser(rig.gate.port) for _ in range(MAX_PAGES)]
    with pytest.raises(InvalidStatus) as refusal:
        Browser(rig.gate.port)
    assert refusal.value.response.status_code == 503
    for page in opened_pages:
        page.close()
    opened_pages[0].until(lambda: not rig.server.get_clients())


def test_pull_without_a_start_ends_with_its_page(rig, pages):
    """viser ends only pulls with a known start."""
    user = pages[0]
    other = rig.open_page()
    (number,) = set(rig.server.get_clients()) - set(sorted(rig.server.get_clients())[:2])
    other.pull("/robot/1/m1", "update", (0.0, 0.0, 0.8), (0.5, 0.0, 0.8))
    arrow = f"/pulls/{number}/arrow"
    user.until(lambda: rig.server.scene.get_handle_by_name(arrow) is not None)
    other.cut()
    user.until(lambda: rig.server.scene.get_handle_by_name(arrow) is None)


def test_read_only_page_has_no_controls_and_changes_nothing():
    shared = []
    with Rig(commands=False) as rig, closing(Browser(rig.gate.port)) as page, closing(Browser(rig.gate.port)) as other:
        rig.server.request_share_url = lambda: shared.append(1)
        page.until(lambda: len(rig.server.get_clients()) == 2 and rig.page.shown > 5 and other.controls)
        assert not {props.get("label") for props in page.controls.values()} & {"STOP", "Activate", "Hold", "weight"}
        assert not any(name.startswith("/handles") for name in page.positions)
        page.pull("/robot/1/m1", "end", (0.0, 0.0, 0.8), (0.5, 0.0, 0.8))
        page.say("GuiUpdateMessage", uuid="none", updates={"value": True})
        switch = page.uuid("Contact forces")
        messages = [{"type": kind} for kind in ("ShareUrlRequest", "ShareUrlDisconnect")]
        messages += [{"type": "GuiFormDirtyMessage", "uuid": switch}, update(page, "Contact forces", update_cb=[])]
        for message in (*messages, drag()):
            page.send(msgspec.msgpack.encode(message))
        page.set("Contact forces", False)  # a read-only page may change only its view
        other.until(lambda: other.controls[switch].get("value") is False)
        other.until(lambda: not rig.page.drawing._shown["contact_forces"])
        assert "update_cb" not in other.controls[switch]
        assert other.unknown == set()
        assert (shared, rig.sent) == ([], [])


def test_drawing_continues_after_an_error(rig, pages, monkeypatch, caplog):
    fails = Mock(side_effect=ValueError("a malformed message"))
    with monkeypatch.context() as patch, caplog.at_level(logging.ERROR, "wbc_controller.apps.page.page"):
        patch.setattr(rig.story, "snapshot", fails)
        pages[0].until(lambda: fails.call_count > 3)
    (record,) = caplog.records
    assert record.exc_info[1] is fails.side_effect
    check_pages(rig, pages)
