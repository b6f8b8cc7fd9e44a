import numpy as np
import pytest

from facewright.fitting.mesh_synthesis import MeshSynthesiser


@pytest.mark.parametrize("tolerance", [0.0, 0.02, 0.2])
def test_stays_within_its_tolerance(small_model, rng, tolerance):
    synthesiser = MeshSynthesiser(small_model, tolerance)
    for _ in range(5):
        w_id, w_exp = small_model.sample_identity(rng), small_model.sample_expression(rng)
        difference = synthesiser.vertices(w_id, w_exp) - small_model.synthesise(w_id, w_exp)
        assert np.sqrt((difference**2).sum(axis=1).mean()) <= 1.15 * tolerance + 1e-3


def test_leaves_most_rows_out_where_little_is_asked(small_model, rng):
    w_id, w_exp = small_model.sample_identity(rng), small_model.sample_expression(rng)
    weights = np.outer(w_id, w_exp).reshape(-1).astype(np.float32)
    counts = [len(MeshSynthesiser(small_model, t)._rows_that_matter(weights)) for t in (0.0, 0.1, 1.0)]
    assert counts[0] > counts[1] > counts[2] > 0
