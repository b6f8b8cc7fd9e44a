"""Shaded pictures of meshes: directional lights, soft skin shading, highlights, anti-aliasing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facewright.imaging.colour import linear_from_srgb, srgb_from_linear
from facewright.imaging.rasterise import Fragments, rasterise
from facewright.mesh.normals import vertex_normals
from facewright.numeric.check import check_shape

Albedo = NDArray[np.floating] | Callable[[Fragments], NDArray[np.floating]]


def _studio_directions() -> NDArray[np.float64]:
    return np.array([[-0.45, -0.55, -0.75], [0.75, -0.25, -0.55], [0.1, -0.75, 0.55]])


@dataclass(frozen=True, eq=False)
class Lights:
    """Directional lights in the camera's frame and an ambient sky.

    Parameters
    ----------
    directions : ndarray of shape (N, 3)
        Vectors towards each light (x right, y down, z away from the viewer); need not be of unit length.
    colours : ndarray of shape (N, 3)
        Linear RGB intensity of each light.
    sky, ground : tuple of 3 floats
        Linear RGB of the ambient light from above and from below.
    """

    directions: NDArray[np.float64] = field(default_factory=_studio_directions)
    colours: NDArray[np.float64] = field(
        default_factory=lambda: np.array([[0.66, 0.63, 0.60], [0.25, 0.27, 0.31], [0.25, 0.25, 0.25]])
    )
    sky: tuple[float, float, float] = (0.29, 0.30, 0.32)
    ground: tuple[float, float, float] = (0.15, 0.14, 0.13)


@dataclass(frozen=True, eq=False)
class Rendering:
    """A picture and what is in it.

    Parameters
    ----------
    image : ndarray of shape (H, W, 3), uint8
        sRGB picture over the background.
    coverage : ndarray of shape (H, W), float32
        Share of the pixel that the mesh covers, 0 to 1.
    """

    image: NDArray[np.uint8]
    coverage: NDArray[np.float32]


def render_mesh(
    camera_vertices: NDArray[np.floating],
    pixels: NDArray[np.floating],
    faces: NDArray[np.integer],
    size: tuple[int, int],
    *,
    albedo: Albedo | None = None,
    lights: Lights | None = None,
    background: NDArray[np.uint8] | tuple[int, int, int] = (240, 240, 242),
    shininess: NDArray[np.floating] | float = 0.12,
    perspective: bool = True,
    supersample: int = 2,
) -> Rendering:
    """Draw a mesh with smooth shading.

    Parameters
    ----------
    camera_vertices : ndarray of shape (V, 3), millimetres
        Vertices in the camera's frame (x right, y down, z away): for shading, and z for visibility.
    pixels : ndarray of shape (V, 2), pixels
        Projections of the vertices.
    faces : ndarray of shape (F, 3)
        Triangles, counter-clockwise seen from outside.
    size : (height, width)
        Size of the picture.
    albedo : ndarray of shape (V, 3), or a function of Fragments to (H, W, 3), optional
        sRGB surface colour in [0, 1]; plaster grey where absent. The function is called at the supersampled size.
    lights : Lights, optional
        Studio lights where absent.
    background : ndarray of shape (H, W, 3), uint8, or one sRGB colour
        What the mesh is drawn over.
    shininess : float or ndarray of shape (V,)
        Strength of the highlight, 0 to 1.
    perspective : bool
        Whether `pixels` come from a pinhole (else weak perspective).
    supersample : int
        Samples per pixel side.

    Returns
    -------
    Rendering
        Picture and coverage.

    Raises
    ------
    ShapeError, ValueRangeError
        If arrays do not match.
    """
    sizes = check_shape("camera_vertices", camera_vertices, "V", 3)
    check_shape("pixels", pixels, "V", 2, **sizes)
    lights = lights or Lights()
    height, width = size
    s = int(supersample)
    # centre of the first pixel is (0, 0) at both resolutions
    fine_pixels = (np.asarray(pixels, dtype=np.float64) + 0.5) * s - 0.5
    fragments = rasterise(fine_pixels, camera_vertices[:, 2], faces, (height * s, width * s), perspective=perspective)
    covered = fragments.covered
    linear = np.zeros((height * s, width * s, 3), np.float32)
    if covered.any():
        linear[covered] = shade_fragments(
            fragments, camera_vertices, faces, albedo=albedo, lights=lights, shininess=shininess
        )
    weight = covered.reshape(height, s, width, s).mean(axis=(1, 3), dtype=np.float32)
    linear = linear.reshape(height, s, width, s, 3).mean(axis=(1, 3))
    base = np.broadcast_to(np.asarray(background, dtype=np.float32) / 255.0, (height, width, 3))
    over = linear + (1.0 - weight[..., None]) * linear_from_srgb(base)
    image = np.round(srgb_from_linear(over) * 255.0).astype(np.uint8)
    if isinstance(background, np.ndarray) and background.ndim == 3:
        image[weight == 0] = background[weight == 0]  # untouched to the last bit
    return Rendering(image, weight)


def shade_fragments(
    fragments: Fragments,
    camera_vertices: NDArray[np.floating],
    faces: NDArray[np.integer],
    *,
    albedo: Albedo | None = None,
    lights: Lights | None = None,
    shininess: NDArray[np.floating] | float = 0.12,
    normals: NDArray[np.floating] | None = None,
) -> NDArray[np.float32]:
    """Return the linear colour of the covered samples of a rasterised mesh, shape (N, 3); see `render_mesh`.

    `normals` (V, 3), of unit length and in the camera's frame, spare their computation where they are known.
    """
    lights = lights or Lights()
    covered = fragments.covered
    n_vertices = len(camera_vertices)
    # vertex_normals points outwards for counter-clockwise triangles in a right-handed frame, which x right, y down,
    # z away is too
    if normals is None:
        normals = vertex_normals(np.asarray(camera_vertices, dtype=np.float64), faces)
    gloss = np.broadcast_to(np.asarray(shininess, dtype=np.float32), (n_vertices,))
    packed = np.concatenate([normals, camera_vertices, gloss[:, None]], axis=1)
    values = fragments.interpolate(faces, packed)[covered]
    n, view = _unit(values[:, :3]), _unit(-values[:, 3:6])
    n = np.where(_dot(n, view)[:, None] < -0.2, -n, n)  # inner walls seen from behind
    colour = _albedo_samples(fragments, covered, faces, albedo, n_vertices)
    up = 0.5 - 0.5 * n[:, 1:2]
    light = up * np.asarray(lights.sky, np.float32) + (1 - up) * np.asarray(lights.ground, np.float32)
    highlight = np.zeros_like(light)
    for direction, intensity in zip(np.asarray(lights.directions, np.float64), np.asarray(lights.colours, np.float32)):
        towards = (direction / np.linalg.norm(direction)).astype(np.float32)
        cosine = n @ towards
        # wrapped diffuse: light bleeds a little past the terminator in skin
        diffuse = np.clip((cosine + 0.25) / 1.25, 0.0, None) ** 1.3
        half = _unit(view + towards)
        sheen = _power_22(np.clip(_dot(n, half), 0.0, None)) * (cosine > 0)
        light += diffuse[:, None] * intensity
        highlight += sheen[:, None] * intensity
    return _roll_off(colour * light + values[:, 6:7] * highlight).astype(np.float32)


def _dot(a: NDArray[Any], b: NDArray[Any]) -> NDArray[Any]:
    return np.einsum("ij,ij->i", a, b)


def _unit(vectors: NDArray[Any]) -> NDArray[Any]:
    return vectors / np.maximum(np.sqrt(_dot(vectors, vectors)), 1e-9)[:, None]


def _power_22(x: NDArray[Any]) -> NDArray[Any]:
    """Return x^22; products are several times as fast as NumPy's power."""
    x2 = x * x
    x4 = x2 * x2
    x8 = x4 * x4
    return x8 * x8 * x4 * x2


def _roll_off(linear: NDArray[np.floating], knee: float = 0.7) -> NDArray[np.floating]:
    """Compress what is brighter than `knee` smoothly below 1: clipped channels would change the hue of bright skin."""
    over = np.maximum(linear - knee, 0.0)
    return np.minimum(linear, knee) + (1.0 - knee) * -np.expm1(-over / (1.0 - knee))


def _albedo_samples(
    fragments: Fragments,
    covered: NDArray[np.bool_],
    faces: NDArray[np.integer],
    albedo: Albedo | None,
    n_vertices: int,
) -> NDArray[np.float32]:
    """Return the linear surface colour of the covered samples, shape (N, 3)."""
    if albedo is None:
        return np.full((int(covered.sum()), 3), 0.62, np.float32)
    if callable(albedo):
        return linear_from_srgb(albedo(fragments)[covered])
    check_shape("albedo", albedo, n_vertices, 3)
    return fragments.interpolate(faces, linear_from_srgb(albedo))[covered]
