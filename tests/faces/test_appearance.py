import numpy as np
import pytest

from facewright.faces.appearance import albedo_function, sample_appearance, vertex_colors, visible_faces
from facewright.faces.expressions import expression_weights
from facewright.faces.simulate import simulate_person
from facewright.imaging.portrait import portrait_view, render_portrait
from facewright.imaging.render import Lights


@pytest.fixture(scope="module", params=["builtin", "ict"])
def face(request):
    return request.getfixturevalue(f"{request.param}_face")


def render(face, look, vertices, size=(480, 440), **view):
    faces = visible_faces(face)
    return render_portrait(
        vertices,
        faces,
        size,
        albedo=albedo_function(face, look, faces),
        lights=Lights(look.light_directions, look.light_colours, look.sky, look.ground),
        background=look.background,
        height_mm=300.0,
        **view,
    ).image


def test_colours_are_colours_and_features_stand_out(face):
    masks = face.topology.masks
    for seed in range(12):
        look = sample_appearance(np.random.default_rng(seed))
        colours = vertex_colors(face, look)
        assert colours.shape == (face.topology.n_vertices, 3)
        assert np.isfinite(colours).all()
        assert colours.min() >= 0
        assert colours.max() <= 1
        light = colours.mean(axis=1)
        cheek = light[masks["cheeks_left"]].mean()
        assert light[masks["brow_left"]].min() < 0.85 * cheek
        assert light[masks["pupil_left"]].min() < 0.12
        lips, skin = colours[masks["lips_lower"]].mean(axis=0), look.skin
        assert lips[0] / lips[1] > skin[0] / skin[1]  # redder than the skin


def test_skin_goes_from_light_to_dark():
    skins = [sample_appearance(np.random.default_rng(seed)).skin.mean() for seed in range(200)]
    assert min(skins) < 0.35
    assert max(skins) > 0.75


def test_see_through_shells_are_not_drawn(ict_face):
    drawn = np.unique(visible_faces(ict_face))
    for name in ("eyelashes_left", "lacrimal_right", "eye_occlusion_left", "eye_blend_right"):
        assert not np.isin(np.arange(*ict_face.topology.parts[name]), drawn).any()
    assert np.isin(np.arange(*ict_face.topology.parts["eyeball_left"]), drawn).any()


def test_a_render_shows_white_eyes_with_dark_pupils(face):
    look = sample_appearance(np.random.default_rng(1))
    image = render(face, look, face.mean_shape, (480, 440))
    pixels = portrait_view(face.mean_shape, (480, 440), height_mm=300.0)[1]
    column, row = pixels[face.topology.masks["pupil_left"]].mean(axis=0).round().astype(int)
    assert image[row, column].max() < 90
    forehead_column, forehead_row = pixels[face.topology.masks["forehead"]].mean(axis=0).round().astype(int)
    assert image[forehead_row, forehead_column].mean() > image[row, column].mean() + 40


@pytest.mark.landmarks
def test_the_detector_finds_people_and_their_landmarks(face):
    pytest.importorskip("mediapipe")
    from facewright.landmarks.mediapipe_detector import MediaPipeDetector

    rng = np.random.default_rng(8)
    errors = []
    with MediaPipeDetector() as detector:
        for name in ("smile", "mouth_stretch", "brow_raiser", "eyes_closed"):
            person, look = simulate_person(face, rng), sample_appearance(rng)
            vertices = person.pose(expression_weights(name))
            view = {"yaw_degrees": rng.uniform(-20, 20), "pitch_degrees": rng.uniform(-8, 8)}
            found = detector.detect(render(face, look, vertices, **view))
            assert len(found) == 1, name
            pixels = portrait_view(vertices, (480, 440), height_mm=300.0, **view)[1]
            truth = pixels[face.topology.landmarks["fw74"]]
            eyes = np.linalg.norm(truth[[27, 31]].mean(axis=0) - truth[[35, 39]].mean(axis=0))
            errors.append(np.linalg.norm(found[0].convert("fw74").points - truth, axis=1)[15:] / eyes)
    assert np.mean(errors) < 0.05
