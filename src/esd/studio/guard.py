"""Who may talk to the studio: requests that know its token, from its own page, by its own name."""

from __future__ import annotations

import hmac

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

_HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "X-Frame-Options": "DENY",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


class Guard:
    """An application that passes on what may be answered, without the token in the path.

    Other sites' pages are kept out by the token, which they do not know; by the names under which
    the studio is asked for (a site may let its own name mean this machine: DNS rebinding); and by
    what browsers say of the page that asks.

    Parameters
    ----------
    inner
        The application that is guarded.
    token
        First part of every path.
    port
        Where the studio listens.
    policy
        Content security policy of all answers.
    """

    def __init__(self, inner: ASGIApp, *, token: str, port: int, policy: str) -> None:
        self._inner = inner
        self._token = token
        self._hosts = {f"{name}:{port}" for name in ("127.0.0.1", "localhost")}
        self._origins = {f"http://{host}" for host in self._hosts}
        self._policy = policy

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or refuse it."""
        if scope["type"] == "lifespan":
            await self._inner(scope, receive, send)
            return
        if scope["type"] != "http":  # the studio has no web sockets
            await send({"type": "websocket.close", "code": 1008})
            return
        refusal = self._refusal(scope)
        if refusal is not None:
            await refusal(scope, receive, send)
            return

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                headers.update({**_HEADERS, "Content-Security-Policy": self._policy})
            await send(message)

        path = "/" + scope["path"].split("/", 2)[2]
        await self._inner(
            {**scope, "path": path, "raw_path": path.encode()}, receive, send_with_headers
        )

    def _refusal(self, scope: Scope) -> PlainTextResponse | None:
        headers = Headers(scope=scope)
        if headers.get("host", "") not in self._hosts:
            return PlainTextResponse("This is not the host that you asked for.", 421)
        origin = headers.get("origin")
        site = headers.get("sec-fetch-site")
        if (origin is not None and origin not in self._origins) or site not in (
            None,
            "same-origin",
            "none",
        ):
            return PlainTextResponse("Pages of other sites may not ask for this.", 403)
        parts = scope["path"].split("/", 2)
        given = parts[1] if len(parts) == 3 else ""
        if not hmac.compare_digest(given.encode(), self._token.encode()):
            return PlainTextResponse("Open the address that esd studio printed.", 404)
        return None
