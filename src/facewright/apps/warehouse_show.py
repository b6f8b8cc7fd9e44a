"""Describe a database or one of its people, and draw a person's meshes and blendshapes on a sheet."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from facewright.errors import MissingFaceError, StoreError, ValueRangeError

if TYPE_CHECKING:
    from facewright.warehouse.store import Warehouse
    from facewright.warehouse.subject import Subject

Progress = Callable[[str, int, int], None]
Painter = Callable[[NDArray[np.floating[Any]]], NDArray[np.uint8]]


@dataclass(frozen=True)
class ShowWarehouseRequest:
    """What to show.

    Parameters
    ----------
    store : str
        Database.
    subject : str, optional
        A person; the database itself where absent.
    out : Path, optional
        Picture of the person to write.
    size : (height, width)
        Pixels of each portrait.
    yaw_degrees : float
        Turn of the head.
    """

    store: str
    subject: str | None = None
    out: Path | None = None
    size: tuple[int, int] = (224, 184)
    yaw_degrees: float = 15.0

    def __post_init__(self) -> None:
        if self.out is not None and self.subject is None:
            raise ValueRangeError("a picture needs a subject: give its name, too.")


def show_warehouse(request: ShowWarehouseRequest, progress: Progress | None = None) -> dict[str, Any]:
    """Return facts of a database or a person as JSON values, and draw the person where a picture is asked for.

    Sizes are those of the arrays in memory. A person's `notes` tell what was unusual, each sentence once, see
    `subject_notes`.

    Raises
    ------
    StoreError
        If there is no such database or person, or the picture cannot be written.
    FileFormatError
        If what is read is damaged.
    """
    from facewright.warehouse.store import Warehouse
    from facewright.warehouse.subject_notes import subject_notes

    warehouse = Warehouse.open(request.store)
    if request.subject is None:
        return _describe_store(warehouse)
    if request.out is not None and not request.out.absolute().parent.is_dir():
        raise StoreError(f"{request.out} cannot be written: the folder {request.out.parent} does not exist.")
    entry = warehouse.entry(request.subject)
    if request.out is not None:
        from facewright.io.image import write_image

        subject = warehouse.read_subject(request.subject, fields=("blendshapes", "color", "landmarks"))
        write_image(request.out, draw_subject(warehouse, subject, request.size, request.yaw_degrees, progress))
    return {
        "name": entry.name,
        "attributes": entry.attributes,
        "expressions": list(entry.expressions),
        "arrays": {name: [*description["shape"], description["dtype"]] for name, description in entry.arrays.items()},
        "uncompressed_megabytes": round(entry.n_bytes / 1e6, 3),
        "digest": entry.digest,
        "notes": subject_notes(entry.provenance, most_named=len(entry.expressions)),
        "provenance": dict(entry.provenance),
        **({"picture": str(request.out)} if request.out is not None else {}),
    }


def _describe_store(warehouse: Warehouse) -> dict[str, Any]:
    entries = warehouse.entries()
    attributes = sorted({key for entry in entries for key in entry.attributes})
    return {
        "store": warehouse.url,
        "version": warehouse.version,
        "face": warehouse.face_name,
        "vertices": warehouse.n_vertices,
        "triangles": len(warehouse.topology.faces),
        "fingerprint": warehouse.topology.fingerprint,
        "licence": warehouse.licence,
        "subjects": len(entries),
        "with_blendshapes": sum("blendshapes" in entry.arrays for entry in entries),
        "meshes": sum(len(entry.expressions) for entry in entries),
        "failures": len(warehouse.failures()),
        "attributes": attributes,
        "expressions": list(warehouse.expression_names),
        "blendshapes": list(warehouse.blendshape_names[1:]),
        "uncompressed_megabytes": round(sum(entry.n_bytes for entry in entries) / 1e6, 3),
    }


def draw_subject(
    warehouse: Warehouse,
    subject: Subject,
    size: tuple[int, int] = (224, 184),
    yaw_degrees: float = 15.0,
    progress: Progress | None = None,
) -> NDArray[np.uint8]:
    """Draw a person: pictures of the expressions where there are any, then the meshes, then the blendshapes.

    Returns
    -------
    ndarray of shape (H, W, 3), uint8
        A sheet with up to ten portraits in a row.
    """
    from facewright.imaging.contact_sheet import contact_sheet

    paint = _painter(warehouse, subject, size, yaw_degrees)
    tiles: list[NDArray[np.uint8]] = []
    captions: list[str] = []
    shapes = [] if subject.blendshapes is None else list(subject.blendshapes)
    total = len(subject.expressions) + len(shapes)
    columns = min(10, max(len(subject.expressions), len(shapes)))
    if subject.color is not None:
        points = [None] * len(subject.color) if subject.landmarks is None else subject.landmarks
        tiles += [photo_tile(picture, marks, size) for picture, marks in zip(subject.color, points)]
        captions += [f"{name}, picture" for name in subject.expressions]
        _fill_row(tiles, captions, size, columns)
    names = list(warehouse.blendshape_names)
    if shapes and {"jawOpen", "mouthClose"} <= set(names):  # alone it pulls closed lips into the face
        i, j = names.index("mouthClose"), names.index("jawOpen")
        names[i], shapes[i] = "jawOpen + mouthClose", shapes[i] + shapes[j] - shapes[0]
    for name, vertices in zip((*subject.expressions, *names), (*subject.meshes, *shapes)):
        if len(captions) and name == "neutral":
            _fill_row(tiles, captions, size, columns)
        tiles.append(paint(vertices))
        captions.append(name)
        if progress is not None:
            progress("drawing portraits", min(len(tiles), total), total)
    return contact_sheet(tiles, captions, columns=columns)


def _painter(warehouse: Warehouse, subject: Subject, size: tuple[int, int], yaw_degrees: float) -> Painter:
    """Paint with the face's colours where the face is installed, else in plaster, the camera set by the neutral."""
    from facewright.apps.paint_person import portrait_painter
    from facewright.imaging.portrait import render_portrait

    topology = warehouse.topology
    face = _face_of(warehouse)
    if face is not None:
        return portrait_painter(topology, face, size, yaw_degrees=yaw_degrees)
    low, high = subject.meshes[0].min(axis=0), subject.meshes[0].max(axis=0)
    centre = (low + high) / 2
    height = 1.1 * max(float(high[1] - low[1]), float(high[0] - low[0]) * size[0] / size[1])

    def draw(vertices: NDArray[np.floating[Any]]) -> NDArray[np.uint8]:
        return render_portrait(
            vertices,
            topology.faces,
            size,
            yaw_degrees=yaw_degrees,
            centre_mm=(float(centre[0]), float(centre[1]), float(centre[2])),
            height_mm=height,
            distance_mm=max(800.0, 3 * height),
        ).image

    return draw


