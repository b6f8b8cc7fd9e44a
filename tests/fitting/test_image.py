import numpy as np
import pytest

from facewright.camera.rotation import rotation_angle
from facewright.errors import DegenerateError, TopologyError, ValueRangeError
from facewright.evaluation.mesh_distance import mesh_distance
from facewright.fitting.image import PhotoFitOptions, PhotoFitter, fit_photo
from facewright.landmarks.contour import face_region
from facewright.landmarks.points import Landmarks

SIZE = (640, 640)


def test_recovers_people_of_the_model(fitter, make_photo, small_model, rng):
    """Synthetic truth: pose within degrees, landmarks within a pixel, shape far nearer than the mean face."""
    region = face_region(small_model.topology, small_model.mean_face)
    faces = small_model.topology.faces
    ours, trivial, degrees = [], [], []
    for _ in range(6):
        vertices, _, _, motion, landmarks = make_photo(rng)
        fit = fitter.fit(landmarks, SIZE, PhotoFitOptions(noise_mm=0.3))
        degrees.append(np.rad2deg(rotation_angle(fit.rotation, motion.rotation)))
        ours.append(mesh_distance(fit.vertices, vertices, faces, region).correspondence_mm)
        trivial.append(mesh_distance(small_model.mean_face, vertices, faces, region).correspondence_mm)
        inner = landmarks.definition.fixed
        assert np.nanmean(fit.residuals_px[inner]) < 1.0
        assert ((fit.blendshape_weights >= 0) & (fit.blendshape_weights <= 1)).all()
    assert np.mean(degrees) < 2.5
    assert np.mean(ours) < 0.5 * np.mean(trivial)


def test_mesh_is_the_mixture_of_the_person_s_blendshapes(fitter, make_photo, rng):
    """Eq. (10) and eq. (17) agree: the rig at the fitted coefficients is the fitted mesh."""
    fit = fitter.fit(make_photo(rng)[4], SIZE)
    difference = fit.rig.pose(fit.blendshape_weights) - fit.vertices
    assert np.sqrt((difference**2).sum(axis=1).mean()) < 0.05
    ids = fit.model.topology.landmarks["fw74"]
    inner = fit.landmarks.definition.fixed
    np.testing.assert_allclose(fit.project(fit.vertices[ids[inner]]), fit.reprojection[inner], atol=0.3)


@pytest.mark.parametrize("perspective", [True, False])
def test_outliers_and_missing_points_do_little_harm(fitter, make_photo, rng, perspective):
    landmarks = make_photo(rng)[4]
    options = PhotoFitOptions(perspective=perspective)
    clean = fitter.fit(landmarks, SIZE, options)
    points, confidence = landmarks.points.copy(), np.ones(74)
    points[[30, 57]] += 60.0
    confidence[[16, 45, 3]] = 0.0
    points[[16, 45, 3]] = np.nan
    dirty = fitter.fit(Landmarks("fw74", points, confidence), SIZE, options)
    assert np.rad2deg(rotation_angle(clean.rotation, dirty.rotation)) < 3.0
    assert np.isfinite(dirty.reprojection).all()
    assert np.isnan(dirty.residuals_px[[16, 45, 3]]).all()
    assert 0 < dirty.reprojection_iod < 0.2


def test_weak_perspective_suits_distant_cameras(fitter, make_photo, rng):
    for _ in range(3):
        _, _, _, motion, landmarks = make_photo(rng, distance=9000.0, focal=14000.0)
        fit = fitter.fit(landmarks, SIZE, PhotoFitOptions(perspective=False))
        assert fit.intrinsics is None and fit.camera_from_model is None
        assert np.rad2deg(rotation_angle(fit.rotation, motion.rotation)) < 8.0
        assert fit.weak_camera.scale == pytest.approx(14000 / 9000, rel=0.1)
        assert fit.reprojection_iod < 0.03


def test_a_known_focal_length_is_kept(fitter, make_photo, rng):
    _, _, _, motion, landmarks = make_photo(rng, distance=500.0, focal=800.0)
    fit = fitter.fit(landmarks, SIZE, PhotoFitOptions(focal_length=800.0, noise_mm=0.3))
    assert fit.intrinsics.focal_x == pytest.approx(800.0, rel=0.1)
    assert fit.camera_from_model.translation[2] == pytest.approx(motion.translation[2], rel=0.1)


