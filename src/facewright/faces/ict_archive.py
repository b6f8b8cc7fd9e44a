"""Convert ICT-FaceKit's upstream OBJ files to the compact arrays, and check that they are what they should be."""

from __future__ import annotations

import hashlib
import tempfile
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path, PurePosixPath
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from facewright.errors import FileFormatError, StoreError
from facewright.faces.blendshape_names import BLENDSHAPE_NAMES, read_package_json
from facewright.faces.ict import N_IDENTITIES, N_VERTICES
from facewright.io.obj import read_obj

Progress = Callable[[str, int, int], None]

MM_PER_UNIT = 10.0  # upstream files are in centimetres
NEUTRAL = "generic_neutral_mesh"
EXPRESSIONS = (*BLENDSHAPE_NAMES[:-1], "eyeLookDown_L", "eyeLookDown_R")
"""Expression files that the 46 blendshapes need."""

_TOLERANCE_MM = 0.05
_MAX_FILE_BYTES = 64 * 1024 * 1024
_GOLDEN = np.uint64(0x9E3779B97F4A7C15)


class Members(Protocol):
    """Files of the upstream model by name, whatever holds them."""

    where: Path

    def read(self, name: str) -> bytes:
        """Return the content of ``FaceXModel/NAME.obj``."""


class FolderMembers:
    """The unpacked upstream repository, or its FaceXModel folder."""

    def __init__(self, folder: Path) -> None:
        self.where = folder
        candidates = [folder, folder / "FaceXModel", *sorted(folder.glob("*/FaceXModel"))]
        found = [path for path in candidates if (path / f"{NEUTRAL}.obj").is_file()]
        if not found:
            raise FileFormatError(f"{folder} must be ICT-FaceKit, got a folder without FaceXModel/{NEUTRAL}.obj.")
        self._folder = found[0]

    def read(self, name: str) -> bytes:
        """Return the content of one file."""
        path = self._folder / f"{name}.obj"
        try:
            if path.stat().st_size > _MAX_FILE_BYTES:
                raise FileFormatError(f"{path} must be an ICT-FaceKit mesh of about 2.5 MB, got a huge file.")
            return path.read_bytes()
        except OSError as error:
            raise FileFormatError(f"{self.where} must be a complete ICT-FaceKit, but {name}.obj is missing.") from error


class ZipMembers:
    """The upstream repository as a zip archive; members are read in memory, nothing is unpacked by its own path."""

    def __init__(self, path: Path) -> None:
        self.where = path
        try:
            self._zip = zipfile.ZipFile(path)
        except OSError as error:
            raise StoreError(f"{path} cannot be read: {error.strerror or error}.") from error
        except (zipfile.BadZipFile, NotImplementedError, ValueError) as error:
            found = "a damaged zip archive" if zipfile.is_zipfile(path) else "a file that is no whole zip archive"
            raise FileFormatError(
                f"{path} must be a zip archive of ICT-FaceKit, its unpacked folder or the compact .npz, got {found}; "
                "leave --from out to download the archive."
            ) from error
        self._names = {
            PurePosixPath(name).stem: name
            for name in self._zip.namelist()
            if PurePosixPath(name).suffix == ".obj" and PurePosixPath(name).parent.name == "FaceXModel"
        }
        if NEUTRAL not in self._names:
            self._zip.close()
            raise FileFormatError(f"{path} must be ICT-FaceKit, got an archive without FaceXModel/{NEUTRAL}.obj.")

    def read(self, name: str) -> bytes:
        """Return the content of one member."""
        if name not in self._names:
            raise FileFormatError(f"{self.where} must be a complete ICT-FaceKit, but {name}.obj is missing.")
        try:
            if self._zip.getinfo(self._names[name]).file_size > _MAX_FILE_BYTES:
                raise FileFormatError(f"{self.where}: {name}.obj must be a mesh of about 2.5 MB, got a huge member.")
            return self._zip.read(self._names[name])
        except (zipfile.BadZipFile, OSError, EOFError, ValueError) as error:
            raise FileFormatError(f"{self.where}: {name}.obj must be readable, got {error}.") from error


def convert_upstream(members: Members, progress: Progress | None = None) -> dict[str, NDArray]:
    """Read the neutral, 100 identities and 47 expressions and return the compact arrays, mm.

    Raises
    ------
    FileFormatError
        If a file is missing, damaged or of another topology.
    """
    arrays = _neutral_arrays(members)
    neutral = arrays["vertices"].astype(np.float64)
    identities = [f"identity{i:03d}" for i in range(N_IDENTITIES)]
    deltas = []
    for done, name in enumerate([*identities, *EXPRESSIONS]):
        vertices = MM_PER_UNIT * _positions(members.read(name), f"{members.where}: {name}.obj")
        deltas.append((vertices - neutral).astype(np.float32))
        if progress is not None:
            progress("converting ICT-FaceKit", done + 1, N_IDENTITIES + len(EXPRESSIONS))
    arrays["identity_modes"] = np.stack(deltas[:N_IDENTITIES])
    arrays["expression_deltas"] = np.stack(deltas[N_IDENTITIES:])
    arrays["expression_names"] = np.array(EXPRESSIONS)
    return arrays


