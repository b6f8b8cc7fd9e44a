"""A portrait of a mesh: a pinhole camera in front of the face, turned by yaw, pitch and roll."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from facewright.imaging.render import Albedo, Lights, Rendering, render_mesh
from facewright.numeric.check import check_shape


def portrait_view(
    vertices: NDArray[np.floating],
    size: tuple[int, int],
    *,
    yaw_degrees: float = 0.0,
    pitch_degrees: float = 0.0,
    roll_degrees: float = 0.0,
    distance_mm: float = 800.0,
    centre_mm: tuple[float, float, float] = (0.0, -10.0, 40.0),
    height_mm: float = 330.0,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Place a pinhole camera before a head and project it.

    Parameters
    ----------
    vertices : ndarray of shape (V, 3), millimetres
        Vertices in model space (y up, face along +z).
    size : (height, width)
        Size of the picture in pixels.
    yaw_degrees, pitch_degrees, roll_degrees : float
        Turn of the head: yaw > 0 turns the face towards its own left (the picture's right), pitch > 0 looks up,
        roll > 0 leans towards the picture's right.
    distance_mm : float
        From the camera to `centre_mm`.
    centre_mm : (x, y, z)
        Model point in the middle of the picture, about which the head turns.
    height_mm : float
        Extent of the picture at that distance, top to bottom.

    Returns
    -------
    camera_vertices : ndarray of shape (V, 3), float64, millimetres
        Vertices in the camera's frame (x right, y down, z away).
    pixels : ndarray of shape (V, 2), float64
        Their projections.
    """
    check_shape("vertices", vertices, "V", 3)
    height, width = size
    cy, sy = np.cos(np.deg2rad(yaw_degrees)), np.sin(np.deg2rad(yaw_degrees))
    cp, sp = np.cos(np.deg2rad(pitch_degrees)), np.sin(np.deg2rad(pitch_degrees))
    cr, sr = np.cos(np.deg2rad(roll_degrees)), np.sin(np.deg2rad(roll_degrees))
    yaw = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    pitch = np.array([[1, 0, 0], [0, cp, sp], [0, -sp, cp]])
    roll = np.array([[cr, sr, 0], [-sr, cr, 0], [0, 0, 1]])
    turned = (np.asarray(vertices, dtype=np.float64) - centre_mm) @ (roll @ pitch @ yaw).T
    camera = turned * [1.0, -1.0, -1.0] + [0.0, 0.0, distance_mm]
    focal = height * distance_mm / height_mm
    pixels = camera[:, :2] / camera[:, 2:] * focal + [(width - 1) / 2, (height - 1) / 2]
    return camera, pixels


def render_portrait(
    vertices: NDArray[np.floating],
    faces: NDArray[np.integer],
    size: tuple[int, int] = (512, 448),
    *,
    albedo: Albedo | None = None,
    lights: Lights | None = None,
    background: NDArray[np.uint8] | tuple[int, int, int] = (240, 240, 242),
    shininess: NDArray[np.floating] | float = 0.12,
    supersample: int = 2,
    yaw_degrees: float = 0.0,
    pitch_degrees: float = 0.0,
    roll_degrees: float = 0.0,
    distance_mm: float = 800.0,
    centre_mm: tuple[float, float, float] = (0.0, -10.0, 40.0),
    height_mm: float = 330.0,
) -> Rendering:
    """Draw a head; see `portrait_view` for the camera and `render_mesh` for the rest."""
    camera, pixels = portrait_view(
        vertices,
        size,
        yaw_degrees=yaw_degrees,
        pitch_degrees=pitch_degrees,
        roll_degrees=roll_degrees,
        distance_mm=distance_mm,
        centre_mm=centre_mm,
        height_mm=height_mm,
    )
    return render_mesh(
        camera,
        pixels,
        faces,
        size,
        albedo=albedo,
        lights=lights,
        background=background,
        shininess=shininess,
        supersample=supersample,
    )
