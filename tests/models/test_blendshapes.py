import numpy as np
import pytest

from facewright.errors import ShapeError, ValueRangeError
from facewright.models.blendshapes import BlendshapeRig


@pytest.fixture
def rig():
    rng = np.random.default_rng(0)
    return BlendshapeRig(
        rng.normal(size=(7, 3)).astype(np.float32),
        ("a", "b", "c"),
        rng.normal(size=(3, 7, 3)).astype(np.float32),
    )


def test_pose_is_neutral_plus_weighted_deltas(rig):
    beta = np.array([0.2, 0.0, 1.5])
    expected = rig.neutral + sum(b * d for b, d in zip(beta, rig.deltas))
    np.testing.assert_allclose(rig.pose(beta), expected, atol=1e-6)
    np.testing.assert_array_equal(rig.pose(np.zeros(3)), rig.neutral)
    np.testing.assert_allclose(rig.pose(np.array([0, 1, 0])), rig.shape("b"), atol=1e-6)


def test_pose_of_frames(rig):
    frames = np.random.default_rng(1).uniform(size=(5, 3))
    posed = rig.pose(frames)
    assert posed.shape == (5, 7, 3)
    assert posed.dtype == np.float32
    for frame, face in zip(frames, posed):
        np.testing.assert_allclose(face, rig.pose(frame), atol=1e-6)
    assert rig.pose(np.zeros((0, 3))).shape == (0, 7, 3)


def test_guards(rig):
    with pytest.raises(ShapeError, match=r"weights must have shape \(3,\)"):
        rig.pose(np.zeros(4))
    with pytest.raises(ValueRangeError, match="finite"):
        rig.pose(np.array([0, np.nan, 0]))
    with pytest.raises(ValueRangeError, match="must be one of a, b, c"):
        rig.shape("d")
    with pytest.raises(ShapeError, match="deltas"):
        BlendshapeRig(rig.neutral, ("a",), rig.deltas)
    with pytest.raises(ValueRangeError, match="unique"):
        BlendshapeRig(rig.neutral, ("a", "a", "c"), rig.deltas)
