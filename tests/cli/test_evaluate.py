import json


def test_from_training_to_a_map_and_its_error(run, shapes, tmp_path):
    model, output = tmp_path / "m", tmp_path / "map.csv"
    run(
        "train",
        shapes,
        "-o",
        model,
        "--preset",
        "paper-hks",
        "--steps",
        600,
        "--include",
        "*[0-2]0",
    )
    done = run(
        "match",
        shapes / "tr_reg_000.off",
        shapes / "tr_reg_030.off",
        "-o",
        output,
        "-m",
        model,
        "--json",
    )
    summary = json.loads(done.stdout)
    assert summary["matched"] == 384
    rows = output.read_text().splitlines()
    assert rows[0] == "source,target,distance,confidence"
    assert len(rows) == 385
    pairs = tmp_path / "pairs.tsv"
    pairs.write_text("tr_reg_000\ttr_reg_030\n")
    trained = json.loads(
        run("evaluate", shapes, "--model", model, "--pairs", pairs, "--no-refine", "--json").stdout
    )
    assert trained["pairs"] == 1
    everything = json.loads(run("evaluate", shapes, "--model", "wks", "--json").stdout)
    assert everything["pairs"] == 12
    promised = (
        "mean_geodesic_error_x100 median_geodesic_error_x100 accuracy_5pct_diameter auc coverage"
    )
    assert {*promised.split(), "pairs", "seconds"} <= set(trained)
    assert "600 steps" in run("model", "show", model).stdout
    assert "hks (raw descriptor)" in run("model", "list").stdout


def test_several_models_are_compared_in_one_figure(run, shapes, tmp_path):
    model, plot = tmp_path / "metric", tmp_path / "curves.png"
    done = run("train", shapes, "-o", model, "--preset", "osd", "--include", "*[0-2]0")
    assert "trained 400 steps on 3 shapes" in done.stdout
    arguments = ("evaluate", shapes, "--include", "*[23]0", "-m", model, "-m", "hks")
    found = json.loads(run(*arguments, "--plot", plot, "--json").stdout)
    assert list(found) == ["models"]
    assert [each["model"] for each in found["models"]] == ["metric", "hks"]
    alone = json.loads(run(*arguments[:4], "-m", "hks", "--json").stdout)
    for key in ("data", "pairs", "auc", "mean_geodesic_error_x100"):
        assert alone[key] == found["models"][1][key]
    assert plot.stat().st_size > 10_000
    lines = run(*arguments, "--plot", plot, "--force").stdout.splitlines()
    assert lines[1].split() == ["model", "metric", "hks"]
    assert lines[-1] == f"drawn to {plot}"
    assert "--force" in run(*arguments, "--plot", plot, expect=1).stderr
    assert ".png, .pdf or .svg" in run(*arguments, "--plot", tmp_path / "a.txt", expect=1).stderr
    within = run(*arguments, "--plot", plot / "a.png", expect=1).stderr
    assert "is a file, not a folder" in within
