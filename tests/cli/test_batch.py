def test_where_all_pairs_fail_no_other_map_is_mentioned(run_here, tmp_path):
    (tmp_path / "pairs.csv").write_text("Source;Target\nno.off;none.off\n")
    done = run_here("batch", "pairs.csv", "-m", "hks", "--workers", 1, expect=1, where=tmp_path)
    assert "There is no file" in done.stdout
    assert done.stderr == "esd: 1 of 1 pairs failed.\n"


def test_a_batch_of_pairs(run, shapes, tmp_path):
    pairs = shapes / "pairs.csv"
    pairs.write_text("source,target\ntr_reg_000.off,tr_reg_010.off\ntr_reg_010.off,no.off\n")
    done = run("batch", pairs, "-m", "hks", "-o", tmp_path, "--workers", 2, expect=1)
    assert "no.off" in done.stdout
    assert "1 of 2 pairs matched" in done.stdout
    assert done.stderr == "esd: 1 of 2 pairs failed; the other maps are written.\n"
    assert len((tmp_path / "tr_reg_000-tr_reg_010.csv").read_text().splitlines()) == 385
    assert "--force" in run("batch", pairs, "-o", tmp_path, expect=1).stderr
    run("batch", pairs, "--view", expect=2)
    run("match", "a.off", "b.off", "--scheduler", "tcp://x", expect=2)
