import asyncio
import json
import struct
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("starlette", reason="the extra 'studio' is not installed")
httpx = pytest.importorskip("httpx", reason="httpx is not installed")

from esd.mesh.io.meshes import write_mesh  # noqa: E402
from esd.mesh.mesh import Mesh  # noqa: E402
from esd.mesh.shapes import subdivide, torus  # noqa: E402
from esd.studio import app as studio_app  # noqa: E402
from esd.studio.app import Studio, create_app  # noqa: E402
from esd.studio.project import Project  # noqa: E402

PORT = 4321
BASE = f"http://127.0.0.1:{PORT}"


def mesh_bytes(folder, scale=1.0) -> bytes:
    """A closed surface without symmetry, of 2,048 vertices."""
    mesh = subdivide(torus(32, 16))
    x, y, z = mesh.vertices.T
    bent = mesh.vertices * (1 + 0.3 * x + 0.2 * y * z)[:, None] * [1, 1, scale]
    write_mesh(Mesh(bent, mesh.faces), folder / "mesh.off")
    return (folder / "mesh.off").read_bytes()


@pytest.fixture
def app(tmp_path):
    studio = Studio(Project(tmp_path / "project"))
    yield create_app(studio, token="secret", port=PORT)
    studio.jobs.close()


def ask(app, *requests, headers=None):
    """Answers to requests, all sent at once: (method, path, further arguments)."""

    async def all_of():
        transport = httpx.ASGITransport(app=app)
        async with httpx.AsyncClient(transport=transport, base_url=BASE, headers=headers) as client:
            sent = [client.request(method, path, **more) for method, path, more in requests]
            return await asyncio.gather(*sent)

    # in a thread of its own, since tests with a browser leave a loop running in this one
    with ThreadPoolExecutor(1) as thread:
        return thread.submit(lambda: asyncio.run(all_of())).result()


def unpacked(content):
    """Length of the text, meta data and arrays of a scene."""
    (size,) = struct.unpack("<I", content[:4])
    meta = json.loads(content[4 : 4 + size])
    arrays = {
        name: np.frombuffer(content, f"<{kind}", count, 4 + size + start)
        for name, kind, start, count in meta["arrays"]
    }
    return size, meta, arrays


def matched_folder(app):
    return Path(get(app, "/secret/state").json()["folder"])


def get(app, path="/secret/", **headers):
    return ask(app, ("GET", path, {}), headers=headers)[0]


def wait_until_done(app, seconds=120):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        state = get(app, "/secret/state").json()
        if all(job["state"] not in ("waiting", "running") for job in state["jobs"]):
            return state
        time.sleep(0.1)
    raise TimeoutError


def test_only_its_own_page_with_the_token_is_answered(app):
    answer = get(app)
    assert answer.status_code == 200
    assert "default-src 'none'" in answer.headers["content-security-policy"]
    assert answer.headers["referrer-policy"] == "no-referrer"
    assert get(app, "/").status_code == 404
    assert get(app, "/guess/state").status_code == 404
    assert get(app, origin=BASE).status_code == 200
    assert get(app, origin="https://evil.example").status_code == 403
    assert get(app, origin="null").status_code == 403
    assert get(app, **{"sec-fetch-site": "cross-site"}).status_code == 403
    # a site whose name is made to mean this machine asks by its own name
    for host in ("evil.example", f"evil.example:{PORT}", "127.0.0.1:80", ""):
        assert get(app, host=host).status_code == 421


def test_names_cannot_leave_the_project(app, tmp_path):
    content = mesh_bytes(tmp_path)
    before = {path for path in tmp_path.rglob("*") if "project" not in path.parts}
    names = [
        "../../evil.off",
        "/etc/evil.off",
        "..\\evil.off",
        ".off",
        "a\0b.off",
        "x" * 5000 + ".off",
    ]
    sent = [("POST", "/secret/shapes", {"params": {"name": n}, "content": content}) for n in names]
    assert {answer.status_code for answer in ask(app, *sent)} == {201}
    assert {path for path in tmp_path.rglob("*") if "project" not in path.parts} == before
    listed = get(app, "/secret/state").json()["shapes"]
    assert all("/" not in shape["name"] and len(shape["name"]) <= 100 for shape in listed)
    for name in ("../viewer.js", "..%2f..%2fapp.py", "app.py"):
        assert get(app, f"/secret/static/{name}").status_code == 404
    wrong = ask(app, ("POST", "/secret/shapes", {"params": {"name": "a.exe"}, "content": b"x"}))[0]
    assert wrong.status_code == 400
    assert "is not a mesh file" in wrong.json()["error"]


