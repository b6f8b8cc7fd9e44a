"""Measure the built-in face: cage positions, identity and expression displacements, annotation -> one small file.

    python tools/measure_builtin_face.py /path/to/ict_facekit.npz

writes src/facewright/faces/data/builtin_face.npz. The figures are read off ICT-FaceKit (MIT, see NOTICE); the cage and
its connectivity are ours (tools/builtin_cage.py).
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from builtin_annotate import annotate
from builtin_cage import build_cage
from builtin_solve import MIRROR_X, Measurement

from facewright.faces.builtin_mesh import build_control_mesh
from facewright.faces.builtin_parts import EYE_CENTRE, HANDLE_MIRROR, HANDLES, handle_weights

OUT = Path(__file__).parents[1] / "src/facewright/faces/data/builtin_face.npz"
N_MODES = 60
GAZE_DEGREES = 24.0
COARSE = {"nostril_floor", "ear", "neck", "cavity", "temple", "side", "nape"}
PART_OF_PATCH = {"side": 1, "ear": 1, "neck": 1, "scalp": 1, "nape": 1, "cavity": 2}
PATCH_NAMES = (
    "face",
    "eye",
    "lip",
    "inner_lip",
    "nostril",
    "nostril_floor",
    "forehead",
    "temple",
    "scalp",
    "nape",
    "side",
    "ear",
    "neck",
    "cavity",
)


SEALED = ("cheekPuff", "cheekSquint", "mouthDimple", "mouthFrown", "mouthPress", "mouthSmile", "mouthStretch")
SLIDING = (
    "jawLeft",
    "jawRight",
    "mouthLeft",
    "mouthRight",
    "mouthPucker",
    "jawForward",
    "mouthRollUpper",
    "mouthRollLower",
)


class Table:
    """Measure whole control tables (cage and handles of the rigid parts)."""

    def __init__(self, m: Measurement, data: dict):
        self.m, self.data = m, data
        ranges = dict(zip(data["part_names"], data["part_ranges"]))
        jaw = data["expression_deltas"][list(data["expression_names"]).index("jawOpen")]
        teeth = np.arange(*ranges["teeth"])
        lower = np.abs(jaw[teeth, 1]) > 5
        self.rigid = [
            np.arange(*ranges["eyeball_left"]), np.arange(*ranges["eyeball_right"]), teeth[~lower], teeth[lower],
        ]  # fmt: skip
        self.mirror = np.concatenate([m.cage.mirror, m.n + HANDLE_MIRROR])
        seal = m.difference(m.upper_lip, m.lower_lip)
        self.seal = seal[np.asarray(abs(seal).sum(axis=1)).ravel() > 1e-9]
        lids = m.difference(m.upper_lid, m.lower_lid)
        self.lids = lids[np.asarray(abs(lids).sum(axis=1)).ravel() > 1e-9]
        right = m.cage.mirror
        self.lids_right = self.lids[:, right]
        eye = np.array(["eye" in p for p in m.cage.patch])
        names = [[m.cage.names[v] for v in f if v >= 0] for f in m.cage.faces]
        lids = np.array([all(n[:2] in ("R1", "R2") for n in f) for f in names]) & eye
        self.left_lids = np.unique(m.quads[lids[m.parents]])
        self.lid_points: list[np.ndarray] = []  # where the left lids are, open and closed

    def handles(self, field: np.ndarray) -> np.ndarray:
        """Best affine motion of each rigid part, read at its four handles."""
        out = []
        for k, ids in enumerate(self.rigid):
            points = self.data["vertices"][ids].astype(float)
            affine, *_ = np.linalg.lstsq(handle_weights(k, points), field[ids].astype(float), rcond=None)
            out.append(affine)
        return np.concatenate(out)

    def eye_handles(self, cage: np.ndarray) -> np.ndarray:
        """Move and scale the left eyeball with its lids, open and closed, so that their gap stays (least squares)."""
        centre = np.array(EYE_CENTRE)
        rows, values = [], []
        moved = self.m.S[self.left_lids] @ cage
        for points in self.lid_points:
            arm = points - centre
            radius = np.linalg.norm(arm, axis=1, keepdims=True)
            rows.append(np.concatenate([arm / radius, radius], axis=1))
            values.append((arm / radius * moved).sum(axis=1))
        ridge = np.diag([1.0, 1.0, 1.0, 15.0]) * 0.5  # unseen directions stay put
        solution, *_ = np.linalg.lstsq(
            np.concatenate([*rows, ridge]), np.concatenate([*values, np.zeros(4)]), rcond=None
        )
        return solution[:3] + solution[3] * (HANDLES[:4] - centre)

    def mirrored(self, table: np.ndarray) -> np.ndarray:
        return table[self.mirror] * MIRROR_X

    def displacement(self, field: np.ndarray, ties=()) -> np.ndarray:
        dense, cavity = self.m.measure(field)
        start = dense[: self.m.n].copy()  # what the dense point of each cage vertex does
        start[self.m.cavity_cage] = cavity
        cage = self.m.solve(dense, cavity, start, ties)
        return np.concatenate([cage, self.handles(field)])


def measure_mean(t: Table) -> np.ndarray:
    """Fit the mean cage, letting points of smooth regions slide, lips sealed, left and right alike."""
    m = t.m
    zero = np.zeros((t.seal.shape[0], 3))
    for round_ in range(5):
        dense, _ = m.measure(t.data["vertices"])
        cage = m.solve(dense, m.start[m.cavity_cage], m.start, [(t.seal, zero)])
        cage = 0.5 * (cage + cage[m.cage.mirror] * MIRROR_X)
        if round_ < 4:
            m.relax(cage)
    return np.concatenate([cage, HANDLES])


def measure_modes(t: Table, count: int) -> tuple[np.ndarray, float]:
    """Principal modes of the measured modes and their mirror images, each at one standard deviation."""
    zero = np.zeros((t.seal.shape[0], 3))
    tables = np.array([t.displacement(f, [(t.seal, zero)]) for f in t.data["identity_modes"]])
    n = t.m.n
    for table in tables:
        image = t.mirrored(table)
        table[n : n + 4] = t.eye_handles(table[:n])
        table[n + 4 : n + 8] = t.eye_handles(image[:n]) * MIRROR_X
    tables = np.concatenate([tables, np.array([t.mirrored(x) for x in tables])]) / np.sqrt(2)
    flat = tables.reshape(len(tables), -1)
    value, vector = np.linalg.eigh(flat @ flat.T)
    value, vector = value[::-1], vector[:, ::-1]
    modes = (vector[:, :count].T @ flat).reshape(count, -1, 3)
    for mode in modes:  # symmetric or antisymmetric, exactly
        image = t.mirrored(mode)
        sign = np.sign((image * mode).sum())
        mode[:] = 0.5 * (mode + sign * image)
        mode *= np.sign(mode.reshape(-1)[np.abs(mode).argmax()])
    return modes, float(value[:count].sum() / value.sum())


def measure_expressions(t: Table, mean: np.ndarray) -> dict[str, np.ndarray]:
    """Measure the 45 shapes and eyesLookDown; lids meet in eyeBlink, lips in jawOpen + mouthClose."""
    source = dict(zip((str(n) for n in t.data["expression_names"]), t.data["expression_deltas"]))
    drop = ("eyeLook", "Pupil", "cheekRaiser")
    names = [n for n in source if not n.startswith(drop)]
    out: dict[str, np.ndarray] = {}
    cage = mean[: t.m.n]
    for name in names:
        ties = []
        if name.startswith("eyeBlink"):
            rows = t.lids if name.endswith("_L") else t.lids_right
            ties = [(rows, -(rows @ cage))]
        elif name == "mouthClose":
            ties = [(t.seal, -(t.seal @ out["jawOpen"][: t.m.n]))]
        elif name.removesuffix("_L").removesuffix("_R") in SEALED:
            ties = [(t.seal, np.zeros((t.seal.shape[0], 3)))]
        out[name] = t.displacement(source[name], ties)
        if name in SLIDING:  # lips slide on one another: only the heights are held
            held = t.displacement(source[name], [(t.seal, np.zeros((t.seal.shape[0], 3)))])
            out[name][:, 1] = held[:, 1]
    down = t.displacement(source["eyeLookDown_L"] + source["eyeLookDown_R"])
    a = np.radians(GAZE_DEGREES)
    turn = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    for k, side in ((0, 1.0), (1, -1.0)):
        rows = slice(t.m.n + 4 * k, t.m.n + 4 * k + 4)
        arm = HANDLES[4 * k : 4 * k + 4] - np.array(EYE_CENTRE) * [side, 1, 1]
        down[rows] = arm @ turn.T - arm
    out["eyesLookDown"] = down
    return _balanced(t, out)


def _balanced(t: Table, shapes: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Make left and right shapes mirror images of one another."""
    swap = {"_L": "_R", "_R": "_L"}
    result = {}
    for name in shapes:
        other = name[:-2] + swap[name[-2:]] if name[-2:] in swap else name
        if name not in swap and (name.endswith(("Left", "Right"))):
            other = name.replace("Left", "#").replace("Right", "Left").replace("#", "Right")
        result[name] = 0.5 * (shapes[name] + t.mirrored(shapes[other]))
    return result


