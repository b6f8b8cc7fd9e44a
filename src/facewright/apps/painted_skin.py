"""The skin of a made-up person as a picture in the face's atlas."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from facewright.apps.paint_person import usual_appearance
from facewright.faces.face import Face


def painted_skin(face: Face, size: int = 1024, seed: int | None = None) -> NDArray[np.uint8] | None:
    """Return the painted skin (size, size, 3), sRGB, for the topology's uv, or None for a face without uv.

    Brows, lips and scalp are drawn per texel, sharper than colours at vertices. Texels outside the atlas repeat the
    nearest inside.

    Parameters
    ----------
    face : Face
    size : int
        Width and height.
    seed : int, optional
        Seed of the appearance; a usual one where absent.
    """
    from facewright.faces.appearance import albedo_function
    from facewright.imaging.rasterise import rasterise
    from facewright.imaging.texture import texels_from_uv

    topology = face.topology
    if topology.uv is None or topology.uv_faces is None:
        return None
    skin = (topology.faces < face.n_skin).all(axis=1)
    faces, uv_faces = topology.faces[skin], topology.uv_faces[skin]
    atlas = rasterise(
        texels_from_uv(topology.uv, (size, size)), np.zeros(len(topology.uv)), uv_faces, (size, size), perspective=False
    )
    colours = albedo_function(face, usual_appearance(seed), faces)(atlas)
    rows, columns = distance_transform_edt(~atlas.covered, return_distances=False, return_indices=True)
    return np.rint(255.0 * np.clip(colours[rows, columns], 0.0, 1.0)).astype(np.uint8)
