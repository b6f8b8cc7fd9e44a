from dataclasses import replace

import numpy as np

from facewright.apps.paint_person import person_colors
from facewright.apps.painted_skin import painted_skin
from facewright.imaging.texture import texels_from_uv


def test_the_picture_has_the_colours_of_the_vertices(builtin_face):
    topology = builtin_face.topology
    picture = painted_skin(builtin_face, 512)
    assert picture.shape == (512, 512, 3) and picture.dtype == np.uint8
    colors = person_colors(builtin_face).astype(int)
    cheeks = np.concatenate([topology.masks["cheeks_left"], topology.masks["cheeks_right"]])
    corner = np.isin(topology.faces, cheeks)
    vertex, uv = topology.faces[corner], topology.uv[topology.uv_faces[corner]]
    x, y = np.rint(texels_from_uv(uv, (512, 512))).astype(int).T
    difference = np.abs(picture[np.clip(y, 0, 511), np.clip(x, 0, 511)] - colors[vertex])
    assert difference.mean() < 3.0


def test_no_atlas_no_picture(builtin_face):
    bare = replace(builtin_face, topology=replace(builtin_face.topology, uv=None, uv_faces=None))
    assert painted_skin(bare) is None
