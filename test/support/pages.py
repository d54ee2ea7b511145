"""Pages of the documentation, with their YAML snippets."""

import re
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).parents[2]


def page(name: str) -> str:
    """Text of a page of docs."""
    return (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8")


def snippets(text: str) -> list[Any]:
    """Content of the YAML snippets of a page."""
    return [yaml.safe_load(block) for block in re.findall(r"```yaml\n(.*?)```", text, re.DOTALL)]
