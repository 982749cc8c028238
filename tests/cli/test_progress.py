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
    assert lines[0] == "esd: counting: 2 of 3, 0 s"
    assert lines[-1] == "esd: waiting: 0 s"
