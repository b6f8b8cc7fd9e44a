"""One frame, all frames fused, and the truth: docs/images/fusion.png. Needs the extra capture."""

import argparse
from pathlib import Path

import numpy as np

from facewright.apps.scan_pictures import depth_picture, error_colours
from facewright.apps.simulated_recording import simulate_recording
from facewright.apps.simulated_subject import simulate_capture_subject
from facewright.capture.fusion import fuse
from facewright.faces import load_face
from facewright.faces.expressions import expression_weights
from facewright.imaging.contact_sheet import contact_sheet
from facewright.io.image import write_image


def main(out: Path) -> None:
    """Fuse a simulated Kinect's recording of a smile and colour the errors."""
    rng = np.random.default_rng(8)
    subject = simulate_capture_subject(load_face("builtin"), rng, glasses=False)
    recording = simulate_recording(subject, expression_weights("smile"), rng, n_frames=24)
    frames = list(recording.frames())
    fused = fuse(frames, reference=0)
    truth = recording.true_depth(0)
    left, top, right, bottom = fused.rectangle

    def shown(picture: np.ndarray) -> np.ndarray:
        return picture[top:bottom, left:right].repeat(2, axis=0).repeat(2, axis=1)

    pictures, captions = [shown(fused.color)], ["colour"]
    for name, depth in (("one frame", frames[0].depth), ("24 frames fused", fused.depth), ("truth", truth)):
        pictures.append(shown(depth_picture(depth, fused.intrinsics, fused.intrinsics, depth.shape)))
        captions.append(name)
    for name, depth in (("one frame", frames[0].depth), ("24 frames fused", fused.depth)):
        error = np.where((depth > 0) & (truth > 0), np.abs(depth - truth), np.nan)
        colours = error_colours(error.ravel(), 4.0).reshape(*error.shape, 3)
        pictures.append(shown(np.round(255 * colours).astype(np.uint8)))
        captions.append(f"error of {name}, 0-4 mm")
    write_image(out / "fusion.png", contact_sheet(pictures, captions, columns=3))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    main(parser.parse_args().out)
