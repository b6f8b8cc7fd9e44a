"""Describe a face and draw its expressions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from facewright.errors import ValueRangeError

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class ShowFaceRequest:
    """Which face to look at.

    Parameters
    ----------
    face : str
        Name or path, see `facewright.faces.load_face`.
    out : Path, optional
        Picture of the 20 expressions to write.
    seed : int, optional
        Draw a simulated person in place of the mean.
    size : (height, width)
        Pixels of each portrait.
    """

    face: str = "builtin"
    out: Path | None = None
    seed: int | None = None
    size: tuple[int, int] = (256, 208)

    def __post_init__(self) -> None:
        if self.seed is not None and self.seed < 0:
            raise ValueRangeError(f"seed must not be negative, got {self.seed}.")


def show_face(request: ShowFaceRequest, progress: Progress | None = None) -> dict[str, Any]:
    """Return a face's sizes, parts and licence as JSON values, and write its picture if one is asked for.

    Raises
    ------
    MissingFaceError
        If the face is unknown or not installed.
    StoreError
        If the picture cannot be written.
    """
    from facewright.faces import load_face

    face = load_face(request.face)
    topology = face.topology
    if request.out is not None:
        _draw(request, progress)
    return {
        "name": face.name,
        "vertices": topology.n_vertices,
        "skin_vertices": face.n_skin,
        "triangles": len(topology.faces),
        "identity_modes": len(face.identity_basis),
        "blendshapes": len(face.blendshape_names),
        "parts": {name: stop - start for name, (start, stop) in topology.parts.items()},
        "landmark_schemes": sorted(topology.landmarks),
        "fingerprint": topology.fingerprint,
        "licence": face.licence,
        **({"picture": str(request.out)} if request.out is not None else {}),
    }


def _draw(request: ShowFaceRequest, progress: Progress | None) -> None:
    from facewright.apps.paint_person import portrait_painter
    from facewright.faces import load_face
    from facewright.faces.expressions import EXPRESSION_NAMES, expression_weights
    from facewright.faces.simulate import simulate_person
    from facewright.imaging.contact_sheet import contact_sheet
    from facewright.io.image import write_image
    from facewright.models.blendshapes import BlendshapeRig

    face = load_face(request.face)
    if request.seed is None:
        rig = BlendshapeRig(face.mean_shape, face.blendshape_names, face.blendshape_deltas)
    else:
        person = simulate_person(face, np.random.default_rng(request.seed))
        rig = BlendshapeRig(person.neutral, face.blendshape_names, person.deltas)
    paint = portrait_painter(face.topology, face, request.size, yaw_degrees=15.0, seed=request.seed)
    pictures = []
    for k, name in enumerate(EXPRESSION_NAMES):
        pictures.append(paint(rig.pose(expression_weights(name))))
        if progress is not None:
            progress("drawing expressions", k + 1, len(EXPRESSION_NAMES))
    assert request.out is not None
    write_image(request.out, contact_sheet(pictures, EXPRESSION_NAMES, columns=5))
