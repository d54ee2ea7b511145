import base64
import dataclasses
import json
import re
import shutil
import subprocess
from importlib import resources
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from refusals import refusal
from synthetic_run import squat

from wbc_controller.controller.visualization.page_report import resource
from wbc_controller.controller.visualization.plots import POINTS, thin_out
from wbc_controller.recording.report.motion import MAX_FRAMES, encode_poses, frame_indices, joint_poses, make_motion
from wbc_controller.recording.report.run_data import Result, _latest
from wbc_controller.recording.report.run_report import friction_use, run_plots, write_run_report


@pytest.fixture(scope="module")
def run():
    return squat("g1", duration=3.0, rate=200.0)


@pytest.fixture(scope="module")
def short():
    """A short run of a robot with few meshes."""
    return squat("go2", duration=1.0, rate=50.0)


@pytest.fixture(scope="module")
def page(run, tmp_path_factory):
    path = tmp_path_factory.mktemp("report") / "demo.html"
    write_run_report(*run, path, kind="wbc_controller demo")
    return path.read_text(encoding="utf-8")


def embedded(page, name):
    return json.loads(re.search(rf'<script type="application/json" id="{name}">(.*?)</script>', page, re.S).group(1))


def decode_poses(packed):
    """Decode the result of `encode_poses`, as ``replay.js`` does."""
    whole = np.frombuffer(base64.b64decode(packed["data"]), dtype="<i2").reshape(packed["shape"])
    return whole * np.array(packed["scale"]) + np.array(packed["center"])


def test_the_true_wrench_of_a_sample_is_the_newest_one():
    np.testing.assert_array_equal(_latest(np.array([[2.0, 5], [1, 4]]), np.array([0, 1, 3])), [[np.nan], [4], [5]])


def test_the_page_loads_nothing_and_holds_the_results(page, run):
    markup = re.sub(r"<script.*?</script>", "", page, flags=re.S)
    assert not re.search(r"(?:src|href)\s*=|@import|url\(|<link|<iframe|<img", markup, re.I)
    assert re.search(r"default-src 'none'", markup)
    assert not re.search(r"<script[^>]*\bsrc\b", page)
    for name in ("replay.js", "page.js"):
        code = resource(name)
        assert code in page
        assert not re.search(r"https?:|fetch\(|XMLHttpRequest|import\(|WebSocket|sendBeacon", code), name
    assert "{{" not in markup
    assert len(page.encode()) < 8e6
    for result in run[0].results:
        assert result.name in page
        assert result.measured in page
    assert "All 2 targets met." in page
    assert "never &lt;in it&gt;" in page


def test_verdict_of_missed_targets_and_of_a_bare_recording(short, tmp_path):
    recording, model = short
    failed = Result("Stays <up>", "yes", "no", False)
    spoiled = dataclasses.replace(recording, results=(*recording.results, failed))
    write_run_report(spoiled, model, tmp_path / "page.html", kind="a run")
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "1 of 3 targets missed: Stays &lt;up&gt;." in page
    assert 'class="pill fail"' in page
    nothing = {name: {} for name in ("task_errors", "contact_wrenches", "true_wrenches", "stage_seconds", "contacts")}
    bare = dataclasses.replace(
        recording, **nothing, cycle_seconds=np.zeros(0), phases=(), results=(), modes=(),
        com_reference=np.full_like(recording.com, np.nan),
    )  # fmt: skip
    write_run_report(bare, model, tmp_path / "page.html", kind="a run")
    assert "No targets were checked" in (tmp_path / "page.html").read_text(encoding="utf-8")


