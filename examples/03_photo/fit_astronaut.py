"""Fit the astronaut portrait and act new expressions: docs/images/fit_astronaut*.png. Needs the landmarks extra."""

import argparse
import tempfile
from pathlib import Path

from facewright.apps.build_model import BuildModelRequest, build_model
from facewright.apps.demo import astronaut_portrait
from facewright.apps.demo_pictures import fit_pictures, person_painter, person_texture
from facewright.faces import load_face
from facewright.faces.expressions import expression_weights
from facewright.fitting.image import fit_photo
from facewright.imaging.contact_sheet import contact_sheet
from facewright.io.image import write_image
from facewright.landmarks.detector import open_detector


def main(out: Path, n_people: int = 60) -> None:
    """Build a model, detect, fit, draw."""
    photo = astronaut_portrait()
    landmarks = open_detector().detect(photo)[0]
    with tempfile.TemporaryDirectory() as folder:
        request = BuildModelRequest(Path(folder) / "m.fwbm", "builtin", n_people, min(40, n_people), 47, n_unseen=0)
        model = build_model(request).model
    fit = fit_photo(model, landmarks, photo.shape[:2])
    print(f"landmarks off by {100 * fit.reprojection_iod:.2f} % of the inter-ocular distance")
    write_image(out / "fit_astronaut.png", contact_sheet(fit_pictures(photo, fit, fit.landmarks.points), columns=3))
    draw = person_painter(load_face("builtin"), fit, person_texture(photo, fit), (300, 260))
    acts = ("neutral", "smile", "mouth_stretch", "anger", "eyes_closed")
    pictures = [draw(fit.rig.pose(expression_weights(act))) for act in acts]
    write_image(out / "fit_astronaut_expressions.png", contact_sheet(pictures, [a.replace("_", " ") for a in acts]))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    main(parser.parse_args().out)
