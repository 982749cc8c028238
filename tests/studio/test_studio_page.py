import os
import re
import signal
import subprocess
import sys

import pytest

pytest.importorskip("starlette", reason="the extra 'studio' is not installed")
pytest.importorskip("uvicorn", reason="the extra 'studio' is not installed")

from esd.mesh.io.meshes import write_mesh
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import subdivide, torus


@pytest.fixture
def start(tmp_path):
    """Start the studio on a project; the process and its address."""
    started = []

    def run():
        command = [sys.executable, "-m", "esd", "studio", "--no-browser", "--project", "p"]
        process = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, text=True)
        started.append(process)
        return process, re.search(r"http://\S+", process.stdout.readline())[0]

    yield run
    for process in started:
        process.kill()
        process.wait()
        process.stdout.close()


@pytest.fixture
def files(tmp_path):
    """Two closed surfaces without symmetry; the name of one is HTML."""
    mesh = subdivide(torus(32, 16))
    x, y, z = mesh.vertices.T
    paths = []
    for name, scale in (("<img src=x onerror=alert(1)>.off", 1.0), ("b.off", 1.1)):
        bent = mesh.vertices * (1 + 0.3 * x + 0.2 * y * z)[:, None] * [1, 1, scale]
        write_mesh(Mesh(bent, mesh.faces), tmp_path / name)
        paths.append(tmp_path / name)
    return paths


def test_from_files_to_a_corrected_map_that_survives_a_kill(browser, start, files):
    playwright = pytest.importorskip("playwright.sync_api")
    process, address = start()
    tab = browser.new_context(viewport={"width": 1400, "height": 800}).new_page()
    complaints = []
    tab.on("console", lambda message: complaints.append(message.text))
    tab.on("pageerror", lambda error: complaints.append(str(error)))
    tab.goto(address)
    tab.set_input_files("#files", files)
    tab.wait_for_selector("html[data-shown^=map]", timeout=120_000)
    assert "<img src=x" in tab.inner_text("#shapes")
    assert tab.is_visible("#verdict")

    # the target is turned onto the source: the same places lie half the width to the right
    tab.click("#landmark-add")
    box = tab.locator("#view").bounding_box()
    for share in (0.06, 0.14, 0.36, 0.42):  # of the width: the torus has a hole in the middle
        for side in (0, 0.5):
            tab.mouse.click(box["x"] + (side + share) * box["width"], box["y"] + box["height"] / 2)
    landmarks = tab.locator("#landmark-list li")
    count = -1
    while count != landmarks.count():  # the list follows the clicks with some delay
        count = landmarks.count()
        tab.wait_for_timeout(1000)
    tab.keyboard.press("Escape")
    assert count >= 3
    tab.click("#landmark-undo")
    playwright.expect(landmarks).to_have_count(count - 1)
    tab.click("#landmark-redo")
    playwright.expect(landmarks).to_have_count(count)
    before = tab.get_attribute("html", "data-shown")
    tab.click("#rematch")
    tab.wait_for_function(
        "(before) => document.documentElement.dataset.shown !== before", arg=before, timeout=120_000
    )
    with tab.expect_download() as saved:
        tab.click("#export-map")
    assert saved.value.path().read_text().startswith("source,target")
    assert complaints == []
    tab.close()

    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    again = browser.new_context().new_page()
    again.goto(start()[1])
    again.wait_for_selector("html[data-shown^=map]", timeout=60_000)
    assert again.locator("#landmark-list li").count() == count
