"""A photo with its face changed, checked on rendered people whose every view is known."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.errors import ShapeError, ValueRangeError
from facewright.faces.appearance import albedo_function, sample_appearance, visible_faces
from facewright.faces.face import Face
from facewright.imaging.mesh_view import MeshView
from facewright.imaging.render import render_mesh
from facewright.imaging.synthesis import PhotoSynthesiser, Synthesis, SynthesisOptions

SIZE = (300, 320)
NECK = np.array([0.0, -60.0, -10.0])  # heads turn about it


@dataclass(frozen=True, eq=False)
class Scene:
    """A generic person before a camera and a background with texture."""

    face: Face
    background: np.ndarray
    camera: Intrinsics
    pose: RigidMotion

    def view(self, vertices, turn=(0.0, 0.0, 0.0), shift=(0.0, 0.0, 0.0)):
        rotation = Rotation.from_euler("yxz", turn, degrees=True).as_matrix()
        pivot = self.pose.apply(NECK)
        seen = (self.pose.apply(vertices) - pivot) @ rotation.T + pivot + shift
        return MeshView(self.camera.project(seen), seen)

    def expression(self, **weights):
        deltas = self.face.blendshape_deltas
        moved = sum(w * deltas[self.face.blendshape_names.index(name)] for name, w in weights.items())
        return self.face.mean_shape.astype(np.float64) + moved

    def render(self, view):
        faces = visible_faces(self.face)
        albedo = albedo_function(self.face, sample_appearance(np.random.default_rng(3)), faces)
        return render_mesh(
            view.camera_vertices, view.pixels, faces, SIZE, albedo=albedo, background=self.background
        ).image


@pytest.fixture(scope="module")
def scene(builtin_face):
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    waves = np.stack([np.sin(x / 9 + k) * np.cos(y / 11 - k) for k in range(3)], axis=-1)
    background = (128 + 50 * waves + np.random.default_rng(0).normal(0, 6, (*SIZE, 3))).clip(0, 255).astype(np.uint8)
    pose = RigidMotion(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 10.0, 900.0]))
    return Scene(builtin_face, background, Intrinsics(520.0, 520.0, 159.5, 149.5), pose)


@pytest.fixture(scope="module")
def subject(scene):
    source = scene.view(scene.expression(mouthSmile_L=0.3))
    photo = scene.render(source)
    return source, photo, PhotoSynthesiser(photo, source, scene.face)


def _psnr(a, b, where):
    return 10 * np.log10(255**2 / np.mean((a[where].astype(float) - b[where]) ** 2))


def test_no_change_gives_the_photo_back_bit_for_bit(subject):
    source, photo, synthesiser = subject
    result = synthesiser.draw(source)
    np.testing.assert_array_equal(result.image, photo)
    assert not result.touched.any() and result.smallest_jacobian == 1.0
    assert not np.shares_memory(result.image, photo)


CASES = {
    "jaw": ({"jawOpen": 1.0}, (0, 0, 0), (0, 0, 0)),
    "brows": ({"browInnerUp_L": 1.0, "browInnerUp_R": 1.0, "browOuterUp_L": 1.0}, (0, 0, 0), (0, 0, 0)),
    "turned": ({"mouthSmile_L": 0.3}, (12, 0, 0), (0, 0, 0)),
    "nodding": ({"mouthSmile_L": 0.3}, (0, 8, 5), (0, 0, 0)),
    "moved": ({"mouthSmile_L": 0.3}, (0, 0, 0), (15, -10, 40)),
    "all": ({"mouthPucker": 0.7, "jawLeft": 0.5}, (-10, 5, 4), (-8, 6, 0)),
}


@pytest.mark.parametrize("case", CASES)
def test_it_is_nearer_to_the_truth_than_the_photo(scene, subject, case):
    _, photo, synthesiser = subject
    weights, turn, shift = CASES[case]
    target = scene.view(scene.expression(**weights), turn, shift)
    truth = scene.render(target)
    result = synthesiser.draw(target)
    front = scene.face.topology.masks["face_region"]
    lo, hi = target.pixels[front].min(axis=0).astype(int), target.pixels[front].max(axis=0).astype(int)
    face = np.zeros(SIZE, bool)
    face[lo[1] : hi[1], lo[0] : hi[0]] = True
    gain = _psnr(result.image, truth, face) - _psnr(photo, truth, face)
    assert gain > 1.5, gain
    assert result.smallest_jacobian > 0


def test_the_background_keeps_its_bits_and_touched_says_where(scene, subject):
    _, photo, synthesiser = subject
    result = synthesiser.draw(scene.view(scene.expression(jawOpen=0.6), (4, 0, 0)))
    same = (result.image == photo).all(axis=2)
    assert same[~result.touched].all()
    assert result.touched.any() and not result.touched[:, :20].any() and not result.touched[:, -20:].any()
    at = result.source_pixels
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    np.testing.assert_array_equal(at[~result.touched], np.stack([x, y], axis=-1)[~result.touched])


def test_a_blink_leaves_hair_and_background_to_the_bit(scene):
    """Nothing breathes: the head's outline stays, so what lies beyond it does."""
    source = scene.view(scene.expression())
    photo = scene.render(source)
    target = scene.view(scene.expression(eyeBlink_L=1.0, eyeBlink_R=1.0))
    touched = PhotoSynthesiser(photo, source, scene.face).draw(target).touched
    front = source.pixels[scene.face.topology.masks["face_region"]]
    (x0, y0), (x1, y1) = front.min(axis=0).astype(int), front.max(axis=0).astype(int)
    assert touched[y0:y1, x0:x1].sum() > 500
    touched[y0:y1, x0:x1] = False
    assert touched.sum() < 100  # pixels of crow's feet beside the temples


