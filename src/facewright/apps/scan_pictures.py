"""Pictures of scan fits: the picture and depth of a capture, the meshes of both stages, and their errors in colour."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from facewright.camera.depth_map import back_project, depth_normals
from facewright.camera.pinhole import Intrinsics
from facewright.fitting.scan import ScanFit
from facewright.imaging.contact_sheet import contact_sheet
from facewright.imaging.render import render_mesh
from facewright.mesh.closest_point import closest_points
from facewright.mesh.topology import Topology
from facewright.numeric.check import check_shape

#: Colours from no error to the largest shown, sRGB, as in FaceWarehouse Fig. 2; grey where there is none to measure.
_SCALE = np.array([[38, 62, 148], [54, 148, 190], [110, 190, 110], [250, 208, 70], [214, 50, 40]]) / 255.0
_UNKNOWN = np.array([0.62, 0.62, 0.62])
_BACKGROUND = (240, 240, 242)


def error_colours(distances_mm: NDArray[np.floating], most_mm: float = 3.0) -> NDArray[np.float64]:
    """Return sRGB colours (N, 3) in [0, 1] of distances (N,): blue at 0, red from `most_mm`, grey where not finite."""
    check_shape("distances_mm", distances_mm, "N")
    known = np.isfinite(distances_mm)
    place = np.clip(np.where(known, distances_mm, 0.0) / most_mm, 0.0, 1.0) * (len(_SCALE) - 1)
    colours = np.stack([np.interp(place, np.arange(len(_SCALE)), _SCALE[:, k]) for k in range(3)], axis=1)
    colours[~known] = _UNKNOWN
    return colours


def zoomed_camera(
    points: NDArray[np.floating], intrinsics: Intrinsics, size: tuple[int, int], margin: float = 0.12
) -> Intrinsics:
    """Return the camera whose picture of `size` (height, width) shows the points (N, 3) with a margin round them."""
    pixels = intrinsics.project(points)
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    middle, extent = 0.5 * (low + high), np.maximum(high - low, 1e-6) * (1.0 + 2.0 * margin)
    zoom = float(min(size[1] / extent[0], size[0] / extent[1]))
    return Intrinsics(
        intrinsics.focal_x * zoom,
        intrinsics.focal_y * zoom,
        (intrinsics.centre_x - middle[0]) * zoom + (size[1] - 1) / 2,
        (intrinsics.centre_y - middle[1]) * zoom + (size[0] - 1) / 2,
    )


def mesh_picture(
    posed: NDArray[np.floating],
    topology: Topology,
    camera: Intrinsics,
    size: tuple[int, int],
    colours: NDArray[np.floating] | None = None,
    background: NDArray[np.uint8] | tuple[int, int, int] = _BACKGROUND,
) -> NDArray[np.uint8]:
    """Draw a mesh (V, 3) of the camera's frame, in plaster or with vertex colours (V, 3); (H, W, 3), uint8."""
    shine = 0.12 if colours is None else 0.0
    return render_mesh(
        posed, camera.project(posed), topology.faces, size, albedo=colours, background=background, shininess=shine
    ).image


def depth_picture(
    depth: NDArray[np.floating], intrinsics: Intrinsics, camera: Intrinsics, size: tuple[int, int]
) -> NDArray[np.uint8]:
    """Draw a depth map as a lit surface, as another (zoomed) camera at the same place sees it; (H, W, 3), uint8."""
    normals = depth_normals(back_project(depth, intrinsics))
    light = np.array([-0.35, -0.45, -0.82])
    shade = np.clip(normals @ light, 0.0, 1.0)
    grey = np.where(np.isfinite(shade), 40.0 + 200.0 * shade, 240.0)
    return _resample(np.repeat(grey[..., None], 3, axis=2), intrinsics, camera, size)


