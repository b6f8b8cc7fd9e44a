from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from facewright.apps.photo_landmarks import MAX_YAW
from facewright.apps.photo_subject import open_photo_subject
from facewright.camera.pinhole import RigidMotion
from facewright.camera.rotation import rotation_from_head_angles
from facewright.errors import DegenerateError, MissingFaceError, NoFaceError, ShapeError, ValueRangeError
from facewright.landmarks.points import Landmarks
from facewright.landmarks.scheme import load_scheme


def people(face, shapes_of, n_identity=8, n_expression=20):
    """A small model of people who are mixtures of a face's modes."""
    from facewright.models.bilinear import fit_bilinear

    rng = np.random.default_rng(3)
    neutrals = face.mean_shape + np.tensordot(rng.normal(size=(10, len(face.identity_basis))), face.identity_basis, 1)
    shapes = np.concatenate([np.zeros((1, *face.mean_shape.shape)), face.blendshape_deltas])
    tensor = (neutrals[:, None] + rng.uniform(0.8, 1.2, (10, 47, 1, 1)) * shapes).astype(np.float32)
    return fit_bilinear(
        tensor, n_identity, n_expression, topology=face.topology,
        expression_names=("neutral", *face.blendshape_names), provenance={"face": shapes_of},
    )  # fmt: skip


@pytest.fixture(scope="module")
def whole_model(builtin_face):
    return people(builtin_face, "builtin")


@pytest.fixture(scope="module")
def skin_model(builtin_face):
    return people(builtin_face.skin(), "builtin")


@pytest.fixture(scope="module")
def scene(builtin_face):
    """A simulated person's true landmarks, on a picture of noise: no detector sees a face in it."""
    from facewright.evaluation.simulated_photo import simulate_photo

    photo = simulate_photo(builtin_face, np.random.default_rng(3))
    noise = np.random.default_rng(4).integers(0, 255, (*photo.image_size, 3)).astype(np.uint8)
    return SimpleNamespace(picture=noise, landmarks=photo.landmarks, truth=photo)


class Finds:
    """A detector that finds what it was given."""

    def __init__(self, *faces):
        self.faces = list(faces)
        self.sizes = []

    def detect(self, image):
        self.sizes.append(image.shape)
        return self.faces

    def __enter__(self):
        return self

    def __exit__(self, *error):
        pass


def opened(scene, model, *faces, picture=None, **options):
    return open_photo_subject(
        scene.picture if picture is None else picture, model, detector=Finds(*(faces or [scene.landmarks])), **options
    )


@pytest.fixture(scope="module", params=["whole_model", "skin_model"])
def subject(request, scene):
    return opened(scene, request.getfixturevalue(request.param))


def test_has_all_parts_and_meets_the_landmarks(subject, scene, builtin_face):
    V = builtin_face.topology.n_vertices
    assert subject.face is builtin_face
    assert subject.rig.neutral.shape == (V, 3) and subject.rig.deltas.shape == (46, V, 3)
    assert subject.weights.shape == (46,) and subject.gaze.shape == (2, 2)
    ids = builtin_face.topology.landmarks["fw74"][15:]
    away = np.linalg.norm(subject.source.pixels[ids] - scene.landmarks.points[15:], axis=1)
    iod = scene.landmarks.interocular_distance()
    assert away.mean() < 0.005 * iod and away.max() < 0.03 * iod
    assert subject.photo.shape == scene.picture.shape and subject.alpha is None


def test_no_change_is_the_source_to_the_last_bit(subject):
    same = subject.vertices(subject.fit.identity_weights, subject.weights, subject.gaze)
    view = subject.view(same, subject.camera_from_model)
    assert np.array_equal(view.pixels, subject.source.pixels)
    assert np.array_equal(view.camera_vertices, subject.source.camera_vertices)


