"""The pictures of the demo: people, the fitted photo, the person in 3D with new expressions and new attributes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from facewright.imaging.contact_sheet import contact_sheet
from facewright.imaging.overlay import crop_around, draw_mesh_lines, draw_points
from facewright.imaging.portrait import render_portrait
from facewright.imaging.render import Lights
from facewright.imaging.texture import bake_texture, texture_albedo

if TYPE_CHECKING:
    from facewright.faces.face import Face
    from facewright.fitting.image import PhotoFit
    from facewright.mesh.topology import Topology

Picture = NDArray[np.uint8]

#: Light for surfaces whose texture already holds the photo's light.
FLAT = Lights(np.array([[-0.4, -0.6, -0.7]]), np.full((1, 3), 0.36), sky=(0.74,) * 3, ground=(0.56,) * 3)


def people_sheet(face: Face, seed: int, n: int = 10, size: tuple[int, int] = (220, 190)) -> Picture:
    """Draw `n` simulated people, each with an appearance and an expression of their own."""
    from facewright.faces.appearance import albedo_function, sample_appearance, vertex_gloss, visible_faces
    from facewright.faces.expressions import EXPRESSION_NAMES, expression_weights
    from facewright.faces.simulate import simulate_person

    rng = np.random.default_rng((seed, 7))
    faces, skin = visible_faces(face), face.topology.part_slice("face", "head_and_neck")
    pictures = []
    for k in range(n):
        person, look = simulate_person(face, rng), sample_appearance(rng)
        vertices = person.pose(expression_weights(EXPRESSION_NAMES[(3 * k) % len(EXPRESSION_NAMES)]))
        height_mm, centre_mm = head_frame(vertices[skin], size)
        drawn = render_portrait(
            vertices,
            faces,
            size,
            albedo=albedo_function(face, look, faces),
            lights=Lights(look.light_directions, look.light_colours, look.sky, look.ground),
            shininess=vertex_gloss(face),
            yaw_degrees=float(rng.uniform(-20, 20)),
            height_mm=height_mm,
            centre_mm=centre_mm,
        )
        pictures.append(drawn.image)
    return contact_sheet(pictures, columns=5)


def fit_pictures(photo: Picture, fit: PhotoFit, detected: NDArray[np.floating], size: int = 460) -> list[Picture]:
    """Draw the photo's face, its landmarks (found: green, fitted: red) and the fitted mesh over it."""
    camera, pixels = fit.camera_points(fit.vertices), fit.project(fit.vertices)
    topology = fit.model.topology
    n_skin = topology.part_slice("face", "head_and_neck").stop
    skin = topology.submesh(n_skin)
    shown, origin, zoom = crop_around(photo, pixels[skin.masks["face"]], height=size, margin=0.12)

    def moved(points: NDArray[np.floating]) -> NDArray[np.float64]:
        return (np.asarray(points) + 0.5 - origin) * zoom - 0.5

    marked = draw_points(draw_points(shown, moved(detected)), moved(fit.reprojection), (230, 40, 60), 1.8)
    quads = skin.quads if skin.quads is not None else skin.faces
    region = np.isin(quads, np.append(skin.masks["face"], -1)).all(axis=1)
    meshed = draw_mesh_lines(
        shown,
        moved(pixels[:n_skin]),
        camera[:n_skin, 2],
        skin.faces,
        quads[region],
        perspective=fit.intrinsics is not None,
    )
    return [shown, marked, meshed]


def person_texture(photo: Picture, fit: PhotoFit, size: int = 1024) -> Picture:
    """Carry the photo onto the fitted person's skin."""
    return bake_texture(
        photo,
        fit.project(fit.vertices),
        fit.camera_points(fit.vertices),
        fit.model.topology,
        size=size,
        textured=_skin(fit),
        perspective=fit.intrinsics is not None,
    )


def person_painter(face: Face, fit: PhotoFit, texture: Picture, size: tuple[int, int]) -> Callable[..., Picture]:
    """Return a function (vertices, yaw_degrees) that draws the person: the photo on the skin, the rest painted."""
    from facewright.faces.appearance import albedo_function, sample_appearance, vertex_gloss

    topology = visible_topology(face)
    look = sample_appearance(np.random.default_rng(3))
    painted = albedo_function(face, look, topology.faces)
    albedo = texture_albedo(texture, topology, textured=_skin(fit), rest=painted)

    height_mm, centre_mm = head_frame(fit.rig.neutral[_skin(fit)], size)
    gloss = np.where(_skin(fit), 0.0, vertex_gloss(face))  # the photo's skin has its own highlights

    def draw(vertices: NDArray[np.floating], yaw_degrees: float = 15.0) -> Picture:
        drawn = render_portrait(
            vertices,
            topology.faces,
            size,
            albedo=albedo,
            lights=FLAT,
            shininess=gloss,
            yaw_degrees=yaw_degrees,
            height_mm=height_mm,
            centre_mm=centre_mm,
        )
        return drawn.image

    return draw


def head_frame(
    vertices: NDArray[np.floating], size: tuple[int, int], margin: float = 0.05
) -> tuple[float, tuple[float, float, float]]:
    """Return the extent (mm) and the centre of a portrait that shows the whole head from every side.

    Parameters
    ----------
    vertices : ndarray of shape (V, 3), millimetres
        The head's skin, in model space.
    size : (height, width)
        Size of the picture, pixels.
    margin : float
        Free space on each side, as a share of the picture's height.
    """
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    centre = (low + high) / 2
    # the crown is nearer to the camera than the head's centre when the head is turned: seen a little larger
    tall = 1.04 * (high[1] - low[1])
    wide = 2 * np.linalg.norm((vertices - centre)[:, [0, 2]], axis=1).max()
    height = max(tall, wide * size[0] / size[1] * 0.9) / (1 - 2 * margin)
    return float(height), (0.0, float(centre[1]), float(centre[2]))


def visible_topology(face: Face) -> Topology:
    """Return the face's topology without the triangles that are not rendered (see-through shells round the eyes)."""
    from facewright.faces.appearance import visible_faces

    shown = np.zeros(face.topology.n_vertices, dtype=bool)
    shown[visible_faces(face)] = True
    keep = shown[face.topology.faces].all(axis=1)
    uv_faces = None if face.topology.uv_faces is None else face.topology.uv_faces[keep]
    return replace(face.topology, faces=face.topology.faces[keep], uv_faces=uv_faces)


def _skin(fit: PhotoFit) -> NDArray[np.bool_]:
    topology = fit.model.topology
    return np.arange(topology.n_vertices) < topology.part_slice("face", "head_and_neck").stop
