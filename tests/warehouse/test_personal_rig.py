import numpy as np
import pytest

from facewright.deform.deformation_transfer import DeformationTransfer
from facewright.errors import ShapeError
from facewright.faces.expressions import EXPRESSION_WEIGHTS, random_expression_weights
from facewright.faces.simulate import simulate_person
from facewright.mesh.random_field import smooth_random_field
from facewright.warehouse.personal_rig import fit_personal_rig


def test_a_rig_from_poses_beats_the_generic_one_and_has_all_parts(builtin_face):
    rng = np.random.default_rng(8)
    face, n = builtin_face, builtin_face.n_skin
    person = simulate_person(face, rng)
    weights = EXPRESSION_WEIGHTS * rng.uniform(0.7, 1.1, EXPRESSION_WEIGHTS.shape)
    poses = person.pose(weights).astype(np.float64)
    poses[1:] += smooth_random_field(face.mean_shape, 25.0, 0.5, rng, n_fields=19)  # as scan fitting leaves
    rig = fit_personal_rig(face, poses[:, :n], EXPRESSION_WEIGHTS)
    assert rig.meshes.shape == poses.shape
    assert rig.deltas.shape == person.deltas.shape
    assert np.array_equal(rig.weights[0], np.zeros(46))
    assert rig.residuals_mm.max() < 1.2
    mean = face.skin().mean_shape.astype(np.float64)
    transfer = DeformationTransfer(mean, poses[0, :n], face.skin().topology.faces)
    generic = transfer.transfer(mean + face.blendshape_deltas[:, :n]) - poses[0, :n]
    unseen = random_expression_weights(rng, 40)
    region = face.topology.masks["face_region"]

    def error(deltas):
        difference = np.tensordot(unseen, deltas[:, region] - person.deltas[:, region], 1)
        return np.sqrt((difference**2).sum(axis=2).mean())

    assert error(rig.deltas) < 0.9 * error(generic)
    for name in ("eyeball_left", "teeth_upper", "teeth_lower"):
        part = slice(*face.topology.parts[name])
        assert np.sqrt(((rig.meshes[:, part] - poses[:, part]) ** 2).sum(axis=2).mean()) < 1.2


def test_arrays_that_do_not_fit_are_refused(builtin_face):
    skins = np.zeros((2, builtin_face.n_skin, 3))
    with pytest.raises(ShapeError, match="skins"):
        fit_personal_rig(builtin_face, skins[:, :-1], np.zeros((2, 46)))
    with pytest.raises(ShapeError, match="guide"):
        fit_personal_rig(builtin_face, skins, np.zeros((3, 46)))
