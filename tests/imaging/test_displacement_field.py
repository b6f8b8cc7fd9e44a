"""The inverse map: exact on the skin, smooth around it, without folds, nothing beyond the margin."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from facewright.errors import ShapeError, ValueRangeError
from facewright.imaging._warp_kernels import compose, gather_skin, spline_weights
from facewright.imaging.displacement_field import HeadField, displacement_field
from facewright.imaging.mesh_view import MeshView
from facewright.imaging.rasterise import rasterise
from facewright.imaging.source_surface import HEAD, SourceSurface

SIZE = (280, 300)


def _view(face, vertices, turn=(0, 0, 0), shift=(0, 0)):
    pivot = np.array([0.0, -60.0, -10.0])
    rotation = Rotation.from_euler("yxz", turn, degrees=True).as_matrix()
    seen = ((vertices - pivot) @ np.diag([1.0, -1.0, -1.0])) @ rotation.T + (0, 60.0, 900.0)
    return MeshView(430.0 * seen[:, :2] / seen[:, 2:] + (150.0, 145.0) + shift, seen)


def _posed(face, weights):
    return face.mean_shape + np.tensordot(np.asarray(weights, np.float64), face.blendshape_deltas.astype(float), 1)


@pytest.fixture(scope="module")
def source(builtin_face):
    return _view(builtin_face, builtin_face.mean_shape.astype(np.float64))


@pytest.fixture(scope="module")
def field(builtin_face, source):
    return HeadField(SourceSurface.of(source, builtin_face), SIZE)


def test_the_same_view_does_not_move(field, source, builtin_face):
    assert field.map_of(source) is None
    assert not displacement_field(source, source, builtin_face, SIZE).any()


def test_the_skin_is_looked_up_where_the_mesh_says(field, source, builtin_face):
    target = _view(builtin_face, builtin_face.mean_shape.astype(np.float64), (7, 0, 2))
    found = displacement_field(source, target, builtin_face, SIZE)
    front = np.concatenate([builtin_face.topology.masks[n] for n in ("forehead", "cheeks_left", "chin")])
    trusted = front[field.surface.weights[front, 0] > 0.99]
    assert len(trusted) > 100
    cells = np.round(target.pixels[trusted]).astype(int)
    error = found[cells[:, 1], cells[:, 0]] - (source.pixels - target.pixels)[trusted]
    assert np.median(np.linalg.norm(error, axis=1)) < 0.12  # pixels: vertices lie between pixel centres


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 2**31), yaw=st.floats(-25, 25), pitch=st.floats(-15, 15), roll=st.floats(-15, 15))
def test_no_folds_in_random_expressions_and_turns(field, builtin_face, seed, yaw, pitch, roll):
    rng = np.random.default_rng(seed)
    weights = rng.random(46) * (rng.random(46) < 0.2)
    target = _view(builtin_face, _posed(builtin_face, weights), (yaw, pitch, roll), rng.uniform(-10, 10, 2))
    found = field.map_of(target)
    assert found is not None and found.smallest_jacobian > 0
    assert np.isfinite(found.displacement).all()


@pytest.mark.parametrize("shift", [(18, 0), (0, -14), (-9, 9)])
def test_the_field_ends_before_the_window_does(field, builtin_face, shift):
    target = _view(builtin_face, builtin_face.mean_shape.astype(np.float64), shift=shift)
    found = field.map_of(target)
    edge = np.concatenate([found.displacement[:, k] for k in (0, -1)] + [found.displacement[k] for k in (0, -1)])
    x, y = found.origin
    h, w = found.displacement.shape[:2]
    if x > 0 and y > 0 and x + w < SIZE[1] and y + h < SIZE[0]:
        assert not edge.any()
    assert found.smallest_jacobian > 0
    # hair follows: above the skull nearly all of the motion is left
    top = int(target.pixels[np.unique(field.surface.faces[field.surface.kinds == HEAD]), 1].min())
    above = found.displacement[top - 6 - y, int(150 + shift[0]) - x]
    np.testing.assert_allclose(above, np.negative(shift), atol=0.35 * np.hypot(*shift))


def test_nothing_is_looked_up_far_beyond_the_picture(builtin_face):
    """A head at the picture's border that moves away from it: the border's content is stretched, not smeared."""
    vertices = builtin_face.mean_shape.astype(np.float64)
    source = _view(builtin_face, vertices, shift=(0, -95))
    target = _view(builtin_face, vertices, shift=(0, -83))
    found = displacement_field(source, target, builtin_face, SIZE)
    y = np.arange(SIZE[0])[:, None]
    assert (y + found[..., 1]).min() > -4.0


def test_a_jaw_that_opens_leaves_the_shoulders(field, builtin_face):
    weights = np.zeros(46)
    weights[builtin_face.blendshape_names.index("jawOpen")] = 1
    found = field.map_of(_view(builtin_face, _posed(builtin_face, weights)))
    x, y = found.origin
    chin = field.surface.chin
    below = int(chin[1] + 0.5 * field.surface.head_size) - y
    if below < found.displacement.shape[0]:
        assert np.abs(found.displacement[below, int(chin[0]) - x]).max() < 1.5


@pytest.mark.parametrize("shift", [(5000, 0), (0, -900), (-1e30, 0)])
def test_a_head_out_of_the_picture_is_refused(field, source, builtin_face, shift):
    target = _view(builtin_face, builtin_face.mean_shape.astype(np.float64), shift=shift)
    with pytest.raises(ValueRangeError, match="partly in the picture of 300 x 280"):
        field.map_of(target)
    with pytest.raises(ValueRangeError, match="partly in the picture"):
        displacement_field(source, target, builtin_face, SIZE)


def test_a_head_behind_the_camera_is_refused(field, source):
    for depth in (-900.0, 0.0):
        moved = source.camera_vertices - (0, 0, source.depth.mean() - depth)
        with pytest.raises(ValueRangeError, match="before the camera"):
            field.map_of(MeshView(source.pixels + 1, moved))


def test_views_must_match(field, source, builtin_face):
    short = MeshView(source.pixels[1:], source.camera_vertices[1:])
    with pytest.raises(ShapeError):
        field.map_of(short)
    with pytest.raises(ShapeError):
        displacement_field(short, source, builtin_face, SIZE)


def test_spline_weights_sum_to_one():
    for step in (1, 2, 5, 8):
        weights, first = spline_weights(step)
        np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-6)
        # linear functions of the cells' centres are kept
        centres = (first[:, None] + np.arange(4) + 0.5) * step - 0.5
        np.testing.assert_allclose((weights * centres).sum(axis=1), np.arange(step), atol=1e-5)


def test_composition_is_that_of_a_naive_loop(rng):
    step, window, origin = 4, (1, 2, 6, 7), (8, 4)
    cells, solid = rng.normal(0, 3, (2, 6, 7)).astype(np.float32), rng.random((6, 7)).astype(np.float32)
    motion, blend = rng.normal(0, 3, (9, 8, 2)).astype(np.float32), rng.random((9, 8)).astype(np.float32)
    found, share = compose(cells, solid, origin, (24, 28), window, step, motion, blend, (13, 9), np.float32(0.012))
    weights, first = spline_weights(step)
    for y in range(0, 24, 3):
        for x in range(0, 28, 5):
            gy, gx = y + origin[1], x + origin[0]
            rows = np.clip(gy // step - window[0] + first[gy % step] + np.arange(4), 0, 5)
            cols = np.clip(gx // step - window[1] + first[gx % step] + np.arange(4), 0, 6)
            w = np.outer(weights[gy % step], weights[gx % step])
            d = np.array([(w * cells[k][np.ix_(rows, cols)]).sum() for k in range(2)])
            s = (w * solid[np.ix_(rows, cols)]).sum()
            v, u = gy - 9, gx - 13
            s = s * s * (3 - 2 * s) * blend[v, u] if 0 <= v < 9 and 0 <= u < 8 else 0.0
            if s:
                d += s * (motion[v, u] - d)
            assert share[y, x] == pytest.approx(s, abs=1e-5)
            length = np.linalg.norm(d)
            d *= 0 if length <= 0.012 else min(1.0, (length - 0.012) / 0.024)
            np.testing.assert_allclose(found[y, x], d, atol=1e-4)


def test_gathered_cells_are_those_of_numpy(field, source, builtin_face):
    """Sums per cell of the lattice, beside interpolated attributes summed by NumPy."""
    surface = field.surface
    target = _view(builtin_face, builtin_face.mean_shape.astype(np.float64), (10, 0, 0))
    step, window = 5, (0, 0, SIZE[0] // 5, SIZE[1] // 5)
    seen = rasterise(target.pixels, target.depth, surface.faces, SIZE)
    attributes = np.concatenate([source.pixels.astype(np.float32), surface.weights], axis=1)
    table = np.array([*surface.outline_origin, surface.outline_scale], np.float32)
    cells = np.zeros((8, *window[2:]), np.float32)
    motion, blend, layer = gather_skin(
        seen.face_index, seen.barycentric, (0, 0), surface.faces, surface.kinds, attributes, surface.outline, table,
        step, window, cells, np.float32(20), np.float32(0),
        (np.float32(1e6), np.float32(1e6)), np.float32(1),
    )  # fmt: skip
    values = seen.interpolate(surface.faces, attributes)
    head = seen.covered & (surface.kinds[np.maximum(seen.face_index, 0)] == HEAD)
    np.testing.assert_array_equal(layer == HEAD, head)
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    expected = values[..., :2] - np.stack([x, y], axis=-1)
    np.testing.assert_allclose(motion[head], expected[head], atol=1e-3)
    np.testing.assert_allclose(blend[head], values[head][:, 2], atol=1e-5)

    def per_cell(a):
        return (a * head).reshape(window[2], step, window[3], step).sum(axis=(1, 3))

    np.testing.assert_allclose(cells[1], per_cell(values[..., 3]), atol=1e-3)
    np.testing.assert_allclose(cells[2], per_cell(values[..., 3] * expected[..., 0]), atol=5e-2)
