"""One person of the database, as arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ValueRangeError
from facewright.numeric.check import check_finite, check_shape

N_LANDMARKS = 74


@dataclass(frozen=True, eq=False)
class Subject:
    """A person: expression meshes, 46 personal blendshapes, and the records they came from.

    Every array about expressions has one row for each of `expressions`, in that order; what is unknown is None.

    Parameters
    ----------
    name : str
        Letters, digits, ``-``, ``_`` and ``.``; unique in the database.
    expressions : tuple of str
        Names of the S expressions that are there, the neutral first.
    meshes : ndarray of shape (S, V, 3), float32, millimetres
        The fitted meshes in one head frame (model space).
    blendshapes : ndarray of shape (47, V, 3), float32, millimetres, or None
        The neutral and the 46 personal blendshapes, absolute positions.
    expression_weights : ndarray of shape (S, 46), float64, or None
        Blendshape weights that each expression was found to be acted with.
    depth : ndarray of shape (S, H, W), float32, millimetres, or None
        Fused depth of each reference frame; 0 for none.
    color : ndarray of shape (S, H, W, 3), uint8, or None
        The reference frames' pictures.
    raw_depth : ndarray of shape (S, H, W), float32, millimetres, or None
        Depth of the reference frames as the camera gave it; 0 for none.
    intrinsics : ndarray of shape (S, 4), float64, or None
        Focal lengths x, y and principal point x, y of the reference frames.
    camera_from_model : ndarray of shape (S, 4, 4), float64, or None
        The head's pose in each reference frame.
    landmarks : ndarray of shape (S, 74, 2), float64, pixels, or None
        2D landmarks, NaN where missing.
    landmarks_3d : ndarray of shape (S, 74, 3), float64, millimetres, or None
        Landmarks lifted by the depth, in the camera's frame, NaN where there is none.
    attributes : mapping of str to str, int, float or bool
        ``age``, ``sex``, ``ethnicity`` and free ones.
    provenance : mapping
        Versions, parameters, residuals in mm, warnings: whatever JSON holds. No times of day or durations: equal
        input gives an equal subject.
    """

    name: str
    expressions: tuple[str, ...]
    meshes: NDArray[np.float32]
    blendshapes: NDArray[np.float32] | None = None
    expression_weights: NDArray[np.float64] | None = None
    depth: NDArray[np.float32] | None = None
    color: NDArray[np.uint8] | None = None
    raw_depth: NDArray[np.float32] | None = None
    intrinsics: NDArray[np.float64] | None = None
    camera_from_model: NDArray[np.float64] | None = None
    landmarks: NDArray[np.float64] | None = None
    landmarks_3d: NDArray[np.float64] | None = None
    attributes: Mapping[str, str | int | float | bool] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_name(self.name)
        if (
            not self.expressions
            or self.expressions[0] != "neutral"
            or len(set(self.expressions)) < len(self.expressions)
        ):
            raise ValueRangeError(
                f"expressions of subject {self.name!r} must be unique and begin with 'neutral', got {self.expressions}."
            )
        sizes = check_shape("meshes", self.meshes, len(self.expressions), "V", 3)
        check_finite(f"meshes of subject {self.name!r}", self.meshes)
        if self.blendshapes is not None:
            check_shape("blendshapes", self.blendshapes, 47, "V", 3, **sizes)
            check_finite(f"blendshapes of subject {self.name!r}", self.blendshapes)
        S = len(self.expressions)
        sizes = {}
        for key, axes in (
            ("expression_weights", (S, 46)),
            ("depth", (S, "H", "W")),
            ("color", (S, "H", "W", 3)),
            ("raw_depth", (S, "H", "W")),
            ("intrinsics", (S, 4)),
            ("camera_from_model", (S, 4, 4)),
            ("landmarks", (S, N_LANDMARKS, 2)),
            ("landmarks_3d", (S, N_LANDMARKS, 3)),
        ):
            if getattr(self, key) is not None:
                sizes = check_shape(key, getattr(self, key), *axes, **sizes)


def check_name(name: str) -> None:
    """Raise ValueRangeError unless `name` can name a subject everywhere: in paths, URLs and on the command line."""
    usable = bool(name) and all(c.isascii() and (c.isalnum() or c in "-_.") for c in name)
    if not usable or name.startswith(".") or len(name) > 128:
        raise ValueRangeError(
            f"name of a subject must be up to 128 letters, digits, -, _ or ., not beginning with a dot, got {name!r}."
        )
