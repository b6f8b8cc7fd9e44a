"""The signed distance volume: known surfaces without bias, equal bits with any number of threads, Open3D beside."""

import numpy as np
import pytest

from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.camera.rotation import rotation_from_vector
from facewright.capture.volume import DepthVolume
from facewright.errors import ShapeError, ValueRangeError

STILL = RigidMotion(np.eye(3), np.zeros(3))
CAMERA = Intrinsics(575.8, 575.8, 61.3, 70.8)
SIZE = (140, 120)
CENTRE, RADIUS = np.array([4.0, -3.0, 700.0]), 60.0


def rays(camera=CAMERA, size=SIZE):
    v, u = np.mgrid[: size[0], : size[1]]
    x, y = (u - camera.centre_x) / camera.focal_x, (v - camera.centre_y) / camera.focal_y
    return np.stack([x, y, np.ones(size)], axis=2)


def sphere_depth(camera_from_world=STILL, camera=CAMERA, size=SIZE):
    """Depth of a sphere at pixel centres, the first of which is (0, 0)."""
    d, c = rays(camera, size), camera_from_world.apply(CENTRE)
    a, b = (d**2).sum(axis=2), d @ c
    disc = b**2 - a * (c @ c - RADIUS**2)
    return np.where(disc > 0, (b - np.sqrt(np.maximum(disc, 0))) / a, 0.0).astype(np.float32)


def make_volume(**kwargs):
    return DepthVolume(CENTRE - 75.0, CENTRE + [75.0, 75.0, 30.0], **kwargs)


def lateral_error(error, depth, inner):
    """Least-squares shift (x, y, pixels) and offset (mm) that explain an error of depth."""
    gy, gx = np.gradient(depth)
    A = np.stack([gx[inner], gy[inner], np.ones(inner.sum())], axis=1)
    return np.linalg.lstsq(A, error[inner], rcond=None)[0]


def test_a_clean_sphere_comes_back_without_bias():
    truth = sphere_depth()
    volume = make_volume()
    volume.integrate(truth, CAMERA, STILL)
    view = volume.view(CAMERA, STILL, SIZE)
    inner = (truth > 0) & (truth < CENTRE[2] - 0.5 * RADIUS)
    assert (view.depth[inner] > 0).mean() > 0.99
    inner &= view.depth > 0
    error = view.depth - truth
    # mm; half a pixel off would be 0.5 below, and 0.25 mm in the mean of |error|
    assert np.abs(error[inner]).mean() < 0.03
    shift_x, shift_y, offset = lateral_error(error, truth, inner)
    assert abs(shift_x) < 0.01 and abs(shift_y) < 0.01 and abs(offset) < 0.03
    points = rays() * view.depth[..., None]
    outwards = (points - CENTRE) / RADIUS
    assert np.percentile((outwards * view.normals).sum(axis=2)[inner], 1) > 0.999


def test_half_a_pixel_in_the_principal_point_would_be_seen():
    truth = sphere_depth()
    wrong = Intrinsics(CAMERA.focal_x, CAMERA.focal_y, CAMERA.centre_x + 0.5, CAMERA.centre_y + 0.5)
    volume = make_volume()
    volume.integrate(truth, wrong, STILL)
    view = volume.view(CAMERA, STILL, SIZE)
    inner = (truth > 0) & (truth < CENTRE[2] - 0.5 * RADIUS) & (view.depth > 0)
    shift = lateral_error(view.depth - truth, truth, inner)
    assert np.allclose(np.abs(shift[:2]), 0.5, atol=0.05)


def test_a_slanted_plane_is_exact():
    normal = np.array([0.3, -0.2, -1.0])
    depth = ((normal @ CENTRE) / (rays() @ normal)).astype(np.float32)
    volume = DepthVolume([-120.0, -130.0, 600.0], [120.0, 130.0, 800.0])
    volume.integrate(depth, CAMERA, STILL)
    view = volume.view(CAMERA, STILL, SIZE)
    inner = np.zeros(SIZE, bool)
    inner[8:-8, 8:-8] = True
    assert (view.depth[inner] > 0).all()
    assert np.abs(view.depth - depth)[inner].max() < 0.02


