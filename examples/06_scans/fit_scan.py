"""Fit a scan of unknown unit and orientation: docs/images/fit_scan.png. Needs the landmarks extra."""

import argparse
import tempfile
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from facewright.apps.fit_scan import FitScanRequest, fit_scan
from facewright.faces import load_face
from facewright.faces.appearance import sample_appearance, vertex_colors, visible_faces
from facewright.faces.expressions import expression_weights
from facewright.faces.simulate import simulate_person
from facewright.io.image import read_image, write_image
from facewright.io.ply import write_ply


def main(out: Path) -> None:
    """Scan a simulated person, turned and in metres, and fit the built-in face to the scan."""
    rng = np.random.default_rng(21)
    face = load_face("builtin")
    vertices = simulate_person(face, rng).pose(0.4 * expression_weights("smile")).astype(np.float64)
    vertices += rng.normal(0.0, 0.15, vertices.shape)  # a scanner's noise
    turned = 0.001 * Rotation.from_euler("xyz", [70.0, 25.0, 130.0], degrees=True).apply(vertices) + [1.0, 2.0, 0.5]
    colours = np.round(255 * vertex_colors(face, sample_appearance(rng))).astype(np.uint8)
    with tempfile.TemporaryDirectory() as folder:
        scan = Path(folder) / "scan.ply"
        write_ply(scan, turned, visible_faces(face), vertex_colors=colours)
        fitted = fit_scan(FitScanRequest(scan, Path(folder) / "fit"))
        write_image(out / "fit_scan.png", read_image(fitted.paths["picture"]))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    main(parser.parse_args().out)
