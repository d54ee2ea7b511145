"""Strategies of configurations and URDFs."""

import itertools
import re

from hypothesis import strategies as st
from hypothesis.strategies import DrawFn, SearchStrategy

from wbc_controller.validation.fuzz.strategies import encoded, mutated_text, scaled_text, share
from wbc_controller.validation.fuzz.values import ATTRIBUTES, SCALARS, STRINGS, TEXTS

_SIZES = st.sampled_from((2, 50, 300, 2000, 20_000))  # sizes of chains and nestings in a hostile URDF
#: Attributes that are changed in all links or joints together.
_EVERYWHERE = ("value", "ixx", "iyy", "ixy", "effort", "velocity", "lower", "upper", "type", "xyz", "rpy")
#: False declarations of the encoding.
_ENCODINGS = st.sampled_from(("utf-16", "ascii", "latin-1", "utf-7", "rot13", "idna", "x" * 300, "", "zlib"))


@st.composite
def hostile_configuration(draw: DrawFn, text: str) -> bytes:
    """Draw a configuration with hostile values, or a hostile YAML text."""
    if draw(share(0.05)):
        return draw(encoded(draw(st.sampled_from(TEXTS))))
    return draw(encoded(draw(mutated_text(text, STRINGS if draw(share(0.2)) else SCALARS))))


@st.composite
def hostile_urdf(draw: DrawFn, text: str) -> bytes:
    """Draw a URDF with hostile attributes, numbers, tokens or elements."""
    kind = draw(st.integers(0, 9))
    if kind <= 2:
        text = draw(mutated_text(text, ATTRIBUTES if kind else STRINGS))
    elif kind <= 4:
        text = draw(scaled_text(text))
    elif kind <= 7:
        for _ in range(draw(st.integers(1, 3))):
            at = draw(st.sampled_from(list(re.finditer(r'="([^"]*)"', text))))
            text = text[: at.start(1)] + draw(st.sampled_from(ATTRIBUTES)) + text[at.end(1) :]
    elif kind == 8:
        name, value = draw(st.sampled_from(_EVERYWHERE)), draw(st.sampled_from(ATTRIBUTES))
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
