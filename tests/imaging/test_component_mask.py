"""Face components on the skin and in pictures."""

from dataclasses import replace

import numpy as np
import pytest

from facewright.errors import TopologyError, ValueRangeError
from facewright.faces.blendshape_names import BLENDSHAPE_NAMES
from facewright.imaging.component_mask import (
    COMPONENTS,
    SkinPixels,
    component_freedom,
    component_level,
    component_pixels,
    component_shapes,
)
from facewright.imaging.mesh_view import MeshView
from facewright.imaging.portrait import portrait_view

SIZE = (240, 210)
CORES = {
    "mouth": ["lips"],
    "eyes": ["eyelid_upper_left", "eyelid_lower_right"],
    "brows": ["brow_left"],
    "nose": ["nose"],
}


@pytest.fixture(params=["builtin", "ict"])
def face(request):
    return request.getfixturevalue(f"{request.param}_face")


def view_of(face, vertices):
    camera, pixels = portrait_view(vertices, SIZE)
    return MeshView(pixels, camera)


def test_every_shape_belongs_to_one_component_and_to_the_face():
    owners = sum(component_shapes(c, BLENDSHAPE_NAMES).astype(int) for c in COMPONENTS if c != "face")
    assert (owners == 1).all()
    assert component_shapes("face", BLENDSHAPE_NAMES).all()


@pytest.mark.parametrize("component", COMPONENTS)
def test_levels_hold_their_core_whole_and_end_within_the_face(face, component):
    level = component_level(face, component)
    masks = face.topology.masks
    for name in CORES.get(component, ["lips", "nose", "brow_right"]):
        inside = masks[name][masks[name] < face.n_skin]
        if component == "face":
            inside = np.intersect1d(inside, masks["face_region"])
        assert (level[inside] >= 1).all()
    outside = np.setdiff1d(np.arange(face.n_skin), masks["face_region"])
    kept = np.unique(np.concatenate([masks[name] for name in ("lips", "nose")]))  # their insides may lie outside it
    assert (level[np.setdiff1d(outside, kept)] <= 0).all()
    assert (level[face.n_skin :] == -1).all()
    assert ((level > 0) & (level < 1)).sum() > 100  # there is a band for the seam


def test_components_keep_away_from_each_other(face):
    masks = face.topology.masks
    assert component_level(face, "mouth")[masks["nose"]].max() < 1
    assert component_level(face, "eyes")[masks["brow_left"]].max() < 0.1
    assert component_level(face, "brows")[masks["lash_line_left"]].max() <= 0


def test_others_lips_and_lids_are_held(face):
    masks = face.topology.masks
    lips, lids = masks["lips"], masks["eyelid_upper_left"]
    for component, held in {"nose": (lips, lids), "brows": (lips, lids), "mouth": (lids,)}.items():
        free = component_freedom(face, component)
        assert all(free[ids].max() == 0 for ids in held)
        assert (free[component_level(face, component) >= 1] == 1).all()
    assert (component_freedom(face, "face") == 1).all()
    assert (component_freedom(face, "mouth")[lips] == 1).all()


def test_an_open_mouth_belongs_to_the_mouth_and_open_eyes_to_the_eyes(face):
    opened = face.mean_shape + face.blendshape_deltas[face.blendshape_names.index("jawOpen")]
    view = view_of(face, opened)
    pixels = SkinPixels.of(face, view, SIZE)
    assert pixels.openings.sum() > 300
    lips = view.pixels[face.topology.masks["lips"]].mean(axis=0).round().astype(int)
    eye = view.pixels[face.topology.masks["iris_left"]].mean(axis=0).round().astype(int)
    levels = {c: component_pixels(pixels, component_level(face, c)) for c in COMPONENTS}
    assert pixels.openings[lips[1], lips[0]] and pixels.openings[eye[1], eye[0]]
    at_mouth = {c: levels[c][lips[1], lips[0]] for c in COMPONENTS}
    at_eye = {c: levels[c][eye[1], eye[0]] for c in COMPONENTS}
    assert at_mouth == {"mouth": 2, "eyes": -1, "brows": -1, "nose": -1, "face": 2}
    assert at_eye == {"mouth": -1, "eyes": 2, "brows": -1, "nose": -1, "face": 2}
    assert (levels["mouth"][~pixels.fragments.covered & ~pixels.openings] == -1).all()


def test_a_closed_mouth_has_no_opening_to_speak_of(builtin_face):
    closed = SkinPixels.of(builtin_face, view_of(builtin_face, builtin_face.mean_shape), SIZE)
    opened = builtin_face.mean_shape + builtin_face.blendshape_deltas[builtin_face.blendshape_names.index("jawOpen")]
    below = np.arange(SIZE[0])[:, None] > SIZE[0] / 2
    assert (closed.openings & below).sum() < 20
    assert (SkinPixels.of(builtin_face, view_of(builtin_face, opened), SIZE).openings & below).sum() > 300


def test_bad_input_is_refused(builtin_face):
    with pytest.raises(ValueRangeError, match="component"):
        component_shapes("ears", BLENDSHAPE_NAMES)
    with pytest.raises(ValueRangeError, match="component"):
        component_level(builtin_face, "ears")
    masks = {name: ids for name, ids in builtin_face.topology.masks.items() if name != "nose"}
    with pytest.raises(TopologyError, match="'nose'"):
        component_level(replace(builtin_face, topology=replace(builtin_face.topology, masks=masks)), "nose")
