from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from facewright.apps.edit_photo import EditRequest, edit_photo, edit_subject, list_attributes
from facewright.apps.edited_view import edited_view, teeth_with_lips
from facewright.apps.photo_subject import open_photo_subject
from facewright.errors import MissingExtraError, ValueRangeError
from facewright.evaluation.simulated_edit import simulate_scene
from facewright.faces.attribute_editor import AttributeEditor
from facewright.landmarks.files import write_landmarks
from facewright.models.bilinear import fit_bilinear
from facewright.models.bilinear_store import save_bilinear

PEOPLE = 24


@pytest.fixture(scope="module")
def model(builtin_face):
    """People who are mixtures of the face's modes, labelled with an age that has no meaning, and a sex."""
    face, rng = builtin_face, np.random.default_rng(3)
    modes = rng.normal(size=(PEOPLE, len(face.identity_basis)))
    neutrals = (face.mean_shape + np.tensordot(modes, face.identity_basis, 1)).astype(np.float32)
    tensor = neutrals[:, None] + np.concatenate([0 * face.blendshape_deltas[:1], face.blendshape_deltas])
    model = fit_bilinear(
        tensor, 20, 12, topology=face.topology, expression_names=("neutral", *face.blendshape_names),
        provenance={"face": "builtin"},
    )  # fmt: skip
    return replace(model, labels={"sex": ("female", "male") * (PEOPLE // 2)})


@pytest.fixture(scope="module")
def scene(builtin_face):
    return simulate_scene(builtin_face, np.random.default_rng(11))


@pytest.fixture(scope="module")
def photo(scene):
    return scene.draw()[0]


@pytest.fixture(scope="module")
def landmarks(scene):
    return scene.landmarks(0.5, np.random.default_rng(0))


@pytest.fixture(autouse=True)
def no_detector(monkeypatch):
    """The same pictures are found with and without MediaPipe."""

    def absent(*args, **options):
        raise MissingExtraError("no detector in this test")

    monkeypatch.setattr("facewright.landmarks.detector.open_detector", absent)


@pytest.fixture(scope="module")
def editor(model):
    return AttributeEditor.of_model(model)


@pytest.fixture
def subject(model, photo, landmarks):
    return open_photo_subject(photo, model, landmarks=landmarks)


@pytest.fixture
def files(tmp_path, model, photo, landmarks):
    """A photo with a transparent corner, its landmarks, the model."""
    alpha = np.full(photo.shape[:2], 255, np.uint8)
    alpha[:40, :40] = 0
    Image.fromarray(np.dstack([photo, alpha])).save(tmp_path / "photo.png")
    write_landmarks(tmp_path / "points.json", landmarks)
    save_bilinear(model, tmp_path / "m.fwbm", max_error_mm=0.5)
    return {"photo": tmp_path / "photo.png", "landmarks": tmp_path / "points.json", "model": tmp_path / "m.fwbm"}


def test_a_wider_mouth_is_wider_in_the_picture(subject, editor):
    edit, drawn = edit_subject(subject, editor, {"mouth width": 2.0})
    assert edit.change["mouth width"] == pytest.approx(2.0, abs=0.05)
    ids = subject.face.topology.landmarks["fw74"]
    before, after = subject.source.pixels[ids], edited_view(subject, edit.weights).pixels[ids]
    width = [np.linalg.norm(p[60] - p[54]) for p in (before, after)]
    scale = np.linalg.norm(before[35] - before[27]) / np.linalg.norm(
        subject.source.camera_vertices[ids[35]] - subject.source.camera_vertices[ids[27]]
    )
    asked = 2.0 * editor.standard_deviation[editor.names.index("mouth width")] * scale
    assert width[1] - width[0] == pytest.approx(asked, rel=0.35)  # the expression scales with the person
    assert drawn.smallest_jacobian > 0
    assert drawn.image.shape == subject.photo.shape
    different = (drawn.image != subject.photo).any(axis=2)
    assert 0.01 < different.mean() < 0.9
    corner = drawn.image[:16, :16]
    np.testing.assert_array_equal(corner, subject.photo[:16, :16])


def test_no_change_gives_the_photo_back(subject, editor):
    edit, drawn = edit_subject(subject, editor, {"jaw width": 0.0})
    np.testing.assert_allclose(edit.weights, subject.fit.identity_weights, atol=1e-9)
    np.testing.assert_array_equal(drawn.image, subject.photo)


def test_eyes_stay_where_they_are(subject, editor):
    weights = editor.change(subject.fit.identity_weights, {"face length": 2.0}).weights
    ids = subject.face.topology.landmarks["fw74"]
    moved = edited_view(subject, weights).pixels[ids] - subject.source.pixels[ids]
    size = np.linalg.norm(moved, axis=1) / subject.fit.landmarks.interocular_distance()
    assert size[[27, 31, 35, 39]].mean() < 0.04 < 0.1 < size[7]


def test_teeth_keep_their_place_between_the_lips(builtin_face, rng):
    topology, old = builtin_face.topology, builtin_face.mean_shape.astype(float)
    assert np.abs(teeth_with_lips(old, old, topology) - old).max() < 1e-9
    new = old.copy()
    lips = np.concatenate([topology.masks["lip_contact_upper"], topology.masks["lip_contact_lower"]])
    new[lips] = old[lips] * [1.2, 1.0, 1.0] + [0.0, -5.0, 1.0]  # wider and lower
    moved = teeth_with_lips(new, old, topology)
    upper = slice(*topology.parts["teeth_upper"])
    change = moved[upper] - old[upper]
    np.testing.assert_allclose(change[:, 1], -5.0, atol=0.3)
    assert np.ptp(moved[upper, 0]) / np.ptp(old[upper, 0]) == pytest.approx(1.2, abs=0.03)
    others = np.ones(len(old), dtype=bool)
    for part in ("teeth_upper", "teeth_lower"):
        others[slice(*topology.parts[part])] = False
    np.testing.assert_array_equal(moved[others], new[others])
    bare = replace(topology, masks={})
    np.testing.assert_array_equal(teeth_with_lips(new, old, bare), new)


def test_files(files, tmp_path, photo, monkeypatch):
    monkeypatch.setattr("facewright.apps.edit_sheet.STEPS", (0.0, 2.0))
    out, sheet = tmp_path / "out.png", tmp_path / "sheet.png"
    result = edit_photo(EditRequest(deviations={"chin": 1.5, "female": 1.0}, out=out, sheet=sheet, **files))
    written = np.asarray(Image.open(out))
    assert written.shape == (*photo.shape[:2], 4)
    np.testing.assert_array_equal(written[..., :3], result.image)
    assert (written[:40, :40, 3] == 0).all() and (written[60:, 60:, 3] == 255).all()
    assert result.paths == {"picture": out, "sheet": sheet}
    width, height = Image.open(sheet).size
    assert width > 2 * 256 and height > 16 * 256  # 14 attributes and two sexes, two steps each
    assert result.edit.change["chin height"] == pytest.approx(1.5, abs=0.05)


def test_the_list(files):
    summaries = {summary.name: summary for summary in list_attributes(files["model"])}
    assert len(summaries) == 16
    face = summaries["face length"]
    assert face.unit == "mm" and 100 < face.mean < 130 and face.n_people == PEOPLE
    assert set(face.also) == set(list(summaries)[:14]) - {"face length"}
    female = summaries["sex: female"]
    assert female.mean == 0.5 and female.unit == ""


def test_mistakes_are_told_before_the_work(files, tmp_path):
    absent = files | {"photo": tmp_path / "absent.png"}
    out = tmp_path / "out.png"
    with pytest.raises(ValueRangeError, match="did you mean 'mouth width'"):
        edit_photo(EditRequest(deviations={"mouth widht": 1.0}, out=out, **absent))
    with pytest.raises(ValueRangeError, match="-4 to 4 standard deviations, got 7"):
        edit_photo(EditRequest(deviations={"mouth width": 7.0}, out=out, **absent))
    with pytest.raises(ValueRangeError, match="must end in"):
        edit_photo(EditRequest(deviations={"mouth width": 1.0}, out=tmp_path / "out.doc", **absent))
    assert not out.exists()


def test_refuses_requests(files, tmp_path):
    out = tmp_path / "out.png"
    with pytest.raises(ValueRangeError, match="out or sheet must be given"):
        EditRequest(deviations={"chin": 1.0}, **files)
    with pytest.raises(ValueRangeError, match="at least one attribute"):
        EditRequest(out=out, **files)
    with pytest.raises(ValueRangeError, match="another file than the photo"):
        EditRequest(deviations={"chin": 1.0}, out=files["photo"], **files)
    with pytest.raises(ValueRangeError, match="two files"):
        EditRequest(deviations={"chin": 1.0}, out=out, sheet=out, **files)
