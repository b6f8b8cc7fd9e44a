"""A picture of a fitted scan: scan, mesh, mesh lines over the scan and distances, from three sides."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from facewright.apps.scan_pictures import error_colours
from facewright.camera.rotation import rotation_from_vector
from facewright.fitting.scan import ScanFit
from facewright.fitting.scan_target import ScanTarget
from facewright.imaging.contact_sheet import contact_sheet
from facewright.imaging.overlay import draw_mesh_lines
from facewright.imaging.render import render_mesh
from facewright.imaging.scan_views import ScanViewer
from facewright.mesh.closest_point import ClosestPoints
from facewright.mesh.topology import Topology
from facewright.numeric.similarity import Similarity

_YAWS = (0.0, 50.0, -50.0)
_MIDDLE, _RADIUS_MM = (0.0, -5.0, 70.0), 125.0
#: The distance that is drawn in red, mm; beyond ten times as much there is no scan to measure.
_MOST_MM = 2.0


def scan_sheet(
    viewer: ScanViewer,
    topology: Topology,
    fit: ScanFit,
    target: ScanTarget,
    scan_from_model: Similarity,
    size: int = 480,
) -> NDArray[np.uint8]:
    """Draw a fitted scan.

    Parameters
    ----------
    viewer : ScanViewer
        The scan.
    topology : Topology
        Of the fitted skin.
    fit : ScanFit
        The fit.
    target : ScanTarget
        What it was fitted to, for the distances.
    scan_from_model : Similarity
        From the fit's model space to the scan.
    size : int
        Side of each picture, pixels.

    Returns
    -------
    ndarray of shape (H, W, 3), uint8
        A row for each side: scan, mesh, mesh lines over the scan, mesh coloured by its distance from the scan (blue 0,
        red 2 mm and more, grey where there is no scan).
    """
    vertices = scan_from_model.apply(fit.vertices)
    distances = ClosestPoints(target.points, target.faces).query(fit.posed, 10.0 * _MOST_MM).distances
    colours = error_colours(distances, _MOST_MM)
    region = np.zeros(topology.n_vertices, dtype=bool)
    region[topology.masks.get("face_region", np.arange(topology.n_vertices))] = True
    polygons = topology.faces if topology.quads is None else topology.quads
    polygons = polygons[np.append(region, True)[polygons].all(axis=1)]  # -1 pads a triangle
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
        rotation, translation = view.camera_from_scan
        # the renderer's tolerances are in mm
        seen = (vertices @ rotation.T + translation) / scan_from_model.scale
        pixels = view.intrinsics.project(seen)
        plain = render_mesh(seen, pixels, topology.faces, (size, size)).image
        lines = draw_mesh_lines(view.image, pixels, seen[:, 2], topology.faces, polygons, opacity=0.6)
        errors = render_mesh(seen, pixels, topology.faces, (size, size), albedo=colours, shininess=0.0).image
        pictures += [view.image, plain, lines, errors]
    labels = ["scan", "mesh", "mesh over scan", f"distance, red from {_MOST_MM:g} mm"] * len(_YAWS)
    return contact_sheet(pictures, labels, columns=4)
