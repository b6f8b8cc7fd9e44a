"""The control cage of the built-in face: our own connectivity, written down as one half and mirrored.

Every vertex has a place where it is measured: a point of the measured model's texture plane (``A`` face sheet, ``B``
back-of-head sheet; thousandths, y downwards), a ray (from a point inside the head), or a position in mm.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

MOUTH = ["U0", "U1", "U2", "U3", "U4", "C", "L4", "L3", "L2", "L1", "L0"]  # midline top -> corner -> midline bottom
EYE = [f"E{i}" for i in range(12)]  # 0 inner corner, 1-5 upper, 6 outer corner, 7-11 lower (outer to inner)
EAR = 12

MOUTH_RINGS = {  # ring name -> points in MOUTH order, sheet A
    "M0": "500,559 517,559 530,559 541,559 548,563 551,569 548,575 541,579.5 530,580 517,580 500,580",
    "M1": "500,534 525,535 549,539.5 569,546.5 583,556 591,565.5 584,579 570,591 550,600 526,604 500,605",
    "M2": "500,512 527,511 553,516 576,527 592,543 602,562 594,586 577,604 554,615 527,619 500,620",
    "M3": "500,491.5 530,489 556,497 579,510 599,531 614,559 605,594 586,620 558,637 529,641 500,642",
    "M4": "500,474 536,474 569,480 598,494 620,520 640,556 629,603 605,638 567,660 532,666 500,667",
}
EYE_RINGS = {
    "R0": "618.5,283 624,280.6 635,280.4 648,280.4 661,280.4 674,280.6 680.5,283 674,284.5 661,285 648,285"
    " 635,285 624,285",
    "R1": "597.5,286 609,276.5 627,272 647,271 667,271.5 684,274.5 695,280.5 684,290.5 667,292.5 647,292.5"
    " 627,292 610,291",
    "R2": "583,287 597,266 617,258 643,254.5 668,255.5 692,262 708,279 694,293 672,303 648,305.5 624,304 600,299",
    "R3": "566,289 576,247 603,227 640,222 677,224 711,238 729,272 715,305 684,328 650,336 615,335 585,319",
}
EAR_RINGS = {
    "b": "A893,300 A935,290 B200,455 B209,490 B213,530 B213,570 B210,603 B196,636 A893,562 A880,490 A876,425 A880,350",
    "r": "A907,340 A935,320 A962,324 A982,345 A988,390 A988,435 A985,472 A962,510 A916,531 A896,490 A896,428 A898,385",
    "i": "A916,352 A936,340 A955,345 A968,360 A974,390 A972,430 A966,465 A942,495 A918,500 A905,475 A903,440 A908,392",
    "a": "A925,372 A938,368 A950,378 A956,392 A958,415 A954,445 A945,468 A930,482 A918,481 A910,466 A907,445 A916,402",
    "c": "A928,389 A934,386 A940,391 A944,402 A945,425 A940,445 A932,457 A924,465 A917,466 A913,457 A911,446 A920,415",
}
FREE = """
MB 500,188  BR0 560,190  BR3 632,182  BR4 692,184  BR5 748,200
GL 500,238  GLd 538,238  N0 500,278  D0 533,280  N1 500,318  D1 535,320  N2 500,355  D2 535,358
N3 500,388  D3 531,392  N4 500,422  T 526,411  N5 500,457
S2 566,350  A0 562,383  A1 590,382  A2 603,425  AL1 560,405  AL2 583,413  AL3 575,450  P1 540,459.5
Q0 520.5,446  Q1 527,430  Q2 543,425.5  Q3 558.5,434  Q4 553.5,447  Q5 535,451.5
q0 533.1,443.3  q1 535.7,436.9  q2 542.1,435.1  q3 548.3,438.5  q4 546.3,443.7  q5 538.9,445.5
pit 541.7,441.6
F1 597,347  F2 628,364  F3 664,369  F4 706,354  F5 748,322  F6 770,268
G3 652,428  G4 708,430  G5 775,408  X 618,458  K0 638,487  K1 671,510  K2 698,556  I5 768,490  I2 757,560
K3 684,620  I3 732,632  K4 637,668  I4 669,692  K5 583,700  K6 541,705  K7 500,706
TB 818,232  T6 825,280  T5 832,345  H5 838,425  J1 822,520
J2 797,615  J3 720,708  J4 628,738  J5 556,740  J6 500,740
nJ6 500,838  nJ5 568,838  nJ4 660,830  nJ3 765,805  nJ2 862,745
"""
SCALP_ROWS = (50.0, 80.0, 110.0, 140.0, 170.0, 199.0)  # degrees about the axis through the ears, 0 = forwards
SCALP_COLUMNS = ((0, 0, 0, 0, 0, 0), (11, 13, 14, 14, 14, 13), (22, 26, 28, 28, 28, 26), (33, 38, 41, 42, 41, 39),
                 (44, 49, 53, 54, 53, 51), (56, 61, 64, 65, 64, 62))  # fmt: skip
SCALP_ORIGIN = (0.0, 25.0, 5.0)
NECK_RAYS = {  # ring point -> angle in degrees from straight ahead, about the neck's axis
    "J6": 0, "J5": 14, "J4": 29, "J3": 46, "J2": 66, "W": 86, "X5": 102, "X4": 117, "X3": 132, "X2": 148, "X1": 164,
    "X0": 180,
}  # fmt: skip
NECK_RING = list(NECK_RAYS)
NECK_HEIGHTS = {"": {"W": -40, "X5": -41, "X4": -43, "X3": -45, "X2": -46, "X1": -46, "X0": -46},
                "n": {"W": -74, "X5": -78, "X4": -81, "X3": -83, "X2": -84, "X1": -85, "X0": -85},
                "e": {"J6": -126, "J5": -126, "J4": -125, "J3": -123, "J2": -119, "W": -114, "X5": -111, "X4": -110,
                      "X3": -110, "X2": -111, "X1": -112, "X0": -112}}  # fmt: skip
CAVITY = {  # the rim of the throat; the walls run from the lips straight past the teeth
    "V1": "0,-5,44 12,-5,44 24,-6,45 34,-10,46 40,-20,47 42,-33,48 40,-46,47 34,-56,46 24,-60,45 12,-61,44 0,-61,44",
}
FACE_QUADS = """
MB BR0 GLd GL; BR0 R3E2 R3E1 GLd; BR0 BR3 R3E3 R3E2; BR3 BR4 R3E4 R3E3; BR4 BR5 R3E5 R3E4; BR5 F6 R3E6 R3E5
GL GLd D0 N0; GLd R3E1 R3E0 D0; N0 D0 D1 N1; N1 D1 D2 N2; N2 D2 D3 N3; N3 D3 T N4
D0 R3E0 R3E11 D1; D1 R3E11 F1 S2; D1 S2 A0 D2; S2 F1 A1 A0; D2 A0 AL1 D3; A0 A1 AL2 AL1; A1 A2 AL3 AL2
N4 T Q2 Q1; D3 AL1 Q2 T; AL1 AL2 Q3 Q2; AL2 AL3 Q4 Q3; AL3 P1 Q5 Q4; P1 N5 Q0 Q5; N4 Q1 Q0 N5
R3E6 F6 F5 R3E7; R3E7 F5 F4 R3E8; R3E8 F4 F3 R3E9; R3E9 F3 F2 R3E10; R3E10 F2 F1 R3E11
F1 F2 A2 A1; F2 F3 G3 A2; F3 F4 G4 G3; F4 F5 G5 G4; F5 F6 T6 T5; F5 T5 H5 G5; F6 BR5 TB T6
A2 G3 K0 X; G3 G4 K1 K0; G4 G5 I5 K1; G5 H5 J1 I5; K1 I5 I2 K2; I5 J1 J2 I2; K2 I2 I3 K3; I2 J2 J3 I3
K3 I3 I4 K4; I3 J3 J4 I4; K4 I4 J4 K5; K5 J4 J5 K6; K6 J5 J6 K7
N5 P1 M4U1 M4U0; P1 AL3 M4U2 M4U1; AL3 A2 X M4U2; M4U2 X K0 M4U3; M4U3 K0 K1 M4U4; M4U4 K1 K2 M4C
M4C K2 K3 M4L4; M4L4 K3 K4 M4L3; M4L3 K4 K5 M4L2; M4L2 K5 K6 M4L1; M4L1 K6 K7 M4L0
"""
NOSTRIL_QUADS = """
Q0 Q1 q1 q0; Q1 Q2 q2 q1; Q2 Q3 q3 q2; Q3 Q4 q4 q3; Q4 Q5 q5 q4; Q5 Q0 q0 q5
"""
NOSTRIL_FLOOR = "q0 q1 q2 pit; q2 q3 q4 pit; q4 q5 q0 pit"
SIDE_QUADS = """
TB b0 b11 T6; T6 b11 b10 T5; T5 b10 b9 H5; H5 b9 b8 J1; J1 b8 W J2; b8 b7 X5 W; b7 b6 s6_5 X5
"""


class Cage(NamedTuple):
    """Connectivity of the whole cage and where each vertex is measured."""

    names: list[str]  # half name, "~" in front for the mirrored half
    faces: np.ndarray  # (F, 4), -1 pads a triangle
    patch: list[str]  # per face: face, eye, lip, inner_lip, nostril, ear, scalp, nape, neck, cavity
    mirror: np.ndarray
    places: dict[str, tuple]  # half name -> ("A"|"B", x, y) | ("ray", origin, direction) | ("mm", x, y, z)

    def index(self, name: str) -> int:
        return self.names.index(name)


def _points(text: str) -> list[tuple[str, float, float]]:
    out = []
    for item in text.split():
        sheet = item[0] if item[0] in "AB" else "A"
        x, y = item.lstrip("AB").split(",")
        out.append((sheet, float(x), float(y)))
    return out


def _places() -> dict[str, tuple]:
    places: dict[str, tuple] = {}
    for ring, text in MOUTH_RINGS.items():
        places.update({ring + key: p for key, p in zip(MOUTH, _points(text), strict=True)})
    for ring, text in EYE_RINGS.items():
        places.update({ring + key: p for key, p in zip(EYE, _points(text), strict=True)})
    for ring, text in EAR_RINGS.items():
        places.update({f"{ring}{k}": p for k, p in enumerate(_points(text))})
    words = FREE.split()
    for name, where in zip(words[::2], words[1::2], strict=True):
        places[name] = _points(where)[0]
    for row, phi in enumerate(np.radians(SCALP_ROWS), start=1):
        for column, angles in enumerate(SCALP_COLUMNS):
            alpha = np.radians(angles[row - 1])
            direction = (np.sin(alpha), np.cos(alpha) * np.sin(phi), np.cos(alpha) * np.cos(phi))
            places[f"s{row}_{column}"] = ("ray", SCALP_ORIGIN, direction)
    for prefix, heights in NECK_HEIGHTS.items():
        for point, y in heights.items():
            angle = np.radians(NECK_RAYS[point])
            axis = (0.0, float(y), {"": -10.0, "n": -8.0, "e": -10.0}[prefix])
            places[prefix + point] = ("ray", axis, (np.sin(angle), 0.0, np.cos(angle)))
    for ring, text in CAVITY.items():
        for key, item in zip(MOUTH, text.split(), strict=True):
            places[ring + key] = ("mm", *(float(v) for v in item.split(",")))
    return places


def _strips(rings: list[str], keys: list[str], closed: bool) -> list[list[str]]:
    quads = []
    for inner, outer in itertools.pairwise(rings):
        for a, b in zip(keys, keys[1:] + ([keys[0]] if closed else [])):
            quads.append([inner + a, inner + b, outer + b, outer + a])
    return quads


def _half_faces() -> list[tuple[str, list[str]]]:
    def listed(text: str) -> list[list[str]]:
        return [q.split() for line in text.strip().splitlines() for q in line.split(";") if q.strip()]

    faces = [("face", q) for q in listed(FACE_QUADS)]
    faces += [("nostril", q) for q in listed(NOSTRIL_QUADS)]
    faces += [("nostril_floor", q) for q in listed(NOSTRIL_FLOOR)]
    faces += [("eye", q) for q in _strips(["R0", "R1", "R2", "R3"], EYE, True)]
    faces += [("lip", q) for q in _strips(["M1", "M2", "M3", "M4"], MOUTH, False)]
    faces += [("inner_lip", q) for q in _strips(["M0", "M1"], MOUTH, False)]
    faces += [("side", q) for q in listed(SIDE_QUADS)]
    ear = [str(k) for k in range(EAR)]
    faces += [("ear", q) for q in _strips(["c", "a", "i", "r", "b"], ear, True)]
    for k in range(EAR // 2 - 1):  # floor of the concha, a ladder
        faces.append(("ear", [f"c{(k - 1) % EAR}", f"c{k}", f"c{9 - k}", f"c{10 - k}"]))
    rows = [["MB", "BR0", "BR3", "BR4", "BR5", "TB", "b0"]]
    rows += [[f"s{r}_{c}" for c in range(6)] + [f"b{r}"] for r in range(1, len(SCALP_ROWS) + 1)]
    rows += [["X0", "X1", "X2", "X3", "X4", "X5"]]
    for k, (upper, lower) in enumerate(itertools.pairwise(rows)):
        for column, (a, b, c, d) in enumerate(zip(upper, upper[1:], lower, lower[1:])):
            # fine where the outline of the head runs, seen from the front or the side
            seen = column < (2, 4, 4, 4, 2, 2, 0)[k]
            patch = ("forehead" if seen else "temple") if k == 0 else "scalp" if seen else "nape"
            faces.append((patch, [a, b, d, c]))
    faces += [("neck", q) for q in _strips(["", "n", "e"], NECK_RING, False)]
    faces += [("cavity", q) for q in _strips(["M0", "V1"], MOUTH, False)]
    for k in range(4):
        faces.append(("cavity", [f"V1U{k}", f"V1U{k + 1}", f"V1L{k + 1}", f"V1L{k}"]))
    faces.append(("cavity", ["V1U4", "V1C", "V1L4"]))
    return faces


def _orient(faces: list[list[int]]) -> list[list[int]]:
    """Flip faces so that neighbours agree; the first face keeps its order."""
    at_edge: dict[tuple[int, int], list[int]] = {}
    for f, face in enumerate(faces):
        for a, b in zip(face, face[1:] + face[:1]):
            at_edge.setdefault((min(a, b), max(a, b)), []).append(f)
    if any(len(users) > 2 for users in at_edge.values()):
        raise ValueError("the cage is not manifold")
    done, stack = {0}, [0]
    while stack:
        f = stack.pop()
        for a, b in zip(faces[f], faces[f][1:] + faces[f][:1]):
            for g in at_edge[min(a, b), max(a, b)]:
                if g in done:
                    continue
                if (a, b) in zip(faces[g], faces[g][1:] + faces[g][:1]):
                    faces[g] = faces[g][::-1]
                done.add(g)
                stack.append(g)
    if len(done) != len(faces):
        raise ValueError(f"the cage has {len(faces) - len(done)} faces that are not connected")
    return faces


def build_cage() -> Cage:
    """Return the cage of the whole head: half, mirrored half, faces turned outwards."""
    places = _places()
    half = _half_faces()
    used = {name for _, face in half for name in face}
    unknown = sorted(used - set(places))
    if unknown:
        raise ValueError(f"cage faces name unknown vertices: {unknown}")
    names = [name for name in places if name in used]
    middle = [n for n in names if _on_midline(n, places)]
    names += ["~" + n for n in names if n not in middle]
    index = {n: k for k, n in enumerate(names)}
    mirrored = {n: n if n in middle else "~" + n for n in places}
    faces = [[index[n] for n in face] for _, face in half]
    faces += [[index[mirrored[n]] for n in face][::-1] for _, face in half]
    faces = _orient(faces)
    # the first face (MB BR0 GLd GL) is listed clockwise seen from the front
    padded = np.array([f[::-1] + [-1] * (4 - len(f)) for f in faces], np.int32)
    mirror = np.array([index[n[1:]] if n[0] == "~" else index[mirrored[n]] for n in names], np.int32)
    return Cage(names, padded, [p for p, _ in half] * 2, mirror, places)


def _on_midline(name: str, places: dict[str, tuple]) -> bool:
    place = places[name]
    if place[0] == "A":
        return place[1] == 500.0
    if place[0] == "B":
        return False
    return abs(place[2][0] if place[0] == "ray" else place[1]) < 1e-9