def test_uploads_are_bounded(app, tmp_path, monkeypatch):
    monkeypatch.setattr(studio_app, "LARGEST_MESH", 1000)

    async def endless():
        while True:
            yield b"x" * 100

    for content in (b"x" * 2000, endless()):
        sent = ("POST", "/secret/shapes", {"params": {"name": "a.off"}, "content": content})
        assert ask(app, sent)[0].status_code == 413
    assert not list((tmp_path / "project").glob(".esd-*"))
    huge = ("PUT", "/secret/settings", {"content": b"[" * (5 * 2**20)})
    assert ask(app, huge)[0].status_code == 413


def test_a_hundred_requests_at_once_lose_nothing(app, tmp_path):
    content = mesh_bytes(tmp_path)
    sent = [
        ("POST", "/secret/shapes", {"params": {"name": f"m{k}.off"}, "content": content})
        for k in range(100)
    ]
    assert {answer.status_code for answer in ask(app, *sent)} == {201}
    kept = json.loads((tmp_path / "project" / "project.json").read_text())["shapes"]
    assert {shape["name"] for shape in kept} == {f"m{k}.off" for k in range(100)}
    assert len(list((tmp_path / "project" / "meshes").iterdir())) == 100


def test_two_meshes_are_matched_and_what_happened_is_kept(app, tmp_path):
    for name, scale in (("a.off", 1.0), ("b.off", 1.1)):
        sent = {"params": {"name": name}, "content": mesh_bytes(tmp_path, scale)}
        assert ask(app, ("POST", "/secret/shapes", sent))[0].status_code == 201
    wait_until_done(app)
    places = [3, 500, 900, 1500]
    for number in (1, 2):
        body = {"names": ["<b>x</b>", "y", "z", "w"], "places": places}
        put = ask(app, ("PUT", f"/secret/shapes/{number}/landmarks", {"json": body}))[0]
        assert put.status_code == 200
    ask(app, ("POST", "/secret/matches", {"json": {"source": 1, "target": 2, "landmarks": True}}))
    (figures,) = wait_until_done(app)["maps"]
    assert figures["landmarks"] == ["<b>x</b>", "y", "z", "w"]
    assert get(app, "/secret/maps/1/2/map?format=.csv").text.startswith("source,target")
    assert get(app, "/secret/maps/1/2/mesh?format=.off").text.startswith("OFF")
    assert "<title>a.off → b.off</title>" in get(app, "/secret/maps/1/2/page").text
    assert get(app, "/secret/shapes/1/landmarks?format=.csv").text.count("\n") == 5
    assert get(app, "/secret/maps/2/1/view").status_code == 404
    again = Project(tmp_path / "project")  # as after a restart
    assert [shape.places for shape in again.shapes()] == [tuple(places)] * 2
    assert again.maps()[0]["verdict"] == figures["verdict"]


@pytest.fixture
def matched(app, tmp_path):
    """The application with a map of two shapes, vertex i of one on vertex i of the other."""
    for name, scale in (("a.off", 1.0), ("b.off", 1.1)):
        sent = {"params": {"name": name}, "content": mesh_bytes(tmp_path, scale)}
        ask(app, ("POST", "/secret/shapes", sent))
    ask(app, ("POST", "/secret/matches", {"json": {"source": 1, "target": 2}}))
    wait_until_done(app)
    return app


