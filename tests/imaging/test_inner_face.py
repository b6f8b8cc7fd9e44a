import time
from types import SimpleNamespace

import numpy as np
import pytest

from facewright.camera.pinhole import Intrinsics
from facewright.camera.rotation import rotation_from_head_angles
from facewright.errors import ShapeError
from facewright.faces.appearance import albedo_function, sample_appearance, vertex_gloss, visible_faces
from facewright.faces.simulate import simulate_person
from facewright.imaging.inner_face import InnerFace
from facewright.imaging.inner_parts import eyeball, openings, rigid_motion, sphere_centre, turn_of_gaze
from facewright.imaging.mesh_view import MeshView
from facewright.imaging.render import Lights, render_mesh
from facewright.imaging.synthesis import PhotoSynthesiser
from facewright.imaging.wide_blur import block_means

SIZE = (300, 300)
SMILE = {name: 0.8 for name in ("mouthSmile_L", "mouthSmile_R", "mouthUpperUp_L", "mouthUpperUp_R")}
BLINK = {"eyeBlink_L": 1.0, "eyeBlink_R": 1.0}


class Person:
    """A simulated person before a camera, whose photo in any expression is known."""

    def __init__(self, face, seed, size=SIZE, focal=1150.0):
        rng = np.random.default_rng(seed)
        self.face, self.size = face, size
        self._person, self.look = simulate_person(face, rng), sample_appearance(rng)
        self._faces = visible_faces(face)
        self._camera = Intrinsics.for_image(size, focal)

    def view(self, yaw=6.0, shift=0.0, turned=None, **shapes):
        weights = np.zeros(len(self.face.blendshape_names))
        for name, weight in shapes.items():
            weights[self.face.blendshape_names.index(name)] = weight
        vertices = np.array(self._person.pose(weights), float)
        if turned is not None:
            for side, gaze in zip(("right", "left"), turned):
                ids = eyeball(self.face, side)
                centre = sphere_centre(vertices[ids])
                vertices[ids] = (vertices[ids] - centre) @ turn_of_gaze(np.asarray(gaze)).T + centre
        rotation = rotation_from_head_angles(yaw, 0, 0)
        seen = rotation @ (vertices - (0, 0, 40)).T
        seen = seen.T + (shift, 0, 900)
        return MeshView(self._camera.project(seen), seen)

    def photo(self, view):
        look, faces = self.look, self._faces
        lights = Lights(look.light_directions, look.light_colours, look.sky, look.ground)
        return render_mesh(
            view.camera_vertices,
            view.pixels,
            faces,
            self.size,
            albedo=albedo_function(self.face, look, faces),
            lights=lights,
            shininess=vertex_gloss(self.face),
            background=(120, 130, 140),
        ).image

    def box(self, part, *views):
        masks = self.face.topology.masks
        names = ["lips"] if part == "mouth" else [f"eyelid_upper_{part}", f"eyelid_lower_{part}"]
        points = np.concatenate([view.pixels[masks[name]] for view in views for name in names])
        low, high = np.floor(points.min(axis=0)).astype(int) - 2, np.ceil(points.max(axis=0)).astype(int) + 3
        return slice(low[1], high[1]), slice(low[0], high[0])


def psnr(a, b):
    return 10 * np.log10(255**2 / ((a.astype(float) - b) ** 2).mean())


class Redrawn:
    """A photo of a person in one expression, and what redraws it."""

    def __init__(self, person, **shapes):
        self.source = person.view(**shapes)
        self.photo = person.photo(self.source)
        self.inner = InnerFace.of(self.photo, self.source, person.face)
        self._warp = PhotoSynthesiser(self.photo, self.source, person.face)

    def plain(self, target):
        """The photo warped by its skin, with nothing drawn in mouth and eyes."""
        return self._warp.draw(target).image


@pytest.fixture(scope="module")
def person(builtin_face):
    return Person(builtin_face, 8)


@pytest.fixture(scope="module")
def redrawn(person):
    kept = {}

    def get(shapes):
        key = tuple(sorted(shapes.items()))
        return kept.setdefault(key, None) or kept.update({key: Redrawn(person, **shapes)}) or kept[key]

    return get


@pytest.fixture(scope="module")
def neutral(redrawn):
    return redrawn({}).photo, redrawn({}).source, redrawn({}).inner


