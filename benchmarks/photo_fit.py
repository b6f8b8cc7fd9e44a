"""A face fitted to the landmarks of a photo: ours beside eos (pip install eos-py), on the same people and pictures.

The package of eos holds no face model, and the one of its repository is not ours to pass on. It gets a model of the
same simulated people as ours: the PCA of their neutrals and their mean blendshapes, of the face without the rest of
the head (what its occluding edges expect). Two comparisons on pictures of unseen people, true landmarks with 1 px
noise: with the landmarks that have a vertex, and with the contour as well (ours slides along strips, eos takes nearest
vertices and occluding edges). Iterations and regularisation of eos are its defaults; its call hands the mesh over as a
Python list, which is part of its time. Error: mean distance of corresponding vertices of the face, after the best
similarity. The camera of eos is orthographic, ours perspective. Its contour fitting was made for the Surrey model: on
this face it does worse than without (mostly by its occluding edges), and the set-up here may not be its best.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common import Table, benchmark_face, best_ms, has_peer, quick_from_command_line
from facewright.evaluation.photo import NOISE_PX
from facewright.evaluation.simulated_photo import SimulatedPhoto, simulate_photo
from facewright.faces.simulate import simulate_population
from facewright.fitting.image import PhotoFitter
from facewright.landmarks.contour import build_contour_strips, face_region
from facewright.landmarks.points import Landmarks
from facewright.landmarks.scheme import load_scheme
from facewright.mesh.topology import Topology
from facewright.models.bilinear import fit_bilinear
from facewright.numeric.similarity import estimate_similarity

N_IDENTITY = 50

Fit = Callable[[Landmarks, tuple[int, int]], np.ndarray]


class EosFitter:
    """eos with a model of our people: fits and returns the vertices of the face, in the order of `region`.

    Parameters
    ----------
    tensor : ndarray of shape (N, 47, V, 3)
        The people; shape 0 is the neutral.
    topology : Topology
        Of V vertices.
    region : ndarray of int
        The face's vertices, sorted.
    folder : Path
        For the files that eos reads.
    """

    def __init__(self, tensor: np.ndarray, topology: Topology, region: np.ndarray, folder: Path) -> None:
        import eos

        self.eos = eos
        shapes = tensor[:, :, region].astype(np.float64)
        row = np.full(topology.n_vertices, -1)
        row[region] = np.arange(len(region))
        faces = row[topology.faces]
        faces = faces[(faces >= 0).all(axis=1)]
        neutrals = shapes[:, 0].reshape(len(shapes), -1)
        mean = neutrals.mean(axis=0)
        _, s, Vt = np.linalg.svd(neutrals - mean, full_matrices=False)
        n_modes = min(N_IDENTITY, len(shapes) - 1)
        variances = s[:n_modes] ** 2 / (len(shapes) - 1)
        shape = eos.morphablemodel.PcaModel(mean, Vt[:n_modes].T, variances, faces.tolist())
        deltas = shapes.mean(axis=0)[1:] - mean.reshape(-1, 3)
        blendshapes = [eos.morphablemodel.Blendshape(str(k), delta.ravel()) for k, delta in enumerate(deltas)]
        self.model = eos.morphablemodel.MorphableModel(shape, blendshapes, eos.morphablemodel.PcaModel())
        self.edges = eos.morphablemodel.EdgeTopology(*edge_topology(faces))
        strips = row[build_contour_strips(topology, tensor[:, 0].mean(axis=0)).vertices]
        last = strips.shape[1] - 1 - np.argmax(strips[:, ::-1] >= 0, axis=1)
        self.load_marks(row[topology.landmarks["fw74"]], strips[np.arange(len(strips)), last], folder)

    def load_marks(self, ids: np.ndarray, jaw: np.ndarray, folder: Path) -> None:
        """Write and load landmark names, contour landmarks and contour vertices, from right temple to left."""
        scheme = load_scheme("fw74")
        contour, middle, half = scheme.sliding.tolist(), len(scheme.sliding) // 2, len(jaw) // 2  # the chin's: no side
        fixed = "\n".join(f'{k} = "{ids[k]}"' for k in scheme.fixed)
        names = f"right = {contour[:middle]}\nleft = {contour[middle + 1 :]}"
        marks, outline = folder / "landmarks.toml", folder / "contour.json"
        marks.write_text(f"[landmark_mappings]\n{fixed}\n[contour_landmarks]\n{names}\n")
        right, left = jaw[:half].tolist(), jaw[half + 1 :].tolist()
        outline.write_text(f'{{"model_contour": {{"right_contour": {right}, "left_contour": {left}}}}}')
        self.mapper = self.eos.core.LandmarkMapper(str(marks))
        self.contour_landmarks = self.eos.fitting.ContourLandmarks.load(str(marks))
        self.model_contour = self.eos.fitting.ModelContour.load(str(outline))

    def fit(self, landmarks: Landmarks, image_size: tuple[int, int]) -> np.ndarray:
        """Fit with the contour where the landmarks have it."""
        height, width = image_size
        named = [
            self.eos.core.Landmark(str(k), point)
            for k, point in enumerate(landmarks.points.astype(np.float32))
            if landmarks.present[k]
        ]
        arguments: list[Any] = [self.model, named, self.mapper, width, height]
        if landmarks.present[load_scheme("fw74").sliding].all():
            arguments += [self.edges, self.contour_landmarks, self.model_contour]
        mesh = self.eos.fitting.fit_shape_and_pose(*arguments)[0]
        return np.asarray(mesh.vertices)[:, :3]


def main() -> None:
    quick = quick_from_command_line(__doc__)
    n_people, n_photos = (30, 4) if quick else (150, 20)
    face = benchmark_face()
    skin = face.skin()
    region = face_region(skin.topology, skin.mean_shape)
    tensor = simulate_population(skin, n_people, np.random.default_rng(0))
    names = ("neutral", *skin.blendshape_names)
    n_modes = min(N_IDENTITY, n_people - 1)
    model = fit_bilinear(tensor, n_modes, len(names), topology=skin.topology, expression_names=names)
    fitter = PhotoFitter(model)
    photos = [simulate_photo(face, np.random.default_rng((1, k))) for k in range(n_photos)]
    noisy = [photo.noisy_landmarks(NOISE_PX, np.random.default_rng((2, k))) for k, photo in enumerate(photos)]
    print(
        f"  models of {n_people} simulated people; {n_photos} pictures of others, landmarks with {NOISE_PX:g} px noise"
    )
    table = Table()
    with tempfile.TemporaryDirectory() as folder:
        peer = EosFitter(tensor, skin.topology, region, Path(folder)) if has_peer("eos") else None
        for what, marks in (("fixed landmarks", [without_contour(each) for each in noisy]), ("with contour", noisy)):
            ours, our_mm = measure(lambda *photo: fitter.fit(*photo).vertices[region], photos, marks, region)
            if peer is None:
                table.ours(what, ours, f"{our_mm:.2f} mm")
                continue
            theirs, their_mm = measure(peer.fit, photos, marks, region)
            table.versus(what, ours, "eos", theirs, f"ours {our_mm:.2f} mm off, theirs {their_mm:.2f} mm")
    table.show()
    trivial = np.mean([distance_mm(model.mean_face[region], photo.vertices[region]) for photo in photos])
    print(f"  ours makes all {skin.topology.n_vertices} vertices, eos the {len(region)} of the face")
    print(f"  the mean face at rest is {trivial:.2f} mm off")


def measure(fit: Fit, photos: list[SimulatedPhoto], marks: list[Landmarks], region: np.ndarray) -> tuple[float, float]:
    """Return the median over pictures of the time of a fit, ms, and the mean error, mm."""
    times, errors = [], []
    for photo, landmarks in zip(photos, marks, strict=True):
        errors.append(distance_mm(fit(landmarks, photo.image_size), photo.vertices[region]))
        times.append(best_ms(partial(fit, landmarks, photo.image_size), 3))
    return float(np.median(times)), float(np.mean(errors))


def distance_mm(vertices: np.ndarray, truth: np.ndarray) -> float:
    """Return the mean distance of corresponding vertices, after the best similarity."""
    return float(np.linalg.norm(estimate_similarity(vertices, truth).apply(vertices) - truth, axis=1).mean())


def without_contour(landmarks: Landmarks) -> Landmarks:
    """Return landmarks without those that slide."""
    confidence = landmarks.confidence.copy()
    confidence[load_scheme(landmarks.scheme).sliding] = 0.0
    return Landmarks(landmarks.scheme, landmarks.points, confidence)


def edge_topology(faces: np.ndarray) -> tuple[list[list[int]], list[list[int]]]:
    """Return faces and vertices of each edge as eos wants them: counted from 1, first face 0 at the boundary."""
    edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    owner = np.repeat(np.arange(len(faces)), 3)
    vertices, inverse, count = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(inverse.ravel(), kind="stable")
    last = np.cumsum(count) - 1
    sides = np.stack([np.where(count > 1, owner[order[last - (count > 1)]] + 1, 0), owner[order[last]] + 1], axis=1)
    return sides.tolist(), (vertices + 1).tolist()


if __name__ == "__main__":
    main()
