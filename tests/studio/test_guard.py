import asyncio
from concurrent.futures import ThreadPoolExecutor

import pytest

pytest.importorskip("starlette", reason="the extra 'studio' is not installed")
httpx = pytest.importorskip("httpx", reason="httpx is not installed")
from starlette.responses import PlainTextResponse  # noqa: E402

from esd.studio.guard import Guard  # noqa: E402

BASE = "http://127.0.0.1:4321"


async def echo(scope, receive, send):
    await PlainTextResponse(scope["path"])(scope, receive, send)


def get(path="/secret/", **headers):
    """The answer of a guarded application that repeats the path."""
    guarded = Guard(echo, token="secret", port=4321, policy="default-src 'none'")

    async def ask():
        transport = httpx.ASGITransport(app=guarded)
        async with httpx.AsyncClient(transport=transport, base_url=BASE, headers=headers) as client:
            return await client.get(path)

    # in a thread of its own, since tests with a browser leave a loop running in this one
    with ThreadPoolExecutor(1) as thread:
        return thread.submit(lambda: asyncio.run(ask())).result()


@pytest.mark.parametrize(
    ("path", "seen"), [("/secret/", "/"), ("/secret/maps/1", "/maps/1"), ("/secret//x", "//x")]
)
def test_the_token_is_taken_off_the_path_and_headers_are_added(path, seen):
    answer = get(path)
    assert (answer.status_code, answer.text) == (200, seen)
    assert answer.headers["content-security-policy"] == "default-src 'none'"
    assert answer.headers["x-frame-options"] == "DENY"


@pytest.mark.parametrize("path", ["/", "/secret", "/secre/", "/secret1/", "//secret/", "/SECRET/"])
def test_without_the_token_nothing_is_there(path):
    answer = get(path)
    assert answer.status_code == 404
    assert "Open the address" in answer.text


def test_pages_of_other_sites_and_other_names_are_refused():
    assert get(origin=BASE).status_code == 200
    assert get(origin="http://localhost:4321", host="localhost:4321").status_code == 200
    for origin in ("https://evil.example", "null", "http://127.0.0.1:80"):
        assert get(origin=origin).status_code == 403
    assert get(**{"sec-fetch-site": "cross-site"}).status_code == 403
    # a site whose name is made to mean this machine asks by its own name
    for host in ("evil.example", "evil.example:4321", "127.0.0.1:80", ""):
        assert get(host=host).status_code == 421


def test_web_sockets_are_closed_and_the_start_is_passed_on():
    seen = []

    async def inner(scope, receive, send):
        seen.append(scope["type"])

    async def send(message):
        seen.append(message)

    guarded = Guard(inner, token="secret", port=4321, policy="")

    async def both():
        await guarded({"type": "lifespan"}, None, send)
        await guarded({"type": "websocket", "path": "/secret/"}, None, send)

    with ThreadPoolExecutor(1) as thread:
        thread.submit(lambda: asyncio.run(both())).result()
    assert seen == ["lifespan", {"type": "websocket.close", "code": 1008}]
