import re
from io import BytesIO

import numpy as np
import pytest

pytest.importorskip("starlette", reason="the extra 'studio' is not installed")
pytest.importorskip("uvicorn", reason="the extra 'studio' is not installed")

from esd.mesh.io.attributes import read_vertex_colours, write_coloured
from esd.mesh.io.meshes import write_mesh
from esd.mesh.mesh import Mesh
from esd.mesh.shapes import subdivide
from standing import animal
from studio_browser import Server, Tab, bent, write_pair

HTML = "<img src=x onerror=alert(1)>"
PLACES = ((0.36, 0.3), (0.7, 0.5), (0.36, 0.68), (0.14, 0.5))
"""Of landmarks, in shares of half of the stage: the torus has a hole in the middle."""


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    found = Server(tmp_path_factory.mktemp("studio") / "project")
    yield found
    found.kill()


@pytest.fixture
def opened(browser, server):
    """The page; that the browser does not complain is checked."""
    tab = Tab(browser, server.address)
    yield tab
    tab.close()
    assert tab.complaints == []


@pytest.fixture
def tab(opened):
    """The page of a project without shapes."""
    opened.empty()
    return opened


@pytest.fixture
def matched(opened, tmp_path):
    """The page with a map of two shapes without landmarks; the name of one is HTML."""
    names = [f"{HTML}.off", "b.off"]
    state = opened.state()
    if [shape["name"] for shape in state["shapes"]] == names and state["maps"]:
        for shape in state["shapes"]:  # as the last test left it
            body = {"names": [], "places": []}
            opened.ask("PUT", f"shapes/{shape['number']}/landmarks", body)
        opened.page.reload()
    else:
        opened.empty()
        opened.add(*write_pair(tmp_path, tuple(names)))
    opened.wait_for_map()
    opened.until_idle()
    return opened


def click_landmarks(tab, count=4):
    """Click pairs of places; the target is turned onto the source, so that they belong together."""
    tab.page.click("#landmark-add")
    for k, place in enumerate(PLACES[:count]):
        for side in ("source", "target"):
            tab.click(side, *place)
        tab.until(lambda k=k: len(tab.landmarks()) == k + 1)
    tab.page.keyboard.press("Escape")
    tab.until(lambda: [len(shape["places"]) for shape in tab.state()["shapes"]] == [count] * 2)


def test_two_files_that_are_dropped_are_matched(tab, tmp_path):
    assert tab.page.is_visible("#empty")
    tab.drop(*write_pair(tmp_path))
    tab.wait_for_map()
    assert tab.page.is_hidden("#empty")
    assert tab.page.is_visible("#verdict")
    assert re.search(r"2,048 of 2,048 vertices", tab.page.inner_text("#statistics"))
    assert tab.page.locator("#shapes > li").count() == 2


def test_two_files_are_matched_beside_others_when_the_state_comes_late(tab, tmp_path):
    write_mesh(bent(1.2), tmp_path / "other.off")
    tab.add(tmp_path / "other.off")
    tab.until_idle()
    tab.page.evaluate(
        """() => { // answers that lack the second file come after the answer to its upload
            const { fetch } = window;
            const pause = (time) => new Promise((done) => setTimeout(done, time));
            window.fetch = async (path, options) => {
                if (path.startsWith("shapes?name=b")) await pause(500);
                const answer = await fetch(path, options);
                if (path.startsWith("state")) await pause(1000);
                return answer;
            };
        }"""
    )
    tab.add(*write_pair(tmp_path))
    tab.wait_for_map()
    assert tab.page.locator("#target option:checked").inner_text() == "b.off"


def test_what_cannot_be_shown_once_is_asked_for_again(tab, tmp_path):
    tab.page.evaluate(
        """() => {
            const { fetch } = window;
            window.fetch = async (path, options) => {
                if (!path.endsWith("/view")) return fetch(path, options);
                window.fetch = fetch;
                throw new Error("broken off");
            };
        }"""
    )
    write_mesh(bent(), tmp_path / "a.off")
    tab.add(tmp_path / "a.off")
    tab.until(lambda: "does not answer" in tab.page.inner_text("#message"))
    tab.ask("PUT", "settings", {})  # a new state
    tab.page.wait_for_selector("html[data-shown^=shapes]")


