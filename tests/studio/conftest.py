"""Fixtures of the pages' tests: a model of the built-in face that takes no training data."""

import numpy as np
import pytest

pytest.importorskip("nicegui", reason="needs the studio extra (NiceGUI)")

from facewright.faces.performance_region import performance_region
from facewright.mesh.uniform_subsample import subsample_mesh
from facewright.models.region_boundaries import share_boundaries
from facewright.models.region_pca import fit_region_pca
from facewright.models.regions import Regions


@pytest.fixture(scope="session")
def face_models(builtin_face):
    """Region-based (both sides of brows, cheeks, mouth) and holistic model of 200 vertices of the built-in face."""
    skin = builtin_face.skin()
    sub = subsample_mesh(
        skin.mean_shape, skin.topology.faces, 200, within=performance_region(builtin_face), mirror=skin.topology.mirror
    )
    neutral = skin.mean_shape[sub.vertex_ids].astype(np.float64)
    rng = np.random.default_rng(3)
    weights = np.clip(rng.normal(0, 0.4, (150, len(skin.blendshape_names))), 0, 1)
    moves = np.einsum("tb,bnc->tnc", weights, skin.blendshape_deltas[:, sub.vertex_ids].astype(np.float64))
    labels = (neutral[:, 0] > 0) + 2 * np.digitize(neutral[:, 1], [-20, 20])
    regions = share_boundaries(labels, sub.faces)
    provenance = {"template": "builtin", "vertex_ids": sub.vertex_ids.tolist()}
    return (
        fit_region_pca(moves, sub.faces, neutral, regions, 6, provenance=provenance),
        fit_region_pca(moves, sub.faces, neutral, Regions.holistic(200), 8, provenance=provenance),
    )
