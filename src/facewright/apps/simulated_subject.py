"""Simulated people as they come to a capture session: face, appearance, hair, glasses, clothes, surroundings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from facewright.apps.simulated_props import Hair, Prop, make_glasses, make_hair, make_torso
from facewright.faces.appearance import Appearance, sample_appearance
from facewright.faces.face import Face
from facewright.faces.simulate import SimulatedPerson, simulate_person

HAIR_SHARE, GLASSES_SHARE = 0.85, 0.3


@dataclass(frozen=True, eq=False)
class SimulatedCaptureSubject:
    """A simulated person as they come to a capture session.

    Parameters
    ----------
    face : Face
        With all its parts.
    person : SimulatedPerson
        Neutral and personal blendshapes.
    appearance : Appearance
        Colours and light.
    hair : Hair or None
        None for closely cut hair or a bald head.
    glasses : (Prop, Prop) or None
        Frame and lenses, on the neutral.
    torso : Prop
        Model space of the head at rest.
    wall_mm, wall_tilt : float
        Distance of the wall along the optical axis, and its slope to the side.
    wall_shades : (float, float)
        How its lightness changes to the right and towards a corner.
    attributes : mapping
        Made-up attributes: age, sex, hair, glasses, skin.
    """

    face: Face
    person: SimulatedPerson
    appearance: Appearance
    hair: Hair | None
    glasses: tuple[Prop, Prop] | None
    torso: Prop
    wall_mm: float
    wall_tilt: float
    wall_shades: tuple[float, float]
    attributes: Mapping[str, str | int | float | bool] = field(default_factory=dict)


def simulate_capture_subject(
    face: Face,
    rng: np.random.Generator,
    *,
    appearance: Appearance | None = None,
    hair: bool | None = None,
    glasses: bool | None = None,
) -> SimulatedCaptureSubject:
    """Draw a person with an appearance, mostly with hair, sometimes with glasses, and clothes.

    Parameters
    ----------
    face : Face
        All parts of it.
    rng : numpy.random.Generator
        Source of randomness.
    appearance : Appearance, optional
        Drawn where absent.
    hair, glasses : bool, optional
        Drawn where absent.
    """
    person = simulate_person(face, rng)
    look = sample_appearance(rng) if appearance is None else appearance
    with_hair = bool(rng.random() < HAIR_SHARE) if hair is None else hair
    with_glasses = bool(rng.random() < GLASSES_SHARE) if glasses is None else glasses
    tone = float(np.mean(look.skin))
    return SimulatedCaptureSubject(
        face,
        person,
        look,
        make_hair(face, look.hair, look.skin, rng) if with_hair else None,
        make_glasses(face, person.neutral, rng) if with_glasses else None,
        make_torso(face, person.neutral, rng),
        float(rng.uniform(1100.0, 1900.0)),
        float(rng.normal(0.0, 0.12)),
        (float(rng.normal(0.0, 0.35)), float(rng.normal(0.0, 0.2))),
        {
            "age": int(rng.integers(18, 76)),
            "sex": str(rng.choice(["female", "male"])),
            "hair": "full" if with_hair else ("short" if look.hair_density > 0 else "none"),
            "glasses": with_glasses,
            "skin": "light" if tone > 0.68 else ("medium" if tone > 0.45 else "dark"),
            "simulated": True,
        },
    )