def test_another_identity_moves_all_parts_together(subject, builtin_face):
    model = subject.fit.model
    other = subject.fit.identity_weights + 0.5 * np.sqrt(np.diag(model.identity_covariance))
    moved = subject.vertices(other) - subject.vertices()
    n = builtin_face.n_skin
    u0 = model.expression_weights[0]
    expected = (model.synthesise(other, u0) - model.synthesise(subject.fit.identity_weights, u0))[:n]
    lids = np.concatenate([builtin_face.topology.masks[f"eyelid_upper_{side}"] for side in ("left", "right")])
    still = np.setdiff1d(builtin_face.topology.masks["lips"], lids)
    np.testing.assert_allclose(moved[still], expected[still], atol=1e-3)
    for side in ("left", "right"):
        ball = moved[builtin_face.topology.part_slice(f"eyeball_{side}")].mean(axis=0)
        lids = moved[builtin_face.topology.masks[f"eyelid_upper_{side}"]].mean(axis=0)
        assert np.linalg.norm(ball - lids) < 2.5  # millimetres; the eye stays in its socket


def test_another_identity_keeps_the_mouth_and_closed_eyes_as_they_are(subject, builtin_face):
    other = subject.fit.identity_weights + np.sqrt(np.diag(subject.fit.model.identity_covariance))
    weights = subject.weights.copy()
    for name in ("eyeBlink_L", "eyeBlink_R"):
        weights[subject.rig.names.index(name)] = 1.0
    masks = builtin_face.topology.masks

    def gaps(vertices, upper, lower):
        return (vertices[masks[upper]] - vertices[masks[lower]])[:, 1]

    before, after = subject.vertices(weights=weights), subject.vertices(other, weights)
    rest, new_rest = subject.vertices(weights=np.zeros(46)), subject.vertices(other, np.zeros(46))
    lips = ("lip_contact_upper", "lip_contact_lower")
    own = gaps(new_rest, *lips) - gaps(rest, *lips)
    np.testing.assert_allclose(gaps(after, *lips), gaps(before, *lips) + own, atol=1e-6)
    for side in ("left", "right"):
        lids = (f"lid_contact_upper_{side}", f"lid_contact_lower_{side}")
        share = gaps(new_rest, *lids) / gaps(rest, *lids)
        np.testing.assert_allclose(gaps(after, *lids), gaps(before, *lids) * share, atol=0.1)


def test_another_expression_and_gaze(subject, builtin_face):
    weights = np.zeros(46)
    weights[subject.rig.names.index("jawOpen")] = 1.0
    moved = subject.vertices(weights=weights) - subject.vertices(weights=np.zeros(46))
    teeth = moved[builtin_face.topology.part_slice("teeth_lower")]
    upper = moved[builtin_face.topology.part_slice("teeth_upper")]
    assert teeth[:, 1].mean() < -8 and np.abs(upper).max() < 0.1
    aside = subject.vertices(gaze=subject.gaze + [0.3, 0.0]) - subject.vertices()
    still = np.delete(aside, np.r_[builtin_face.topology.part_slice("eyeball_left", "eyeball_right")], axis=0)
    assert not still.any()
    assert aside[builtin_face.topology.masks["iris_left"], 0].mean() > 2.0


def test_a_blink_and_raised_brows_leave_skull_ears_and_neck_exactly_still(subject, builtin_face):
    """The small model's shapes move everything: what is far from the eyes is the noise of its compression."""
    mean, n = builtin_face.mean_shape, builtin_face.n_skin
    front = mean[builtin_face.topology.masks["face_region"]]
    beyond = np.linalg.norm(mean[:n, None] - front[None], axis=2).min(axis=1) > 10.0
    rest = subject.vertices(weights=np.zeros(46))
    for prefix in ("eyeBlink", "browInnerUp", "browOuterUp", "eyeWide"):
        weights = np.array([float(name.startswith(prefix)) for name in subject.rig.names])
        moved = np.abs(subject.vertices(weights=weights) - rest)[:n]
        assert moved.max() > 0.5
        assert not moved[beyond].any()
    noise = np.abs(subject.fit.rig.deltas[subject.rig.names.index("eyeBlink_L"), :n][beyond])
    assert noise.max() > 0  # else this could not fail


