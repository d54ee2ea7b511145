"""Compilation of kernels: types, structs, cache on disk."""

import ast
import contextlib
import importlib.util
import inspect
import os
import re
import subprocess
import sys
import threading
import time
from pathlib import Path

import numba
import numpy as np
import pytest

from wbc_controller import compilation
from wbc_controller.compilation import Struct

SHORT_SOURCE = """
from wbc_controller.compilation import OutVector, StridedVector, Struct, Vector, compiled

@compiled
def total(values: Vector, factor: float) -> float:
    found = 0.0
    for i in range(len(values)):
        found += factor * values[i]
    return found
"""
SOURCE = f"""{SHORT_SOURCE}
class Scaled(Struct):
    values: Vector
    factor: float
    out: OutVector

@compiled
def strided_total(values: StridedVector) -> float:
    found = 0.0
    for i in range(len(values)):
        found += values[i]
    return found

@compiled
def scale(scaled: Scaled) -> None:
    for i in range(len(scaled.values)):
        scaled.out[i] = scaled.factor * scaled.values[i]
"""
ROOT = Path(compilation.__file__).parent
KERNELS = sorted(ROOT.rglob("*_kernels.py"))
#: Tests of Numba's own type checks.
compiled_only = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="NUMBA_DISABLE_JIT is set")


def load(folder, source=SHORT_SOURCE, name="kernels_of_a_test"):
    file = folder / f"{name}.py"
    file.write_text(source, encoding="utf-8")
    spec = importlib.util.spec_from_file_location(name, file)
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def kernels(tmp_path_factory):
    return load(tmp_path_factory.mktemp("kernels"), SOURCE)


def scaled(kernels, **changes):
    fields = {"values": np.ones(3), "factor": 2.0, "out": np.zeros(3), **changes}
    return kernels.Scaled(**{name: value for name, value in fields.items() if value is not None})


def test_a_struct_shares_memory_with_its_arrays_and_keeps_them_alive(kernels):
    values, out = np.arange(3.0), np.zeros(3)
    struct = scaled(kernels, values=values, out=out)
    kernels.scale(struct)
    assert out.tolist() == [0.0, 2.0, 4.0]
    values += 1.0
    kernels.scale(struct)
    assert out.tolist() == [2.0, 4.0, 6.0]
    assert struct.values is values
    struct = scaled(kernels, values=np.arange(1000.0), out=np.zeros(1000))
    np.random.default_rng(0).normal(size=(200, 1000))  # freed memory would be written
    kernels.scale(struct)
    assert struct.out.tolist() == (2.0 * np.arange(1000.0)).tolist()
    with pytest.raises(AttributeError, match=r"Scaled\.factor is read-only; create a new struct"):
        scaled(kernels).factor = 3.0


@pytest.mark.parametrize("changes", [{"out": None}, {"other": 1.0}])
def test_missing_and_unknown_fields_are_refused(kernels, changes):
    with pytest.raises(TypeError, match=r"Scaled has the fields \['values', 'factor', 'out'\], got"):
        scaled(kernels, **changes)


def frozen(values):
    values.setflags(write=False)
    return values


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"values": np.ones(3, dtype=np.float32)}, "float32 of shape"),
        ({"values": np.ones((3, 1))}, r"float64 of shape \(3, 1\)"),
        ({"values": np.ones(6)[::2]}, ".*, not c_contiguous"),
        ({"values": [1.0, 2.0]}, r"\[1.0, 2.0\]"),
        ({"out": frozen(np.ones(3))}, ".*, not writeable"),
    ],
)
def test_arrays_of_another_type_are_refused(kernels, changes, said):
    (name,) = changes
    message = rf"Scaled\.{name} must be a contiguous .*float64 array with 1 axes, got {said}"
    with pytest.raises(TypeError, match=message):
        scaled(kernels, **changes)


def test_frozen_and_strided_arrays_are_read(kernels):
    assert kernels.total(frozen(np.ones(3)), 2) == 6.0
    values = np.arange(12.0).reshape(3, 4)
    for each in (values[1], values[:, 2], values[::-1, 0], values[0, :0], values.T[3]):
        assert kernels.strided_total(each) == each.sum()


