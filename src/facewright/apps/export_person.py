"""Export a person chosen by the user: generic, simulated, from a model, a fitted photo, or a database."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from facewright.apps.export import ExportRequest, ExportResult, demo_clip, export_rig
from facewright.apps.paint_person import face_of_model, person_colors
from facewright.errors import FileFormatError, MissingFaceError, TopologyError, ValueRangeError

if TYPE_CHECKING:
    from facewright.faces.face import Face
    from facewright.mesh.topology import Topology
    from facewright.models.bilinear import BilinearModel
    from facewright.models.blendshapes import BlendshapeRig

Progress = Callable[[str, int, int], None]

FIT_FORMAT = "facewright photo fit"


@dataclass(frozen=True)
class ExportPersonRequest:
    """Whom to export and how.

    Parameters
    ----------
    out : Path
        ``.glb``, ``.gltf``, or a folder.
    model : Path, optional
        Model file; with `person` (training person) or `fit` (JSON of a fitted photo), else its mean person.
    database, subject : str, optional
        Database and name of a person in it, in place of a model.
    face : str
        Face to export where neither is given; its generic rig, or the simulated person of `seed`.
    names : str
        Naming scheme, see `ExportRequest`.
    texture : Path, optional
        Picture of the skin.
    animate : bool
        Add the demo clip.
    """

    out: Path
    model: Path | None = None
    person: int | None = None
    fit: Path | None = None
    face: str = "builtin"
    seed: int | None = None
    names: str = "facewright"
    texture: Path | None = None
    animate: bool = False
    database: str | None = None
    subject: str | None = None

    def __post_init__(self) -> None:
        if self.model is None and (self.person is not None or self.fit is not None):
            raise ValueRangeError("model must be given with person or fit, got none.")
        if self.person is not None and self.fit is not None:
            raise ValueRangeError("person must be left out where fit is given, got both.")
        if self.model is not None and self.seed is not None:
            raise ValueRangeError("seed must be left out where a model is given, got both.")
        if (self.database is None) != (self.subject is None):
            given, lacking = ("database", "subject") if self.subject is None else ("subject", "database")
            raise ValueRangeError(f"{lacking} must be given with {given}, got none.")
        if self.database is not None and (self.model is not None or self.seed is not None):
            raise ValueRangeError("model and seed must be left out where a database is given, got both.")


def export_person(request: ExportPersonRequest, progress: Progress | None = None) -> ExportResult:
    """Export the person that `request` names; see `export_rig` for files and errors.

    Raises
    ------
    ValueRangeError
        If the model has no such training person, or the database's person has no blendshapes.
    StoreError
        If there is no such database or person.
    FileFormatError, TopologyError
        If the fit's JSON is not one, or was made with another model.
    """
    source = _from_database if request.database is not None else _from_face if request.model is None else _from_model
    rig, topology, face, licence = source(request)
    texture = None
    if request.texture is not None:
        from facewright.io.image import read_image

        texture = read_image(request.texture)
    return export_rig(
        ExportRequest(
            rig=rig,
            topology=topology,
            out=request.out,
            names=request.names,
            texture=texture,
            vertex_colors=person_colors(face, request.seed),
            clip=demo_clip(rig.names) if request.animate else None,
            copyright=licence,
        ),
        progress,
    )


def _from_face(request: ExportPersonRequest) -> tuple[BlendshapeRig, Topology, Face | None, str]:
    from facewright.faces import load_face
    from facewright.faces.simulate import simulate_person
    from facewright.models.blendshapes import BlendshapeRig

    face = load_face(request.face)
    if request.seed is None:
        rig = BlendshapeRig(face.mean_shape, face.blendshape_names, face.blendshape_deltas)
    else:
        person = simulate_person(face, np.random.default_rng(request.seed))
        rig = BlendshapeRig(person.neutral, face.blendshape_names, person.deltas)
    return rig, face.topology, face, face.licence


def _from_database(request: ExportPersonRequest) -> tuple[BlendshapeRig, Topology, Face | None, str]:
    from facewright.faces import load_face
    from facewright.models.blendshapes import BlendshapeRig
    from facewright.warehouse.store import Warehouse

    assert request.database is not None and request.subject is not None
    warehouse = Warehouse.open(request.database)
    shapes = warehouse.read_subject(request.subject, ["blendshapes"]).blendshapes
    if shapes is None:
        raise ValueRangeError(f"subject must have blendshapes to be a rig, got {request.subject!r} without.")
    try:
        known = load_face(warehouse.face_name)
    except MissingFaceError:
        known = None
    face = known if known is not None and known.topology.fingerprint == warehouse.topology.fingerprint else None
    rig = BlendshapeRig(shapes[0], warehouse.blendshape_names[1:], shapes[1:] - shapes[0])
    return rig, warehouse.topology, face, warehouse.licence


def _from_model(request: ExportPersonRequest) -> tuple[BlendshapeRig, Topology, Face | None, str]:
    from facewright.models.bilinear_store import load_bilinear

    assert request.model is not None
    model = load_bilinear(request.model)
    if request.fit is not None:
        w_id = _fitted_identity(request.fit, model, request.model)
    elif request.person is not None:
        if request.person >= len(model.identity_weights):
            raise ValueRangeError(
                f"person must be below the {len(model.identity_weights)} training people of {request.model}, "
                f"got {request.person}."
            )
        w_id = model.identity_weights[request.person]
    else:
        w_id = model.identity_mean
    return model.blendshapes(w_id), model.topology, face_of_model(model), str(model.provenance.get("licence", ""))


def _fitted_identity(path: Path, model: BilinearModel, model_path: Path) -> NDArray[np.float64]:
    from facewright.faces.blendshape_names import read_json

    content = read_json(path)
    content = content if isinstance(content, dict) else {}
    if content.get("format", FIT_FORMAT) != FIT_FORMAT or content.get("version", 1) != 1:
        found = f"{content.get('format', FIT_FORMAT)!r} version {content.get('version', 1)!r}"
        raise FileFormatError(f"{path} must be {FIT_FORMAT!r} version 1, got {found}.")
    origin = content.get("model")
    origin = origin if isinstance(origin, dict) else {}
    topology = origin.get("topology")
    if topology not in (None, model.topology.fingerprint):
        raise TopologyError(
            f"{path} must be a fit of topology {model.topology.fingerprint}, the model's, got {topology!r}."
        )
    weights = content.get("identity_weights")
    try:
        w_id = np.array(weights, dtype=np.float64)
    except (TypeError, ValueError):
        w_id = np.empty(0)
    if w_id.shape != (model.n_identity,) or not np.isfinite(w_id).all():
        raise FileFormatError(
            f"{path} must hold 'identity_weights' of {model.n_identity} numbers, as `facewright fit` writes them "
            f"with this model, got {w_id.size}."
        )
    _check_model_id(path, origin.get("model_id"), model, model_path)
    return w_id


def _check_model_id(path: Path, found: object, model: BilinearModel, model_path: Path) -> None:
    """Refuse weights of another model: with this one, they would silently make another person."""
    if found is None:
        raise FileFormatError(
            f"{path} must say by 'model_id' with which model the photo was fitted, got none: it was written by an "
            f"older facewright or by hand; run facewright fit with {model_path} again."
        )
    if found != model.model_id:
        raise FileFormatError(
            f"{path} must be a fit with the model {model_path}, whose model_id is {model.model_id}, got a fit with "
            f"model {found}; give that model, or run facewright fit with this one."
        )