def test_no_change_draws_nothing(neutral):
    photo, view, inner = neutral
    image, touched = photo.copy(), np.zeros(SIZE, bool)
    inner.paint(image, view, touched=touched)
    assert not touched.any()
    np.testing.assert_array_equal(image, photo)


def test_a_head_that_only_shifts_is_left_to_the_warp(person, neutral):
    photo, _, inner = neutral
    image, touched = photo.copy(), np.zeros(SIZE, bool)
    inner.paint(image, person.view(shift=6.0), touched=touched)
    assert not touched.any()


@pytest.mark.parametrize(
    ("before", "after", "part", "gain", "least"),
    [
        ({}, {"jawOpen": 0.6}, "mouth", 4.0, 20.0),
        ({}, SMILE, "mouth", 0.5, 19.0),
        ({"jawOpen": 0.5}, {}, "mouth", 2.0, 23.0),
        (SMILE, {}, "mouth", 1.0, 23.0),
        (SMILE, {"jawOpen": 0.6}, "mouth", 3.0, 20.0),
        ({}, BLINK, "left", 4.0, 22.0),
        ({}, BLINK, "right", 4.0, 22.0),
        ({}, {"eyeBlink_L": 0.5}, "left", 3.0, 22.0),
        ({}, {"eyeWide_L": 1.0, "eyeWide_R": 1.0}, "right", 1.0, 20.0),
        (BLINK, {}, "left", 2.0, 17.0),
    ],
)
def test_nearer_to_the_true_picture_than_the_plain_warp(person, redrawn, before, after, part, gain, least):
    start, target = redrawn(before), person.view(**after)
    truth, plain = person.photo(target), start.plain(target)
    image = plain.copy()
    start.inner.paint(image, target)
    box = person.box(part, target)
    assert psnr(image[box], truth[box]) > max(psnr(plain[box], truth[box]) + gain, least)


def test_what_is_drawn_is_told_and_nothing_else_changes(person, neutral):
    photo, _, inner = neutral
    image, touched = photo.copy(), np.zeros(SIZE, bool)
    inner.paint(image, person.view(jawOpen=0.5), touched=touched)
    assert touched.any()
    assert not (image != photo).any(axis=2)[~touched].any()


def test_a_closed_lid_shows_neither_iris_nor_white(person, redrawn):
    target = person.view(**BLINK)
    image = redrawn({}).plain(target)
    redrawn({}).inner.paint(image, target)
    for side in ("right", "left"):
        lid = target.pixels[person.face.topology.masks[f"eyelid_upper_{side}"]]
        x, y = np.round(lid).astype(int).T
        shades = image[y, x].astype(float)
        # white is far less red than skin
        assert ((shades[:, 0] - shades[:, 2]) > 0.15 * shades[:, 0]).mean() > 0.95


def test_a_little_motion_changes_little(person, redrawn):
    target = person.view(jawOpen=0.02, eyeBlink_L=0.03)
    plain = redrawn({}).plain(target)
    image = plain.copy()
    redrawn({}).inner.paint(image, target)
    assert np.abs(image.astype(float) - plain).mean() < 0.5


def test_the_gaze_turns_the_photos_iris(person, neutral):
    photo, source, inner = neutral
    gaze = np.array([[0.35, 0.0], [0.35, 0.0]])
    image = photo.copy()
    inner.paint(image, source, gaze)
    truth = person.photo(person.view(turned=gaze))
    for side in ("right", "left"):
        box = person.box(side, source)
        assert psnr(image[box], truth[box]) > psnr(photo[box], truth[box]) + 3.0


def test_a_mesh_whose_eyes_are_turned_needs_no_gaze(person, neutral):
    photo, source, inner = neutral
    gaze = np.array([[0.3, 0.1], [0.3, 0.1]])
    turned = person.view(turned=gaze)
    image, again = photo.copy(), photo.copy()
    inner.paint(image, turned)
    inner.paint(again, turned, gaze)
    box = person.box("left", source)
    assert psnr(image[box], person.photo(turned)[box]) > psnr(photo[box], person.photo(turned)[box]) + 3.0
    assert np.abs(image[box].astype(float) - again[box]).mean() < 6.0


