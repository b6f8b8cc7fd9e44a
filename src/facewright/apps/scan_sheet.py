"""A picture of a fitted scan: scan, mesh, mesh lines over the scan and distances, from three sides."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from facewright.apps.export import OVERLAY_PARTS
from facewright.apps.paint_person import usual_appearance
from facewright.apps.scan_pictures import error_colours
from facewright.camera.rotation import rotation_from_vector
from facewright.faces.appearance import vertex_colors
from facewright.faces.face import Face
from facewright.fitting.scan import ScanFit
from facewright.fitting.scan_target import ScanTarget
from facewright.imaging.contact_sheet import contact_sheet
from facewright.imaging.overlay import draw_mesh_lines
from facewright.imaging.render import Albedo, render_mesh
from facewright.imaging.scan_views import ScanView, ScanViewer
from facewright.imaging.texture import texture_albedo
from facewright.mesh.closest_point import ClosestPoints
from facewright.mesh.topology import Topology
from facewright.numeric.similarity import Similarity

_YAWS = (0.0, 50.0, -50.0)
_MIDDLE, _RADIUS_MM = (0.0, -5.0, 70.0), 125.0
#: The distance that is drawn in red, and that beyond which there is no scan to measure; mm.
_MOST_MM = 2.0
_FAR_MM = 15.0
_SKIN = 0.8


def scan_sheet(
    viewer: ScanViewer,
    face: Face,
    vertices: NDArray[np.floating],
    fit: ScanFit,
    target: ScanTarget,
    scan_from_model: Similarity,
    texture: NDArray[np.uint8] | None = None,
    size: int = 480,
) -> NDArray[np.uint8]:
    """Draw a fitted scan.

    Parameters
    ----------
    viewer : ScanViewer
        The scan.
    face : Face
        The template.
    vertices : ndarray of shape (V, 3), millimetres
        All its parts as fitted, in model space.
    fit : ScanFit
        The fit of its skin.
    target : ScanTarget
        What it was fitted to, for the distances.
    scan_from_model : Similarity
        From the fit's model space to the scan.
    texture : ndarray of shape (H, W, 3), uint8, optional
        The fitted mesh's texture.
    size : int
        Side of each picture, pixels.

    Returns
    -------
    ndarray of shape (H, W, 3), uint8
        A row for each side: scan, mesh, mesh with texture (where there is one), mesh lines over the scan, mesh coloured
        by its distance from the scan (blue 0, red 2 mm and more, grey where there is no scan to measure).
    """
    distances = ClosestPoints(target.points, target.faces).query(fit.posed, _FAR_MM).distances
    colours = error_colours(distances, _MOST_MM)
    plaster = _plaster(face)
    shown = _without_overlays(face.topology)
    textured = None
    if texture is not None:
        on_skin = np.arange(len(plaster)) < face.n_skin
        textured = texture_albedo(texture, shown, textured=on_skin, rest=plaster)
    labels = ["scan", "mesh", *(["with the scan's colours"] if textured is not None else []), "mesh over scan"]
    labels.append(f"distance, red from {_MOST_MM:g} mm")
    pictures = []
    for yaw in _YAWS:
        turn = rotation_from_vector([0.0, np.deg2rad(yaw), 0.0])
        view = viewer.view(
            turn @ scan_from_model.rotation.T,
            middle=scan_from_model.apply(np.array(_MIDDLE)),
            radius=_RADIUS_MM * scan_from_model.scale,
            size=size,
            supersample=2,
        )
        pictures.append(view.image)
        pictures += _mesh_pictures(view, face, shown, vertices, scan_from_model, plaster, textured, colours)
    return contact_sheet(pictures, labels * len(_YAWS), columns=len(labels))


def _mesh_pictures(
    view: ScanView,
    face: Face,
    shown: Topology,
    vertices: NDArray[np.floating],
    scan_from_model: Similarity,
    plaster: NDArray[np.float64],
    textured: Albedo | None,
    colours: NDArray[np.float64],
) -> list[NDArray[np.uint8]]:
    """Draw the mesh as a view of the scan sees it: plain, textured, as lines, coloured by distance."""
    size = view.image.shape[0], view.image.shape[1]
    n = face.n_skin
    rotation, translation = view.camera_from_scan
    # in mm, as what draws lines expects
    seen = (scan_from_model.apply(vertices) @ rotation.T + translation) / scan_from_model.scale
    pixels = view.intrinsics.project(seen)
    albedos = [plaster] if textured is None else [plaster, textured]
    pictures = [render_mesh(seen, pixels, shown.faces, size, albedo=albedo).image for albedo in albedos]
    skin = face.topology.submesh(n)
    region = np.zeros(n, dtype=bool)
    region[skin.masks.get("face_region", np.arange(n))] = True
    polygons = skin.faces if skin.quads is None else skin.quads
    polygons = polygons[np.append(region, True)[polygons].all(axis=1)]  # -1 pads a triangle
    lines = draw_mesh_lines(view.image, pixels[:n], seen[:n, 2], skin.faces, polygons, opacity=0.6)
    errors = render_mesh(seen[:n], pixels[:n], skin.faces, size, albedo=colours, shininess=0.0).image
    return [*pictures, lines, errors]


def _without_overlays(topology: Topology) -> Topology:
    """Return the topology without lashes, tear fluid and the like, which are see-through and drawn by no texture."""
    overlay = np.zeros(topology.n_vertices, dtype=bool)
    for name, (start, stop) in topology.parts.items():
        overlay[start:stop] = name.startswith(OVERLAY_PARTS)
    kept = ~overlay[topology.faces].any(axis=1)
    uv_faces = None if topology.uv_faces is None else topology.uv_faces[kept]
    return replace(topology, faces=topology.faces[kept], quads=None, uv_faces=uv_faces)


def _plaster(face: Face) -> NDArray[np.float64]:
    """Return sRGB colours (V, 3) in [0, 1]: grey skin, all else as it is."""
    colours = vertex_colors(face, usual_appearance(None)).astype(np.float64)
    colours[: face.n_skin] = _SKIN
    return colours
