"""What compiled functions refuse, when it is said that they are compiled, and what they may call."""

import ast
import importlib.util
import logging
import subprocess
import sys
import weakref
from pathlib import Path

import numba
import numpy as np
import pytest

from wbc_controller import arguments, compiled
from wbc_controller.compiled import Bound
from wbc_controller.inverse_dynamics.formulation.residual_kernels import residuals

SOURCE = """
from wbc_controller.compiled import NUMBER, VECTOR, compiled

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


def test_what_is_kept_has_other_names_than_older_code_looks_for(file, monkeypatch):
    """Older code in the same folder cannot read the types of arguments, and would end at the import."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    load(file)
    kept = [each.name for each in file.parent.rglob("*.nb[ci]")]
    assert len(kept) == 2
    assert all("-borrowed." in name for name in kept)


def test_another_source_is_compiled_anew(file):
    assert load(file).total(np.ones(3), 2.0) == 6.0
    file.write_text(SOURCE.replace("found = 0.0", "found = 1.25"), encoding="utf-8")
    assert load(file).total(np.ones(3), 2.0) == 7.25


def test_another_module_beside_it_compiles_it_anew(file):
    """It may have functions of that module in it."""
    other = file.parent / "other.py"
    other.write_text("from wbc_controller.compiled import part\n\n@part\ndef more(x):\n    return x + 1.0\n")
    source = SOURCE.replace("import NUMBER", "import NUMBER").replace("+= factor", "+= more(factor)")
    file.write_text("from other import more\n" + source, encoding="utf-8")
    for added in (1.0, 10.0):
        other.write_text(other.read_text().replace("1.0", str(added)))
        script = f"import numpy as np; import {file.stem} as m; from wbc_controller.compiled import compile_all;"
        script += "compile_all(); print(m.total(np.ones(3), 2.0))"
        done = subprocess.run(
            [sys.executable, "-c", script], cwd=file.parent, capture_output=True, text=True, check=True
        )
        assert float(done.stdout) == 3.0 * (2.0 + added)


@pytest.mark.parametrize(
    "values",
    [
        np.ones(3, dtype=np.float32),
        np.ones(3, dtype=np.int64),
        np.ones(3).astype(">f8"),
        np.ones((2, 2)),
        np.array(1.0),
        np.ones(6)[::2],
        np.frombuffer(bytes(25), offset=1),
        np.ones(3).view(type("Other", (np.ndarray,), {})),
        [1.0, 2.0],
        None,
    ],
    ids=["float32", "int64", "swapped", "matrix", "scalar", "gaps", "not aligned", "another class", "list", "none"],
)
def test_types_that_were_not_named_are_refused(file, values):
    total = load(file).total
    with pytest.raises(
        TypeError, match="takes an array of float64 with 1 axes, aligned, row by row; it was given"
    ) as told:
        total(values, 2.0)
    assert str(told.value).endswith(repr(values))


def test_numbers_of_other_types_are_read_and_too_few_or_many_arguments_refused(file):
    total = load(file).total
    assert total(np.ones(3), 2) == 6.0
    for given in ((), (np.ones(3),), (np.ones(3), 2.0, 3.0)):
        with pytest.raises(TypeError, match="expected 2 arguments"):
            total(*given)
    with pytest.raises(TypeError):
        total(np.ones(3), "x")


def test_what_cannot_be_written_is_read_and_not_written(file):
    frozen = np.ones(3)
    frozen.setflags(write=False)
    assert load(file).total(frozen, 2.0) == 6.0
    with pytest.raises(TypeError, match="row by row, to be written; it was given"):
        residuals(np.ones((1, 2)), np.ones((2, 1)), np.zeros(0), frozen)


def test_arrays_in_any_order_are_read_by_their_strides(file):
    file.write_text(SOURCE.replace("VECTOR", "ANY_VECTOR"), encoding="utf-8")
    total = load(file).total
    values = np.arange(12.0).reshape(3, 4)
    for each in (
        values[1],
        values[:, 2],
        values[::-1, 0],
        values[0, :0],
        values.T[3],
        np.frombuffer(bytes(range(25)), offset=1),
    ):
        assert total(each, 2.0) == 2.0 * each.sum()


