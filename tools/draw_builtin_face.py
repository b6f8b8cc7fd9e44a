"""Draw the pictures of the built-in face in docs/images: views, expressions, people, cage and atlas."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from facewright.faces import load_face
from facewright.faces.appearance import Appearance, albedo_function, sample_appearance, vertex_gloss, visible_faces
from facewright.faces.blendshape_names import BLENDSHAPE_NAMES
from facewright.imaging.portrait import portrait_view, render_portrait
from facewright.imaging.render import Lights

OUT = Path(__file__).parents[1] / "docs/images"
FACE = load_face("builtin")
TRIANGLES = visible_faces(FACE)
EXPRESSIONS = (
    {},
    {"mouthSmile": 0.9, "cheekSquint": 0.6},
    {"mouthSmile": 0.8, "mouthUpperUp": 0.7, "mouthLowerDown": 0.5, "cheekSquint": 0.6},
    {"jawOpen": 0.8, "browInnerUp": 0.6, "eyeWide": 0.6},
    {"eyeBlink": 1.0},
    {"mouthPucker": 1.0},
    {"browDown": 1.0, "noseSneer": 0.6, "mouthFrown": 0.4},
    {"eyeBlink_L": 1.0, "mouthSmile_L": 0.8, "browOuterUp_R": 0.8},
)


def posed(shape: np.ndarray, weights: dict[str, float]) -> np.ndarray:
    out = shape.astype(np.float64)
    for name, weight in weights.items():
        for k, other in enumerate(BLENDSHAPE_NAMES):
            if other == name or other in (name + "_L", name + "_R"):
                out = out + weight * FACE.blendshape_deltas[k]
    return out


def portrait(shape: np.ndarray, look: Appearance | None, size: tuple[int, int], **view: float) -> np.ndarray:
    albedo = None if look is None else albedo_function(FACE, look, TRIANGLES)
    lights, gloss = None, np.float64(0.12)
    if look is not None:
        gloss = vertex_gloss(FACE)
        lights = Lights(look.light_directions, look.light_colours, look.sky, look.ground)
    return render_portrait(
        shape, TRIANGLES, size, albedo=albedo, lights=lights, supersample=3, shininess=gloss, **view
    ).image


def sheet(pictures: list[np.ndarray], columns: int, name: str, colours: int = 0) -> None:
    rows = [np.concatenate(pictures[i : i + columns], axis=1) for i in range(0, len(pictures), columns)]
    path = OUT / name
    image = Image.fromarray(np.concatenate(rows))
    (image.quantize(colours) if colours else image).save(path, optimize=True)
    print(f"{path.name}: {path.stat().st_size / 1000:.0f} kB")


def wireframe(size: tuple[int, int], **view: float) -> np.ndarray:
    """Plaster with all polygons drawn over it: quads, and the triangles where two levels of detail meet."""
    picture = portrait(FACE.mean_shape, None, size, **view)
    big = 3
    image = Image.fromarray(picture).resize((size[1] * big, size[0] * big), Image.Resampling.BICUBIC)
    camera, _ = portrait_view(FACE.mean_shape, size, **view)
    _, pixels = portrait_view(FACE.mean_shape, (size[0] * big, size[1] * big), **view)
    quads = FACE.topology.quads
    quads = quads[(quads < FACE.n_skin).all(axis=1)]
    a, b, c, d = (camera[np.where(quads[:, k] >= 0, quads[:, k], quads[:, 2])] for k in range(4))
    facing = np.einsum("nc,nc->n", np.cross(c - a, np.where(quads[:, 3:] >= 0, d, c) - b), a) < 0
    draw = ImageDraw.Draw(image)
    for quad in quads[facing]:
        draw.polygon([tuple(p) for p in pixels[quad[quad >= 0]]], outline=(52, 84, 132))
    return np.array(image.resize((size[1], size[0]), Image.Resampling.LANCZOS))


def main() -> None:
    OUT.mkdir(parents=True, exist_ok=True)
    look = sample_appearance(np.random.default_rng(3))
    centre, size = {"centre_mm": (0.0, 8.0, 20.0), "height_mm": 295.0}, (400, 330)
    views = [portrait(FACE.mean_shape, look, size, yaw_degrees=y, **centre) for y in (0, 40, 85)]
    sheet(views, 3, "builtin_views.png")
    sheet([wireframe(size, yaw_degrees=y, **centre) for y in (0, 40, 85)], 3, "builtin_mesh.png", 128)
    close = {"centre_mm": (0.0, 0.0, 60.0), "height_mm": 215.0}
    sheet([portrait(posed(FACE.mean_shape, e), look, (310, 250), **close) for e in EXPRESSIONS], 4,
          "builtin_expressions.png")  # fmt: skip
    rng, people = np.random.default_rng(12), []
    for _ in range(8):
        shape = FACE.mean_shape + np.tensordot(rng.normal(size=len(FACE.identity_basis)), FACE.identity_basis, 1)
        people.append(portrait(shape, sample_appearance(rng), (290, 250), yaw_degrees=rng.uniform(-25, 25), **centre))
    sheet(people, 4, "builtin_people.png")


if __name__ == "__main__":
    main()