def test_parts_outside_the_photo_are_left_out(person):
    source, target = person.view(), person.view(jawOpen=0.6, **BLINK)
    photo = person.photo(source)
    cut = int(source.pixels[person.face.topology.masks["nose"], 1].mean())
    upper = np.ascontiguousarray(photo[:cut])
    image = upper.copy()
    InnerFace.of(upper, source, person.face).paint(image, target)
    assert (image != upper).any()


def test_an_unchanged_view_with_its_own_gaze_is_the_photo(person):
    gaze = np.array([[0.22, -0.1], [0.18, -0.12]])
    source = person.view(turned=gaze)
    photo = person.photo(source)
    image, touched = photo.copy(), np.zeros(SIZE, bool)
    InnerFace.of(photo, source, person.face, gaze=gaze).paint(image, source, gaze, touched)
    assert not touched.any()
    np.testing.assert_array_equal(image, photo)


def test_a_face_of_two_thousand_pixels_takes_seconds_and_looks_the_same(person, neutral):
    photo, source, inner = neutral
    target, n = person.view(jawOpen=0.5, **BLINK), 8

    def larger(view):
        return MeshView((view.pixels + 0.5) * n - 0.5, view.camera_vertices)

    large = np.ascontiguousarray(photo.repeat(n, axis=0).repeat(n, axis=1))
    assert np.ptp(larger(source).pixels[person.face.topology.masks["face_region"], 1]) > 2000
    image = photo.copy()
    inner.paint(image, target)
    start = time.process_time()
    InnerFace.of(large, larger(source), person.face).paint(large, larger(target))
    assert time.process_time() - start < 12.0
    assert psnr(block_means(large.astype(np.float32), n), image) > 32.0


def test_mouth_and_eyes_look_as_they_did(person, redrawn, golden):
    target = person.view(jawOpen=0.45, mouthLowerDown_L=0.4, mouthLowerDown_R=0.4, eyeBlink_R=0.5, eyeBlink_L=1.0)
    image = redrawn({}).plain(target)
    redrawn({}).inner.paint(image, target)
    golden("inner_face", np.ascontiguousarray(image[30:270, 40:260]))


def test_other_sizes_are_refused(person, neutral):
    photo, view, inner = neutral
    with pytest.raises(ShapeError):
        inner.paint(photo[1:].copy(), view)
    with pytest.raises(ShapeError):
        inner.paint(photo.copy(), MeshView(view.pixels[1:], view.camera_vertices[1:]))


def test_rigid_motion_and_sphere_are_recovered(rng):
    points = rng.normal(size=(200, 3))
    points = 12.0 * points / np.linalg.norm(points, axis=1, keepdims=True)
    points[:20] *= 1.1  # a cornea
    rotation, shift = turn_of_gaze(np.array([0.3, -0.2])), np.array([3.0, -5.0, 700.0])
    found, moved = rigid_motion(points, points @ rotation.T + shift)
    np.testing.assert_allclose(found, rotation, atol=1e-9)
    np.testing.assert_allclose(moved, shift, atol=1e-9)
    np.testing.assert_allclose(sphere_centre(points + shift), shift, atol=0.2)


def test_a_nose_before_the_far_eye_hides_it(person, builtin_face):
    source = person.view(yaw=25.0)
    photo = person.photo(source)
    inner, field = InnerFace.of(photo, source, builtin_face), PhotoSynthesiser(photo, source, builtin_face).field
    target = person.view(yaw=40.0, **BLINK)
    found = field.map_of(target)
    shown, (x, y) = found.fragments.face_index, found.fragments_origin
    window = np.s_[y : y + shown.shape[0], x : x + shown.shape[1]]
    faces, nose = builtin_face.topology.faces, np.zeros(builtin_face.topology.n_vertices, bool)
    nose[: builtin_face.n_skin] = True
    for opening in openings(builtin_face):  # the skin round the eyes is theirs
        nose[opening.vertices] = False
    inside = np.zeros(SIZE, bool)
    inside[window] = nose[faces[shown]].any(axis=2) & (shown >= 0)
    drawn = []
    for front in (None, (shown, (x, y))):
        touched = np.zeros(SIZE, bool)
        inner._shading = SimpleNamespace(paint=lambda *_: None)  # which rightly changes the nose
        inner.paint(photo.copy(), target, touched=touched, front=front)
        drawn.append((touched & inside).sum())
    assert drawn[0] > 10 and drawn[1] == 0
