"""Fuzzer of files: hostile ones are refused; crashes and hangs of the reader are detected."""

import logging
import re

import pytest
from bad_readers import dies_and_hangs
from command_line import wbc
from hypothesis import strategies as st

from wbc_controller.validation.fuzz import files
from wbc_controller.validation.fuzz.files import case_folder, fuzz_files, make_case, read_case
from wbc_controller.validation.fuzz.strategies import draw_by_key, structures

URDF = files._originals("go2")[1]


def test_the_command_reads_hostile_files(tmp_path):
    result = wbc("fuzz", "urdf", "go2", "--count", "6", "--out", tmp_path)
    assert re.fullmatch(r"6 cases in \d+ s: (\d+ (refused|works)(, |\n)){2}", result.stdout)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("kind", ["configurations", "recordings"])
def test_hostile_files_work_or_are_refused(tmp_path, caplog, kind):
    """In this process; `wbc fuzz` reads tens of thousands in a child."""
    caplog.set_level(logging.CRITICAL)
    results = set()
    for number in range(10):
        make_case(kind, "go2", 0, number, tmp_path / str(number))
        results.add(read_case(tmp_path / str(number)))
    assert results == {"works", "refused"}


@pytest.mark.parametrize("name", structures(URDF))
def test_hostile_structures_of_a_urdf_work_or_are_refused(tmp_path, name):
    make_case("urdf", "go2", 0, 0, tmp_path)
    for text in {draw_by_key(structures(URDF)[name], name, number) for number in range(2)}:
        assert text != URDF
        (tmp_path / "robot.urdf").write_text(text, encoding="utf-8")
        assert read_case(tmp_path) in ("works", "refused")


def test_seed_and_number_determine_the_case(tmp_path):
    for place in ("a", "b"):
        make_case("configurations", "go2", 5, 7, tmp_path / place)
    texts = [(tmp_path / place / "robot.yaml").read_bytes().replace(b"/b/", b"/a/") for place in ("a", "b")]
    assert texts[0] == texts[1]
    make_case("configurations", "go2", 6, 7, tmp_path / "a")
    assert (tmp_path / "a" / "robot.yaml").read_bytes() != texts[0]


def test_unchanged_files_work_in_time(tmp_path, monkeypatch):
    monkeypatch.setattr(files, "hostile_urdf", lambda text: st.just(text.encode()))
    make_case("urdf", "go2", 0, 0, tmp_path)
    assert read_case(tmp_path) == "works"
    monkeypatch.setattr(files, "_PROCESSOR_TIME_LIMIT", 0.0)
    assert read_case(tmp_path).startswith("slow: ")


def test_crash_and_hang_of_the_reader(tmp_path, monkeypatch):
    monkeypatch.setattr(files, "_CASE_TIMEOUT", 3.0)
    monkeypatch.setattr(files, "read_case", dies_and_hangs)
    results = {trial.folder: trial.result for trial in fuzz_files("configurations", ("go2",), 3, 0, tmp_path)}
    works, dead, hanging = (case_folder(tmp_path, "configurations", number) for number in range(3))
    assert results == {works: "works", dead: "crash: SIGSEGV", hanging: "hang: no result after 3 s"}
    assert (dead / "robot.yaml").exists()


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (KeyError("mass"), "traceback: KeyError: 'mass'"),
        (SystemExit(1), "traceback: SystemExit: 1"),
        (files.ConfigurationError("some sentence"), "unnamed: no path in 'some sentence'"),
    ],
)
def test_tracebacks_and_errors_without_a_path_are_failures(tmp_path, monkeypatch, error, said):
    def broken(path):
        raise error

    monkeypatch.setattr(files, "check", broken)
    make_case("configurations", "go2", 0, 0, tmp_path)
    assert read_case(tmp_path).startswith(said)
