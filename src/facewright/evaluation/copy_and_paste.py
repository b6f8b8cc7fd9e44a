"""The baseline of component transfer: a component cut out of one picture and pasted into another, in two dimensions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import ConvexHull, Delaunay

from facewright.landmarks.points import Landmarks, interocular_distance

#: Landmarks that a component is cut out around, and how far, by the inter-ocular distance.
_OUTLINES: dict[str, tuple[tuple[str, ...], ...]] = {
    "mouth": (("outer_mouth",),),
    "eyes": (("right_eye",), ("left_eye",)),
    "brows": (("right_brow",), ("left_brow",)),
    "nose": (("nose",),),
    "face": (("right_brow", "left_brow", "right_eye", "left_eye", "nose", "outer_mouth"),),
}
_MARGIN, _FEATHER = 0.16, 0.10


def paste_component(
    target: NDArray[np.uint8],
    reference: NDArray[np.uint8],
    target_landmarks: Landmarks,
    reference_landmarks: Landmarks,
    component: str,
) -> NDArray[np.uint8]:
    """Paste a component of one picture over another, aligned by a similarity, with a soft edge.

    Parameters
    ----------
    target, reference : ndarray of shape (H, W, 3) and (h, w, 3), uint8
        Pictures.
    target_landmarks, reference_landmarks : Landmarks
        Scheme ``fw74``. The similarity is that of the landmarks outside the component and off the contour.
    component : str
        One of `facewright.imaging.component_mask.COMPONENTS`.

    Returns
    -------
    ndarray of shape (H, W, 3), uint8
        The target with the component pasted.
    """
    aligned, weight = aligned_component(target, reference, target_landmarks, reference_landmarks, component)
    mixed = target + weight[..., None] * (aligned - target)
    return np.clip(np.round(mixed), 0, 255).astype(np.uint8)


def aligned_component(
    target: NDArray[np.uint8],
    reference: NDArray[np.uint8],
    target_landmarks: Landmarks,
    reference_landmarks: Landmarks,
    component: str,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the reference (H, W, 3) brought to the target by the similarity, and the paste's soft mask (H, W)."""
    groups = target_landmarks.definition.groups
    own = np.unique(np.concatenate([groups[name] for outline in _OUTLINES[component] for name in outline]))
    fixed = target_landmarks.definition.fixed
    used = fixed if component == "face" else np.setdiff1d(fixed, own)
    if component == "mouth":
        used = np.setdiff1d(used, groups["inner_mouth"])
    a = _similarity(target_landmarks.points[used], reference_landmarks.points[used])
    height, width = target.shape[:2]
    y, x = np.mgrid[:height, :width].astype(np.float64)
    at = np.stack([x, y, np.ones_like(x)], axis=-1) @ a.T  # in the reference
    aligned = np.stack(
        [
            ndimage.map_coordinates(
                reference[..., k].astype(np.float32), [at[..., 1], at[..., 0]], order=1, mode="nearest"
            )
            for k in range(3)
        ],
        axis=-1,
    )
    iod = interocular_distance(reference_landmarks.points, "fw74")
    weight = np.zeros((height, width))
    for outline in _OUTLINES[component]:
        points = reference_landmarks.points[np.concatenate([groups[name] for name in outline])]
        hull = points[ConvexHull(points).vertices]
        inside = Delaunay(hull).find_simplex(at) >= 0
        scale = np.sqrt(abs(np.linalg.det(a[:, :2])))
        away = ndimage.distance_transform_edt(~inside) * scale / iod
        weight = np.maximum(weight, np.clip((_MARGIN - away) / _FEATHER, 0, 1))
    return aligned.astype(np.float32), weight.astype(np.float32)


def _similarity(source: NDArray[np.float64], target: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (2, 3) similarity of the plane that best takes source points to target points."""
    s, t = source - source.mean(axis=0), target - target.mean(axis=0)
    # as complex numbers: t = (a + i b) s
    a = (s * t).sum() / (s**2).sum()
    b = (s[:, 0] * t[:, 1] - s[:, 1] * t[:, 0]).sum() / (s**2).sum()
    turn = np.array([[a, -b], [b, a]])
    return np.column_stack([turn, target.mean(axis=0) - turn @ source.mean(axis=0)])