def test_lids_and_lips_meet_as_in_the_model(whole_model, scene, builtin_face):
    subject = opened(scene, whole_model)
    masks, raw = builtin_face.topology.masks, subject.fit.rig
    for name, what in (
        ("eyeBlink_L", "lid_contact_{}_left"), ("eyeBlink_R", "lid_contact_{}_right"), ("jawOpen", "lip_contact_{}"),
        ("mouthSmile_L", "lip_contact_{}"), ("mouthPucker", "lip_contact_{}"), ("mouthClose", "lip_contact_{}"),
    ):  # fmt: skip
        upper, lower = masks[what.format("upper")], masks[what.format("lower")]
        gap, was = (v[upper] - v[lower] for v in (subject.rig.shape(name), raw.shape(name)))
        np.testing.assert_allclose(gap, was, atol=0.15)  # millimetres


def test_residual_turns_with_the_head(subject, builtin_face):
    motion = subject.camera_from_model
    turn = rotation_from_head_angles(0, 0, 40) @ rotation_from_head_angles(0, 0, 0).T
    rolled = RigidMotion(turn @ motion.rotation, turn @ motion.translation)
    a, b = subject.source, subject.view(subject.vertices(), rolled)
    centre = np.array([subject.intrinsics.centre_x, subject.intrinsics.centre_y])
    expected = (a.pixels - centre) @ turn[:2, :2].T + centre  # a turn about the optical axis turns the picture
    np.testing.assert_allclose(b.pixels, expected, atol=1e-6)


def test_refuses_other_shapes(subject):
    with pytest.raises(ShapeError):
        subject.view(np.zeros((10, 3)))
    with pytest.raises(ShapeError):
        subject.vertices(np.zeros(3))
    with pytest.raises(ShapeError):
        subject.vertices(weights=np.zeros(3))


def test_no_face(scene, whole_model):
    with pytest.raises(NoFaceError, match="must show a face"):
        open_photo_subject(scene.picture, whole_model, detector=Finds())


def test_several_faces_the_largest_is_used_and_said(scene, whole_model):
    small = Landmarks("fw74", 0.5 * scene.landmarks.points + 300.0, scene.landmarks.confidence)
    first = opened(scene, whole_model, scene.landmarks, small)
    second = opened(scene, whole_model, scene.landmarks, small, face_index=1)
    assert "2 faces were found, the largest is used" in first.remarks[0]
    assert np.linalg.norm(first.source.pixels.mean(0) - second.source.pixels.mean(0)) > 100
    with pytest.raises(NoFaceError, match=r"face 2 \(0 is the largest\), the detector found 2 faces"):
        opened(scene, whole_model, scene.landmarks, small, face_index=2)
    with pytest.raises(ValueRangeError, match="face_index"):
        opened(scene, whole_model, face_index=-1)


def test_a_profile_is_beyond_reach(builtin_face, whole_model, scene):
    from facewright.apps.true_landmarks import true_landmarks
    from facewright.camera.pinhole import Intrinsics

    skin = builtin_face.skin()
    camera = Intrinsics.for_image((640, 640), 1400.0)
    rotation = rotation_from_head_angles(75, 0, 0)
    motion = RigidMotion(rotation, np.array([0, 0, 900.0]) - rotation @ [0, 0, 40.0])
    points = true_landmarks(skin.topology, skin.mean_shape, skin.mean_shape, camera, motion)
    with pytest.raises(ValueRangeError, match=f"sideways by at most {MAX_YAW:.0f} degrees, got 7"):
        opened(scene, whole_model, points)