def test_a_matrix_is_read_by_its_shape(file):
    source = SOURCE.replace("VECTOR", "ANY_MATRIX").replace("range(len(values))", "range(values.shape[0])")
    file.write_text(source.replace("factor * values[i]", "factor * values[i, -1] + values.shape[1]"), encoding="utf-8")
    total = load(file).total
    values = np.arange(12.0).reshape(3, 4)
    for each in (values, values.T, values[::2, 1:3]):
        assert total(each, 2.0) == 2.0 * each[:, -1].sum() + len(each) * each.shape[1]


def test_bytes_are_read_and_nothing_else_that_holds_bytes(file):
    file.write_text(SOURCE.replace("VECTOR", "BYTES"), encoding="utf-8")
    total = load(file).total
    assert total(bytes(range(200, 210)), 1.0) == sum(range(200, 210))
    assert total(b"", 1.0) == 0.0
    for other in (bytearray(b"abc"), memoryview(b"abc"), "abc", np.frombuffer(b"abc", dtype=np.uint8)):
        with pytest.raises(TypeError, match="takes bytes; it was given"):
            total(other, 1.0)


def test_a_call_leaves_no_reference_and_no_memory_behind(file):
    total, values, content = load(file).total, np.ones(3), bytes(40)
    assert total(values, 2.0) == 6.0
    before = sys.getrefcount(values), sys.getrefcount(None)
    for _ in range(100):
        total(values, 2.0)
        with pytest.raises(TypeError):
            total(content, 2.0)
    assert sys.getrefcount(values) == before[0]
    assert abs(sys.getrefcount(None) - before[1]) < 50


def test_another_layout_of_objects_is_found_at_the_import(monkeypatch):
    arguments.see_fields()
    for field in ("_TYPE", "_SIZE", "_CONTENT", "_DATA", "_NDIM", "_DTYPE", "_FLAGS", "_ORDER", "_NUMBER"):
        with monkeypatch.context() as patched:
            patched.setattr(arguments, field, getattr(arguments, field) + 8)
            with pytest.raises(ImportError, match="keeps arrays in another way"):
                arguments.see_fields()
    monkeypatch.setattr(arguments, "_SHAPE", arguments._STRIDES)
    with pytest.raises(ImportError, match="keeps arrays in another way"):
        arguments.see_fields()


def test_a_table_holds_numbers_as_they_are_and_arrays_by_address_and_keeps_them():
    values, weak = np.arange(6.0).reshape(2, 3), []
    bound = Bound(2, 3, values, np.arange(3))
    weak.append(weakref.ref(values))
    assert bound.table.tolist()[:3] == [2, 3, values.ctypes.data]
    del values
    assert weak[0]() is not None  # as long as compiled code may read it
    del bound
    assert weak[0]() is None


@pytest.mark.parametrize("array", [np.ones((3, 2)).T, np.ones(6)[::2], np.asfortranarray(np.ones((2, 3)))])
def test_an_array_with_gaps_or_by_columns_is_not_bound(array):
    with pytest.raises(ValueError, match="row by row"):
        Bound(1, array)


@pytest.mark.parametrize("kind", [np.float32, np.int32, np.bool_, np.complex128])
def test_an_array_of_other_numbers_than_compiled_code_reads_is_not_bound(kind):
    with pytest.raises(TypeError, match="float64, int64 and int8"):
        Bound(np.ones(3, dtype=kind))


def test_where_nothing_can_be_kept_it_is_compiled_and_says_so(caplog):
    """Of code that is in no file, nothing can."""
    names = {}
    with caplog.at_level(logging.WARNING):
        exec(SOURCE, names)  # noqa: S102 - the text above
        compiled.compile_all()
        assert names["total"](np.ones(3), 2.0) == 6.0
        assert "compiled at every start" in caplog.text
        assert "NUMBA_CACHE_DIR" in caplog.text
        caplog.clear()
        compiled.compile_all()
    assert not caplog.messages  # once is enough


KERNELS = sorted(Path(compiled.__file__).parent.rglob("*_kernels.py"))


@pytest.mark.parametrize("file", KERNELS, ids=lambda file: file.stem)
def test_kernels_import_kernels_only(file):
    """Compiled code is made anew when a file of kernels changes, and ignores all other files."""
    imported = {
        node.module
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.ImportFrom)
    }
    ours = {module for module in imported if module.startswith("wbc_controller.")}
    assert all(
        module.endswith("_kernels") or module in ("wbc_controller.compiled", "wbc_controller.records")
        for module in ours
    )
