"""The same points pulled on a region-based and on a holistic model: docs/images/wink_and_smirk.jpg (RB Fig. 1, 7).

Grey: where a point shall go. Black: where it is; yellow: the one that is being dragged. The built-in face follows
models of 397 vertices, trained on a simulated performer (built the first time, then kept).
"""

import argparse
from pathlib import Path

import numpy as np

from facewright.apps.default_region_model import default_region_models
from facewright.apps.pose_pictures import PosePainter
from facewright.apps.pose_session import PoseSession
from facewright.apps.posed_character import load_character
from facewright.faces import load_face
from facewright.imaging.contact_sheet import contact_sheet
from facewright.io.image import write_image

#: What is done, to which point (iBUG's 68 landmarks), and how far, mm (x to the person's left, y up, z forward).
STEPS = (
    ("a smirk", (54,), (7.0, 8.0, -2.0)),
    ("and a wink", (43, 44), (0.0, -10.0, 1.0)),
    ("the other brow", (19,), (0.0, 10.0, 0.0)),
    ("the lower lip", (58,), (-2.0, -9.0, 0.0)),
)


def main(out: Path) -> None:
    """Drag one point after the other, each is pinned where it was brought, and draw both models."""
    face = load_face("builtin")
    model, holistic = default_region_models()
    session = PoseSession(model, holistic=holistic)  # beta 0.5, gamma 0.025, as in the paper
    character = load_character("builtin", session.models)
    painter = PosePainter(face)
    rows = {kind: [painter.draw_pose(session, character, kind)] for kind in session.kinds}
    for _, landmarks, move in STEPS:
        place = face.mean_shape[face.topology.landmarks["ibug68"][list(landmarks)]].mean(axis=0)
        vertex = int(np.argmin(np.linalg.norm(model.neutral - place, axis=1)))
        target = session.positions()[vertex] + np.array(move)
        session.drag(vertex, target)
        session.release()
        pins = {**session.state.pins, vertex: target}
        for kind in session.kinds:
            picture = painter.draw_pose(session, character, kind)
            targets = np.array([character.from_model(v, p) for v, p in pins.items()])
            held = np.array([character.from_model(v, session.positions(kind)[v]) for v in pins])
            rows[kind].append(painter.mark(picture, targets, held, [len(pins) - 1]))
        session.pin(vertex, target)
    names = [name for name, _, _ in STEPS]
    captions = ["region-based model", *names, "holistic model", *names]
    sheet = contact_sheet([*rows["region"], *rows["holistic"]], captions, columns=len(names) + 1)
    write_image(out / "wink_and_smirk.jpg", sheet, quality=88)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    main(parser.parse_args().out)