def test_golden(scene, subject, golden):
    _, _, synthesiser = subject
    target = scene.view(scene.expression(mouthSmile_L=1.0, mouthSmile_R=1.0, browInnerUp_L=0.7), (9, 3, -4))
    golden("photo_redrawn", synthesiser.draw(target).image[25:265, 40:280])


def test_drawing_twice_is_drawing_once(scene, subject):
    _, _, synthesiser = subject
    target = scene.view(scene.expression(jawOpen=0.6), (10, 0, 0))
    first = synthesiser.draw(target)
    synthesiser.draw(scene.view(scene.expression(), (-10, 0, 0)))
    np.testing.assert_array_equal(first.image, synthesiser.draw(target).image)


def test_a_small_change_changes_little(scene, subject):
    """No popping: the picture goes to the photo as the view goes to the photo's."""
    _, photo, synthesiser = subject
    change = []
    for share in (0.02, 0.1, 0.5):
        target = scene.view(scene.expression(mouthSmile_L=0.3, jawOpen=0.5 * share), (6 * share, 0, 0))
        image = synthesiser.draw(target).image
        change.append(np.abs(image.astype(int) - photo).mean())
    assert 0 < change[0] < change[1] < change[2]
    assert change[0] < 0.15 * change[2]


class _Recorder:
    """Stands in for the inner face: records calls, paints one pixel."""

    def __init__(self):
        self.calls = []

    def paint(self, image, target, gaze=None, touched=None, front=None):
        self.calls.append(gaze)
        image[0, 0] = 255 - image[0, 0]
        touched[0, 0] = True


def test_the_inner_face_is_painted_where_something_changes(scene, subject):
    source, photo, _ = subject
    recorder = _Recorder()
    synthesiser = PhotoSynthesiser(photo, source, scene.face, inner=recorder)
    assert not synthesiser.draw(source).touched.any() and recorder.calls == []
    gaze = np.zeros((2, 2))
    looked = synthesiser.draw(source, gaze)
    assert recorder.calls[0] is gaze and looked.touched.sum() == 1
    moved = synthesiser.draw(scene.view(scene.expression(jawOpen=0.5)))
    assert recorder.calls[1] is None and moved.touched[0, 0]


def test_a_short_reach_changes_less_of_the_photo(scene, subject):
    source, photo, synthesiser = subject
    target = scene.view(scene.expression(mouthSmile_L=0.3, jawOpen=0.1), (1, 0, 0))
    near = PhotoSynthesiser(photo, source, scene.face, SynthesisOptions(hair=0.05, reach=0.1)).draw(target)
    assert 0 < near.touched.sum() < 0.8 * synthesiser.draw(target).touched.sum()
    assert near.smallest_jacobian > 0


@pytest.mark.parametrize("name", ["hair", "reach", "neck", "outline"])
@pytest.mark.parametrize("value", [0.0, -1.0, 300.0, float("nan")])
def test_options_must_be_in_range(name, value):
    with pytest.raises(ValueRangeError, match=name):
        SynthesisOptions(**{name: value})


def test_a_firm_outline_moves_the_silhouette_farther(scene, subject):
    """The far contour is where the mesh's is, not where the surroundings hold it."""
    source, photo, _ = subject
    wide = MeshView(
        (source.pixels - source.pixels.mean(axis=0)) * [1.06, 1.0] + source.pixels.mean(axis=0), source.camera_vertices
    )
    moved = []
    for outline in (1.0, 16.0):
        drawn = PhotoSynthesiser(photo, source, scene.face, SynthesisOptions(outline=outline)).draw(wide)
        moved.append(np.abs(drawn.image.astype(int) - photo).sum())
    assert moved[1] > 1.02 * moved[0]


def test_shapes_must_match(scene, subject):
    source, photo, synthesiser = subject
    with pytest.raises(ShapeError):
        PhotoSynthesiser(photo[..., 0], source, scene.face)
    short = MeshView(source.pixels[:-1], source.camera_vertices[:-1])
    with pytest.raises(ShapeError):
        PhotoSynthesiser(photo, short, scene.face)
    with pytest.raises(ShapeError):
        synthesiser.draw(short)


def test_source_pixels_without_a_map():
    image = np.zeros((2, 3, 3), np.uint8)
    at = Synthesis(image, 1.0, None, np.zeros((2, 3), bool)).source_pixels
    np.testing.assert_array_equal(at[1, 2], (2, 1))
