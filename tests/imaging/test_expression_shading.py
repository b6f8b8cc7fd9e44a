"""The light on skin that follows the expression, on rendered people."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from facewright.imaging.expression_shading import ExpressionShading
from facewright.imaging.mesh_view import MeshView
from facewright.imaging.photo_light import estimate_light
from facewright.imaging.synthesis import PhotoSynthesiser

_spec = importlib.util.spec_from_file_location("test_inner_face_people", Path(__file__).with_name("test_inner_face.py"))
people = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(people)

FULL = {name: 1.0 for name in ("mouthSmile_L", "mouthSmile_R", "cheekSquint_L", "cheekSquint_R")}


@pytest.fixture(scope="module")
def person(builtin_face):
    return people.Person(builtin_face, 8)


def shading_of(person, view, photo=None):
    photo = person.photo(view) if photo is None else photo
    return photo, ExpressionShading.of(photo, view, person.face, estimate_light(photo, view, person.face))


def painted(shading, image, target, head=None):
    image, marks = image.copy(), np.zeros(image.shape[:2], bool)
    shading.paint(image, marks, target, np.eye(3) if head is None else head)
    return image, marks


def test_no_change_changes_nothing(person):
    view = person.view()
    photo, shading = shading_of(person, view)
    image, marks = painted(shading, photo, view)
    assert not marks.any()
    np.testing.assert_array_equal(image, photo)


def test_a_head_that_turns_as_a_whole_keeps_its_light(person):
    view = person.view()
    photo, shading = shading_of(person, view)
    angle = np.radians(12.0)
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    centre = view.camera_vertices.mean(axis=0)
    turned = MeshView(view.pixels, (view.camera_vertices - centre) @ turn.T + centre)
    _, marks = painted(shading, photo, turned, turn)
    assert not marks.any()


@pytest.mark.parametrize(("before", "after"), [({}, FULL), (FULL, {})])
def test_a_smile_lights_the_cheeks_as_in_its_true_picture(person, before, after):
    view, target = person.view(**before), person.view(**after)
    photo, shading = shading_of(person, view)
    warped, truth = PhotoSynthesiser(photo, view, person.face).draw(target).image, person.photo(target)
    image, marks = painted(shading, warped, target)
    assert marks.sum() > 500
    assert people.psnr(image[marks], truth[marks]) > people.psnr(warped[marks], truth[marks]) + 0.2
    np.testing.assert_array_equal(image[~marks], warped[~marks])


def test_the_fold_of_a_smile_goes_with_it(person):
    smiling, target = person.view(**FULL), person.view()
    photo = person.photo(smiling)
    points = smiling.pixels[person.face.topology.landmarks["fw74"]]
    wing, corner = points[47], points[54]
    away = 0.5 * (wing + corner) + 0.35 * (corner - points[57])  # beside the mouth, on the subject's right
    step = (corner - wing) / np.linalg.norm(corner - wing)
    y, x = np.mgrid[: photo.shape[0], : photo.shape[1]]
    along, across = (x - away[0]) * step[0] + (y - away[1]) * step[1], (x - away[0]) * step[1] - (y - away[1]) * step[0]
    dark = 0.55 * np.exp(-((across / 1.5) ** 2)) * (np.abs(along) < 10)
    folded = np.round(photo * (1 - dark[..., None])).astype(np.uint8)
    _, shading = shading_of(person, smiling, folded)
    line = dark > 0.4
    kept = painted(shading, folded, smiling)[0]
    # drawn in the smile's own places, so that what went is seen without the warp
    gone = painted(shading, folded, MeshView(smiling.pixels, target.camera_vertices))[0]
    np.testing.assert_array_equal(kept, folded)
    before = photo[line].mean() - folded[line].mean()
    assert photo[line].mean() - gone[line].mean() < 0.6 * before


def test_skin_outside_the_picture_is_left_out(person):
    view = person.view()
    photo, shading = shading_of(person, view)
    target = person.view(**FULL)
    away = MeshView(target.pixels - (0.0, 5000.0), target.camera_vertices)
    image, marks = painted(shading, photo, away)
    assert not marks.any()
    np.testing.assert_array_equal(image, photo)
