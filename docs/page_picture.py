"""Takes the picture of the live page in the README: python docs/page_picture.py docs/images/page.png.

It plays with G1 on a mock robot, in Chromium without a screen, and needs the packages of requirements/dev.txt.
"""

from __future__ import annotations

import io
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

from wbc_controller.apps.page.play import free_domain
from wbc_controller.apps.terminal.request_parser import parse_request
from wbc_controller.apps.terminal.session import Session
from wbc_controller.settings.config import load

#: Size of the page, px.
SIZE = {"width": 1440, "height": 820}
#: What the robot does: it bends its knees and reaches forward and up.
SENTENCES = (
    "com 6cm down",
    "update {tasks: {right_hand: {enabled: true}, left_hand: {enabled: true}}}",
    "right_hand 12cm forward 18cm up",
    "left_hand 16cm forward 6cm up",
)
#: Time for it, for a browser that draws without a GPU, s.
PATIENCE = 20.0
#: With slow motion below, for a computer that is busy with drawing.
CHANGES = {"safety.state_timeout": 1.0}


def take(path: Path) -> None:
    """Take the picture."""
    config, domain = load("g1").replace(CHANGES), free_domain()
    os.environ |= {"ROS_DOMAIN_ID": str(domain)}
    with tempfile.TemporaryDirectory() as folder:
        robot = Path(folder) / "g1.yaml"
        robot.write_text(config.to_yaml(), encoding="utf-8")
        command = [sys.executable, "-m", "wbc_controller", "play", str(robot), "--port", "0", "--domain", str(domain)]
        command += ["--real-time-factor", "0.4"]  # in slow motion, torques come in time beside a browser without a GPU
        environment = {name: value for name, value in os.environ.items() if name != "DISPLAY"}
        playing = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)  # noqa: S603 - our own
        try:
            address = next(match[1] for line in playing.stdout or () if (match := re.match(r"page: (\S+)", line)))
            with Session(config.settings, patience=60.0) as session:
                session.listen("controller", "state")
                session.until(lambda: session.mode() == "active", "the controller is not active", 60.0)
                picture = _picture(address, lambda: _act(session, config.settings))
        finally:
            playing.send_signal(signal.SIGINT)
            playing.wait()
    image = Image.open(io.BytesIO(picture)).convert("RGB")
    image.quantize(256, method=Image.Quantize.MAXCOVERAGE, kmeans=3).save(path, optimize=True)
    print(f"{path}: {path.stat().st_size // 1000} kB")


def _act(session: Session, settings: object) -> None:
    for sentence in SENTENCES:
        session.execute(parse_request(sentence.split(" ", 1) if "{" in sentence else sentence.split(), settings))


def _picture(address: str, act: object) -> bytes:
    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))))
    with sync_playwright() as started:
        flags = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]
        browser = started.chromium.launch(executable_path=chromium, args=flags)
        page = browser.new_page(viewport=SIZE)
        page.set_default_timeout(120_000)
        page.goto(address)
        page.get_by_text("active", exact=True).wait_for()
        page.get_by_role("button", name="Hold").wait_for()
        for close in page.locator(".mantine-Notification-closeButton").all():
            close.click()  # that the browser draws without a GPU is true of this one alone
        page.get_by_text("Show", exact=True).click()
        page.get_by_label("Shadows").check()
        act()  # type: ignore[operator]
        page.get_by_text("Show", exact=True).click()
        page.get_by_role("button", name="STOP").scroll_into_view_if_needed()
        page.wait_for_timeout(1000.0 * PATIENCE)
        picture = page.screenshot()
        browser.close()
    return picture


if __name__ == "__main__":
    take(Path(sys.argv[1]))
