import os
import sys

import pytest


def test_view_writes_a_page_with_the_error(run_here, pair):
    run_here("view", "a.off", "b.off", "map.csv", where=pair)
    assert '["error", "f4"' not in (pair / "a-b.html").read_text()
    run_here("view", "a.off", "b.off", "map.csv", "--truth", "map.csv", "-o", "t.html", where=pair)
    points = ("--points", "a.vts", "b.vts")
    run_here("view", "a.off", "b.off", "map.csv", *points, "-o", "p.html", where=pair)
    assert (pair / "t.html").read_text() == (pair / "p.html").read_text()
    assert '["error", "f4"' in (pair / "p.html").read_text()
    done = run_here("view", "a.off", "b.off", "map.csv", *points, "--truth", "map.csv", "-o", "q.html", where=pair, expect=2)  # fmt: skip
    assert "--truth or --points, not both" in done.stderr
    (pair / "b.vts").write_text("1\n2\n")
    done = run_here(
        "view", "a.off", "b.off", "map.csv", *points, "-o", "q.html", where=pair, expect=1
    )
    assert "must have the same points; one has 96" in done.stderr


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has such names")
def test_names_that_are_no_text_are_shown(run_here, pair):
    odd = os.fsdecode(b"a\xff.off")
    (pair / odd).write_bytes((pair / "a.off").read_bytes())
    run_here("view", odd, "b.off", "map.csv", "-o", "odd.html", where=pair)
    assert "a\N{REPLACEMENT CHARACTER}.off" in (pair / "odd.html").read_text()
