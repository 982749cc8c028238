"""The studio in a real browser: a server of its own, and what a tab shows of it."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from esd.mesh.io.meshes import write_mesh
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import subdivide, torus

DESKTOP = {"viewport": {"width": 1400, "height": 800}, "color_scheme": "light"}


def bent(scale: float = 1.0) -> Mesh:
    """A closed surface of 2,048 vertices; half a turn about x takes it to itself."""
    mesh = subdivide(torus(32, 16))
    x, y, z = mesh.vertices.T
    return Mesh(mesh.vertices * (1 + 0.3 * x + 0.2 * y * z)[:, None] * [1, 1, scale], mesh.faces)


def write_pair(folder: Path, names: tuple[str, str] = ("a.off", "b.off")) -> list[Path]:
    """Two such surfaces as files; vertex i of one belongs to vertex i of the other."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / name for name in names]
    for path, scale in zip(paths, (1.0, 1.1), strict=True):
        write_mesh(bent(scale), path)
    return paths


class Server:
    """`esd studio` on a project, which can be killed and started again."""

    def __init__(self, folder: Path, **options) -> None:
        self.folder = folder
        self._options = options
        self.start()

    def start(self) -> None:
        folder = self.folder
        command = [sys.executable, "-m", "esd", "studio", "--no-browser", "--project", str(folder)]
        self._process = subprocess.Popen(
            command, cwd=folder.parent, stdout=subprocess.PIPE, text=True, **self._options
        )
        self.address = re.search(r"http://\S+", self._process.stdout.readline())[0]

    def interrupt(self, *, times: int) -> str:
        """Press Ctrl-C; what is printed on standard error until it has ended."""
        for _ in range(times):
            self._process.send_signal(signal.SIGINT)
            time.sleep(0.05)
        return self._process.communicate(timeout=30)[1]

    def kill(self) -> None:
        os.kill(self._process.pid, signal.SIGKILL)
        self._process.wait()
        self._process.stdout.close()


class Tab:
    """The studio's page in a browser, and what the browser complained of."""

    def __init__(self, browser, address: str, **options) -> None:
        self.context = browser.new_context(**{**DESKTOP, **options})
        self.context.set_default_timeout(120_000)
        self.page = self.context.new_page()
        self.complaints: list[str] = []
        self.page.on("console", lambda message: self.complaints.append(message.text))
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.address = address
        self.page.goto(address)
        self.page.wait_for_selector("html[data-following]")

    def close(self) -> None:
        self.context.close()

    def ask(self, method: str, path: str, body: object = None) -> object:
        """What the server answers."""
        answer = self.page.request.fetch(
            self.address + path, method=method, data=None if body is None else json.dumps(body)
        )
        assert answer.ok, answer.text()
        return answer.json()

    def state(self) -> dict:
        return self.ask("GET", "state")

    def empty(self) -> None:
        """Remove all shapes."""
        for shape in self.state()["shapes"]:
            self.ask("DELETE", f"shapes/{shape['number']}")
        self.until(lambda: self.page.locator("#shapes > li").count() == 0)
        self.page.wait_for_selector("html:not([data-shown])")
        self.settle()
        self.complaints.clear()  # the page may just have asked for a shape that was removed

    def until(self, happened, seconds: float = 120) -> None:
        """Wait until something is so."""
        end = time.monotonic() + seconds
        while not happened():
            assert time.monotonic() < end, "it did not happen"
            self.page.wait_for_timeout(50)

    def until_idle(self) -> None:
        """Wait until nothing waits or runs, and the page shows it."""
        self.until(
            lambda: not {"waiting", "running"} & {job["state"] for job in self.state()["jobs"]}
        )
        self.page.wait_for_selector("#jobs li:not(.failed)", state="detached")

    def settle(self, moving: float = 0) -> None:
        """Wait for some milliseconds that something moves, and until what is then is drawn."""
        self.page.wait_for_timeout(moving)
        frame = "new Promise((done) => requestAnimationFrame(() => setTimeout(done)))"
        self.page.evaluate(f"async () => {{ for (let k = 0; k < 3; k++) await {frame}; }}")

    def drop(self, *paths: Path) -> None:
        """Drop files and folders on the stage, as a person does."""
        box = self.page.locator("#stage").bounding_box()
        place = {"x": box["x"] + box["width"] / 2, "y": box["y"] + box["height"] / 2}
        data = {"items": [], "files": [str(path) for path in paths], "dragOperationsMask": 1}
        session = self.context.new_cdp_session(self.page)
        for kind in ("dragEnter", "dragOver", "drop"):
            session.send("Input.dispatchDragEvent", {"type": kind, **place, "data": data})

    def add(self, *paths: Path) -> None:
        self.page.set_input_files("#files", paths)

    def choose(self, button: str, path: Path) -> None:
        """Choose a file in the dialogue that a button opens."""
        with self.page.expect_file_chooser() as chooser:
            self.page.click(button)
        chooser.value.set_files(path)

    def wait_for_map(self, before: str | None = None) -> str:
        """Wait until a map is shown, another than before; which."""
        self.page.wait_for_function(
            "(before) => { const { shown } = document.documentElement.dataset;"
            " return shown?.startsWith('map') && shown !== before; }",
            arg=before,
            timeout=120_000,
        )
        return self.page.get_attribute("html", "data-shown")

    def at(self, side: str, x: float, y: float) -> tuple[float, float]:
        """A place on the page by shares of a shape's half of the stage."""
        box = self.page.locator("#view").bounding_box()
        left = box["x"] + (box["width"] / 2 if side == "target" else 0)
        return left + x * box["width"] / 2, box["y"] + y * box["height"]

    def click(self, side: str, x: float, y: float) -> None:
        self.page.mouse.click(*self.at(side, x, y))

    def pins(self) -> list[tuple[float, float]]:
        """Where on the page the pins are."""
        box = self.page.locator("#view").bounding_box()
        found = self.page.locator("#marks .pin").evaluate_all(
            "all => all.map((e) => [Number(e.getAttribute('cx')), Number(e.getAttribute('cy'))])"
        )
        return [(box["x"] + x, box["y"] + y) for x, y in found]

    def landmarks(self) -> list[list[str]]:
        """Name and vertices of each row of the list."""
        return self.page.locator("#landmark-list li").evaluate_all(
            "all => all.map((e) => [...e.querySelectorAll('input')].map((i) => i.value))"
        )

    def saved(self, button: str) -> bytes:
        """What is saved when a button is pressed."""
        with self.page.expect_download() as found:
            self.page.click(button)
        return found.value.path().read_bytes()

    def picture(self) -> np.ndarray:
        """The stage as it is seen."""
        from io import BytesIO

        from PIL import Image

        self.settle()
        shot = self.page.locator("#stage").screenshot()
        return np.asarray(Image.open(BytesIO(shot)).convert("RGB")).astype(int)
