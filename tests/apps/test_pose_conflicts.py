import numpy as np

from facewright.apps.pose_conflicts import pin_conflicts
from facewright.models.region_poser import RegionPoser


def test_says_which_pins_and_leaves_the_poser_as_it_was(patch):
    model = patch[0]
    poser = RegionPoser(model, gamma=1e-3)
    zeta = np.zeros(model.n_coefficients)
    near = np.flatnonzero(np.linalg.norm(model.neutral[:, :2] - [20, 15], axis=1) < 12)[:2]
    rest = model.neutral[near]
    poser.set_constraints([5, 7])
    assert pin_conflicts(poser, {}, zeta) == ()
    assert pin_conflicts(poser, {int(near[0]): rest[0] + [1.0, 0, 0]}, zeta) == ()  # missed by less than is told
    assert "reach by 300" in pin_conflicts(poser, {int(near[0]): rest[0] + [0, 0, 300.0]}, zeta)[0]
    pins = {int(near[0]): rest[0] + [0, 0, 5.0], int(near[1]): rest[1] - [0, 0, 5.0]}
    (said,) = pin_conflicts(poser, pins, zeta)
    assert f"{near[0]}" in said and f"{near[1]}" in said and "contradict each other" in said and said.endswith("mm.")
    assert poser.constrained.tolist() == [5, 7]
