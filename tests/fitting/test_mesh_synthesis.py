import numpy as np
import pytest

from facewright.fitting.mesh_synthesis import MeshSynthesiser


@pytest.mark.parametrize("tolerance", [0.0, 0.02, 0.2])
def test_stays_within_its_tolerance(small_model, rng, tolerance):
    synthesiser = MeshSynthesiser(small_model, tolerance)
    for _ in range(5):
        w_id, w_exp = small_model.sample_identity(rng), small_model.sample_expression(rng)
        difference = synthesiser.vertices(w_id, w_exp) - small_model.synthesise(w_id, w_exp)
        assert np.sqrt((difference**2).sum(axis=1).mean()) <= 1.5 * tolerance + 1e-3
