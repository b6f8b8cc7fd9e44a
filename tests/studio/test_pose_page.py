"""The page in a real browser: a point of the face is dragged with the mouse, and the face follows."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from facewright.models.region_store import save_region_model

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
WAIT_S = 60.0
#: Folder for a picture of the page, if one is wanted.
PICTURES = os.environ.get("FACEWRIGHT_ARTIFACTS")


@pytest.fixture(scope="module")
def chromium():
    """A headless Chromium: the system's, else Playwright's own; skips where there is none."""
    playwright = pytest.importorskip("playwright.sync_api", reason="needs Playwright")
    with playwright.sync_playwright() as tool:
        found = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
        try:
            browser = tool.chromium.launch(executable_path=found, args=FLAGS)
        except playwright.Error as error:
            pytest.skip(f"needs a Chromium (apt install chromium, or playwright install chromium): {str(error)[:80]}")
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def served(face_models, tmp_path_factory):
    """`facewright pose` in a process of its own: its address and its folder."""
    folder = tmp_path_factory.mktemp("pose")
    for name, model in zip(("face", "holistic"), face_models, strict=True):
        save_region_model(model, folder / f"{name}.fwrm")
    words = ["pose", "face.fwrm", "--holistic", "holistic.fwrm", "--port", "0", "--no-browser", "--json"]
    command = [sys.executable, "-c", "from facewright.cli.main import run; run()", *words]
    own = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST")}  # NiceGUI looks for it
    with subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True, env=own) as process:
        line = process.stdout.readline()
        assert line, "the server ended before it answered"
        yield json.loads(line)["address"], folder
        process.send_signal(signal.SIGINT)
        assert process.wait(20) in (0, 130)


@pytest.fixture(scope="module")
def page(chromium, served):
    """The page, loaded once; fails if it asks anything of another machine or an error reaches its console."""
    page = chromium.new_page(viewport={"width": 1100, "height": 760})
    trouble = []
    page.on("pageerror", lambda error: trouble.append(str(error)))
    page.on("console", lambda message: trouble.append(message.text) if message.type == "error" else None)
    outside = ("http", "ws")
    page.on("request", lambda r: trouble.append(r.url) if r.url.startswith(outside) and "127.0.0.1" not in r.url else 0)
    page.goto(served[0])
    _wait(page, "window.facewrightPose?.ready() === true")
    yield page
    assert trouble == []
    page.close()


def _wait(page, condition):
    page.wait_for_function(condition, timeout=1000 * WAIT_S)


def _positions(page, kind="region"):
    return np.array(page.evaluate("kind => facewrightPose.positions(kind)", kind)).reshape(-1, 3)


def _find(page, near):
    """The control point nearest to a place (mm) that a click finds, and where it is on the screen."""
    rest = np.array(page.evaluate("facewrightPose.rest()")).reshape(-1, 3)
    handles = np.array(page.evaluate("facewrightPose.handles()"))
    for handle in np.argsort(np.linalg.norm(rest[handles] - near, axis=1))[:8]:
        at = page.evaluate("handle => facewrightPose.place(handle, 'region')", int(handle))
        if at["handle"] == handle:
            return int(handle), handles[handle], at
    raise AssertionError("no control point there can be seen")


def test_a_point_is_dragged_and_its_region_follows(page, served):
    _, vertex, at = _find(page, [30, -35, 100])  # left corner of the mouth
    before = _positions(page)
    page.mouse.move(at["x"], at["y"])
    page.mouse.down()
    for step in range(1, 9):
        page.mouse.move(at["x"] + 2 * step, at["y"] - 3 * step)
    _wait(page, "facewrightPose.measured().answers.length > 0")
    time.sleep(0.3)
    page.mouse.up()
    autosaved = served[1] / "pose.fwpose"
    deadline = time.monotonic() + WAIT_S
    while not autosaved.is_file() and time.monotonic() < deadline:
        time.sleep(0.05)
    moved = _positions(page) - before
    length = np.linalg.norm(moved, axis=1)
    assert moved[vertex, 1] > 2.0 and moved[vertex, 0] > 0.5  # up and to the person's left, as the mouse went
    assert length[before[:, 1] > 25].max() < 0.2 * length[vertex]  # the brows hardly
    if PICTURES:
        page.screenshot(path=Path(PICTURES) / "pose_page.png")

    # the browser draws what the session holds
    from facewright.apps.pose_file import open_pose
    from facewright.apps.pose_session import PoseSession
    from facewright.apps.posed_character import load_character
    from facewright.models.region_store import load_region_model

    session = PoseSession(
        load_region_model(served[1] / "face.fwrm"), holistic=load_region_model(served[1] / "holistic.fwrm")
    )
    open_pose(autosaved, session)
    character = load_character("builtin", session.models)
    for kind in session.kinds:
        expected = np.empty_like(character.neutral)
        character.pose(kind, session.coefficients(kind), expected)
        np.testing.assert_allclose(_positions(page, kind), expected, atol=1e-3)

    page.keyboard.press("Control+z")
    _wait(page, f"Math.abs(facewrightPose.positions('region')[{3 * vertex + 1}] - {before[vertex, 1]}) < 1e-3")
    np.testing.assert_allclose(_positions(page), before, atol=1e-3)


def test_pins_symmetry_keys_and_views(page):
    handle, _, at = _find(page, [30, -35, 100])
    page.keyboard.down("Shift")
    page.mouse.click(at["x"], at["y"])
    page.keyboard.up("Shift")
    _wait(page, f"facewrightPose.pins('region').some(([one]) => one === {handle})")
    page.get_by_text(f"Vertex {handle}", exact=True).wait_for(timeout=1000 * WAIT_S)
    page.mouse.move(at["x"], at["y"])
    page.keyboard.press("p")
    _wait(page, "facewrightPose.pins('region').length === 0")
    page.keyboard.press("Space")  # no keyframes yet
    page.get_by_text("playback needs at least two keyframes").wait_for(timeout=1000 * WAIT_S)
    page.keyboard.press("k")
    page.get_by_text("1 key,").wait_for(timeout=1000 * WAIT_S)
    page.keyboard.press("h")
    _wait(page, "facewrightPose.shown().length === 2")
    page.get_by_text("Holistic", exact=True).first.wait_for(timeout=1000 * WAIT_S)
    page.keyboard.press("Control+z")


@pytest.mark.slow
def test_another_character_takes_its_place(page):
    for name, enough in (("Model's mesh", "=== 200"), ("Built-in face", "> 5000")):
        for _ in range(5):  # the list hides where the browser was too busy to lay it out
            page.locator(".studio-bar .q-select").click()
            option = page.get_by_role("option", name=name)
            try:
                option.click(timeout=5000)
                break
            except Exception:
                page.keyboard.press("Escape")
        _wait(page, f"facewrightPose.rest().length / 3 {enough}")
        np.testing.assert_allclose(
            _positions(page), np.reshape(page.evaluate("facewrightPose.rest()"), (-1, 3)), atol=0.05
        )


def test_an_export_that_cannot_be_is_one_sentence(page, served):
    page.get_by_role("button", name="Export").click()
    page.get_by_label("Where").fill(str(served[1] / "nowhere" / "pose.glb"))
    page.get_by_role("button", name="Write").click()
    page.get_by_text("cannot be written").wait_for(timeout=1000 * WAIT_S)
    page.get_by_label("Where").fill(str(served[1] / "pose.glb"))
    page.get_by_role("button", name="Write").click()
    page.get_by_text(re.compile("^Written: ")).wait_for(timeout=1000 * WAIT_S)
    assert (served[1] / "pose.glb").read_bytes()[:4] == b"glTF"
