"""The hand-written page on the architecture names files that exist."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")


def test_named_modules_exist():
    """`nodes/loop` is a file or folder of the package."""
    named = re.findall(
        r"`((?:nodes|controller|middleware|inverse_dynamics|simulation|recording|safety)/[\w/.]+)`", PAGE
    )
    assert len(named) > 12
    missing = [
        name for name in named if not any((ROOT / "wbc_controller" / f"{name}{end}").exists() for end in ("", ".py"))
    ]
    assert missing == []
