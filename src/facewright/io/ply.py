"""Stanford PLY: meshes and point clouds, ascii and binary of either byte order; any other elements on request."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from facewright.errors import FileFormatError, StoreError
from facewright.io.atomic import write_atomically
from facewright.io.mesh_data import MeshData, fan_triangles, pad_polygons
from facewright.numeric.check import check_finite, check_indices, check_shape

_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True, eq=False)
class PlyList:
    """A list property: row i is ``values[offsets[i]:offsets[i + 1]]``."""

    offsets: NDArray[np.int64]
    values: NDArray[Any]


@dataclass
class _Property:
    name: str
    dtype: str
    count_dtype: str | None = None


@dataclass
class _Element:
    name: str
    count: int
    properties: list[_Property] = field(default_factory=list)

    @property
    def has_list(self) -> bool:
        return any(p.count_dtype for p in self.properties)


def read_ply(path: str | Path) -> MeshData:
    """Read the mesh or point cloud of a PLY file; vertex order is kept.

    Parameters
    ----------
    path : str or Path
        The file: ascii, binary little endian or binary big endian.

    Returns
    -------
    MeshData
        Positions in the file's unit and type (float32 or float64), faces (none for a cloud), normals, colours, texture
        coordinates (per vertex, or per corner as meshlab writes them).

    Raises
    ------
    StoreError
        If the file cannot be read.
    FileFormatError
        If the file is truncated, corrupt or not a PLY mesh; the message names the file.
    """
    path = Path(path)
    elements = read_ply_elements(path)
    vertex = elements.get("vertex", {})
    if not {"x", "y", "z"} <= vertex.keys():
        raise FileFormatError(f"{path} must have an element 'vertex' with x, y, z, got {sorted(elements)}.")
    vertices = np.stack([_scalar(path, vertex[axis]) for axis in "xyz"], axis=1)
    if vertices.dtype.kind != "f":
        vertices = vertices.astype(np.float64)
    if not np.isfinite(vertices).all():
        raise FileFormatError(f"{path} must have finite vertices, got NaN or infinite ones.")
    faces, polygons, uv, uv_faces = _faces(path, elements.get("face", {}), len(vertices))
    if uv is None and (per_vertex := _columns(vertex, ("u", "v"), ("s", "t"), ("texture_u", "texture_v"))) is not None:
        uv, uv_faces = per_vertex.astype(np.float32), faces
    normals = _columns(vertex, ("nx", "ny", "nz"))
    return MeshData(
        vertices=vertices,
        faces=faces,
        polygons=polygons,
        uv=uv,
        uv_faces=uv_faces,
        normals=None if normals is None else normals.astype(np.float32),
        vertex_colors=_colors(vertex),
    )


def read_ply_elements(path: str | Path) -> dict[str, dict[str, NDArray[Any] | PlyList]]:
    """Read every element of a PLY file: element name -> property name -> array (or PlyList).

    Parameters
    ----------
    path : str or Path
        The file.

    Returns
    -------
    dict of str to dict
        Scalar properties as arrays of shape (count,), native byte order; list properties as `PlyList`.

    Raises
    ------
    StoreError, FileFormatError
        See `read_ply`. Sizes are checked against the file before anything is allocated.
    """
    path = Path(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise StoreError(f"{path} must be a readable PLY file, got: {error.strerror or error}.") from error
    order, elements, start = _header(path, data)
    if order == "=":
        return _read_ascii(path, data[start:], elements)
    found: dict[str, dict[str, NDArray[Any] | PlyList]] = {}
    for element in elements:
        if element.has_list:
            found[element.name], start = _read_binary_lists(path, data, start, element, order)
        else:
            dtype = np.dtype([(p.name, order + p.dtype) for p in element.properties])
            _check_room(path, data, start, element.count * dtype.itemsize, element)
            rows = np.frombuffer(data, dtype, element.count, start) if dtype.itemsize else np.empty(0, dtype)
            start += element.count * dtype.itemsize
            found[element.name] = {p.name: rows[p.name].astype(p.dtype) for p in element.properties}
    return found


def write_ply(
    path: str | Path,
    vertices: ArrayLike,
    faces: ArrayLike | None = None,
    *,
    normals: ArrayLike | None = None,
    vertex_colors: ArrayLike | None = None,
    ascii: bool = False,
    comments: tuple[str, ...] = (),
) -> None:
    """Write a mesh or point cloud as PLY, whole.

    Parameters
    ----------
    path : str or Path
        The file to write.
    vertices : ndarray of shape (V, 3), float32 or float64
        Positions; the type is kept, anything else becomes float64.
    faces : ndarray of shape (F, K), int, optional
        Triangles or polygons, -1 pads shorter rows; a point cloud without.
    normals : ndarray of shape (V, 3), optional
        Written as float32.
    vertex_colors : ndarray of shape (V, 3), uint8, optional
        sRGB colours.
    ascii : bool
        Write text in place of binary little endian.
    comments : tuple of str
        Comment lines of the header.

    Raises
    ------
    ShapeError, ValueRangeError
        If an array does not fit the others.
    StoreError
        If the file cannot be written.
    """
    positions = np.asarray(vertices)
    if positions.dtype not in (np.float32, np.float64):
        positions = positions.astype(np.float64)
    V = check_shape("vertices", positions, "V", 3)["V"]
    check_finite("vertices", positions)
    columns: list[tuple[str, str, NDArray[Any]]] = [
        (axis, positions.dtype.str[1:], positions[:, i]) for i, axis in enumerate("xyz")
    ]
    for names, array, dtype in ((("nx", "ny", "nz"), normals, "f4"), (("red", "green", "blue"), vertex_colors, "u1")):
        if array is not None:
            values = np.asarray(array)
            check_shape("normals" if dtype == "f4" else "vertex_colors", values, V, 3)
            columns += [(name, dtype, values[:, i]) for i, name in enumerate(names)]
    rows = np.empty(V, dtype=[(name, "<" + dtype) for name, dtype, _ in columns])
    for name, _, values in columns:
        rows[name] = values
    polygons = np.empty((0, 3), np.int64) if faces is None else np.asarray(faces)
    check_shape("faces", polygons, "F", "K")
    check_indices("faces", polygons[polygons >= 0], V)

    long_names = {"f4": "float", "f8": "double", "u1": "uchar"}
    header = ["ply", f"format {'ascii' if ascii else 'binary_little_endian'} 1.0"]
    header += [f"comment {comment}" for comment in comments]
    header += [f"element vertex {V}"] + [f"property {long_names[dtype]} {name}" for name, dtype, _ in columns]
    header += [f"element face {len(polygons)}", "property list uchar int vertex_indices", "end_header", ""]
    body = _ascii_body(rows, polygons) if ascii else rows.tobytes() + _binary_faces(polygons)
    with write_atomically(Path(path)) as temporary:
        temporary.write_bytes("\n".join(header).encode("utf-8") + body)


def _header(path: Path, data: bytes) -> tuple[str, list[_Element], int]:
    """Parse the header: byte order sign, elements, position of the first byte after it."""
    stop = data.find(b"end_header")
    end = data.find(b"\n", stop)
    if not data.startswith(b"ply") or stop < 0 or end < 0:
        raise FileFormatError(f"{path} must be a PLY file (from 'ply' to 'end_header'), got {data[:12]!r}...")
    order, elements = "", list[_Element]()
    for number, line in enumerate(data[:stop].decode("utf-8", "replace").splitlines(), 1):
        match line.split():
            case ["format", name, *_] if name in _ORDERS:
                order = _ORDERS[name]
            case ["element", name, count] if count.isdigit():
                elements.append(_Element(name, int(count)))
            case ["property", "list", n, kind, name] if elements and _TYPES.get(n, "f")[0] in "iu" and kind in _TYPES:
                elements[-1].properties.append(_Property(name, _TYPES[kind], _TYPES[n]))
            case ["property", kind, name] if elements and kind in _TYPES:
                elements[-1].properties.append(_Property(name, _TYPES[kind]))
            case ["ply"] | ["comment", *_] | ["obj_info", *_] | []:
                pass
            case _:
                raise FileFormatError(f"{path} line {number} must be a PLY header line, got {line[:60]!r}.")
    if not order:
        raise FileFormatError(f"{path} must state a PLY format (ascii or binary), got none.")
    return order, elements, end + 1


def _check_room(path: Path, data: bytes, start: int, n_bytes: int, element: _Element) -> None:
    if start + n_bytes > len(data):
        raise FileFormatError(
            f"{path} must hold {n_bytes} bytes for {element.count} x {element.name!r}, "
            f"got {max(0, len(data) - start)}: the file is truncated."
        )


def _read_binary_lists(
    path: Path, data: bytes, start: int, element: _Element, order: str
) -> tuple[dict[str, NDArray[Any] | PlyList], int]:
    """Read rows with list properties: at once if every row has the first row's counts, else by walking the rows."""
    smallest = sum(np.dtype(p.count_dtype or p.dtype).itemsize for p in element.properties)
    _check_room(path, data, start, element.count * smallest, element)
    uniform = _read_uniform_lists(data, start, element, order)
    if uniform is not None:
        return uniform
    from facewright.io.ply_walk import walk_rows

    sizes = np.array(
        [(np.dtype(p.count_dtype or "u1").itemsize, np.dtype(p.dtype).itemsize) for p in element.properties]
    )
    is_list = np.array([p.count_dtype is not None for p in element.properties])
    raw = np.frombuffer(data, np.uint8)
    starts, counts, stop = walk_rows(raw, start, element.count, sizes, is_list, order == "<")
    if stop < 0:
        raise FileFormatError(f"{path} must hold {element.count} x {element.name!r}: the file is truncated.")
    found: dict[str, NDArray[Any] | PlyList] = {}
    for k, prop in enumerate(element.properties):
        offsets = np.concatenate([[0], np.cumsum(counts[:, k])])
        size = np.dtype(prop.dtype).itemsize
        first = np.repeat(starts[:, k] - offsets[:-1] * size, counts[:, k])
        position = first + np.arange(offsets[-1]) * size
        values = raw[position[:, None] + np.arange(size)].reshape(-1).view(order + prop.dtype).astype(prop.dtype)
        found[prop.name] = PlyList(offsets, values) if prop.count_dtype else values
    return found, stop