def test_a_folder_that_is_dropped_brings_its_meshes(tab, tmp_path):
    folder = tmp_path / "set"
    write_pair(folder / "inner")
    (folder / "notes.txt").write_text("no mesh")
    (folder / ".hidden.off").write_text("no mesh either")
    tab.drop(folder)
    tab.until(lambda: "not a mesh: notes.txt" in tab.page.inner_text("#message"))
    tab.wait_for_map()
    assert tab.page.locator("#shapes > li").count() == 2


def test_pointing_at_a_shape_shows_the_match(matched):
    page = matched.page
    page.mouse.move(*matched.at("source", 0.7, 0.5))
    matched.until(lambda: page.inner_text("#readout"))
    shown = re.match(
        r"source vertex (\d+) → target vertex (\d+) · confidence", page.inner_text("#readout")
    )
    assert shown[1] == shown[2]
    assert page.locator("#marks circle").count() == 2
    page.mouse.move(*matched.at("source", 0.01, 0.01))
    matched.until(lambda: not page.inner_text("#readout"))


def test_landmarks_are_clicked_dragged_named_and_undone(matched):
    page = matched.page
    click_landmarks(matched)
    first = matched.landmarks()
    assert [name for name, _, _ in first] == ["1", "2", "3", "4"]
    assert len({source for _, source, _ in first}) == 4

    # drag the pin of the first on the target a little
    pins = matched.pins()
    half = matched.at("target", 0, 0)[0]
    x, y = next(pin for pin in pins if pin[0] > half)
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 5, y + 60, steps=6)
    page.mouse.up()
    matched.until(lambda: matched.landmarks() != first)
    dragged = matched.landmarks()
    assert dragged[0][:2] == first[0][:2]
    assert dragged[0][2] != first[0][2]
    assert dragged[1:] == first[1:]

    page.keyboard.press("Control+z")
    matched.until(lambda: matched.landmarks() == first)
    page.keyboard.press("Control+Shift+z")
    matched.until(lambda: matched.landmarks() == dragged)
    page.click("#landmark-undo")
    matched.until(lambda: matched.landmarks() == first)

    # names, of which HTML is one like any other
    name = page.locator("#landmark-list input[type=text]").first
    name.fill(HTML)
    name.press("Enter")
    matched.until(lambda: matched.state()["shapes"][1]["names"][0] == HTML)
    label = page.locator("#marks text").first
    matched.until(lambda: label.inner_html().startswith("&lt;img"))
    name.fill("2")
    name.press("Enter")
    matched.until(lambda: "has this name" in page.inner_text("#message"))

    # a vertex that is typed, and one that there is not
    vertex = page.locator("#landmark-list input[type=number]").nth(1)
    vertex.fill("7")
    vertex.press("Enter")
    matched.until(lambda: matched.state()["shapes"][1]["places"][0] == 7)
    vertex = page.locator("#landmark-list input[type=number]").nth(1)
    vertex.fill("99999")
    vertex.press("Enter")
    matched.until(lambda: "vertices from 0 to 2047" in page.inner_text("#message"))
    page.locator("#landmark-list button").last.click()
    matched.until(lambda: len(matched.landmarks()) == 3)
    matched.until(lambda: len(matched.state()["shapes"][0]["places"]) == 3)


def test_a_place_is_suggested(matched):
    page = matched.page
    page.keyboard.press("s")
    page.wait_for_selector("#marks .pin")
    matched.settle(600)  # it flies for 500
    assert "click the same place on the target" in page.inner_text("#landmark-hint")
    matched.click("target", 0.5, 0.5)  # the camera flew to the place on both
    matched.until(lambda: len(matched.landmarks()) == 1)
    page.keyboard.press("Escape")


