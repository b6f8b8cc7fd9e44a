"""Masks, landmarks and texture coordinates of the built-in face, read off the names of its cage."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from builtin_atlas import FACE_GAIN, flatten, flatten_disc
from builtin_cage import EYE, MOUTH
from builtin_solve import Measurement

from facewright.faces.builtin import shorter_diagonals, split_quads
from facewright.faces.builtin_mesh import ControlMesh

DATA = Path(__file__).parents[1] / "src/facewright"
NOSE = {"N0", "N1", "N2", "N3", "N4", "N5", "D0", "D1", "D2", "D3", "S2", "A0", "A1", "A2", "T", "AL1", "AL2", "AL3",
        "P1", "Q0", "Q1", "Q2", "Q3", "Q4", "Q5", "q0", "q1", "q2", "q3", "q4", "q5", "pit"}  # fmt: skip
CHEEK = {
    "F1",
    "F2",
    "F3",
    "F4",
    "F5",
    "A2",
    "G3",
    "G4",
    "G5",
    "X",
    "K0",
    "K1",
    "K2",
    "I5",
    "I2",
    "K3",
    "I3",
    "T5",
    "H5",
}
CHIN = {"M4L0", "M4L1", "M4L2", "K5", "K6", "K7", "J4", "J5", "J6"}


class Annotator:
    def __init__(self, m: Measurement, control: ControlMesh, mean: np.ndarray):
        self.m, self.control = m, control
        self.points = control.matrix @ mean[: m.n]
        self.index = np.full(m.S.shape[0], -1)
        self.index[control.fine_index] = np.arange(len(control.fine_index))
        self.n_skin = control.parts["head_and_neck"][1]
        self.names = [[m.cage.names[v] for v in f if v >= 0] for f in m.cage.faces]
        self.patch = np.array(m.cage.patch)

    def path(self, names: list[str], closed: bool = False) -> np.ndarray:
        ids = self.index[self.m.dense_path(names, closed)]
        return ids[ids >= 0]

    def inside(self, faces: np.ndarray) -> np.ndarray:
        """Vertices of the given cage faces (bool per face), sorted."""
        ids = np.unique(self.index[self.m.quads[faces[self.m.parents]]])
        return ids[ids >= 0]

    def by_names(self, allowed: set[str], left: bool | None = None) -> np.ndarray:
        def ok(face: list[str]) -> bool:
            side = left is None or any(n[0] == "~" for n in face) != left
            return side and all(n.lstrip("~") in allowed for n in face)

        return self.inside(np.array([ok(f) for f in self.names]))

    def mirrored(self, ids: np.ndarray) -> np.ndarray:
        return np.sort(self.control.mirror[ids])

    # -- masks ----------------------------------------------------------------------------------------------------
    def masks(self) -> dict[str, np.ndarray]:
        rings = ("M0", "M1", "M2", "M3")
        out = {
            "lips_upper": self.by_names({r + k for r in rings for k in MOUTH[:6]}),
            "lips_lower": self.by_names({r + k for r in rings for k in MOUTH[5:]}),
        }
        out["lips"] = np.union1d(out["lips_upper"], out["lips_lower"])
        upper = {r + k for r in ("R1", "R2") for k in EYE[:7]}
        lower = {r + k for r in ("R1", "R2") for k in [EYE[0], *EYE[6:]]}
        sided = {
            "eyelid_upper": self.by_names(upper, left=True),
            "eyelid_lower": self.by_names(lower, left=True),
            "lash_line": np.unique(self.path(["R1" + k for k in EYE], closed=True)),
            "cheeks": self.by_names(CHEEK, left=True),
            "brow": self._brow(),
        }
        for name, ids in sided.items():
            out[f"{name}_left"], out[f"{name}_right"] = ids, self.mirrored(ids)
        out["nose"] = self.by_names(NOSE)
        out["nostrils"] = self.inside(np.isin(self.patch, ["nostril", "nostril_floor"]))
        rim = self.path([f"Q{k}" for k in range(6)], closed=True)
        out["nostril_insides"] = np.setdiff1d(out["nostrils"], np.union1d(rim, self.mirrored(rim)))
        out["chin"] = self.by_names(CHIN)
        out["ears"] = self.inside(self.patch == "ear")
        brows = np.union1d(out["brow_left"], out["brow_right"])
        out["forehead"] = np.setdiff1d(self.inside(np.isin(self.patch, ["forehead", "temple"])), brows)
        out["face"] = np.arange(*self.control.parts["face"])
        out["face_region"] = self.inside(np.isin(self.patch, ["face", "eye", "lip", "forehead", "temple", "nostril"]))
        x = self.points[: self.n_skin, 0]
        out["left"], out["right"] = np.flatnonzero(x > 1e-3), np.flatnonzero(x < -1e-3)
        pairs = {"lip_contact": (self.m.upper_lip, self.m.lower_lip),
                 "lid_contact_left": (self.m.upper_lid, self.m.lower_lid)}  # fmt: skip
        for name, (a, b) in pairs.items():
            first, second = self.index[a], self.index[b]
            apart = first != second
            stem, _, side = name.partition("_contact")
            out[f"{stem}_contact_upper{side}"] = first[apart]
            out[f"{stem}_contact_lower{side}"] = second[apart]
        for side in ("upper", "lower"):
            out[f"lid_contact_{side}_right"] = self.control.mirror[out[f"lid_contact_{side}_left"]]
        return {k: v.astype(np.int16) for k, v in out.items()}

    def _brow(self) -> np.ndarray:
        """Skin within the band between the upper and the lower row of the left brow's landmarks."""
        p = self.points[self._fw74()]
        upper, lower = p[[23, 22, 21]], p[[24, 25, 26]]
        x, y = self.points[: self.n_skin, 0], self.points[: self.n_skin, 1]
        top = np.interp(x, upper[:, 0], upper[:, 1]) + 1.5
        bottom = np.interp(x, lower[:, 0], lower[:, 1]) - 1.5
        within = (y < top) & (y > bottom) & (x > lower[0, 0] - 2) & (x < upper[2, 0] + 2)
        return np.flatnonzero(within & (self.points[: self.n_skin, 2] > 50))

    # -- landmarks --------------------------------------------------------------------------------------------------
    def _nearest(self, targets: np.ndarray, allowed: np.ndarray) -> np.ndarray:
        gap = np.linalg.norm(self.points[allowed][None] - targets[:, None], axis=-1)
        return allowed[gap.argmin(axis=1)]

    def _place(self, vertices: np.ndarray, groups: dict[str, list[int]], mirror: np.ndarray) -> np.ndarray:
        """Nearest vertex of the right kind (lash line, lip rings) to the measured model's landmark vertices."""
        targets = self.m.data["vertices"][vertices].astype(float)
        targets = 0.5 * (targets + targets[mirror] * [-1, 1, 1])
        lash = self.path(["R1" + k for k in EYE], closed=True)
        border = np.concatenate([self.path(["M3" + k for k in MOUTH])])
        above = self.path(["M1" + k for k in MOUTH[:6]])  # both sides of the contact line are in one place
        below = self.path(["M1" + k for k in MOUTH[5:]])
        front = np.flatnonzero(self.points[: self.n_skin, 2] > 0)
        allowed = {"eye": lash, "outer_mouth": border, "inner_upper": above, "inner_lower": below}
        kind = {k: name for name, ids in groups.items() for k in ids}
        out = np.zeros(len(targets), int)
        for k, target in enumerate(targets):
            left = target * [1, 1, 1] if target[0] >= 0 else target * [-1, 1, 1]
            choice = self._nearest(left[None], allowed.get(kind.get(k, ""), front))[0]
            if abs(left[0]) < 0.3 and kind.get(k) is None:
                midline = front[np.abs(self.points[front, 0]) < 1e-6]
                choice = self._nearest(left[None], midline)[0]
            out[k] = choice if target[0] >= 0 else self.control.mirror[choice]
        return out

    def _fw74(self) -> np.ndarray:
        vertices = json.loads((DATA / "faces/data/ict_landmarks.json").read_text())["fw74"]
        mirror = np.array(json.loads((DATA / "landmarks/data/fw74.json").read_text())["mirror"])
        groups = {"eye": [*range(27, 43)], "outer_mouth": [*range(54, 66)], "inner_upper": [*range(66, 71)],
                  "inner_lower": [71, 72, 73]}  # fmt: skip
        return self._place(np.array(vertices), groups, mirror)

    def landmarks(self) -> dict[str, np.ndarray]:
        fw74 = self._fw74()
        mirror68 = np.array(json.loads((DATA / "landmarks/data/ibug68.json").read_text())["mirror"])
        groups = {"eye": [*range(36, 48)], "outer_mouth": [*range(48, 60)], "inner_upper": [*range(60, 65)],
                  "inner_lower": [65, 66, 67]}  # fmt: skip
        mediapipe = np.full(478, -1)
        table = json.loads((DATA / "landmarks/data/mediapipe478_to_fw74.json").read_text())["points"]
        for target, sources in table.items():
            if len(sources) == 1 and int(target) > 14:
                mediapipe[sources[0][0]] = fw74[int(target)]
        found = {
            "fw74": fw74,
            "ibug68": self._place(self.m.data["landmarks_68"], groups, mirror68),
            "mediapipe478": mediapipe,
        }
        return {k: v.astype(np.int16) for k, v in found.items()}

    # -- texture ----------------------------------------------------------------------------------------------------
    def skin_uv(self) -> dict[str, np.ndarray]:
        all_quads = self.control.quads
        cavity = self.cavity_quads()
        quads = all_quads[~cavity]
        key = np.minimum(np.arange(len(self.points)), self.control.mirror)
        triangles = split_quads(quads, shorter_diagonals(self.points, quads, key))
        seam = self.path(["eX0", "nX0", "X0", "s6_0", "s5_0", "s4_0"])
        important = np.ones(self.n_skin)
        important[self.control.parts["face"][0] : self.control.parts["face"][1]] = FACE_GAIN
        uv, _ = flatten(self.points[: self.n_skin], triangles, seam, important)
        inner = all_quads[cavity]
        used = np.unique(inner[inner >= 0])
        local = np.where(inner >= 0, np.searchsorted(used, np.maximum(inner, 0)), -1)
        disc = flatten_disc(split_quads(local, shorter_diagonals(self.points[used], local, key[used])), len(used))
        return {
            "skin_uv": np.round(uv * 65535).astype(np.uint16),
            "skin_seam": seam.astype(np.int16),
            "cavity_uv": np.round(disc * 65535).astype(np.uint16),
            "cavity_quads": cavity,
        }

    def cavity_quads(self) -> np.ndarray:
        """Quads of the mouth cavity: those inside the rim M0, which the skin shares."""
        quads = self.control.quads
        touches = (quads >= self.n_skin).any(axis=1)
        rim = np.zeros(len(self.points), bool)
        ring = ["M0" + k for k in MOUTH]
        rim[self.path(ring)] = rim[self.control.mirror[self.path(ring)]] = True
        only_rim = (rim[np.maximum(quads, 0)] | (quads < 0)).all(axis=1)
        return touches | only_rim


def annotate(m: Measurement, control: ControlMesh, mean: np.ndarray) -> dict[str, np.ndarray]:
    """Return the arrays that go into the face's file."""
    a = Annotator(m, control, mean)
    out = {f"mask_{k}": v for k, v in a.masks().items()}
    out.update({f"landmarks_{k}": v for k, v in a.landmarks().items()})
    out.update(a.skin_uv())
    return out
