import numpy as np
import pytest

from facewright.errors import DegenerateError, ShapeError, ValueRangeError
from facewright.fitting.registration import (
    RegistrationOptions,
    TemplateRegistration,
    bend_by_landmarks,
    conjugate_gradients,
)
from facewright.mesh.closest_point import closest_points


@pytest.fixture(scope="module")
def template(builtin_face):
    n = builtin_face.topology.parts["face"][1]
    return builtin_face.mean_shape[:n].astype(np.float64), builtin_face.topology.submesh(n)


@pytest.fixture(scope="module")
def registration(template):
    return TemplateRegistration(template[0], template[1].faces, RegistrationOptions(match_rim=True))


def person(builtin_face, rng, n):
    weights = rng.normal(size=len(builtin_face.identity_basis))
    return (builtin_face.mean_shape + np.tensordot(weights, builtin_face.identity_basis, 1))[:n].astype(np.float64)


def known_marks(topology):
    marks = topology.landmarks["ibug68"]
    return marks[marks >= 0]


def rms(vectors):
    return float(np.sqrt((vectors**2).sum(axis=1).mean()))


def test_a_person_is_found_better_than_by_landmarks_alone(builtin_face, template, registration, rng):
    mean, topology = template
    target = person(builtin_face, rng, len(mean))
    marks = known_marks(topology)
    steps = []
    found = registration.register(target, topology.faces, marks, target[marks], lambda *s: steps.append(s))
    surface = closest_points(target, topology.faces, found.vertices).distances
    assert np.sqrt((surface**2).mean()) < 0.25
    assert rms(found.vertices - target) < 0.7 * rms(found.start - target)
    assert rms(found.vertices - target) < 0.5 * rms(mean - target)
    assert found.landmark_rms_mm < 0.3
    assert found.surface_rms_mm < 0.2
    assert found.matched.mean() > 0.9
    assert steps[-1] == ("registering", 7, 7)


def test_the_pose_of_the_target_does_not_matter(builtin_face, template, registration, rng):
    from facewright.camera.rotation import rotation_from_vector

    mean, topology = template
    target = person(builtin_face, rng, len(mean))
    marks = known_marks(topology)
    here = registration.register(target, topology.faces, marks, target[marks]).vertices
    R, t = rotation_from_vector(rng.normal(size=3)), rng.normal(size=3) * 500
    there = registration.register(target @ R.T + t, topology.faces, marks, target[marks] @ R.T + t).vertices
    # the smoothness is the same; conjugate gradients stop at a tolerance
    assert rms(there - (here @ R.T + t)) < 0.05


def test_holes_leave_the_template_near_where_its_surroundings_put_it(builtin_face, template, rng):
    mean, topology = template
    target = person(builtin_face, rng, len(mean))
    marks = known_marks(topology)
    centre = target[topology.masks["cheeks_left"]].mean(axis=0)
    hole = np.linalg.norm(target - centre, axis=1) < 15.0
    faces = topology.faces[~hole[topology.faces].any(axis=1)]
    found = TemplateRegistration(mean, topology.faces).register(target, faces, marks, target[marks])
    assert (~found.matched[hole]).mean() > 0
    assert rms((found.vertices - target)[hole]) < 2.0


def test_few_landmarks_give_a_similarity(rng):
    points = rng.normal(size=(50, 3)) * 40
    wanted = 1.3 * points[:5] + [5.0, 6.0, 7.0]
    np.testing.assert_allclose(bend_by_landmarks(points, np.arange(5), wanted), 1.3 * points + [5, 6, 7], atol=1e-9)


def test_many_landmarks_are_met_and_affine_maps_kept(rng):
    points = rng.normal(size=(200, 3)) * 40
    A = np.eye(3) + 0.1 * rng.normal(size=(3, 3))
    ids = np.arange(30)
    np.testing.assert_allclose(bend_by_landmarks(points, ids, points[ids] @ A.T), points @ A.T, atol=1e-6)
    wanted = points[ids] + rng.normal(size=(30, 3))
    np.testing.assert_allclose(bend_by_landmarks(points, ids, wanted)[ids], wanted, atol=1e-6)


def test_conjugate_gradients_solve_a_random_system(rng):
    B = rng.normal(size=(40, 40))
    A = B @ B.T + 40 * np.eye(40)
    right = rng.normal(size=(40, 3))
    x = conjugate_gradients(
        lambda v: A @ v, lambda v: v / np.diag(A)[:, None], right, np.zeros((40, 3)), tolerance=1e-10, iterations=200
    )
    np.testing.assert_allclose(A @ x, right, atol=1e-7)


def test_what_cannot_be_registered_is_refused(template, registration):
    mean, topology = template
    marks = known_marks(topology)
    with pytest.raises(ShapeError, match="landmark_positions"):
        registration.register(mean, topology.faces, marks, mean[marks][:5])
    with pytest.raises(ValueRangeError, match="finite"):
        registration.register(mean, topology.faces, marks, mean[marks] * np.nan)
    with pytest.raises(ValueRangeError, match="landmark_vertices"):
        registration.register(mean, topology.faces, marks - 10**6, mean[marks])
    with pytest.raises(DegenerateError, match="line"):
        registration.register(mean, topology.faces, marks[:4], np.outer(np.arange(4.0), [1, 2, 3]))
    with pytest.raises(DegenerateError, match="same way"):
        registration.register(mean, topology.faces[:, ::-1], marks, mean[marks])


@pytest.mark.parametrize("options", [{"stiffness": ()}, {"stiffness": (1.0, 0.0)}, {"tangential": -1.0}])
def test_options_are_checked(options):
    with pytest.raises(ValueRangeError):
        RegistrationOptions(**options)
