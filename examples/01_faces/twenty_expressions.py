"""The built-in face acting the 20 expressions of FaceWarehouse 3.1: docs/images/twenty_expressions.png."""

import argparse
from pathlib import Path

from facewright.apps.show_face import ShowFaceRequest, show_face


def main(out: Path) -> None:
    """Draw the mean face with each named expression."""
    show_face(ShowFaceRequest("builtin", out / "twenty_expressions.png", size=(220, 180)))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    main(parser.parse_args().out)
