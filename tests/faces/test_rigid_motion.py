from types import SimpleNamespace

import numpy as np
from scipy.spatial.transform import Rotation

from facewright.faces.rigid_motion import rigid_motions, rigid_vertices


def piece(rng):
    """A face of one rigid piece that shape 0 turns and moves, shape 1 leaves alone."""
    rest = rng.normal(size=(30, 3)) * 10
    turn, shift = Rotation.from_rotvec([0.3, -0.1, 0.2]), np.array([1.0, 2.0, -3.0])
    centre = rest.mean(axis=0)
    moved = turn.apply(rest - centre) + centre + shift
    topology = SimpleNamespace(parts={"teeth": (0, 30)}, masks={"half": np.arange(15, dtype=np.int32)})
    face = SimpleNamespace(
        mean_shape=rest,
        blendshape_deltas=np.stack([moved - rest, np.zeros_like(rest)]),
        topology=topology,
        rigid_parts={"teeth": "jaw"},
    )
    return face, turn, shift


def test_rotation_and_translation_are_found_and_replayed(rng):
    face, turn, shift = piece(rng)
    (motion,) = rigid_motions(face)
    assert np.allclose(motion.rotations[0], turn.as_rotvec())
    assert np.allclose(motion.translations[0], shift)
    replayed = motion.deltas(face.mean_shape, np.ones(2))
    assert np.allclose(replayed, face.blendshape_deltas)


def test_any_amplitude_keeps_distances(rng):
    face, _, _ = piece(rng)
    (motion,) = rigid_motions(face)
    other = rng.normal(size=(30, 3)) * 9
    moved = other + motion.deltas(other, np.array([1.3, 0.7]))[0]
    between = np.linalg.norm(other[:, None] - other[None], axis=2)
    assert np.allclose(np.linalg.norm(moved[:, None] - moved[None], axis=2), between)


def test_pieces_are_parts_or_masks(rng):
    face, _, _ = piece(rng)
    assert len(rigid_vertices(face, "teeth")) == 30
    assert len(rigid_vertices(face, "half")) == 15
