import numpy as np
import pytest

from facewright.camera.rotation import rotation_from_vector
from facewright.errors import DegenerateError, ShapeError
from facewright.faces.expressions import expression_weights
from facewright.faces.simulate import simulate_person
from facewright.mesh.random_field import smooth_random_field
from facewright.warehouse.head_frame import HeadFrame


@pytest.mark.parametrize("expression", ["mouth_stretch", "brow_raiser", "grin"])
def test_the_head_s_motion_is_found_beside_the_face_s(builtin_face, rng, expression):
    skin = builtin_face.skin()
    person = simulate_person(skin, rng)
    neutral = person.neutral.astype(np.float64)
    weights = expression_weights(expression)
    moved = np.tensordot(weights, person.deltas.astype(np.float64), 1)
    generic = np.tensordot(weights, skin.blendshape_deltas, 1)
    turn, shift = rotation_from_vector(np.array([0.02, -0.015, 0.01])), np.array([0.8, -1.2, 0.5])
    noise = smooth_random_field(neutral, 20.0, 0.3, rng, n_fields=1)[0]
    seen = (neutral + moved + noise) @ turn.T + shift
    motion = HeadFrame(builtin_face).align(neutral, seen, generic)
    region = builtin_face.topology.masks["face_region"]
    error = motion.apply(seen) - (neutral + moved + noise)
    assert np.sqrt((error[region] ** 2).sum(axis=1).mean()) < 0.5
    assert np.sqrt(((seen - neutral - moved - noise)[region] ** 2).sum(axis=1).mean()) > 1.0


def test_a_face_that_moves_everywhere_is_refused(builtin_face):
    neutral = builtin_face.skin().mean_shape.astype(np.float64)
    with pytest.raises(DegenerateError, match="still"):
        HeadFrame(builtin_face).align(neutral, neutral, np.full_like(neutral, 20.0))
    with pytest.raises(ShapeError, match="moved"):
        HeadFrame(builtin_face).align(neutral, neutral, neutral[:5])