def quantise(tables: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Round each table to int16 with a step of its own."""
    step = np.abs(tables).reshape(len(tables), -1).max(axis=1) / 32767
    return np.round(tables / step[:, None, None]).astype(np.int16), step.astype(np.float64)


def main() -> None:
    data = dict(np.load(sys.argv[1]))
    cage = build_cage()
    t = Table(Measurement(cage, data), data)
    mean = measure_mean(t)
    expressions = measure_expressions(t, mean)
    lids = t.m.S[t.left_lids]
    for weight in (0.0, 0.5, 1.0):
        t.lid_points.append(lids @ (mean + weight * expressions["eyeBlink_L"])[: t.m.n])
    modes, share = measure_modes(t, N_MODES)
    print(f"{N_MODES} identity modes keep {100 * share:.2f} % of the variance")

    patch = np.array([PATCH_NAMES.index(p) for p in cage.patch], np.uint8)
    is_fine = np.array([p not in COARSE for p in cage.patch])
    part = np.array([PART_OF_PATCH.get(p, 0) for p in cage.patch], np.uint8)
    control = build_control_mesh(cage.faces, len(cage.names), is_fine, part, cage.mirror)
    arrays = {
        "cage_faces": cage.faces.astype(np.int16), "cage_mirror": cage.mirror.astype(np.int16),
        "cage_patch": patch, "cage_is_fine": is_fine, "cage_part": part, "patch_names": np.array(PATCH_NAMES),
        "expression_names": np.array(list(expressions)),
    }  # fmt: skip
    arrays["mean"] = mean.astype(np.float32)
    for name, tables in (("identity", modes), ("expression", np.array(list(expressions.values())))):
        arrays[f"{name}_values"], arrays[f"{name}_step"] = quantise(tables)
    arrays.update(annotate(t.m, control, mean))
    OUT.parent.mkdir(exist_ok=True)
    np.savez_compressed(OUT, **arrays)
    print(f"{OUT}: {OUT.stat().st_size / 1000:.0f} kB, {control.matrix.shape[0]} skin and cavity vertices")


if __name__ == "__main__":
    main()
