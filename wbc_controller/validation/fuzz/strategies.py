"""Strategies of bytes, texts, messages, configurations and URDFs."""

import copy
import itertools
import re
import struct
from collections.abc import Sequence
from typing import Any, TypeVar

import hypothesis
import numpy as np
from hypothesis import strategies as st
from hypothesis.strategies import DrawFn, SearchStrategy
from rosbags.interfaces import Nodetype

from wbc_controller.middleware.codec import TYPES, encode, message
from wbc_controller.middleware.topics import Endpoint
from wbc_controller.validation.fuzz import values
from wbc_controller.validation.fuzz.target import Target

T = TypeVar("T")

_RANDOM_BYTES = 8192  # for one value; the most that Hypothesis uses
_MUTATIONS = (1, 1, 1, 2, 4)
_LONGEST_RUN = 64  # bytes
_LONGEST_NOISE = 400  # bytes
#: Share of fields with a very long array or text, and lengths of texts and arrays.
_LARGE, _LARGEST = 0.002, (20_000, 300_000)
_MANY = 100
_TOKEN = re.compile(r"[-+]?[0-9][-+.0-9eE]*|[A-Za-z_][\w./:-]*|\S")  # a number, a word, or another visible character
#: A number in a text, and its factors.
_NUMBER = re.compile(r"(?<![\w.])-?[0-9]+\.?[0-9]*(?:[eE][-+]?[0-9]+)?(?![\w.])")
_FACTORS = (-1.0, 0.0, 0.5, 2.0, 57.29577951308232, 1e-9, 1e-3, 1e3, 1e6)
#: Characters that are invalid in some encoding, YAML or XML.
_STRAY = ("\x00", "\r", "\t", "\ufeff", "\u2028", "é", "\U0001f916", "#", ":", "-", "[", "}", "&", "*", "!", "<", ">")
_SIZES = st.sampled_from((2, 50, 300, 2000, 20_000))  # sizes of chains and nestings in a hostile URDF
#: Attributes that are changed in all links or joints together.
_EVERYWHERE = ("value", "ixx", "iyy", "ixy", "effort", "velocity", "lower", "upper", "type", "xyz", "rpy")
#: False declarations of the encoding.
_ENCODINGS = st.sampled_from(("utf-16", "ascii", "latin-1", "utf-7", "rot13", "idna", "x" * 300, "", "zlib"))


def draw_by_key(strategy: SearchStrategy[T], *key: object) -> T:
    """Draw a value determined by a key and the code."""
    drawn: list[T] = []

    @hypothesis.settings(database=None, deadline=None)
    @hypothesis.given(strategy)
    def keep(value: T) -> None:
        drawn.append(value)

    handle: Any = keep
    generator = np.random.default_rng(list(str(key).encode()))
    while not drawn:  # too few bytes give none
        handle.hypothesis.fuzz_one_input(generator.bytes(_RANDOM_BYTES))
    return drawn[0]


def share(probability: float) -> SearchStrategy[bool]:
    """Return a strategy of True with a probability, to within 0.001."""
    return st.integers(0, 999).map(lambda value: value >= 1000 * (1.0 - probability))


@st.composite
def mutated_bytes(draw: DrawFn, payload: bytes) -> bytes:
    """Draw a payload with changed, repeated, inserted or missing bytes."""
    data = bytearray(payload)
    for _ in range(draw(st.sampled_from(_MUTATIONS))):
        if not data:
            return draw(st.binary(max_size=_LONGEST_RUN))
        at, run = draw(st.integers(0, len(data) - 1)), draw(st.integers(1, _LONGEST_RUN))
        kind = draw(st.integers(0, 7))
        if kind == 0:
            data[at] ^= 1 << draw(st.integers(0, 7))
        elif kind == 1:
            data[at] = draw(st.sampled_from((0, 1, 0x7F, 0x80, 0xFF)))
        elif kind == 2:
            data[at - at % 4 : at - at % 4 + 4] = struct.pack("<I", draw(st.sampled_from(values.LENGTHS)))
        elif kind == 3:
            data[at - at % 8 + 4 : at - at % 8 + 12] = struct.pack("<d", draw(st.sampled_from(values.FLOATS)))
        elif kind == 4:
            del data[at:]
        elif kind == 5:
            del data[at : at + run]
        elif kind == 6:
            data[at:at] = data[at : at + run] * draw(st.integers(1, 3))
        else:
            data[at:at] = draw(st.binary(min_size=run, max_size=run))
    return bytes(data)


