"""Tracking with models of fewer people or fewer expressions, beside the whole one (FaceWarehouse Fig. 12)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from facewright.evaluation.component import SYMMETRIC
from facewright.faces.face import Face
from facewright.fitting.video import VideoFitter
from facewright.landmarks.dense import DensePoints, dense_points
from facewright.models.bilinear import BilinearModel, fit_bilinear

#: People of the smaller model; expressions of the other, the neutral among them, are `SYMMETRIC`.
N_FEW = 15


@dataclass(frozen=True, eq=False)
class Tracker:
    """A fitter whose model may have other shapes than the face.

    Parameters
    ----------
    fitter : VideoFitter
        Of the model.
    mixing : ndarray of shape (B, 46)
        How much of each of the face's shapes one of the model's B shapes is.
    """

    fitter: VideoFitter
    mixing: NDArray[np.float64]

    def coefficients(self, weights: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the face's coefficients (T, 46), in [0, 1], of the model's (T, B)."""
        return np.clip(np.asarray(weights, dtype=np.float64) @ self.mixing, 0.0, 1.0)


def smaller_trackers(skin: Face, tensor: NDArray[np.float32], n_identity: int) -> dict[str, Tracker]:
    """Build the models of Fig. 12 from a population.

    Parameters
    ----------
    skin : Face
        Its face.
    tensor : ndarray of shape (N, 47, V, 3), millimetres
        The population, neutral first.
    n_identity : int
        Identity components, where there are as many people.

    Returns
    -------
    dict of str to Tracker
        ``15x47``: the first 15 people with all shapes; ``150x10`` (by the number of people): all people with the
        neutral and nine symmetric expressions, sums of shapes.
    """
    names = skin.blendshape_names
    N, S = tensor.shape[:2]
    people = min(N_FEW, N)
    few = fit_bilinear(tensor[:people], people, S, topology=skin.topology, expression_names=("neutral", *names))
    mixing = mixing_of(SYMMETRIC, names)
    neutral = tensor[:, 0]
    shapes = np.empty((N, 1 + len(SYMMETRIC), *neutral.shape[1:]), np.float32)
    shapes[:, 0] = neutral
    for i, row in enumerate(mixing):
        chosen = np.flatnonzero(row)
        shapes[:, 1 + i] = neutral + (tensor[:, 1 + chosen] - neutral[:, None]).sum(axis=1)
    plain = fit_bilinear(
        shapes,
        min(n_identity, N),
        shapes.shape[1],
        topology=skin.topology,
        expression_names=("neutral", *SYMMETRIC),
    )
    return {
        f"{people}x{S}": Tracker(VideoFitter(few), np.eye(len(names))),
        f"{N}x{shapes.shape[1]}": Tracker(VideoFitter(plain, points=_seen_as(plain, mixing)), mixing),
    }


def mixing_of(sums: Mapping[str, Sequence[str]], names: Sequence[str]) -> NDArray[np.float64]:
    """Return which shapes (B, 46) each sum is made of."""
    mixing = np.zeros((len(sums), len(names)))
    for row, parts in zip(mixing, sums.values(), strict=True):
        row[[list(names).index(part) for part in parts]] = 1.0
    return mixing


def _seen_as(model: BilinearModel, mixing: NDArray[np.float64]) -> DensePoints:
    """Return the detector's points with its response to the model's own shapes."""
    points = dense_points(model.topology)
    if not len(points.expression_response):
        return points
    response = np.tensordot(mixing, points.expression_response, 1)
    return replace(points, expression_response=response, blendshape_names=tuple(model.expression_names[1:]))
