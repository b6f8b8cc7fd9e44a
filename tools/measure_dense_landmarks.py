"""Measure what MediaPipe's 478 points are on a face, on renders of simulated people: landmarks/data/dense478_*.npz.

    python tools/measure_dense_landmarks.py ict
    python tools/measure_dense_landmarks.py builtin

A few minutes of two cores each. People are drawn before a textured wall, with a camera's blur and noise; only numbers
are kept, in `--folder`, where people that are there already are not drawn again. The people's seeds (20260, k) are
used nowhere else. The data file says how it was made: seed, people, frames, size of the pictures, detector. See
`facewright.landmarks.dense.DensePoints` for what the numbers mean.
"""

from __future__ import annotations

import argparse
import multiprocessing
import tempfile
from collections.abc import Iterator, Sequence
from functools import partial
from importlib.metadata import version
from pathlib import Path

import numpy as np
from scipy import ndimage
from scipy.linalg import solve_triangular

from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.camera.rotation import rotation_from_head_angles, rotation_from_vector
from facewright.evaluation.textured_background import textured_background
from facewright.faces import load_face
from facewright.faces.appearance import albedo_function, sample_appearance, vertex_gloss, visible_faces
from facewright.faces.blendshape_names import BLENDSHAPE_NAMES
from facewright.faces.expressions import random_expression_weights
from facewright.faces.face import Face
from facewright.faces.simulate import simulate_person
from facewright.imaging.render import Lights, render_mesh
from facewright.io.atomic import write_atomically
from facewright.landmarks.dense import MEASURED_FACES, N_POSE_TERMS, head_plane, pose_terms
from facewright.mesh.normals import vertex_normals

DATA = Path(__file__).parents[1] / "src/facewright/landmarks/data"
N_PEOPLE = 40
#: How the pictures are made; kept in the data file.
SEED, SIZE, SUPERSAMPLE, BLUR_PIXELS, NOISE_LEVELS = 20260, 384, 1, 0.5, 2.0
SETTINGS = {
    "seed": SEED,
    "size": SIZE,
    "supersample": SUPERSAMPLE,
    "blur_pixels": BLUR_PIXELS,
    "noise_levels": NOISE_LEVELS,
}
CENTRE = np.array([0.0, 0.0, 40.0])  # of the head, model space
AT_REST = 6  # first frames of each person; the first two are frontal
N_MIXTURES = 20
N_DIRECTIONS, N_MODES, N_CANDIDATES = 160, 24, 80


KEPT = ("weights", "rotation", "translation", "focal", "points")


def detector_version() -> str:
    """Return which detector is measured."""
    return f"mediapipe {version('mediapipe')}"


def expressions(rng: np.random.Generator) -> np.ndarray:
    """Return rest, every shape on its own (pairs together and on one side), and random mixtures: (73, 46)."""
    index = {name: i for i, name in enumerate(BLENDSHAPE_NAMES)}
    rows = [np.zeros(46) for _ in range(AT_REST)]
    for name, i in index.items():
        if name.endswith("_R"):
            continue
        row = np.zeros(46)
        row[i] = rng.uniform(0.35, 1.0)
        if name.endswith("_L"):
            j = index[name[:-1] + "R"]
            row[j] = row[i] * rng.uniform(0.85, 1.0)
            one = np.zeros(46)
            one[[i, j][int(rng.integers(2))]] = rng.uniform(0.35, 1.0)
            rows.append(one)
        if name == "mouthClose":
            row[index["jawOpen"]] = min(1.0, row[i] * rng.uniform(1.0, 1.1))
        rows.append(row)
    return np.array([*rows, *random_expression_weights(rng, N_MIXTURES)])


def camera(rng: np.random.Generator, frontal: bool) -> tuple[Intrinsics, RigidMotion]:
    """Draw a camera and a pose."""
    rotation = rotation_from_head_angles(*(rng.uniform(-1, 1, 3) * ((4, 4, 3) if frontal else (30, 18, 12))))
    distance = float(np.exp(rng.uniform(*np.log((500, 1500)))))
    focal = float(rng.uniform(0.6, 0.82)) * SIZE / 240.0 * distance
    shift = rng.uniform(-0.04, 0.04, 2) * SIZE / focal * distance
    motion = RigidMotion(rotation, np.array([*shift, distance]) - rotation @ CENTRE)
    return Intrinsics.for_image((SIZE, SIZE), focal), motion