def test_what_waits_when_the_studio_is_killed_is_done_when_it_is_opened_again(app, tmp_path):
    for name, scale in (("a.off", 1.0), ("b.off", 1.1)):
        sent = {"params": {"name": name}, "content": mesh_bytes(tmp_path, scale)}
        ask(app, ("POST", "/secret/shapes", sent))
    wait_until_done(app)
    queue = tmp_path / "project" / "queue"
    assert not queue.exists()
    match = [
        ("POST", "/secret/matches", {"json": {"source": source, "target": 3 - source}})
        for source in (1, 2, 2)
    ]
    repair = ("POST", "/secret/shapes/1/repair", {})
    assert {answer.status_code for answer in ask(app, *match, repair)} == {202}
    kept = {path.name: path.read_text() for path in queue.iterdir()}
    wait_until_done(app)
    assert not list(queue.iterdir())
    # what a process that was killed here would have left, with something damaged
    for name, text in {**kept, "00000099.json": "{", "00000098.json": kept[max(kept)]}.items():
        (queue / name).write_text(text.replace('"source": 2', '"source": 99'))
    for path in (tmp_path / "project" / "maps").iterdir():
        path.unlink()
    again = Studio(Project(tmp_path / "project"))
    try:
        second = create_app(again, token="secret", port=PORT)
        state = wait_until_done(second)
        assert [(each["source"], each["target"]) for each in state["maps"]] == [(1, 2)]
        assert [shape["name"] for shape in state["shapes"]][2:] == ["a-repaired.ply"] * 2
        assert not list(queue.iterdir())
    finally:
        again.jobs.close()


def test_labels_are_carried_and_maps_measured(matched, tmp_path):
    def post(path, content=b"", **params):
        answer = ask(matched, ("POST", f"/secret/{path}", {"params": params, "content": content}))[
            0
        ]
        assert answer.status_code < 300, answer.text
        return answer.json()

    assert get(matched, "/secret/shapes/1/labels").status_code == 404
    assert get(matched, "/secret/shapes/1/labels/view").status_code == 404
    post("shapes/1/labels", "\n".join(["<b>", "tail"] * 2048).encode(), name="l.txt")  # of faces
    _, meta, arrays = unpacked(get(matched, "/secret/shapes/1/labels/view").content)
    assert meta["names"] == ["<b>", "tail"]
    assert arrays["labels"].shape == (2048,)
    assert post("maps/1/2/carry")["job"] is not None
    state = wait_until_done(matched)
    assert [shape["labels"] for shape in state["shapes"]] == [1, 1]
    carried = get(matched, "/secret/shapes/2/labels").text.split()
    assert len(carried) == 4096  # of faces, too
    assert set(carried) == {"<b>", "tail"}
    assert post("maps/1/2/carry")["job"]
    wait_until_done(matched)

    points = b"\n".join(b"%d" % (i + 1) for i in range(2048))
    for number in (1, 2):
        assert "mean_error" not in get(matched, "/secret/state").json()["maps"][0]
        post(f"shapes/{number}/points", points, name="p.vts")
    (figures,) = wait_until_done(matched)["maps"]
    assert 0 <= figures["mean_error"] < 0.02
    _, meta, arrays = unpacked(get(matched, "/secret/maps/1/2/view").content)
    assert "error" in arrays
    assert meta["verdict"]["word"] == figures["verdict"]
    assert dict(meta["statistics"])["Candidate"]  # the judgement is still that of the match
    # a true map counts more than points; matched again, the map is measured again
    post("maps/1/2/truth", b"".join(b"%d\n" % (i + 1) for i in [*range(1, 2048), 0]), name="t.txt")
    (again,) = wait_until_done(matched)["maps"]
    assert again["mean_error"] > figures["mean_error"]
    ask(matched, ("POST", "/secret/matches", {"json": {"source": 1, "target": 2}}))
    assert wait_until_done(matched)["maps"][0]["mean_error"] == pytest.approx(again["mean_error"])


