"""One person from recordings to meshes and blendshapes, fully automatically (FaceWarehouse 3.1 and 3.2)."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from facewright.camera.pinhole import RigidMotion
from facewright.errors import (
    DegenerateError,
    FacewrightError,
    FileFormatError,
    MissingExtraError,
    MissingFaceError,
    StoreError,
    ValueRangeError,
)
from facewright.faces.expressions import EXPRESSION_NAMES, expression_weights
from facewright.numeric.threads import one_blas_thread
from facewright.warehouse.expression_record import (
    ExpressionRecord,
    LoadedRecording,
    StageClock,
    needs_detector,
    padded,
    read_record,
)
from facewright.warehouse.personal_rig import PersonalRig, fit_personal_rig
from facewright.warehouse.provenance import package_versions, plain, without_folder
from facewright.warehouse.subject import Subject

if TYPE_CHECKING:
    from facewright.capture.captures import SubjectCapture
    from facewright.faces.face import Face
    from facewright.fitting.scan import ScanFit, ScanFitter
    from facewright.landmarks.detector import LandmarkDetector

Progress = Callable[[str, int, int], None]

STAGES = ("read", "fuse", "landmark", "neutral", "expression", "rig")
"""Keys of the seconds that `process_timed` returns."""


@dataclass(frozen=True)
class ProcessOptions:
    """How recordings become a subject; plain values only, so that they travel to workers and into provenance.

    Parameters
    ----------
    face : str
        Name or path of the face, see `facewright.faces.load_face`.
    least_expressions : int
        Expressions besides the neutral without which no blendshapes are made and the subject fails.
    keep_records : bool
        Keep fused depth and picture of each expression in the subject.
    keep_raw : bool
        Keep the reference frames' depth as the camera gave it, too.
    task_file : str
        A ``face_landmarker.task`` file for MediaPipe releases that need one; empty for none.
    fusion : str
        Engine of the fusion, see `facewright.capture.fusion.FusionOptions`.
    """

    face: str = "builtin"
    least_expressions: int = 10
    keep_records: bool = True
    keep_raw: bool = False
    task_file: str = ""
    fusion: str = "numba"

    def __post_init__(self) -> None:
        if not 1 <= self.least_expressions < len(EXPRESSION_NAMES):
            raise ValueRangeError(
                f"least_expressions must be between 1 and {len(EXPRESSION_NAMES) - 1}, got {self.least_expressions}."
            )
        if self.fusion != "numba":
            from facewright.capture.fusion import FusionOptions

            FusionOptions(engine=self.fusion)  # before the work: tells unknown engines and a missing extra


class ProcessedSubject(NamedTuple):
    """A subject and how long each stage took.

    Attributes
    ----------
    subject : Subject
        The result; it knows nothing of times.
    seconds : dict of str to float
        Wall-clock seconds of each of `STAGES`.
    """

    subject: Subject
    seconds: dict[str, float]


def process_subject(
    capture: SubjectCapture, options: ProcessOptions | None = None, progress: Progress | None = None
) -> Subject:
    """Make meshes and blendshapes of one person from recordings; see `process_timed`."""
    return process_timed(capture, options, progress).subject


def process_timed(
    capture: SubjectCapture, options: ProcessOptions | None = None, progress: Progress | None = None
) -> ProcessedSubject:
    """Make meshes and blendshapes of one person from recordings, and tell where the time went.

    Recordings are fused, landmarks found on their reference frames (points of a sidecar win), the neutral is fitted,
    then the other expressions; all are brought into one head frame; 46 blendshapes are recovered by example-based
    rigging with the acted weights estimated; eyeballs, teeth, lashes and the other parts are attached. An expression
    that fails is left out and recorded in the provenance.

    Parameters
    ----------
    capture : SubjectCapture
        From `facewright.capture.captures.list_captures`.
    options : ProcessOptions, optional
        How.
    progress : callable, optional
        Called as progress(expression, done, total).

    Returns
    -------
    ProcessedSubject
        Equal input gives an equal subject, bit by bit, with any number of threads.

    Raises
    ------
    FileFormatError
        If the capture has problems, such as no recording of the neutral.
    MissingExtraError
        If a package is missing: MediaPipe while a recording has no complete sidecar, or what reads the recordings.
    FacewrightError
        If the neutral cannot be used, of the kind that its failure was.
    DegenerateError
        If fewer than `least_expressions` other expressions can be used.
    """
    options = options or ProcessOptions()
    if capture.problems or "neutral" not in capture.recordings:
        raise FileFormatError(
            " ".join(capture.problems) or f"{capture.path} must have a recording of the neutral expression."
        )
    with one_blas_thread():  # the same bits for any number of threads; the kernels that count have their own
        return _process(capture, options, progress)


def _process(capture: SubjectCapture, options: ProcessOptions, progress: Progress | None) -> ProcessedSubject:
    from facewright.faces import load_face

    face = load_face(options.face)
    run = _Run(face, capture, StageClock({stage: 0.0 for stage in STAGES}), progress, options.fusion)
    with run.detector(options.task_file) as detector:
        run.fit_all(detector)
    if len(run.fits) - 1 < options.least_expressions:
        raise DegenerateError(
            f"subject {capture.name!r} must have at least {options.least_expressions} usable "
            f"{'expression' if options.least_expressions == 1 else 'expressions'} besides the neutral, got "
            f"{len(run.fits) - 1}" + run.why_not() + "."
        )
    with run.clock.time("rig"):
        rig = run.rig()
    return ProcessedSubject(run.subject(options, rig), run.clock.seconds)


class _Run:
    """One subject on its way through the stages."""

    def __init__(
        self, face: Face, capture: SubjectCapture, clock: StageClock, progress: Progress | None, fusion: str
    ) -> None:
        self.face, self.capture, self.clock, self.progress, self.fusion = face, capture, clock, progress, fusion
        names = [name for name in EXPRESSION_NAMES if name in capture.recordings]
        self.names = sorted(names, key=lambda name: name != "neutral")  # the neutral first, others in their order
        self.records: dict[str, ExpressionRecord] = {}
        self.fits: dict[str, ScanFit] = {}
        self.failed: dict[str, dict[str, str]] = {}

    def detector(self, task_file: str) -> Any:
        """Return the context of a detector, or of None where sidecars hold everything."""
        if not needs_detector(dict(self.capture.recordings)):
            return nullcontext(None)
        from facewright.landmarks.detector import open_detector

        with self.clock.time("landmark"):
            return open_detector(task_file or None)

    def fit_all(self, detector: LandmarkDetector | None) -> None:
        """Read and fit every expression; the neutral must succeed."""
        fitter = scan_fitter(self.face)
        with ThreadPoolExecutor(1, thread_name_prefix="recordings") as reader:
            ahead = self._load(reader, 0)
            for done, name in enumerate(self.names):
                if self.progress is not None:
                    self.progress(name, done, len(self.names))
                loaded, ahead = ahead, self._load(reader, done + 1)
                assert loaded is not None
                try:
                    self._fit(fitter, name, detector, loaded)
                except FacewrightError as error:
                    self._record_failure(name, error)
        if self.progress is not None:
            self.progress("blendshapes", len(self.names), len(self.names))

    def _load(self, reader: ThreadPoolExecutor, number: int) -> Future[LoadedRecording] | None:
        """Begin to read a recording while the one before is worked on."""
        if number >= len(self.names):
            return None
        return reader.submit(LoadedRecording, self.capture.recordings[self.names[number]])

    def _record_failure(self, name: str, error: FacewrightError) -> None:
        """Note why an expression is left out; raise what ends the subject."""
        if _is_fatal(error):
            raise error
        if name == "neutral":
            raise type(error)(f"the neutral of subject {self.capture.name!r} cannot be used: {error}") from error
        self.records.pop(name, None)
        self.failed[name] = {"kind": type(error).__name__, "reason": str(error)}

    def _fit(
        self, fitter: ScanFitter, name: str, detector: LandmarkDetector | None, loaded: Future[LoadedRecording]
    ) -> None:
        from facewright.fitting.depth_target import depth_target

        record = read_record(name, self.capture.recordings[name], detector, self.clock, loaded, self.fusion)
        self.records[name] = record
        with self.clock.time("neutral" if name == "neutral" else "expression"):
            target = depth_target(record.fused.depth, record.fused.intrinsics, record.landmarks)
            if name == "neutral":
                fit = fitter.fit_neutral(target)
            else:
                fit = fitter.fit_expression(self.fits["neutral"], expression_weights(name), target)
        record.facts["landmarks_3d"] = target.landmarks
        self.fits[name] = fit

    def why_not(self) -> str:
        """Return the reasons of failed expressions as a clause."""
        return "".join(f"; {name}: {failure['reason'].rstrip('.')}" for name, failure in self.failed.items())

    def rig(self) -> PersonalRig:
        """Return the rig; all fits are in the neutral's head frame, by what holds still in each expression."""
        guide = np.stack([expression_weights(name) for name in self.fits])
        return fit_personal_rig(self.face, np.stack([fit.vertices for fit in self.fits.values()]), guide)

    def subject(self, options: ProcessOptions, rig: PersonalRig) -> Subject:
        """Return the arrays and where they come from."""
        names = tuple(self.fits)
        records = [self.records[name] for name in names]
        blendshapes = np.concatenate([rig.meshes[:1], rig.meshes[0] + rig.deltas])
        keep = options.keep_records
        return Subject(
            name=self.capture.name,
            expressions=names,
            meshes=rig.meshes.astype(np.float32),
            blendshapes=blendshapes.astype(np.float32),
            expression_weights=rig.weights,
            depth=padded([record.fused.depth for record in records]) if keep else None,
            color=padded([record.fused.color for record in records]) if keep else None,
            raw_depth=padded([record.raw_depth for record in records]) if options.keep_raw else None,
            intrinsics=np.array([_camera(record) for record in records]),
            camera_from_model=np.stack([_matrix(fit.target_from_model) for fit in self.fits.values()]),
            landmarks=np.stack([record.landmarks.points for record in records]),
            landmarks_3d=np.stack([record.facts.pop("landmarks_3d") for record in records]),
            attributes=dict(self.capture.attributes),
            provenance=self._provenance(options, rig),
        )

    def _provenance(self, options: ProcessOptions, rig: PersonalRig) -> dict[str, Any]:
        expressions = {}
        for i, (name, fit) in enumerate(self.fits.items()):
            expressions[name] = {
                **self.records[name].facts,
                "fit": fit.report,
                "rig_residual_mm": rig.residuals_mm[i],
            }
        facts = plain(
            {
                "source": "captures",
                "versions": package_versions(),
                "face": {"name": self.face.name, "topology": self.face.topology.fingerprint},
                "options": {**asdict(options), "task_file": Path(options.task_file).name},
                "expressions": expressions,
                "failed": self.failed,
                "missing": [name for name in EXPRESSION_NAMES if name not in self.capture.recordings],
                "rig": {"method": "example-based rigging, acted weights estimated", "amplitudes": rig.amplitudes},
            }
        )
        named: dict[str, Any] = without_folder(facts, self.capture.path)
        return named


@lru_cache(maxsize=2)
def scan_fitter(face: Face) -> ScanFitter:
    """Return the fitter of a face, made once a process."""
    from facewright.fitting.scan import ScanFitter

    return ScanFitter(face)


def _is_fatal(error: FacewrightError) -> bool:
    """Tell whether an error is not of one expression: a package is missing, or a disk may answer the next time."""
    if isinstance(error, StoreError):
        return isinstance(error.__cause__, OSError) and not isinstance(error.__cause__, FileNotFoundError)
    return isinstance(error, MissingExtraError | MissingFaceError)


def _camera(record: ExpressionRecord) -> list[float]:
    k = record.fused.intrinsics
    return [k.focal_x, k.focal_y, k.centre_x, k.centre_y]


def _matrix(motion: RigidMotion) -> NDArray[np.float64]:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = motion.rotation, motion.translation
    return matrix