def _read_uniform_lists(
    data: bytes, start: int, element: _Element, order: str
) -> tuple[dict[str, NDArray[Any] | PlyList], int] | None:
    fields: list[Any] = []
    at = start
    for p in element.properties:
        if p.count_dtype is None:
            fields.append((p.name, order + p.dtype))
            at += np.dtype(p.dtype).itemsize
            continue
        head = np.dtype(order + p.count_dtype)
        if element.count == 0 or at + head.itemsize > len(data):
            count = 0
        else:
            count = int(np.frombuffer(data, head, 1, at)[0])
        if count < 0 or at + count > len(data):
            return None
        fields += [(f"n {p.name}", head), (p.name, order + p.dtype, (count,))]
        at += head.itemsize + count * np.dtype(p.dtype).itemsize
    dtype = np.dtype(fields)
    if start + element.count * dtype.itemsize > len(data):
        return None
    rows = np.frombuffer(data, dtype, element.count, start)
    found: dict[str, NDArray[Any] | PlyList] = {}
    for p in element.properties:
        values = rows[p.name].astype(p.dtype)
        if p.count_dtype is None:
            found[p.name] = values
        else:
            if not (rows[f"n {p.name}"] == values.shape[1]).all():
                return None
            offsets = np.arange(element.count + 1, dtype=np.int64) * values.shape[1]
            found[p.name] = PlyList(offsets, values.reshape(-1))
    return found, start + element.count * dtype.itemsize


