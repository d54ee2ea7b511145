"""Hostile recordings with valid checksums."""

import contextlib
import copy
import json
import struct
import tempfile
from collections.abc import Sequence
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Any

from hypothesis import strategies as st
from hypothesis.strategies import DrawFn, SearchStrategy

from wbc_controller.controller.cycle import ControlCycle
from wbc_controller.errors import InputRefused
from wbc_controller.middleware.codec import decode, encode, message
from wbc_controller.nodes.lockstep import Lockstep
from wbc_controller.recording.mcap_file import McapMessages, Topic
from wbc_controller.recording.recorder import Recorder
from wbc_controller.recording.recording_file import Recording
from wbc_controller.recording.replay.cycle_replay import Replay
from wbc_controller.recording.replay.recording_summary import explain_cycle, summarize
from wbc_controller.recording.report.run_data import make_run_data
from wbc_controller.settings.config import load
from wbc_controller.validation.fuzz.strategies import mutated_bytes, mutated_text
from wbc_controller.validation.fuzz.values import FLOATS, SCALARS, STRINGS

Messages = Sequence[tuple[Topic, int, bytes]]  # messages of a recording: topic, time in ns, payload
_CYCLES, _SOLVED = 60, 20  # cycles of the original run, and replayed cycles of a hostile one
_STRING = "std_msgs/msg/String"
#: Replacements of a value in JSON.
_VALUES: SearchStrategy[Any] = st.one_of(
    st.sampled_from((None, True, False, 0, -1, 1, 2**31, 2**63, 10**400, "", [], {}, [[]], [None], {"$map": [[1]]})),
    st.sampled_from(FLOATS),
    st.sampled_from(STRINGS),
    st.sampled_from(({"$mode": "x"}, {"$trajectory": []}, {"$record": "Fault"}, {"$float": "x"}, {"$array": "AA"})),
)


def record_run(robot: str, path: Path) -> None:
    """Record a short run: activation, motion, a refused request, and a stop."""
    settings = load(robot).replace({"recorder.seconds": 0.0}).settings
    requests = [("command", "fly"), ("update", "{limits: {acceleration: 200.0}}")]
    texts = {3: [("command", "activate")], 20: requests, _CYCLES - 3: [("command", "estop")]}  # by cycle
    with contextlib.closing(Recorder(settings, path, patient=True, name=robot)) as recorder:
        run = Lockstep(settings, recorder=recorder)
        for i in range(_CYCLES):
            for key, text in texts.get(i, ()):
                run.user.send_text(key, text)
            if i == 10:
                run.user.move(run.com())
            run.cycle()


@cache
def original(robot: str) -> tuple[dict[int, Topic], Messages]:
    """Return topics and messages of a short run."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        record_run(robot, path)
        file = McapMessages(path)
        messages = list(file)
    return file.topics, messages


@st.composite
def hostile_messages(draw: DrawFn, messages: Messages) -> Messages:
    """Draw messages with hostile changes."""
    result = list(messages)
    for _ in range(draw(st.sampled_from((1, 1, 1, 2, 3)))):
        kinds: dict[str, list[int]] = {}
        for i, (topic, _, _) in enumerate(result):
            kinds.setdefault(topic.name.rpartition("/")[2], []).append(i)
        at = draw(st.sampled_from(kinds[draw(st.sampled_from(sorted(kinds)))]))
        topic, time, payload = result[at]
        change = draw(st.integers(0, 19))
        if change == 0:
            del result[at]
        elif change == 1:
            result.insert(draw(st.integers(0, len(result))), result[at])
        elif change == 2:
            result[at] = topic, draw(st.sampled_from((0, 1, 2**62, 2**63 - 1))), payload
        else:
            result[at] = topic, time, draw(_hostile_payload(topic, payload))
        if not result:
            return messages
    return result


@st.composite
def _hostile_payload(draw: DrawFn, topic: Topic, payload: bytes) -> bytes:
    if draw(st.integers(0, 9)) == 0:
        return draw(mutated_bytes(payload))
    if topic.type == _STRING:
        try:
            text = str(decode(payload, _STRING).data)
        except InputRefused:  # changed before
            return draw(mutated_bytes(payload))
        return encode(message(_STRING, data=draw(_hostile_text(text))))
    if len(payload) < 12:
        return draw(mutated_bytes(payload))
    data = bytearray(payload)
    end = len(data) - 8 * draw(st.integers(0, min(40, (len(data) - 12) // 8)))  # arrays of numbers end the message
    data[end - 8 : end] = struct.pack("<d", draw(st.sampled_from(FLOATS)))
    return bytes(data)


@st.composite
def _hostile_text(draw: DrawFn, text: str) -> str:
    try:
        tree = json.loads(text)
    except ValueError:
        return draw(mutated_text(text, SCALARS))
    if not isinstance(tree, dict) or draw(st.integers(0, 9)) == 0:
        return draw(mutated_text(text, STRINGS))
    tree = copy.deepcopy(tree)
    owner, key = tree, draw(st.sampled_from(sorted(tree)))
    while isinstance(owner[key], dict | list) and owner[key] and draw(st.integers(0, 7)):
        owner = owner[key]
        key = draw(st.sampled_from(sorted(owner) if isinstance(owner, dict) else range(len(owner))))
    change = draw(st.integers(0, 9))
    if change == 0:
        del owner[key]
    elif change == 1 and isinstance(owner, list):
        owner.append(copy.deepcopy(owner[key]))
    elif change <= 3 and isinstance(owner[key], str):
        owner[key] = draw(mutated_text(owner[key], SCALARS))
    else:
        owner[key] = draw(_VALUES)
    return json.dumps(tree, separators=(",", ":"))


def read_recording(path: Path) -> None:
    """Read a recording as the commands do; raise `ConfigurationError` if it is refused."""
    recorded = Recording(path)
    summarize(recorded)
    run = Replay(recorded)
    for number, solved in enumerate(islice(run.run(), _SOLVED)):
        if number % _SOLVED == _SOLVED // 2:
            explain_cycle(solved, recorded, run.controller)
    make_run_data(recorded, ControlCycle(recorded.config, preflight=False))
