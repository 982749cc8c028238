import time

import esd.cli.progress as progress


def test_where_there_is_no_terminal_progress_is_a_line_now_and_then(monkeypatch, capsys):
    monkeypatch.setattr(progress, "SILENCE", 0.05)
    with progress.progress("counting", 3) as advance:
        advance(2)
        time.sleep(0.2)
    with progress.progress("waiting"):
        time.sleep(0.2)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "esd: counting: 2 of 3, 0 s, about 0 s left"
    assert lines[-1] == "esd: waiting: 0 s"


def test_the_step_whose_turn_it_is_reports(monkeypatch, capsys):
    monkeypatch.setattr(progress, "SILENCE", 0.05)
    with progress.progress("describing", 2) as described, progress.progress("training", 9) as done:
        time.sleep(0.2)
        assert "training" not in capsys.readouterr().err
        described(2)
        time.sleep(0.2)
        capsys.readouterr()
        done(1)
        time.sleep(0.2)
    lines = capsys.readouterr().err.splitlines()
    assert lines
    assert all(line.startswith("esd: training: 1 of 9, 0 s") for line in lines)


def test_of_nothing_to_do_nothing_is_shown(monkeypatch, capsys):
    monkeypatch.setattr(progress, "SILENCE", 0.05)
    with progress.progress("describing", 0):
        time.sleep(0.2)
    assert capsys.readouterr().err == ""
