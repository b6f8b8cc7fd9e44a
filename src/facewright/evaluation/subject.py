"""Suite `subject`: one person from recordings to blendshapes, fully automatically; time, and truth beside it."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from facewright.apps.simulate_captures import TRUTH_FILE, SimulateCapturesRequest, simulate_captures
from facewright.capture.captures import list_captures
from facewright.deform.deformation_transfer import DeformationTransfer
from facewright.deform.example_based_rigging import RigFitter
from facewright.errors import ValueRangeError
from facewright.faces.blendshape_names import coupled_shapes
from facewright.faces.expressions import expression_weights, random_expression_weights
from facewright.faces.face import Face
from facewright.landmarks.contour import face_region
from facewright.mesh.closest_point import closest_points
from facewright.numeric.rotation import rotation_vector_from_matrix
from facewright.numeric.similarity import Similarity, estimate_similarity
from facewright.warehouse.process_subject import STAGES, ProcessOptions, process_timed
from facewright.warehouse.subject import Subject

Progress = Callable[[str, int, int], None]

N_UNSEEN = 50
N_FRAMES = 24


def run(face: Face, seed: int, progress: Progress | None = None, *, subjects: int = 3) -> dict[str, float]:
    """Measure the way from recordings to blendshapes on simulated people, with detected landmarks.

    Each person records 20 expressions of 24 frames each before a simulated Kinect, with hair, torso and sometimes
    glasses. All is judged over the face in front of the jaw line (`facewright.landmarks.contour.face_region`) in the
    true head frame (one rigid motion of the neutral); the blendshapes on 50 random expressions nobody acted.

    Parameters
    ----------
    face : Face
        All parts of it.
    seed : int
        Seed of people, recordings and expressions.
    progress : callable, optional
        Called as progress("subject", done, total).
    subjects : int
        People; times are medians, so that what is made once for all people does not count from three on.

    Returns
    -------
    dict of str to float
        ``seconds`` per subject, and of it ``read_seconds``, ``fuse_seconds``, ``landmark_seconds``,
        ``neutral_seconds``, ``expression_seconds``, ``rig_seconds``; ``unseen_rms_mm``: how far unseen expressions
        move from the neutral, against the truth, vertex by vertex; ``generic_rms_mm``: the same for generic shapes
        carried to the fitted neutral; ``true_meshes_unseen_rms_mm``: for a rig from the true meshes of the acted
        expressions; ``posed_rms_mm`` and ``generic_posed_rms_mm``: unseen expressions as they are, with the error of
        the neutral; ``neutral_surface_rms_mm``, ``neutral_correspondence_rms_mm``; ``parts_rms_mm``: eyeballs, teeth
        and all else but the skin, in the neutral; ``head_jitter_mm`` and ``head_jitter_degrees``: how far the head
        frames of expressions are apart from the neutral's, against the truth; ``expressions``: meshes made, the
        neutral among them, per subject.

    Raises
    ------
    ValueRangeError
        If `subjects` is not positive.
    """
    if subjects < 1:
        raise ValueRangeError(f"subjects must be positive, got {subjects}.")
    seconds: dict[str, list[float]] = {stage: [] for stage in (*STAGES, "all")}
    squares: dict[str, list[float]] = {}
    numbers: dict[str, list[float]] = {}
    rng = np.random.default_rng(seed)
    for done in range(subjects):
        with tempfile.TemporaryDirectory(prefix="facewright-subject-") as folder:
            simulate_captures(
                SimulateCapturesRequest(
                    out=Path(folder), n_subjects=1, face=face.name, n_frames=N_FRAMES, seed=seed + done, truth=True
                )
            )
            (capture,) = list_captures(folder)
            start = perf_counter()
            processed = process_timed(capture, ProcessOptions(face=face.name))
            seconds["all"].append(perf_counter() - start)
            truth = TrueSubject.read(capture.path / TRUTH_FILE)
        for stage, value in processed.seconds.items():
            seconds[stage].append(value)
        judged = judge(face, processed.subject, truth, random_expression_weights(rng, N_UNSEEN))
        for key, value in judged.items():
            (squares if key.endswith("rms_mm") else numbers).setdefault(key, []).append(value)
        if progress is not None:
            progress("subject", done + 1, subjects)
    return {
        "seconds": float(np.median(seconds["all"])),
        **{f"{stage}_seconds": float(np.median(seconds[stage])) for stage in STAGES},
        **{key: float(np.sqrt(np.mean(np.square(values)))) for key, values in squares.items()},
        **{key: float(np.mean(values)) for key, values in numbers.items()},
    }


class TrueSubject:
    """What is known of a simulated subject.

    Parameters
    ----------
    expressions : tuple of str
        Expressions that were recorded.
    weights : ndarray of shape (S, 46)
        As they were acted.
    meshes : ndarray of shape (S, V, 3), millimetres
        All parts of the face.
    neutral : ndarray of shape (V, 3), millimetres
        At rest.
    deltas : ndarray of shape (46, V, 3), millimetres
        Personal blendshapes.
    """

    def __init__(
        self,
        expressions: tuple[str, ...],
        weights: NDArray[np.float64],
        meshes: NDArray[np.floating],
        neutral: NDArray[np.floating],
        deltas: NDArray[np.floating],
    ) -> None:
        self.expressions = expressions
        self.weights = weights
        self.meshes = meshes.astype(np.float64)
        self.neutral = neutral.astype(np.float64)
        self.deltas = deltas.astype(np.float64)

    @classmethod
    def read(cls, path: Path) -> TrueSubject:
        """Read the file that `simulate_captures` writes beside the recordings."""
        with np.load(path, allow_pickle=False) as stored:
            return cls(
                tuple(str(name) for name in stored["expressions"]),
                stored["weights"],
                stored["meshes"],
                stored["neutral"],
                stored["blendshape_deltas"],
            )


def judge(face: Face, subject: Subject, truth: TrueSubject, unseen: NDArray[np.float64]) -> dict[str, float]:
    """Measure a subject against the truth; for the keys see `run`."""
    assert subject.blendshapes is not None
    skin = face.skin()
    part = face_region(face.skin().topology, face.skin().mean_shape)
    shapes = subject.blendshapes.astype(np.float64)
    frame = estimate_similarity(shapes[0, part], truth.neutral[part], with_scale=False)
    shapes = frame.apply(shapes)
    neutral, deltas = shapes[0], shapes[1:] - shapes[0]
    n = face.n_skin
    mean = skin.mean_shape.astype(np.float64)

    def carried(rest: NDArray[np.float64]) -> NDArray[np.float64]:
        transfer = DeformationTransfer(mean, rest, skin.topology.faces)
        return transfer.transfer(mean + skin.blendshape_deltas) - rest

    generic = carried(neutral[:n])
    bound = _rig_of_true_meshes(face, truth, carried(truth.neutral[:n]))
    offset = neutral[part] - truth.neutral[part]
    off_surface = closest_points(truth.neutral[:n], skin.topology.faces, neutral[part]).distances
    shift, turn = head_jitter(face, subject, truth, frame)
    return {
        "unseen_rms_mm": _rms_at(unseen, deltas[:, part] - truth.deltas[:, part]),
        "generic_rms_mm": _rms_at(unseen, generic[:, part] - truth.deltas[:, part]),
        "true_meshes_unseen_rms_mm": _rms_at(unseen, bound[:, part] - truth.deltas[:, part]),
        "posed_rms_mm": _rms_at(unseen, deltas[:, part] - truth.deltas[:, part], offset),
        "generic_posed_rms_mm": _rms_at(unseen, generic[:, part] - truth.deltas[:, part], offset),
        "neutral_surface_rms_mm": float(np.sqrt((off_surface**2).mean())),
        "neutral_correspondence_rms_mm": _rms(offset),
        "parts_rms_mm": _rms(neutral[n:] - truth.neutral[n:]),
        "head_jitter_mm": shift,
        "head_jitter_degrees": turn,
        "expressions": float(len(subject.expressions)),
    }


def head_jitter(face: Face, subject: Subject, truth: TrueSubject, frame: Similarity) -> tuple[float, float]:
    """Return how far head frames of expressions are from where they should be: millimetres and degrees, RMS.

    The motion between fitted and true mesh is measured on the part of the face that the true expression leaves still;
    the shift is that of the points there.
    """
    part = face_region(face.skin().topology, face.skin().mean_shape)
    upper = part[face.mean_shape[part, 1] > face.mean_shape[face.topology.landmarks["fw74"][43], 1] - 40.0]
    rest = frame.apply(subject.meshes[0, upper].astype(np.float64))
    shifts, turns = [], []
    for name, mesh in zip(subject.expressions[1:], subject.meshes[1:]):
        posed = truth.meshes[truth.expressions.index(name)]
        moved = np.linalg.norm(posed[upper] - truth.neutral[upper], axis=1)
        still = 1.0 / (1.0 + (moved / 0.3) ** 2) ** 2
        # from where the neutral has these points, moved as in truth, to where the expression's mesh has them
        goal = rest + posed[upper] - truth.neutral[upper]
        motion = estimate_similarity(goal, frame.apply(mesh[upper].astype(np.float64)), weights=still, with_scale=False)
        shifts.append(_rms(motion.apply(rest) - rest))
        turns.append(float(np.degrees(np.linalg.norm(rotation_vector_from_matrix(motion.rotation)))))
    return float(np.sqrt(np.mean(np.square(shifts)))), float(np.sqrt(np.mean(np.square(turns))))


def _rig_of_true_meshes(face: Face, truth: TrueSubject, generic: NDArray[np.float64]) -> NDArray[np.float64]:
    n = face.n_skin
    fitter = RigFitter(
        truth.neutral[:n], generic, face.skin().topology.faces, coupled=coupled_shapes(face.blendshape_names)
    )
    guide = np.stack([expression_weights(name) for name in truth.expressions])
    return fitter.fit(truth.meshes[:, :n], guide).deltas


def _rms(difference: NDArray[np.float64]) -> float:
    """Return the root mean square length of differences (V, 3)."""
    return float(np.sqrt((difference**2).sum(axis=-1).mean()))


def _rms_at(
    weights: NDArray[np.float64], differences: NDArray[np.float64], offset: NDArray[np.float64] | None = None
) -> float:
    """Return the RMS vertex error of expressions (N, 46) whose shapes differ by (46, V, 3) and neutrals by `offset`."""
    error = np.tensordot(weights, differences, 1)
    if offset is not None:
        error += offset
    return float(np.sqrt((error**2).sum(axis=2).mean()))
