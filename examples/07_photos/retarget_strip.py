"""A film and a sheet of edits, closely: docs/images/retarget_strip.jpg and edit_sheet.jpg.

Needs the landmarks extra and the video extra.

A simulated person acts, the astronaut portrait does the same. Every column of the strip is a frame: the actor, the
portrait, and the portrait's eyes and mouth three times as large. The video itself goes where ``--video`` says.
"""

import argparse
import tempfile
from fractions import Fraction
from pathlib import Path

import numpy as np
from PIL import Image

from facewright.apps.animate import PhotoChoice
from facewright.apps.build_model import BuildModelRequest, build_model
from facewright.apps.demo import astronaut_portrait
from facewright.apps.edit_photo import EditRequest, edit_photo
from facewright.apps.retarget import RetargetRequest, retarget
from facewright.apps.track_video import VideoChoice
from facewright.evaluation.simulated_video import simulate_video
from facewright.faces import load_face
from facewright.imaging.contact_sheet import contact_sheet
from facewright.io.image import read_image, write_image
from facewright.io.video_reader import VideoReader
from facewright.io.video_writer import FrameClock, VideoWriter, join_videos
from facewright.landmarks.detector import LandmarkDetector, open_detector

EYES, MOUTH = (36, 72), (44, 72)  # height and width, pixels
HEAD = (slice(40, 220), slice(136, 316))
COLUMNS, LARGER = 8, 3
FRAMES_PER_SECOND = 25


def main(out: Path, n_people: int | None = None, seconds: float = 6.0, video: Path | None = None) -> None:
    """Retarget a simulated actor and show every nth frame; draw the sheet of attributes."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        photo, model = folder / "portrait.png", None
        write_image(photo, astronaut_portrait())
        if n_people is not None:
            model, seconds = folder / "small.fwbm", 1.0
            build_model(BuildModelRequest(model, "builtin", n_people, n_people, 47, n_unseen=0))
        film = video or folder / "film.mp4"
        actors = film_of_an_actor(folder / "actor.mp4", seconds)
        retarget(RetargetRequest(VideoChoice(folder / "actor.mp4"), PhotoChoice(photo, model=model), film))
        with VideoReader(film) as reader:
            frames = [frame.image for frame in reader]
        shown = np.linspace(0, len(frames) - 1, COLUMNS + 2)[1:-1].astype(int)
        with open_detector() as detector:
            strip = [np.concatenate([actors[k], *close_ups(frames[k], detector)], axis=0) for k in shown]
        captions = [f"{k / FRAMES_PER_SECOND:.1f} s" for k in shown]
        write_image(out / "retarget_strip.jpg", contact_sheet(strip, captions, columns=COLUMNS), quality=84)
        edit_photo(EditRequest(photo, {}, out=None, sheet=folder / "sheet.png", model=model))
        write_image(out / "edit_sheet.jpg", smaller(read_image(folder / "sheet.png"), 720), quality=80)


def film_of_an_actor(path: Path, seconds: float) -> list[np.ndarray]:
    """Film a simulated person; returns the head of each frame, as wide as the strip's columns."""
    clip = simulate_video(load_face("builtin"), np.random.default_rng(8), seconds, rest_first=False)
    frames = list(clip.images())
    height, width = frames[0].shape[:2]
    clock = FrameClock(np.arange(len(frames)) / FRAMES_PER_SECOND, Fraction(FRAMES_PER_SECOND))
    with VideoWriter(path.with_name("piece.mp4"), width, height, clock) as out:
        for frame in frames:
            out.write(frame)
    join_videos(path, [path.with_name("piece.mp4")], clock)
    side = min(height, width)
    left, top = (width - side) // 2, (height - side) // 2
    return [smaller(frame[top : top + side, left : left + side], LARGER * 72) for frame in frames]


def close_ups(frame: np.ndarray, detector: LandmarkDetector) -> list[np.ndarray]:
    """Return the head, and eyes and mouth enlarged where they are in the frame."""
    parts = [smaller(frame[HEAD], LARGER * 72)]
    (face, *_) = detector.detect(frame)
    found = face.convert("fw74")
    for (height, width), wanted in ((EYES, ("left_eye", "right_eye")), (MOUTH, ("outer_mouth",))):
        ids = [k for group in wanted for k in found.definition.groups[group]]
        x, y = np.rint(found.points[ids].mean(axis=0) - (width / 2, height / 2)).astype(int)
        parts.append(smaller(frame[y : y + height, x : x + width], LARGER * width))
    return parts


def smaller(picture: np.ndarray, width: int) -> np.ndarray:
    """Return the picture at another width."""
    image = Image.fromarray(picture)
    return np.asarray(image.resize((width, round(width * image.height / image.width)), Image.Resampling.LANCZOS))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    parser.add_argument("--video", type=Path)
    given = parser.parse_args()
    main(given.out, video=given.video)