def test_poses_of_the_page_equal_pinocchio_and_forces_are_in_world_axes(run, page):
    recording, model = run
    data = embedded(page, "motion-data")
    poses = decode_poses(data["poses"])
    frames = frame_indices(recording.time)
    time = np.frombuffer(base64.b64decode(data["time"]), "<f4")
    np.testing.assert_allclose(time, recording.time[frames], atol=1e-6)
    assert np.diff(time).max() < 1.0 / 25.0
    kinematics = model.pinocchio.createData()
    assert {part["joint"] for part in data["parts"]} == set(range(data["joints"]))
    arm = np.array([0.1, 0.1, 0.1])
    for frame in (0, len(frames) // 3, len(frames) - 1):
        pin.forwardKinematics(model.pinocchio, kinematics, recording.q[frames[frame]])
        for i in range(data["joints"]):  # g1 has a visual on every joint except the world
            where = pin.XYZQUATToSE3(poses[frame, i] / np.r_[1, 1, 1, np.full(4, np.linalg.norm(poses[frame, i, 3:]))])
            assert np.linalg.norm(where.act(arm) - kinematics.oMi[i + 1].act(arm)) < 1e-3
    forces = np.frombuffer(base64.b64decode(data["forces"]), "<f4").reshape(len(frames), 2, 2, 6)
    # The synthetic squat keeps its soles flat, so that vertical and contact normal agree.
    np.testing.assert_allclose(forces[0, :, 0, 5], [w[0, 2] for w in recording.contact_wrenches.values()], rtol=1e-3)
    np.testing.assert_allclose(forces[0, :, 0, 2], 0.0, atol=2e-3)
    assert data["weight"] == pytest.approx(model.mass * model.gravity)


def test_packed_poses_are_exact_at_rest_and_quaternions_do_not_jump(run):
    _, model = run
    q = np.tile(pin.neutral(model.pinocchio), (200, 1))
    for i, angle in enumerate(np.linspace(0.0, 4.0 * np.pi, 200)):
        q[i, 3:7] = pin.SE3ToXYZQUAT(pin.SE3(pin.rpy.rpyToMatrix(0.3, 0.0, angle), np.zeros(3)))[3:]
    poses = joint_poses(q, model, [1, 5])
    assert np.abs(np.diff(poses[:, :, 3:], axis=0)).max() < 0.1
    poses = np.tile(np.array([1.5, -2.0, 0.3, 0.0, 0.0, 0.0, 1.0]), (4, 2, 1))
    np.testing.assert_allclose(decode_poses(encode_poses(poses)), poses, atol=1e-12)


def test_long_runs_stay_small_and_keep_peaks_and_gaps():
    frames = frame_indices(np.arange(0.0, 1000.0, 0.002))
    assert len(frames) == MAX_FRAMES
    assert frames[0] == 0
    assert frames[-1] == 499999
    assert list(frame_indices(np.array([3.0]))) == [0]
    time = np.arange(50000.0)
    values = np.sin(time / 3000.0)
    values[31234] = 7.0
    values[40000:41000] = np.nan
    x, y = thin_out(time, values)
    assert len(x) <= POINTS
    assert np.all(np.diff(x) > 0)
    assert np.nanmax(y) == 7.0
    assert np.isnan(y).any()
    assert not np.isfinite(y[(x >= 40000) & (x < 41000)]).any()


def test_every_plot_has_titles_and_units_and_phases_fill_the_run(run):
    plots = run_plots(run[0])
    assert [plot.key for plot in plots] == ["com", "torques", "forces", "friction", "errors", "cycles", "stages"]
    for plot in plots:
        assert plot.title
        assert all(plot.key == "stages" or "[" in axis.title.text for axis in plot.figure.select_yaxes())
        assert any("[" in (axis.title.text or "") for axis in plot.figure.select_xaxes())
        assert all(trace.type in ("scatter", "bar") for trace in plot.figure.data)  # SVG, not WebGL
    spans = run[0].spans
    assert spans[0][0] == 0.0
    assert spans[-1][1] == run[0].time[-1]
    assert all(a[1] == b[0] for a, b in pairwise(spans))


def test_an_invalid_run_is_refused(short, tmp_path):
    recording, model = short
    wide = dataclasses.replace(recording, q=np.zeros((len(recording.time), 20)))
    with pytest.raises(ValueError, match="20 columns"):
        write_run_report(wide, model, tmp_path / "x", kind="a run")
    lost = {name: contact.model_copy(update={"frame": "foo"}) for name, contact in recording.contacts.items()}
    said = refusal(write_run_report, dataclasses.replace(recording, contacts=lost), model, tmp_path / "x", kind="a run")
    assert "contacts.front_left_foot.frame = 'foo'" in said
    assert not (tmp_path / "x").exists()


def test_friction_use_and_corners_of_contacts(page, short):
    wrench = np.array([[30.0, 40.0, 100.0], [0.0, 0.0, 1.0], [np.nan] * 3])
    np.testing.assert_allclose(friction_use(wrench, 0.5), [1.0, np.nan, np.nan])
    assert np.isnan(friction_use(np.full((3, 6), np.nan), 0.5)).all()
    foot = next(each["corners"] for each in embedded(page, "motion-data")["contacts"] if each["name"] == "left_foot")
    np.testing.assert_allclose(np.mean(foot, axis=0), [0.035, 0.0, -0.035], atol=1e-12)
    np.testing.assert_allclose(np.ptp(foot, axis=0), [0.17, 0.05, 0.0])
    paw = next(each["corners"] for each in make_motion(*short)["contacts"] if each["name"] == "front_left_foot")
    np.testing.assert_allclose(paw, [[0.0012, 0.0, -0.2081]])


def test_mathematics_of_the_replay(tmp_path):
    node = shutil.which("node")
    if node is None:
        pytest.skip("node is not installed: the functions of replay.js are not run")
    source = resources.files("wbc_controller.controller.visualization") / "page" / "replay.js"
    quaternion = pin.SE3ToXYZQUAT(pin.SE3(pin.rpy.rpyToMatrix(0.3, -0.7, 1.9), np.zeros(3)))[3:]
    script = tmp_path / "run.js"
    script.write_text(f"""
        const Replay = require({json.dumps(str(source))});
        const [v, t] = Replay.subdivide([0, 0, 0, 1, 0, 0, 0, 1, 0], [0, 1, 2], 0.3);
        let area = 0, longest = 0;
        for (let k = 0; k < t.length; k += 3) {{
          const [a, b, c] = [0, 1, 2].map(i => [v[3 * t[k + i]], v[3 * t[k + i] + 1]]);
          area += ((b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])) / 2;
          longest = Math.max(longest, Math.hypot(b[0] - a[0], b[1] - a[1]));
        }}
        console.log(JSON.stringify({{
          R: Replay.rotation(...{json.dumps(quaternion.tolist())}), area, longest,
          hull: Replay.hull([[0, 0], [1, 0], [0.5, 0.5], [1, 1], [0, 1], [0.5, 0]]),
          locate: [-1, 0, 0.5, 2.5, 9].map(t => Replay.locate([0, 1, 3], t)),
          numbers: [...Replay.decode({json.dumps(base64.b64encode(np.int16([1, -2]).tobytes()).decode())}, Int16Array)],
        }}));
    """)
    out = subprocess.run([node, str(script)], capture_output=True, text=True, check=True, timeout=60)
    answer = json.loads(out.stdout)
    rotation = pin.Quaternion(np.array(quaternion)).toRotationMatrix()
    np.testing.assert_allclose(np.reshape(answer["R"], (3, 3)), rotation, atol=1e-12)
    assert answer["hull"] == [[0, 0], [1, 0], [1, 1], [0, 1]]
    assert answer["locate"] == [[0, 0], [0, 0], [0, 0.5], [1, 0.75], [2, 0]]
    assert answer["numbers"] == [1, -2]
    assert answer["area"] == pytest.approx(0.5)
    assert answer["longest"] <= 0.3