@st.composite
def mutated_text(draw: DrawFn, text: str, others: Sequence[str]) -> str:
    """Draw a text with replaced tokens, and changed lines."""
    for _ in range(draw(st.sampled_from(_MUTATIONS))):
        tokens, lines = list(_TOKEN.finditer(text)), text.split("\n")
        line, kind = draw(st.integers(0, len(lines) - 1)), draw(st.integers(0, 11))
        if kind >= 9:
            text = draw(scaled_text(text))
        elif kind <= 4 and tokens:
            token = draw(st.sampled_from(tokens))
            by = draw(st.sampled_from(others)) if kind <= 3 else draw(st.sampled_from(tokens)).group()
            text = text[: token.start()] + by + text[token.end() :]
        elif kind <= 5:
            at = draw(st.integers(0, len(text)))
            text = text[:at] + draw(st.sampled_from(_STRAY)) + text[at:]
        else:
            if kind == 6:
                del lines[line]
            elif kind == 7:
                lines.insert(draw(st.integers(0, len(lines))), lines[line])
            else:
                lines[line] = " " * draw(st.integers(0, 8)) + lines[line].strip()
            text = "\n".join(lines)
    return text


def scaled_text(text: str) -> SearchStrategy[str]:
    """Return a strategy of texts with one number multiplied by one of `_FACTORS`."""

    def scaled(at: re.Match[str], factor: float) -> str:
        return f"{text[: at.start()]}{float(at.group()) * factor:.12g}{text[at.end() :]}"

    numbers = list(_NUMBER.finditer(text))
    return st.builds(scaled, st.sampled_from(numbers), st.sampled_from(_FACTORS)) if numbers else st.just(text)


def encoded(text: str) -> SearchStrategy[bytes]:
    """Return a strategy of the bytes of a text, sometimes in another encoding or invalid."""
    encodings = st.sampled_from(("utf-16", "utf-32", "utf-8-sig", "latin-1"))
    others = encodings.map(lambda name: text.encode(name, errors="replace")) | mutated_bytes(text.encode())
    return share(0.06).flatmap(lambda other: others if other else st.just(text.encode()))


def _places(content: Any) -> list[tuple[Any, str, Any]]:
    """Return owner, name and type of each primitive field; of sequences of messages, the first and last elements."""
    found = []
    for name, kind in TYPES.fielddefs[content.__msgtype__][1]:
        node, detail = kind
        if node == Nodetype.NAME:
            found += _places(getattr(content, name))
            continue
        found.append((content, name, kind))
        if node in (Nodetype.SEQUENCE, Nodetype.ARRAY) and detail[0][0] == Nodetype.NAME:
            elements = getattr(content, name)
            found += [place for element in [*elements[:1], *elements[-1:]] for place in _places(element)]
    return found


@st.composite
def hostile(draw: DrawFn, content: Any, names: Sequence[str]) -> Any:
    """Draw a message with replaced numbers and texts, and other sequences."""
    content = copy.deepcopy(content)
    for _ in range(draw(st.integers(1, 3))):
        owner, name, (node, detail) = draw(st.sampled_from(_places(content)))
        value = getattr(owner, name)
        if node == Nodetype.BASE:
            value = draw(scalar(detail[0], names))
        elif detail[0][0] == Nodetype.BASE and detail[0][1][0] != "string":
            value = draw(_numbers(value, detail[0][1][0], detail[1]))
        elif len(value):
            elements: SearchStrategy[Any] = st.sampled_from(list(value))
            if detail[0][0] == Nodetype.BASE:
                elements = st.one_of(elements, elements, scalar("string", names))
            at, other = draw(st.integers(0, len(value) - 1)), draw(elements)
            one = ([*value[:at], *value[at + 1 :]], [*value[:at], other, *value[at + 1 :]], [*value, other])
            orders, lists = st.permutations(list(value)), st.lists(elements, max_size=_MANY)
            value = draw(st.one_of(orders, lists, st.sampled_from(one)))
            if value and draw(share(_LARGE)):
                value = [value[i % len(value)] for i in range(6000)]
            value = copy.deepcopy(value)
        setattr(owner, name, value)
    return content


