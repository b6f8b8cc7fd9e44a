"""Look at a bilinear model: its leading ways to differ in identity and expression, as one sheet of pictures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from facewright.errors import ValueRangeError
from facewright.numeric.check import check_choice

if TYPE_CHECKING:
    from facewright.mesh.topology import Topology
    from facewright.models.bilinear import BilinearModel

Progress = Callable[[str, int, int], None]

SIDES = ("identity", "expression", "both")


@dataclass(frozen=True, eq=False)
class ExploreRequest:
    """What to draw.

    Parameters
    ----------
    model : BilinearModel
        The model.
    out : Path
        Picture to write (.png, .jpg).
    n_modes : int
        Leading modes drawn, one row each.
    sigmas : tuple of float
        Standard deviations from the mean, one column each.
    side : {"identity", "expression", "both"}
        Which weights to vary.
    size : (height, width)
        Pixels of each portrait.
    yaw_degrees : float
        Turn of the heads.
    """

    model: BilinearModel
    out: Path
    n_modes: int = 4
    sigmas: tuple[float, ...] = (-2.0, -1.0, 0.0, 1.0, 2.0)
    side: str = "both"
    size: tuple[int, int] = (224, 192)
    yaw_degrees: float = 20.0

    def __post_init__(self) -> None:
        check_choice("side", self.side, SIDES)
        if not 1 <= self.n_modes <= 20:
            raise ValueRangeError(f"n_modes must be in [1, 20], got {self.n_modes}.")
        if not self.sigmas or not np.isfinite(self.sigmas).all():
            raise ValueRangeError(f"sigmas must be one or more finite numbers, got {self.sigmas}.")


def explore_model(request: ExploreRequest, progress: Progress | None = None) -> Path:
    """Draw the leading modes of a bilinear model and return the picture's path.

    Modes are the principal axes of the training weights' covariance, so a column is a number of standard deviations
    of real variation; identity rows show the mean expression's neutral, expression rows the mean person.

    Raises
    ------
    StoreError
        If the picture cannot be written.
    """
    from facewright.imaging.contact_sheet import contact_sheet
    from facewright.io.image import write_image

    pictures: list[NDArray[np.uint8]] = []
    captions: list[str] = []
    cells = _cells(request)
    draw = portrait_painter(request.model.topology, request.size, request.yaw_degrees)
    for k, (caption, w_id, w_exp) in enumerate(cells):
        pictures.append(draw(request.model.synthesise(w_id, w_exp)))
        captions.append(caption)
        if progress is not None:
            progress("drawing faces", k + 1, len(cells))
    write_image(request.out, contact_sheet(pictures, captions, columns=len(request.sigmas)))
    return request.out


def principal_axes(covariance: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the principal axes of a covariance (n, n) as rows, longest first, each one standard deviation long.

    The sign makes each axis' largest entry positive.
    """
    values, vectors = np.linalg.eigh(np.asarray(covariance, dtype=np.float64))
    axes = (vectors * np.sqrt(np.maximum(values, 0.0))).T[::-1]
    largest = np.take_along_axis(axes, np.abs(axes).argmax(axis=1)[:, None], axis=1)
    return axes * np.where(largest < 0, -1.0, 1.0)


def portrait_painter(
    topology: Topology, size: tuple[int, int], yaw_degrees: float = 0.0
) -> Callable[[NDArray[np.floating]], NDArray[np.uint8]]:
    """Return a function that draws vertices (V, 3) of `topology`, each part in its plain colour."""
    from facewright.apps.export import LOOKS, face_looks
    from facewright.imaging.colour import srgb_from_linear
    from facewright.imaging.portrait import render_portrait

    looks, index = face_looks(topology)
    faces = topology.faces[index >= 0]
    palette = srgb_from_linear(np.array([LOOKS[look][0] for look in looks], dtype=np.float32))
    albedo = np.full((topology.n_vertices, 3), 0.7, dtype=np.float32)
    albedo[faces] = palette[index[index >= 0]][:, None]

    def draw(vertices: NDArray[np.floating]) -> NDArray[np.uint8]:
        return render_portrait(vertices, faces, size, albedo=albedo, yaw_degrees=yaw_degrees).image

    return draw


def _cells(request: ExploreRequest) -> list[tuple[str, NDArray[np.float64], NDArray[np.float64]]]:
    """List caption and weights of every picture, row by row."""
    model = request.model
    neutral = model.expression_weights[0]
    cells = []
    if request.side in ("identity", "both"):
        axes = principal_axes(model.identity_covariance)[: request.n_modes]
        for mode, axis in enumerate(axes, 1):
            cells += [(f"identity {mode}: {s:+g} sd", model.identity_mean + s * axis, neutral) for s in request.sigmas]
    if request.side in ("expression", "both"):
        axes = principal_axes(model.expression_covariance)[: request.n_modes]
        for mode, axis in enumerate(axes, 1):
            cells += [
                (f"expression {mode}: {s:+g} sd", model.identity_mean, model.expression_mean + s * axis)
                for s in request.sigmas
            ]
    return cells
