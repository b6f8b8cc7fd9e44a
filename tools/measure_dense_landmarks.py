"""Measure what MediaPipe's 478 points are on a face, on renders of simulated people: landmarks/data/dense478_*.npz.

    python tools/measure_dense_landmarks.py gather ict FOLDER --people 30
    python tools/measure_dense_landmarks.py analyse ict FOLDER

`gather` may run in several processes with different `--first`; only numbers are kept. The people's seeds (20260, k) are
used nowhere else. See `facewright.landmarks.dense.DensePoints` for what the numbers mean.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from scipy import ndimage
from scipy.linalg import solve_triangular

from facewright.camera.pinhole import Intrinsics, RigidMotion
from facewright.camera.rotation import rotation_from_head_angles, rotation_from_vector
from facewright.faces import load_face
from facewright.faces.appearance import albedo_function, sample_appearance, vertex_gloss, visible_faces
from facewright.faces.blendshape_names import BLENDSHAPE_NAMES
from facewright.faces.expressions import random_expression_weights
from facewright.faces.face import Face
from facewright.faces.simulate import SimulatedPerson, simulate_person
from facewright.imaging.render import Lights, render_mesh
from facewright.io.atomic import write_atomically
from facewright.landmarks.dense import head_plane, pose_terms
from facewright.mesh.normals import vertex_normals

SEED, SIZE = 20260, 288
CENTRE = np.array([0.0, 0.0, 40.0])
AT_REST = 6  # first frames of each person; the first two are frontal
NOISE_LEVELS = 2.0
N_DIRECTIONS, N_MODES, N_CANDIDATES = 160, 24, 80
DATA = Path(__file__).parents[1] / "src/facewright/landmarks/data"


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
    return np.array([*rows, *random_expression_weights(rng, 20)])


def background(tone: tuple[int, int, int], rng: np.random.Generator) -> np.ndarray:
    """Return a textured wall, so that no outline is told by a plain one."""
    picture = np.broadcast_to(np.asarray(tone, dtype=np.float64), (SIZE, SIZE, 3)).copy()
    for size, strength in ((25.0, 25.0), (6.0, 10.0), (1.5, 5.0)):
        patches = ndimage.gaussian_filter(rng.standard_normal((SIZE, SIZE, 1)), (size, size, 0))
        picture += strength * patches / patches.std()
    return np.clip(np.rint(picture), 0, 255).astype(np.uint8)


def camera(rng: np.random.Generator, frontal: bool) -> tuple[Intrinsics, RigidMotion]:
    """Draw a camera and a pose."""
    rotation = rotation_from_head_angles(*(rng.uniform(-1, 1, 3) * ((4, 4, 3) if frontal else (30, 18, 12))))
    distance = float(np.exp(rng.uniform(*np.log((500, 1500)))))
    focal = float(rng.uniform(0.6, 0.82)) * SIZE / 240.0 * distance
    shift = rng.uniform(-0.04, 0.04, 2) * SIZE / focal * distance
    motion = RigidMotion(rotation, np.array([*shift, distance]) - rotation @ CENTRE)
    return Intrinsics.for_image((SIZE, SIZE), focal), motion


def gather(name: str, folder: Path, first: int, people: int) -> None:
    """Draw people, find their points, keep the numbers: one file each."""
    import mediapipe

    face = load_face(name)
    faces, gloss = visible_faces(face), vertex_gloss(face)
    eyes = [face.topology.parts[part] for part, kind in face.rigid_parts.items() if kind == "eye"]
    mesh = mediapipe.solutions.face_mesh.FaceMesh(static_image_mode=False, refine_landmarks=True, max_num_faces=1)
    for k in range(first, first + people):
        person = simulate_person(face, np.random.default_rng((SEED, k)))
        rng = np.random.default_rng((SEED, k, 1))
        look, weights = sample_appearance(rng), expressions(rng)
        albedo = albedo_function(face, look, faces)
        lights = Lights(look.light_directions, look.light_colours, look.sky, look.ground)
        wall = background(look.background, rng)
        kept: dict[str, list] = {key: [] for key in ("weights", "rotation", "translation", "focal", "points")}
        for i, row in enumerate(weights):
            intrinsics, motion = camera(rng, frontal=i < 2)
            vertices = person.pose(row).astype(np.float64)
            yaw, pitch = rng.uniform(-1, 1, 2) * (0.45, 0.3) * (i > 1 and rng.random() < 0.6)
            for start, stop in eyes:
                middle = vertices[start:stop].mean(axis=0)
                turn = rotation_from_vector([0.0, yaw, 0.0]) @ rotation_from_vector([-pitch, 0.0, 0.0])
                vertices[start:stop] = (vertices[start:stop] - middle) @ turn.T + middle
            seen = motion.apply(vertices)
            image = render_mesh(
                seen,
                intrinsics.project(seen),
                faces,
                (SIZE, SIZE),
                albedo=albedo,
                lights=lights,
                background=wall,
                shininess=gloss,
            ).image
            noisy = np.rint(image + NOISE_LEVELS * rng.standard_normal(image.shape))
            picture = np.ascontiguousarray(np.clip(noisy, 0, 255).astype(np.uint8))
            for _ in range(3 if i == 0 else 2):  # the second look starts from where the first found the face
                faces_found = mesh.process(picture).multi_face_landmarks
            if faces_found:
                points = np.array([(p.x, p.y) for p in faces_found[0].landmark]) * SIZE - 0.5
                for key, value in zip(
                    kept, (row, motion.rotation, motion.translation, intrinsics.focal_x, points), strict=True
                ):
                    kept[key].append(value)
        with write_atomically(folder / f"{name}_{k:04d}.npz") as path, path.open("wb") as file:
            np.savez(file, **{key: np.array(value) for key, value in kept.items()})


class Measured:
    """The people of a folder."""

    def __init__(self, face: Face, folder: Path) -> None:
        self.face = face
        self.files = sorted(folder.glob(f"{face.name}_*.npz"))

    def person(self, file: Path) -> tuple[SimulatedPerson, dict[str, np.ndarray]]:
        """Return a person and what was found of them."""
        k = int(file.stem.rsplit("_", 1)[1])
        with np.load(file) as data:
            return simulate_person(self.face, np.random.default_rng((SEED, k))), dict(data)

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
    people = [measured.person(file) for file in measured.files]
    near = np.zeros((478, n), np.float32)
    for person, data in people:
        still = {key: value[:2] for key, value in data.items()}
        for seen, found in measured.frames(np.repeat(person.neutral[None, :n].astype(float), 2, axis=0), still):
            near += np.linalg.norm((found[:, None] - seen[None]).astype(np.float32), axis=2)
    normals = vertex_normals(face.mean_shape[:n].astype(np.float64), face.skin().topology.faces)
    near[:, normals[:, 2] < -0.15] = np.inf
    candidates = np.argsort(near, axis=1)[:, :N_CANDIDATES]
    total, square, within, count = np.zeros((478, N_CANDIDATES, 2)), 0.0, 0.0, 0
    for person, data in people:
        r = np.array(
            [f[:, None] - s[candidates] for s, f in measured.frames(person.pose(data["weights"])[:, :n], data)]
        )
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
    for k, file in enumerate(measured.files):
        person, data = measured.person(file)
        posed = person.neutral[vertices] + np.einsum("tb,blc->tlc", data["weights"], person.deltas[:, vertices])
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
    ridge = 3.0 * np.diag(np.r_[np.full(6, 0.05), np.ones(46)])
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


def analyse(name: str, folder: Path, vertices_of: Path | None) -> None:
    """Turn the gathered numbers into the data file."""
    face = load_face(name)
    measured = Measured(face, folder)
    if vertices_of is None:
        vertices = choose_vertices(measured)
    else:
        with np.load(vertices_of) as data:
            vertices = data["vertices"].astype(np.int32)
    r, who, weights, rotations = departures(measured, vertices)
    C, own, left = regress(r, who, weights, rotations)
    offset = own.mean(axis=0)
    _, strength, directions = np.linalg.svd((own - offset) / np.sqrt(len(own) - 1), full_matrices=False)
    covariance = left.T @ left / (len(left) - len(own) - 52)
    covariance = 0.95 * covariance + 0.05 * np.diag(np.diag(covariance)) + 0.2**2 * np.eye(len(covariance))
    root = np.linalg.cholesky(covariance)
    clear = solve_triangular(root, signals(face, vertices, C[6:]), lower=True)
    U = np.linalg.svd(clear, full_matrices=False)[0][:, :N_DIRECTIONS]
    whitening = solve_triangular(root, U, lower=True, trans="T").T
    modes = strength[:N_MODES, None] * directions[:N_MODES]
    half = np.float16
    with write_atomically(DATA / f"dense478_{name}.npz") as path, path.open("wb") as file:
        np.savez_compressed(
            file,
            vertices=vertices,
            offset=offset.reshape(-1, 2).astype(half),
            pose_response=C[:6].reshape(6, -1, 2).astype(half),
            expression_response=C[6:].reshape(46, -1, 2).astype(half),
            person_modes=modes.reshape(len(modes), -1, 2).astype(half),
            whitening=whitening.astype(half),
            blendshape_names=np.array(face.blendshape_names),
            fingerprints=np.array([face.topology.fingerprint, face.skin().topology.fingerprint]),
            n_people=len(own),
            n_frames=len(left),
        )


def main() -> None:
    """Run one of the two steps."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("step", choices=("gather", "analyse"))
    parser.add_argument("face")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--people", type=int, default=30)
    parser.add_argument("--vertices", type=Path, help="take the vertices from this data file")
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    if given.step == "gather":
        gather(given.face, given.folder, given.first, given.people)
    else:
        analyse(given.face, given.folder, given.vertices)


if __name__ == "__main__":
    main()