def test_scale_and_place_of_the_picture_do_not_matter(fitter, make_photo, rng):
    landmarks = make_photo(rng)[4]
    a = fitter.fit(landmarks, SIZE)
    b = fitter.fit(Landmarks("fw74", landmarks.points * 3.0 + 1.0), (1920, 1920))
    np.testing.assert_allclose(a.blendshape_weights, b.blendshape_weights, atol=0.02)
    assert np.rad2deg(rotation_angle(a.rotation, b.rotation)) < 0.2


def test_mirrored_pictures_give_mirrored_heads(fitter, make_photo, rng):
    landmarks = make_photo(rng)[4]
    yaw, pitch, roll = fitter.fit(landmarks, SIZE).head_angles_degrees
    mirrored = fitter.fit(landmarks.mirrored(640), SIZE).head_angles_degrees
    np.testing.assert_allclose(mirrored, (-yaw, pitch, -roll), atol=2.5)


def test_other_schemes_are_fitted(small_model, make_photo, rng):
    _, _, _, motion, landmarks = make_photo(rng)
    by_68 = fit_photo(small_model, landmarks.convert("ibug68"), SIZE)
    assert np.rad2deg(rotation_angle(by_68.rotation, motion.rotation)) < 8.0
    direct = PhotoFitter(small_model, "ibug68").fit(landmarks.convert("ibug68"), SIZE)
    assert direct.landmarks.scheme == "ibug68"
    assert np.rad2deg(rotation_angle(direct.rotation, motion.rotation)) < 8.0


def test_gradient_of_the_joint_energy(fitter, make_photo, rng):
    """Finite differences of the whole energy in all its unknowns."""
    from dataclasses import replace

    from facewright.camera.pinhole import Intrinsics, RigidMotion
    from facewright.camera.rotation import rotation_from_vector
    from facewright.fitting.coordinate_descent import Targets
    from facewright.fitting.energies.expression_prior import ExpressionPrior
    from facewright.fitting.perspective_refinement import CameraPrior, PinholeProblem, PinholeState

    small = fitter.landmark_model
    _, _, intrinsics, motion, landmarks = make_photo(rng)
    order = np.concatenate([small.fixed, small.sliding])
    targets = Targets(landmarks.points[order] + rng.normal(0, 3, (74, 2)), np.ones(74), len(small.fixed), 1.0)
    c, beta = rng.normal(size=small.n_identity) * 0.3, rng.uniform(0.1, 0.4, 46)
    state = PinholeState(small.person(c), beta, motion, intrinsics)
    centre = state.person.candidates(small.expression(beta)).mean(axis=0)
    problem = PinholeProblem(small, targets, ExpressionPrior(), CameraPrior(1200.0, 0.4), centre, state)
    _, g = problem.quadratic(state)

    def moved(x):
        middle = state.motion.apply(centre)
        middle = middle + np.array([*(x[3:5] / state.scale(centre)), 0.0])
        middle = middle * np.exp(-x[5])
        middle[2] *= np.exp(x[6])
        rotation = rotation_from_vector(x[:3]) @ motion.rotation
        focal = intrinsics.focal_x * np.exp(x[6])
        return PinholeState(
            small.person(c + x[7 : 7 + len(c)]),
            beta + x[7 + len(c) :],
            RigidMotion(rotation, middle - rotation @ centre),
            replace(Intrinsics.for_image(SIZE), focal_x=focal, focal_y=focal),
        )

    n = len(g)
    for i in [0, 1, 2, 3, 4, 5, 6, 7, 9, 12, n - 46, n - 20, n - 1]:
        h = 1e-3
        e = h * np.eye(n)[i]
        numeric = (problem.energy(moved(e)) - problem.energy(moved(-e))) / (2 * h)
        assert g[i] == pytest.approx(numeric, rel=2e-2, abs=0.05), i


def test_refuses_bad_input(fitter, make_photo, builtin_face, rng):
    landmarks = make_photo(rng)[4]
    few = np.zeros(74)
    few[15:20] = 1
    with pytest.raises(DegenerateError, match="at least 10"):
        fitter.fit(Landmarks("fw74", landmarks.points, few), SIZE)
    with pytest.raises(DegenerateError):
        fitter.fit(Landmarks("fw74", np.full((74, 2), 100.0)), SIZE)
    for bad in ({"rounds": 0}, {"refinements": -1}, {"noise_mm": 0.0}, {"focal_length": -5.0}, {"noise_mm": np.nan}):
        with pytest.raises(ValueRangeError):
            PhotoFitOptions(**bad)


def test_refuses_models_without_landmarks(small_model):
    from dataclasses import replace

    bare = replace(small_model.topology, landmarks={})
    with pytest.raises(TopologyError, match="fw74"):
        PhotoFitter(replace(small_model, topology=bare))
