"""Takes the picture of the demo's report: python docs/report_picture.py report/g1.html docs/images/demo.png.

`wbc demo g1 --sensors good --lockstep` writes the report. Needs the packages of requirements/dev.txt, and Chromium.
"""

from __future__ import annotations

import sys
from pathlib import Path

from page_picture import launch, save
from playwright.sync_api import sync_playwright

#: Size of the picture, px.
SIZE = {"width": 1400, "height": 820}
#: Time of the reach in the report, s.
REACH = 19.5


def take(report: Path, path: Path) -> None:
    """Take the picture of the report at the time of the reach."""
    with sync_playwright() as started:
        browser = launch(started)
        page = browser.new_page(viewport=SIZE)
        page.goto(f"{report.resolve().as_uri()}#t={REACH}")
        page.wait_for_timeout(5000.0)
        save(page.screenshot(), path)
        browser.close()


if __name__ == "__main__":
    take(Path(sys.argv[1]), Path(sys.argv[2]))
