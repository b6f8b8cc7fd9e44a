"""Fixtures of the database's tests: a small topology, people on it, a store."""

import numpy as np
import pytest

from facewright.faces.blendshape_names import BLENDSHAPE_NAMES
from facewright.faces.expressions import EXPRESSION_NAMES
from facewright.mesh.topology import Topology
from facewright.warehouse.store import Warehouse
from facewright.warehouse.subject import Subject

ROWS, COLUMNS = 15, 20  # 300 vertices: three chunks of 128, the last one not full


@pytest.fixture(scope="session")
def grid_topology():
    """A bent sheet of quads with uv, masks (one of them empty), landmarks and a mirror map."""
    k = np.arange(ROWS * COLUMNS).reshape(ROWS, COLUMNS)
    quads = np.stack([k[:-1, :-1], k[:-1, 1:], k[1:, 1:], k[1:, :-1]], axis=-1).reshape(-1, 4).astype(np.int32)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).reshape(2, -1, 3).swapaxes(0, 1).reshape(-1, 3)
    y, x = np.mgrid[0:1:15j, 0:1:20j]
    return Topology(
        name="grid",
        n_vertices=ROWS * COLUMNS,
        faces=np.ascontiguousarray(faces),
        quads=quads,
        uv=np.stack([x.ravel(), y.ravel()], axis=1).astype(np.float32),
        uv_faces=np.ascontiguousarray(faces),
        parts={"face": (0, 200), "head_and_neck": (200, 300)},
        masks={"face": np.arange(0, 200, dtype=np.int32), "none": np.empty(0, np.int32)},
        landmarks={"fw74": np.arange(74, dtype=np.int32) * 4},
        mirror=np.ascontiguousarray(k[:, ::-1]).ravel().astype(np.int32),
    )


@pytest.fixture
def make_subject():
    """Make a subject of random shapes on the grid; the same seed gives the same subject."""

    def make(name="anna", seed=0, *, raw=False, blendshapes=True, **attributes):
        rng = np.random.default_rng(seed)
        y, x = np.mgrid[0:1:15j, 0:1:20j]
        neutral = np.stack([150 * x - 75, 180 * y - 90, 40 * np.sin(np.pi * x)], axis=-1).reshape(-1, 3)
        neutral = neutral + rng.normal(0, 1, neutral.shape)
        deltas = rng.normal(0, 2, (46, *neutral.shape)) * (rng.random((46, len(neutral), 1)) < 0.3)
        weights = rng.uniform(0, 1, (20, 46)) * (np.arange(20) > 0)[:, None]
        fields = {}
        if raw:
            landmarks = rng.uniform(0, 60, (20, 74, 2))
            landmarks[3, 5] = np.nan
            fields = {
                "depth": (rng.uniform(500, 700, (20, 48, 64)) * (rng.random((20, 48, 64)) < 0.5)).astype(np.float32),
                "color": rng.integers(0, 255, (20, 48, 64, 3), dtype=np.uint8),
                "raw_depth": rng.uniform(500, 700, (20, 48, 64)).astype(np.float32),
                "intrinsics": np.tile([575.8, 575.8, 319.5, 239.5], (20, 1)),
                "camera_from_model": np.tile(np.eye(4), (20, 1, 1)),
                "landmarks": landmarks,
                "landmarks_3d": np.full((20, 74, 3), np.nan),
            }
        return Subject(
            name=name,
            expressions=EXPRESSION_NAMES,
            meshes=(neutral + np.tensordot(weights, deltas, 1)).astype(np.float32),
            blendshapes=np.concatenate([neutral[None], neutral + deltas]).astype(np.float32) if blendshapes else None,
            expression_weights=weights,
            attributes=attributes,
            provenance={"seed": seed, "rms_mm": np.float32(0.25), "warnings": ("one",), "nothing": float("nan")},
            **fields,
        )

    return make


@pytest.fixture
def store(tmp_path, grid_topology):
    """An empty database in a folder."""
    pytest.importorskip("zarr")
    return Warehouse.create(tmp_path / "faces.zarr", grid_topology, blendshape_names=BLENDSHAPE_NAMES)


@pytest.fixture
def same_subject():
    """Assert that two subjects are the same, bit by bit."""
    from facewright.warehouse.layout import FIELDS

    def check(found, expected):
        assert found.name == expected.name and found.expressions == tuple(expected.expressions)
        assert dict(found.attributes) == dict(expected.attributes)
        for field in FIELDS:
            a, b = getattr(found, field), getattr(expected, field)
            assert (a is None) == (b is None), field
            if a is not None:
                assert a.dtype == b.dtype and a.tobytes() == np.ascontiguousarray(b).tobytes(), field

    return check
