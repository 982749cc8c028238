import json
import re

import numpy as np
import pytest

from esd.common import InputError
from esd.matching.correspondence import Correspondence
from esd.mesh.shapes import icosphere, torus
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
    return view(
        SOURCE,
        TARGET,
        match,
        error=error,
        source_name="<a>&b",
        target_name="c",
        model="sphere-model",
        up="y",
    )


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


def test_a_page_has_the_name_of_one(tmp_path, page):
    with pytest.raises(InputError, match=r"ends in .html"):
        page.save(tmp_path / "page.pdf")


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

    def settle(self) -> None:
        """Wait until what is asked for is drawn."""
        frame = "new Promise((done) => requestAnimationFrame(() => setTimeout(done)))"
        for _ in range(3):
            self.tab.evaluate(f"() => {frame}")

    def readout(self) -> str:
        self.settle()
        return self.tab.inner_text("#readout")

    def picture(self) -> np.ndarray:
        from io import BytesIO

        from PIL import Image

        self.settle()
        return np.asarray(Image.open(BytesIO(self.tab.screenshot())).convert("RGB")).astype(int)


@pytest.fixture
def saved(page, tmp_path):
    page.save(tmp_path / "page.html")
    return tmp_path / "page.html"


def test_page_in_a_browser(browser, saved):
    # 270 pixels are the panel's
    opened = Opened(browser, saved, viewport={"width": 1070, "height": 600}, color_scheme="light")
    tab = opened.tab
    first = opened.picture()
    for side in (first[50:550, :400], first[50:550, 400:800]):
        shape = np.abs(side - side[-1, 0]).sum(axis=2) > 30
        assert 0.1 < shape.mean() < 0.9
        assert len(np.unique(side[shape], axis=0)) > 500  # many colours

    # the middle of each half looks at the vertex with the largest z, which is the same on both
    tab.mouse.move(200, 300)
    on_source = re.fullmatch(
        r"source vertex (\d+) → target vertex (\d+) · confidence [\d.]+ · error [\d.]+ % of √area"
        r" · distance 0.10 · stretch -?[\d.]+ log₂ of area",
        opened.readout(),
    )
    assert on_source[1] == on_source[2]
    assert SOURCE.vertices[int(on_source[1]), 2] > 0.95
    tab.mouse.move(600, 300)
    assert opened.readout().startswith(("source vertex", "no source vertex"))
    tab.mouse.move(2, 598)
    assert opened.readout() == ""

    before = opened.picture()
    tab.get_by_text("Error", exact=True).click()
    assert np.abs(opened.picture() - before).mean() > 1
    assert tab.is_visible("#scale")
    tab.keyboard.press("2")
    assert tab.is_checked("input[value=confidence]")
    tab.keyboard.press("1")
    tab.keyboard.press("l")
    assert tab.inner_text("#line-count") == "60"
    with_lines = opened.picture()
    assert np.abs(with_lines - before)[:500, 380:420].max() > 50  # between the shapes
    tab.keyboard.press("l")
    tab.keyboard.press("ArrowLeft")
    turned = opened.picture()
    assert np.abs(turned - before)[:500, :400].max() > 20
    assert np.abs(turned - before)[:500, 400:800].max() > 20  # the cameras are linked
    tab.keyboard.press("r")
    np.testing.assert_array_equal(opened.picture()[:590, :800], before[:590, :800])
    tab.keyboard.press("t")
    assert opened.picture()[:500, 400].mean() < 60 < before[:500, 400].mean()
    assert opened.complaints == []


def test_dragging_turns_over_the_pole_and_every_axis_can_point_up(browser, saved):
    opened = Opened(browser, saved, viewport={"width": 1070, "height": 600})
    tab = opened.tab
    seen = set()
    for axis in ("x", "-x", "y", "-y", "z", "-z"):
        tab.select_option("#up", axis)
        tab.mouse.move(200, 300)
        seen.add(opened.readout())
        tab.mouse.move(2, 598)
    assert len(seen) == 2, (
        seen
    )  # the shapes are seen from the front: z up shows another side than y up
    tab.select_option("#up", "y")
    for _ in range(4):  # a quarter turn each
        tab.mouse.move(200, 200)
        tab.mouse.down()
        tab.mouse.move(200, 350, steps=5)
        tab.mouse.up()
        tab.mouse.move(200, 300)
        seen.add(opened.readout())
        tab.keyboard.press("Escape")
    assert len(seen) == 6  # a camera that stops at the pole would see it again
    assert opened.complaints == []


def test_the_scale_is_fixed_until_it_is_moved(browser, saved):
    opened = Opened(browser, saved, viewport={"width": 1070, "height": 700})
    tab = opened.tab
    tab.keyboard.press("3")
    assert tab.inner_text("#lowest-value") == "0.0"
    assert tab.inner_text("#highest-value") == "25.0 % of √area"
    assert tab.locator("#histogram rect").count() == 40
    before = opened.picture()
    tab.locator("#highest").fill("0.1")
    assert tab.inner_text("#highest-value") == "10.0 % of √area"
    after = opened.picture()
    assert np.abs(after - before)[:, :400].mean() > 1
    assert np.abs(after - before)[:, 400:800].mean() > 1  # the target has the values, too
    tab.click("#fit")
    assert tab.inner_text("#lowest-value") == "0.8"  # the 2nd percentile of 0 to 40
    tab.click("#fix")
    np.testing.assert_array_equal(opened.picture()[:600, :800], before[:600, :800])


