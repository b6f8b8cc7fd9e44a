import numpy as np
import pytest

from facewright.evaluation.component import SYMMETRIC
from facewright.evaluation.smaller_models import mixing_of, smaller_trackers
from facewright.faces.simulate import simulate_population


def test_sums_of_shapes():
    mixing = mixing_of({"both": ("b", "c"), "one": ("a",)}, ("a", "b", "c", "d"))
    np.testing.assert_array_equal(mixing, [[0, 1, 1, 0], [1, 0, 0, 0]])


def test_models_of_fewer_people_and_expressions(builtin_face, rng):
    skin = builtin_face.skin()
    tensor = simulate_population(skin, 18, rng)
    trackers = smaller_trackers(skin, tensor, 16)
    assert set(trackers) == {"15x47", "18x10"}
    few, plain = trackers["15x47"], trackers["18x10"]
    assert few.fitter.model.expression_names[1:] == skin.blendshape_names
    assert plain.fitter.model.expression_names == ("neutral", *SYMMETRIC)
    # a smile of the plain model is a smile of both sides, and is drawn as their sum
    B = len(SYMMETRIC)
    smile = list(SYMMETRIC).index("mouthSmile")
    weights = np.zeros((2, B))
    weights[1, smile] = 0.5
    found = plain.coefficients(weights)
    names = skin.blendshape_names
    assert found.shape == (2, 46) and found[0].sum() == 0.0
    assert {names[i] for i in np.flatnonzero(found[1])} == {"mouthSmile_L", "mouthSmile_R"}
    rows = [1 + names.index(name) for name in SYMMETRIC["mouthSmile"]]
    wanted = (tensor[:, rows] - tensor[:, :1]).sum(axis=1).mean(axis=0)
    model = plain.fitter.model
    mean = model.blendshapes(model.identity_mean).deltas[smile]
    assert np.sqrt(((mean - wanted) ** 2).sum(axis=1).mean()) < 0.1 * np.sqrt((wanted**2).sum(axis=1).mean())
    # the detector's response to it is that to the two together
    points, whole = plain.fitter.dense.points, few.fitter.dense.points
    both = whole.expression_response[[names.index(name) for name in SYMMETRIC["mouthSmile"]]].sum(axis=0)
    np.testing.assert_allclose(points.expression_response[smile], both)
    np.testing.assert_allclose(few.coefficients(np.full((1, 46), 0.25)), 0.25)


def test_coefficients_stay_within_one(builtin_face, rng):
    tracker = smaller_trackers(builtin_face.skin(), simulate_population(builtin_face.skin(), 16, rng), 16)["16x10"]
    assert tracker.coefficients(np.full((1, len(SYMMETRIC)), 2.0)).max() == pytest.approx(1.0)
