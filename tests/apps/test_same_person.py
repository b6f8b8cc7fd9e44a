"""Two photos of one person or of two: patterns of light and dark, and real photos."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from facewright.apps.photo_subject import complete_subject, open_photo_subject
from facewright.apps.same_person import Comparison, compare_people, pattern_correlation
from facewright.apps.transfer_component import unify_subjects
from facewright.evaluation.simulated_pair import simulate_pair
from facewright.faces.simulate import simulate_person, simulate_population
from facewright.fitting.image import PhotoFitter
from facewright.io.image import PhotoFile
from facewright.models.bilinear import fit_bilinear


@pytest.fixture(scope="module")
def model(builtin_face):
    tensor = simulate_population(builtin_face, 16, np.random.default_rng(1))
    names = ("neutral", *builtin_face.blendshape_names)
    provenance = {"face": "builtin"}
    return fit_bilinear(tensor, 15, 47, topology=builtin_face.topology, expression_names=names, provenance=provenance)


@pytest.fixture(scope="module")
def subjects(model, builtin_face):
    """Two photos each of two people."""
    fitter, found = PhotoFitter(model), []
    for seed in (4, 5):
        rng = np.random.default_rng(seed)
        pair = simulate_pair(builtin_face, simulate_person(builtin_face, rng), "mouth", rng)
        for shot in (pair.target, pair.reference):
            fit = fitter.fit(shot.landmarks, shot.image.shape[:2])
            found.append(complete_subject(PhotoFile.of(shot.image), fit, builtin_face, shot.landmarks))
    return found


def test_patterns_of_one_person_are_alike(subjects):
    same = [pattern_correlation(subjects[k], subjects[k + 1]) for k in (0, 2)]
    different = [pattern_correlation(subjects[a], subjects[b]) for a in (0, 1) for b in (2, 3)]
    assert min(same) > max(different)
    assert pattern_correlation(subjects[0], subjects[0]) == pytest.approx(1.0)


def test_exposure_and_tint_change_nothing_to_speak_of(subjects):
    own = subjects[0]
    other = replace(own, photo=np.rint(own.photo * [0.9, 0.75, 0.6]).astype(np.uint8))
    assert pattern_correlation(own, other) > 0.98


def test_without_the_detectors_points_nothing_is_said(subjects):
    assert compare_people(subjects[0], subjects[2]) is None


def test_both_shape_and_pattern_count():
    assert Comparison(0.0, 0.2).two_people and not Comparison(0.0, 0.8).two_people
    assert Comparison(12.0, 0.8).two_people and not Comparison(-12.0, 0.2).two_people


@pytest.mark.landmarks
@pytest.mark.slow
def test_real_photos(model, test_data: Path):
    pytest.importorskip("mediapipe")
    data = pytest.importorskip("skimage.data")
    photos = (test_data / "photos" / "obama.jpg", test_data / "photos" / "obama3.jpg", data.astronaut())
    first, second, stranger = (open_photo_subject(photo, model) for photo in photos)
    assert unify_subjects(first, second)[2] == ()
    for own in (first, second):
        (remark,) = unify_subjects(own, stranger)[2]
        assert "two people" in remark
