"""Suite `registration`: a template on clean targets of known correspondence, beside trimesh's `nricp_amberg`."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ValueRangeError
from facewright.faces.face import Face
from facewright.fitting.hand_landmarks import landmarks_from_points
from facewright.fitting.registration import RegistrationOptions, TemplateRegistration
from facewright.fitting.scan import ScanFitOptions, ScanFitter
from facewright.fitting.scan_target import ScanTarget
from facewright.mesh.closest_point import ClosestPoints
from facewright.mesh.normals import vertex_normals

Progress = Callable[[str, int, int], None]

_MODES = 30


def run(face: Face, seed: int, progress: Progress | None = None, *, subjects: int = 3) -> dict[str, float]:
    """Register the mean face to simulated targets: 30 random identity modes, 68 exact landmarks, no noise, no holes.

    Parameters
    ----------
    face : Face
        Its part ``face`` (9,409 vertices for ICT-FaceKit) is template and target.
    seed : int
        Seed of the targets: for each, 30 of the identity modes are chosen and weighted by N(0, 1).
    progress : callable, optional
        Called as progress("registering", done, total).
    subjects : int
        Targets.

    Returns
    -------
    dict of str to float
        ``surface_rms_mm``, ``correspondence_rms_mm``: of all vertices to the target's surface and to their own true
        positions, for a registration that knows nothing of the modes; ``seconds`` for one, everything included but
        compilation. ``nricp_*``: the same of trimesh's ``nricp_amberg`` with its own settings, same template, targets
        and landmarks (left out where trimesh is not installed). ``with_model_*``: the same of the scan fitter, which
        knows all identity modes, over all of which it looks (its set-up, once per face, is not in ``seconds``).
        ``mean_face_*``: the template where it stands, the trivial baseline; ``landmarks_only_*``: bent by the landmarks
        alone. Root mean squares over vertices and targets; seconds are means. ``vertices``: of the template.

    Raises
    ------
    ValueRangeError
        If `subjects` is not positive, or the face has fewer than 30 identity modes.
    """
    if subjects < 1:
        raise ValueRangeError(f"subjects must be positive, got {subjects}.")
    if len(face.identity_basis) < _MODES:
        raise ValueRangeError(f"face must have at least {_MODES} identity modes, got {len(face.identity_basis)}.")
    n = face.topology.parts["face"][1]
    topology = face.topology.submesh(n)
    mean, faces = face.mean_shape[:n].astype(np.float64), topology.faces
    marks = topology.landmarks["ibug68"]
    known = np.flatnonzero(marks >= 0)  # the built-in face has two of the contour on the neck
    basis = face.identity_basis[:, :n].astype(np.float64)
    options = RegistrationOptions(match_rim=True)  # template and target end alike
    fitter = ScanFitter(face, ScanFitOptions(n_modes=len(basis), region="head"))
    rng = np.random.default_rng(seed)
    TemplateRegistration(mean, faces, options).register(mean, faces, marks[known], mean[marks[known]])  # compiles
    fitter.fit_neutral(_scan_target(face, mean, faces, marks))
    scores: dict[str, list[tuple[float, float, float]]] = {}

    def score(name: str, start: float, vertices: NDArray[np.float64], target: NDArray[np.float64]) -> None:
        seconds = perf_counter() - start
        surface = ClosestPoints(target, faces).query(vertices).distances
        between = ((vertices - target) ** 2).sum(axis=1).mean()
        scores.setdefault(name, []).append((float((surface**2).mean()), float(between), seconds))

    for done in range(subjects):
        chosen = rng.permutation(len(basis))[:_MODES]
        target = mean + np.tensordot(rng.standard_normal(_MODES), basis[chosen], axes=1)
        start = perf_counter()
        ours = TemplateRegistration(mean, faces, options).register(target, faces, marks[known], target[marks[known]])
        score("", start, ours.vertices, target)
        score("landmarks_only_", start, ours.start, target)
        score("mean_face_", start, mean, target)
        start = perf_counter()
        fit = fitter.fit_neutral(_scan_target(face, target, faces, marks))
        score("with_model_", start, fit.posed[:n], target)
        start = perf_counter()
        peer = _nricp(mean, faces, target, marks[known])
        if peer is not None:
            score("nricp_", start, peer, target)
        if progress is not None:
            progress("registering", done + 1, subjects)
    metrics = {"vertices": float(n)}
    for name, rows in scores.items():
        surface_square, between_square, seconds = np.mean(rows, axis=0)
        metrics[f"{name}surface_rms_mm"] = float(np.sqrt(surface_square))
        metrics[f"{name}correspondence_rms_mm"] = float(np.sqrt(between_square))
        if name in ("", "with_model_", "nricp_"):
            metrics[f"{name}seconds"] = float(seconds)
    return metrics


def _scan_target(
    face: Face, vertices: NDArray[np.float64], faces: NDArray[np.int32], marks: NDArray[np.int32]
) -> ScanTarget:
    """Return a mesh with its 68 landmarks, vertices `marks`, as what the scan fitter takes."""
    points, confidence = landmarks_from_points(face, np.where(marks[:, None] >= 0, vertices[marks], np.nan))
    return ScanTarget(vertices, vertex_normals(vertices, faces), faces, points, confidence)


def _nricp(
    mean: NDArray[np.float64], faces: NDArray[np.int32], target: NDArray[np.float64], marks: NDArray[np.int32]
) -> NDArray[np.float64] | None:
    """Register by trimesh's non-rigid ICP (Amberg et al. 2007); None where trimesh or its index is not installed."""
    try:
        import rtree  # noqa: F401
        import trimesh
        from trimesh.registration import nricp_amberg
    except ImportError:
        return None
    source = trimesh.Trimesh(mean, faces, process=False)
    wanted = trimesh.Trimesh(target, faces, process=False)
    found = nricp_amberg(source, wanted, source_landmarks=marks, target_positions=target[marks])
    return np.asarray(found, dtype=np.float64)
