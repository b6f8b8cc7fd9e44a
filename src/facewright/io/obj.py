"""Wavefront OBJ: polygons of any size, texture coordinates, vertex colours, the texture's file name."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from facewright.errors import FileFormatError, StoreError, ValueRangeError
from facewright.io.atomic import write_atomically
from facewright.io.mesh_data import MeshData, fan_triangles, pad_polygons
from facewright.numeric.check import check_finite, check_indices, check_shape

Lines = list[bytes]
Rows = list[list[bytes]]


def read_obj(path: str | Path) -> MeshData:
    """Read a Wavefront OBJ file; vertex order is kept.

    All corner forms (``v``, ``v/vt``, ``v//vn``, ``v/vt/vn``), negative (relative) indices, polygons of any size,
    colours after the position (``v x y z r g b`` in [0, 1] or [0, 255]), comments and continued lines are read; groups,
    smoothing groups and curves are skipped.

    Parameters
    ----------
    path : str or Path
        The file.

    Returns
    -------
    MeshData
        Positions are float64 in the file's unit; `texture` is the first picture that the material library names.

    Raises
    ------
    StoreError
        If the file cannot be read.
    FileFormatError
        If a line does not parse or an index is out of range; the message names file and line.
    """
    path = Path(path)
    lines = _lines(path)
    heads = np.array([line[:2].replace(b"\t", b" ") for line in lines], dtype="S2") if lines else np.empty(0, "S2")
    at = {key: np.flatnonzero(heads == key.encode()) for key in ("v ", "vt", "vn", "f ")}
    # An S2 array drops nothing but NUL bytes, so a bare "v" or "f" line is caught as too short below.
    vertices, colors = _vertices(path, lines, at["v "])
    uv = _numbers(path, lines, at["vt"], 2, optional=1)
    vn = _numbers(path, lines, at["vn"], 3)
    counts, corners = _corners(path, lines, at)
    texture = _texture(path, lines)
    if not len(vertices):
        raise FileFormatError(f"{path} must be an OBJ mesh, got a file without any 'v x y z' line.")

    triangles, _ = fan_triangles(counts)
    all_triangles = bool((counts == 3).all())
    has_uv = len(uv) > 0 and len(corners) > 0 and bool((corners[:, 1] >= 0).all())
    return MeshData(
        vertices=vertices,
        faces=corners[:, 0][triangles].astype(np.int32),
        polygons=None if all_triangles else pad_polygons(corners[:, 0], counts),
        uv=uv.astype(np.float32) if len(uv) else None,
        uv_faces=corners[:, 1][triangles].astype(np.int32) if has_uv else None,
        uv_polygons=pad_polygons(corners[:, 1], counts) if has_uv and not all_triangles else None,
        normals=_vertex_normals(len(vertices), corners, vn),
        vertex_colors=colors,
        texture=texture,
    )


def write_obj(
    path: str | Path,
    vertices: ArrayLike,
    faces: ArrayLike,
    *,
    uv: ArrayLike | None = None,
    uv_faces: ArrayLike | None = None,
    vertex_colors: ArrayLike | None = None,
    texture: str | Path | None = None,
    comment: str = "",
) -> None:
    """Write a Wavefront OBJ file whole, and beside it a material library if a texture is named.

    Parameters
    ----------
    path : str or Path
        The file to write; ``face.obj`` names its material library ``face.mtl``.
    vertices : ndarray of shape (V, 3)
        Positions, written with 9 significant digits (float32 survives exactly).
    faces : ndarray of shape (F, K), int
        Triangles or polygons; -1 pads shorter rows.
    uv : ndarray of shape (U, 2), optional
        Texture coordinates, v upwards.
    uv_faces : ndarray of shape (F, K), int, optional
        Indices into `uv`; `faces` itself where `uv` has one row per vertex.
    vertex_colors : ndarray of shape (V, 3), uint8, optional
        sRGB colours, written after the positions as numbers in [0, 1].
    texture : str or Path, optional
        Picture that the material shall name, relative to `path`; it is not written here.
    comment : str, optional
        First lines of the file.

    Raises
    ------
    ShapeError, ValueRangeError
        If an array does not fit the others.
    StoreError
        If the files cannot be written.
    """
    path = Path(path)
    positions = np.asarray(vertices)
    V = check_shape("vertices", positions, "V", 3)["V"]
    check_finite("vertices", positions)
    faces = _check_polygons("faces", faces, V)
    text = ["".join(f"# {line}\n" for line in comment.splitlines())]
    if texture is not None:
        text.append(f"mtllib {path.with_suffix('.mtl').name}\nusemtl face\n")
    if vertex_colors is None:
        text.append(_format("v %.9g %.9g %.9g\n", positions))
    else:
        colors = np.asarray(vertex_colors)
        check_shape("vertex_colors", colors, V, 3)
        text.append(_format("v %.9g %.9g %.9g %.4g %.4g %.4g\n", np.hstack([positions, colors / 255.0])))
    if uv is None:
        text.append(_format_faces(faces, None))
    else:
        coordinates = np.asarray(uv)
        U = check_shape("uv", coordinates, "U", 2)["U"]
        corners = _check_polygons("uv_faces", faces if uv_faces is None else uv_faces, U)
        if corners.shape != faces.shape or ((corners < 0) != (faces < 0)).any():
            raise ValueRangeError(
                f"uv_faces must have the rows of faces {faces.shape}, got {corners.shape} or other padding."
            )
        text.append(_format("vt %.9g %.9g\n", coordinates))
        text.append(_format_faces(faces, corners))
    if texture is not None:
        material = f"newmtl face\nKd 1 1 1\nmap_Kd {Path(texture).as_posix()}\n"
        with write_atomically(path.with_suffix(".mtl")) as temporary:
            temporary.write_text(material, encoding="utf-8")
    with write_atomically(path) as temporary:
        temporary.write_text("".join(text), encoding="utf-8")


def _lines(path: Path) -> Lines:
    """Read a file's lines, blanks trimmed, continuations joined (with empty lines left, so that numbers stay true)."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise StoreError(f"{path} must be a readable OBJ file, got: {error.strerror or error}.") from error
    if b"\0" in data[:4096]:
        raise FileFormatError(f"{path} must be an OBJ text file, got binary data.")
    if b"\\\n" in data or b"\\\r" in data:
        data = re.sub(rb"(?:[^\n]*\\\r?\n)+[^\n]*", _join, data)
    return [line.strip() for line in data.splitlines()]


def _join(match: re.Match[bytes]) -> bytes:
    """Join continued lines into one, followed by as many empty ones."""
    pieces = re.split(rb"\\\r?\n", match[0])
    return b" ".join(pieces) + b"\n" * (len(pieces) - 1)


def _rows(lines: Lines, at: NDArray[np.int64]) -> Rows:
    """Split lines into fields, the keyword first, comments cut off."""
    return [line.split() if b"#" not in line else line.split(b"#")[0].split() for line in map(lines.__getitem__, at)]


def _numbers(path: Path, lines: Lines, at: NDArray[np.int64], width: int, *, optional: int = 0) -> NDArray[np.float64]:
    """Read `width` finite numbers after the keyword of each line; `optional` of them may be missing (then 0)."""
    rows = _rows(lines, at)
    if not rows:
        return np.empty((0, width))
    if optional and any(len(row) <= width for row in rows):
        rows = [row + [b"0"] * (width + 1 - len(row)) if len(row) > width - optional else row for row in rows]
    try:
        values = np.array([row[1 : width + 1] for row in rows], dtype=bytes).astype(np.float64)
        if values.shape == (len(rows), width) and np.isfinite(values).all():
            return values
    except ValueError:
        pass
    for number, row in zip(at, rows):
        if len(row) <= width or not all(_is_finite_number(field) for field in row[1 : width + 1]):
            raise FileFormatError(
                f"{path} line {number + 1} must hold {width} finite numbers after '{row[0].decode()}', "
                f"got {_shown(lines[number])}."
            )
    raise FileFormatError(f"{path} must hold {width} finite numbers in each '{rows[0][0].decode()}' line.")


def _is_finite_number(field: bytes) -> bool:
    try:
        return bool(np.isfinite(float(field)))
    except ValueError:
        return False


def _shown(line: bytes) -> str:
    text = line.decode("utf-8", "replace")
    return repr(text if len(text) <= 60 else text[:57] + "...")


def _vertices(path: Path, lines: Lines, at: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.uint8] | None]:
    positions = _numbers(path, lines, at, 3)
    if not len(at) or len(_rows(lines, at[:1])[0]) < 7:
        return positions, None
    try:
        colors = _numbers(path, lines, at, 6)[:, 3:]
    except FileFormatError:
        return positions, None  # not on every vertex: not a colour per vertex
    scale = 255.0 if colors.max() <= 1.0 else 1.0
    return positions, np.clip(np.rint(colors * scale), 0, 255).astype(np.uint8)


