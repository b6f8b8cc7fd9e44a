from dataclasses import replace

import numpy as np
import pytest

from facewright.errors import ShapeError, TopologyError
from facewright.imaging.portrait import portrait_view
from facewright.imaging.rasterise import rasterise
from facewright.imaging.texture import bake_texture, sample_bilinear, texels_from_uv, texture_albedo
from facewright.mesh.topology import Topology


def globe(n=24, radius=60.0):
    """Latitude-longitude sphere with an atlas; u runs once round, the seam is behind."""
    v, u = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, 2 * n), indexing="ij")
    theta, phi = v * np.pi, (u - 0.5) * 2 * np.pi
    points = np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), np.sin(theta) * np.cos(phi)], -1).reshape(-1, 3)
    ids = np.arange(len(points)).reshape(n, 2 * n)
    a, b, c, d = ids[:-1, :-1].ravel(), ids[1:, :-1].ravel(), ids[1:, 1:].ravel(), ids[:-1, 1:].ravel()
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int32)
    uv = np.stack([u.ravel(), 1 - v.ravel()], 1).astype(np.float32)
    mirror = ids[:, ::-1].ravel().astype(np.int32)
    return points * radius, Topology("globe", len(points), faces, uv=uv, uv_faces=faces, mirror=mirror)


def test_sampling_a_ramp_gives_the_position():
    ramp = np.stack(np.meshgrid(np.arange(7.0), np.arange(5.0)), -1)
    points = np.array([[0.0, 0], [2.5, 1.25], [6, 4]])
    np.testing.assert_allclose(sample_bilinear(ramp, points), points, atol=1e-6)


def test_texels_cover_the_image_from_edge_to_edge():
    np.testing.assert_allclose(
        texels_from_uv(np.array([[0.0, 1.0], [1.0, 0.0]]), (10, 20)), [[-0.5, -0.5], [19.5, 9.5]]
    )


def test_baking_and_rendering_gives_the_photo_back():
    vertices, topology = globe()
    yy, xx = np.mgrid[:240, :240]
    photo = np.stack([128 + 90 * np.sin(xx / 14), 128 + 90 * np.cos(yy / 17), 100 + 0 * xx], -1).astype(np.uint8)
    camera, pixels = portrait_view(vertices, (240, 240), centre_mm=(0, 0, 0), height_mm=160)
    texture = bake_texture(photo, pixels, camera, topology, size=512, perspective=True)
    fragments = rasterise(pixels, camera[:, 2], topology.faces, (240, 240))
    again = texture_albedo(texture, topology)(fragments) * 255
    frontal = np.hypot(xx - 119.5, yy - 119.5) < 55
    assert np.abs(again - photo)[frontal].mean() < 3.0
    # behind, where nothing was seen, the mean colour continues instead of black
    assert texture[:, :20].mean() > 60


def test_only_chosen_parts_are_textured():
    vertices, topology = globe()
    camera, pixels = portrait_view(vertices, (64, 64), centre_mm=(0, 0, 0), height_mm=160)
    upper = vertices[:, 1] > 0
    photo = np.full((64, 64, 3), (200, 10, 10), np.uint8)
    texture = bake_texture(photo, pixels, camera, topology, size=64, textured=upper, perspective=True)
    blue = np.tile([0.0, 0.0, 1.0], (len(vertices), 1))
    albedo = texture_albedo(texture, topology, textured=upper, rest=blue)
    seen = albedo(rasterise(pixels, camera[:, 2], topology.faces, (64, 64)))
    np.testing.assert_allclose(seen[20, 32], [200 / 255, 10 / 255, 10 / 255], atol=0.02)
    np.testing.assert_allclose(seen[44, 32], [0, 0, 1], atol=1e-6)


def test_refuses_meshes_without_an_atlas_and_wrong_counts():
    vertices, topology = globe()
    bare = Topology("bare", topology.n_vertices, topology.faces)
    photo = np.zeros((8, 8, 3), np.uint8)
    with pytest.raises(TopologyError, match="must have texture coordinates"):
        bake_texture(photo, vertices[:, :2], vertices, bare)
    with pytest.raises(ShapeError, match="pixels must have shape"):
        bake_texture(photo, vertices[:5, :2], vertices, topology)
    with pytest.raises(ShapeError, match="textured must have shape"):
        bake_texture(photo, vertices[:, :2], vertices, topology, textured=np.ones(3, bool))


def test_only_the_face_shows_the_photo():
    vertices, topology = globe(48)
    masks = {
        "face_region": np.flatnonzero((vertices[:, 2] > 20) & (vertices[:, 1] > -40)),
        "cheeks_left": np.flatnonzero((np.hypot(vertices[:, 0] - 20, vertices[:, 1]) < 14) & (vertices[:, 2] > 0)),
        "nostril_insides": np.flatnonzero((np.hypot(vertices[:, 0], vertices[:, 1] - 5) < 10) & (vertices[:, 2] > 0)),
    }
    topology = replace(topology, masks={k: v.astype(np.int32) for k, v in masks.items()})
    camera, pixels = portrait_view(vertices, (240, 240), centre_mm=(0, 0, 0), height_mm=160)
    skin, hair, collar = np.array([220, 175, 155]), (120, 95, 30), (10, 10, 200)
    photo = np.tile(skin, (240, 240, 1)).astype(np.uint8)
    photo[:72], photo[190:] = hair, collar
    photo[130:134, 100:140] = (150, 60, 60)  # lips, in the middle of the face, are far from the cheeks' colour
    topology.masks["lips"] = np.flatnonzero(
        (np.abs(vertices[:, 0]) < 20) & (np.abs(vertices[:, 1] + 8) < 8) & (vertices[:, 2] > 0)
    ).astype(np.int32)
    texture = bake_texture(photo, pixels, camera, topology, size=512, perspective=True)
    seen = texture_albedo(texture, topology)(rasterise(pixels, camera[:, 2], topology.faces, (240, 240))) * 255
    for y, x in ((60, 120), (195, 120), (140, 90), (100, 60)):  # where hair was, where the collar was, cheek, side
        np.testing.assert_allclose(seen[y, x], skin, atol=6)
    assert seen[112, 120].max() < 100 and seen[112, 120, 0] > 1.3 * seen[112, 120, 2]
    assert seen[132, 120, 1] < 90
