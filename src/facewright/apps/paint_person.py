"""Colours for people who have no photo: the face that a model was built with, and a made-up appearance on it."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from facewright.errors import MissingFaceError

if TYPE_CHECKING:
    from facewright.faces.appearance import Appearance
    from facewright.faces.face import Face
    from facewright.imaging.render import Albedo
    from facewright.mesh.topology import Topology
    from facewright.models.bilinear import BilinearModel

Painter = Callable[[NDArray[np.floating]], NDArray[np.uint8]]


def face_of_model(model: BilinearModel) -> Face | None:
    """Return the face that a model was built with, or None where it is not installed or has another topology."""
    from facewright.faces import load_face

    name = str(model.provenance.get("face", ""))
    try:
        face = load_face(name)
    except MissingFaceError:
        return None
    candidates = [face] if model.n_vertices == face.topology.n_vertices else [face.skin()]
    return next((f for f in candidates if f.topology.fingerprint == model.topology.fingerprint), None)


def usual_appearance(seed: int | None = None) -> Appearance:
    """Return the appearance that pictures use where nobody chose one: middle skin, or that of `seed`."""
    from facewright.faces.appearance import sample_appearance

    return sample_appearance(np.random.default_rng(11 if seed is None else seed))


def person_colors(face: Face | None, seed: int | None = None) -> NDArray[np.uint8] | None:
    """Return sRGB vertex colours (V, 3) of a made-up person with this face, or None without a face."""
    if face is None:
        return None
    from facewright.faces.appearance import vertex_colors

    colors = vertex_colors(face, usual_appearance(seed))
    return np.clip(np.rint(255.0 * colors), 0, 255).astype(np.uint8)


def portrait_painter(
    topology: Topology,
    face: Face | None,
    size: tuple[int, int],
    *,
    yaw_degrees: float = 0.0,
    seed: int | None = None,
) -> Painter:
    """Return a function that draws vertices (V, 3) of `topology`.

    Parameters
    ----------
    topology : Topology
        Of the vertices.
    face : Face, optional
        Face of this topology, which says where lips, brows and irises are; without it each part has one colour.
    size : (height, width)
        Pixels of a portrait.
    yaw_degrees : float
        Turn of the head.
    seed : int, optional
        Seed of the appearance; a usual one where absent.
    """
    from facewright.imaging.portrait import render_portrait

    albedo: Albedo
    gloss: NDArray[np.floating] | float = 0.12
    if face is None:
        faces, albedo = _plain_parts(topology)
    else:
        from facewright.faces.appearance import albedo_function, vertex_gloss, visible_faces

        faces, gloss = visible_faces(face), vertex_gloss(face)
        albedo = albedo_function(face, usual_appearance(seed), faces)

    def draw(vertices: NDArray[np.floating]) -> NDArray[np.uint8]:
        return render_portrait(vertices, faces, size, albedo=albedo, shininess=gloss, yaw_degrees=yaw_degrees).image

    return draw


def _plain_parts(topology: Topology) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    from facewright.apps.export import LOOKS, face_looks
    from facewright.imaging.colour import srgb_from_linear

    looks, index = face_looks(topology)
    faces = topology.faces[index >= 0]
    palette = srgb_from_linear(np.array([LOOKS[look][0] for look in looks], dtype=np.float32))
    albedo = np.full((topology.n_vertices, 3), 0.7, dtype=np.float32)
    albedo[faces] = palette[index[index >= 0]][:, None]
    return faces, albedo
