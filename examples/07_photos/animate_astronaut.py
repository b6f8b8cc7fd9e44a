"""Curves act on the astronaut portrait: docs/images/animate_astronaut.png. Needs landmarks extra and video extra.

The video itself goes where ``--video`` says.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np

from facewright.apps.animate import AnimateRequest, PhotoChoice, animate
from facewright.apps.build_model import BuildModelRequest, build_model
from facewright.apps.demo import astronaut_portrait
from facewright.apps.demo_photo import acting
from facewright.apps.performance_files import write_performance_csv
from facewright.imaging.contact_sheet import contact_sheet
from facewright.io.image import write_image
from facewright.io.video_reader import VideoReader

HEAD = (slice(10, 230), slice(122, 332))


def main(out: Path, n_people: int | None = None, video: Path | None = None) -> None:
    """Play ten seconds of acting on the portrait and show twelve of its frames."""
    with tempfile.TemporaryDirectory() as name:
        photo, curves, model = Path(name, "portrait.png"), Path(name, "acting.csv"), None
        write_image(photo, astronaut_portrait())
        write_performance_csv(curves, acting())
        if n_people is not None:
            model = Path(name, "small.fwbm")
            build_model(BuildModelRequest(model, "builtin", n_people, n_people, 47, n_unseen=0))
        clip = Path(name, "acting.mp4") if video is None else video
        result = animate(AnimateRequest(PhotoChoice(photo, model=model), curves, clip))
        shown = np.linspace(0, result.n_frames - 1, 12).astype(int)
        with VideoReader(clip) as reader:
            pictures = [frame.image[HEAD] for k, frame in enumerate(reader) if k in shown]
    captions = [f"{k / result.frame_rate:.1f} s" for k in shown]
    write_image(out / "animate_astronaut.png", contact_sheet(pictures, captions, columns=6))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    parser.add_argument("--video", type=Path)
    given = parser.parse_args()
    main(given.out, video=given.video)
