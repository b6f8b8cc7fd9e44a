import numpy as np
import pytest

from facewright.errors import ShapeError
from facewright.faces.blendshape_names import BLENDSHAPE_NAMES
from facewright.fitting.energies.coefficient_terms import CoefficientTerms
from facewright.fitting.energies.expression_prior import ExpressionPrior

TERMS = CoefficientTerms.of(BLENDSHAPE_NAMES, ExpressionPrior())


def test_gradient_and_hessian_are_the_energy_s(rng):
    terms = TERMS.with_lids(np.array([0.7, 0.2]))
    beta, h = rng.uniform(0.1, 0.9, 46), 1e-5
    numeric = [(terms.energy(beta + h * e) - terms.energy(beta - h * e)) / (2 * h) for e in np.eye(46)]
    np.testing.assert_allclose(terms.gradient(beta), numeric, atol=1e-5)
    bent = np.array([(terms.gradient(beta + h * e) - terms.gradient(beta - h * e)) / (2 * h) for e in np.eye(46)])
    np.testing.assert_allclose(terms.hessian, bent, atol=1e-5)


def test_sides_that_act_alike_cost_less():
    both, one = np.zeros(46), np.zeros(46)
    smile = [BLENDSHAPE_NAMES.index(f"mouthSmile_{s}") for s in "LR"]
    both[smile], one[smile[0]] = 0.5, 1.0
    assert TERMS.energy(both) < TERMS.energy(one)


def test_seen_lids_ask_for_blinks():
    shut = TERMS.with_lids(np.array([1.0, 0.0]))
    right, left = (BLENDSHAPE_NAMES.index(f"eyeBlink_{s}") for s in "RL")
    slope = shut.gradient(np.zeros(46))
    assert slope[right] < -10 and slope[left] > 0


def test_shapes_that_are_missing_are_left_out():
    few = CoefficientTerms.of(("jawOpen", "eyeBlink_L"), ExpressionPrior())
    assert not few.lid_rows[0].any() and few.lid_rows[1].tolist() == [0.0, 1.0]
    assert not few.coupling.any()
    with pytest.raises(ShapeError):
        few.with_lids(np.zeros(3))