class Studio:
    """Draws one simulated person."""

    def __init__(self, face: Face, k: int) -> None:
        self.face, self.person = face, simulate_person(face, np.random.default_rng((SEED, k)))
        self.rng = np.random.default_rng((SEED, k, 1))
        look = sample_appearance(self.rng)
        self.weights = expressions(self.rng)
        self.faces, self.gloss = visible_faces(face), vertex_gloss(face)
        self.albedo = albedo_function(face, look, self.faces)
        self.lights = Lights(look.light_directions, look.light_colours, look.sky, look.ground)
        self.wall = textured_background(look.background, (SIZE, SIZE), self.rng)
        self.eyes = [face.topology.parts[part] for part, kind in face.rigid_parts.items() if kind == "eye"]

    def frames(self) -> Iterator[tuple[np.ndarray, Intrinsics, RigidMotion, np.ndarray]]:
        """Yield coefficients, camera, pose and picture of each frame."""
        for i, row in enumerate(self.weights):
            intrinsics, motion = camera(self.rng, frontal=i < 2)
            yaw, pitch = self.rng.uniform(-1, 1, 2) * (0.45, 0.3) * (i > 1 and self.rng.random() < 0.6)
            yield row, intrinsics, motion, self.draw(row, intrinsics, motion, yaw, pitch)

    def draw(
        self, row: np.ndarray, intrinsics: Intrinsics, motion: RigidMotion, yaw: float, pitch: float
    ) -> np.ndarray:
        """Draw the person with an expression and turned eyes: (SIZE, SIZE, 3), uint8."""
        vertices = self.person.pose(row).astype(np.float64)
        turn = rotation_from_vector([0.0, yaw, 0.0]) @ rotation_from_vector([-pitch, 0.0, 0.0])
        for start, stop in self.eyes:
            middle = vertices[start:stop].mean(axis=0)
            vertices[start:stop] = (vertices[start:stop] - middle) @ turn.T + middle
        seen = motion.apply(vertices)
        image = render_mesh(
            seen,
            intrinsics.project(seen),
            self.faces,
            (SIZE, SIZE),
            albedo=self.albedo,
            lights=self.lights,
            background=self.wall,
            shininess=self.gloss,
            supersample=SUPERSAMPLE,
        ).image
        blurred = ndimage.gaussian_filter(image.astype(np.float32), (BLUR_PIXELS, BLUR_PIXELS, 0))
        noisy = blurred + NOISE_LEVELS * self.rng.standard_normal(image.shape, dtype=np.float32)
        return np.ascontiguousarray(np.clip(np.rint(noisy), 0, 255).astype(np.uint8))


def gather(name: str, folder: Path, k: int) -> int:
    """Draw person `k`, find the points, keep the numbers: one file. Returns the number of frames with a face."""
    import mediapipe

    studio = Studio(load_face(name), k)
    kept: dict[str, list] = {key: [] for key in KEPT}
    with mediapipe.solutions.face_mesh.FaceMesh(
        static_image_mode=False, refine_landmarks=True, max_num_faces=1
    ) as mesh:
        for i, (row, intrinsics, motion, picture) in enumerate(studio.frames()):
            for _ in range(3 if i == 0 else 2):  # the second look starts from where the first found the face
                found = mesh.process(picture).multi_face_landmarks
            if found:
                points = np.array([(p.x, p.y) for p in found[0].landmark]) * SIZE - 0.5
                values = (row, motion.rotation, motion.translation, intrinsics.focal_x, points)
                for key, value in zip(KEPT, values, strict=True):
                    kept[key].append(value)
    with write_atomically(person_file(name, folder, k)) as path, path.open("wb") as file:
        np.savez(file, **{key: np.array(value) for key, value in kept.items()}, **SETTINGS, detector=detector_version())
    return len(kept["points"])


def person_file(name: str, folder: Path, k: int) -> Path:
    """Return where a person's numbers are kept."""
    return folder / f"{name}_{k:04d}.npz"