def test_what_is_carried_and_measured_must_fit(matched):
    def refused(path, content, name, status=400):
        sent = {"params": {"name": name}, "content": content}
        answer = ask(matched, ("POST", f"/secret/{path}", sent))[0]
        assert answer.status_code == status
        return answer.json()["error"]

    assert "ends in one of .npy" in refused("shapes/1/labels", b"1", "l.exe")
    assert "each of 2048 vertices or 4096 faces; got 1" in refused("shapes/1/labels", b"1", "l.txt")
    assert "ends in one of .vts" in refused("shapes/1/points", b"1", "p.txt")
    assert "vertices from 1 to 2048" in refused("shapes/1/points", b"9999", "p.vts")
    assert "'points.vts' must hold" in refused("shapes/1/points", b"x", "p.vts")
    assert "'truth.txt' maps 1 vertices" in refused("maps/1/2/truth", b"1\n", "t.txt")
    assert "not been matched" in refused("maps/2/1/truth", b"1\n", "t.txt", 404)
    assert get(matched, "/secret/maps/1/2/nothing").status_code == 404
    assert get(matched, "/secret/maps/1/2/look").status_code == 400
    wrong = ask(matched, ("PUT", "/secret/shapes/1/up", {"json": {"up": "w"}}))[0]
    assert "Expected one of x, -x" in wrong.json()["error"]


def test_the_mirror_is_settled_when_a_map_that_is_not_wrong_is_matched_again(matched):
    body = {"names": ["a", "b", "c"], "places": [3, 500, 900]}
    for number in (1, 2):
        ask(matched, ("PUT", f"/secret/shapes/{number}/landmarks", {"json": body}))
    for verdict, mirror in (("good", "no"), ("failed", "auto")):
        path = next(iter(matched_folder(matched).glob("maps/1-2.json")))
        path.write_text(json.dumps({**json.loads(path.read_text()), "verdict": verdict}))
        sent = {"json": {"source": 1, "target": 2, "landmarks": True}}
        ask(matched, ("POST", "/secret/matches", sent))
        assert wait_until_done(matched)["maps"][0]["mirror"] == mirror


def test_a_failing_job_reports_its_line(app):
    sent = {"params": {"name": "a.off"}, "content": b"OFF\n1 1 0\nnonsense"}
    ask(app, ("POST", "/secret/shapes", sent))
    state = wait_until_done(app)
    (job,) = state["jobs"]
    assert job["state"] == "failed"
    assert job["error"]
    assert "\n" not in job["error"]
    assert "1-a.off" in job["error"]
    assert state["folder"] not in job["error"]
    assert state["shapes"] == []


def test_a_job_is_cancelled_and_the_next_one_is_done(app, tmp_path):
    content = mesh_bytes(tmp_path)
    for name in ("a.off", "b.off"):
        ask(app, ("POST", "/secret/shapes", {"params": {"name": name}, "content": content}))
    assert ask(app, ("DELETE", "/secret/jobs/1", {}))[0].status_code == 200
    state = wait_until_done(app)
    assert [job["state"] for job in state["jobs"]] == ["cancelled", "done"]
    assert [shape["name"] for shape in state["shapes"]] == ["b.off"]
    missing = ask(app, ("DELETE", "/secret/jobs/99", {}))[0]
    assert "There is no job 99" in missing.json()["error"]


def test_what_cannot_be_used_is_refused(app, tmp_path):
    def refused(method, path, **more):
        answer = ask(app, (method, f"/secret/{path}", more))[0]
        assert answer.status_code == 400
        return answer.json()["error"]

    assert "There is no shape 7" in refused("DELETE", "shapes/7")
    assert "Expected JSON" in refused("PUT", "settings", content=b"{")
    assert "Expected a JSON object" in refused("PUT", "settings", content=b"[]")
    assert "Expected a model" in refused("PUT", "settings", json={"model": "../x"})
    assert "numbers of a source" in refused("POST", "matches", json={"source": "1", "target": 2})
    content = mesh_bytes(tmp_path)
    ask(app, ("POST", "/secret/shapes", {"params": {"name": "a.off"}, "content": content}))
    assert "two different shapes" in refused("POST", "matches", json={"source": 1, "target": 1})
    wait_until_done(app)
    put = lambda **body: refused("PUT", "shapes/1/landmarks", json=body)  # noqa: E731
    assert "Expected lists" in put(names=1)
    assert "as many names as vertices" in put(names=["a"], places=[])
    assert "1 to 100 characters" in put(names=[""], places=[0])
    assert "printable" in put(names=["a\nb"], places=[0])
    assert "one name" in put(names=["a", "a"], places=[0, 1])
    assert "vertices from 0 to" in put(names=["a"], places=[10**9])
    assert "ends in one of" in refused("POST", "shapes/1/landmarks?name=a.exe", content=b"x")