def test_points_that_make_no_face(scene, whole_model, rng):
    with pytest.raises((ValueRangeError, DegenerateError)):
        opened(scene, whole_model, Landmarks("fw74", rng.uniform(0, 640, (74, 2))))
    with pytest.raises(DegenerateError):
        opened(scene, whole_model, Landmarks("fw74", np.full((74, 2), 100.0)))


def test_points_beyond_the_picture_are_refused(scene, whole_model):
    far = Landmarks("fw74", scene.landmarks.points + 5000.0)
    with pytest.raises(ValueRangeError, match="must lie in the picture"):
        opened(scene, whole_model, far)


def test_given_points_win_over_found_ones(scene, whole_model):
    points = scene.landmarks.points.copy()
    confidence = np.zeros(74)
    points[57] += [0.0, -4.0]
    confidence[57] = 1.0
    plain = opened(scene, whole_model)
    subject = opened(scene, whole_model, landmarks=Landmarks("fw74", points, confidence))
    np.testing.assert_array_equal(subject.landmarks.points[57], points[57])
    np.testing.assert_array_equal(np.delete(subject.landmarks.points, 57, 0), np.delete(plain.landmarks.points, 57, 0))


def test_large_pictures_are_searched_small(scene, whole_model):
    """12,000 pixels across: the detector sees a copy of at most 2,000, points come back at full size."""
    big = np.zeros((9000, 12000, 3), np.uint8)
    detector = Finds(scene.landmarks)
    subject = open_photo_subject(big, whole_model, detector=detector)
    assert max(detector.sizes[0][:2]) <= 2000 and len(detector.sizes) == 1
    # a small copy of factor 6: pixel centres (x + 0.5) / 6 - 0.5
    np.testing.assert_allclose((subject.landmarks.points + 0.5) / 6 - 0.5, scene.landmarks.points, atol=1e-9)
    assert subject.photo is big  # no copy of 324 MB


def test_transparency_is_kept_and_the_detector_sees_white(scene, whole_model, tmp_path):
    alpha = np.full(scene.picture.shape[:2], 255, np.uint8)
    alpha[:40] = 0
    Image.fromarray(np.dstack([scene.picture, alpha])).save(tmp_path / "a.png")
    seen = []

    class Watches(Finds):
        def detect(self, image):
            seen.append(image)
            return self.faces

    subject = open_photo_subject(tmp_path / "a.png", whole_model, detector=Watches(scene.landmarks))
    assert (seen[0][:40] == 255).all()
    np.testing.assert_array_equal(subject.photo, scene.picture)
    np.testing.assert_array_equal(subject.alpha, alpha)


@pytest.mark.parametrize("kind", ["grey", "16", "cmyk", "gif", "float"])
def test_unusual_files_work(kind, scene, whole_model, tmp_path):
    grey = Image.fromarray(scene.picture).convert("L")
    path = tmp_path / {"gif": "a.gif", "cmyk": "a.jpg", "float": "a.tif"}.get(kind, "a.png")
    if kind == "grey":
        grey.save(path)
    elif kind == "16":
        Image.fromarray(np.asarray(grey).astype(np.uint16) * 257).save(path)
    elif kind == "cmyk":
        Image.fromarray(scene.picture).convert("CMYK").save(path)
    elif kind == "float":
        Image.fromarray((np.asarray(grey) / 255).astype(np.float32)).save(path)
    else:
        grey.save(path, save_all=True, append_images=[Image.fromarray(255 - np.asarray(grey))])
    subject = open_photo_subject(path, whole_model, detector=Finds(scene.landmarks))
    assert subject.photo.shape == scene.picture.shape and subject.photo.dtype == np.uint8
    said = {"16": "8 bits", "cmyk": "CMYK", "gif": "first is used", "float": "8 bits"}.get(kind)
    assert (said is None and not subject.remarks) or said in subject.remarks[0]


