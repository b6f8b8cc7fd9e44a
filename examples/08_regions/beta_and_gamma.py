"""One dragged point under several beta and gamma: docs/images/beta_and_gamma.png (RB Fig. 2).

Above every region by itself, a colour each; below one face, its boundaries averaged, the redder the more it moved.
Grey: where the corner of the mouth shall go; black: where it is.
"""

import argparse
from pathlib import Path

import numpy as np

from facewright.apps.default_region_model import default_region_models
from facewright.apps.region_pictures import region_colours
from facewright.imaging.contact_sheet import contact_sheet
from facewright.imaging.overlay import draw_points
from facewright.imaging.portrait import portrait_view, render_portrait
from facewright.io.image import write_image
from facewright.models.region_model import RegionModel
from facewright.models.region_poser import RegionPoser

WEIGHTS = ((0.0, 0.025), (0.05, 0.025), (0.5, 0.025), (10.0, 0.025), (0.5, 0.001), (0.5, 0.5))  # beta, gamma
CORNER, MOVE = (28.0, -36.0, 100.0), (8.0, 9.0, -1.0)  # of the mouth, the person's left; mm
GREY, RED = np.array([0.76, 0.76, 0.76]), np.array([0.86, 0.20, 0.14])
MOST_MM = 8.0  # of a motion, full red
SIZE, VIEW = (260, 210), {"height_mm": 200.0, "centre_mm": (0.0, 8.0, 60.0)}


def main(out: Path) -> None:
    """Solve eq. 9 with each pair of weights, draw before and after blending."""
    model = default_region_models().region
    vertex = int(np.argmin(np.linalg.norm(model.neutral - CORNER, axis=1)))
    target = model.neutral[vertex] + MOVE
    before, after, weights, gaps = [], [], [], []
    for beta, gamma in WEIGHTS:
        poser = RegionPoser(model, beta, gamma)
        poser.set_constraints([vertex])
        zeta = poser.solve(target[None], np.zeros(model.n_coefficients))
        posed = poser.positions(zeta)
        before.append(marked(draw(*pieces(model, poser.blend.copies(zeta))), target, posed[vertex]))
        share = np.clip(np.linalg.norm(posed - model.neutral, axis=1) / MOST_MM, 0.0, 1.0)[:, None]
        tint = (1.0 - share) * GREY + share * RED
        after.append(marked(draw(posed, model.faces, tint), target, posed[vertex]))
        found = poser.blend.gaps(zeta)
        weights.append(f"beta {beta:g}, gamma {gamma:g}")
        gaps.append(f"gaps {found.mean_mm:.2f} mm, most {found.max_mm:.1f}")
    sheet = contact_sheet([*before, *after], [*weights, *gaps], columns=len(WEIGHTS))
    write_image(out / "beta_and_gamma.png", sheet)


def pieces(model: RegionModel, copies: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return vertices, triangles and colours of all regions, each with its own copies of shared vertices."""
    vertices, triangles, start = [], [], 0
    colours = np.repeat(region_colours(len(model.bases)), [len(ids) for ids in model.regions.members], axis=0)
    for number, ids in enumerate(model.regions.members):
        place = np.full(model.n_vertices, -1)
        place[ids] = start + np.arange(len(ids))
        inside = place[model.faces]
        triangles.append(inside[(inside >= 0).all(axis=1)])
        lifted = model.neutral[ids] + copies[start : start + len(ids)]
        lifted[:, 2] += 0.02 * number  # mm: where two regions agree, one of them is seen
        vertices.append(lifted)
        start += len(ids)
    return np.concatenate(vertices), np.concatenate(triangles), colours


def draw(vertices: np.ndarray, triangles: np.ndarray, colours: np.ndarray) -> np.ndarray:
    """Draw a mesh with a colour for each vertex."""
    return render_portrait(vertices, triangles, SIZE, albedo=colours, shininess=0.0, **VIEW).image


def marked(picture: np.ndarray, target: np.ndarray, held: np.ndarray) -> np.ndarray:
    """Draw a target and the point that was pulled to it."""
    pixels = portrait_view(np.stack([target, held]), SIZE, **VIEW)[1]
    return draw_points(draw_points(picture, pixels[:1], (90, 90, 95), 4.0), pixels[1:], (15, 15, 18), 2.5)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    main(parser.parse_args().out)
