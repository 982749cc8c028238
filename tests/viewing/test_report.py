import json
import re
from io import BytesIO

import numpy as np
import pytest

from esd.common import InputError
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import icosphere
from esd.population.atlas import Atlas, atlas
from esd.viewing.report import report


@pytest.fixture(scope="module")
def ellipsoids() -> Atlas:
    sphere = icosphere(3)
    shapes = [Mesh(sphere.vertices * [1 + 0.2 * i, 1, 1], sphere.faces) for i in range(5)]
    return atlas([*shapes, icosphere(1)], registered=True)


def test_a_report_holds_everything_and_asks_for_nothing(ellipsoids):
    html = report(ellipsoids, title="<a>&b").html
    assert "<title>&lt;a>&amp;b</title>" in html
    assert not re.search(r'(src|href)="', html)
    meta = json.loads(re.search(r'id="meta"[^>]*>(.*?)</script>', html)[1])
    sizes = {name: size for name, _, _, size in meta["arrays"]}
    count = len(ellipsoids.mean)
    assert sizes["source_positions"] == sizes["mode_1"] == 3 * count
    assert sizes["deviation"] == count
    assert len(meta["shapes"]) == 5
    assert html.count("data-shape=") == 5
    assert "its connectivity is not that of" in html  # why the sixth was left out
    assert html.count("<figure>") == 3
    with pytest.raises(InputError, match="`up` must be one of"):
        report(ellipsoids, up="w")


def test_a_report_in_a_browser(browser, ellipsoids, tmp_path):
    path = tmp_path / "report.html"
    report(ellipsoids).save(path)
    complaints = []
    tab = browser.new_context(offline=True, viewport={"width": 1090, "height": 800}).new_page()
    tab.on("console", lambda message: complaints.append(message.text))
    tab.on("pageerror", lambda error: complaints.append(str(error)))
    tab.on("request", lambda r: r.url == path.as_uri() or complaints.append(r.url))
    tab.goto(path.as_uri())
    tab.wait_for_selector("html[data-ready]")

    def drawn() -> np.ndarray:
        """Whether the shape is drawn at each pixel of the stage."""
        from PIL import Image

        for _ in range(3):
            tab.evaluate("() => new Promise((d) => requestAnimationFrame(() => setTimeout(d)))")
        image = np.asarray(Image.open(BytesIO(tab.screenshot())).convert("RGB")).astype(int)
        stage = image[60:560, :780]
        return np.abs(stage - stage[0, 0]).sum(axis=2) > 30

    def width() -> int:
        return int(drawn().any(axis=0).sum())

    assert "Standard deviation" in tab.inner_text("#colours")
    mean = width()
    tab.locator("#mode-1").fill("2")
    plus = width()
    assert tab.inner_text("#mode-1-value") == "+2.0"
    tab.locator("#mode-1").fill("-2")
    minus = width()
    assert min(plus, minus) < 0.95 * mean < 1.05 * mean < max(plus, minus)
    tab.click("#mean")
    assert width() == mean
    assert tab.inner_text("#shown") == "mean shape"
    tab.locator("tr", has_text="shape_4").locator("button").click()
    assert tab.inner_text("#shown") == "shape_4"
    assert width() > 1.05 * mean  # the longest
    tab.select_option("#colours", "colours")
    assert tab.inner_text("#lowest") == ""
    tab.mouse.move(390, 300)
    drawn()
    assert re.fullmatch(
        r"vertex \d+ · standard deviation [\d.]+ % of the extent", tab.inner_text("#readout")
    )
    tab.click("#play")
    assert tab.inner_text("#play") == "Stop"
    tab.click("#play")
    tab.select_option("#up", "x")
    tab.click("#reset")
    assert tab.input_value("#up") != "x"
    assert complaints == []
