import numpy as np
import pytest
from scipy.interpolate import LinearNDInterpolator

from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.camera.rotation import rotation_angle, rotation_from_head_angles
from facewright.errors import DegenerateError, ShapeError, ValueRangeError
from facewright.fitting.dense_model import FramePose
from facewright.fitting.face_surface import SurfacePoints
from facewright.fitting.video import VideoFitOptions, VideoFitter, _chunks, _runs
from facewright.landmarks.face_crops import CROP_SIDE, FaceCrop, FaceCrops
from facewright.landmarks.track import LandmarkTrack

SIZE = (480, 640)


@pytest.fixture(scope="module")
def video_fitter(small_model):
    return VideoFitter(small_model, VideoFitOptions(key_frames=6))


def make_clip(fitter, rng, T=50, noise=0.15, gap=None, smile_from=15):
    """Return a track of a person of the model as the detector would see it, and the truth."""
    dense = fitter.dense
    c, q = 0.7 * rng.normal(size=dense.n_identity), np.r_[rng.normal(size=24), np.zeros(dense.n_modes - 24)]
    person = dense.person(c, q)
    weights = np.zeros((T, 46))
    smile, blink = (
        [dense.names.index(f"mouthSmile_{s}") for s in "LR"],
        [dense.names.index(f"eyeBlink_{s}") for s in "LR"],
    )
    weights[smile_from : smile_from + 15, smile] = 0.8
    weights[38:41, blink] = 0.9
    frames, rotations = [], []
    for k in range(T):
        R = rotation_from_head_angles(12 * np.sin(k / 8.0), 5 * np.cos(k / 6.0), 2.0)
        motion = RigidMotion(R, np.array([10.0, -5.0, 650.0]) - R @ [0, 0, 40.0])
        pose = FramePose(motion, Intrinsics.for_image(SIZE, 960.0))
        points = dense.predict(person, pose, weights[k]) + rng.normal(0, noise, (dense.points.n_points, 2))
        frames.append(None if gap is not None and gap[0] <= k < gap[1] else points)
        rotations.append(R)
    return LandmarkTrack.of(np.arange(T) / 25.0, frames, SIZE), weights, np.array(rotations), (smile, blink)


def test_recovers_what_is_acted(video_fitter, rng):
    track, weights, rotations, (smile, blink) = make_clip(video_fitter, rng)
    fit = video_fitter.fit(track)
    ours = fit.performance
    assert np.abs(ours.weights - weights).mean() < 0.4 * np.abs(weights).mean()
    assert (ours.weights[18:27][:, smile] > 0.5).all() and (ours.weights[:8][:, smile] < 0.15).all()
    assert ours.weights[39, blink].min() > 0.5 and ours.weights[34, blink].max() < 0.25
    degrees = [np.rad2deg(rotation_angle(a, b)) for a, b in zip(ours.rotations, rotations, strict=True)]
    assert np.mean(degrees) < 2.0
    assert np.nanmean(fit.residuals_iod) < 0.02
    assert fit.identity.rig.neutral.shape == (video_fitter.model.n_vertices, 3)


def test_the_neutral_is_not_the_first_frame(video_fitter, rng):
    """A clip that begins with a smile begins with a smile."""
    track, _, _, (smile, _) = make_clip(video_fitter, rng, smile_from=0)
    ours = video_fitter.fit(track).performance.weights
    assert ours[2:12][:, smile].min() > 0.4
    assert ours[20:35][:, smile].max() < 0.2


def test_smoothing_has_no_lag_and_less_jitter(small_model, video_fitter, rng):
    track, weights, _, (_, blink) = make_clip(video_fitter, rng, noise=0.5)
    identity = video_fitter.identity(track)
    smooth = video_fitter.fit(track, identity).performance.weights
    rough = VideoFitter(small_model, VideoFitOptions(smoothness=0.0)).fit(track, identity).performance.weights
    assert np.abs(np.diff(smooth, 2, axis=0)).mean() < 0.7 * np.abs(np.diff(rough, 2, axis=0)).mean()
    lid = smooth[:, blink].mean(axis=1)
    lags = [np.corrcoef(np.roll(lid, -lag), weights[:, blink[0]])[0, 1] for lag in (-2, -1, 0, 1, 2)]
    assert int(np.argmax(lags)) == 2


def test_time_reversed_clips_give_reversed_coefficients(video_fitter, rng):
    track, *_ = make_clip(video_fitter, rng)
    identity = video_fitter.identity(track)
    back = LandmarkTrack(track.times, track.points[::-1].copy(), track.tracked, SIZE)
    there, again = (video_fitter.fit(each, identity).performance.weights for each in (track, back))
    assert np.abs(there - again[::-1]).mean() < 0.01


