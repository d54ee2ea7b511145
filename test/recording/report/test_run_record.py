import dataclasses

import numpy as np
import pytest
from synthetic_run import squat

from wbc_controller.recording.report.run_record import Recording, supports_of
from wbc_controller.errors import ConfigurationError
from wbc_controller.settings.files import find_configuration, load_settings


@pytest.fixture(scope="module")
def recording():
    return squat("g1", duration=2.0, rate=50.0)[0]


def equal(a, b):
    if isinstance(a, np.ndarray):
        return np.array_equal(a, b, equal_nan=True)
    if hasattr(a, "items"):
        return list(a) == list(b) and all(equal(a[key], b[key]) for key in a)
    if dataclasses.is_dataclass(a):
        return all(equal(getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(a))
    return a == b


def test_round_trip(recording, tmp_path):
    reference = np.array(recording.com_reference)
    reference[5] = np.nan
    recording = dataclasses.replace(recording, com_reference=reference, frame_errors={"a/b ü": recording.time})
    recording.save(tmp_path / "run.wbc")
    loaded = Recording.load(tmp_path / "run.wbc")
    for field in dataclasses.fields(Recording):
        assert equal(getattr(recording, field.name), getattr(loaded, field.name)), field.name


def test_arrays_are_frozen_copies(recording):
    time = np.array(recording.time)
    copy = dataclasses.replace(recording, time=time)
    time[0] = -5.0
    assert copy.time[0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        copy.tau[0, 0] = 1.0
    with pytest.raises(TypeError):
        copy.friction["left_foot"] = 0.0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"com": np.zeros((3, 3))}, r"com has the shape \(3, 3\); it must be \(100, 3\)"),
        ({"time": np.full(100, np.nan)}, "time must be finite"),
        ({"time": np.arange(100.0)[::-1]}, "never decrease"),
        ({"q": np.full((100, 36), np.inf)}, "q holds values that are not finite"),
        ({"contact_wrenches": {"left_foot": np.zeros((100, 4))}}, r"contact_wrenches\['left_foot'\] has 4 columns"),
        ({"stage_seconds": {"solver": np.zeros(7)}}, r"stage_seconds\['solver'\] has the shape"),
    ],
)
def test_refuses_what_does_not_fit(recording, changes, message):
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(recording, **changes)


def test_refuses_an_empty_run(recording):
    n = {name: getattr(recording, name)[:0] for name in ("time", "q", "tau", "com", "com_reference", "unmodelled")}
    empty = {name: {} for name in ("frame_errors", "contact_wrenches", "true_wrenches")}
    with pytest.raises(ValueError, match="at least one sample"):
        dataclasses.replace(recording, **n, **empty)


def bad_files(recording, folder):
    recording.save(folder / "good.npz")
    good = (folder / "good.npz").read_bytes()
    yield "missing", None, "cannot be read"
    yield "text", b"hello", "not a recording"
    yield "empty", b"", "not a recording"
    yield "cut", good[: len(good) // 2], "not a recording"
    np.savez(folder / "other.npz", x=np.zeros(3))
    yield "other", (folder / "other.npz").read_bytes(), "lacks .*metadata"
    np.save(folder / "array.npy", np.zeros(3))
    yield "array", (folder / "array.npy").read_bytes(), "not a recording"
    np.savez(folder / "future.npz", metadata=np.array('{"format": 99}'))
    yield "future", (folder / "future.npz").read_bytes(), "its format is 99"
    np.savez(folder / "list.npz", metadata=np.array("[1]"))
    yield "list", (folder / "list.npz").read_bytes(), "not a recording"
    np.savez(folder / "pickle.npz", metadata=np.array([{"format": 1}], dtype=object))
    yield "pickle", (folder / "pickle.npz").read_bytes(), "not a recording"


def test_a_malformed_file_gives_one_clear_error(recording, tmp_path):
    for name, content, message in bad_files(recording, tmp_path):
        path = tmp_path / f"bad-{name}.npz"
        if content is not None:
            path.write_bytes(content)
        with pytest.raises(ConfigurationError, match=message) as caught:
            Recording.load(path)
        assert str(path) in str(caught.value), name
        assert "\n" not in str(caught.value), name


def test_supports_of_surfaces_and_points():
    foot = supports_of(load_settings(find_configuration("g1")).contacts)["left_foot"]
    np.testing.assert_allclose(foot.placement, [0.035, 0.0, -0.035, 0.0, 0.0, 0.0, 1.0])
    np.testing.assert_allclose(np.ptp(foot.corners, axis=0), [0.17, 0.05, 0.0])
    paw = supports_of(load_settings(find_configuration("go2")).contacts)["front_left_foot"]
    np.testing.assert_array_equal(paw.corners, [[0.0, 0.0, 0.0]])