@compiled_only
@pytest.mark.parametrize(
    "values", [np.ones(3, dtype=np.float32), np.ones(3).astype(">f8"), np.ones((2, 2)), np.ones(6)[::2], None]
)
def test_types_that_the_annotations_do_not_name_are_refused(kernels, values):
    with pytest.raises((TypeError, ValueError, numba.errors.NumbaError)):
        kernels.total(values, 2.0)


@compiled_only
def test_nothing_is_compiled_after_the_import(kernels):
    before = [dict(kernel.overloads) for kernel in (kernels.total, kernels.scale)]
    kernels.total(np.ones(3), 2)
    kernels.scale(scaled(kernels))
    assert [dict(kernel.overloads) for kernel in (kernels.total, kernels.scale)] == before


def start(folder, script, **environment):
    """Start Python on the kernels in a folder."""
    (folder / "kernels_of_a_test.py").write_text(SOURCE, encoding="utf-8")
    environment = {**os.environ, "PYTHONPATH": str(ROOT.parent), **environment}
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen([sys.executable, "-c", script], cwd=folder, env=environment, **pipes)


@compiled_only
def test_processes_that_start_together_compile_each_function_once_and_a_later_one_loads_them(tmp_path):
    script = "import logging; logging.basicConfig(level=logging.INFO); import kernels_of_a_test"
    processes = [start(tmp_path, script, NUMBA_CACHE_DIR=str(tmp_path)) for _ in range(2)]
    logs = [process.communicate(timeout=300)[1] for process in processes]
    assert [process.returncode for process in processes] == [0, 0]
    for function in ("total", "strided_total", "scale", "allocate_Scaled"):
        assert "".join(logs).count(f"wbc_controller.compilation:compiled {function} in") == 1, logs
    for log in logs:
        assert log.count("once, 15 to 60 s of processor time") == (":compiled " in log)
    assert start(tmp_path, script, NUMBA_CACHE_DIR=str(tmp_path)).communicate(timeout=300) == ("", "")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Return the cache folder."""
    monkeypatch.setattr(compilation, "_cache_folder", lambda: tmp_path)
    return tmp_path


@contextlib.contextmanager
def locked(folder, name):
    """Hold the lock of `total` as another process does; yield a thread that loads the module `name`."""
    compilation._warn_once.cache_clear()
    with (folder / "total.lock").open("w") as lock:
        compilation.fcntl.flock(lock, compilation.fcntl.LOCK_EX | compilation.fcntl.LOCK_NB)
        waiting = threading.Thread(target=load, args=(folder,), kwargs={"name": name})
        waiting.start()
        yield waiting
    waiting.join()


@compiled_only
def test_waiting_for_another_process_is_logged(folder, monkeypatch, caplog):
    monkeypatch.setattr(compilation, "_SLOW", 0.01)
    with locked(folder, "waiting") as waiting:
        while "waiting for another process" not in caplog.text:
            assert waiting.is_alive()
            time.sleep(0.01)
    assert sys.modules["waiting"].total(np.ones(3), 2.0) == 6.0


@compiled_only
def test_a_short_wait_for_another_process_is_not_logged(folder, monkeypatch, caplog):
    """Processes that start together hold the lock while they load the compiled functions."""
    monkeypatch.setattr(compilation, "_SLOW", 300.0)
    blocked = threading.Event()
    flock = compilation.fcntl.flock

    def observed(file, operation):
        if operation == compilation.fcntl.LOCK_EX:
            blocked.set()
        flock(file, operation)

    monkeypatch.setattr(compilation.fcntl, "flock", observed)
    with locked(folder, "briefly"):
        assert blocked.wait(60.0)
    assert "waiting for another process" not in caplog.text


@compiled_only
def test_without_a_lock_or_a_writable_folder_functions_are_compiled_all_the_same(folder, monkeypatch, caplog):
    (folder / "total.lock").mkdir()  # cannot be opened, as in a read-only folder
    with caplog.at_level("DEBUG", "wbc_controller"):
        assert load(folder, name="unlocked").total(np.ones(3), 2.0) == 6.0
    assert "total is compiled without a lock: [Errno 21] Is a directory" in caplog.text
    monkeypatch.setattr(compilation, "_cache_folder", lambda: None)
    assert load(folder, name="uncached").total(np.ones(3), 2.0) == 6.0


@compiled_only
def test_progress_is_a_warning_for_slow_functions(folder, monkeypatch, caplog):
    monkeypatch.setattr(compilation, "_SLOW", 0.0)
    monkeypatch.setattr(compilation, "_compiled_names", [])
    load(folder, SOURCE, name="slow")
    shown = [record.getMessage() for record in caplog.records if record.levelname == "WARNING"]
    progress = [re.sub(r"\d+\.\d s", "… s", text) for text in shown if text.startswith("compiled")]
    assert progress == [
        f"compiled {function} in … s ({i} of about {compilation._total()})"
        for i, function in enumerate(("total", "strided_total", "allocate_Scaled", "scale"), start=1)
    ]


def test_the_number_of_kernels_is_known():
    modules = [f"wbc_controller.{'.'.join(kernel.relative_to(ROOT).with_suffix('').parts)}" for kernel in KERNELS]
    script = f"""
