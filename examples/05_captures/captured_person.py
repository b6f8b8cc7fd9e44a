"""From recordings to a person: docs/images/captured_captures.png, captured_expressions.png, captured_blendshapes.png.

Needs the extras capture and warehouse and the landmarks extra.
"""

import argparse
import tempfile
from pathlib import Path

from facewright.apps.simulate_captures import SimulateCapturesRequest, simulate_captures
from facewright.apps.subject_pictures import subject_sheets
from facewright.capture.captures import list_captures
from facewright.capture.recording import open_recording
from facewright.faces import load_face
from facewright.io.image import write_image
from facewright.warehouse.process_subject import ProcessOptions, process_subject


def main(out: Path, n_frames: int = 20) -> None:
    """Record a simulated person, process the recordings, and draw what came out beside what went in."""
    with tempfile.TemporaryDirectory() as folder:
        simulate_captures(SimulateCapturesRequest(Path(folder), 1, "builtin", n_frames, seed=2))
        (capture,) = list_captures(Path(folder))
        subject = process_subject(capture, ProcessOptions(face="builtin"))
        references = subject.provenance["expressions"]
        raw = {
            name: open_recording(capture.recordings[name]).frame(int(references[name]["reference_frame"])).depth
            for name in subject.expressions
        }
    for name, sheet in subject_sheets(load_face("builtin"), subject, raw, size=280).items():
        write_image(out / f"captured_{name}.png", sheet)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/images"))
    main(parser.parse_args().out)
