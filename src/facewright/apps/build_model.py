"""Build the bilinear model of a face: simulate people, decompose the tensor, save the model."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from facewright.errors import StoreError, ValueRangeError

if TYPE_CHECKING:
    from facewright.faces.face import Face
    from facewright.models.bilinear import BilinearModel

Progress = Callable[[str, int, int], None]

N_SHAPES = 47  # the neutral and 46 blendshapes
MEMORY_LIMIT_MB = 1500.0


@dataclass(frozen=True)
class BuildModelRequest:
    """What model to build.

    Parameters
    ----------
    out : Path
        The model file to write.
    face : str
        Name of a face or path of its file, see `facewright.faces.load_face`.
    n_people : int
        Simulated people N.
    n_identity, n_expression : int
        Components kept. FaceWarehouse section 3.3 keeps 50 and 25 of 150 and 47; small motions come last in the order
        of components, so that 25 leave closed lids 2 mm open, and all 47 less than 0.3 mm.
    seed : int
        Seed of the simulated people.
    skin_only : bool
        Leave out eyes, teeth and mouth cavity.
    n_unseen : int
        People of another seed on whom the model is checked; 0 for none.
    """

    out: Path
    face: str = "builtin"
    n_people: int = 150
    n_identity: int = 50
    n_expression: int = 47
    seed: int = 0
    skin_only: bool = False
    n_unseen: int = 2

    def __post_init__(self) -> None:
        for name, value, low, high in (
            ("n_people", self.n_people, 2, 10_000),
            ("n_identity", self.n_identity, 1, self.n_people),
            ("n_expression", self.n_expression, 1, N_SHAPES),
            ("seed", self.seed, 0, 2**63 - 1),
            ("n_unseen", self.n_unseen, 0, 1000),
        ):
            if not low <= value <= high:
                raise ValueRangeError(f"{name} must be in [{low}, {high}], got {value}.")


@dataclass(frozen=True, eq=False)
class BuildModelResult:
    """A model and how it was made.

    Parameters
    ----------
    path : Path
        The model file.
    model : BilinearModel
        The model itself.
    n_bytes : int
        Size of the file.
    simulate_seconds, decompose_seconds : float
        Time of the two steps.
    unseen_rms_mm : float or None
        Root mean square distance of corresponding vertices, model against people and expressions that it has not
        seen; None where `n_unseen` was 0.
    """

    path: Path
    model: BilinearModel
    n_bytes: int
    simulate_seconds: float
    decompose_seconds: float
    unseen_rms_mm: float | None


def build_model(request: BuildModelRequest, progress: Progress | None = None) -> BuildModelResult:
    """Simulate people with a face, build their bilinear model and save it.

    Parameters
    ----------
    request : BuildModelRequest
        Face, sizes, seed and file.
    progress : callable, optional
        Called with stage, done, total.

    Returns
    -------
    BuildModelResult
        The model, its file, times, and its error on unseen people.

    Raises
    ------
    MissingFaceError
        If the face is not installed.
    StoreError
        If the folder of `request.out` does not exist or the file cannot be written; before anything is computed
        where that can be known.

    Notes
    -----
    FaceWarehouse section 3.3, eq. (8)-(9). Tensors above 1.5 GB lie in a temporary file beside the model while it is
    built, so that memory stays small.
    """
    from facewright.faces import load_face

    if not request.out.parent.is_dir():
        raise StoreError(f"{request.out} cannot be written: the folder {request.out.parent} does not exist.")
    face = load_face(request.face)
    face = face.skin() if request.skin_only else face
    model, simulate_seconds, decompose_seconds = _build(request, face, progress)
    unseen = _unseen_rms_mm(model, face, request, progress) if request.n_unseen else None

    from facewright.models.bilinear_store import save_bilinear

    save_bilinear(model, request.out)
    n_bytes = request.out.stat().st_size
    return BuildModelResult(request.out, model, n_bytes, simulate_seconds, decompose_seconds, unseen)


def _build(request: BuildModelRequest, face: Face, progress: Progress | None) -> tuple[BilinearModel, float, float]:
    from facewright import __version__
    from facewright.faces.simulate import simulate_population
    from facewright.models.bilinear import fit_bilinear

    shape = (request.n_people, N_SHAPES, face.topology.n_vertices, 3)
    with _scratch_folder(request.out) as folder:
        start = time.perf_counter()
        tensor = _tensor(shape, folder)
        simulate_population(face, request.n_people, np.random.default_rng(request.seed), progress, out=tensor)
        simulated = time.perf_counter()
        model = fit_bilinear(
            tensor,
            request.n_identity,
            request.n_expression,
            topology=face.topology,
            expression_names=("neutral", *face.blendshape_names),
            provenance={
                "source": "simulated people",
                "face": face.name,
                "licence": face.licence,
                "seed": request.seed,
                "n_people": request.n_people,
                "facewright": __version__,
            },
            progress=progress,
        )
        done = time.perf_counter()
        del tensor
    return model, simulated - start, done - simulated


@contextmanager
def _scratch_folder(out: Path) -> Iterator[Path]:
    """Make a folder beside the model, so that a place that cannot be written is told before the long work."""
    try:
        folder = tempfile.TemporaryDirectory(dir=out.parent, prefix=".facewright-")
    except OSError as error:
        raise StoreError(
            f"{out} cannot be written: its folder {out.parent} takes no new files ({error.strerror or error}); give "
            "another place."
        ) from error
    with folder as path:
        yield Path(path)


def _tensor(shape: tuple[int, int, int, int], folder: Path) -> NDArray[np.float32]:
    """Make room for the people: in memory if it is little, else in a file."""
    n_bytes = 4 * int(np.prod(shape, dtype=np.int64))
    if n_bytes <= MEMORY_LIMIT_MB * 2**20:
        return np.zeros(shape, dtype=np.float32)
    import shutil

    free = shutil.disk_usage(folder).free
    if free < 1.02 * n_bytes:
        raise StoreError(f"{folder.parent} must have {n_bytes / 1e9:.1f} GB free while building, got {free / 1e9:.1f}.")
    return np.memmap(folder / "people.f32", np.float32, "w+", shape=shape)


def _unseen_rms_mm(model: BilinearModel, face: Face, request: BuildModelRequest, progress: Progress | None) -> float:
    from facewright.faces.expressions import random_expression_weights
    from facewright.faces.simulate import simulate_person

    rng = np.random.default_rng((request.seed, 1))  # another stream than the training people
    squares = []
    for k in range(request.n_unseen):
        person = simulate_person(face, rng)
        for truth in person.pose(random_expression_weights(rng, 3)):
            found = model.synthesise(*model.project(truth))
            squares.append(((found - truth) ** 2).sum(axis=1).mean())
        if progress is not None:
            progress("checking on unseen people", k + 1, request.n_unseen)
    return float(np.sqrt(np.mean(squares)))