def test_landmark_files_are_saved_and_loaded(matched, tmp_path):
    page = matched.page
    click_landmarks(matched)
    rows = matched.landmarks()
    page.click("#landmarks summary")
    for suffix in (".csv", ".fcsv", ".mrk.json", ".pts", ".tps"):
        page.select_option("#landmark-format", suffix)
        path = tmp_path / f"marks{suffix}"
        path.write_bytes(matched.saved("#store-source"))
        while matched.landmarks():
            count = len(matched.landmarks())
            page.locator("#landmark-list button").first.click()
            matched.until(lambda count=count: len(matched.landmarks()) < count)
        matched.choose("#load-source", path)
        matched.until(lambda: len(matched.landmarks()) == 4)
        assert [(name, v) for name, v, _ in matched.landmarks()] == [(n, v) for n, v, _ in rows]
    (tmp_path / "no.csv").write_text("nothing")
    matched.choose("#load-target", tmp_path / "no.csv")
    matched.until(lambda: "landmarks.csv" in page.inner_text("#message"))
    # what the browser reports of an answer that refuses
    assert all("400" in line for line in matched.complaints)
    matched.complaints.clear()


def test_landmarks_are_carried_and_the_pair_is_matched_again(matched):
    page = matched.page
    click_landmarks(matched)
    for row in range(4):
        vertex = page.locator("#landmark-list input[type=number]").nth(2 * row + 1)
        vertex.fill("")
        vertex.press("Enter")
        matched.until(lambda row=row: matched.landmarks()[row][2] == "")
    assert page.is_disabled("#rematch")
    page.click("#landmarks summary")
    page.click("#carry")
    matched.until(lambda: all(target for _, _, target in matched.landmarks()))
    assert [source == target for _, source, target in matched.landmarks()].count(True) >= 3
    before = page.get_attribute("html", "data-shown")
    page.click("#rematch")
    matched.wait_for_map(before)
    assert matched.state()["maps"][0]["landmarks"] == ["1", "2", "3", "4"]


def test_a_job_is_cancelled(tab, tmp_path):
    write_mesh(subdivide(subdivide(bent())), tmp_path / "large.off")
    tab.add(tmp_path / "large.off")
    bar = tab.page.locator("#jobs progress")
    assert bar.evaluate("(e) => e.position") >= 0  # an undetermined one is animated
    tab.page.click("#jobs button[aria-label^=Cancel]")
    tab.until(lambda: tab.page.locator("#shapes > li").count() == 0)
    assert tab.state()["jobs"][-1]["state"] == "cancelled"
    tab.add(*write_pair(tmp_path))  # the next ones are done
    tab.wait_for_map()


def test_both_shapes_are_shaded_alike(tab, tmp_path):
    for k, name in enumerate(("a.off", "b.off")):  # added one by one: they are not matched
        write_mesh(bent(), tmp_path / name)
        tab.add(tmp_path / name)
        tab.until(lambda k=k: len([s for s in tab.state()["shapes"] if s["vertices"]]) == k + 1)
    tab.page.wait_for_function("() => document.documentElement.dataset.shown?.includes(',')")

    def difference() -> float:
        below = tab.picture()[60:]  # the names
        half = below.shape[1] // 2
        return np.abs(below[:, :half] - below[:, half : 2 * half]).mean()

    tab.until(lambda: difference() < 0.5, seconds=30)


def test_findings_are_shown_where_they_are_and_repaired_on_request(tab, tmp_path):
    mesh = bent()
    faces = np.concatenate([mesh.faces[:-40], mesh.faces[:3, [0, 2, 1]]])  # a hole; doubled faces
    write_mesh(Mesh(mesh.vertices, faces), tmp_path / "torn.off")
    tab.add(tmp_path / "torn.off")
    tab.page.wait_for_selector("#shapes summary")
    tab.page.click("#shapes summary")
    tab.page.wait_for_selector("html[data-shown^=shapes]")
    before = tab.picture()
    for name in ("c.off", "d.off"):  # two others, which are shown
        write_mesh(mesh, tmp_path / name)
    tab.add(tmp_path / "c.off", tmp_path / "d.off")
    tab.wait_for_map()
    tab.until_idle()
    show = tab.page.locator("#shapes button[aria-label^='Show where']")
    assert show.count() >= 1
    show.first.click()

    def is_red() -> bool:
        picture = tab.picture()
        return bool(((picture[..., 0] > 150) & (picture[..., 1] < 90)).any())

    tab.until(is_red)
    tab.settle(600)  # it flies for 500
    assert np.abs(tab.picture() - before).mean() > 1
    for shape in tab.state()["shapes"][1:]:
        tab.ask("DELETE", f"shapes/{shape['number']}")
    tab.until(lambda: tab.page.locator("#shapes > li").count() == 1)
    tab.page.click("#shapes button[aria-label^=Repair]")
    tab.until(lambda: tab.page.locator("#shapes > li").count() == 2)
    tab.until_idle()
    shapes = tab.state()["shapes"]
    assert shapes[1]["name"] == "torn-repaired.ply"
    assert len(shapes[1]["findings"]) < len(shapes[0]["findings"])


