"""Page of `wbc check --html`."""

import json
import re

import pytest
from command_line import wbc

from wbc_controller.apps.terminal.check_page import write_check_page
from wbc_controller.controller.check.preflight import check
from wbc_controller.settings.config import load

WIDE = {f"contacts.{side}_foot.{key}": size for side in ("left", "right")
        for key, size in (("half_length", 0.14), ("half_width", 0.09))}  # fmt: skip


def polygons(page, kind):
    """Return the polygons of a kind by title, corners in pixels."""
    drawn = re.findall(rf'<polygon class="{kind}" points="([^"]*)"><title>([^<]*)</title>', page)
    return {title: [tuple(map(float, corner.split(","))) for corner in points.split()] for points, title in drawn}


def sides(corners):
    return [max(values) - min(values) for values in zip(*corners, strict=True)]


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    path = tmp_path_factory.mktemp("check") / "page.html"
    config = load("g1")
    write_check_page(config, check(config), "", path)
    return path.read_text(encoding="utf-8")


def test_page_has_findings_soles_and_forces(page):
    markup = re.sub(r"<script.*?</script>", "", page, flags=re.S)
    assert not re.search(r"(?:src|href)\s*=|@import|url\(|<link|<iframe|<img", markup, re.I)
    assert "{{" not in markup
    assert "170 × 50 mm on a sole of 170 × 60 mm" in page
    assert ">ok<" in page
    scale = float(re.search(r'class="scale" d="M [\d.]+ [\d.]+ h ([\d.]+)"', page).group(1)) / 100.0  # pixels per mm
    assumed = sides(polygons(page, "assumed")["left_foot: in the configuration"])
    true = sides(polygons(page, "true")["left_foot: underside in the URDF"])
    assert [side / scale for side in assumed] == pytest.approx([50.0, 170.0], abs=0.2)
    assert [side / scale for side in true] == pytest.approx([60.0, 170.0], abs=0.2)
    (motion,) = re.findall(r'<script type="application/json" id="motion-data">(.*?)</script>', page, re.S)
    data = json.loads(motion)
    assert {contact["name"] for contact in data["contacts"]} == {"left_foot", "right_foot"}
    assert len(data["parts"]) > 20


def test_failed_check_writes_a_page_with_its_error(tmp_path):
    path = tmp_path / "wide.yaml"
    path.write_text(load("talos").replace(WIDE).to_yaml(), encoding="utf-8")
    assert "reach 54 mm beyond the sole" in wbc("check", path, "--html", tmp_path / "page.html", status=2).stderr
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "reach 54 mm beyond the sole" in page
    assumed, true = polygons(page, "assumed"), polygons(page, "true")
    width = sides(true["left_foot: underside in the URDF"])[0]
    assert sides(assumed["left_foot: in the configuration"])[0] > 1.3 * width


def test_check_without_a_drawing(tmp_path):
    path = tmp_path / "none.yaml"
    path.write_text(load("g1").to_yaml().replace("left_knee_joint", "no_such_joint"), encoding="utf-8")
    result = wbc("check", path, "--html", tmp_path / "page.html", status=2)
    assert "no_such_joint" in result.stderr
    assert "page.html: not written" in result.stderr
    assert not (tmp_path / "page.html").exists()
