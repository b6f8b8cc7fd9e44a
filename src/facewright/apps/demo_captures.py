"""The demo's first half: a simulated person before a depth camera, the database, and the model made of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from facewright.apps.build import BuildRequest, build
from facewright.apps.build_database_model import BuildDatabaseModelRequest, build_database_model
from facewright.apps.simulate_captures import TRUTH_FILE, SimulateCapturesRequest, simulate_captures
from facewright.apps.simulate_people import SimulatePeopleRequest, simulate_people
from facewright.apps.subject_pictures import subject_sheets
from facewright.errors import DegenerateError
from facewright.io.image import write_image
from facewright.landmarks.contour import face_region
from facewright.mesh.closest_point import closest_points
from facewright.numeric.similarity import estimate_similarity

if TYPE_CHECKING:
    from facewright.faces.face import Face
    from facewright.models.bilinear import BilinearModel
    from facewright.warehouse.subject import Subject

Progress = Callable[[str, int, int], None]

N_FRAMES = 12
CAPTURED = "person-000"


@dataclass(frozen=True, eq=False)
class DemoDatabase:
    """What the first half made.

    Parameters
    ----------
    model : BilinearModel
        Of all people in the database.
    model_bytes : int
        Size of its file.
    subject : Subject
        The captured person.
    n_people : int
        People in the database.
    n_frames : int
        Frames that were recorded.
    capture_seconds : float
        From recordings to 46 blendshapes.
    neutral_rms_mm, mean_face_rms_mm : float
        Distance of the captured neutral, and of the mean face, from the true surface over the face, root mean square.
    """

    model: BilinearModel
    model_bytes: int
    subject: Subject
    n_people: int
    n_frames: int
    capture_seconds: float
    neutral_rms_mm: float
    mean_face_rms_mm: float


def build_demo_database(
    out: Path, face: Face, n_simulated: int, sizes: tuple[int, int], seed: int, progress: Progress | None = None
) -> DemoDatabase:
    """Record a simulated person, build the database, add simulated people, build the model, draw the person.

    Parameters
    ----------
    out : Path
        Existing folder; ``captures/``, ``faces.zarr/``, ``model.fwbm`` and the pictures ``captured*.png`` go there.
    face : Face
        The face all are made of.
    n_simulated : int
        People added without a camera, so that the model has enough of them.
    sizes : (identities, expressions)
        Components of the model.
    seed : int
        Seed of all people.
    progress : callable, optional
        Called with stage, done, total.

    Raises
    ------
    DegenerateError
        If the captured person could not be made, with the reason.
    """
    from facewright.warehouse.process_subject import ProcessOptions
    from facewright.warehouse.store import Warehouse

    captures, database = out / "captures", out / "faces.zarr"
    recorded = simulate_captures(
        SimulateCapturesRequest(captures, 1, face.name, N_FRAMES, seed=seed, truth=True), progress
    )
    report = build(BuildRequest(captures, str(database), ProcessOptions(face=face.name)), progress).report
    for failure in report.failed.values():
        raise DegenerateError(f"the demo's captured person must become a subject: {failure.reason}")
    simulate_people(SimulatePeopleRequest(str(database), n_simulated, face.name, seed), progress)
    built = build_database_model(
        BuildDatabaseModelRequest(str(database), out / "model.fwbm", sizes[0], sizes[1]), progress
    )
    warehouse = Warehouse.open(str(database))
    subject = warehouse.read_subject(CAPTURED)
    for name, sheet in subject_sheets(face, subject, size=280).items():
        write_image(out / f"captured_{name}.png", sheet)
    with np.load(captures / CAPTURED / TRUTH_FILE, allow_pickle=False) as stored:
        truth = stored["neutral"].astype(np.float64)
    return DemoDatabase(
        built.model,
        built.n_bytes,
        subject,
        len(warehouse.subject_names()),
        recorded.n_frames,
        report.seconds,
        _surface_rms(face, subject.meshes[0], truth),
        _surface_rms(face, face.mean_shape, truth),
    )


def _surface_rms(face: Face, vertices: NDArray[np.floating], truth: NDArray[np.float64]) -> float:
    """Return the RMS distance (mm) of the face's vertices from the true skin, after one rigid motion."""
    skin = face.skin()
    region = face_region(skin.topology, skin.mean_shape)
    ours = vertices[region].astype(np.float64)
    placed = estimate_similarity(ours, truth[region], with_scale=False).apply(ours)
    distances = closest_points(truth[: face.n_skin], skin.topology.faces, placed).distances
    return float(np.sqrt((distances**2).mean()))
