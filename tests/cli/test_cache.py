import re


def test_the_cache_is_shown_and_cleared(run_here, shapes, monkeypatch):
    run_here("spectrum", "tr_reg_000.off", "-k", 20, where=shapes)
    assert re.search(r"\b[1-9]\d* entries", run_here("cache", where=shapes).stdout)
    assert " 0 entries" in run_here("cache", "--clear", where=shapes).stdout
    assert " 0 entries" in run_here("cache", where=shapes).stdout
    monkeypatch.setenv("ESD_CACHE", "off")
    assert run_here("cache", where=shapes).stdout == "The cache is off (ESD_CACHE=off).\n"
