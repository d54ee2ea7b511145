"""Docstrings of the mechanics, and snippets of docs/mechanics.md."""

import ast
import dataclasses
import inspect
import re
import textwrap

import pytest
from pages import ROOT

from wbc_controller import mechanics

PAGE = ROOT / "docs" / "mechanics.md"
#: Equation or section of the note.
REFERENCE = re.compile(r"\(\d{1,2}\)|equations? \(\d|section \d|Lemma 1|\(S\d+\)")
SHAPE = re.compile(r"\((?:\d|n|k|m|nv|nq|na|rods)[^()]*,[^()]*\)")
UNIT = re.compile(r"\b(m|kg|s|N|J|W|rad|m/s|m/s²|rad/s|N·m|N·s|N·m·s|units)\b")
#: Functions that raise for their callers.
RAISING = {"as_array", "frame_index", "joint_index", "single_joint", "duration", "_unit", "_check", "_consistent"}

#: Arguments described by the package.
COMMON = set(re.findall(r"``(\w+)``", mechanics.__doc__))

functions = sorted(name for name in mechanics.__all__ if inspect.isfunction(getattr(mechanics, name)))
classes = sorted(name for name in mechanics.__all__ if inspect.isclass(getattr(mechanics, name)))


def raises_itself(function):
    """Return True if the body raises, or calls one of `RAISING`."""
    nodes = list(ast.walk(ast.parse(textwrap.dedent(inspect.getsource(function)))))
    called = [node.func for node in nodes if isinstance(node, ast.Call)]
    calls = {getattr(name, "id", getattr(name, "attr", "")) for name in called}
    return any(isinstance(node, ast.Raise) for node in nodes) or bool(calls & RAISING)


def test_exported_names():
    assert mechanics.__all__ == sorted(mechanics.__all__)
    assert len(functions) > 40
    public = {
        name for name in vars(mechanics) if not name.startswith("_") and not inspect.ismodule(getattr(mechanics, name))
    }
    assert public == set(mechanics.__all__)


@pytest.mark.parametrize("name", functions)
def test_functions_name_the_equation_shapes_units_and_errors(name):
    function = getattr(mechanics, name)
    signature, text = inspect.signature(function), inspect.getdoc(function)
    assert REFERENCE.search(text), "no equation of the note"
    documented = set(re.findall(r"^    (\w+): ", text, re.MULTILINE)) | COMMON
    assert set(signature.parameters) <= documented, "an argument is not described"
    described = [p.annotation for name, p in signature.parameters.items() if name not in COMMON]
    if any("array" in str(annotation).lower() for annotation in [*described, signature.return_annotation]):
        assert SHAPE.search(text), "no shape"
    assert UNIT.search(text), "no unit"
    assert ("Raises:" in text) or not raises_itself(function)


@pytest.mark.parametrize("name", classes)
def test_classes_describe_their_fields(name):
    item = getattr(mechanics, name)
    text, lines = inspect.getdoc(item), inspect.getsource(item).splitlines()
    for field in vars(item).get("__annotations__", {}) if dataclasses.is_dataclass(item) else ():
        (at,) = (i for i, line in enumerate(lines) if line.startswith(f"    {field}: "))
        assert "  # " in lines[at] or lines[at - 1].startswith("    #: "), f"{field} is not described"
    if "__post_init__" in vars(item) and name != "JointCoupling":
        assert "Raises:" in text


def test_the_page_runs():
    """Run all snippets in one namespace."""
    namespace = {}
    found = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    assert len(found) >= 10
    for number, snippet in enumerate(found):
        exec(compile(snippet, f"{PAGE.name}, snippet {number}", "exec"), namespace)  # noqa: S102  # our own page


def test_the_page_names_every_function_and_shows_pictures_that_exist():
    text = PAGE.read_text(encoding="utf-8")
    missing = [name for name in mechanics.__all__ if f"`{name}`" not in text and f"{name}(" not in text]
    assert missing == []
    for image in re.findall(r"!\[[^\]]*\]\(([^)]+)\)", text):
        file = PAGE.parent / image
        assert file.is_file(), image
        assert file.stat().st_size < 60_000, image
    assert len(re.findall(r"!\[", text)) >= 6
