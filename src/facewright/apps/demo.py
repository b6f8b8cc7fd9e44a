"""The whole tour: a person captured, a database, its model, a photograph found in it, a face posed, rigs, a page."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from facewright.apps.demo_captures import CAPTURED, DemoDatabase, build_demo_database
from facewright.apps.demo_page import Figure, Section, write_demo_page
from facewright.apps.demo_page import Picture as PagePicture
from facewright.apps.demo_photo import draw_photo
from facewright.apps.demo_pictures import Picture, fit_pictures, people_sheet, person_painter, person_texture
from facewright.apps.demo_posing import DemoPosing, draw_posing
from facewright.apps.explore_model import ExploreRequest, explore_model
from facewright.apps.export import ExportRequest, demo_clip, export_rig
from facewright.errors import NoFaceError
from facewright.faces import load_face
from facewright.faces.blendshape_names import BLENDSHAPE_NAMES
from facewright.faces.expressions import expression_weights, random_expression_weights
from facewright.faces.simulate import simulate_person
from facewright.fitting.image import PhotoFit, PhotoFitter
from facewright.imaging.contact_sheet import contact_sheet
from facewright.io.atomic import write_set_atomically
from facewright.io.image import write_image
from facewright.landmarks.detector import open_detector
from facewright.numeric.similarity import estimate_similarity

if TYPE_CHECKING:
    from facewright.faces.face import Face
    from facewright.landmarks.points import Landmarks
    from facewright.models.bilinear import BilinearModel

Progress = Callable[[str, int, int], None]

N_SIMULATED, N_IDENTITY, N_EXPRESSION = 59, 40, 47
N_UNSEEN = 3
PORTRAIT = (300, 260)
EXPRESSIONS = (
    "neutral", "smile", "mouth_stretch", "anger", "brow_raiser",
    "lip_puckerer", "grin", "sadness", "cheek_blowing", "eyes_closed",
)  # fmt: skip


@dataclass(frozen=True)
class DemoResult:
    """What the demo measured and wrote.

    Parameters
    ----------
    page : str
        Path of the page.
    seconds : float
        Wall-clock time of all of it.
    capture_seconds : float
        From the captured person's recordings to 46 blendshapes.
    captured_rms_mm, captured_mean_face_rms_mm : float
        Distance of the captured neutral, and of the mean face, from the true surface, root mean square over the face.
    fit_ms : float
        Time of fitting the photo, without the detector and without compilation.
    reprojection_iod : float
        Mean distance of the photo's landmarks from the fit's, as a share of the inter-ocular distance.
    unseen_rms_mm, mean_face_rms_mm : float
        Error of the model, and of the mean face, on people and expressions that it has not seen.
    model_mb, glb_mb : float
        Sizes of the files.
    """

    page: str
    seconds: float
    capture_seconds: float
    captured_rms_mm: float
    captured_mean_face_rms_mm: float
    fit_ms: float
    reprojection_iod: float
    unseen_rms_mm: float
    mean_face_rms_mm: float
    model_mb: float
    glb_mb: float


def run_demo(out: Path, seed: int = 0, progress: Progress | None = None) -> DemoResult:
    """Run the tour on the built-in face and scikit-image's astronaut portrait.

    Parameters
    ----------
    out : Path
        Folder for the page and its files; made where it does not exist.
    seed : int
        Seed of the simulated people.
    progress : callable, optional
        Called with stage, done, total.

    Returns
    -------
    DemoResult
        Numbers; the page is ``out / "index.html"``.

    Raises
    ------
    StoreError
        If the folder cannot be made or written.
    MissingExtraError
        If the landmark detector is not installed.
    NoFaceError
        If the detector does not find the portrait's face.
    """
    start = time.perf_counter()
    with write_set_atomically(out) as folder:  # before the work: tells at once where it cannot be made
        result = _tour(folder, seed, start, progress)
    return replace(result, page=str(out / "index.html"))


def _tour(out: Path, seed: int, start: float, progress: Progress | None) -> DemoResult:
    """Do all of it, into an existing folder."""
    detector = open_detector()  # before the long work: tells at once if the extra is missing
    photo = astronaut_portrait()
    faces = detector.detect(photo)
    if not faces:
        raise NoFaceError("the demo's portrait must show a face, the detector found none.")
    face = load_face("builtin")
    database = build_demo_database(out, face, N_SIMULATED, (N_IDENTITY, N_EXPRESSION), seed, progress)
    model = database.model
    unseen_rms, mean_rms = _unseen_errors(model, face, seed, progress)
    fit, fit_ms = _timed_fit(model, faces[0], (photo.shape[0], photo.shape[1]))
    texture = person_texture(photo, fit)
    _draw(out, face, photo, fit, texture, seed, progress)
    draw_photo(out, photo, detector, model, out / "model.fwbm", progress)
    posing = draw_posing(out, face, progress)
    explore_model(ExploreRequest(model, out / "model.png", n_modes=3, size=(180, 156)), progress)
    clip = demo_clip(fit.rig.names)
    exported = export_rig(
        ExportRequest(fit.rig, face.topology, out / "person.glb", texture=texture, clip=clip, copyright=face.licence,
                      vertex_colors=_plain_colours(face)),
        progress,
    )  # fmt: skip
    result = DemoResult(
        page=str(out / "index.html"),
        seconds=time.perf_counter() - start,
        capture_seconds=database.capture_seconds,
        captured_rms_mm=database.neutral_rms_mm,
        captured_mean_face_rms_mm=database.mean_face_rms_mm,
        fit_ms=fit_ms,
        reprojection_iod=fit.reprojection_iod,
        unseen_rms_mm=unseen_rms,
        mean_face_rms_mm=mean_rms,
        model_mb=database.model_bytes / 1e6,
        glb_mb=exported.n_bytes / 1e6,
    )
    _write_page(out, result, database, fit, posing)
    return result


def astronaut_portrait() -> NDArray[np.uint8]:
    """Return the portrait of Eileen Collins that scikit-image ships (NASA, public domain), (512, 512, 3), uint8."""
    from skimage import data

    return np.ascontiguousarray(data.astronaut())


def _unseen_errors(model: BilinearModel, face: Face, seed: int, progress: Progress | None) -> tuple[float, float]:
    """Return the RMS errors (mm) of the model and of the mean face on people and expressions it has not seen."""
    rng = np.random.default_rng((seed, 11))  # another stream than the training people
    ours, trivial = [], []
    for k in range(N_UNSEEN):
        person = simulate_person(face, rng)
        for truth in person.pose(random_expression_weights(rng, 3)):
            found = model.synthesise(*model.project(truth))
            ours.append(((found - truth) ** 2).sum(axis=1).mean())
            placed = estimate_similarity(model.mean_face.astype(np.float64), truth.astype(np.float64))
            trivial.append(((placed.apply(model.mean_face) - truth) ** 2).sum(axis=1).mean())
        if progress is not None:
            progress("checking on unseen people", k + 1, N_UNSEEN)
    return float(np.sqrt(np.mean(ours))), float(np.sqrt(np.mean(trivial)))


def _timed_fit(model: BilinearModel, landmarks: Landmarks, image_size: tuple[int, int]) -> tuple[PhotoFit, float]:
    fitter = PhotoFitter(model)
    fitter.fit(landmarks, image_size)  # compiles
    start = time.perf_counter()
    fit = fitter.fit(landmarks, image_size)
    _ = fit.vertices
    return fit, 1e3 * (time.perf_counter() - start)


def _draw(
    out: Path, face: Face, photo: Picture, fit: PhotoFit, texture: Picture, seed: int, progress: Progress | None
) -> None:
    """Draw the person's pictures into the folder."""
    draw = person_painter(face, fit, texture, PORTRAIT)
    write_image(out / "people.png", people_sheet(face, seed))
    for name, picture in zip(("photo", "landmarks", "mesh"), fit_pictures(photo, fit, fit.landmarks.points)):
        write_image(out / f"{name}.png", picture)
    views = [draw(fit.vertices, yaw) for yaw in (-50, -25, 0, 25, 50)]
    write_image(out / "views.png", contact_sheet(views, columns=5))
    acted = []
    for k, name in enumerate(EXPRESSIONS):
        acted.append(draw(fit.rig.pose(expression_weights(name))))
        if progress is not None:
            progress("drawing expressions", k + 1, len(EXPRESSIONS))
    write_image(out / "expressions.png", contact_sheet(acted, [e.replace("_", " ") for e in EXPRESSIONS], columns=5))


