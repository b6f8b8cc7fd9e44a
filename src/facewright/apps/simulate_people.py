"""Put simulated people into a database, so that a model can be built before many real ones are captured."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from facewright.errors import ValueRangeError

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class SimulatePeopleRequest:
    """Whom to simulate, and into which database.

    Parameters
    ----------
    out : str
        The database: a folder or an fsspec URL; made if it is not there.
    n_people : int
        People, called ``simulated-0000`` and so on; those that are there already stay as they are.
    face : str
        ``builtin``, ``ict`` or the path of a face's .npz file.
    seed : int
        Each person depends on it and on the person's number alone.
    """

    out: str
    n_people: int = 40
    face: str = "builtin"
    seed: int = 0

    def __post_init__(self) -> None:
        if not 1 <= self.n_people <= 10_000:
            raise ValueRangeError(f"n_people must be in [1, 10000], got {self.n_people}.")


@dataclass(frozen=True)
class SimulatePeopleResult:
    """Who was added.

    Parameters
    ----------
    url : str
        The database.
    added, present : tuple of str
        Names of the people added, and of those that had been there.
    """

    url: str
    added: tuple[str, ...]
    present: tuple[str, ...]


def simulate_people(request: SimulatePeopleRequest, progress: Progress | None = None) -> SimulatePeopleResult:
    """Add simulated people to a database: neutral and 46 personal blendshapes each, all parts of the face.

    Parameters
    ----------
    request : SimulatePeopleRequest
        Database, number, face and seed.
    progress : callable, optional
        Called as progress("simulating people", done, total).

    Returns
    -------
    SimulatePeopleResult

    Raises
    ------
    MissingFaceError, MissingExtraError
        If the face, or a package of the database, is not installed.
    StoreError, FileFormatError
        If the database cannot be written, or is none.
    TopologyError
        If it holds another face.
    """
    from facewright import __version__
    from facewright.faces import load_face
    from facewright.faces.simulate import simulate_person
    from facewright.warehouse.store import Warehouse
    from facewright.warehouse.subject import Subject

    face = load_face(request.face)
    warehouse = Warehouse.create(request.out, face, exist_ok=True)
    there = set(warehouse.subject_names())
    names = [f"simulated-{k:04d}" for k in range(request.n_people)]
    added = []
    for k, name in enumerate(names):
        if name not in there:
            person = simulate_person(face, np.random.default_rng((request.seed, k)))
            shapes = np.concatenate([person.neutral[None], person.neutral + person.deltas])
            provenance = {"source": "simulated", "face": face.name, "seed": request.seed, "number": k}
            warehouse.write_subject(
                Subject(
                    name=name,
                    expressions=("neutral",),
                    meshes=shapes[:1],
                    blendshapes=shapes,
                    attributes={"simulated": True},
                    provenance={**provenance, "facewright": __version__},
                )
            )
            added.append(name)
        if progress is not None:
            progress("simulating people", k + 1, request.n_people)
    return SimulatePeopleResult(warehouse.url, tuple(added), tuple(name for name in names if name in there))