def _face_of(warehouse: Warehouse) -> Any:
    from facewright.faces import load_face

    try:
        face = load_face(warehouse.face_name)
    except MissingFaceError:
        return None
    if face.topology.fingerprint == warehouse.topology.fingerprint:
        return face
    skin = face.skin()
    return skin if skin.topology.fingerprint == warehouse.topology.fingerprint else None


def _fill_row(tiles: list[NDArray[np.uint8]], captions: list[str], size: tuple[int, int], columns: int) -> None:
    """Add empty tiles up to the end of the row."""
    missing = -len(tiles) % columns
    tiles += [np.full((*size, 3), 255, dtype=np.uint8)] * missing
    captions += [""] * missing


def photo_tile(
    picture: NDArray[np.uint8], landmarks: NDArray[np.floating[Any]] | None, size: tuple[int, int]
) -> NDArray[np.uint8]:
    """Cut the head out of a picture, upright; the whole picture where it has no landmarks.

    Parameters
    ----------
    picture : ndarray of shape (H, W, 3), uint8
        Black rows below and columns on the right, which fill pictures of unlike sizes, do not count.
    landmarks : ndarray of shape (74, 2), pixels, or None
        NaN where missing. The head is turned by quarter turns until the chin is below the eyes.
    size : (height, width)
        Pixels of the result.
    """
    from facewright.capture.quarter_turns import turn_picture, turn_points
    from facewright.imaging.overlay import crop_around

    inside = picture.any(axis=2)
    height, width = (np.flatnonzero(inside.any(axis=axis)).max(initial=0) + 1 for axis in (1, 0))
    picture = picture[:height, :width]
    if landmarks is None:
        return _thumbnail(picture, size)
    turns = _turns_to_upright(landmarks)
    points = turn_points(landmarks, (height, width), turns)
    seen = (points >= 0).all(axis=1) & (points < turn_picture(picture, turns).shape[1::-1]).all(axis=1)
    if np.count_nonzero(seen) < 3:
        return _thumbnail(picture, size)
    crop, _, _ = crop_around(turn_picture(picture, turns), points[seen], margin=0.3, height=max(size))
    top, left = (crop.shape[0] - size[0]) // 2, (crop.shape[1] - size[1]) // 2
    return np.ascontiguousarray(crop[top : top + size[0], left : left + size[1]])


def _turns_to_upright(landmarks: NDArray[np.floating[Any]]) -> int:
    """Return the counter-clockwise quarter turns after which the mouth lies below the eyes; 0 where one is missing."""
    from facewright.landmarks.scheme import load_scheme

    groups = load_scheme("fw74").groups
    eyes, mouth = (
        landmarks[np.concatenate([groups[name] for name in names])]
        for names in (("left_eye", "right_eye"), ("outer_mouth", "inner_mouth"))
    )
    if not (np.isfinite(eyes).any(axis=0).all() and np.isfinite(mouth).any(axis=0).all()):
        return 0
    right, down = np.nanmean(mouth, axis=0) - np.nanmean(eyes, axis=0)
    # a turn takes (right, down) to (down, -right)
    return int(np.argmax([down, -right, -down, right]))


def _thumbnail(picture: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[np.uint8]:
    """Fit a picture into a tile, whole, with white borders."""
    from PIL import Image

    image = Image.fromarray(picture)
    image.thumbnail((size[1], size[0]))
    tile = Image.new("RGB", (size[1], size[0]), (255, 255, 255))
    tile.paste(image, ((size[1] - image.width) // 2, (size[0] - image.height) // 2))
    return np.asarray(tile)
