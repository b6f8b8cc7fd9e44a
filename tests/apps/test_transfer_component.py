"""A face component carried from one photo into another."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from facewright.apps.photo_subject import complete_subject
from facewright.apps.transfer_component import (
    TransferRequest,
    angle_between,
    is_grey,
    transfer_between,
    transfer_component,
    unify_subjects,
)
from facewright.camera.pinhole import RigidMotion
from facewright.errors import TopologyError, ValueRangeError
from facewright.evaluation.simulated_pair import simulate_pair
from facewright.faces.simulate import simulate_person, simulate_population
from facewright.fitting.image import PhotoFitter
from facewright.imaging.component_mask import COMPONENTS
from facewright.io.image import PhotoFile
from facewright.models.bilinear import fit_bilinear


@pytest.fixture(scope="module")
def model(builtin_face):
    tensor = simulate_population(builtin_face, 9, np.random.default_rng(1))
    names = ("neutral", *builtin_face.blendshape_names)
    return fit_bilinear(tensor, 8, 47, topology=builtin_face.topology, expression_names=names)


@pytest.fixture(scope="module")
def pair(builtin_face):
    rng = np.random.default_rng(4)
    return simulate_pair(builtin_face, simulate_person(builtin_face, rng), "mouth", rng)


@pytest.fixture(scope="module")
def subjects(model, pair, builtin_face):
    fitter = PhotoFitter(model)
    return [subject_of(fitter, shot, builtin_face) for shot in (pair.target, pair.reference)]


def subject_of(fitter, shot, face, image=None):
    picture = shot.image if image is None else image
    fit = fitter.fit(shot.landmarks, picture.shape[:2])
    return complete_subject(PhotoFile.of(picture), fit, face, shot.landmarks)


def test_two_photos_of_one_person_get_one_identity(subjects):
    target, reference, remarks = unify_subjects(*subjects)
    assert remarks == ()
    np.testing.assert_array_equal(target.fit.identity_weights, reference.fit.identity_weights)
    assert np.abs(subjects[0].fit.identity_weights - subjects[1].fit.identity_weights).max() > 1e-3


def test_two_people_are_told(builtin_face, model, subjects, pair):
    other = pair.reference
    # a face half as wide again is certainly another person's
    points = other.landmarks.points.copy()
    points[:, 0] = 256 + 1.5 * (points[:, 0] - 256)
    other = replace(other, landmarks=replace(other.landmarks, points=points))
    stranger = subject_of(PhotoFitter(model), other, builtin_face)
    target, reference, remarks = unify_subjects(subjects[0], stranger)
    assert len(remarks) == 1 and "two people" in remarks[0]
    assert target is subjects[0] and reference is stranger
    result = transfer_between(target, reference, "mouth")  # and still works
    assert result.mask.sum() > 500


@pytest.mark.parametrize("component", COMPONENTS)
def test_a_photos_own_component_changes_nothing_to_speak_of(subjects, component):
    own = subjects[0]
    result = transfer_between(own, own, component)
    np.testing.assert_array_equal(result.warped, own.photo)
    difference = np.abs(result.image.astype(int) - own.photo)
    assert result.mask.sum() > 300
    assert difference.max() <= 3 and difference[result.mask].mean() < 0.6


def test_the_mouth_comes_over_and_the_rest_stays(subjects, pair):
    target, reference, _ = unify_subjects(*subjects)
    result = transfer_between(target, reference, "mouth")
    np.testing.assert_array_equal(result.image[~result.touched], target.photo[~result.touched])
    assert result.mask.sum() > 1000 and (result.touched | ~result.mask).all()
    region = pair.region

    def error(image):
        return np.abs(image[region].astype(int) - pair.truth[region]).mean()

    assert error(result.image) < 0.7 * error(pair.target.image)
    names = list(target.rig.names)
    assert result.weights[names.index("jawOpen")] == reference.weights[names.index("jawOpen")]
    assert result.weights[names.index("browDown_L")] == target.weights[names.index("browDown_L")]


def wrinkled(subject):
    """Return the person with a wrinkled nose."""
    weights = subject.weights.copy()
    weights[[k for k, name in enumerate(subject.rig.names) if name.startswith("noseSneer")]] += 0.15
    return replace(subject, weights=weights)


def test_a_wrinkled_nose_leaves_mouth_and_eyes(subjects, builtin_face):
    own = subjects[0]
    result = transfer_between(own, wrinkled(own), "nose")
    change = np.abs(result.image.astype(int) - own.photo).max(axis=2)
    masks = builtin_face.topology.masks

    def changed(name):
        x, y = own.source.pixels[masks[name]].round().astype(int).T
        return change[y, x]

    assert result.mask.any() and changed("nose").mean() > 1
    for name in ("lips", "eyelid_upper_left", "eyelid_upper_right", "lash_line_left"):
        assert changed(name).mean() < 3.0, name


def test_a_nose_seen_from_another_side_moves_only(subjects):
    own = subjects[0]
    motion = own.camera_from_model
    turn = Rotation.from_euler("y", 25.0, degrees=True).as_matrix()
    centre = own.source.camera_vertices.mean(axis=0)
    turned = RigidMotion(turn @ motion.rotation, turn @ (motion.translation - centre) + centre)
    aside = replace(wrinkled(own), fit=replace(own.fit, camera_from_model=turned))
    assert angle_between(own, aside) == pytest.approx(25.0, abs=1.0)
    result = transfer_between(own, aside, "nose")
    assert not result.mask.any() and "another side (25 degrees" in " ".join(result.remarks)
    np.testing.assert_array_equal(result.image, result.warped)
    assert (result.image != own.photo).any()


def test_a_target_without_colours_keeps_none(builtin_face, model, pair, subjects):
    grey = np.repeat(pair.target.image.mean(axis=2).astype(np.uint8)[..., None], 3, axis=2)
    assert is_grey(grey) and not is_grey(pair.target.image)
    target = subject_of(PhotoFitter(model), pair.target, builtin_face, grey)
    result = transfer_between(target, subjects[1], "mouth")
    assert is_grey(result.image)
    back = transfer_between(subjects[0], replace(subjects[1], photo=grey), "mouth")
    assert any("no colours" in remark for remark in back.remarks)


def test_a_component_turned_away_is_refused(subjects):
    target, reference = subjects
    outside = replace(reference, photo=reference.photo[:150])  # ends above the mouth
    with pytest.raises(ValueRangeError, match="must show the mouth"):
        transfer_between(target, outside, "mouth")


def test_bad_requests_are_refused(tmp_path, subjects, ict_face):
    with pytest.raises(ValueRangeError, match="component"):
        TransferRequest(tmp_path / "a.jpg", tmp_path / "b.jpg", "ears", tmp_path / "c.png")
    with pytest.raises(ValueRangeError, match="must end in"):
        TransferRequest(tmp_path / "a.jpg", tmp_path / "b.jpg", "mouth", tmp_path / "c.txt")
    with pytest.raises(ValueRangeError, match="component"):
        transfer_between(*subjects, "ears")
    with pytest.raises(TopologyError, match="one face"):
        transfer_between(subjects[0], replace(subjects[1], face=ict_face), "mouth")


@pytest.mark.landmarks
@pytest.mark.slow
def test_photos_in_a_picture_out(test_data, tmp_path, model, builtin_face):
    pytest.importorskip("mediapipe")
    from facewright.io.image import read_image
    from facewright.models.bilinear_store import save_bilinear

    path = tmp_path / "model.fwbm"
    save_bilinear(replace(model, provenance={"face": "builtin"}), path)
    photos = test_data / "photos"
    stages = []
    request = TransferRequest(photos / "obama3.jpg", photos / "obama.jpg", "mouth", tmp_path / "smile.png", model=path)
    result = transfer_component(request, lambda *stage: stages.append(stage))
    assert stages[-1][1] == stages[-1][2]
    before, after = read_image(photos / "obama3.jpg"), read_image(tmp_path / "smile.png")
    np.testing.assert_array_equal(after, result.image)
    np.testing.assert_array_equal(after[~result.touched], before[~result.touched])
    assert result.touched.mean() < 0.5 and "two people" not in " ".join(result.remarks)
    # teeth are seen: the brightest of what came over is far brighter than lips
    assert np.percentile(after[result.mask].mean(axis=1), 97) > np.percentile(before[result.mask].mean(axis=1), 97) + 25
