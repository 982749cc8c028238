from pathlib import Path

import pytest

pytest.importorskip("starlette", reason="the extra 'studio' is not installed")


@pytest.fixture
def served(monkeypatch):
    """What `serve` was called with; it says that it listens, and ends."""
    calls = []

    def serve(folder, *, shapes, port, on_start):
        calls.append((folder, list(shapes), port))
        on_start("http://127.0.0.1:1/token/")

    opened = []
    monkeypatch.setattr("esd.studio.serve.serve", serve)
    monkeypatch.setattr("typer.launch", opened.append)
    return calls, opened


def test_the_address_is_printed_and_opened(run_here, served, tmp_path):
    calls, opened = served
    said = run_here("studio", "a.off", "b.off", "--port", 8765, where=tmp_path).stdout
    [(folder, shapes, port)] = calls
    assert folder == tmp_path / "studio"
    assert [shape.name for shape in shapes] == ["a.off", "b.off"]
    assert port == 8765
    assert opened == ["http://127.0.0.1:1/token/"]
    assert "The studio is at http://127.0.0.1:1/token/" in said
    assert "Everything is kept in" in said


def test_a_project_is_resumed_without_a_browser(run_here, served, tmp_path):
    calls, opened = served
    run_here("studio", "--project", "mine", "--no-browser", where=tmp_path)
    assert calls == [(Path("mine"), [], 0)]
    assert opened == []
