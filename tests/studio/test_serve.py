import concurrent.futures
import re
import socket
import subprocess
from pathlib import Path
from urllib.parse import urlsplit

import pytest

pytest.importorskip("starlette", reason="the extra 'studio' is not installed")
pytest.importorskip("uvicorn", reason="the extra 'studio' is not installed")
httpx = pytest.importorskip("httpx", reason="httpx is not installed")

from esd.common import InputError  # noqa: E402
from esd.studio.serve import new_project_folder, serve  # noqa: E402
from studio_browser import Server, write_pair  # noqa: E402


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    found = Server(tmp_path_factory.mktemp("served") / "project")
    yield found
    found.kill()


def raw(server, request: bytes) -> bytes:
    """The answer to bytes that are sent as they are."""
    place = urlsplit(server.address)
    with socket.create_connection((place.hostname, place.port), timeout=20) as connection:
        connection.sendall(request)
        answer = b""
        while part := connection.recv(65536):
            answer += part
    return answer


def test_new_folders_are_numbered(tmp_path):
    assert new_project_folder(tmp_path).name == "studio"
    (tmp_path / "studio").mkdir()
    (tmp_path / "studio-2").mkdir()
    assert new_project_folder(tmp_path).name == "studio-3"


def test_what_cannot_be_served_is_refused_before_anything_is_written(tmp_path):
    with pytest.raises(InputError, match=r"'a.png' is not a mesh file"):
        serve(tmp_path / "p", shapes=[Path("a.png")])
    with pytest.raises(InputError, match=r"There is no file 'none.off'"):
        serve(tmp_path / "p", shapes=[Path("none.off")])
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(InputError, match=r"Port .* cannot be used: .*; give another one"):
            serve(tmp_path / "q", port=taken.getsockname()[1])
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "photo.jpg").write_bytes(b"x")
    with pytest.raises(InputError, match="holds other files and no project"):
        serve(tmp_path / "other")
    assert not (tmp_path / "p").exists()
    assert not (tmp_path / "q").exists()


def test_it_listens_on_this_machine_alone(server):
    place = urlsplit(server.address)
    assert place.hostname == "127.0.0.1"
    assert len(place.path.strip("/")) >= 32  # of the token
    try:
        others = {entry[4][0] for entry in socket.getaddrinfo(socket.gethostname(), None)}
    except OSError:  # the machine does not know its own name
        others = {"127.0.0.2"}
    for address in others - {"127.0.0.1", "::1"}:
        with pytest.raises(OSError):  # refused, or no way there
            socket.create_connection((address, place.port), timeout=1).close()


def test_other_origins_and_names_are_refused_over_the_wire(server):
    place = urlsplit(server.address)
    path, own = place.path, place.netloc
    for host, more, status in (
        (own, "", 200),
        ("evil.example", "", 421),  # a name that was made to mean this machine
        (f"evil.example:{place.port}", "", 421),
        (f"127.0.0.1.evil.example:{place.port}", "", 421),
        (own, "Origin: https://evil.example\r\n", 403),
        (own, "Origin: null\r\n", 403),
        (own, f"Origin: http://{own}.evil.example\r\n", 403),
        (own, "Sec-Fetch-Site: cross-site\r\n", 403),
        (own, f"Origin: http://{own}\r\nSec-Fetch-Site: same-origin\r\n", 200),
    ):
        request = f"GET {path}state HTTP/1.1\r\nHost: {host}\r\n{more}Connection: close\r\n\r\n"
        answer = raw(server, request.encode())
        assert answer.startswith(f"HTTP/1.1 {status} ".encode()), (host, more, answer[:80])


def test_no_path_leads_out_of_the_page(server):
    place = urlsplit(server.address)
    for path in (
        "/",
        "/guess/",
        "//",
        place.path + "static/../../app.py",
        place.path + "static/..%2f..%2fapp.py",
        place.path + "static/%2e%2e/app.py",
        place.path + "static//etc/passwd",
        place.path + "../project.json",
        place.path + "maps/1/2/../../../project.json",
        place.path + "shapes/-1/view",
        place.path + "shapes/1e9/view",
        place.path + "shapes/99999999999999999999999/view",
    ):
        request = f"GET {path} HTTP/1.1\r\nHost: {place.netloc}\r\nConnection: close\r\n\r\n"
        status = raw(server, request.encode()).split(b" ", 2)[1]
        assert status in (b"404", b"400"), path


def test_what_is_too_large_is_refused_before_it_is_sent(server):
    place = urlsplit(server.address)
    head = (
        f"POST {place.path}shapes?name=a.off HTTP/1.1\r\nHost: {place.netloc}\r\n"
        f"Content-Length: {2**40}\r\nConnection: close\r\n\r\n"
    )
    assert raw(server, head.encode()).startswith(b"HTTP/1.1 413 ")
    assert not list(server.folder.glob(".esd-*"))


def test_a_hundred_requests_at_once_are_all_answered(server, tmp_path):
    content = write_pair(tmp_path)[0].read_bytes()

    def ask(k: int) -> int:
        if k % 2:
            return httpx.get(f"{server.address}state", timeout=60).status_code
        where = f"{server.address}shapes"
        return httpx.post(
            where, params={"name": f"m{k}.off"}, content=content, timeout=60
        ).status_code

    with concurrent.futures.ThreadPoolExecutor(100) as many:
        answers = list(many.map(ask, range(100)))
    assert answers == [201, 200] * 50
    shapes = httpx.get(f"{server.address}state").json()["shapes"]
    assert {shape["name"] for shape in shapes} == {f"m{k}.off" for k in range(0, 100, 2)}
    for shape in shapes:
        httpx.delete(f"{server.address}shapes/{shape['number']}")


def test_an_upload_that_is_broken_off_leaves_nothing(server):
    place = urlsplit(server.address)
    head = (
        f"POST {place.path}shapes?name=a.off HTTP/1.1\r\nHost: {place.netloc}\r\n"
        "Content-Length: 100000\r\n\r\nOFF\n"
    )
    with socket.create_connection((place.hostname, place.port)) as connection:
        connection.sendall(head.encode())
    names = [s["name"] for s in httpx.get(f"{server.address}state").json()["shapes"]]
    assert "a.off" not in names
    for _ in range(100):
        if not list(server.folder.glob(".esd-*")):
            break
        httpx.get(f"{server.address}state")
    assert not list(server.folder.glob(".esd-*"))


def test_interrupting_it_ends_it_without_a_word(tmp_path):
    for times in (1, 2):
        server = Server(tmp_path / str(times), stderr=subprocess.PIPE)
        assert server.interrupt(times=times) == ""


def test_the_page_names_no_other_site(server):
    page = httpx.get(server.address)
    assert not re.search(r"https?://", page.text)
    assert "connect-src 'self'" in page.headers["content-security-policy"]
