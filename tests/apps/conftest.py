"""Fixtures of the apps' tests: a small region-based model whose truth is known."""

import numpy as np
import pytest

from facewright.models.region_boundaries import share_boundaries
from facewright.models.region_pca import fit_region_pca
from facewright.models.regions import Regions


def patch_models(n_components=6, frames=60):
    """A sheet of 9 x 7 vertices in four quarters that move each in its own way; region-based and holistic model."""
    rng = np.random.default_rng(5)
    x, y = np.meshgrid(np.linspace(-40, 40, 9), np.linspace(-30, 30, 7))
    neutral = np.stack([x.ravel(), y.ravel(), 100 - 0.01 * (x.ravel() ** 2 + y.ravel() ** 2)], axis=1)
    ids = np.arange(63).reshape(7, 9)
    a, b, c, d = ids[:-1, :-1].ravel(), ids[:-1, 1:].ravel(), ids[1:, 1:].ravel(), ids[1:, :-1].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int32)
    centres = np.array([[-20, -15], [20, -15], [-20, 15], [20, 15.0]])
    bumps = np.exp(-((neutral[:, None, :2] - centres) ** 2).sum(axis=2) / (2 * 14.0**2))
    ways = np.linalg.qr(rng.normal(size=(4, 3, 3)))[0]  # each quarter can go anywhere
    moves = np.einsum("tbk,bkc,nb->tnc", rng.normal(size=(frames, 4, 3)) * 4, ways, bumps)
    labels = (neutral[:, 0] > 0).astype(int) + 2 * (neutral[:, 1] > 0)
    regions = share_boundaries(labels, faces)
    region = fit_region_pca(moves, faces, neutral, regions, n_components)
    holistic = fit_region_pca(moves, faces, neutral, Regions.holistic(63), 5)
    return region, holistic


@pytest.fixture(scope="session")
def patch():
    """Region-based and holistic model of a small sheet."""
    return patch_models()
