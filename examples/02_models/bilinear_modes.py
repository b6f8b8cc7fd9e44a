"""Build a bilinear model of 40 people and draw its leading modes: docs/images/bilinear_modes.png."""

import argparse
import tempfile
from pathlib import Path

from facewright.apps.build_model import BuildModelRequest, build_model
from facewright.apps.explore_model import ExploreRequest, explore_model


def main(out: Path, n_people: int = 40) -> None:
    """Build, report the error on unseen people, draw."""
    with tempfile.TemporaryDirectory() as folder:
        request = BuildModelRequest(Path(folder) / "model.fwbm", "builtin", n_people, min(30, n_people), 47)
        built = build_model(request)
        print(f"{n_people} people, {built.n_bytes / 1e6:.1f} MB, {built.unseen_rms_mm:.2f} mm on unseen people")
        explore_model(ExploreRequest(built.model, out / "bilinear_modes.png", n_modes=3, size=(200, 172)))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    main(parser.parse_args().out)
