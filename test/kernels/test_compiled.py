"""What compiled functions refuse, when it is said that they are compiled, and what they may call."""

import ast
import importlib.util
import logging
from pathlib import Path

import numpy as np
import pytest

from wbc_controller import kernels
from wbc_controller.kernels import compiled
from wbc_controller.kernels.joint_motion import acceleration_bounds

SOURCE = """
from wbc_controller.kernels.compiled import NUMBER, VECTOR, compiled

@compiled(VECTOR, NUMBER)
def total(values, factor):
    found = 0.0
    for i in range(len(values)):
        found += factor * values[i]
    return found
"""


def load(file):
    spec = importlib.util.spec_from_file_location("kernel_of_a_test", file)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    compiled.compile_all()
    return module


@pytest.fixture
def file(tmp_path):
    file = tmp_path / "kernel_of_a_test.py"
    file.write_text(SOURCE, encoding="utf-8")
    return file


def test_the_first_start_says_that_it_compiles_and_the_next_one_finds_it(file, caplog):
    with caplog.at_level(logging.WARNING):
        first = load(file).total
        said = " ".join(caplog.messages)
        assert "compiled total, 1 of 1" in said
        caplog.clear()
        assert load(file).total(np.ones(3), 2.0) == first(np.ones(3), 2.0) == 6.0
    assert not caplog.messages


def test_another_source_is_compiled_anew(file):
    assert load(file).total(np.ones(3), 2.0) == 6.0
    file.write_text(SOURCE.replace("found = 0.0", "found = 1.25"), encoding="utf-8")
    assert load(file).total(np.ones(3), 2.0) == 7.25


def test_types_that_were_not_named_are_refused_and_not_compiled(file):
    total = load(file).total
    for values in (np.ones(3, dtype=np.float32), np.ones((2, 2)), np.ones(6)[::2], [1.0, 2.0]):
        with pytest.raises(TypeError, match="No matching definition"):
            total(values, 2.0)
    frozen = np.ones(3)
    frozen.setflags(write=False)
    assert total(frozen, 2) == 6.0  # reading needs no more
    each = np.arange(3)
    with pytest.raises(TypeError, match="No matching definition"):  # and writing does
        acceleration_bounds(each, each, frozen, frozen, np.zeros((2, 0)), np.zeros(0), *[1.0] * 7, frozen, np.ones(3))


def test_where_nothing_can_be_kept_it_is_compiled_and_says_so(caplog):
    """Of code that is in no file, nothing can."""
    names = {}
    with caplog.at_level(logging.WARNING):
        exec(SOURCE, names)  # noqa: S102 - the text above
        compiled.compile_all()
    assert names["total"](np.ones(3), 2.0) == 6.0
    assert "compiled at every start" in caplog.text
    assert "NUMBA_CACHE_DIR" in caplog.text


@pytest.mark.parametrize("file", sorted(Path(kernels.__file__).parent.glob("*.py")), ids=lambda file: file.stem)
def test_a_kernel_calls_no_function_of_another_file(file):
    """Numba keeps its code until its own file changes."""
    imported = {
        node.module
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.ImportFrom)
    }
    ours = {module for module in imported if module.startswith("wbc_controller.")}
    if file.stem == "__init__":
        assert {path.stem for path in file.parent.glob("*.py")} - {"__init__", "compiled"} == set(kernels.__all__)
    else:
        assert ours <= {"wbc_controller.kernels.compiled", "wbc_controller.records"}
