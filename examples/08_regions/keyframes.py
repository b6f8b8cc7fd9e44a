"""Five poses become an animation: docs/images/keyframes.jpg; the same as glTF goes where ``--glb`` says (RB 6)."""

import argparse
from pathlib import Path

import numpy as np

from facewright.apps.default_region_model import default_region_models
from facewright.apps.pose_export import PoseExportRequest, export_pose
from facewright.apps.pose_pictures import PosePainter
from facewright.apps.pose_session import PoseSession
from facewright.apps.posed_character import load_character
from facewright.faces import load_face
from facewright.imaging.contact_sheet import contact_sheet
from facewright.io.image import write_image

SMILE = (True, (54,), (9.0, 9.0, -4.0))  # on both sides; landmarks of iBUG's 68; x to the person's left, y up, mm
WINK = (False, (43, 44), (0.0, -10.0, 1.0))
BROWS = (True, (24,), (0.0, 10.0, 0.0))
LIDS = (True, (43, 44), (0.0, 4.0, 0.0))
LIP = (True, (57,), (0.0, -16.0, 0.0))
CHIN = (True, (8,), (0.0, -24.0, 0.0))
KEYS = ((0.0, ()), (0.5, (SMILE,)), (1.0, (SMILE, WINK)), (1.5, (BROWS, LIDS, CHIN, LIP)), (2.2, ()))  # seconds, drags
COLUMNS = 12


def main(out: Path, glb: Path | None = None) -> None:
    """Pose by dragging, set a key at each pose, draw what lies between."""
    face = load_face("builtin")
    session = PoseSession(default_region_models().region)
    character = load_character("builtin", session.models)
    for time, drags in KEYS:
        session.reset()
        for symmetric, landmarks, move in drags:
            session.set_symmetric(symmetric)
            place = face.mean_shape[face.topology.landmarks["ibug68"][list(landmarks)]].mean(axis=0)
            vertex = int(np.argmin(np.linalg.norm(session.model.neutral - place, axis=1)))
            session.drag(vertex, session.positions()[vertex] + np.array(move))
            session.release()
        session.set_key(time)
    painter = PosePainter(face, (236, 196))
    times = np.linspace(0.0, session.keyframes.duration, COLUMNS)
    pictures = []
    for time in times:
        session.seek(time)
        pictures.append(painter.draw_pose(session, character))
    sheet = contact_sheet(pictures, [f"{time:.1f} s" for time in times], columns=COLUMNS // 2)
    write_image(out / "keyframes.jpg", sheet, quality=88)
    if glb is not None:
        export_pose(session, PoseExportRequest(glb, "glb", character=character))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    parser.add_argument("--glb", type=Path)
    given = parser.parse_args()
    main(given.out, given.glb)