class Measured:
    """The people of a folder."""

    def __init__(self, face: Face, folder: Path, people: Sequence[int]) -> None:
        self.face = face
        found = [self._person(k, person_file(face.name, folder, k)) for k in people]
        self.people = [(neutral, deltas, data) for neutral, deltas, data in found if len(data["points"]) > AT_REST]

    def _person(self, k: int, file: Path) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
        """Return a person's skin, neutral and deltas, and what was found of them."""
        with np.load(file, allow_pickle=False) as data:
            made = {key: data[key].item() for key in (*SETTINGS, "detector")}
            if made != SETTINGS | {"detector": detector_version()}:
                raise SystemExit(f"{file} was made otherwise ({made}): remove it.")
            person, n = simulate_person(self.face, np.random.default_rng((SEED, k))), self.face.n_skin
            kept = {key: data[key] for key in KEPT}
        return person.neutral[:n].copy(), person.deltas[:, :n].copy(), kept

    @staticmethod
    def frames(vertices: np.ndarray, data: dict[str, np.ndarray]):  # type: ignore[no-untyped-def]
        """Yield, in the head's plane in millimetres, projected vertices (T, N, 3) and found points of each frame."""
        for shape, R, t, focal, points in zip(
            vertices, data["rotation"], data["translation"], data["focal"], data["points"], strict=True
        ):
            motion = RigidMotion(R, t)
            plane = head_plane(R, focal / float(motion.apply(CENTRE)[2]))
            pixels = Intrinsics.for_image((SIZE, SIZE), float(focal)).project(motion.apply(shape))
            yield pixels @ plane.T, points @ plane.T


def choose_vertices(measured: Measured) -> np.ndarray:
    """Return the skin vertex that each point follows best over all people, poses and expressions, (478,)."""
    face, n = measured.face, measured.face.n_skin
    near = np.zeros((478, n), np.float32)
    for neutral, _, data in measured.people:
        still = {key: value[:2] for key, value in data.items()}
        for seen, found in measured.frames(np.repeat(neutral[None].astype(float), 2, axis=0), still):
            near += np.linalg.norm((found[:, None] - seen[None]).astype(np.float32), axis=2)
    normals = vertex_normals(face.mean_shape[:n].astype(np.float64), face.skin().topology.faces)
    near[:, normals[:, 2] < -0.15] = np.inf
    candidates = np.argsort(near, axis=1)[:, :N_CANDIDATES]
    total, square, within, count = np.zeros((478, N_CANDIDATES, 2)), 0.0, 0.0, 0
    for neutral, deltas, data in measured.people:
        posed = neutral.astype(float) + np.tensordot(data["weights"], deltas, 1)
        r = np.array([f[:, None] - s[candidates] for s, f in measured.frames(posed, data)])
        total, square, count = total + r.sum(axis=0), square + (r**2).sum(axis=(0, 3)), count + len(r)
        within = within + ((r - r.mean(axis=0)) ** 2).sum(axis=(0, 3))
    mean = total / count
    spread, inner = square / count - (mean**2).sum(axis=2), within / count
    # what a vertex moves unlike the point counts most; people's own offsets less; a small offset is better than a large
    score = inner + 0.25 * (spread - inner) + 0.03 * (mean**2).sum(axis=2)
    return candidates[np.arange(478), np.argmin(score, axis=1)].astype(np.int32)