def _neutral_arrays(members: Members) -> dict[str, NDArray]:
    """Return positions, polygons and texture coordinates of the neutral mesh."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{NEUTRAL}.obj"
        try:
            path.write_bytes(members.read(NEUTRAL))
        except OSError as error:
            raise StoreError(f"the temporary folder must have room for one mesh, got {error.strerror}.") from error
        mesh = read_obj(path)
    if len(mesh.vertices) != N_VERTICES or mesh.polygons is None or mesh.uv is None or mesh.uv_polygons is None:
        raise FileFormatError(
            f"{members.where}: {NEUTRAL}.obj must have {N_VERTICES} vertices, quads and texture coordinates, "
            f"got {len(mesh.vertices)} vertices."
        )
    return {
        "vertices": (MM_PER_UNIT * mesh.vertices).astype(np.float32),
        "faces": mesh.polygons.astype(np.int32),
        "uv": mesh.uv.astype(np.float32),
        "uv_faces": mesh.uv_polygons.astype(np.int32),
    }


def _positions(content: bytes, where: str) -> NDArray[np.float64]:
    """Return the positions of an OBJ file; the topology is known, and five times faster not read again."""
    rows = [line[2:].split()[:3] for line in content.split(b"\n") if line.startswith(b"v ")]
    if len(rows) != N_VERTICES:
        raise FileFormatError(f"{where} must have {N_VERTICES} vertices, got {len(rows)}.")
    try:
        positions = np.array(rows, dtype=np.float64)
    except ValueError as error:
        raise FileFormatError(f"{where} must have lines 'v x y z', got {error}.") from error
    if positions.shape != (N_VERTICES, 3) or not np.isfinite(positions).all():
        raise FileFormatError(f"{where} must have finite vertices x y z, got {positions.shape[1:]} or NaN.")
    return positions


def check_contents(arrays: Mapping[str, NDArray], where: Path) -> None:
    """Check that the arrays are ICT-FaceKit's, whatever file they came from.

    Polygons must have the known SHA-256, and so must the neutral and the texture coordinates rounded to six significant
    digits (what upstream files have, and what survives float32). Each identity mode and expression must have four
    known sums with fixed signs, so that a change of any coordinate by more than 0.05 mm shows. The archive's own hash
    is not used: GitHub may compress the same commit differently tomorrow.

    Raises
    ------
    FileFormatError
        If anything differs.
    """
    expected = read_package_json("ict_contents.json")
    assert isinstance(expected, dict)
    for name, digest in expected["sha256"].items():
        if canonical_sha256(arrays[name]) != digest:
            raise FileFormatError(f"{where}: {name} must be ICT-FaceKit's, got other content.")
    shapes = {f"identity{i:03d}": mode for i, mode in enumerate(arrays["identity_modes"])}
    shapes |= {str(name): delta for name, delta in zip(arrays["expression_names"], arrays["expression_deltas"])}
    for name, sums in expected["signed_sums"].items():
        if name not in shapes or np.abs(signed_sums(shapes[name]) - sums).max() > _TOLERANCE_MM:
            raise FileFormatError(f"{where}: shape {name} must be ICT-FaceKit's, got other content.")


def canonical_sha256(array: NDArray) -> str:
    """Return the SHA-256 of an array's integers, or of its numbers rounded to six significant digits."""
    if array.dtype.kind in "iu":
        return hashlib.sha256(np.ascontiguousarray(array, dtype="<i4").tobytes()).hexdigest()
    numbers = np.asarray(array, dtype=np.float64).ravel() + 0.0  # no negative zeros
    return hashlib.sha256("\n".join(np.char.mod("%.6g", numbers)).encode()).hexdigest()


def signed_sums(delta: NDArray) -> NDArray[np.float64]:
    """Return four sums of all coordinates with fixed pseudo-random signs, mm."""
    values = np.asarray(delta, dtype=np.float64).ravel()
    hashed = np.arange(1, values.size + 1, dtype=np.uint64) * _GOLDEN
    return np.array(
        [
            ((hashed >> np.uint64(bit) & np.uint64(1)).astype(np.float64) * 2.0 - 1.0) @ values
            for bit in (37, 43, 51, 59)
        ]
    )
