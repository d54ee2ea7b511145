"""Live tests on a busy computer: deadline failures are repeated, faults are reported."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
TESTS = """
import pytest
from pathlib import Path

@pytest.fixture
def attempt():
    count = Path("count")
    count.write_text(str(int(count.read_text()) + 1 if count.exists() else 1))
    return int(count.read_text())

@pytest.mark.{marker}
def test_once(attempt):
    print("attempt", attempt)
    assert attempt >= {succeeds}, f"attempt {{attempt}}"
"""


@pytest.mark.parametrize(
    ("slowness", "marker", "succeeds", "attempts", "outcome"),
    [
        (9.0, "live", 1, 1, "1 passed"),
        (9.0, "live", 2, 2, "1 passed, 1 warning"),
        (9.0, "live", 9, 3, "1 failed, 2 warnings"),  # a fault fails every time
        (1.0, "live", 2, 1, "1 failed"),
        (9.0, "browser", 2, 1, "1 failed"),
    ],
)
def test_only_live_tests_are_repeated_and_only_on_a_busy_computer(
    tmp_path, slowness, marker, succeeds, attempts, outcome
):
    hook = f"import busy\nbusy.slowness = lambda: {slowness}\nfrom busy import pytest_runtest_protocol\n"
    (tmp_path / "conftest.py").write_text(hook)
    (tmp_path / "test_once.py").write_text(TESTS.format(marker=marker, succeeds=succeeds))
    words = [sys.executable, "-m", "pytest", "-q", "-c", str(ROOT / "pyproject.toml"), "--rootdir", str(tmp_path), "."]
    done = subprocess.run(
        [*words, "-p", "no:cacheprovider"], cwd=tmp_path, env=os.environ, capture_output=True, text=True
    )
    assert f"\n{outcome} in " in done.stdout, done.stdout
    assert (tmp_path / "count").read_text() == str(attempts)
    if succeeds == 2 and attempts == 2:
        assert "failed at a load average of" in done.stdout
        assert "and is repeated: AssertionError: attempt 1" in done.stdout
