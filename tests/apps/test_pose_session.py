import numpy as np
import pytest

from facewright.apps.pose_session import PoseSession
from facewright.errors import FacewrightError, ShapeError, TopologyError, ValueRangeError
from facewright.models.region_poser import RegionPoser

MIRROR = np.array([-1.0, 1.0, 1.0])


@pytest.fixture
def session(patch):
    return PoseSession(patch[0], holistic=patch[1])


def _vertex(session, x, y):
    return int(np.argmin(np.linalg.norm(session.model.neutral[:, :2] - [x, y], axis=1)))


def test_a_drag_is_what_the_poser_solves_from_where_it_began(session):
    model, v = session.model, _vertex(session, 20, 15)
    first = session.drag(v, model.neutral[v] + [1, 2, 3]).copy()
    session.drag(v, model.neutral[v] + [9, 9, 9])
    np.testing.assert_array_equal(
        session.drag(v, model.neutral[v] + [1, 2, 3]), first
    )  # no way of getting there counts
    poser = RegionPoser(model, boundaries="keep")
    poser.set_constraints([v])
    zeta = poser.solve((model.neutral[v] + [1, 2, 3])[None], np.zeros(model.n_coefficients))
    np.testing.assert_allclose(first, poser.positions(zeta), atol=1e-4)
    assert session.dragging and session.undo_label is None
    session.release()
    assert not session.dragging and session.undo_label == "drag"
    second = session.drag(v, model.neutral[v] + [1, 2, 3]).copy()  # a second pull begins at the first one's pose
    again = poser.solve((model.neutral[v] + [1, 2, 3])[None], zeta)
    np.testing.assert_allclose(second, poser.positions(again), atol=1e-4)


def test_grabbing_a_point_without_moving_it_moves_nothing(session):
    v, other = _vertex(session, 20, 15), _vertex(session, -20, -15)
    session.drag(v, session.model.neutral[v] + [0, 6, 2])
    session.release()
    posed = session.positions().copy()
    for _ in range(3):
        session.drag(other, session.positions()[other].copy())
        session.release()
    assert np.abs(session.positions() - posed).max() < 1e-3


def test_positions_land_in_the_callers_buffer(session):
    out = np.zeros((session.model.n_vertices, 3), np.float32)
    own = PoseSession(session.model, out=out)
    v = _vertex(session, 20, 15)
    moved = own.drag(v, session.model.neutral[v] + [0, 6, 2])
    assert moved is out or np.shares_memory(moved, out)
    np.testing.assert_array_equal(out, own.positions())
    assert np.abs(out - session.model.neutral).max() > 1.0
    for bad in (out[:-1], out.astype(float), out.T.copy().T):
        with pytest.raises(FacewrightError, match="out"):
            PoseSession(session.model, out=bad)


def test_only_the_region_follows_and_the_holistic_model_moves_more(session):
    v = _vertex(session, 20, 15)
    session.drag(v, session.model.neutral[v] + [0, 6, 2])
    far = session.model.neutral[:, 0] < -20
    leak = [
        (np.linalg.norm(session.positions(kind) - session.model.neutral, axis=1)[far] ** 2).sum()
        for kind in ("region", "holistic")
    ]
    assert leak[0] < 0.5 * leak[1]


def test_pins_hold_and_a_dragged_pin_goes_along(session):
    v, w = _vertex(session, 20, 15), _vertex(session, 10, 10)
    free = session.drag(v, session.model.neutral[v] + [0, 8, 0])[w].copy()
    session.undo()
    session.pin(w)
    held = session.drag(v, session.model.neutral[v] + [0, 8, 0])[w]
    rest = session.model.neutral[w]
    assert np.linalg.norm(held - rest) < 0.6 * np.linalg.norm(free - rest)
    session.release()
    np.testing.assert_allclose(session.state.pins[w], rest, atol=1e-4)
    session.drag(w, rest + [1, 0, 0])
    session.release()
    np.testing.assert_allclose(session.state.pins[w], rest + [1, 0, 0], atol=1e-4)
    session.unpin(w)
    assert not session.state.pins
    with pytest.raises(ValueRangeError, match="not"):
        session.unpin(w)


def test_pins_that_cannot_be_met_are_told(session):
    v = _vertex(session, 20, 15)
    assert session.pin(v) == ()
    (said,) = session.pin(v, session.model.neutral[v] + [0, 0, 500.0])
    assert "out of the face's reach" in said
    session.reset()
    w = _vertex(session, 20, 10)
    target = session.model.neutral[v] + [0, 4, 0]
    assert session.pin(v, target) == ()
    away = session.positions()[w] + [0.0, -12.0, 0]
    (said,) = session.pin(w, away)
    assert "contradict each other" in said or "reach" in said
    session.unpin_all()
    assert session.conflicts() == ()


def test_symmetric_mode_moves_both_sides_alike_and_keeps_the_midline(session):
    session.set_symmetric(True)
    v = _vertex(session, 20, 15)
    m = int(session.mirror[v])
    np.testing.assert_allclose(session.model.neutral[m], session.model.neutral[v] * MIRROR, atol=1e-9)
    session.drag(v, session.model.neutral[v] + [2, 5, 1])
    gesture = session._gesture
    np.testing.assert_allclose(gesture.targets[1] - session.model.neutral[m], [-2, 5, 1], atol=1e-4)
    session.release()
    middle = _vertex(session, 0, 10)
    session.drag(middle, session.positions()[middle] + [5.0, 3.0, 0.0])
    assert abs(session._gesture.targets[0, 0] - session._grabbed_at[0, 0]) < 1e-6
    session.release()
    session.pin(v)
    assert set(session.state.pins) == {v, m}
    session.unpin(m)
    assert not session.state.pins


