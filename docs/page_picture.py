"""Takes the picture of the live page: python docs/page_picture.py docs/images/page.png.

`wbc play` runs with G1 on a mock robot; headless Chromium draws the page. Needs the packages of requirements/dev.txt.
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
from playwright.sync_api import Browser, Playwright, sync_playwright

from wbc_controller.apps.page.page_service import free_domain
from wbc_controller.apps.terminal.request_parser import parse_request
from wbc_controller.apps.terminal.session import Session
from wbc_controller.settings.config import load

#: Size of the page, px.
SIZE = {"width": 1440, "height": 820}
#: Requests to the robot: bend the knees, reach forward and up.
REQUESTS = (
    "com 6cm down",
    "update {tasks: {right_hand: {enabled: true}, left_hand: {enabled: true}}}",
    "right_hand 12cm forward 18cm up",
    "left_hand 16cm forward 6cm up",
)
#: Time for the motion, in a browser without a GPU, s.
PATIENCE = 20.0
#: With slow motion, this lets the states arrive in time while the browser occupies the processors.
CHANGES = {"safety.state_timeout": 1.0}


def take(path: Path) -> None:
    """Take the picture of the page during a reach."""
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
    save(picture, path)


def save(picture: bytes, path: Path) -> None:
    """Write a screenshot with a palette of 256 colours."""
    image = Image.open(io.BytesIO(picture)).convert("RGB")
    image.quantize(256, method=Image.Quantize.MAXCOVERAGE, kmeans=3).save(path, optimize=True)
    print(f"{path}: {path.stat().st_size // 1000} kB")


def launch(started: Playwright) -> Browser:
    """Start Chromium, which draws without a GPU."""
    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))))
    flags = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]
    return started.chromium.launch(executable_path=chromium, args=flags)


def _act(session: Session, settings: object) -> None:
    for request in REQUESTS:
        session.execute(parse_request(request.split(" ", 1) if "{" in request else request.split(), settings))


def _picture(address: str, act: object) -> bytes:
    with sync_playwright() as started:
        browser = launch(started)
        page = browser.new_page(viewport=SIZE)
        page.set_default_timeout(120_000)
        page.goto(address)
        page.get_by_text("active", exact=True).wait_for()
        page.get_by_role("button", name="Hold").wait_for()
        for close in page.locator(".mantine-Notification-closeButton").all():
            close.click()  # the warning about the missing GPU
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
