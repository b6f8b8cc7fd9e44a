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
        Standard deviations from the mean of identity, one column each; expression goes in as many steps from the least
        to the greatest that a training shape has.
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

    Modes are the directions of the training weights' variation that move the surface most, one deviation long; identity
    rows show neutral faces, expression rows the mean person.

    Raises
    ------
    StoreError
        If the picture cannot be written.
    """
    from facewright.apps.paint_person import face_of_model, portrait_painter
    from facewright.imaging.contact_sheet import contact_sheet
    from facewright.io.image import write_image

    pictures: list[NDArray[np.uint8]] = []
    captions: list[str] = []
    cells = _cells(request)
    model = request.model
    draw = portrait_painter(model.topology, face_of_model(model), request.size, yaw_degrees=request.yaw_degrees)
    for k, (caption, w_id, w_exp) in enumerate(cells):
        pictures.append(draw(model.synthesise(w_id, w_exp)))
        captions.append(caption)
        if progress is not None:
            progress("drawing faces", k + 1, len(cells))
    write_image(request.out, contact_sheet(pictures, captions, columns=len(request.sigmas)))
    return request.out


def principal_axes(covariance: NDArray[np.floating], directions: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the axes in weight space along which the surface varies most, one standard deviation long each.

    Parameters
    ----------
    covariance : ndarray of shape (n, n)
        Of the weights.
    directions : ndarray of shape (n, V, 3), millimetres
        How the surface moves per unit of each weight.

    Returns
    -------
    ndarray of shape (n, n), float64
        Axes as rows, the one that moves the surface most first. With A A^T the covariance, they are the columns of A
        turned so that their displacements of the surface are orthogonal; the sign lets the largest entry be positive.
    """
    values, vectors = np.linalg.eigh(np.asarray(covariance, dtype=np.float64))
    A = vectors * np.sqrt(np.maximum(values, 0.0))
    D = np.asarray(directions, dtype=np.float64).reshape(len(A), -1)
    _, turn = np.linalg.eigh(A.T @ (D @ D.T) @ A)
    axes = (A @ turn).T[::-1]
    largest = np.take_along_axis(axes, np.abs(axes).argmax(axis=1)[:, None], axis=1)
    return axes * np.where(largest < 0, -1.0, 1.0)


def _cells(request: ExploreRequest) -> list[tuple[str, NDArray[np.float64], NDArray[np.float64]]]:
    """List caption and weights of every picture, row by row."""
    model = request.model
    neutral = model.expression_weights[0]
    cells = []
    if request.side in ("identity", "both"):
        axes = principal_axes(model.identity_covariance, model.expression(neutral))[: request.n_modes]
        for mode, axis in enumerate(axes, 1):
            cells += [(f"identity {mode}: {s:+g} sd", model.identity_mean + s * axis, neutral) for s in request.sigmas]
    if request.side in ("expression", "both"):
        axes = principal_axes(model.expression_covariance, model.person(model.identity_mean))
        # Most shapes lie near the mean and one or two far out: two deviations would show next to nothing.
        reach = (model.expression_weights - model.expression_mean) @ np.linalg.pinv(axes)
        for mode, (axis, found) in enumerate(zip(axes[: request.n_modes], reach.T), 1):
            for s in np.linspace(found.min(), found.max(), len(request.sigmas)):
                w_exp = model.expression_mean + s * axis
                cells.append((f"expression {mode}: {s:+.1f} sd", model.identity_mean, w_exp))
    return cells
