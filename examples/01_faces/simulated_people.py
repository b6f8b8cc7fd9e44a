"""Simulated people with appearances and expressions of their own: docs/images/simulated_people.png."""

import argparse
from pathlib import Path

from facewright.apps.demo_pictures import people_sheet
from facewright.faces import load_face
from facewright.io.image import write_image


def main(out: Path) -> None:
    """Draw ten people."""
    write_image(out / "simulated_people.png", people_sheet(load_face("builtin"), seed=5, n=10))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    main(parser.parse_args().out)
