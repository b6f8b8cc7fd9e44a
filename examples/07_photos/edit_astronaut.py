"""Change attributes of the astronaut portrait: docs/images/edit_astronaut.png. Needs the landmarks extra."""

import argparse
import tempfile
from pathlib import Path

from facewright.apps.build_model import BuildModelRequest, build_model
from facewright.apps.demo import astronaut_portrait
from facewright.apps.edit_photo import EditRequest, edit_photo
from facewright.imaging.contact_sheet import contact_sheet
from facewright.io.image import write_image

EDITS = (
    {"face length": 2.0}, {"face width": 2.0}, {"mouth width": 2.0}, {"nose width": 2.0}, {"eye size": 2.0},
    {"face length": -2.0}, {"face width": -2.0}, {"mouth width": -2.0}, {"nose width": -2.0}, {"eye size": -2.0},
)  # fmt: skip
HEAD = (slice(10, 230), slice(122, 332))


def main(out: Path, n_people: int | None = None) -> None:
    """Edit one attribute at a time; the default model, or a small one of so many people."""
    with tempfile.TemporaryDirectory() as name:
        photo, model, result = Path(name, "portrait.png"), None, Path(name, "edited.png")
        write_image(photo, astronaut_portrait())
        if n_people is not None:
            model = Path(name, "small.fwbm")
            build_model(BuildModelRequest(model, "builtin", n_people, n_people, 47, n_unseen=0))
        pictures = []
        for changes in EDITS:
            edited = edit_photo(EditRequest(photo, changes, out=result, model=model))
            pictures.append(edited.image[HEAD])
    captions = [f"{attribute} {amount:+g} sd" for changes in EDITS for attribute, amount in changes.items()]
    half = len(EDITS) // 2
    for start in (half, 0):  # the photo itself stands before each row
        pictures.insert(start, astronaut_portrait()[HEAD])
        captions.insert(start, "the photo")
    write_image(out / "edit_astronaut.png", contact_sheet(pictures, captions, columns=half + 1))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    main(parser.parse_args().out)
