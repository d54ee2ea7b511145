"""A browser without a screen: it speaks viser's own messages over the connection that its page opens."""

import threading
from collections import Counter
from typing import Any

import msgspec
import numpy as np
import viser
import zstandard
from waiting import until
from websockets.sync.client import ClientConnection, connect

#: Where the camera of a page is; the server counts a page as there when it has said so.
CAMERA = {
    "wxyz": (1.0, 0.0, 0.0, 0.0), "position": (2.0, 0.0, 1.0), "fov": 0.8, "near": 0.01, "far": 100.0,
    "image_height": 600, "image_width": 800, "look_at": (0.0, 0.0, 0.5), "up_direction": (0.0, 0.0, 1.0),
}  # fmt: skip


def projected(points: Any, position: Any, look_at: Any, angle: float) -> Any:
    """Coordinates in the picture, in half heights of the picture from its centre to the right and up, (n, 2)."""
    forward = (look_at - position) / np.linalg.norm(look_at - position)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rays = points - position
    depth = rays @ forward
    assert depth.min() > 0.1
    return np.stack([rays @ right / depth, rays @ np.cross(right, forward) / depth], axis=1) / np.tan(angle / 2.0)


class Browser:
    """One page: it keeps what the server has told it of the scene and of the controls."""

    def __init__(self, port: int, *, path: str = "/", **options: Any) -> None:
        self.positions: dict[str, tuple[float, ...]] = {}
        self.turns: dict[str, tuple[float, ...]] = {}  # quaternions, w first
        self.controls: dict[str, dict[str, Any]] = {}
        self.updates = 0
        self.unknown: set[str] = set()  # messages that only other pages send: the server must not pass them on
        self.moved: Counter[str] = Counter()  # messages that moved something, by name
        self._connection: ClientConnection = connect(
            f"ws://127.0.0.1:{port}{path}", subprotocols=[f"viser-v{viser.__version__}"], max_size=None, **options
        )
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()
        self.say("ViewerCameraMessage", **CAMERA)

    def close(self) -> None:
        self._connection.close()
        self._thread.join()

    def cut(self) -> None:
        """Go without a word, as when the browser is killed."""
        self._connection.socket.close()

    def say(self, kind: str, **fields: Any) -> None:
        """Send one of viser's messages."""
        self._connection.send(msgspec.msgpack.encode({"type": kind, **fields}))

    def send(self, payload: bytes | str) -> None:
        """Send bytes, or a text message, as they are."""
        self._connection.send(payload)

    def uuid(self, label: str) -> str:
        """Identifier of the first control with a label."""
        return next(uuid for uuid, props in self.controls.items() if props.get("label") == label)

    def drag(self, handle: str, phase: str, position: Any = (), wxyz: Any = (1.0, 0.0, 0.0, 0.0)) -> None:
        """A handle is gripped (start), moved (update) or let go (end)."""
        name = f"/handles/{handle}"
        if phase == "update":
            self.say("TransformControlsUpdateMessage", name=name, wxyz=wxyz, position=tuple(map(float, position)))
        else:
            self.say(f"TransformControlsDrag{phase.capitalize()}Message", name=name)

    def pull(self, link: str, phase: str, start: Any, end: Any) -> None:
        """A link is pulled on."""
        self.say(
            "SceneNodeDragMessage", phase=phase, name=link, instance_index=None,
            start_position=tuple(map(float, start)), start_screen_pos=(0.5, 0.5),
            end_position=tuple(map(float, end)), end_screen_pos=(0.5, 0.5), button="left", modifier="shift",
        )  # fmt: skip

    def set(self, label: str, value: Any) -> None:
        """Press a button (True), or set a switch or a slider, by its label."""
        self.say("GuiUpdateMessage", uuid=self.uuid(label), updates={"value": value})

    def hold(self, label: str, frequency: float) -> None:
        """Hold a button, for one message."""
        self.say("GuiButtonHoldMessage", uuid=self.uuid(label), frequency=frequency)

    def until(self, condition: Any, patience: float = 20.0, what: str = "a condition") -> None:
        until(condition, what, patience)

    def _read(self) -> None:
        inflate = zstandard.ZstdDecompressor()
        try:
            for payload in self._connection:
                size = int.from_bytes(payload[8:16], "little")
                for message in msgspec.msgpack.decode(inflate.decompress(payload[16 : 16 + size]))["messages"]:
                    self._take(message)
        except Exception:  # noqa: S110 - the connection has been cut, which is what some tests do
            pass

    def _take(self, message: dict[str, Any]) -> None:
        kind = message["type"]
        if kind == "SetPositionMessage":
            self.positions[message["name"]] = tuple(message["position"])
            self.moved[message["name"]] += 1
        elif kind == "SetOrientationMessage":
            self.turns[message["name"]] = tuple(message["wxyz"])
            self.moved[message["name"]] += 1
        elif kind.startswith("Gui") and "props" in message and "uuid" in message:
            self.controls[message["uuid"]] = dict(message["props"])
        elif kind.startswith(("GuiForm", "FileTransfer", "Share")):
            self.unknown.add(kind)
        elif kind == "GuiUpdateMessage" and message["uuid"] in self.controls:
            self.controls[message["uuid"]] |= message["updates"]
            self.updates += 1
