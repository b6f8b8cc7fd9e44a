"""Build the bilinear model of the people in a database (FaceWarehouse 3.3)."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from facewright.errors import DegenerateError, StoreError, ValueRangeError

if TYPE_CHECKING:
    from facewright.models.bilinear import BilinearModel
    from facewright.warehouse.store import Warehouse

Progress = Callable[[str, int, int], None]

N_SHAPES = 47  # the neutral and 46 blendshapes


@dataclass(frozen=True)
class BuildDatabaseModelRequest:
    """What model to build of whom.

    Parameters
    ----------
    database : str
        Folder or URL of the database.
    out : Path
        The model file to write.
    n_identity, n_expression : int
        Components kept; no more identity components than people are used.
    where : tuple of str
        Conditions on attributes, such as ``age > 30``, that people must meet; all people where empty.
    n_held_out : int
        People left out of the model, evenly spread over the names, on whom it is checked.
    workers : int
        Worker processes on this machine; 0 for none.
    scheduler : str, optional
        Address of an existing Dask scheduler instead.
    retries : int
        Further attempts at a block that could not be read.
    block_mb : float
        Size of the blocks that are read at a time.
    """

    database: str
    out: Path
    n_identity: int = 50
    n_expression: int = N_SHAPES
    where: tuple[str, ...] = ()
    n_held_out: int = 0
    workers: int = 0
    scheduler: str | None = None
    retries: int = 2
    block_mb: float = 64.0

    def __post_init__(self) -> None:
        for name, value, low, high in (
            ("n_identity", self.n_identity, 1, 1_000_000),
            ("n_expression", self.n_expression, 1, N_SHAPES),
            ("n_held_out", self.n_held_out, 0, 1_000_000),
        ):
            if not low <= value <= high:
                raise ValueRangeError(f"{name} must be in [{low}, {high}], got {value}.")


@dataclass(frozen=True, eq=False)
class BuildDatabaseModelResult:
    """A model and how it was made.

    Parameters
    ----------
    path : Path
        The model file.
    model : BilinearModel
        The model itself.
    n_bytes : int
        Size of the file.
    n_without_blendshapes : int
        People in the database who have none and were left out.
    decompose_seconds : float
        Time of reading and decomposing.
    unseen_rms_mm : float or None
        Root mean square distance of corresponding vertices between the people held out, in all 47 shapes, and the
        model's nearest faces; None where nobody was held out.
    """

    path: Path
    model: BilinearModel
    n_bytes: int
    n_without_blendshapes: int
    decompose_seconds: float
    unseen_rms_mm: float | None


def build_database_model(
    request: BuildDatabaseModelRequest,
    progress: Progress | None = None,
    *,
    on_dashboard: Callable[[str], None] | None = None,
) -> BuildDatabaseModelResult:
    """Decompose the blendshapes of a database's people by blocks of vertices and save the model.

    Memory does not grow with the number of people; see `BlockedTensor`. The people's labels (age, sex, ...), without
    their names and without free texts, go into the model, where `facewright edit` finds them.

    Raises
    ------
    StoreError
        If there is no database, it cannot be read, or the model's folder does not exist.
    FileFormatError
        If the database is foreign or damaged.
    DegenerateError
        If fewer than two people with blendshapes remain.
    ValueRangeError
        If a condition is not one.

    Notes
    -----
    FaceWarehouse section 3.3, eq. (8)-(9), whose tensor is made of the 47 FACS shapes of each person, as here.
    """
    from facewright.models.bilinear import fit_bilinear
    from facewright.models.bilinear_store import save_bilinear
    from facewright.warehouse.dask_cluster import open_cluster
    from facewright.warehouse.gram_blocks import BlockedTensor
    from facewright.warehouse.store import Warehouse

    if not request.out.parent.is_dir():
        raise StoreError(f"{request.out} cannot be written: the folder {request.out.parent} does not exist.")
    warehouse = Warehouse.open(request.database)
    training, held_out, n_without = _choose(warehouse, request)
    start = time.perf_counter()
    with open_cluster(request.workers, request.scheduler, retries=request.retries) as cluster:
        if on_dashboard is not None and cluster.dashboard:
            on_dashboard(cluster.dashboard)
        tensor = warehouse.blendshape_tensor(training)
        model = fit_bilinear(
            BlockedTensor(tensor, cluster, request.block_mb, retries=request.retries),
            min(request.n_identity, len(training)),
            request.n_expression,
            topology=warehouse.topology,
            expression_names=warehouse.blendshape_names,
            provenance=_provenance(warehouse, training, held_out, request),
            progress=progress,
        )
    model = replace(model, labels=_labels(warehouse, training))
    seconds = time.perf_counter() - start
    unseen = _unseen_rms_mm(model, warehouse, held_out, progress) if held_out else None
    save_bilinear(model, request.out)
    return BuildDatabaseModelResult(request.out, model, request.out.stat().st_size, n_without, seconds, unseen)


def _choose(warehouse: Warehouse, request: BuildDatabaseModelRequest) -> tuple[list[str], list[str], int]:
    """Return the names to learn from, those held out, and how many have no blendshapes."""
    entries = warehouse.entries(request.where)
    names = [entry.name for entry in entries if "blendshapes" in entry.arrays]
    if len(names) - request.n_held_out < 2:
        held = f" after {request.n_held_out} are held out" if request.n_held_out else ""
        whom = " that meet the conditions" if request.where else ""
        raise DegenerateError(
            f"{warehouse.url} must have at least two people with blendshapes{whom}{held}, "
            f"got {max(len(names) - request.n_held_out, 0)}."
        )
    places = np.linspace(0, len(names) - 1, request.n_held_out + 2)[1:-1].round().astype(int)
    held_out = [names[place] for place in places]
    return [name for name in names if name not in held_out], held_out, len(entries) - len(names)


def _provenance(
    warehouse: Warehouse, training: list[str], held_out: list[str], request: BuildDatabaseModelRequest
) -> dict[str, object]:
    from facewright import __version__

    return {
        "source": "database",
        "database": Path(warehouse.url).name,
        "where": list(request.where),
        "face": warehouse.face_name,
        "licence": warehouse.licence,
        "contents": _contents(warehouse, training),
        "n_people": len(training),
        "n_held_out": len(held_out),
        "facewright": __version__,
    }


def _labels(warehouse: Warehouse, names: list[str]) -> dict[str, tuple[str | int | float | bool | None, ...]]:
    """Return what the people are labelled with, one value a person, None where it is not known.

    Texts that differ from person to person are left out: they are notes or names, not kinds of people.
    """
    from facewright.models.label_regression import MAX_CATEGORIES

    attributes = {entry.name: entry.attributes for entry in warehouse.entries()}
    labels = {}
    for key in sorted({key for name in names for key in attributes[name]}):
        values = tuple(_plain(attributes[name].get(key)) for name in names)
        if len({value for value in values if isinstance(value, str)}) <= MAX_CATEGORIES:
            labels[key] = values
    return labels


def _plain(value: object) -> str | int | float | bool | None:
    """Return a label as a number where it is one, also one that was written as text."""
    from facewright.warehouse.query import parse_value

    if isinstance(value, str):
        return parse_value(value) if value.strip() else None
    if isinstance(value, bool | int) or (isinstance(value, float) and np.isfinite(value)):
        return value
    return None


def _contents(warehouse: Warehouse, names: list[str]) -> str:
    """Return 16 hex digits that are the same for the same people with the same contents."""
    digest, chosen = hashlib.sha256(), set(names)
    for entry in warehouse.entries():
        if entry.name in chosen:
            digest.update(f"{entry.name} {entry.digest}\n".encode())
    return digest.hexdigest()[:16]


def _unseen_rms_mm(model: BilinearModel, warehouse: Warehouse, names: list[str], progress: Progress | None) -> float:
    from facewright.models.bilinear_projection import BilinearProjector

    projector = BilinearProjector(model)
    squares: list[float] = []
    for done, name in enumerate(names, start=1):
        shapes = warehouse.read_array(name, "blendshapes")
        assert shapes is not None  # chosen for having them
        squares.extend(projector.fit(shape).rms_mm ** 2 for shape in shapes)
        if progress is not None:
            progress("checking on people held out", done, len(names))
    return float(np.sqrt(np.mean(squares)))
