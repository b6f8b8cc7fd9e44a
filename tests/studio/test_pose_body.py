import json

import numpy as np
import pytest

from facewright.apps.pose_session import PoseSession
from facewright.apps.posed_character import load_character
from facewright.errors import ValueRangeError
from facewright.studio.pose_body import PoseBody, region_colours, region_title


def _unpacked(packet):
    """What `fetchShared` of stream.js reads."""
    (size,) = np.frombuffer(packet, "<u4", 1)
    shared = json.loads(packet[4 : 4 + size])
    types = {"f4": "<f4", "u4": "<u4", "i4": "<i4", "u1": "u1"}
    for name, (kind, offset, length) in shared.pop("arrays").items():
        assert offset % 4 == 0
        shared[name] = np.frombuffer(packet, types[kind], length, offset)
    return shared


@pytest.fixture(scope="module")
def session(face_models):
    return PoseSession(face_models[0], holistic=face_models[1])


@pytest.mark.parametrize("name", ["builtin", "none"])
def test_the_packet_holds_the_face(session, name):
    character = load_character(name, session.models)
    shared = _unpacked(PoseBody(session, character).packet(session))
    V = len(character.neutral)
    np.testing.assert_array_equal(shared["positions"].reshape(V, 3), character.neutral)
    assert shared["kinds"] == ["region", "holistic"] and len(shared["regions"]) == 6
    assert sum(group["count"] for group in shared["groups"]) == len(shared["faces"]) == len(shared["drawnFaces"])
    # drawn vertices are the face's: a corner of a triangle is drawn where the face has it
    np.testing.assert_array_equal(shared["source"][shared["drawnFaces"]], shared["faces"])
    nearest = shared["nearest"]
    np.testing.assert_array_equal(nearest[shared["handles"]], np.arange(200))
    if name == "builtin":
        assert bytes(shared["skin"][:4]) == b"\x89PNG" and len(shared["uv"]) == 2 * len(shared["source"])
        ears = character.topology.masks["ears"]
        assert (nearest[ears] < 0).mean() > 0.7  # cannot be dragged
        tint = shared["regionColours"].reshape(V, 4)
        assert tint[ears, 3].mean() < 40 and tint[shared["handles"], 3].mean() > 230
        # what a shut mouth touches is dragged by its own lip
        upper = character.topology.masks["lip_contact_upper"]
        lower = np.setdiff1d(character.topology.masks["lips_lower"], character.topology.masks["lips_upper"])
        assert not np.isin(shared["handles"][nearest[upper[2:-2]]], lower).any()


def test_positions_follow_the_pose(session):
    body = PoseBody(session, load_character("builtin", session.models))
    body.update(session)
    np.testing.assert_allclose(body.positions["region"], body.character.neutral, atol=1e-3)
    corner = np.array([22.0, -35.0, 100.0])  # of the mouth, which moves easily
    v = int(np.linalg.norm(session.model.neutral - corner, axis=1).argmin())
    place = body.character.from_model(v, session.model.neutral[v] + [0, 2, 1])
    np.testing.assert_allclose(body.character.to_model(v, place), session.model.neutral[v] + [0, 2, 1], atol=1e-6)
    session.drag(v, body.character.to_model(v, place))
    body.update(session)
    session.undo()
    handle = body.character.handles[v]
    moved = body.positions["region"][handle] - body.character.neutral[handle]
    posed = session.model.neutral[v]
    assert np.linalg.norm(moved) > 0.5 and np.isfinite(posed).all()


def test_colours_of_regions_that_touch_differ(session, face_models):
    colours = region_colours(face_models[0].regions, face_models[0].faces).astype(int)
    apart = np.abs(colours[:, None] - colours).sum(axis=2)
    assert apart[~np.eye(6, dtype=bool)].min() > 60


def test_names():
    assert region_title("region_07") == "Region 7" and region_title("left_brow") == "Left brow"
    with pytest.raises(ValueRangeError, match="character must be one of"):
        load_character("bob", {})


@pytest.mark.parametrize("name", ["builtin", "none"])
def test_a_twin_poses_the_same_in_buffers_of_its_own(session, name, rng):
    character = load_character(name, session.models)
    twin = character.twin()
    one, other = np.empty_like(character.neutral), np.empty_like(character.neutral)
    zeta = rng.normal(size=session.model.n_coefficients)
    character.pose("region", zeta, one)
    twin.pose("region", zeta, other)
    np.testing.assert_array_equal(one, other)
    mine = {id(value) for value in vars(character).values() if isinstance(value, dict)}
    assert not any(id(value) in mine for key, value in vars(twin).items() if key in ("_drivers", "_blends"))