def test_frames_without_a_face_hold_and_ease(video_fitter, rng):
    track, *_ = make_clip(video_fitter, rng, gap=(22, 50))
    fit = video_fitter.fit(track)
    assert not fit.performance.tracked[22:].any() and np.isnan(fit.residuals_iod[22:]).all()
    np.testing.assert_allclose(fit.performance.weights[24], fit.performance.weights[21])
    assert np.abs(fit.performance.weights[-1]).max() == 0.0
    np.testing.assert_allclose(fit.performance.rotations[40], fit.performance.rotations[21], atol=1e-9)


def test_runs_and_chunks_cover_each_tracked_frame_once(rng):
    T = 2000
    tracked = rng.random(T) > 0.02
    cuts = rng.random(T) > 0.995
    points = np.where(tracked[:, None, None], 1.0, np.nan) * np.ones((T, 478, 2))
    track = LandmarkTrack(np.arange(T) / 25.0, points.astype(np.float32), tracked, SIZE, cuts)
    seen = np.zeros(T, int)
    for _, run in _runs(track):
        assert not track.cuts[run.start + 1 : run.stop].any()
        for chunk, kept in _chunks(run):
            assert chunk.start <= kept.start < kept.stop <= chunk.stop
            seen[kept] += 1
    np.testing.assert_array_equal(seen, tracked.astype(int))
    pieces = _chunks(slice(0, 2000))
    assert len(pieces) == 3 and pieces[1][0].start < pieces[1][1].start


def drawn(fitter, track, c, q, weights, rng):
    """Return what a camera sees of the clip's person: a mottled skin in light from one side, and nothing around it."""
    person = fitter.dense.person(c, q)
    surface = SurfacePoints(fitter.model).of(fitter.model.blendshapes(fitter.dense.identity_of(person)))
    skin = 130.0 * np.exp(0.3 * np.sin(surface.rest @ rng.normal(0, 0.12, (3, 6))).mean(axis=1))
    crops = []
    for k, beta in enumerate(weights):
        R = rotation_from_head_angles(12 * np.sin(k / 8.0), 5 * np.cos(k / 6.0), 2.0)
        points, normals = surface.at(beta)
        motion = RigidMotion(R, np.array([10.0, -5.0, 650.0]) - R @ [0, 0, 40.0])
        pixels = Intrinsics.for_image(SIZE, 960.0).project(motion.apply(points))
        level = skin * (0.7 + 0.3 * (normals @ R.T) @ np.array([0.6, -0.5, -0.62]))
        low, step = pixels.min(axis=0) - 8, float(np.ptp(pixels, axis=0).max() + 16) / (CROP_SIDE - 1)
        grid = low + step * np.stack(np.meshgrid(*2 * [np.arange(CROP_SIDE)]), axis=-1)
        picture = LinearNDInterpolator(pixels, level, fill_value=60.0)(grid) + rng.normal(0, 1.0, grid.shape[:2])
        crops.append(FaceCrop(np.clip(np.rint(picture), 0, 255).astype(np.uint8), low, step))
    return FaceCrops.of(crops)


def test_brightness_tells_what_points_do_not(video_fitter, rng):
    """Cheeks puff while the points stay where they were."""
    dense = video_fitter.dense
    seed = int(rng.integers(2**31))
    track, weights, *_ = make_clip(video_fitter, np.random.default_rng(seed))
    again = np.random.default_rng(seed)  # the same person
    c, q = 0.7 * again.normal(size=dense.n_identity), np.r_[again.normal(size=24), np.zeros(dense.n_modes - 24)]
    puff = [dense.names.index(f"cheekPuff_{s}") for s in "LR"]
    acted = weights.copy()
    acted[4:12, puff] = 0.8
    crops = drawn(video_fitter, track, c, q, acted, rng)
    identity = video_fitter.identity(track)
    blind = video_fitter.fit(track, identity).performance
    seeing = video_fitter.fit(track, identity, crops=crops).performance
    assert blind.weights[6:10, puff].max() < 0.1
    assert seeing.weights[6:10, puff].min() > 0.3 and seeing.weights[20:35, puff].max() < 0.15
    assert np.abs(seeing.weights - acted).mean() < np.abs(blind.weights - acted).mean()
    with pytest.raises(ShapeError, match="crops"):
        video_fitter.fit(track, identity, crops=FaceCrops.of([None] * 3))
    nothing = video_fitter.fit(track, identity, crops=FaceCrops.of([None] * track.n_frames)).performance
    assert np.abs(nothing.weights - blind.weights).max() < 1e-9


def test_refuses_what_cannot_be_fitted(video_fitter):
    with pytest.raises(ValueRangeError, match="key_frames"):
        VideoFitOptions(key_frames=0)
    with pytest.raises(ValueRangeError, match="expression_spread"):
        VideoFitOptions(expression_spread=0.0)
    with pytest.raises(ValueRangeError, match="smoothness"):
        VideoFitOptions(smoothness=-1.0)
    with pytest.raises(ValueRangeError, match="focal_length"):
        VideoFitOptions(focal_length=-5.0)
    nobody = LandmarkTrack.of([0.0, 0.04], [None, None], SIZE)
    with pytest.raises(DegenerateError, match="at least one frame"):
        video_fitter.fit(nobody)
