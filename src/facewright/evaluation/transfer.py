"""Suite `transfer`: deformation transfer of the generic blendshapes to simulated people, on the skin."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter

import numpy as np

from facewright.deform.deformation_transfer import DeformationTransfer
from facewright.errors import ValueRangeError
from facewright.faces.face import Face
from facewright.faces.simulate import simulate_person

Progress = Callable[[str, int, int], None]

_REPEATS = 5


def run(face: Face, seed: int, progress: Progress | None = None, *, subjects: int = 3) -> dict[str, float]:
    """Measure deformation transfer.

    Parameters
    ----------
    face : Face
        Its skin is used (11,248 vertices for ICT-FaceKit).
    seed : int
        Seed of the simulated people.
    progress : callable, optional
        Called as progress("transferring", done, total).
    subjects : int
        People to measure on.

    Returns
    -------
    dict of str to float
        ``factor_ms``: setting up and factoring for one target, median. ``per_expression_ms``: one expression alone,
        median; ``per_expression_batch_ms``: when all 46 go together. ``rms_mm``: transferred generic shapes against the
        person's true ones at weight one (amplitudes, asymmetry and perturbation of the person included), over skin
        vertices and shapes; ``untransferred_rms_mm``: the same for plain copying of displacements.
        ``no_motion_rms_mm``: the same for leaving the person at rest, the trivial baseline. ``rest_motion_rms_mm``:
        motion of the target when the source is at rest; ``same_mesh_rms_mm``: error when source and target are one mesh
        (both rounding). ``vertices``: size of the mesh.

    Raises
    ------
    ValueRangeError
        If `subjects` is not positive.
    """
    if subjects < 1:
        raise ValueRangeError(f"subjects must be positive, got {subjects}.")
    skin = face.skin()
    rng = np.random.default_rng(seed)
    source = skin.mean_shape.astype(np.float64)
    deltas = skin.blendshape_deltas.astype(np.float64)
    faces = skin.topology.faces
    warm_up = DeformationTransfer(source, source, faces)  # compiles the kernels, outside the times
    same = warm_up.transfer(source + deltas)
    times: dict[str, list[float]] = {"factor": [], "single": [], "batch": []}
    errors, copied, unmoved, resting = [], [], [], []
    for done in range(subjects):
        person = simulate_person(skin, rng)
        target = person.neutral.astype(np.float64)
        for repeat in range(_REPEATS):
            start = perf_counter()
            transfer = DeformationTransfer(source, target, faces)
            times["factor"].append(perf_counter() - start)
            start = perf_counter()
            transfer.transfer(source + deltas[repeat % len(deltas)])
            times["single"].append(perf_counter() - start)
        start = perf_counter()
        carried = transfer.transfer(source + deltas) - target
        times["batch"].append((perf_counter() - start) / len(deltas))
        errors.append(_mean_square(carried - person.deltas))
        copied.append(_mean_square(deltas - person.deltas))
        unmoved.append(_mean_square(person.deltas))
        resting.append(_mean_square(transfer.transfer(source) - target))
        if progress is not None:
            progress("transferring", done + 1, subjects)
    return {
        "vertices": float(len(source)),
        "factor_ms": 1e3 * float(np.median(times["factor"])),
        "per_expression_ms": 1e3 * float(np.median(times["single"])),
        "per_expression_batch_ms": 1e3 * float(np.median(times["batch"])),
        "rms_mm": float(np.sqrt(np.mean(errors))),
        "untransferred_rms_mm": float(np.sqrt(np.mean(copied))),
        "no_motion_rms_mm": float(np.sqrt(np.mean(unmoved))),
        "rest_motion_rms_mm": float(np.sqrt(np.mean(resting))),
        "same_mesh_rms_mm": float(np.sqrt(_mean_square(same - source - deltas))),
    }


def _mean_square(displacements: np.ndarray) -> float:
    """Return the mean squared length of displacements (..., V, 3), mm^2."""
    return float((displacements**2).sum(axis=-1).mean())