def test_views_from_other_poses_agree_with_the_truth():
    volume = make_volume()
    for angle in np.deg2rad([-10.0, 0.0, 10.0]):
        turn = rotation_from_vector([0.0, angle, 0.0])
        camera_from_world = RigidMotion(turn, CENTRE - turn @ CENTRE + [3.0, 1.0, -2.0])
        volume.integrate(sphere_depth(camera_from_world), CAMERA, camera_from_world.inverse())
    turn = rotation_from_vector([0.1, 0.05, 0.02])
    camera_from_world = RigidMotion(turn, CENTRE - turn @ CENTRE)
    truth = sphere_depth(camera_from_world)
    view = volume.view(CAMERA, camera_from_world.inverse(), SIZE)
    inner = (truth > 0) & (truth < CENTRE[2] - 0.6 * RADIUS)
    assert (view.depth[inner] > 0).mean() > 0.99
    inner &= view.depth > 0
    assert np.abs(view.depth - truth)[inner].mean() < 0.04


def test_noise_averages_out(rng):
    truth = sphere_depth()
    volume = make_volume()
    for _ in range(16):
        noisy = truth + (truth > 0) * rng.normal(0.0, 1.5, SIZE)
        volume.integrate(noisy.astype(np.float32), CAMERA, STILL)
    view = volume.view(CAMERA, STILL, SIZE)
    inner = (truth > 0) & (truth < CENTRE[2] - 0.6 * RADIUS) & (view.depth > 0)
    error = (view.depth - truth)[inner]
    assert np.sqrt((error**2).mean()) < 1.5 / 3
    assert abs(error.mean()) < 0.05


def test_pixels_without_weight_do_not_count():
    truth = sphere_depth()
    volume = make_volume()
    volume.integrate(truth, CAMERA, STILL)
    before = volume.tsdf.copy()
    volume.integrate(truth + 3.0, CAMERA, STILL, share=np.zeros(SIZE, np.float32))
    assert np.array_equal(before, volume.tsdf)
    assert not volume.view(CAMERA, STILL, SIZE, least_weight=1.5).depth.any()


@pytest.mark.parametrize("threads", ["1", "3"])
def test_equal_bits_with_any_number_of_threads(monkeypatch, threads, rng):
    frames = [(sphere_depth() + np.random.default_rng(k).normal(0, 1, SIZE)).astype(np.float32) for k in range(3)]
    views = []
    for count in ("2", threads):
        monkeypatch.setenv("NUMBA_NUM_THREADS", count)
        volume = make_volume()
        for frame in frames:
            volume.integrate(np.maximum(frame, 0), CAMERA, STILL)
        views.append(volume.view(CAMERA, STILL, SIZE))
    assert np.array_equal(views[0].depth, views[1].depth)
    assert np.array_equal(views[0].normals, views[1].normals)


def test_what_is_refused():
    with pytest.raises(ValueRangeError, match="positive extents"):
        DepthVolume(np.zeros(3), np.zeros(3))
    with pytest.raises(ValueRangeError, match=r"at most 2\^27 voxels"):
        DepthVolume(np.zeros(3), np.full(3, 5000.0))
    with pytest.raises(ShapeError, match="share must have shape"):
        make_volume().integrate(sphere_depth(), CAMERA, STILL, share=np.ones((2, 2), np.float32))


def test_open3d_finds_the_same_surface():
    """Open3D 0.19's block grid, beside: its fused surface agrees if the principal point is half a pixel further."""
    o3d = pytest.importorskip("open3d")
    core = o3d.core
    truth = sphere_depth()
    errors = {}
    for shift in (0.0, 0.5):
        grid = o3d.t.geometry.VoxelBlockGrid(
            ("tsdf", "weight"), (core.float32, core.float32), ((1), (1)), 0.0015, 8, 4000, core.Device("CPU:0")
        )
        matrix = CAMERA.matrix
        matrix[:2, 2] += shift
        image, K, pose = o3d.t.geometry.Image(core.Tensor(truth)), core.Tensor(matrix), core.Tensor(np.eye(4))
        blocks = grid.compute_unique_block_coordinates(image, K, pose, 1000.0, 2.0, 4.0)
        grid.integrate(blocks, image, K, pose, 1000.0, 2.0, 4.0)
        points = grid.extract_point_cloud(0.5).point.positions.numpy() * 1000.0 - CENTRE
        front = points[points[:, 2] < -0.6 * RADIUS]
        off = np.linalg.norm(front, axis=1) - RADIUS
        errors[shift] = np.linalg.lstsq(np.c_[front / RADIUS, np.ones(len(front))], off, rcond=None)[0]
    assert np.abs(errors[0.5][:2]).max() < 0.05
    assert np.abs(errors[0.0][:2]).min() > 0.4  # mm: half a pixel at 650 mm