def _resample(picture: NDArray, intrinsics: Intrinsics, camera: Intrinsics, size: tuple[int, int]) -> NDArray[np.uint8]:
    """Show a picture as a camera at the same place with other intrinsics sees it, nearest pixel."""
    height, width = picture.shape[:2]
    x = (np.arange(size[1]) - camera.centre_x) / camera.focal_x * intrinsics.focal_x + intrinsics.centre_x
    y = (np.arange(size[0]) - camera.centre_y) / camera.focal_y * intrinsics.focal_y + intrinsics.centre_y
    column, row = np.rint(x).astype(int), np.rint(y).astype(int)
    shown = picture[np.clip(row, 0, height - 1)[:, None], np.clip(column, 0, width - 1)[None, :]].copy()
    outside = ((row < 0) | (row >= height))[:, None] | ((column < 0) | (column >= width))[None, :]
    shown[outside] = _BACKGROUND
    return np.clip(np.rint(shown), 0, 255).astype(np.uint8)


def fit_pictures(
    fit: ScanFit,
    topology: Topology,
    color: NDArray[np.uint8],
    depth: NDArray[np.floating],
    intrinsics: Intrinsics,
    *,
    size: tuple[int, int] = (480, 400),
    most_mm: float = 3.0,
    truth: NDArray[np.floating] | None = None,
) -> list[NDArray[np.uint8]]:
    """Draw a fit as FaceWarehouse Fig. 2 does: picture, depth, both stages' meshes, both stages' errors, overlay.

    Parameters
    ----------
    fit : ScanFit
        Of a depth map.
    topology : Topology
        Of the fitted skin.
    color : ndarray of shape (H, W, 3), uint8
        The reference picture.
    depth : ndarray of shape (H, W), millimetres
        The depth map that was fitted.
    intrinsics : Intrinsics
        Of both.
    size : (height, width)
        Of each picture.
    most_mm : float
        The error drawn in red.
    truth : ndarray of shape (V, 3), millimetres, optional
        The true mesh in the camera's frame, where it is known: errors are then distances from it, and it is drawn, too.

    Returns
    -------
    list of ndarray of shape (H, W, 3), uint8
        Picture, depth, stage 1, stage 2, errors of stage 1, errors of stage 2, mesh over the picture, and the truth.
    """
    stage1, stage2 = fit.target_from_model.apply(fit.stage1_vertices), fit.posed
    region = topology.masks.get("face_region", np.arange(topology.n_vertices))
    camera = zoomed_camera(stage2[region], intrinsics, size)
    shown = _resample(color, intrinsics, camera, size)
    pictures = [shown, depth_picture(depth, intrinsics, camera, size)]
    pictures += [mesh_picture(x, topology, camera, size) for x in (stage1, stage2)]
    for x in (stage1, stage2):
        if truth is None:
            seen = intrinsics.project(x)
            distances = np.abs(x[:, 2] - _depth_at(depth, seen))
            distances[distances > 10.0 * most_mm] = np.nan
        else:
            distances = closest_points(truth, topology.faces, x).distances
        pictures.append(mesh_picture(x, topology, camera, size, error_colours(distances, most_mm)))
    over = mesh_picture(stage2, topology, camera, size, background=shown)
    pictures.append((0.5 * shown + 0.5 * over).astype(np.uint8))
    if truth is not None:
        pictures.append(mesh_picture(truth, topology, camera, size))
    return pictures


def _depth_at(depth: NDArray[np.floating], pixels: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the depth (N,) at the nearest pixels; NaN outside and where there is none."""
    column, row = np.rint(pixels[:, 0]).astype(int), np.rint(pixels[:, 1]).astype(int)
    inside = (column >= 0) & (column < depth.shape[1]) & (row >= 0) & (row < depth.shape[0])
    z = np.where(inside, depth[np.where(inside, row, 0), np.where(inside, column, 0)], 0.0)
    return np.where(z > 0, z, np.nan)


def fit_sheet(rows: list[list[NDArray[np.uint8]]], labels: list[str] | None = None) -> NDArray[np.uint8]:
    """Put the pictures of several fits on one sheet, a row for each; labels, if given, one for each picture."""
    return contact_sheet([picture for row in rows for picture in row], labels, columns=max(len(row) for row in rows))
