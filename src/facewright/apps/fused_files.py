"""The files that a fused recording becomes: depth, camera, picture, points, mesh, and sheets to look at."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from facewright.camera.pinhole import Intrinsics
    from facewright.capture.fused_depth import FusedDepth
    from facewright.faces.face import Face
    from facewright.fitting.scan import ScanFit
    from facewright.landmarks.points import Landmarks

_PICTURE_HEIGHT = 560
_MOST_ERROR_MM = 3.0
_AROUND = 0.06  # of the face rectangle, drawn on each side
_CAMERA_FRAME = "the reference frame's camera, millimetres: x right, y down, z ahead"


def write_fused(
    folder: Path, raw_depth: NDArray[np.floating], fused: FusedDepth, landmarks: Landmarks | None
) -> dict[str, str]:
    """Write depth, camera, picture, points and sheet.

    Parameters
    ----------
    folder : Path
        An existing folder.
    raw_depth : ndarray of shape (H, W), millimetres
        Of the reference frame, as the camera gave it.
    fused : FusedDepth
        Of its recording.
    landmarks : Landmarks, optional
        Of its picture.

    Returns
    -------
    dict of str to str
        ``depth``, ``camera``, ``color``, ``picture``, ``points`` -> the file's name.
    """
    from facewright.capture.tum_writer import DEPTH_PER_METRE
    from facewright.io.atomic import write_atomically
    from facewright.io.frame_image import encode_depth
    from facewright.io.image import write_image

    names = {"depth": "depth.png", "camera": "camera.json", "color": "color.png", "picture": "fusion.png"}
    counts = np.rint(fused.depth * np.float64(DEPTH_PER_METRE / 1000.0))
    counts[counts > np.iinfo(np.uint16).max] = 0
    with write_atomically(folder / names["depth"]) as temporary:
        temporary.write_bytes(encode_depth(counts.astype(np.uint16)))
    write_json(folder / names["camera"], _camera(fused.intrinsics, fused.depth.shape, DEPTH_PER_METRE))
    write_image(folder / names["color"], fused.color)
    write_image(folder / names["picture"], fusion_sheet(raw_depth, fused, landmarks))
    return names | {"points": _write_points(folder / "points.ply", fused)}


def _camera(k: Intrinsics, size: tuple[int, ...], depth_per_metre: float) -> dict[str, Any]:
    return {
        "width": size[1],
        "height": size[0],
        "fx": k.focal_x,
        "fy": k.focal_y,
        "cx": k.centre_x,
        "cy": k.centre_y,
        "depth_per_metre": depth_per_metre,
    }


def _write_points(file: Path, fused: FusedDepth) -> str:
    """Write the fused surface's points, with normals and colours; returns the file's name."""
    from facewright.camera.depth_map import back_project, depth_normals
    from facewright.io.ply import write_ply

    grid = back_project(fused.depth, fused.intrinsics)
    normals = depth_normals(grid)
    seen = np.isfinite(normals).all(axis=2) & (fused.depth > 0)
    write_ply(
        file,
        grid[seen].astype(np.float32),
        normals=normals[seen],
        vertex_colors=fused.color[seen],
        comments=(f"facewright: fused depth, in the frame of {_CAMERA_FRAME}",),
    )
    return file.name


def write_fitted(
    folder: Path,
    name: str,
    face: Face,
    fused: FusedDepth,
    fit: ScanFit,
    vertices: NDArray[np.float64],
    on_scan: bool,
) -> dict[str, str]:
    """Write the mesh and the picture of its errors.

    Parameters
    ----------
    folder : Path
        An existing folder.
    name : str
        Of the recording, for the file's comment.
    face : Face
        The template.
    fused : FusedDepth
        What it was fitted to.
    fit : ScanFit
        Of the skin.
    vertices : ndarray of shape (V, 3), millimetres
        All parts of the face, in model space.
    on_scan : bool
        Write the mesh in the camera's frame instead of model space.

    Returns
    -------
    dict of str to str
        ``mesh``, ``errors`` -> the file's name.
    """
    from facewright.apps.scan_pictures import fit_pictures, fit_sheet
    from facewright.io.image import write_image
    from facewright.io.obj import write_obj

    names = {"mesh": "face.obj", "errors": "fit.png"}
    where = f"the frame of {_CAMERA_FRAME}" if on_scan else "model space, millimetres"
    write_obj(
        folder / names["mesh"],
        fit.target_from_model.apply(vertices) if on_scan else vertices,
        face.topology.faces,
        uv=face.topology.uv,
        uv_faces=face.topology.uv_faces,
        comment=f"facewright: {face.name} fitted to {name}, in {where}",
    )
    pictures = fit_pictures(
        fit, face.skin().topology, fused.color, fused.depth, fused.intrinsics, most_mm=_MOST_ERROR_MM
    )
    errors = f"distances, 0-{_MOST_ERROR_MM:g} mm"
    labels = ["picture", "fused depth", "stage 1", "stage 2", f"stage 1: {errors}", f"stage 2: {errors}", "overlay"]
    write_image(folder / names["errors"], fit_sheet([pictures], labels))
    return names


def write_json(file: Path, values: dict[str, Any]) -> str:
    """Write values as a JSON file; returns its name."""
    from facewright.io.atomic import write_atomically

    with write_atomically(file) as temporary:
        temporary.write_text(json.dumps(values, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    return file.name


def fusion_sheet(
    raw_depth: NDArray[np.floating], fused: FusedDepth, landmarks: Landmarks | None, height: int = _PICTURE_HEIGHT
) -> NDArray[np.uint8]:
    """Draw colour with landmarks, one frame's depth and the fused depth beside each other, (H, W, 3), uint8.

    Parameters
    ----------
    raw_depth : ndarray of shape (H, W), millimetres
        The reference frame.
    fused : FusedDepth
        Of its recording.
    landmarks : Landmarks, optional
        Of its picture.
    height : int
        Of each picture, pixels.
    """
    from PIL import Image

    from facewright.apps.scan_pictures import depth_picture
    from facewright.camera.pinhole import Intrinsics
    from facewright.imaging.contact_sheet import contact_sheet
    from facewright.imaging.overlay import draw_points

    left, top, right, bottom = _around(fused.rectangle, fused.depth.shape)
    zoom = height / (bottom - top)
    size = height, max(round((right - left) * zoom), 1)
    k = fused.intrinsics
    camera = Intrinsics(
        k.focal_x * zoom,
        k.focal_y * zoom,
        (k.centre_x + 0.5 - left) * zoom - 0.5,
        (k.centre_y + 0.5 - top) * zoom - 0.5,
    )
    cut = Image.fromarray(fused.color[top:bottom, left:right])
    color = np.asarray(cut.resize(size[::-1], Image.Resampling.BICUBIC))
    if landmarks is not None:
        color = draw_points(color, (landmarks.points + 0.5 - (left, top)) * zoom - 0.5)
    one, all_frames = (depth_picture(depth, k, camera, size) for depth in (raw_depth, fused.depth))
    n = fused.report.n_fused
    captions = [f"frame {fused.reference}", "depth of this frame", f"depth fused of {n} frame{'s' if n != 1 else ''}"]
    return contact_sheet([color, one, all_frames], captions, columns=3)


def _around(box: tuple[int, int, int, int], size: tuple[int, ...]) -> tuple[int, int, int, int]:
    side = round(_AROUND * max(box[2] - box[0], box[3] - box[1]))
    return max(box[0] - side, 0), max(box[1] - side, 0), min(box[2] + side, size[1]), min(box[3] + side, size[0])
