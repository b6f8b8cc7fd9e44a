"""Carry a mouth and eyes from one photo to another: docs/images/transfer_astronaut.png. Needs the landmarks extra.

The second photo is made from the first, with another expression, turned and darker: so both show one person.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np

from facewright.apps.build_model import BuildModelRequest, build_model
from facewright.apps.default_model import default_model
from facewright.apps.demo import astronaut_portrait
from facewright.apps.photo_subject import open_photo_subject
from facewright.apps.transfer_component import TransferRequest, transfer_component
from facewright.camera.pinhole import RigidMotion
from facewright.camera.rotation import FRONTAL, rotation_from_head_angles
from facewright.faces.expressions import expression_weights
from facewright.imaging.contact_sheet import contact_sheet
from facewright.io.image import write_image
from facewright.models.bilinear_store import load_bilinear

HEAD = (slice(10, 230), slice(122, 332))


def second_photo(model: Path | None) -> np.ndarray:
    """Return the portrait with rounded lips and closed eyes, turned by 8 degrees and a third darker."""
    subject = open_photo_subject(astronaut_portrait(), default_model() if model is None else load_bilinear(model))
    pose = subject.camera_from_model
    turn = pose.rotation @ FRONTAL.T @ rotation_from_head_angles(8.0, 0.0, 0.0) @ pose.rotation.T
    weights = np.maximum(expression_weights("lip_puckerer"), expression_weights("eyes_closed"))
    view = subject.view(subject.vertices(weights=weights), RigidMotion(turn @ pose.rotation, pose.translation))
    return (subject.synthesiser.draw(view).image * 0.67).astype(np.uint8)


def main(out: Path, n_people: int | None = None) -> None:
    """Make the second photo, then carry components of it over."""
    with tempfile.TemporaryDirectory() as name:
        model = None
        if n_people is not None:
            model = Path(name, "small.fwbm")
            build_model(BuildModelRequest(model, "builtin", n_people, n_people, 47, n_unseen=0))
        target, reference, result = Path(name, "a.png"), Path(name, "b.png"), Path(name, "c.png")
        write_image(target, astronaut_portrait())
        other = second_photo(model)
        write_image(reference, other)
        pictures = [astronaut_portrait()[HEAD], other[HEAD]]
        for component in ("mouth", "eyes", "face"):
            transfer = transfer_component(TransferRequest(target, reference, component, result, model=model))
            pictures.append(transfer.image[HEAD])
    captions = ["target", "reference", "its mouth", "its eyes", "its face"]
    write_image(out / "transfer_astronaut.png", contact_sheet(pictures, captions, columns=5))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    main(parser.parse_args().out)
