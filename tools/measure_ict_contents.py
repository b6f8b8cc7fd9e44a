"""Measure the fingerprint that `facewright faces install ict` checks: python measure_ict_contents.py COMPACT.npz."""

import json
import sys
from pathlib import Path

from facewright.faces.ict import read_compact_arrays
from facewright.faces.ict_archive import EXPRESSIONS, canonical_sha256, signed_sums

OUT = Path(__file__).parents[1] / "src/facewright/faces/data/ict_contents.json"

arrays = read_compact_arrays(Path(sys.argv[1]))
shapes = {f"identity{i:03d}": mode for i, mode in enumerate(arrays["identity_modes"])}
names = [str(name) for name in arrays["expression_names"]]
shapes |= {name: arrays["expression_deltas"][names.index(name)] for name in EXPRESSIONS}
content = {
    "about": "What ICT-FaceKit's arrays must be (mm): SHA-256 of polygons, and of the neutral and texture coordinates "
    "at six significant digits; four signed sums of each shape. Written by tools/measure_ict_contents.py.",
    "sha256": {name: canonical_sha256(arrays[name]) for name in ("vertices", "faces", "uv", "uv_faces")},
    "signed_sums": {name: [round(float(v), 3) for v in signed_sums(delta)] for name, delta in shapes.items()},
}
lines = json.dumps(content, indent=1).replace("\n   ", " ").replace("\n  ]", "]")
OUT.write_text(lines + "\n", encoding="utf-8")