def _read_ascii(path: Path, body: bytes, elements: list[_Element]) -> dict[str, dict[str, NDArray[Any] | PlyList]]:
    lines = [line for line in body.splitlines() if line.strip()]
    found: dict[str, dict[str, NDArray[Any] | PlyList]] = {}
    first = 0
    for element in elements:
        rows = [line.split() for line in lines[first : first + element.count]]
        first += element.count
        if len(rows) < element.count:
            raise FileFormatError(
                f"{path} must hold {element.count} lines of {element.name!r}, got {len(rows)}: the file is truncated."
            )
        try:
            found[element.name] = _ascii_rows(rows, element)
        except (ValueError, IndexError) as error:
            raise FileFormatError(
                f"{path} must hold {len(element.properties)} properties in each line of {element.name!r}, got {error}."
            ) from None
    return found


def _ascii_rows(rows: list[list[bytes]], element: _Element) -> dict[str, NDArray[Any] | PlyList]:
    found: dict[str, NDArray[Any] | PlyList] = {}
    if not element.has_list:
        width = len(element.properties)
        table = np.array([row[:width] for row in rows], dtype=bytes).reshape(len(rows), width).astype(np.float64)
        for k, p in enumerate(element.properties):
            found[p.name] = table[:, k].astype(p.dtype)
        return found
    lengths = np.fromiter(map(len, rows), np.int64, len(rows))
    row_start = np.cumsum(lengths) - lengths
    tokens = np.array([token for row in rows for token in row], dtype=bytes).astype(np.float64)
    column = np.zeros(len(rows), dtype=np.int64)
    for p in element.properties:
        if (column >= lengths).any():
            raise ValueError("a line that is too short")
        values = tokens[row_start + column] if len(rows) else np.empty(0)
        column = column + 1
        if p.count_dtype is None:
            found[p.name] = values.astype(p.dtype)
            continue
        counts = values.astype(np.int64)
        if (counts < 0).any() or (column + counts > lengths).any():
            raise ValueError("a list that is longer than its line")
        offsets = np.concatenate([[0], np.cumsum(counts)])
        position = np.repeat(row_start + column - offsets[:-1], counts) + np.arange(offsets[-1])
        found[p.name] = PlyList(offsets, tokens[position].astype(p.dtype))
        column = column + counts
    return found


