"""Mesh sequences of one topology as a performer's data: nothing is fitted, only subsampled and held still."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from facewright.errors import FileFormatError, MissingFaceError, StoreError, TopologyError, ValueRangeError
from facewright.io.obj import read_obj
from facewright.io.ply import read_ply
from facewright.mesh.connectivity import vertex_components
from facewright.mesh.mesh_sequence import MeshSequence
from facewright.mesh.uniform_subsample import subsample_mesh
from facewright.models.performer_data import PerformerClip, PerformerData
from facewright.models.procrustes import RigidMotions, rigid_motions, stable_weights
from facewright.numeric.similarity import estimate_similarity

Progress = Callable[[str, int, int], None]

_STILL_FRAMES = 400  # are enough to tell what hardly moves
_SUFFIXES = (".obj", ".ply")


def read_mesh_sequence(path: Path, frames_per_second: float) -> MeshSequence:
    """Read a clip: an ``.npz`` with times, vertices and faces, or a folder of OBJ or PLY files in the order of names.

    Parameters
    ----------
    path : Path
    frames_per_second : float
        Of a folder, which has no times.

    Raises
    ------
    StoreError
        If there is no such file or folder.
    FileFormatError
        If it holds no meshes, or an archive lacks an array.
    TopologyError
        If the meshes' triangles differ.
    """
    if path.is_dir():
        return _read_folder(path, frames_per_second)
    if not path.is_file():
        raise StoreError(f"{path} must be a folder of meshes or an .npz file, got nothing there.")
    try:
        with np.load(path, allow_pickle=False) as content:
            arrays = {name: content[name] for name in ("times", "vertices", "faces")}
    except (KeyError, ValueError, OSError, zipfile.BadZipFile) as error:
        raise FileFormatError(f"{path} must be an .npz file with times, vertices and faces, got: {error}.") from error
    return MeshSequence(
        arrays["times"].astype(np.float64), arrays["vertices"].astype(np.float32), arrays["faces"].astype(np.int32)
    )


def mesh_recordings(files: Sequence[Path]) -> dict[str, Path]:
    """Return the clips by name: each file or folder of meshes, and each .npz file of a folder without meshes.

    Raises
    ------
    ValueRangeError
        If two bear one name.
    """
    found: dict[str, Path] = {}
    for file in files:
        inside = [file]
        if file.is_dir() and not any(path.suffix.lower() in _SUFFIXES for path in file.iterdir()):
            inside = sorted(file.glob("*.npz")) or [file]
        for path in inside:
            if path.stem in found:
                raise ValueRangeError(f"recordings must have different names, got {path.stem!r} twice.")
            found[path.stem] = path
    return found


def _read_folder(path: Path, frames_per_second: float) -> MeshSequence:
    files = [file for file in path.iterdir() if file.suffix.lower() in _SUFFIXES]
    if not files:
        raise FileFormatError(f"{path} must hold meshes in {' or '.join(_SUFFIXES)}, or clips in .npz, got none.")
    # frame_9 comes before frame_10
    files.sort(key=lambda file: [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", file.name)])
    meshes = [read_obj(file) if file.suffix.lower() == ".obj" else read_ply(file) for file in files]
    first = meshes[0]
    for file, mesh in zip(files, meshes):
        same = len(mesh.vertices) == len(first.vertices) and np.array_equal(mesh.faces, first.faces)
        if not same:
            raise TopologyError(
                f"all meshes of {path} must have the triangles of {files[0].name}, got others in {file.name}."
            )
    vertices = np.stack([mesh.vertices for mesh in meshes]).astype(np.float32)
    return MeshSequence(np.arange(len(files)) / frames_per_second, vertices, first.faces.astype(np.int32))


def performer_from_meshes(
    clips: Mapping[str, MeshSequence],
    *,
    name: str = "performer",
    n_vertices: int | None = 397,
    neutral: str | None = None,
    progress: Progress | None = None,
) -> PerformerData:
    """Turn mesh sequences of one topology into a performer's data.

    Meshes of the built-in face or ICT-FaceKit (whole or skin) are subsampled as markers' registrations are, so that
    both go together. Others are subsampled evenly, or kept whole where they have no more than `n_vertices`.

    Parameters
    ----------
    clips : mapping of str to MeshSequence
    name : str
    n_vertices : int, optional
        Of the coarse mesh; all where absent.
    neutral : str, optional
        ``CLIP:FRAME`` at rest; frame 0 of a clip called neutral or rest, else of the first, where absent.
    progress : callable, optional

    Raises
    ------
    TopologyError
        If the clips' triangles differ, or the mesh is not one connected piece.
    ValueRangeError
        If there is no clip, the neutral does not exist, or so many vertices cannot be joined to a mesh.
    """
    if not clips:
        raise ValueRangeError("clips must hold at least one clip, got none.")
    first = next(iter(clips.values()))
    for clip_name, clip in clips.items():
        if clip.vertices.shape[1] != first.vertices.shape[1] or not np.array_equal(clip.faces, first.faces):
            raise TopologyError(f"all clips must be meshes of one topology, got another in {clip_name}.")
    rest, told = _rest_mesh(clips, neutral)
    template, ids, faces, mirror, reference = _coarse(rest, first.faces, n_vertices)
    base = rest[ids].astype(np.float64)
    if reference is None:
        reference = (base - base.mean(axis=0)).astype(np.float32)
    home = estimate_similarity(base, reference, with_scale=False)
    still = home.apply(base)
    some = np.concatenate([clip.vertices[:, ids] for clip in clips.values()])
    some = some[np.linspace(0, len(some) - 1, min(len(some), _STILL_FRAMES)).astype(int)]
    weights = stable_weights(some, still)
    done = []
    for number, (clip_name, clip) in enumerate(clips.items()):
        motion = rigid_motions(clip.vertices[:, ids], still, weights)
        head: RigidMotions = motion.inverse()
        vertices = motion.apply(clip.vertices[:, ids]).astype(np.float32)
        done.append(PerformerClip(clip_name, clip.times, vertices, head.rotations, head.translations))
        if progress is not None:
            progress("aligning clips", number + 1, len(clips))
    notes = {clip.name: {"frames": clip.n_frames} for clip in done}
    return PerformerData(
        name=name,
        faces=faces,
        neutral=still.astype(np.float32),
        reference=reference,
        clips=tuple(done),
        template=template,
        vertex_ids=ids,
        mirror=mirror,
        statistics={"neutral": told, "source": "meshes", "clips": notes},
    )


def _rest_mesh(clips: Mapping[str, MeshSequence], neutral: str | None) -> tuple[NDArray[np.float32], str]:
    if neutral is None:
        named = [name for name in clips if any(word in name.lower() for word in ("neutral", "rest"))]
        neutral = f"{named[0] if named else next(iter(clips))}:0"
    clip_name, colon, number = neutral.rpartition(":")
    if not colon:
        clip_name, number = neutral, "0"
    if clip_name not in clips or not number.isdigit() or int(number) >= clips[clip_name].n_frames:
        raise ValueRangeError(f"neutral must be CLIP:FRAME of {', '.join(clips)}, got {neutral!r}.")
    return clips[clip_name].vertices[int(number)], f"{clip_name}:{number}"


def _coarse(rest: NDArray[np.float32], faces: NDArray[np.int32], n_vertices: int | None):  # type: ignore[no-untyped-def]
    """Return the template's name, the kept vertices, triangles, mirror map and reference positions."""
    from facewright.faces import load_face
    from facewright.faces.coarse_face import coarse_face

    for known in ("builtin", "ict"):
        try:
            face = load_face(known)
        except MissingFaceError:
            continue
        for topology in (face.topology, face.skin().topology):
            if n_vertices is not None and len(rest) == topology.n_vertices and np.array_equal(faces, topology.faces):
                coarse = coarse_face(face, n_vertices)
                return coarse.template, coarse.vertex_ids, coarse.faces, coarse.mirror, coarse.positions
    used = np.unique(faces)
    pieces = len(np.unique(vertex_components(faces, len(rest))[used]))
    if pieces != 1 or len(used) != len(rest):
        loose = len(rest) - len(used)
        raise TopologyError(
            f"the mesh must be one connected piece, got {pieces} pieces and {loose} vertices without a triangle; "
            "give the face's skin alone."
        )
    if n_vertices is None or len(rest) <= n_vertices:
        return "meshes", np.arange(len(rest), dtype=np.int32), faces, None, None
    ids, coarse_faces = subsample_mesh(rest, faces, n_vertices)
    return "meshes", ids, coarse_faces, None, None