def _corners(path: Path, lines: Lines, at: dict[str, NDArray[np.int64]]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Read the face lines: corners per polygon (P,), and per corner the zero-based v, vt, vn (-1 = not given)."""
    rows = _rows(lines, at["f "])
    counts = np.fromiter(map(len, rows), dtype=np.int64, count=len(rows)) - 1
    short = np.flatnonzero(counts < 3)
    if len(short):
        number = at["f "][short[0]]
        raise FileFormatError(f"{path} line {number + 1} must list at least 3 corners, got {_shown(lines[number])}.")
    tokens = [token for row in rows for token in row[1:]]
    corners = np.zeros((len(tokens), 3), dtype=np.int64)
    if not tokens:
        return counts, corners
    try:
        corners = _split_tokens(tokens)
    except ValueError:
        _raise_bad_face(path, lines, at["f "], rows)
    line_of_corner = np.repeat(at["f "], counts)
    for column, key in enumerate(("v ", "vt", "vn")):
        total = len(at[key])
        values = corners[:, column]
        relative = values < 0
        if relative.any():  # -1 is the last one defined above this line
            values[relative] += np.searchsorted(at[key], line_of_corner[relative]) + 1
            values[relative & (values < 1)] = total + 1  # points above the first: out of range
        bad = np.flatnonzero((values > total) | ((values == 0) & (column == 0)))
        if len(bad):
            number = line_of_corner[bad[0]]
            raise FileFormatError(
                f"{path} line {number + 1} must index the {total} '{key.strip()}' lines (1 to {total}), "
                f"got {_shown(lines[number])}."
            )
    return counts, corners - 1


def _split_tokens(tokens: Sequence[bytes]) -> NDArray[np.int64]:
    """Split corner tokens such as b"5/7/2" into three integers each, 0 where not given."""
    text = b" ".join(tokens) + b" "
    if b"/" not in text:
        corners = np.zeros((len(tokens), 3), dtype=np.int64)
        corners[:, 0] = np.array(tokens).astype(np.int64)
        return corners
    text = text.replace(b"//", b"/0/").replace(b"/ ", b"/0 ")
    characters = np.frombuffer(text, dtype=np.uint8)
    ends = np.flatnonzero(characters == ord(" "))
    slashes = np.diff(np.cumsum(characters == ord("/"))[ends], prepend=0)
    if slashes.max() > 2:
        raise ValueError("more than three indices")
    numbers = np.array(text.replace(b"/", b" ").split()).astype(np.int64)
    owner = np.repeat(np.arange(len(tokens)), slashes + 1)
    if len(owner) != len(numbers):
        raise ValueError("an index is missing")
    first = np.cumsum(slashes + 1) - (slashes + 1)
    corners = np.zeros((len(tokens), 3), dtype=np.int64)
    corners[owner, np.arange(len(numbers)) - first[owner]] = numbers
    return corners


def _raise_bad_face(path: Path, lines: Lines, at: NDArray[np.int64], rows: Rows) -> None:
    for number, row in zip(at, rows):
        try:
            _split_tokens(row[1:])
        except (ValueError, OverflowError):
            raise FileFormatError(
                f"{path} line {number + 1} must list corners as v, v/vt, v//vn or v/vt/vn, got {_shown(lines[number])}."
            ) from None
    raise FileFormatError(f"{path} must list face corners as v, v/vt, v//vn or v/vt/vn.")


def _vertex_normals(n_vertices: int, corners: NDArray[np.int64], vn: NDArray[np.float64]) -> NDArray[np.float32] | None:
    """Give one normal per vertex where the file has exactly one for each, else None."""
    if not len(vn) or not len(corners) or (corners[:, 2] < 0).any():
        return None
    of_vertex = np.full(n_vertices, -1, dtype=np.int64)
    of_vertex[corners[:, 0]] = corners[:, 2]
    if (of_vertex < 0).any() or (vn[of_vertex[corners[:, 0]]] != vn[corners[:, 2]]).any():
        return None
    return vn[of_vertex].astype(np.float32)


def _texture(path: Path, lines: Lines) -> Path | None:
    """Find the picture of the first material with one (map_Kd)."""
    for line in lines:
        if not line.startswith(b"mtllib"):
            continue
        library = path.parent / line[6:].strip().decode("utf-8", "replace")
        try:
            material = library.read_text(encoding="utf-8", errors="replace")
        except OSError:
            continue
        for entry in map(str.strip, material.splitlines()):
            if entry.lower().startswith("map_kd") and len(entry.split()) > 1:
                name = entry[6:].strip()
                name = name.split()[-1] if name.startswith("-") else name  # options come before the name
                return library.parent / name.replace("\\", "/")
    return None


def _check_polygons(name: str, polygons: ArrayLike, size: int) -> NDArray[np.int64]:
    rows = np.asarray(polygons)
    check_shape(name, rows, "F", "K")
    if rows.shape[1] < 3 or (rows.size and (rows[:, :3] < 0).any()):
        raise ValueRangeError(f"{name} must have at least 3 corners in each row, got {rows.shape[1]} columns.")
    check_indices(name, rows[rows >= 0], size)
    return rows.astype(np.int64)


def _format(pattern: str, values: NDArray[Any]) -> str:
    return (pattern * len(values)) % tuple(values.ravel().tolist())


def _format_faces(faces: NDArray[np.int64], uv_faces: NDArray[np.int64] | None) -> str:
    """Write polygons in their order; runs of equal corner counts are formatted at once."""
    counts = (faces >= 0).sum(axis=1)
    breaks = np.flatnonzero(np.diff(counts)) + 1
    pieces = []
    for start, stop in zip([0, *breaks], [*breaks, len(faces)]):
        if start == stop:
            continue
        n = int(counts[start])
        corners = faces[start:stop, :n] + 1
        if uv_faces is None:
            pieces.append(_format("f" + " %d" * n + "\n", corners))
        else:
            both = np.stack([corners, uv_faces[start:stop, :n] + 1], axis=2)
            pieces.append(_format("f" + " %d/%d" * n + "\n", both))
    return "".join(pieces)
