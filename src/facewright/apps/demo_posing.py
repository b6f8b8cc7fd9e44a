"""The demo's posing: the same points pulled on a region-based and a holistic model, and the poses as an animation."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from facewright.apps.default_region_model import default_region_models
from facewright.apps.pose_export import PoseExportRequest, export_pose
from facewright.apps.pose_pictures import Picture, PosePainter
from facewright.apps.pose_session import PoseSession
from facewright.apps.posed_character import load_character
from facewright.imaging.contact_sheet import contact_sheet
from facewright.io.image import write_image

if TYPE_CHECKING:
    from facewright.apps.posed_character import PosedCharacter
    from facewright.faces.face import Face

Progress = Callable[[str, int, int], None]

#: What is pulled: its name, between which landmarks (ibug68) it lies, how far, mm.
PULLS: tuple[tuple[str, tuple[int, ...], tuple[float, float, float]], ...] = (
    ("a smirk", (54,), (7.0, 8.0, -2.0)),
    ("and a wink", (43, 44), (0.0, -10.0, 1.0)),
    ("the other brow", (19,), (0.0, 10.0, 0.0)),
)
_KEY_SECONDS = 0.6
_SIZE = (300, 250)


class DemoPosing(NamedTuple):
    """What was posed: regions and coefficients of the model, and of the holistic one; frames of the animation."""

    n_regions: int
    n_coefficients: int
    n_holistic: int
    n_frames: int


def draw_posing(out: Path, face: Face, progress: Progress | None = None) -> DemoPosing:
    """Write ``posing.png`` and ``posed.glb`` into the demo's folder.

    Parameters
    ----------
    out : Path
        The folder.
    face : Face
        The built-in face.
    progress : callable, optional
        Called with stage, done, total.

    Raises
    ------
    StoreError
        If the default models, built the first time, or a file cannot be written.
    """
    models = default_region_models(progress)
    session = PoseSession(models.region, holistic=models.holistic)
    character = load_character("builtin", session.models)
    painter = PosePainter(face, _SIZE)
    rows = {kind: [painter.draw_pose(session, character, kind)] for kind in session.kinds}
    session.set_key(0.0)
    for k, (_, landmarks, move) in enumerate(PULLS):
        place = face.mean_shape[face.topology.landmarks["ibug68"][list(landmarks)]].mean(axis=0)
        vertex = int(np.argmin(np.linalg.norm(models.region.neutral - place, axis=1)))
        target = session.positions()[vertex] + np.array(move)
        session.drag(vertex, target)
        session.release()
        for kind in session.kinds:
            rows[kind].append(_marked(painter, session, character, kind, {**session.state.pins, vertex: target}))
        session.set_key((k + 1) * _KEY_SECONDS)
        session.pin(vertex, target)
        if progress is not None:
            progress("posing", k + 1, len(PULLS))
    session.reset()
    session.set_key((len(PULLS) + 1.5) * _KEY_SECONDS)
    names = [name for name, _, _ in PULLS]
    captions = ["regions", *names, "one holistic model", *names]
    sheet = contact_sheet([*rows["region"], *rows["holistic"]], captions, columns=len(names) + 1)
    write_image(out / "posing.png", sheet)
    written = export_pose(session, PoseExportRequest(out / "posed.glb", "glb", character=character), progress)
    return DemoPosing(
        len(models.region.bases), models.region.n_coefficients, models.holistic.n_coefficients, written.n_frames
    )


def _marked(
    painter: PosePainter,
    session: PoseSession,
    character: PosedCharacter,
    kind: str,
    pins: dict[int, NDArray[np.float64]],
) -> Picture:
    """Draw a pose with what pulls at it, the last pin being the one that was dragged."""
    targets = np.array([character.from_model(v, p) for v, p in pins.items()])
    held = np.array([character.from_model(v, session.positions(kind)[v]) for v in pins])
    return painter.mark(painter.draw_pose(session, character, kind), targets, held, [len(pins) - 1])
