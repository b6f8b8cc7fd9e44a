"""Take the pictures of docs/guides/posing.md from the page itself, in headless Chromium, and time its answers.

python tools/draw_pose_page.py [docs/images]
"""

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from playwright.sync_api import Page, sync_playwright

FLAGS = [
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
]
#: The built-in face: left and right corner of the mouth, middle of the left brow, mm.
LEFT_CORNER, RIGHT_CORNER, LEFT_BROW = (28.0, -36.0, 100.0), (-28.0, -36.0, 100.0), (30.0, 48.0, 110.0)
STILL_S = 3.0


def place(page: Page, near: tuple[float, float, float]) -> tuple[int, float, float]:
    """Return the control point nearest to a place (mm) that can be clicked, and where it is on the screen."""
    rest = np.array(page.evaluate("facewrightPose.rest()")).reshape(-1, 3)
    handles = np.array(page.evaluate("facewrightPose.handles()"))
    for handle in np.argsort(np.linalg.norm(rest[handles] - near, axis=1))[:10]:
        at = page.evaluate("handle => facewrightPose.place(handle, 'region')", int(handle))
        if at["handle"] == handle:
            return int(handle), at["x"], at["y"]
    raise RuntimeError(f"no control point near {near} can be seen")


def pull(
    page: Page, near: tuple[float, float, float], dx: float, dy: float, *, steps: int = 12, hold: bool = False
) -> None:
    """Drag a control point by pixels."""
    _, x, y = place(page, near)
    page.mouse.move(x, y)
    page.mouse.down()
    for step in range(1, steps + 1):
        page.mouse.move(x + dx * step / steps, y + dy * step / steps)
        time.sleep(0.02)
    if not hold:
        page.mouse.up()
    time.sleep(0.5)


def click_time(page: Page, seconds: float, span: float = 4.0) -> None:
    """Go to a time of the timeline."""
    box = page.locator(".timeline").bounding_box()
    assert box is not None
    page.mouse.click(box["x"] + 18 + seconds / span * (box["width"] - 36), box["y"] + 40)
    time.sleep(0.5)


def draw(page: Page, folder: Path) -> None:
    """Pose a smirk with a raised brow, and take two pictures."""
    page.keyboard.press("k")
    click_time(page, 1.0)
    pull(page, LEFT_CORNER, 14, -20)
    pull(page, LEFT_CORNER, 8, -12)
    page.keyboard.press("k")
    click_time(page, 2.0)
    handle, x, y = place(page, RIGHT_CORNER)
    page.keyboard.down("Shift")
    page.mouse.click(x, y)
    page.keyboard.up("Shift")
    pull(page, LEFT_BROW, 3, -26)
    page.keyboard.press("k")
    page.keyboard.press("r")
    pull(page, LEFT_CORNER, 8, -14, hold=True)
    time.sleep(STILL_S)
    page.screenshot(path=folder / "pose_page.png")
    page.mouse.up()
    page.keyboard.press("Control+z")
    page.keyboard.press("r")
    page.keyboard.press("h")
    page.mouse.move(40, 500)
    time.sleep(STILL_S)
    page.screenshot(path=folder / "pose_side_by_side.png")
    page.keyboard.press("h")
    sys.stdout.write(f"pinned vertex {handle}; pictures in {folder}\n")


def measure(page: Page) -> None:
    """Time drags at 60 moves a second, and drawing."""
    page.evaluate("facewrightPose.forget()")
    _, x, y = place(page, LEFT_CORNER)
    page.mouse.move(x, y)
    page.mouse.down()
    for step in range(180):
        page.mouse.move(x + 25 * np.sin(step / 15), y - 25 * abs(np.sin(step / 20)))
        time.sleep(1 / 60)
    page.keyboard.press("Escape")
    page.mouse.up()
    taken = page.evaluate("facewrightPose.measured()")
    sys.stdout.write(f"{page.evaluate('facewrightPose.renderer()')}, load {os.getloadavg()[0]:.1f}\n")
    times = {
        "message to positions": taken["roundTrips"],
        "mouse event to drawn": taken["answers"],
        "between frames": list(np.diff(taken["frames"])),
    }
    for share, quickly in ((1, False), (1, True), (0.5, True), (0.35, True)):
        ask = f"facewrightPose.drawing(8, {share}, {'true' if quickly else 'false'})"
        times[f"drawing {share:g} {'by sphere' if quickly else 'full light'}"] = page.evaluate(ask)
    for name, values in times.items():
        low, mid, high = np.percentile(values, [0, 50, 90]) if values else (np.nan,) * 3
        sys.stdout.write(f"{name}: n {len(values)}, best {low:.1f}, median {mid:.1f}, 90 % {high:.1f} ms\n")


def main() -> None:
    """Serve the page, draw and measure it."""
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "docs/images").resolve()
    with tempfile.TemporaryDirectory() as work, sync_playwright() as tool:
        command = [sys.executable, "-m", "facewright", "pose", "--no-browser", "--port", "0", "--json"]
        with subprocess.Popen(command, cwd=work, stdout=subprocess.PIPE, text=True) as server:
            assert server.stdout is not None
            address = json.loads(server.stdout.readline())["address"]
            browser = tool.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
            page = browser.new_page(viewport={"width": 1600, "height": 1000})
            page.goto(address)
            page.wait_for_function("window.facewrightPose?.ready() === true", timeout=120_000)
            time.sleep(STILL_S)
            draw(page, folder)
            measure(page)
            browser.close()
            server.send_signal(signal.SIGINT)


if __name__ == "__main__":
    main()
