"""How region-based models behave: drags that stay local, boundaries that hold and do not show."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from facewright.mesh.normals import face_area_vectors
from facewright.models.region_blend import Blend, BoundaryGaps, RegionBlend
from facewright.models.region_fit import RegionFitter, reconstruction_rms
from facewright.models.region_model import RegionModel
from facewright.models.region_poser import RegionPoser

BETA, GAMMA = 0.5, 0.025
"""The paper's parameters of interaction."""

BETAS = (0.0, 0.1, 0.5, 1.0, 2.0, 5.0, 10.0)
DRAG_MM = 5.0
#: Directions of the drags, towards the side of the corner (x), up (y) and forwards (z).
_DIRECTIONS = np.array([[1.0, 0.0, 0.0], [0.7, 0.7, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [0.6, -0.8, 0.0]])
_BROW_DIRECTIONS = np.array([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [-0.8, -0.6, 0.0]])


def measure_locality(
    models: Mapping[str, RegionModel], reference: NDArray[np.floating], corners: NDArray[np.integer]
) -> dict[str, float]:
    """Drag each corner of the mouth by 5 mm in five directions.

    Parameters
    ----------
    models : mapping of str to RegionModel
        Trained with the same data; the first one's regions say what is elsewhere.
    reference : ndarray of shape (N, 3), millimetres
        The generic face, whose x tells the sides.
    corners : ndarray of shape (2,), int
        Vertices at the left and the right corner.

    Returns
    -------
    dict of str to float
        With the models' names before: ``_leak``, share of the squared motion on the other side of the face;
        ``_elsewhere``: share of it outside the regions that hold the dragged vertex; ``_missed_mm``: how far from its
        target that vertex stays.
    """
    metrics: dict[str, float] = {}
    regions = next(iter(models.values())).regions
    for name, model in models.items():
        poser = RegionPoser(model, BETA, GAMMA)
        leaks, elsewhere, missed = [], [], []
        for corner in corners:
            poser.set_constraints([corner])
            away = np.ones(len(reference), bool)
            for ids in regions.members:
                if corner in ids:
                    away[ids] = False
            side = np.sign(reference[corner, 0])
            other = reference[:, 0] * side < 0
            for direction in _DIRECTIONS * [side, 1.0, 1.0]:
                target = model.neutral[corner] + DRAG_MM * direction / np.linalg.norm(direction)
                zeta = poser.solve(target[None], np.zeros(model.n_coefficients))
                moved = poser.positions(zeta) - model.neutral
                squared = (moved**2).sum(axis=1)
                leaks.append(squared[other].sum() / squared.sum())
                elsewhere.append(squared[away].sum() / squared.sum())
                missed.append(np.linalg.norm(model.neutral[corner] + moved[corner] - target))
        for key, values in (("leak", leaks), ("elsewhere", elsewhere), ("missed_mm", missed)):
            metrics[f"{name}_{key}"] = float(np.mean(values))
    return metrics


def measure_boundaries(
    model: RegionModel, holistic: RegionModel, displacements: NDArray[np.floating]
) -> dict[str, float]:
    """Measure what differs at the regions' shared vertices, and what shows of it.

    Parameters
    ----------
    model : RegionModel
    holistic : RegionModel
        Of the same data, with components to spare.
    displacements : ndarray of shape (T, N, 3), millimetres
        Unseen frames.

    Returns
    -------
    dict of str to float
        ``gap_mean_mm_beta_B`` and ``gap_max_mm_beta_B`` before blending, of fits of eq. 6 with beta B;
        ``crease_deg``: RMS over the edges with a shared vertex of how far the angle between their two triangles is from
        that of the data, beta 0.5; ``crease_deg_gradient``: gaps spread in the gradient domain; ``crease_deg_still``:
        nothing moved; ``crease_deg_holistic``: at the same edges with as many holistic components as it takes to
        reconstruct as well, ``crease_components``; that model has no boundaries; ``crease_ratio`` of the two.
    """
    metrics = {}
    blend = RegionBlend(model)
    for beta in BETAS:
        zeta = RegionFitter(model, beta).fit(displacements)
        gaps = [blend.gaps(row) for row in zeta]
        metrics[f"gap_mean_mm_beta_{beta:g}"] = float(np.mean([gap.mean_mm for gap in gaps]))
        metrics[f"gap_max_mm_beta_{beta:g}"] = float(np.max([gap.max_mm for gap in gaps]))
    fitter = RegionFitter(model, BETA)
    zeta = fitter.fit(displacements)
    pairs = _boundary_edges(model)
    truth = _bends(model.neutral + displacements, model.faces, pairs)

    def crease(moved: NDArray[np.floating]) -> float:
        made = _bends(model.neutral + moved, model.faces, pairs)
        return float(np.rad2deg(np.sqrt(((made - truth) ** 2).mean())))

    found = fitter.reconstruct(zeta)
    whole, count = _as_good(holistic, displacements, reconstruction_rms(displacements, found))
    made, smooth = crease(found), crease(whole)
    return metrics | {
        "crease_deg": made,
        "crease_ratio": made / smooth,
        "crease_deg_gradient": crease(fitter.reconstruct(zeta, "gradient")),
        "crease_deg_holistic": smooth,
        "crease_deg_still": crease(np.zeros_like(found)),
        "crease_components": float(count),
    }


def measure_dragged_boundaries(
    model: RegionModel,
    holistic: RegionModel,
    reference: NDArray[np.floating],
    corners: NDArray[np.integer],
    brows: NDArray[np.integer],
) -> dict[str, float]:
    """Drag corners of the mouth and brows by 5 mm from the neutral, and measure boundaries.

    Parameters
    ----------
    model, holistic : RegionModel
        Of the same data.
    reference : ndarray of shape (N, 3), millimetres
        The generic face, whose x tells the sides.
    corners, brows : ndarray of shape (K,), int
        Vertices, dragged one by one: corners in five directions, brows up, down and down towards each other.

    Returns
    -------
    dict of str to float
        ``gap_mean_mm_dragged`` and ``gap_max_mm_dragged``: between copies, before blending makes them one;
        ``crease_deg_dragged``: RMS over the edges with a shared vertex of how much the drag changes the angle between
        their two triangles, copies averaged; ``crease_max_deg_dragged``: the largest; ``crease_contrast_dragged``: that
        RMS over the same at all other edges, so that it does not depend on how far the face follows. With
        ``_gradient``: gaps spread in the gradient domain; ``_holistic``: the holistic model, at the same edges;
        ``crease_ratio_dragged`` and ``crease_ratio_dragged_gradient``: contrast over the holistic one's.
    """
    drags = [(v, way) for v in corners for way in _DIRECTIONS] + [(v, way) for v in brows for way in _BROW_DIRECTIONS]
    vertices = np.array([vertex for vertex, _ in drags])
    ways = np.array([way for _, way in drags])
    ways[:, 0] *= np.sign(reference[vertices, 0])
    offsets = DRAG_MM * ways / np.linalg.norm(ways, axis=1, keepdims=True)
    border, inside = _boundary_edges(model), _boundary_edges(model, shared=False)
    metrics: dict[str, float] = {}
    kinds: tuple[tuple[str, RegionModel, Blend], ...] = (
        ("", model, "average"),
        ("_gradient", model, "gradient"),
        ("_holistic", holistic, "average"),
    )
    for suffix, posed, blend in kinds:
        moved, gaps = _dragged(RegionPoser(posed, BETA, GAMMA, blend=blend), vertices, offsets)
        if not suffix:
            metrics["gap_mean_mm_dragged"] = float(np.mean([gap.mean_mm for gap in gaps]))
            metrics["gap_max_mm_dragged"] = float(np.max([gap.max_mm for gap in gaps]))
        here, away = (_bent(posed, moved, pairs) for pairs in (border, inside))
        metrics[f"crease_deg_dragged{suffix}"] = float(np.sqrt((here**2).mean()))
        metrics[f"crease_max_deg_dragged{suffix}"] = float(np.abs(here).max())
        metrics[f"crease_contrast_dragged{suffix}"] = float(np.sqrt((here**2).mean() / (away**2).mean()))
    for suffix in ("", "_gradient"):
        contrast = metrics[f"crease_contrast_dragged{suffix}"]
        metrics[f"crease_ratio_dragged{suffix}"] = contrast / metrics["crease_contrast_dragged_holistic"]
    return metrics


def _dragged(
    poser: RegionPoser, vertices: NDArray[np.integer], offsets: NDArray[np.float64]
) -> tuple[NDArray[np.float64], list[BoundaryGaps]]:
    """Return positions (D, N, 3), mm, and the gaps before blending, of D drags from the neutral, each of one vertex."""
    moved, gaps = [], []
    for vertex, offset in zip(vertices, offsets, strict=True):
        poser.set_constraints([vertex])
        zeta = poser.solve((poser.model.neutral[vertex] + offset)[None], np.zeros(poser.model.n_coefficients))
        moved.append(poser.positions(zeta))
        gaps.append(poser.blend.gaps(zeta))
    return np.array(moved), gaps


def _bent(model: RegionModel, vertices: NDArray[np.float64], pairs: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return by how much (T, E), degrees, the angles between pairs of triangles differ from the neutral's."""
    still = _bends(model.neutral[None], model.faces, pairs)
    return np.rad2deg(_bends(vertices, model.faces, pairs) - still)


def _as_good(
    holistic: RegionModel, displacements: NDArray[np.floating], rms_mm: float
) -> tuple[NDArray[np.float64], int]:
    """Return the reconstruction by the fewest components of a PCA whose error is at most `rms_mm`, and their number."""
    basis = holistic.bases[0].reshape(len(holistic.bases[0]), -1)
    flat = np.asarray(displacements, dtype=np.float64).reshape(len(displacements), -1)
    coefficients = flat @ basis.T
    left = (flat**2).sum() - np.cumsum((coefficients**2).sum(axis=0))
    enough = left <= rms_mm**2 * flat.size / 3
    count = int(enough.argmax()) + 1 if enough.any() else len(basis)
    return (coefficients[:, :count] @ basis[:count]).reshape(displacements.shape), count


def _boundary_edges(model: RegionModel, *, shared: bool = True) -> NDArray[np.intp]:
    """Return the pairs of triangles (E, 2) that share an edge with an end that regions share, or without."""
    faces = model.faces
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    owner = np.tile(np.arange(len(faces)), 3)
    order = np.lexsort((edges[:, 1], edges[:, 0]))
    edges, owner = edges[order], owner[order]
    first = np.flatnonzero((edges[1:] == edges[:-1]).all(axis=1))
    at_border = (model.regions.count > 1)[edges[first]].any(axis=1)
    return np.stack([owner[first], owner[first + 1]], axis=1)[at_border == shared]


def _bends(vertices: NDArray[np.floating], faces: NDArray[np.integer], pairs: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return the angles (T, E), radians, between the normals of pairs of triangles."""
    result = []
    for frame in vertices:
        normals = face_area_vectors(frame, faces)
        normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        result.append(np.arccos(np.clip((normals[pairs[:, 0]] * normals[pairs[:, 1]]).sum(axis=1), -1.0, 1.0)))
    return np.array(result)
