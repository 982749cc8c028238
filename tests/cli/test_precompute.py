import json


def test_a_store_is_made_trained_on_and_brought_up_to_date(run, shapes, tmp_path):
    store = tmp_path / "s.h5"
    made = ("precompute", shapes, "-o", store, "--preset", "paper-gps", "--workers", 2)
    assert "4 shapes computed, 0 unchanged" in run(*made).stdout
    printed = json.loads(run(*made, "--json").stdout)
    assert (printed["computed"], printed["unchanged"], printed["failed"]) == (0, 4, {})
    trained = ("train", store, "--preset", "paper-gps", "--steps", 5, "--include", "*[0-2]0")
    assert "5 steps on 3 shapes" in run(*trained, "-o", tmp_path / "m").stdout
    done = run("train", store, "--preset", "paper-hks", "-o", tmp_path / "n", expect=1)
    assert "does not hold what this training takes" in done.stderr
    assert "holds no meshes" in run("evaluate", store, expect=1).stderr
    assert "another recipe" in run(*made[:-3], "paper-hks", expect=1).stderr
    assert (
        "is a store already" in run("precompute", store, "-o", tmp_path / "t.h5", expect=1).stderr
    )
    for wrong, message in (
        (("-m", "hks"), "--preset or --model"),
        (("--scheduler", "tcp://x"), "--workers or --scheduler"),
    ):
        assert message in run(*made, *wrong, expect=2).stderr
    done = run("precompute", shapes, "-o", tmp_path / "s.zarr", expect=1)
    assert "stores are written to .h5" in done.stderr


def test_shapes_that_fail_are_listed(run, shapes, tmp_path):
    (shapes / "corres").mkdir()
    for file in shapes.glob("*.off"):
        (shapes / "corres" / f"{file.stem}.vts").write_text("1\n2\n3\n")
    (shapes / "tr_reg_010.off").write_text("OFF\n")
    store = tmp_path / "s.h5"
    done = run("precompute", shapes, "-o", store, "-m", "gps", "--workers", 1, expect=1)
    assert done.stdout.startswith("tr_reg_010\t")
    assert "3 shapes computed" in done.stdout
    assert done.stderr.count("\n") == 1
    assert "1 of 4 shapes failed" in done.stderr
    again = run("precompute", shapes, "-o", store, "-m", "gps", "--json", expect=1)
    assert list(json.loads(again.stdout)["failed"]) == ["tr_reg_010"]
