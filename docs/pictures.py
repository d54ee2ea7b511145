"""Takes the pictures of docs/images: python docs/pictures.py page|demo|walk.

Needs Chromium, the packages of requirements/dev.txt, and for `demo` and `walk` the reports of
`wbc demo g1 --sensors good --lockstep` and `wbc demo walk --sensors good --lockstep`.
"""

import io
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import Browser, Page, Playwright, sync_playwright

from wbc_controller.apps.page.page_service import free_domain
from wbc_controller.apps.terminal.request_parser import parse_request
from wbc_controller.apps.terminal.session import Session
from wbc_controller.settings.config import load

_ROOT = Path(__file__).resolve().parents[1]
_IMAGES, _REPORTS = _ROOT / "docs" / "images", _ROOT / "report"
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
#: Size of the report, px, and time of the reach, s.
REPORT_SIZE, REACH = {"width": 1400, "height": 820}, 19.5
#: Size of the moving picture, px, pictures per second, and quality of the compression, 0 to 100.
WALK_SIZE, RATE, QUALITY = {"width": 640, "height": 440}, 15, 45
#: Phase of the walk, and the time of the picture before and after its end, s.
PHASE, BEFORE, AFTER = "walk forward", 4.0, 5.0
#: Angle of the camera about the vertical, and above the ground, degrees; magnification.
CAMERA = "az=40&el=14&zoom=1.02"


def take_page() -> None:
    """Take the picture of `wbc play` with G1 on a mock robot, during a reach."""
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
    save(picture, _IMAGES / "page.png")


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


def take_demo() -> None:
    """Take the picture of the demo's report at the time of the reach."""
    with sync_playwright() as started:
        browser = launch(started)
        page = browser.new_page(viewport=REPORT_SIZE)
        page.goto(f"{(_REPORTS / 'g1.html').as_uri()}#t={REACH}")
        page.wait_for_timeout(5000.0)
        save(page.screenshot(), _IMAGES / "demo.png")
        browser.close()


def take_walk() -> None:
    """Draw the replay of the walk's report at equal distances of time."""
    with sync_playwright() as started:
        browser = launch(started)
        page = browser.new_page(viewport=WALK_SIZE)
        page.goto(f"{(_REPORTS / 'walk.html').as_uri()}#only=replay&t=0&{CAMERA}")
        frames = [_frame(page, time) for time in _times(page)]
        browser.close()
    path = _IMAGES / "walk.webp"
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
    {"page": take_page, "demo": take_demo, "walk": take_walk}[sys.argv[1]]()
