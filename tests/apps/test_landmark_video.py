"""Landmarks of a video file in pieces: a run that was killed ends like one that was not."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("av")

from facewright.apps import landmark_video
from facewright.apps.landmark_video import LandmarkVideo, find_video_landmarks, frame_rate_of
from facewright.io.video_reader import VideoInfo
from facewright.io.video_writer import FrameClock, VideoWriter
from facewright.landmarks import video_detector
from facewright.landmarks.track import LandmarkTrack

FRAMES = 47


class Remembers:
    """A detector whose answers depend on the frames before, like one that follows a face; loses dark frames."""

    seen = 0

    def __init__(self, face_index: int, task_file: Path | None) -> None:
        self.state = float(face_index)

    def __enter__(self) -> Remembers:
        return self

    def __exit__(self, *error: object) -> None:
        pass

    def detect(self, image: np.ndarray) -> SimpleNamespace:
        Remembers.seen += 1
        level = float(image.mean())
        self.state = 0.5 * self.state + level
        if level < 40:
            return SimpleNamespace(points=None, cut=False)
        points = np.full((478, 2), self.state, np.float32)
        points[0] = 4.0  # so that the square reaches into the picture
        return SimpleNamespace(points=points, cut=abs(level - 150) < 1)


@pytest.fixture(autouse=True)
def small_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(landmark_video, "PIECE", 12)
    monkeypatch.setattr(landmark_video, "WARM_UP", 4)
    monkeypatch.setattr(video_detector, "VideoDetector", Remembers)


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("clip") / "a.mp4"
    with VideoWriter(path, 32, 16, FrameClock(np.arange(FRAMES) / 25, Fraction(25))) as video:
        for k in range(FRAMES):
            video.write(np.full((16, 32, 3), 20 if 20 <= k < 27 else 60 + 3 * k, np.uint8))
    return path


def same(a: LandmarkVideo, b: LandmarkVideo) -> None:
    for name in ("times", "points", "tracked", "cuts"):
        np.testing.assert_array_equal(getattr(a.track, name), getattr(b.track, name))
    assert (a.info, a.start, a.notes) == (b.info, b.start, b.notes)
    for k in range(a.track.n_frames):
        one, other = a.crops.at(k), b.crops.at(k)
        assert (one is None) == (other is None) == (not a.track.tracked[k])
        if one is not None and other is not None:
            np.testing.assert_array_equal(one.pixels, other.pixels)
            assert one.step == other.step and (one.corner == other.corner).all()


class Killed(BaseException):
    pass


@pytest.mark.parametrize("killed_at", [1, 11, 12, 13, 30, 36, FRAMES])
def test_killed_run_is_taken_up_and_ends_the_same(tmp_path: Path, clip: Path, killed_at: int) -> None:
    (tmp_path / "whole").mkdir()
    whole = find_video_landmarks(clip, tmp_path / "whole")
    assert whole.track.n_frames == FRAMES and whole.track.image_size == (16, 32)
    assert not whole.track.tracked[20:27].any() and whole.track.tracked[:20].all()

    def kill(stage: str, done: int, total: int) -> None:
        if done >= killed_at:
            raise Killed

    folder = tmp_path / "killed"
    folder.mkdir()
    with pytest.raises(Killed):
        find_video_landmarks(clip, folder, progress=kill)
    Remembers.seen = 0
    same(find_video_landmarks(clip, folder), whole)
    # Whole pieces of before are not detected again, but for the warm-up of the next one.
    assert Remembers.seen <= FRAMES - killed_at // 12 * 12 + 4 * 4 + 12
    Remembers.seen = 0
    same(find_video_landmarks(clip, folder), whole)
    assert Remembers.seen == 0


def test_detector_is_warm_at_the_start_of_a_piece(tmp_path: Path, clip: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pieces = find_video_landmarks(clip, _made(tmp_path / "a")).track
    monkeypatch.setattr(landmark_video, "PIECE", 1000)
    whole = find_video_landmarks(clip, _made(tmp_path / "b")).track
    tracked = whole.tracked
    # Four frames of warm-up leave a sixteenth of what was before.
    assert np.abs(pieces.points[tracked] - whole.points[tracked]).max() < 0.1 * np.nanmax(whole.points)
    np.testing.assert_array_equal(pieces.points[:12][tracked[:12]], whole.points[:12][tracked[:12]])


def _made(path: Path) -> Path:
    path.mkdir()
    return path


def test_frame_rate_is_the_stated_one_where_the_times_agree() -> None:
    def video(times: np.ndarray) -> LandmarkVideo:
        n = len(times)
        track = LandmarkTrack(times, np.zeros((n, 478, 2), np.float32), np.ones(n, bool), (4, 4))
        return LandmarkVideo(track, VideoInfo(4, 4, Fraction(30000, 1001), n, 1.0, 0, False), 0.0, ())

    assert frame_rate_of(video(np.arange(50) * 1001 / 30000)) == Fraction(30000, 1001)
    assert float(frame_rate_of(video(np.arange(50) / 12.5))) == pytest.approx(12.5, rel=1e-6)
    assert frame_rate_of(video(np.zeros(1))) == Fraction(30000, 1001)