def test_a_model_whose_face_is_absent(scene, whole_model, monkeypatch, tmp_path):
    monkeypatch.setenv("FACEWRIGHT_HOME", str(tmp_path))
    with pytest.raises(MissingFaceError, match="must be installed to draw eyes and teeth"):
        opened(scene, replace(whole_model, provenance={"face": "ict"}))
    with pytest.raises(MissingFaceError, match="unknown"):
        opened(scene, replace(whole_model, provenance={}))


def test_a_model_of_another_mesh(scene, whole_model, builtin_face):
    small = people(replace(builtin_face.skin(), topology=builtin_face.skin().topology), "builtin")
    faces = small.topology.faces[:, [1, 2, 0]].copy()
    faces[0] = faces[0][[1, 0, 2]]
    other = replace(small, topology=replace(small.topology, faces=faces))
    with pytest.raises(MissingFaceError, match="build the model again"):
        opened(scene, other)


def test_progress_goes_forward(scene, whole_model):
    calls = []
    opened(scene, whole_model, progress=lambda *a: calls.append(a))
    assert [c[1] for c in calls] == sorted(c[1] for c in calls) and calls[-1][1] == calls[-1][2]


@pytest.fixture(scope="module")
def astronaut():
    pytest.importorskip("mediapipe")
    data = pytest.importorskip("skimage.data")
    return np.ascontiguousarray(data.astronaut())


def opening(subject, size, what):
    """Mask of the pixels at 4 times the size in which the mesh shows no skin, within the detector's polygon's box."""
    from facewright.imaging.rasterise import rasterise

    topology = subject.face.topology
    zoom = 4
    skin = topology.faces < subject.face.n_skin
    pixels = (subject.source.pixels + 0.5) * zoom - 0.5
    shown = rasterise(pixels, subject.source.depth, topology.faces, (size[0] * zoom, size[1] * zoom))
    polygon = subject.landmarks.points[load_scheme("mediapipe478").groups[what]]
    corners = (polygon + 0.5) * zoom
    low, high = corners.min(axis=0).astype(int) - 8, corners.max(axis=0).astype(int) + 9
    inner = ~skin.all(axis=1)[shown.face_index] & shown.covered
    from skimage.draw import polygon2mask

    found = polygon2mask(inner.shape, corners[:, ::-1] - 0.5)
    box = (slice(low[1], high[1]), slice(low[0], high[0]))
    return inner[box], found[box], zoom


@pytest.mark.landmarks
def test_mouth_of_the_mesh_is_the_mouth_of_the_picture(astronaut, whole_model):
    subject = open_photo_subject(astronaut, whole_model)
    assert subject.landmarks.scheme == "mediapipe478"
    inner, found, zoom = opening(subject, astronaut.shape[:2], "inner_mouth")
    differing = (inner != found).sum() / zoom**2
    outline = 2 * np.ptp(np.flatnonzero(found.any(axis=0))) / zoom
    assert differing / outline < 0.5  # pixels, mean distance of the two outlines
    assert np.abs(np.rad2deg(subject.gaze)).max() < 15  # she looks at the camera


@pytest.mark.landmarks
def test_two_people(test_data, whole_model):
    pytest.importorskip("mediapipe")
    path = test_data / "photos" / "two_people.jpg"
    first, second = (open_photo_subject(path, whole_model, face_index=k) for k in (0, 1))
    assert "2 faces were found" in first.remarks[0] and "number 1" in second.remarks[0]
    assert first.landmarks.interocular_distance() > second.landmarks.interocular_distance() * 0.8


@pytest.mark.landmarks
def test_pictures_without_a_face(whole_model, rng):
    pytest.importorskip("mediapipe")
    for size in ((1, 1), (7, 300), (256, 256)):
        with pytest.raises(NoFaceError):
            open_photo_subject(rng.integers(0, 255, (*size, 3)).astype(np.uint8), whole_model)