def _scalar(path: Path, values: NDArray[Any] | PlyList) -> NDArray[Any]:
    if isinstance(values, PlyList):
        raise FileFormatError(f"{path} must have x, y, z as numbers, got lists.")
    return values


def _columns(vertex: Mapping[str, NDArray[Any] | PlyList], *choices: tuple[str, ...]) -> NDArray[Any] | None:
    for names in choices:
        if all(isinstance(vertex.get(name), np.ndarray) for name in names):
            return np.stack([np.asarray(vertex[name]) for name in names], axis=1)
    return None


def _colors(vertex: Mapping[str, NDArray[Any] | PlyList]) -> NDArray[np.uint8] | None:
    colors = _columns(vertex, ("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"), tuple("rgb"))
    if colors is None or colors.dtype == np.uint8:
        return colors
    scale = {"f": 255.0, "u": 255.0 / 65535.0}.get(colors.dtype.kind, 1.0)
    return np.clip(np.rint(np.nan_to_num(colors) * scale), 0, 255).astype(np.uint8)


def _faces(
    path: Path, face: Mapping[str, NDArray[Any] | PlyList], n_vertices: int
) -> tuple[NDArray[np.int32], NDArray[np.int32] | None, NDArray[np.float32] | None, NDArray[np.int32] | None]:
    """Give triangles, polygons where there are others, and uv per corner where the file has them."""
    lists = face.get("vertex_indices", face.get("vertex_index"))
    if not isinstance(lists, PlyList) or len(lists.offsets) < 2:
        return np.empty((0, 3), np.int32), None, None, None
    counts, corners = np.diff(lists.offsets), lists.values.astype(np.int64)
    if (counts < 3).any():
        raise FileFormatError(f"{path} must have faces of at least 3 corners, got one of {counts.min()}.")
    if corners.min() < 0 or corners.max() >= n_vertices:
        raise FileFormatError(
            f"{path} must index its {n_vertices} vertices, got indices from {corners.min()} to {corners.max()}."
        )
    triangles, _ = fan_triangles(counts)
    polygons = None if (counts == 3).all() else pad_polygons(corners, counts)
    uv = uv_faces = None
    texcoord = face.get("texcoord")
    if isinstance(texcoord, PlyList) and (np.diff(texcoord.offsets) == 2 * counts).all():
        pairs = texcoord.values.reshape(-1, 2).astype(np.float32)
        uv, index = np.unique(pairs, axis=0, return_inverse=True)
        uv_faces = index.reshape(-1)[triangles].astype(np.int32)
    return corners[triangles].astype(np.int32), polygons, uv, uv_faces


def _binary_faces(polygons: NDArray[Any]) -> bytes:
    """Serialise polygons in their order: a byte of count, then int32 corners; runs of equal counts at once."""
    counts = (polygons >= 0).sum(axis=1)
    breaks = np.flatnonzero(np.diff(counts)) + 1
    pieces = []
    for start, stop in zip([0, *breaks], [*breaks, len(polygons)]):
        if start < stop:
            n = int(counts[start])
            rows = np.empty(stop - start, dtype=[("n", "u1"), ("v", "<i4", (n,))])
            rows["n"], rows["v"] = n, polygons[start:stop, :n]
            pieces.append(rows.tobytes())
    return b"".join(pieces)


def _ascii_body(rows: NDArray[Any], polygons: NDArray[Any]) -> bytes:
    assert rows.dtype.names is not None
    pattern = " ".join("%d" if rows.dtype[n].kind == "u" else "%.17g" for n in rows.dtype.names) + "\n"
    if rows.dtype["x"].itemsize == 4:
        pattern = pattern.replace("%.17g", "%.9g")
    text = (pattern * len(rows)) % tuple(value for row in rows.tolist() for value in row)
    counts = (polygons >= 0).sum(axis=1)
    faces = "".join(f"{n} {' '.join(map(str, row[:n]))}\n" for n, row in zip(counts.tolist(), polygons.tolist()))
    return (text + faces).encode("ascii")