def test_weights_change_the_last_pull_as_one_step(session):
    v = _vertex(session, 20, 15)
    target = session.model.neutral[v] + [0, 6, 0]
    session.drag(v, target)
    session.release()
    before = np.linalg.norm(session.positions()[v] - target)
    for gamma in (0.02, 0.01, 0.001):
        session.set_weights(gamma=gamma)
    assert np.linalg.norm(session.positions()[v] - target) < 0.5 * before
    session.undo()
    assert session.state.gamma == 0.025
    np.testing.assert_allclose(np.linalg.norm(session.positions()[v] - target), before, atol=1e-4)
    for name, value in (("beta", -0.1), ("gamma", -1.0), ("gamma", np.nan)):
        with pytest.raises(ValueRangeError, match=f"{name} must be finite and not negative"):
            session.set_weights(**{name: value})
    assert session.state.beta == 0.5


def test_steps_back_and_forth_restore_everything(session):
    v = _vertex(session, 20, 15)
    poses = [session.coefficients().copy()]
    for k in range(3):
        session.drag(v, session.model.neutral[v] + [0, 2.0 * (k + 1), 0])
        session.release()
        poses.append(session.coefficients().copy())
    for pose in poses[-2::-1]:
        session.undo()
        np.testing.assert_array_equal(session.coefficients(), pose)
    with pytest.raises(ValueRangeError, match="nothing to undo"):
        session.undo()
    for pose in poses[1:]:
        session.redo()
        np.testing.assert_array_equal(session.coefficients(), pose)
    with pytest.raises(ValueRangeError, match="nothing to redo"):
        session.redo()
    session.undo()
    session.drag(v, session.model.neutral[v])
    session.undo()  # a held vertex is let go, no step is taken back
    np.testing.assert_array_equal(session.coefficients(), poses[2])
    session.reset()
    np.testing.assert_allclose(session.positions(), session.model.neutral, atol=1e-4)


def test_keyframes_play_in_parameter_space(session):
    v = _vertex(session, 20, 15)
    session.set_key(0.0)
    session.drag(v, session.model.neutral[v] + [0, 6, 0])
    session.set_key(1.0)
    end = session.coefficients().copy()
    session.seek(0.5)
    np.testing.assert_allclose(session.coefficients(), 0.5 * end, atol=1e-12)
    np.testing.assert_allclose(session.sample([0.0, 0.5, 1.0]), [0 * end, 0.5 * end, end], atol=1e-12)
    assert len(session.state.keyframes["holistic"]) == 2
    session.move_key(1, 2.0)
    session.delete_key(0)
    assert session.keyframes.times.tolist() == [2.0]
    session.undo()
    session.undo()
    assert session.keyframes.times.tolist() == [0.0, 1.0]


def test_a_pose_that_seeking_left_comes_back_first(session):
    v = _vertex(session, 20, 15)
    session.set_key(0.0)
    session.drag(v, session.model.neutral[v] + [0, 6, 0])
    session.release()
    lost = session.coefficients().copy()
    session.seek(0.3)
    assert np.abs(session.coefficients()).max() == 0
    session.undo()
    np.testing.assert_array_equal(session.coefficients(), lost)
    session.undo()
    assert np.abs(session.coefficients()).max() == 0


def test_set_pose_brings_the_holistic_model_near(session, rng):
    zeta = rng.normal(size=session.model.n_coefficients)
    session.set_pose(zeta)
    np.testing.assert_array_equal(session.coefficients(), zeta)
    moved = np.linalg.norm(session.positions() - session.model.neutral)
    assert np.linalg.norm(session.positions("holistic") - session.positions()) < moved
    with pytest.raises(ShapeError):
        session.set_pose(zeta[:-1])


def test_refuses(session, patch):
    for vertex in (-1, 63, 10**9):
        with pytest.raises(ValueRangeError, match=r"\[0, 63\)"):
            session.drag(vertex, [0, 0, 0])
        with pytest.raises(ValueRangeError, match=r"\[0, 63\)"):
            session.pin(vertex)
    with pytest.raises(ShapeError):
        session.drag(0, [0, 0])
    with pytest.raises(ValueRangeError, match="finite"):
        session.drag(0, [0, np.nan, 0])
    assert not session.dragging
    with pytest.raises(ValueRangeError, match="0 s or later"):
        session.seek(-1.0)
    with pytest.raises(ValueRangeError, match="kind must be"):
        session.positions("both")
    with pytest.raises(ValueRangeError, match="beta"):
        PoseSession(patch[0], beta=-1)
    with pytest.raises(ValueRangeError, match="one region"):
        PoseSession(patch[0], holistic=patch[0])
    import dataclasses

    other = dataclasses.replace(patch[1], faces=patch[1].faces[:, [1, 2, 0]])
    with pytest.raises(TopologyError, match="mesh"):
        PoseSession(patch[0], holistic=other)
