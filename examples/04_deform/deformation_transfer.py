"""Carry the generic expressions over to another head: docs/images/deformation_transfer.png."""

import argparse
from pathlib import Path

import numpy as np

from facewright.apps.paint_person import portrait_painter
from facewright.deform.deformation_transfer import DeformationTransfer
from facewright.faces import load_face
from facewright.faces.expressions import expression_weights
from facewright.faces.simulate import simulate_neutrals
from facewright.imaging.contact_sheet import contact_sheet
from facewright.io.image import write_image

ACTS = ("neutral", "mouth_stretch", "smile", "lip_funneler", "anger")


def main(out: Path) -> None:
    """Draw the generic face above and another person below, with the same expressions."""
    face = load_face("builtin")
    other = simulate_neutrals(face, 1, np.random.default_rng(12))[0]
    weights = np.stack([expression_weights(act) for act in ACTS])
    source = face.mean_shape + np.tensordot(weights, face.blendshape_deltas, axes=1)
    carried = other + source - face.mean_shape  # teeth and eyeballs move as they do in the generic face
    soft = face.topology.submesh(face.topology.parts["mouth_cavity"][1])  # skin and mouth cavity, in one piece
    n = soft.n_vertices
    carried[:, :n] = DeformationTransfer(face.mean_shape[:n], other[:n], soft.faces).transfer(source[:, :n])
    draw = portrait_painter(face.topology, None, (260, 220), yaw_degrees=20.0)
    pictures = [draw(vertices) for vertices in (*source, *carried)]
    captions = [f"{who}: {act.replace('_', ' ')}" for who in ("generic", "another") for act in ACTS]
    write_image(out / "deformation_transfer.png", contact_sheet(pictures, captions))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    main(parser.parse_args().out)