import importlib
from wbc_controller import compilation
for module in {modules}: importlib.import_module(module)
print(len(compilation._compiled_names), compilation._total())
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    made, total = done.stdout.split()
    assert made == ("0" if numba.config.DISABLE_JIT else total)


@compiled_only
def test_another_source_is_compiled_anew(tmp_path):
    assert load(tmp_path).total(np.ones(3), 2.0) == 6.0
    os.utime(tmp_path / "kernels_of_a_test.py", (0, 0))
    assert load(tmp_path, SHORT_SOURCE.replace("found = 0.0", "found = 1.25")).total(np.ones(3), 2.0) == 7.25


def test_the_cache_folder_depends_on_the_sources_and_the_bounds_checks(tmp_path, monkeypatch):
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(compilation, "_PACKAGE", tmp_path)
    kernel, names = tmp_path / "some_kernels.py", set()
    for content, checked in (("a", 0), ("b", 0), ("b", 1)):
        kernel.write_text(content, encoding="utf-8")
        monkeypatch.setattr(numba.config, "BOUNDSCHECK", checked)
        folder = compilation._cache_folder.__wrapped__()
        assert folder.parent == tmp_path
        names.add(folder.name)
    assert len(names) == 3


def test_warning_without_a_writable_folder(tmp_path, monkeypatch, caplog):
    (tmp_path / "file").write_text("", encoding="utf-8")
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "file"))
    assert compilation._cache_folder.__wrapped__() is None
    assert "compiled at every start" in caplog.text
    assert "set NUMBA_CACHE_DIR" in caplog.text


def test_without_compilation_kernels_are_functions_and_structs_are_plain_objects(tmp_path):
    """For breakpoints and coverage."""
    script = """
import types, numpy as np, kernels_of_a_test as k
struct = k.Scaled(values=np.ones(2), factor=3.0, out=np.zeros(2))
k.scale(struct)
print(isinstance(k.scale, types.FunctionType), struct.out.tolist(), k.Scaled.__mro__[2].__name__)
"""
    said, _ = start(tmp_path, script, NUMBA_DISABLE_JIT="1").communicate(timeout=300)
    assert said == "True [3.0, 3.0] object\n"


@pytest.mark.parametrize("file", KERNELS, ids=lambda file: file.stem)
def test_kernels_import_kernels_only(file):
    """The cache depends on kernel files only."""
    nodes = ast.walk(ast.parse(file.read_text(encoding="utf-8")))
    imported = {node.module for node in nodes if isinstance(node, ast.ImportFrom)}
    others = {name for name in imported if name.startswith("wbc_controller.") and not name.endswith("_kernels")}
    assert others <= {"wbc_controller.compilation", "wbc_controller.records"}


def test_structs_describe_each_field():
    structs = [struct for struct in Struct.__subclasses__() if struct.__module__.startswith("wbc_controller.")]
    assert structs
    for struct in structs:
        lines = [line for line in inspect.getsource(struct).splitlines() if "  # " in line]
        described = {line.strip().partition(":")[0] for line in (*struct.__doc__.splitlines(), *lines)}
        assert not struct._fields.keys() - described, struct
