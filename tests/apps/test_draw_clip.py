"""Drawing a clip: threads, pieces, a killed run; photos of any size."""

from __future__ import annotations

import threading
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image

pytest.importorskip("av")

from facewright.apps import draw_clip as module
from facewright.apps.draw_clip import draw_clip, photo_for_video
from facewright.apps.photo_motion import PhotoMotion
from facewright.camera.pinhole import RigidMotion
from facewright.errors import FileFormatError, ValueRangeError
from facewright.io.video_reader import VideoReader
from facewright.io.video_writer import FrameClock

FRAMES = 25


class Draws:
    """A subject whose picture tells the frame by its grey level."""

    def __init__(self) -> None:
        self.photo = np.zeros((16, 24, 3), np.uint8)
        self.drawn: list[int] = []
        self.lock = threading.Lock()

    def vertices(self, weights: np.ndarray, gaze: np.ndarray) -> float:
        return float(weights[0])

    def view(self, vertices: float, pose: Any) -> float:
        return vertices

    @property
    def synthesiser(self) -> Draws:
        return self

    def draw(self, view: float, gaze: np.ndarray) -> SimpleNamespace:
        with self.lock:
            self.drawn.append(round(view * 100))
        return SimpleNamespace(image=np.full(self.photo.shape, round(20 + 200 * view), np.uint8))


def motion() -> PhotoMotion:
    pose = RigidMotion(np.eye(3), np.zeros(3))
    weights = np.arange(FRAMES)[:, None] / 100
    return PhotoMotion(np.arange(FRAMES) / 25, weights, (pose,) * FRAMES, np.zeros((FRAMES, 2, 2)))


CLOCK = FrameClock(np.arange(FRAMES) / 25, Fraction(25))


@pytest.fixture(autouse=True)
def small_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "PIECE", 10)


@pytest.mark.parametrize("threads", [1, 3])
def test_frames_are_in_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, threads: int) -> None:
    monkeypatch.setattr(module, "thread_count", lambda: threads)
    draw_clip(Draws(), motion(), CLOCK, tmp_path, tmp_path / "a.mp4")  # type: ignore[arg-type]
    with VideoReader(tmp_path / "a.mp4") as video:
        levels = [frame.image.mean() for frame in video]
    np.testing.assert_allclose(levels, 20 + 2 * np.arange(FRAMES), atol=2)


class Killed(BaseException):
    pass


@pytest.mark.parametrize("killed_at", [1, 10, 15, 25])
def test_killed_run_ends_with_the_same_bytes(tmp_path: Path, killed_at: int) -> None:
    for name in ("whole", "killed"):
        (tmp_path / name).mkdir()
    draw_clip(Draws(), motion(), CLOCK, tmp_path / "whole", tmp_path / "whole.mp4")  # type: ignore[arg-type]

    def kill(stage: str, done: int, total: int) -> None:
        if done >= killed_at:
            raise Killed

    folder, out = tmp_path / "killed", tmp_path / "killed.mp4"
    with pytest.raises(Killed):
        draw_clip(Draws(), motion(), CLOCK, folder, out, progress=kill)  # type: ignore[arg-type]
    assert not out.exists()
    again = Draws()
    draw_clip(again, motion(), CLOCK, folder, out)  # type: ignore[arg-type]
    assert out.read_bytes() == (tmp_path / "whole.mp4").read_bytes()
    assert sorted(again.drawn) == list(range((killed_at - 1) // 10 * 10, FRAMES))


def test_clock_must_be_that_of_the_motion(tmp_path: Path) -> None:
    clock = FrameClock(np.arange(3) / 25, Fraction(25))
    with pytest.raises(ValueRangeError, match="25 frames"):
        draw_clip(Draws(), motion(), clock, tmp_path, tmp_path / "a.mp4")  # type: ignore[arg-type]


def saved(path: Path, width: int, height: int, mode: str = "RGB") -> Path:
    Image.fromarray(np.full((height, width), 128, np.uint8)).convert(mode).save(path)
    return path


def test_photos_become_even_and_no_larger_than_asked_for(tmp_path: Path) -> None:
    file, scale = photo_for_video(saved(tmp_path / "a.png", 401, 301), 1280)
    assert file.pixels.shape == (300, 400, 3) and scale == 1 and file.remarks == ()
    file, scale = photo_for_video(saved(tmp_path / "b.png", 1601, 1201), 640)
    assert file.pixels.shape == (480, 640, 3) and scale == pytest.approx(640 / 1601)
    assert "1601 x 1201" in file.remarks[-1] and "640 x 480" in file.remarks[-1]


def test_transparent_photos_are_laid_over_white(tmp_path: Path) -> None:
    Image.new("RGBA", (8, 8), (0, 0, 0, 0)).save(tmp_path / "a.png")
    assert (photo_for_video(tmp_path / "a.png", 640)[0].pixels == 255).all()


def test_what_is_no_photo_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.png").write_bytes(b"no picture")
    with pytest.raises(FileFormatError):
        photo_for_video(tmp_path / "a.png", 640)
    with pytest.raises(ValueRangeError, match="size"):
        photo_for_video(saved(tmp_path / "b.png", 10, 10), 10)