def test_a_model_is_chosen_and_shapes_are_swapped_and_removed(matched):
    page = matched.page
    page.click("#swap")
    page.select_option("#model", "paper-hks")
    matched.until(lambda: matched.state()["settings"]["model"] == "paper-hks")
    page.click("#start")
    matched.until(
        lambda: {m["model"] for m in matched.state()["maps"]} == {"oriented", "paper-hks"}
    )
    matched.wait_for_map()
    page.select_option("#model", "default")
    matched.until(lambda: matched.state()["settings"]["model"] == "default")
    asked = []
    page.once("dialog", lambda dialog: (asked.append(dialog.message), dialog.dismiss()))
    page.locator("#shapes button[aria-label^=Remove]").first.click()
    matched.until(lambda: asked)
    assert "with its maps?" in asked[0]
    assert len(matched.state()["shapes"]) == 2
    page.once("dialog", lambda dialog: dialog.accept())
    page.locator("#shapes button[aria-label^=Remove]").first.click()
    matched.until(lambda: len(matched.state()["shapes"]) == 1)
    matched.empty()


def test_all_pairs_of_several_shapes_are_in_the_gallery(tab, server, tmp_path):
    red = np.where(bent().vertices[:, :1] > 0, [[220, 30, 30, 255]], [[30, 30, 220, 255]])
    write_coloured(bent(), red.astype(np.uint8), tmp_path / "m0.ply")
    for k in (1, 2):
        write_mesh(bent(1 + 0.1 * k), tmp_path / f"m{k}.off")
    tab.add(tmp_path / "m0.ply", *(tmp_path / f"m{k}.off" for k in (1, 2)))
    tab.until(lambda: [s["vertices"] for s in tab.state()["shapes"]] == [2048] * 3)
    tab.page.click("#match-all")
    tab.until(lambda: len(tab.state()["maps"]) == 3)
    buttons = tab.page.locator("#maps button")
    tab.until(lambda: buttons.count() == 3)
    accuracies = [m["expected_accuracy"] for m in tab.state()["maps"]]
    assert accuracies == sorted(accuracies)
    buttons.last.click()
    tab.page.wait_for_selector("#maps button[aria-current=true]")
    assert buttons.last.get_attribute("aria-current") == "true"
    tab.wait_for_map()
    # the landmarks, labels and colours of the source go to all
    tab.page.select_option("#source", label="m0.ply")
    number = tab.state()["shapes"][0]["number"]
    tab.ask("PUT", f"shapes/{number}/landmarks", {"names": ["nose", "tail"], "places": [5, 900]})
    parts = np.where(bent().vertices[:, 1] > 0, "upper", "lower")
    (tmp_path / "parts.txt").write_text("\n".join(parts))
    tab.page.click("#transfer summary")
    tab.choose("#load-labels", tmp_path / "parts.txt")
    tab.until(lambda: tab.state()["shapes"][0]["labels"] == 1)
    tab.page.click("#carry-all")
    tab.until(lambda: [s["names"] for s in tab.state()["shapes"]] == [["nose", "tail"]] * 3)
    tab.until(lambda: [s["labels"] for s in tab.state()["shapes"]] == [1, 1, 1])
    tab.until_idle()
    numbers = [shape["number"] for shape in tab.state()["shapes"]]
    for k in (1, 2):
        (path,) = (server.folder / "carried").glob(f"{numbers[k]}-m{k}-by-{number}-m0.glb")
        colours = read_vertex_colours(path)[:, 0] > 128
        same = (colours == (red[:, 0] > 128)).mean()
        assert max(same, 1 - same) > 0.95
    carried = tab.saved("#store-labels").decode().split()
    same = (np.array(carried) == parts).mean()
    assert max(same, 1 - same) > 0.95  # half a turn about x takes the shape to itself
    tab.page.get_by_text("Labels", exact=True).click()
    colours = {tuple(c) for c in tab.picture()[::4, ::4].reshape(-1, 3)}
    assert len(colours) > 50
    tab.page.mouse.move(*tab.at("source", 0.36, 0.3))
    tab.until(lambda: "label upper" in tab.page.inner_text("#readout"))


