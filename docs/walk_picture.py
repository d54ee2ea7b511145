"""Makes the moving picture of the walk: python docs/walk_picture.py report/walk.html docs/images/walk.webp.

`wbc demo walk --sensors good --lockstep` writes the report. Needs the packages of requirements/dev.txt, and Chromium.
"""

from __future__ import annotations

import io
import json
import sys
from pathlib import Path

from page_picture import launch
from PIL import Image
from playwright.sync_api import Page, sync_playwright

#: Size of the picture, px, and pictures per second.
SIZE, RATE = {"width": 640, "height": 440}, 15
#: Phase of the demo, and the time of the picture before and after its end, s.
PHASE, BEFORE, AFTER = "walk forward", 4.0, 5.0
#: Angle of the camera about the vertical, and above the ground, degrees; magnification.
CAMERA = "az=40&el=14&zoom=1.02"
#: Quality of the compression, 0 to 100.
QUALITY = 45


def take(report: Path, path: Path) -> None:
    """Draw the replay of the report at equal distances of time."""
    with sync_playwright() as started:
        browser = launch(started)
        page = browser.new_page(viewport=SIZE)
        page.goto(f"{report.resolve().as_uri()}#only=replay&t=0&{CAMERA}")
        frames = [_frame(page, time) for time in _times(page)]
        browser.close()
    frames[0].save(
        path, save_all=True, append_images=frames[1:], duration=round(1000.0 / RATE), loop=0, quality=QUALITY, method=6
    )
    print(f"{path}: {len(frames)} pictures, {path.stat().st_size // 1000} kB")


def _times(page: Page) -> list[float]:
    motion = json.loads(page.locator("#motion-data").text_content() or "{}")
    middle = next(end for _, end, name in motion["phases"] if name == PHASE)
    return [middle - BEFORE + i / RATE for i in range(round((BEFORE + AFTER) * RATE))]


def _frame(page: Page, time: float) -> Image.Image:
    page.evaluate(
        "time => new Promise(done => { replay.seek(time); requestAnimationFrame(() => requestAnimationFrame(done)); })",
        time,
    )
    return Image.open(io.BytesIO(page.locator("#replay canvas").screenshot())).convert("RGB")


if __name__ == "__main__":
    take(Path(sys.argv[1]), Path(sys.argv[2]))
