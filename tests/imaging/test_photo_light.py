import numpy as np
import pytest

from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.camera.rotation import rotation_from_head_angles
from facewright.errors import DegenerateError, ShapeError
from facewright.faces.appearance import albedo_function, sample_appearance, visible_faces
from facewright.imaging.mesh_view import MeshView
from facewright.imaging.photo_light import estimate_light, harmonics
from facewright.imaging.render import Lights, render_mesh

SIZE = (240, 240)


def frontal(face, yaw=5.0):
    intrinsics = Intrinsics.for_image(SIZE, 800.0)
    rotation = rotation_from_head_angles(yaw, 0, 0)
    motion = RigidMotion(rotation, np.array([0, 0, 900.0]) - rotation @ np.array([0, 0, 40.0]))
    seen = motion.apply(face.mean_shape.astype(float))
    return MeshView(intrinsics.project(seen), seen)


def photographed(face, view, rng, lights):
    faces = visible_faces(face)
    look = sample_appearance(rng)
    albedo = albedo_function(face, look, faces)
    return render_mesh(view.camera_vertices, view.pixels, faces, SIZE, albedo=albedo, lights=lights, shininess=0).image


def white(lights, normals):
    """The renderer's own diffuse shading of a white surface."""
    up = 0.5 - 0.5 * normals[:, 1:2]
    light = up * np.array(lights.sky) + (1 - up) * np.array(lights.ground)
    for direction, colour in zip(lights.directions, lights.colours):
        cosine = normals @ (direction / np.linalg.norm(direction))
        light = light + np.clip((cosine + 0.25) / 1.25, 0, None)[:, None] ** 1.3 * colour
    return light


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_the_side_and_strength_of_a_key_light_are_found(builtin_face, rng, side):
    lights = Lights(np.array([[0.8 * side, -0.3, -0.6]]), np.full((1, 3), 0.7), (0.25,) * 3, (0.15,) * 3)
    view = frontal(builtin_face)
    light = estimate_light(photographed(builtin_face, view, rng, lights), view, builtin_face)
    normals = np.array([[0.7, 0, -0.714], [-0.7, 0, -0.714], [0, -0.6, -0.8], [0, 0, -1.0]])
    expected = white(lights, normals).mean(axis=1)
    found = light.irradiance(normals).mean(axis=1)
    # one photo does not tell how light the skin is: shares of the frontal light
    np.testing.assert_allclose(found / found[3], expected / expected[3], atol=0.17)
    assert 0.5 < found[3] / expected[3] < 1.6
    assert np.sign(light.lights().directions[0, 0]) == side


def test_lights_for_the_renderer_shade_like_the_estimate(builtin_face, rng):
    lights = Lights()
    view = frontal(builtin_face)
    light = estimate_light(photographed(builtin_face, view, rng, lights), view, builtin_face)
    normals = rng.normal(size=(200, 3))
    normals[:, 2] = -np.abs(normals[:, 2]) - 0.5
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    error = np.abs(white(light.lights(), normals) - light.irradiance(normals))
    assert error.mean() < 0.1 * light.irradiance(normals).mean()


def test_a_dark_beard_changes_little(builtin_face):
    view = frontal(builtin_face)
    photo = photographed(builtin_face, view, np.random.default_rng(4), Lights())
    clean = estimate_light(photo, view, builtin_face)
    chin = view.pixels[builtin_face.topology.masks["chin"]]
    low, high = chin.min(axis=0).astype(int), chin.max(axis=0).astype(int)
    bearded = photo.copy()
    bearded[low[1] : high[1], low[0] : high[0]] = 20
    forward = np.array([[0.0, 0.0, -1.0]])
    found = estimate_light(bearded, view, builtin_face).skin(forward)
    np.testing.assert_allclose(found, clean.skin(forward), rtol=0.12)


def test_harmonics_are_orthogonal_over_the_sphere(rng):
    n = rng.normal(size=(200_000, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    basis = harmonics(n)
    gram = basis.T @ basis / len(n)
    assert np.abs(gram - np.diag(np.diag(gram))).max() < 0.01


def test_a_face_outside_the_photo_is_refused(builtin_face):
    view = frontal(builtin_face)
    away = MeshView(view.pixels + 5000.0, view.camera_vertices)
    with pytest.raises(DegenerateError, match="skin"):
        estimate_light(np.zeros((*SIZE, 3), np.uint8), away, builtin_face)


def test_a_view_of_another_mesh_is_refused(builtin_face):
    view = frontal(builtin_face)
    with pytest.raises(ShapeError):
        estimate_light(
            np.zeros((*SIZE, 3), np.uint8), MeshView(view.pixels[1:], view.camera_vertices[1:]), builtin_face
        )
