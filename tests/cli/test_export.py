import numpy as np

from esd.matching.correspondence import load_map
from esd.mesh.io.meshes import read_arrays, read_mesh


def test_export_keeps_matches_and_changes_formats(run_here, pair):
    run_here("export", "a.off", "b.off", "map.csv", "--truth", "map.csv", "-o", "a.ply", where=pair)
    assert b"property int target\n" in (pair / "a.ply").read_bytes()
    assert b"property float error\n" in (pair / "a.ply").read_bytes()
    run_here("export", "a.off", "b.off", "map.csv", "-o", "m.vts", where=pair)
    match = load_map(pair / "m.vts", source_count=96, target_count=384)
    np.testing.assert_array_equal(match.target_index, np.arange(96))


def test_points_are_exported_and_take_labels(run_here, pair):
    np.savetxt(pair / "p.xyz", read_mesh(pair / "a.off").vertices)
    for name in ("p.ply", "p.vtp", "p.npy"):
        run_here("export", "p.xyz", "b.off", "map.csv", "-o", name, where=pair)
    assert b"property int target\n" in (pair / "p.ply").read_bytes()
    assert len(read_arrays(pair / "p.ply")[0]) == 96
    (pair / "labels.txt").write_text("one\n" * 96)
    run_here("transfer", "p.xyz", "b.off", "map.csv", "--labels", "labels.txt", where=pair)
    assert (pair / "b-labels.txt").read_text() == "one\n" * 384
    truth = ("--truth", "map.csv", "-o", "e.ply")
    done = run_here("export", "b.off", "p.xyz", "map.csv", *truth, where=pair, expect=1)
    assert "maps 96 vertices" in done.stderr
    done = run_here("export", "a.off", "p.xyz", "map.csv", *truth, where=pair, expect=1)
    assert "Errors are measured along the faces of the target" in done.stderr
