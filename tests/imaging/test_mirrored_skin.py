"""The far cheek of a turned head from its mirror image, beside the truth of a render."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from facewright.camera.pinhole import Intrinsics
from facewright.faces.appearance import albedo_function, sample_appearance, visible_faces
from facewright.imaging.mesh_view import MeshView
from facewright.imaging.mirrored_skin import MirroredSkin
from facewright.imaging.rasterise import rasterise
from facewright.imaging.render import render_mesh
from facewright.imaging.source_surface import SourceSurface
from facewright.imaging.synthesis import PhotoSynthesiser

SIZE = (300, 320)


class _Person:
    def __init__(self, face):
        self.face, self.faces = face, visible_faces(face)
        self.albedo = albedo_function(face, sample_appearance(np.random.default_rng(3)), self.faces)
        x = np.mgrid[: SIZE[0], : SIZE[1]][1]
        self.wall = np.stack([70 + 60 * ((x // 9) % 2), 110 + 0 * x, 150 + 0 * x], axis=-1).astype(np.uint8)

    def view(self, yaw):
        turn = Rotation.from_euler("y", yaw, degrees=True).as_matrix()
        pivot = np.array([0.0, -60.0, -10.0])
        seen = ((self.face.mean_shape - pivot) @ np.diag([1.0, -1.0, -1.0])) @ turn.T + (0, 70.0, 910.0)
        return MeshView(Intrinsics(520.0, 520.0, 159.5, 149.5).project(seen), seen)

    def render(self, view):
        return render_mesh(
            view.camera_vertices, view.pixels, self.faces, SIZE, albedo=self.albedo, background=self.wall
        ).image


@pytest.fixture(scope="module")
def person(builtin_face):
    return _Person(builtin_face)


@pytest.fixture(scope="module")
def turned(person):
    """A photo of a head turned by 25 degrees."""
    view = person.view(25.0)
    photo = person.render(view)
    return photo, view, PhotoSynthesiser(photo, view, person.face)


def _psnr(a, b, where):
    return 10 * np.log10(255**2 / np.mean((a[where].astype(float) - b[where]) ** 2))


def test_the_far_cheek_is_nearer_to_the_truth(person, turned):
    _, _, synthesiser = turned
    target = person.view(5.0)
    truth = person.render(target)
    head = rasterise(target.pixels, target.depth, person.face.topology.faces, SIZE).covered
    front = target.pixels[person.face.topology.masks["face_region"]]
    far = head.copy()
    far[:, : int(front[:, 0].mean())] = False  # the half that comes into view
    if target.pixels[synthesiser.mirrored.ids, 0].mean() < 160:
        far = head & ~far
    far[int(front[:, 1].max()) - 12 :] = False
    mirrored = synthesiser.draw(target).image
    kept = synthesiser.mirrored
    synthesiser.mirrored = None
    stretched = synthesiser.draw(target).image
    synthesiser.mirrored = kept
    gain = _psnr(mirrored, truth, far) - _psnr(stretched, truth, far)
    assert gain > 1.5, gain


def test_it_comes_in_slowly(person, turned):
    photo, _, synthesiser = turned
    change = []
    for yaw in (24.9, 24.0, 20.0):
        image = synthesiser.draw(person.view(yaw)).image
        change.append(np.abs(image.astype(int) - photo).mean())
    assert change[0] < 0.15 * change[2] and change[0] < change[1] < change[2]


def test_a_head_turned_farther_away_takes_nothing(person, turned):
    photo, view, synthesiser = turned
    target = person.view(38.0)
    seen = rasterise(target.pixels, target.depth, synthesiser.surface.faces, SIZE)
    image, touched = photo.copy(), np.zeros(SIZE, bool)
    synthesiser.mirrored.paint(image, touched, photo, target, seen, (0, 0))
    assert not touched.any()
    synthesiser.mirrored.paint(image, touched, photo, view, seen, (0, 0))
    np.testing.assert_array_equal(image, photo)


def test_light_that_differs_is_made_up_for(person):
    """One side half as bright: the mirrored side is darkened to its neighbours, not brought in bright."""
    view = person.view(25.0)
    photo = person.render(view)
    surface = SourceSurface.of(view, person.face)
    middle = view.pixels[person.face.topology.masks["nose"], 0].mean()
    plain = MirroredSkin.of(photo, surface, person.face)
    far_right = view.pixels[plain.ids, 0].mean() > middle
    shade = 1 / (1 + np.exp((np.arange(SIZE[1]) - middle) / 4 * (1 if far_right else -1)))
    dark = np.rint(photo * (0.6 + 0.4 * shade)[None, :, None]).astype(np.uint8)
    found = MirroredSkin.of(dark, surface, person.face)
    chosen = found.ids[found.weights[:, 0] > 0.5]
    ratios = found.attributes[chosen, 2:] / plain.attributes[chosen, 2:]
    assert np.median(ratios) == pytest.approx(0.6, abs=0.1)


def test_a_head_seen_from_the_front_has_no_other_side(person):
    view = person.view(0.0)
    assert MirroredSkin.of(person.render(view), SourceSurface.of(view, person.face), person.face) is None


def test_a_face_without_mirror_map_has_none(person, turned):
    photo, view, _ = turned
    face = replace(person.face, topology=replace(person.face.topology, mirror=None))
    assert MirroredSkin.of(photo, SourceSurface.of(view, face), face) is None
