import numpy as np
import pytest

from facewright.errors import ShapeError, TopologyError, ValueRangeError
from facewright.imaging.scan_texture import bake_scan_texture
from facewright.imaging.texture import sample_bilinear, texels_from_uv
from facewright.io.mesh_data import MeshData
from facewright.mesh.topology import Topology


@pytest.fixture(scope="module")
def face(builtin_face):
    return builtin_face.skin()


def colour_of(points):
    return np.clip(128 + points * [1.0, 0.8, 0.9], 0, 255)


def test_colours_are_those_of_the_scan_at_the_same_place(face):
    vertices = face.mean_shape.astype(np.float64)
    scan = MeshData(vertices, face.topology.faces, vertex_colors=colour_of(vertices).astype(np.uint8))
    texture = bake_scan_texture(scan, None, vertices, face.topology, reach=1.0, size=256)
    at = np.zeros((len(vertices), 2))
    at[face.topology.faces] = texels_from_uv(face.topology.uv, (256, 256))[face.topology.uv_faces]
    used = np.unique(face.topology.faces)
    found = sample_bilinear(texture.astype(np.float32), at[used])
    assert np.median(np.abs(found - colour_of(vertices[used]))) < 3.0


def test_a_texture_survives_being_carried_over(face, rng):
    coarse = rng.uniform(0, 255, (6, 6, 3))
    from PIL import Image

    picture = np.asarray(Image.fromarray(coarse.astype(np.uint8)).resize((256, 256), Image.Resampling.BICUBIC))
    topology = face.topology
    scan = MeshData(face.mean_shape, topology.faces, uv=topology.uv, uv_faces=topology.uv_faces)
    texture = bake_scan_texture(scan, picture, face.mean_shape, topology, reach=1.0, size=256)
    at = texels_from_uv(topology.uv, (256, 256))[np.unique(topology.uv_faces)]
    difference = sample_bilinear(texture.astype(np.float32), at) - sample_bilinear(picture.astype(np.float32), at)
    assert np.median(np.abs(difference)) < 3.0


def test_where_the_scan_is_not_colours_continue(face):
    vertices = face.mean_shape.astype(np.float64)
    right = (vertices[face.topology.faces][..., 0] < 0).all(axis=1)
    grey = np.full((len(vertices), 3), 90, np.uint8)
    scan = MeshData(vertices, face.topology.faces[right], vertex_colors=grey)
    texture = bake_scan_texture(scan, None, vertices, face.topology, reach=2.0, size=128)
    assert np.abs(texture.astype(int) - 90).max() <= 1


def test_what_cannot_be_baked_is_refused(face):
    vertices, topology = face.mean_shape, face.topology
    plain = MeshData(vertices, topology.faces)
    with pytest.raises(ValueRangeError, match="neither"):
        bake_scan_texture(plain, None, vertices, topology, reach=1.0, size=32)
    with pytest.raises(ShapeError, match="texture coordinates"):
        bake_scan_texture(plain, np.zeros((4, 4, 3), np.uint8), vertices, topology, reach=1.0, size=32)
    with pytest.raises(ValueRangeError, match="within reach"):
        bake_scan_texture(plain, None, vertices + 1000, topology, reach=1.0, size=32)
    bare = Topology("bare", len(vertices), topology.faces)
    with pytest.raises(TopologyError, match="texture coordinates"):
        bake_scan_texture(plain, None, vertices, bare, reach=1.0, size=32)
