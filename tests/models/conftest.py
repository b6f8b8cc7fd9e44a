"""A small population with a face-like spectrum, its topology and model."""

import numpy as np
import pytest

from facewright.mesh.topology import Topology
from facewright.models.bilinear import fit_bilinear

N, S, ROWS, COLUMNS = 16, 9, 15, 12
V = ROWS * COLUMNS


def make_topology():
    grid = np.arange(V, dtype=np.int32).reshape(ROWS, COLUMNS)
    a, b, c, d = grid[:-1, :-1].ravel(), grid[:-1, 1:].ravel(), grid[1:, 1:].ravel(), grid[1:, :-1].ravel()
    quads = np.stack([a, b, c, d], axis=1)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    uv = np.stack(np.meshgrid(np.linspace(0, 1, COLUMNS), np.linspace(0, 1, ROWS)), axis=-1).reshape(-1, 2)
    return Topology(
        name="grid",
        n_vertices=V,
        faces=faces,
        quads=quads,
        uv=uv.astype(np.float32),
        uv_faces=faces,
        parts={"face": (0, 100), "head_and_neck": (100, V)},
        masks={"lips": np.array([3, 4, 9], dtype=np.int32), "none": np.array([], dtype=np.int32)},
        landmarks={"two": np.array([5, -1], dtype=np.int32)},
        mirror=grid[:, ::-1].ravel().copy(),
    )


def make_tensor(rng, n_people=N, n_shapes=S, n_vertices=V, detail_mm=0.2):
    """Mean + identity + expression + their product + detail, mm: decaying spectra, mean far above all."""
    grid = rng.normal(size=(n_vertices, 3)) * 60
    identity = rng.normal(size=(8, n_vertices, 3)) * (4 * 0.7 ** np.arange(8))[:, None, None]
    expression = rng.normal(size=(n_shapes, n_vertices, 3)) * (3 * 0.8 ** np.arange(n_shapes))[:, None, None]
    expression[0] = 0
    people = rng.normal(size=(n_people, 8))
    amplitude = 1 + 0.2 * rng.normal(size=(n_people, n_shapes))
    tensor = grid + np.einsum("ni,ivc->nvc", people, identity)[:, None]
    tensor = tensor + amplitude[:, :, None, None] * expression
    return (tensor + detail_mm * rng.normal(size=tensor.shape)).astype(np.float32)


@pytest.fixture(scope="session")
def population():
    return make_tensor(np.random.default_rng(7))


@pytest.fixture(scope="session")
def model(population):
    return fit_bilinear(
        population,
        8,
        6,
        topology=make_topology(),
        expression_names=["neutral"] + [f"shape{i}" for i in range(1, S)],
        provenance={"face": "grid", "seed": 7},
    )


@pytest.fixture(scope="session")
def tensor_maker():
    return make_tensor