@st.composite
def _numbers(draw: DrawFn, value: Any, type_name: str, size: int) -> Any:
    change = draw(st.integers(0, 2))
    length = size or len(value)
    if not size and draw(share(_LARGE)):
        length = draw(st.sampled_from(_LARGEST))
    elif not size and change == 0:
        length = draw(st.integers(0, len(value) + 2))
    result = np.resize(value if len(value) else np.zeros(1, dtype=type_name), length)
    if length and change == 1:
        result[draw(st.integers(0, length - 1))] = draw(scalar(type_name, ()))
    elif change == 2:
        result = np.full(length, draw(scalar(type_name, ())), dtype=type_name)
    return result


@st.composite
def scalar(draw: DrawFn, type_name: str, names: Sequence[str]) -> Any:
    """Draw a hostile value of a primitive type; strings may be one of `names`."""
    if type_name == "string":
        if draw(share(_LARGE)):
            return "x" * draw(st.sampled_from(_LARGEST))
        is_name = bool(names) and draw(share(0.3))
        return draw(st.sampled_from(names if is_name else values.STRINGS))
    if type_name == "bool":
        return draw(st.booleans())
    if "float" in type_name:
        return draw(st.sampled_from(values.FLOATS))
    bits = int(re.sub(r"\D", "", type_name) or 8)  # byte and octet have 8
    value = draw(st.sampled_from(values.INTEGERS)) % (1 << bits)
    unsigned = type_name.startswith("u") or not type_name.startswith("int")
    return value if unsigned or value < 1 << (bits - 1) else value - (1 << bits)


def hostile_text(key: str) -> SearchStrategy[str]:
    """Return a strategy of texts for a topic of texts: a word, an update or a URDF."""
    strings = st.sampled_from(values.STRINGS)
    if key == "update":
        mutated = st.sampled_from(values.UPDATES).flatmap(lambda update: mutated_text(update, values.SCALARS))
        return st.one_of(strings, st.sampled_from(values.TEXTS), mutated, mutated)
    if key == "robot_description":
        return strings | mutated_text("<robot name='r'>\n<link name='a'/>\n<link name='b'/>\n</robot>", values.STRINGS)
    words = st.sampled_from(values.WORDS)
    mutated = words.flatmap(lambda word: mutated_text(word, values.STRINGS))
    return st.one_of(strings, words, mutated, mutated)


@st.composite
def payloads(draw: DrawFn, topic: Endpoint, example: Any, names: Sequence[str]) -> bytes:
    """Draw a payload: noise, mutated bytes, hostile fields or text, or a valid message."""
    kind = draw(st.integers(0, 99))
    if kind >= 92:
        return draw(st.binary(max_size=_LONGEST_NOISE))
    if topic.type == "std_msgs/msg/String" and kind >= 20:
        return encode(message(topic.type, data=draw(hostile_text(topic.key))))
    if kind >= 60:
        return draw(mutated_bytes(encode(example)))
    return encode(draw(hostile(example, names)) if kind >= 4 else example)


@st.composite
def requests(draw: DrawFn, target: Target, names: Sequence[str]) -> tuple[Endpoint, bytes]:
    """Draw a topic of a node and a payload."""
    topics = list(target.topics.values())
    if draw(share(0.33)):  # many topics of setpoints exist, but only one of updates
        key = draw(st.sampled_from(sorted({topic.key for topic in topics})))
        topics = [topic for topic in topics if topic.key == key]
    topic = draw(st.sampled_from(topics))
    return topic, draw(payloads(topic, target.example(topic), names))


