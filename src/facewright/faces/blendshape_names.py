"""The 46 FACS blendshapes every face has, their left-right pairs, and maps to other naming schemes."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from facewright.errors import FileFormatError, StoreError
from facewright.numeric.check import check_choice

BLENDSHAPE_NAMES: tuple[str, ...] = (
    "browDown_L",
    "browDown_R",
    "browInnerUp_L",
    "browInnerUp_R",
    "browOuterUp_L",
    "browOuterUp_R",
    "cheekPuff_L",
    "cheekPuff_R",
    "cheekSquint_L",
    "cheekSquint_R",
    "eyeBlink_L",
    "eyeBlink_R",
    "eyeSquint_L",
    "eyeSquint_R",
    "eyeWide_L",
    "eyeWide_R",
    "jawForward",
    "jawLeft",
    "jawOpen",
    "jawRight",
    "mouthClose",
    "mouthDimple_L",
    "mouthDimple_R",
    "mouthFrown_L",
    "mouthFrown_R",
    "mouthFunnel",
    "mouthLeft",
    "mouthLowerDown_L",
    "mouthLowerDown_R",
    "mouthPress_L",
    "mouthPress_R",
    "mouthPucker",
    "mouthRight",
    "mouthRollLower",
    "mouthRollUpper",
    "mouthShrugLower",
    "mouthShrugUpper",
    "mouthSmile_L",
    "mouthSmile_R",
    "mouthStretch_L",
    "mouthStretch_R",
    "mouthUpperUp_L",
    "mouthUpperUp_R",
    "noseSneer_L",
    "noseSneer_R",
    "eyesLookDown",
)
"""Names in the project's order: ICT-FaceKit's without gaze, pupils and cheekRaisers, then ``eyesLookDown``."""

_SIDEWAYS = {"jawLeft": "jawRight", "jawRight": "jawLeft", "mouthLeft": "mouthRight", "mouthRight": "mouthLeft"}


def blendshape_index(name: str) -> int:
    """Return the position of blendshape `name` in `BLENDSHAPE_NAMES`.

    Raises
    ------
    ValueRangeError
        If no blendshape has that name.
    """
    check_choice("blendshape", name, BLENDSHAPE_NAMES)
    return BLENDSHAPE_NAMES.index(name)


def mirrored_name(name: str) -> str:
    """Return the blendshape that is the mirror image of `name` across the face's middle plane.

    Examples
    --------
    >>> mirrored_name("mouthSmile_L"), mirrored_name("jawLeft"), mirrored_name("jawOpen")
    ('mouthSmile_R', 'jawRight', 'jawOpen')
    """
    if name.endswith(("_L", "_R")):
        return name[:-1] + ("R" if name.endswith("L") else "L")
    return _SIDEWAYS.get(name, name)


def coupled_shapes(names: tuple[str, ...]) -> list[tuple[int, int]]:
    """Return index pairs of shapes that a person exaggerates alike: left and right; the jaw and its counter-shape."""
    pairs = [
        (i, names.index(mirrored_name(name)))
        for i, name in enumerate(names)
        if name.endswith("_L") and mirrored_name(name) in names
    ]
    if "jawOpen" in names and "mouthClose" in names:
        pairs.append((names.index("jawOpen"), names.index("mouthClose")))
    return pairs


def mirror_order() -> NDArray[np.intp]:
    """Return the (46,) permutation that swaps left and right: ``weights[mirror_order()]`` mirrors a pose."""
    return np.array([BLENDSHAPE_NAMES.index(mirrored_name(name)) for name in BLENDSHAPE_NAMES])


@dataclass(frozen=True, eq=False)
class NameMap:
    """Linear map between the weights of another naming scheme and ours.

    Parameters
    ----------
    scheme : str
        The other scheme, for example ``"arkit52"``.
    names : tuple of str
        The other scheme's N names, in its order.
    to_ours : ndarray of shape (46, N), float64
        ``to_ours @ weights_of_scheme`` are weights of our shapes (not clipped).
    from_ours : ndarray of shape (N, 46), float64
        ``from_ours @ weights_of_ours`` are weights of the scheme's shapes.
    without_counterpart : tuple of str
        Names of the other scheme that no shape of ours expresses (gaze, tongue); they read and write as zero.
    """

    scheme: str
    names: tuple[str, ...]
    to_ours: NDArray[np.float64]
    from_ours: NDArray[np.float64]
    without_counterpart: tuple[str, ...]


def load_name_map(scheme: str | Path) -> NameMap:
    """Load the map between a naming scheme and the 46 blendshapes.

    Parameters
    ----------
    scheme : str or Path
        ``"arkit52"`` or ``"facewarehouse46"``, or the path of a JSON file laid out like ours, to replace them.

    Raises
    ------
    StoreError
        If the file cannot be read.
    FileFormatError
        If it is not JSON, lacks an entry, or names an unknown shape.
    """
    if isinstance(scheme, str) and scheme in NAME_SCHEMES:
        return _builtin_name_map(scheme)
    path = Path(scheme)
    if path.suffix != ".json":
        check_choice("naming scheme", scheme, (*NAME_SCHEMES, "a path to a .json file"))
    return _parse_name_map(read_json(path), path.name)


NAME_SCHEMES: tuple[str, ...] = ("arkit52", "facewarehouse46")
"""Naming schemes that come with the package."""


@cache
def _builtin_name_map(scheme: str) -> NameMap:
    return _parse_name_map(read_package_json(f"{scheme}.json"), f"{scheme}.json")


def _parse_name_map(content: object, where: str) -> NameMap:
    """Turn the JSON content into matrices; every unknown name is refused with its file."""
    if not isinstance(content, dict) or not {"names", "to_ours", "from_ours"} <= content.keys():
        raise FileFormatError(f"{where} must be a JSON object with names, to_ours and from_ours.")
    names = tuple(content["names"])
    to_ours = _matrix(content["to_ours"], columns=names, rows=BLENDSHAPE_NAMES, where=where)
    from_ours = _matrix(content["from_ours"], columns=BLENDSHAPE_NAMES, rows=names, where=where)
    silent = ~to_ours.any(axis=0) & ~from_ours.any(axis=1)
    return NameMap(
        scheme=str(content.get("scheme", Path(where).stem)),
        names=names,
        to_ours=to_ours,
        from_ours=from_ours,
        without_counterpart=tuple(name for name, none in zip(names, silent) if none),
    )


def _matrix(entries: object, columns: tuple[str, ...], rows: tuple[str, ...], where: str) -> NDArray[np.float64]:
    """Build a dense matrix from ``{column: {row: weight}}``."""
    matrix = np.zeros((len(rows), len(columns)))
    if not isinstance(entries, dict):
        raise FileFormatError(f"{where}: to_ours and from_ours must be objects of objects of numbers.")
    for column, targets in entries.items():
        if column not in columns or not isinstance(targets, dict):
            raise FileFormatError(f"{where}: {column!r} must be one of the {len(columns)} names it maps from.")
        for row, weight in targets.items():
            if row not in rows or not isinstance(weight, int | float):
                raise FileFormatError(
                    f"{where}: {column!r} must map names of the other scheme to numbers, got {row!r}: {weight!r}."
                )
            matrix[rows.index(row), columns.index(column)] = weight
    return matrix


def read_package_json(name: str) -> object:
    """Read a JSON data file that comes with ``facewright.faces``."""
    return json.loads((resources.files("facewright.faces") / "data" / name).read_text(encoding="utf-8"))


def read_json(path: Path) -> object:
    """Read a user's JSON file, with typed errors that name it."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise StoreError(f"{path} must be a readable file, got {error.strerror or error}.") from error
    except ValueError as error:
        raise FileFormatError(f"{path} must be a JSON file in UTF-8, got {error}.") from error