def test_a_texture_is_shown_on_both_and_carried(tab, tmp_path):
    first, second = bent(), bent(1.1)
    red = np.where(first.vertices[:, :1] > 0, [[220, 30, 30, 255]], [[30, 30, 220, 255]])
    write_coloured(first, red.astype(np.uint8), tmp_path / "a.ply")
    write_mesh(second, tmp_path / "b.off")
    tab.add(tmp_path / "a.ply", tmp_path / "b.off")
    tab.wait_for_map()
    tab.page.get_by_text("Texture", exact=True).click()
    picture = tab.picture()
    for half in np.split(picture[:, : picture.shape[1] // 2 * 2], 2, axis=1):
        r, g, b = np.moveaxis(half, 2, 0)
        assert ((r > 100) & (b < 80) & (g < 80)).mean() > 0.02
        assert ((b > 100) & (r < 80) & (g < 80)).mean() > 0.02
    assert tab.saved("#export-look").startswith(b"glTF")


def test_a_map_is_measured_by_the_truth(matched, tmp_path):
    page = matched.page
    points = "\n".join(map(str, range(1, 2049)))
    (tmp_path / "points.vts").write_text(points)
    page.click("#transfer summary")
    for side in ("source", "target"):
        matched.choose(f"#points-{side}", tmp_path / "points.vts")
        number = int(side == "target")
        matched.until(lambda n=number: matched.state()["shapes"][n]["points"] >= 1)
    page.wait_for_selector("#modes input[value=error]", state="attached")
    assert "Mean error" in page.inner_text("#statistics")
    assert matched.state()["maps"][0]["mean_error"] < 0.02
    page.get_by_text("Error", exact=True).click()
    assert page.inner_text("#highest-value") == "25.0 % of √area"
    shifted = "".join(f"{i}\n" for i in [*range(2, 2049), 1])
    (tmp_path / "true.txt").write_text(shifted)
    before = matched.state()["maps"][0]["mean_error"]
    matched.choose("#load-truth", tmp_path / "true.txt")
    matched.until(lambda: matched.state()["maps"][0].get("mean_error", 0) > before)


def test_what_has_no_counterpart_is_grey_and_the_axis_up_is_kept(matched):
    page = matched.page
    assert page.is_hidden("#legend")
    page.select_option("#up", "-y")
    matched.until(lambda: matched.state()["shapes"][0]["up"] == "-y")
    page.reload()
    matched.wait_for_map()
    assert page.input_value("#up") == "-y"
    page.select_option("#up", "y")
    matched.until(lambda: matched.state()["shapes"][0]["up"] == "y")


def test_what_stands_opens_upright(tab, tmp_path):
    mesh = animal()
    write_mesh(Mesh(mesh.vertices * [1, -1, -1], mesh.faces), tmp_path / "fallen.off")
    tab.add(tmp_path / "fallen.off")
    tab.page.wait_for_selector("html[data-shown^=shapes]")
    assert tab.page.input_value("#up") == "-y"
    assert tab.state()["shapes"][0]["up"] == ""  # not chosen by anyone


def test_everything_is_exported(matched, tmp_path):
    page = matched.page
    assert matched.saved("#export-map").startswith(b"source,target")
    for suffix, start in ((".obj", b""), (".off", b"OFF"), (".glb", b"glTF"), (".ply", b"ply")):
        page.select_option("#mesh-format", suffix)
        assert matched.saved("#export-mesh").startswith(start)
    click_landmarks(matched)
    page.click("#landmarks summary")
    assert matched.saved("#store-target").count(b"\n") == 5

    from PIL import Image

    picture = np.asarray(Image.open(BytesIO(matched.saved("#export-picture"))))
    assert picture.shape[2] == 4
    assert picture[0, 0, 3] == 0
    assert 0.1 < (picture[..., 3] == 255).mean() < 0.9
    (tmp_path / "page.html").write_bytes(matched.saved("#export-page"))
    mailed = matched.context.new_page()
    mailed.goto((tmp_path / "page.html").as_uri())
    mailed.wait_for_selector("html[data-ready]")
    assert mailed.is_visible("#verdict")
    assert HTML in mailed.inner_text("#source-name")
    mailed.close()


def test_a_studio_that_was_killed_resumes(browser, tmp_path):
    server = Server(tmp_path / "project")
    tab = Tab(browser, server.address)
    try:
        tab.add(*write_pair(tmp_path / "files"))
        tab.wait_for_map()
        click_landmarks(tab)
        rows = tab.landmarks()
        verdict = tab.page.inner_text("#verdict")
        tab.add(tmp_path / "files" / "a.off")  # is being examined when the server is killed
        tab.ask("POST", "matches", {"source": 2, "target": 1})  # and this waits
        tab.until(lambda: len(tab.state()["shapes"]) == 3)
        server.kill()
        tab.until(lambda: "does not answer" in tab.page.inner_text("#message"))
        server.start()
        again = Tab(browser, server.address)
        again.wait_for_map()
        assert again.landmarks() == rows
        assert again.page.inner_text("#verdict") == verdict
        again.until(lambda: again.state()["shapes"][2]["vertices"] == 2048)
        again.until(lambda: len(again.state()["maps"]) == 2)
        assert again.complaints == []
        again.close()
    finally:
        tab.close()
        server.kill()


def test_a_browser_without_webgl_shows_why_and_still_matches(browser, server, tmp_path):
    first = Tab(browser, server.address)
    first.empty()
    first.context.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
    first.page.reload()
    first.page.wait_for_selector("#failure")
    assert "WebGL 2" in first.page.inner_text("#failure")
    first.add(*write_pair(tmp_path))
    first.until(lambda: len(first.state()["maps"]) == 1)
    first.page.wait_for_selector("#export-map")
    assert first.saved("#export-map").startswith(b"source,target")
    assert first.complaints == []
    first.close()


def test_on_a_phone_and_in_the_dark(browser, server, tmp_path):
    phone = {"viewport": {"width": 390, "height": 844}, "is_mobile": True, "has_touch": True}
    tab = Tab(browser, server.address, **phone, color_scheme="dark")
    tab.empty()
    tab.add(*write_pair(tmp_path))
    tab.wait_for_map()
    assert tab.page.is_hidden("#panel")
    assert tab.picture()[-1, 0].sum() < 150
    box = tab.page.locator("#view").bounding_box()
    tab.page.touchscreen.tap(box["width"] * 0.7, box["height"] * 0.25)
    tab.until(lambda: "source vertex" in tab.page.inner_text("#readout"))
    tab.page.click("#panel-button")
    assert tab.page.is_visible("#work")
    assert tab.page.is_visible("#landmark-add")
    assert tab.page.locator("#view").bounding_box()["height"] > 0.4 * 844
    wide = tab.page.evaluate("() => document.documentElement.scrollWidth")
    assert wide == 390
    assert tab.complaints == []
    tab.close()


def test_every_control_has_a_name_and_shows_the_focus(matched):
    page = matched.page
    unnamed = page.evaluate(
        "() => [...document.querySelectorAll('input, select, button, canvas')].filter((e) =>"
        " !(e.labels?.length || e.getAttribute('aria-label') || e.textContent.trim()))"
        ".map((e) => e.outerHTML)"
    )
    assert unnamed == []
    page.locator("#add").focus()
    for _ in range(25):
        page.keyboard.press("Tab")
        outline = page.evaluate(
            "() => { const e = document.activeElement; return getComputedStyle("
            "e.type === 'radio' ? e.nextElementSibling : e).outlineStyle; }"
        )
        assert outline == "solid"