def _plain_colours(face: Face) -> NDArray[np.uint8]:
    """Paint eyes, teeth and mouth of the exported rig."""
    from facewright.faces.appearance import sample_appearance, vertex_colors

    colours = vertex_colors(face, sample_appearance(np.random.default_rng(3)))
    return np.round(np.clip(colours, 0, 1) * 255).astype(np.uint8)


def _write_page(out: Path, result: DemoResult, database: DemoDatabase, fit: PhotoFit, posing: DemoPosing) -> None:
    model = database.model
    yaw, pitch, roll = fit.head_angles_degrees
    sections = [
        Section(
            "A person before a depth camera",
            f"A simulated person acted 20 expressions before a simulated Kinect, turning the head: {database.n_frames} "
            "noisy frames. Each recording was fused into one smooth depth map, a template was fitted to it, and the "
            "20 meshes became 46 personal blendshapes (FaceWarehouse, 3.1-3.2).",
            [[PagePicture("captured_captures.png", "Points found in the picture, fused depth, the fitted mesh, the "
                          "mesh over the picture, and its distance from the depth.")],
             [PagePicture("captured_expressions.png", "The 20 fitted expressions, eyes and teeth added.")],
             [PagePicture("captured_blendshapes.png", "Some of the 46 blendshapes: most of them nobody acted.")]],
        ),
        Section(
            "The database and its model",
            f"The captured person and {N_SIMULATED} simulated ones stand in a database, faces.zarr, with "
            f"{len(model.expression_names)} shapes each; their tensor was decomposed into {model.n_identity} identity "
            f"and {model.n_expression} expression parts. All that follows uses this model.",
            [[PagePicture("people.png", "Ten simulated people.")],
             [PagePicture("model.png", "The leading ways to differ: in identity (first three rows, -2 to +2 standard "
                          "deviations) and in expression (from one end of the training shapes to the other).")]],
        ),
        Section(
            "One photograph",
            "A detector finds points on the photo (green). The model is turned, scaled and shaped until its points "
            "(red) lie on them; the mesh on the right is what came out. All below is made from this one picture.",
            [[PagePicture("photo.png", "The photo: astronaut Eileen Collins (NASA), as scikit-image ships it."),
              PagePicture("landmarks.png", "Found points (green) and the fitted model's (red)."),
              PagePicture("mesh.png", f"The fitted mesh; the head is turned by {yaw:.0f}, {pitch:.0f} and {roll:.0f} "
                          "degrees (yaw, pitch, roll).")]],
        ),
        Section("The person in 3D", "A rig with 46 named expressions, carried by person.glb.", viewer=True),
        Section(
            "New expressions",
            "The same person with expressions that are not in the photo: blendshapes of this person, from the bilinear "
            "model (FaceWarehouse, eq. 17).",
            [[PagePicture("expressions.png", "Ten of the twenty expressions of FaceWarehouse.")],
             [PagePicture("views.png", "The fitted expression from five sides. The camera saw the front only; the "
                          "sides continue the skin that it saw.")]],
        ),
        Section(
            "The photo, changed",
            "Attributes with names, in standard deviations of the population: one changes, the others are held "
            "(FaceWarehouse, 4.1). The photo itself is redrawn, background and hair with it.",
            [[PagePicture("edited.png", "The photo, and five attributes at -2 and +2 standard deviations.")]],
        ),
        Section(
            "The photo acts",
            "Expressions and turns of the head played on the one photo; the same curves may come from a video, or from "
            "a Live Link Face recording (FaceWarehouse, 4.4). Teeth, mouth and lids are drawn in the photo's light.",
            [[PagePicture("acted.png", "The photo, and five expressions.")],
             [PagePicture("acting.mp4", "Ten seconds of expressions, made by facewright animate.")]],
        ),
        Section(
            "A face posed by hand",
            "Points of the built-in face are pulled one after the other (grey: where to; black: where it is; yellow: "
            f"the last). Above, the face is {posing.n_regions} regions, found in a simulated performer's motion, that "
            "share their boundaries: what is not pulled stays. Below, one model of the whole face and the same points: "
            "everything follows (Tena et al. 2011, Fig. 1 and 7). To pose it yourself in the browser: facewright pose.",
            [[PagePicture("posing.png", f"Regions ({posing.n_coefficients} coefficients) above, holistic "
                          f"({posing.n_holistic}) below; the poses as an animation: posed.glb.")]],
        ),
    ]  # fmt: skip
    figures = [
        Figure("capture to blendshapes", f"{result.capture_seconds:.0f} s", f"{database.n_frames} frames to 46 shapes "
               "of one person, points found by the detector"),
        Figure("captured neutral, error", f"{result.captured_rms_mm:.2f} mm", "from the true surface (RMS over the "
               "face)"),
        Figure("the same, mean face", f"{result.captured_mean_face_rms_mm:.2f} mm", "the trivial answer, for "
               "comparison"),
        Figure("landmarks off by", f"{100 * result.reprojection_iod:.1f} %", "mean distance between found and fitted "
               "points in the photo, as a share of the distance between the eyes"),
        Figure("fit of the photo", f"{result.fit_ms:.0f} ms", "once the points are found"),
        Figure("error on unseen people", f"{result.unseen_rms_mm:.2f} mm", f"how well the model takes the shape of "
               f"{N_UNSEEN} people and {3 * N_UNSEEN} expressions that it was not built from (RMS over all vertices)"),
        Figure("the same, mean face", f"{result.mean_face_rms_mm:.2f} mm", "the trivial answer, for comparison"),
        Figure("vertices", f"{model.n_vertices:,}", "of the built-in face, eyes, teeth and mouth included"),
        Figure("model file", f"{result.model_mb:.1f} MB", "core, priors and topology, compressed"),
        Figure("whole demo", f"{result.seconds:.0f} s", "on this machine"),
    ]  # fmt: skip
    files = [
        ("person.glb", "the person as a rig with 46 morph targets, photo texture and a short animation: Blender, "
         "Unity, Unreal, three.js and others open it"),
        ("posed.glb", f"the posed face as an animation of {posing.n_frames} frames"),
        ("faces.zarr", "the database: facewright warehouse ls faces.zarr"),
        (f"captures/{CAPTURED}/neutral/rgb.txt", "the recordings, as folders of pictures: facewright capture show"),
        ("acting.csv", "the film's curves as a Live Link Face recording: facewright animate PHOTO --curves acting.csv"),
        ("model.fwbm", "the bilinear model: facewright fit PHOTO --model model.fwbm"),
    ]  # fmt: skip
    write_demo_page(
        out,
        "facewright: from a depth camera and a photo to faces that move",
        "What you see was computed on this machine's CPU a moment ago, by make demo, from a built-in face, a simulated "
        "person before a simulated depth camera, and one photograph. Nothing was downloaded; all of it may be shipped.",
        sections,
        figures,
        files,
        out / "person.glb",
        {name.replace("_", " "): _nonzero(expression_weights(name)) for name in EXPRESSIONS},
    )


def _nonzero(weights: NDArray[np.floating]) -> dict[str, float]:
    return {name: round(float(w), 4) for name, w in zip(BLENDSHAPE_NAMES, weights) if w}
