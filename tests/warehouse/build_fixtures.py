"""What the tests of builds share: captures of nothing in particular, options, contents of a database."""

from pathlib import Path

import fake_process
import numpy as np

from facewright.camera.pinhole import Intrinsics
from facewright.capture.captures import SubjectCapture
from facewright.mesh.topology import Topology
from facewright.warehouse.process_subject import ProcessOptions
from facewright.warehouse.store import Warehouse

OPTIONS = ProcessOptions(face="tiny")


def tiny_topology(name="tiny", n_vertices=fake_process.TINY):
    """A strip of triangles with as many vertices as the fake process makes."""
    first = np.arange(n_vertices - 2, dtype=np.int32)
    return Topology(name, n_vertices, np.stack([first, first + 1, first + 2], axis=1))


def captures_of(*names, notes=None, **problems):
    """Captures that only the fake process can use; it leaves a file for each attempt in `notes`."""
    attributes = {"notes": str(notes)} if notes else {}
    captures = []
    for name in names:
        path = Path("/nowhere") / name
        problem = (problems[name],) if name in problems else ()
        captures.append(SubjectCapture(name, path, attributes, {"neutral": path / "neutral"}, problem))
    return captures


def contents(warehouse):
    """Digest of each subject."""
    warehouse = warehouse if isinstance(warehouse, Warehouse) else Warehouse.open(warehouse)
    return {name: warehouse.digest(name) for name in warehouse.subject_names()}


def read_everything(url):
    """Read every array of every subject, which compares it with its checksum."""
    warehouse = Warehouse.open(url)
    return {name: warehouse.read_subject(name) for name in warehouse.subject_names()}


def write_captures(root, *names, expressions=("neutral",)):
    """Write folders that are listed as captures: recordings of one small frame."""
    from facewright.capture.frame import RGBDFrame
    from facewright.capture.tum_writer import write_tum_recording

    for name in names:
        for expression in expressions:
            folder = Path(root) / name / expression
            folder.parent.mkdir(parents=True, exist_ok=True)
            color = np.zeros((6, 8, 3), np.uint8)
            depth = np.full((6, 8), 600.0, np.float32)
            intrinsics = Intrinsics(5.0, 5.0, 3.5, 2.5)
            write_tum_recording(folder, [RGBDFrame(color, depth, intrinsics, 0.0)])
    return Path(root)