@st.composite
def hostile_configuration(draw: DrawFn, text: str) -> bytes:
    """Draw a configuration with hostile values, or a hostile YAML text."""
    if draw(share(0.05)):
        return draw(encoded(draw(st.sampled_from(values.TEXTS))))
    return draw(encoded(draw(mutated_text(text, values.STRINGS if draw(share(0.2)) else values.SCALARS))))


@st.composite
def hostile_urdf(draw: DrawFn, text: str) -> bytes:
    """Draw a URDF with hostile attributes, numbers, tokens or elements."""
    kind = draw(st.integers(0, 9))
    if kind <= 2:
        text = draw(mutated_text(text, values.ATTRIBUTES if kind else values.STRINGS))
    elif kind <= 4:
        text = draw(scaled_text(text))
    elif kind <= 7:
        for _ in range(draw(st.integers(1, 3))):
            at = draw(st.sampled_from(list(re.finditer(r'="([^"]*)"', text))))
            text = text[: at.start(1)] + draw(st.sampled_from(values.ATTRIBUTES)) + text[at.end(1) :]
    elif kind == 8:
        name, value = draw(st.sampled_from(_EVERYWHERE)), draw(st.sampled_from(values.ATTRIBUTES))
        text = re.sub(rf'\b{name}="[^"]*"', lambda found: f'{name}="{value}"', text)
    else:
        text = draw(st.one_of(*structures(text).values()))
    return draw(encoded(text))


def structures(text: str) -> dict[str, SearchStrategy[str]]:
    """Return strategies of URDFs with another structure, by name of the change."""
    elements = list(re.finditer(r"(?s)<(joint|link|inertial|limit|robot)\b.*?</\1>|<limit[^>]*/>", text))
    joints = list(re.finditer(r'<parent\s+link="([^"]*)"\s*/>\s*<child\s+link="([^"]*)"\s*/>', text))
    body = re.sub(r"<\?xml.*?\?>", "", text)
    levels = "".join(f'<!ENTITY l{i} "{f"&l{i - 1};" * 10}">' for i in range(1, 12))
    changed = {
        "entities": st.just(f'<!DOCTYPE robot [<!ENTITY l0 "x">{levels}]>' + text.replace('name="', 'name="&l11;', 1)),
        "external": st.just(
            '<!DOCTYPE robot [<!ENTITY f SYSTEM "file:///etc/hostname">]>' + text.replace('name="', 'name="&f;', 1)
        ),
        "chain": _SIZES.map(lambda size: text.replace("</robot>", _chain(text, size) + "</robot>")),
        "nested": _SIZES.map(lambda size: text.replace("</robot>", "<a>" * size + "</a>" * size + "</robot>")),
        "declared": _ENCODINGS.map(lambda name: f'<?xml version="1.0" encoding="{name}"?>' + body),
        "cut": st.integers(0, len(text) - 1).map(lambda length: text[:length]),
    }
    if elements:
        changed["twice"] = st.sampled_from(elements).map(lambda at: text[: at.end()] + at.group() + text[at.end() :])
    if joints:
        changed["loop"] = st.builds(_loop, st.just(text), st.sampled_from(joints), st.booleans())
    return changed


def _chain(text: str, size: int) -> str:
    root = (re.findall(r'<link\s+name="([^"]*)"', text) or ["base"])[0]
    names = [root, *(f"more_{i}" for i in range(size))]
    joint = '<joint name="at_{1}" type="fixed"><parent link="{0}"/><child link="{1}"/></joint>'
    return "".join(f'<link name="{pair[1]}"/>' + joint.format(*pair) for pair in itertools.pairwise(names))


def _loop(text: str, at: re.Match[str], same: bool) -> str:
    parent, child = at.group(2), at.group(2 if same else 1)
    return text[: at.start()] + f'<parent link="{parent}"/><child link="{child}"/>' + text[at.end() :]