def departures(measured: Measured, vertices: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return departures (F, 956) in the head's plane, person numbers, coefficients and rotations of all frames."""
    r, who, weights, rotations = [], [], [], []
    for k, (neutral, deltas, data) in enumerate(measured.people):
        posed = neutral[vertices] + np.tensordot(data["weights"], deltas[:, vertices], 1)
        r += [(found - seen).ravel() for seen, found in measured.frames(posed, data)]
        who += [k] * len(posed)
        weights.append(data["weights"])
        rotations.append(data["rotation"])
    return np.array(r), np.array(who), np.concatenate(weights), np.concatenate(rotations)


def regress(r, who, weights, rotations):  # type: ignore[no-untyped-def]
    """Return responses (52, 956) to pose terms and coefficients, each person's own departure, and what is left."""
    X = np.concatenate([pose_terms(rotations), weights], axis=1)
    D = (who[:, None] == np.unique(who)[None]).astype(float)
    D_mean = (D / D.sum(axis=0)).T
    Xc, rc = X - D @ (D_mean @ X), r - D @ (D_mean @ r)
    ridge = 3.0 * np.diag(np.r_[np.full(N_POSE_TERMS, 0.05), np.ones(46)])
    C = np.linalg.solve(Xc.T @ Xc + ridge, Xc.T @ rc)
    return C, D_mean @ (r - X @ C), rc - Xc @ C


def signals(face: Face, vertices: np.ndarray, response: np.ndarray) -> np.ndarray:
    """Return what is to be told from noise: shapes, people and small motions at nine poses, (956, S)."""
    mean, deltas, modes = (
        array.astype(np.float64)
        for array in (
            face.mean_shape[vertices],
            face.blendshape_deltas[:, vertices],
            face.identity_basis[:, vertices],
        )
    )
    columns = []
    for yaw in (-20, 0, 20):
        for pitch in (-10, 0, 10):
            R = rotation_from_head_angles(yaw, pitch, 0)
            columns += list(0.35 * ((deltas @ R[:2].T).reshape(46, -1) + response))
            columns += list(0.5 * (modes @ R[:2].T).reshape(len(modes), -1))
            x, y, z = (mean @ R.T).T
            nothing = np.zeros_like(x)
            turns = ((nothing, -z), (z, nothing), (-y, x), (nothing + 100, nothing), (nothing, nothing + 100), (x, y))
            columns += [0.1 * np.stack(turn, axis=1).ravel() for turn in turns]
    return np.array(columns).T


def analyse(face: Face, folder: Path, people: Sequence[int], out: Path) -> None:
    """Turn the gathered numbers into the data file."""
    measured = Measured(face, folder, people)
    vertices = choose_vertices(measured)
    r, who, weights, rotations = departures(measured, vertices)
    C, own, left = regress(r, who, weights, rotations)
    freedom = len(left) - len(own) - len(C)
    if len(own) < 2 or freedom < 1:
        raise SystemExit(f"{len(own)} people in {len(left)} frames are too few: draw more people.")
    offset = own.mean(axis=0)
    _, strength, directions = np.linalg.svd((own - offset) / np.sqrt(len(own) - 1), full_matrices=False)
    covariance = left.T @ left / freedom
    covariance = 0.95 * covariance + 0.05 * np.diag(np.diag(covariance)) + 0.2**2 * np.eye(len(covariance))
    root = np.linalg.cholesky(covariance)
    clear = solve_triangular(root, signals(face, vertices, C[N_POSE_TERMS:]), lower=True)
    U = np.linalg.svd(clear, full_matrices=False)[0][:, :N_DIRECTIONS]
    whitening = solve_triangular(root, U, lower=True, trans="T").T
    modes = strength[:N_MODES, None] * directions[:N_MODES]
    half = np.float16
    with write_atomically(out) as path, path.open("wb") as file:
        np.savez_compressed(
            file,
            vertices=vertices,
            offset=offset.reshape(-1, 2).astype(half),
            pose_response=C[:N_POSE_TERMS].reshape(N_POSE_TERMS, -1, 2).astype(half),
            expression_response=C[N_POSE_TERMS:].reshape(46, -1, 2).astype(half),
            person_modes=modes.reshape(len(modes), -1, 2).astype(half),
            whitening=whitening.astype(half),
            blendshape_names=np.array(face.blendshape_names),
            fingerprints=np.array([face.topology.fingerprint, face.skin().topology.fingerprint]),
            people=np.asarray(people, dtype=np.int32),
            n_people=len(own),
            n_frames=len(left),
            detector=detector_version(),
            **SETTINGS,
        )


def main(arguments: Sequence[str] | None = None) -> None:
    """Gather, then analyse."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("face", choices=MEASURED_FACES)
    parser.add_argument("--people", type=int, default=N_PEOPLE)
    parser.add_argument("--jobs", type=int, default=2, help="processes")
    parser.add_argument("--folder", type=Path, help="keep what was gathered here; forgotten where absent")
    parser.add_argument("--out", type=Path, help="data file; the package's own where absent")
    given = parser.parse_args(arguments)
    out = given.out or DATA / f"dense478_{given.face}.npz"
    with tempfile.TemporaryDirectory() as temporary:
        folder = given.folder or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        people = range(given.people)
        missing = [k for k in people if not person_file(given.face, folder, k).exists()]
        work = partial(gather, given.face, folder)
        if given.jobs > 1:
            with multiprocessing.get_context("spawn").Pool(given.jobs) as pool:
                pool.map(work, missing, chunksize=1)
        else:
            list(map(work, missing))
        analyse(load_face(given.face), folder, people, out)


if __name__ == "__main__":
    main()
