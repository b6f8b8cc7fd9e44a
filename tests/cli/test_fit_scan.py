import json

import numpy as np

from facewright.io.ply import write_ply


def test_a_scan_is_fitted_and_told_as_json(builtin_face, invoke, tmp_path):
    face = builtin_face.skin()
    scan = 0.001 * face.mean_shape.astype(np.float64) @ np.diag([-1.0, 1.0, -1.0])  # metres, turned round
    write_ply(tmp_path / "head.ply", scan, face.topology.faces)
    np.savetxt(tmp_path / "marks.csv", scan[face.topology.landmarks["fw74"]], delimiter=",")
    args = (tmp_path / "head.ply", "-o", tmp_path / "out", "--landmarks", tmp_path / "marks.csv", "--json")
    result = invoke("fit-scan", *args)
    assert result.exit_code == 0, result.output
    payload = json.loads(result.stdout)
    assert payload["unit"] == "m"
    assert payload["residuals"]["stage2_rms_mm"] < 0.3
    assert (tmp_path / "out" / "face.obj").is_file()


def test_what_is_no_scan_is_refused(refused, tmp_path):
    (tmp_path / "a.obj").write_text("v 0 0 0\n")
    assert "without triangles" in refused("fit-scan", tmp_path / "a.obj", "-o", tmp_path / "out")
    assert "unit" in refused("fit-scan", tmp_path / "a.obj", "--unit", "ell")
    assert not (tmp_path / "out").exists()
