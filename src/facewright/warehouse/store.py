"""The database of people: subjects x expressions in one Zarr store, local or behind any fsspec URL."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from facewright.errors import FileFormatError, StoreError, TopologyError, ValueRangeError
from facewright.faces.blendshape_names import BLENDSHAPE_NAMES
from facewright.faces.expressions import EXPRESSION_NAMES
from facewright.mesh.topology import Topology
from facewright.numeric.check import check_choice
from facewright.warehouse.entry import SubjectEntry, read_entries
from facewright.warehouse.layout import (
    FIELDS,
    ROOT,
    failure_folder,
    group_document,
    label_key,
    subject_key,
)
from facewright.warehouse.objects import Objects, open_objects
from facewright.warehouse.subject import Subject, check_name

if TYPE_CHECKING:
    from facewright.faces.face import Face
    from facewright.warehouse.blendshape_tensor import BlendshapeTensor
    from facewright.warehouse.failures import Failure
    from facewright.warehouse.query import Value

_RESERVED = ("zarr.json",)


class Warehouse:
    """An open database; made by `Warehouse.create` or `Warehouse.open`, cheap, and safe to pickle.

    Arrays come back bit by bit as they were written. Subjects appear whole or not at all; many processes may read and
    write at once. See `facewright.warehouse.layout` for what lies where.
    """

    def __init__(self, objects: Objects, document: dict[str, Any], mode: str) -> None:
        self.objects = objects
        self.document = document
        self.mode = mode

    # --- making and opening ------------------------------------------------------------------------------------------

    @classmethod
    def create(
        cls,
        url: str | os.PathLike[str],
        face: Face | Topology,
        *,
        expression_names: Sequence[str] = EXPRESSION_NAMES,
        blendshape_names: Sequence[str] = BLENDSHAPE_NAMES,
        exist_ok: bool = False,
    ) -> Warehouse:
        """Make an empty database.

        Parameters
        ----------
        url : str or path
            New or empty folder, or URL that fsspec knows.
        face : Face or Topology
            What all meshes in it are of.
        expression_names : sequence of str
            Expressions that subjects are asked for, the neutral first.
        blendshape_names : sequence of str
            The 46 blendshapes without the neutral.
        exist_ok : bool
            Open the database that is there, if it is of this topology and these blendshapes. Of two processes that
            create at once, one makes the store and the other opens it.

        Raises
        ------
        StoreError
            If something is there already, or the place cannot be written.
        TopologyError
            If `exist_ok` and the database there is of another topology or other blendshapes.
        """
        from facewright import __version__
        from facewright.warehouse.arrays import import_zarr
        from facewright.warehouse.root_document import make_root

        import_zarr()
        names = tuple(expression_names), tuple(blendshape_names)
        if names[0][:1] != ("neutral",) or any(len(set(some)) < len(some) for some in names) or len(names[1]) != 46:
            raise ValueRangeError(
                "expression_names must be unique and begin with 'neutral', blendshape_names be 46 unique names, got "
                f"{names[0]} and {len(names[1])} names."
            )
        objects = open_objects(url)
        topology = face if isinstance(face, Topology) else face.topology
        facts = {
            "face": topology.name if isinstance(face, Topology) else face.name,
            "licence": "" if isinstance(face, Topology) else face.licence,
            "expression_names": list(names[0]),
            "blendshape_names": list(names[1]),
            "facewright": __version__,
        }
        there = objects.get([ROOT])[0] is not None
        document = None if there else make_root(objects, topology, facts)
        return cls._existing(url, topology, names[1], exist_ok) if document is None else cls(objects, document, "a")

    @classmethod
    def _existing(
        cls, url: str | os.PathLike[str], topology: Topology, blendshape_names: tuple[str, ...], exist_ok: bool
    ) -> Warehouse:
        if not exist_ok:
            raise StoreError(f"{url} must be a new place, got one that holds a Zarr store already; open it instead.")
        store = cls.open(url, "a")
        if store.topology.fingerprint != topology.fingerprint:
            raise TopologyError(
                f"{url} must be a database of {topology.name!r} ({topology.n_vertices} vertices), got one of "
                f"{store.face_name!r} ({store.n_vertices} vertices)."
            )
        if store.blendshape_names[1:] != blendshape_names:
            raise TopologyError(
                f"{url} must be a database with blendshapes {', '.join(blendshape_names[:3])} ..., got "
                f"{', '.join(store.blendshape_names[1:4])} ..."
            )
        return store

    @classmethod
    def open(cls, url: str | os.PathLike[str], mode: str = "r") -> Warehouse:
        """Open a database: ``"r"`` to read, ``"a"`` to write, too.

        Raises
        ------
        StoreError
            If there is none, or it cannot be read.
        FileFormatError
            If what is there is foreign, damaged or of another version.
        """
        from facewright.warehouse.root_document import read_root

        check_choice("mode", mode, ("r", "a"))
        objects = open_objects(url)
        return cls(objects, read_root(objects), mode)

    # --- what it is of -----------------------------------------------------------------------------------------------

    @property
    def url(self) -> str:
        """Where it lies."""
        return self.objects.url

    @property
    def version(self) -> int:
        """Version of the store's layout."""
        return int(self.document["version"])

    @property
    def face_name(self) -> str:
        """Name of the face whose topology it is of."""
        return str(self.document["face"])

    @property
    def licence(self) -> str:
        """Licence and attribution of the face's geometry."""
        return str(self.document.get("licence", ""))

    @property
    def expression_names(self) -> tuple[str, ...]:
        """Expressions that subjects are asked for, the neutral first; a subject may have others."""
        return tuple(self.document["expression_names"])

    @property
    def blendshape_names(self) -> tuple[str, ...]:
        """Names of the 47 rows of blendshapes: ``"neutral"`` and the 46."""
        return ("neutral", *self.document["blendshape_names"])

    @property
    def n_vertices(self) -> int:
        """Number of vertices V of every mesh."""
        return int(self.document["topology"]["n_vertices"])

    @cached_property
    def topology(self) -> Topology:
        """The topology, read from the store."""
        from facewright.warehouse.topology_arrays import read_topology

        return read_topology(self.objects, self.document["topology"])

    # --- subjects ----------------------------------------------------------------------------------------------------

    def subject_names(self, where: str | Iterable[str] = (), **attributes: Value) -> list[str]:
        """Return the names of subjects, sorted; no arrays are read.

        Parameters
        ----------
        where : str or iterable of str
            Conditions such as ``"age > 30 and sex = f"``; all must hold. See `facewright.warehouse.query.Condition`.
        **attributes
            Attributes that must be equal.

        Raises
        ------
        ValueRangeError
            If a condition cannot be read, or is about an attribute that no subject has.
        """
        return [entry.name for entry in self.entries(where, **attributes)]

    def entries(self, where: str | Iterable[str] = (), **attributes: Value) -> list[SubjectEntry]:
        """Return the small documents of subjects, sorted by name; see `subject_names`."""
        from facewright.warehouse.query import check_known, conditions_of

        conditions = conditions_of(where, **attributes)
        entries = read_entries(self.objects, [n for n in self.objects.names_in("subjects") if n not in _RESERVED])
        if not conditions or not entries:
            return entries
        check_known(conditions, (entry.attributes for entry in entries))
        return [e for e in entries if all(condition.fits(e.attributes) for condition in conditions)]

    def entry(self, name: str) -> SubjectEntry:
        """Return the small document of one subject.

        Raises
        ------
        StoreError
            If there is no such subject.
        FileFormatError
            If its document is damaged.
        """
        check_name(name)
        found = read_entries(self.objects, [name])
        if not found:
            raise StoreError(f"{self.url} has no subject {name!r}; see facewright warehouse ls.")
        return found[0]

    def __contains__(self, name: str) -> bool:
        return self.objects.get([subject_key(name)])[0] is not None

    def read_subject(self, name: str, fields: Iterable[str] | None = None) -> Subject:
        """Read a subject, checking every array against its checksum.

        Parameters
        ----------
        name : str
        fields : iterable of str, optional
            Arrays to read beside the meshes; all by default. The others are None.

        Raises
        ------
        StoreError
            If there is no such subject, or the store cannot be read.
        FileFormatError
            If an array is missing, truncated or corrupt; the message names subject and array.
        """
        wanted = list(FIELDS) if fields is None else ["meshes", *fields]
        for field in wanted:
            check_choice("field", field, FIELDS)
        entry, arrays = self._read(name, wanted)
        return Subject(
            name=name,
            expressions=entry.expressions,
            attributes=entry.attributes,
            provenance=entry.provenance,
            **arrays,
        )

    def read_array(self, name: str, field: str) -> NDArray[Any] | None:
        """Read one array of a subject, such as ``"blendshapes"``; None where the subject has none."""
        check_choice("field", field, FIELDS)
        return self._read(name, [field])[1].get(field)

    def write_subject(self, subject: Subject, overwrite: bool = False) -> SubjectEntry:
        """Write a subject, whole or not at all, and forget its recorded failure.

        Raises
        ------
        StoreError
            If it is there already and `overwrite` is False, the database is open for reading only, or there is no
            room.
        TopologyError
            If its meshes are of another number of vertices.
        """
        from facewright.warehouse.commit import commit_subject

        self._check_writable()
        if subject.name in _RESERVED:
            raise ValueRangeError(f"name of a subject must not be {subject.name!r}, which the store needs itself.")
        for field in ("meshes", "blendshapes"):
            array = getattr(subject, field)
            if array is not None and array.shape[1] != self.n_vertices:
                raise TopologyError(
                    f"{field} of subject {subject.name!r} must have the {self.n_vertices} vertices of "
                    f"{self.face_name!r}, got {array.shape[1]}."
                )
        entry = commit_subject(self.objects, subject, overwrite=overwrite)
        self.objects.delete(failure_folder(subject.name))
        return entry

    def remove_subject(self, name: str) -> None:
        """Remove a subject with all its arrays and labels; a recorded failure of that name goes, too."""
        self._check_writable()
        from facewright.warehouse.commit import remove_subject

        if not remove_subject(self.objects, name):
            raise StoreError(f"{self.url} has no subject {name!r}; see facewright warehouse ls.")

    def set_labels(self, name: str, attributes: Mapping[str, Value | None]) -> dict[str, Any]:
        """Set attributes of a subject; they win over those it was written with, also when it is written again.

        None takes an attribute away. Arrays and `digest` stay as they are.

        Returns
        -------
        dict
            All attributes, as they hold now.
        """
        from facewright.warehouse.commit import checked_attributes

        self._check_writable()
        entry = self.entry(name)
        checked: dict[str, Any] = checked_attributes({k: v for k, v in attributes.items() if v is not None})
        labels = {**entry.labels, **checked, **{key: None for key, value in attributes.items() if value is None}}
        self.objects.put(label_key(name), group_document({"labels": labels}))
        return replace(entry, labels=labels).attributes

    def digest(self, name: str) -> str:
        """Return the SHA-256 of a subject's contents: equal contents, equal digest, wherever and whenever written."""
        return self.entry(name).digest

    def blendshape_tensor(self, names: Sequence[str] | None = None) -> BlendshapeTensor:
        """Return the blendshapes of subjects as a tensor (N, 47, V, 3) that is read by blocks of vertices.

        Parameters
        ----------
        names : sequence of str, optional
            Which subjects, in which order; by default all that have blendshapes, by name.

        Raises
        ------
        StoreError
            If there is no subject of a name, or none with blendshapes.
        """
        from facewright.warehouse.blendshape_tensor import BlendshapeTensor

        entries = self.entries() if names is None else read_entries(self.objects, list(names))
        missing = set(names or ()) - {entry.name for entry in entries}
        missing |= {entry.name for entry in entries if names is not None and "blendshapes" not in entry.arrays}
        entries = [entry for entry in entries if "blendshapes" in entry.arrays]
        if missing or not entries:
            whom = f"for {', '.join(sorted(missing)[:5])}" if missing else "for any subject"
            raise StoreError(f"{self.url} has no blendshapes {whom}; see facewright warehouse ls.")
        return BlendshapeTensor(self.objects, entries)

    # --- failures ----------------------------------------------------------------------------------------------------

    def record_failure(self, name: str, reason: str, kind: str = "") -> None:
        """Keep why a subject could not be made, until it is written; an older subject of that name stays.

        Parameters
        ----------
        name : str
            Any text, since an unusable name may be the reason.
        reason : str
            One sentence.
        kind : str
            Kind of failure, such as the error's class.
        """
        from facewright.warehouse.failures import write_failure

        self._check_writable()
        write_failure(self.objects, name, reason, kind)

    def failures(self) -> dict[str, Failure]:
        """Return recorded failures by subject, sorted by name."""
        from facewright.warehouse.failures import read_failures

        return read_failures(self.objects)

    def read_field(self, entry: SubjectEntry, field: str) -> NDArray[Any]:
        """Read one of the arrays that `entry` tells of, and check it."""
        from facewright.warehouse.arrays import read_array

        where = f"{self.url}: {field} of subject {entry.name!r}"
        return read_array(self.objects, f"{entry.folder}/{field}", entry.arrays[field], where)

    def _read(self, name: str, fields: Sequence[str]) -> tuple[SubjectEntry, dict[str, NDArray[Any]]]:
        entry = self.entry(name)
        while True:
            try:
                return entry, {key: self.read_field(entry, key) for key in entry.arrays if key in fields}
            except FileFormatError:
                entry, before = self.entry(name), entry
                if entry.token == before.token:  # else it was written again meanwhile
                    raise

    def _check_writable(self) -> None:
        if self.mode != "a":
            raise StoreError(f"{self.url} is open for reading only; open it with mode 'a'.")
