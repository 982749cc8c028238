import json
import os
import re
import shutil

import numpy as np
import pytest

from esd.common import InputError
from esd.matching.correspondence import Correspondence
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import grid, icosphere, torus
from esd.viewing.page import Page, view

SOURCE, TARGET = icosphere(3), icosphere(4)


@pytest.fixture(scope="module")
def page() -> Page:
    """A sphere on a finer one, one vertex without a match."""
    index = np.arange(len(SOURCE.vertices))  # the first vertices of the finer one are the same
    index[SOURCE.vertices[:, 0].argmax()] = -1
    distance = np.where(index >= 0, 0.1, np.inf)
    match = Correspondence(index, distance, np.linspace(0, 1, len(index)))
    error = np.linspace(0, 0.4, len(index))
    return view(SOURCE, TARGET, match, error=error, source_name="<a>&b", target_name="c", up="y")


def test_page_holds_everything_and_asks_for_nothing(page):
    assert "<title>&lt;a>&amp;b → c</title>" in page.html
    assert not re.search(r'(src|href)="', page.html)
    meta = json.loads(re.search(r'id="meta"[^>]*>(.*?)</script>', page.html)[1])
    sizes = {name: size for name, _, _, size in meta["arrays"]}
    assert sizes["source_positions"] == 3 * len(SOURCE.vertices)
    assert sizes["target_faces"] == 3 * len(TARGET.faces)
    assert sizes["map"] == len(SOURCE.vertices)
    assert sizes["line_order"] == 300
    assert "<iframe srcdoc=" in page._repr_html_()


def test_up_is_guessed_from_the_longest_side():
    tall = grid(5, 4)
    same = Correspondence(np.arange(20), np.zeros(20), np.ones(20))
    for order, up in (((0, 1, 2), "y"), ((2, 1, 0), "z")):
        mesh = Mesh(tall.vertices[:, order] * (1 + np.arange(3)), tall.faces)
        assert f'"up": "{up}"' in view(mesh, mesh, same).html


def test_what_cannot_be_shown_is_refused(tmp_path, page):
    mesh = torus(7, 5)
    match = Correspondence(np.arange(35), np.zeros(35), np.ones(35))
    with pytest.raises(InputError, match="`up` must be"):
        view(mesh, mesh, match, up="w")
    with pytest.raises(InputError, match=r"`error` must have shape \(35,\)"):
        view(mesh, mesh, match, error=np.zeros(3))
    with pytest.raises(InputError, match=r"ends in .html"):
        page.save(tmp_path / "page.pdf")


@pytest.fixture(scope="module")
def browser():
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    path = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("google-chrome")
    if path is None:
        pytest.skip("no Chromium on this machine; name one in CHROMIUM")
    software = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    with playwright.sync_playwright() as run:
        started = run.chromium.launch(executable_path=path, args=software)
        yield started
        started.close()


class Opened:
    """The page in a browser, without a network, and what it complained of."""

    def __init__(self, browser, path, **options):
        self.complaints = []
        self.tab = browser.new_context(offline=True, **options).new_page()
        self.tab.on("console", lambda message: self.complaints.append(message.text))
        self.tab.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.tab.on("request", lambda r: r.url == path.as_uri() or self.complaints.append(r.url))
        self.tab.goto(path.as_uri())
        self.tab.wait_for_selector("html[data-ready]")

    def readout(self) -> str:
        self.tab.wait_for_timeout(150)
        return self.tab.inner_text("#readout")

    def picture(self) -> np.ndarray:
        from io import BytesIO

        from PIL import Image

        self.tab.wait_for_timeout(150)
        return np.asarray(Image.open(BytesIO(self.tab.screenshot())).convert("RGB")).astype(int)


@pytest.fixture
def saved(page, tmp_path):
    page.save(tmp_path / "page.html")
    return tmp_path / "page.html"


def test_page_in_a_browser(browser, saved):
    opened = Opened(browser, saved, viewport={"width": 1000, "height": 600}, color_scheme="light")
    tab = opened.tab
    first = opened.picture()
    for side in (first[:500, :500], first[:500, 500:]):
        shape = np.abs(side - side[-1, 0]).sum(axis=2) > 30
        assert 0.1 < shape.mean() < 0.9
        assert len(np.unique(side[shape], axis=0)) > 500  # many colours

    # the middle of each half looks at the vertex with the largest z, which is the same on both
    tab.mouse.move(250, 255)
    on_source = re.fullmatch(
        r"source vertex (\d+) → target vertex (\d+) · confidence [\d.]+ · error [\d.]+ % of √area",
        opened.readout(),
    )
    assert on_source[1] == on_source[2]
    assert SOURCE.vertices[int(on_source[1]), 2] > 0.95
    tab.mouse.move(750, 255)
    assert opened.readout().startswith(("source vertex", "no source vertex"))
    tab.mouse.move(2, 2)
    assert opened.readout() == ""

    before = opened.picture()
    tab.get_by_text("Error", exact=True).click()
    assert np.abs(opened.picture() - before).mean() > 1
    assert tab.is_visible("#legend")
    tab.keyboard.press("2")
    assert tab.is_checked("input[value=confidence]")
    tab.keyboard.press("1")
    tab.keyboard.press("l")
    assert tab.inner_text("#line-count") == "60"
    with_lines = opened.picture()
    assert np.abs(with_lines - before)[:500, 480:520].max() > 50  # between the shapes
    tab.keyboard.press("l")
    tab.keyboard.press("ArrowLeft")
    turned = opened.picture()
    assert np.abs(turned - before)[:500, :500].max() > 20
    assert np.abs(turned - before)[:500, 500:].max() > 20  # the cameras are linked
    tab.keyboard.press("r")
    np.testing.assert_array_equal(opened.picture()[:500], before[:500])
    tab.keyboard.press("t")
    assert opened.picture()[:500, 500].mean() < 60 < before[:500, 500].mean()
    assert opened.complaints == []


def test_page_on_a_phone(browser, saved):
    phone = {"viewport": {"width": 390, "height": 844}, "is_mobile": True, "has_touch": True}
    opened = Opened(browser, saved, **phone)
    box = opened.tab.locator("#controls").bounding_box()
    assert box["x"] >= 0
    assert box["x"] + box["width"] <= 390
    opened.tab.touchscreen.tap(195, 160)
    assert re.match(r"source vertex \d+ → target vertex \d+", opened.readout())
    opened.tab.locator("#morph").fill("50")
    assert opened.tab.inner_text("#morph-share") == "50%"
    assert opened.complaints == []


def test_page_of_a_map_without_confidence_offers_none(browser, tmp_path):
    mesh = torus(12, 8)
    count = len(mesh.vertices)
    unknown = np.full(count, np.nan)
    path = tmp_path / "page.html"
    view(mesh, mesh, Correspondence(np.arange(count), unknown, unknown)).save(path)
    opened = Opened(browser, path)
    assert opened.tab.is_hidden("input[value=confidence] + span")
    assert opened.tab.is_hidden("input[value=error] + span")
    assert opened.complaints == []