def test_verdict_figures_and_worst_places_are_shown(browser, saved):
    opened = Opened(browser, saved, viewport={"width": 1070, "height": 700})
    tab = opened.tab
    assert re.fullmatch(
        r"(Failed|Doubtful): about \d+% of the matches within 5 % of the diameter",
        tab.inner_text("#verdict"),
    )
    assert tab.is_visible("#warning")
    assert "sphere-model" in tab.inner_text("#statistics")
    assert f"{len(SOURCE.vertices) - 1} of {len(SOURCE.vertices)} vertices" in tab.inner_text(
        "#statistics"
    )
    places = tab.locator("#place-list button")
    assert 0 < places.count() <= 8
    vertex = int(re.search(r"vertex (\d+)", places.first.inner_text())[1])
    places.first.click()
    tab.wait_for_timeout(700)
    assert opened.readout().startswith(f"source vertex {vertex} →")
    tab.keyboard.press("Escape")
    tab.mouse.move(400, 350)
    tab.mouse.move(200, 350)  # it is in the middle now
    assert opened.readout().startswith(f"source vertex {vertex} →")


def test_what_has_no_counterpart_is_grey_on_both_and_explained(browser, tmp_path):
    index = np.where(SOURCE.vertices[:, 0] < 0, np.arange(len(SOURCE.vertices)), -1)
    known = np.where(index >= 0, 0.1, np.nan)
    path = tmp_path / "page.html"
    view(SOURCE, TARGET, Correspondence(index, known, known), up="y").save(path)
    opened = Opened(browser, path, viewport={"width": 1070, "height": 600}, color_scheme="light")
    legend = opened.tab.inner_text("#legend")
    shares = re.search(r"(\d+) % of the source, (\d+) % of the target", legend).groups()
    assert 45 <= int(shares[0]) <= 55
    assert 30 <= int(shares[1]) < 50  # what is near an image has a counterpart
    picture = opened.picture()
    for middle in (200, 600):  # of the shapes, whose right half is grey
        left, right = (
            picture[250:350, middle - 90 : middle - 50],
            picture[250:350, middle + 80 : middle + 120],
        )
        assert np.ptp(right, axis=2).max() < 12
        assert np.ptp(left, axis=2).max() > 50
    assert opened.complaints == []


def test_what_has_the_focus_is_seen(browser, saved):
    opened = Opened(browser, saved, viewport={"width": 1070, "height": 700})
    tab = opened.tab
    seen = []
    for _ in range(12):
        tab.keyboard.press("Tab")
        style = tab.evaluate(
            "() => { const e = document.activeElement; const s = getComputedStyle(e.type === 'radio'"
            " ? e.nextElementSibling : e); return [e.id || e.tagName, s.outlineStyle, s.outlineWidth]; }"
        )
        seen.append(style[0])
        assert style[1:] == ["solid", "3px"], style
    assert "view" in seen
    unnamed = tab.evaluate(
        "() => [...document.querySelectorAll('input, select, button')]"
        ".filter((e) => !(e.labels?.length || e.getAttribute('aria-label') || e.textContent.trim())).length"
    )
    assert unnamed == 0


def test_page_on_a_phone(browser, saved):
    phone = {"viewport": {"width": 390, "height": 844}, "is_mobile": True, "has_touch": True}
    opened = Opened(browser, saved, **phone)
    tab = opened.tab
    assert tab.is_hidden("#panel")
    tab.touchscreen.tap(195, 220)
    assert re.match(r"source vertex \d+ → target vertex \d+", opened.readout())
    tab.click("#panel-button")
    box = tab.locator("#panel").bounding_box()
    assert (box["x"], box["width"]) == (0, 390)
    assert box["height"] < 0.5 * 844
    tab.locator("#morph").fill("50")
    assert tab.inner_text("#morph-share") == "50%"
    assert opened.complaints == []


def test_a_phone_on_its_side_shows_the_shapes(browser, saved):
    phone = {"viewport": {"width": 844, "height": 390}, "is_mobile": True, "has_touch": True}
    opened = Opened(browser, saved, **phone)
    assert opened.tab.locator("#view").bounding_box()["width"] == 844
    opened.tab.click("#panel-button")
    assert opened.tab.locator("#view").bounding_box()["width"] >= 0.7 * 844
    assert opened.tab.locator("#view").bounding_box()["height"] == 390


def test_a_browser_without_webgl_says_so(browser, saved):
    tab = browser.new_context(offline=True).new_page()
    tab.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
    tab.goto(saved.as_uri())
    tab.wait_for_selector("#failure")
    assert "WebGL 2" in tab.inner_text("#failure")


def test_page_of_a_map_without_confidence_offers_none(browser, tmp_path):
    mesh = torus(12, 8)
    count = len(mesh.vertices)
    unknown = np.full(count, np.nan)
    path = tmp_path / "page.html"
    view(mesh, mesh, Correspondence(np.arange(count), unknown, unknown)).save(path)
    opened = Opened(browser, path)
    modes = opened.tab.locator("#modes input").evaluate_all("all => all.map((e) => e.value)")
    assert modes == ["colours", "stretch"]
    assert opened.tab.is_hidden("#verdict")
    assert opened.complaints == []
