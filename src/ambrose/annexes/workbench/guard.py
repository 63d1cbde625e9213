"""Who may ask: one wrapper around the whole server looks at every request and every socket.

1. Host: only the address that the server was started on, so that no name of a stranger that
   resolves to 127.0.0.1 reaches it (DNS rebinding).
2. Origin: what changes something, and every socket, comes from a page of this server; browsers
   state it on both (RFC 6454; Fetch, "Origin" and "Sec-Fetch-Site").
3. Token: the printed address holds one that is good once and is exchanged for a cookie that scripts
   cannot read and other sites' requests do not carry (SameSite=Strict). The next is printed then.
4. Size: a body above its limit is refused, also one that does not state its length.

What goes out forbids scripts, styles and frames from anywhere but here, and scripts in the text.
"""

from __future__ import annotations

import hmac
import secrets
from collections.abc import Awaitable, Callable, Iterable, MutableMapping
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs

Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
App = Callable[[Message, Receive, Send], Awaitable[None]]

BODY = 1_000_000  # bytes of an ordinary request
_METHODS = ("GET", "HEAD", "POST", "PUT", "DELETE")
_READS = ("GET", "HEAD")
_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; "
    "connect-src 'self'; frame-src 'self'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'"
)
# a page of results brings its scripts in its text: it runs, alone, and reaches nothing here
PAGE_POLICY = (
    "sandbox allow-scripts; default-src 'none'; script-src 'unsafe-inline'; "
    "style-src 'unsafe-inline'; img-src data: blob:; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'self'"
)
_HEADERS = {
    b"x-content-type-options": b"nosniff",
    b"referrer-policy": b"no-referrer",
    b"cache-control": b"no-store",
    b"cross-origin-opener-policy": b"same-origin",
    b"cross-origin-resource-policy": b"same-origin",
}


class Guard:
    """The server ``app`` behind its checks.

    hosts: "address:port" that it answers to; limit(path): the largest body [bytes] of a path;
    announce(token): called with every new token, the first one included.
    """

    def __init__(
        self,
        app: App,
        hosts: Iterable[str],
        announce: Callable[[str], None],
        limit: Callable[[str], int] = lambda path: BODY,
    ) -> None:
        self._app = app
        self._hosts = frozenset(hosts)
        self._announce = announce
        self._limit = limit
        port = min(self._hosts).rpartition(":")[2]
        self._cookie = f"ambrose-{port}"
        self._sessions: list[bytes] = []
        self._token = ""
        self.renew()

    def renew(self) -> None:
        """A new token, good once; the one before is good no more."""
        self._token = secrets.token_urlsafe(32)
        self._announce(self._token)

    async def __call__(self, scope: Message, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        headers = _Headers(scope.get("headers", ()))
        session = self._enter(scope, headers)
        refusal = self._refusal(scope, headers, session)
        if refusal is not None and scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": 4403, "reason": refusal[1]})
        elif refusal is not None:
            await _refuse(send, *refusal)
        elif scope["type"] == "websocket":
            await self._app(scope, receive, send)
        else:
            limit = self._limit(scope["path"])
            await self._app(scope, _counted(receive, limit), _dressed(send, session))

    def _enter(self, scope: Message, headers: _Headers) -> bytes:
        """The cookie of a browser that comes with the printed address, once; else b""."""
        if scope["type"] != "http" or scope["method"] != "GET" or scope["path"] != "/":
            return b""
        given = parse_qs(scope.get("query_string", b"").decode("latin-1")).get("token", [])
        right_place = headers.one(b"host") in self._hosts
        if not right_place or len(given) != 1 or not _same(given[0], self._token):
            return b""
        session = secrets.token_urlsafe(32)
        self._sessions.append(session.encode())
        self.renew()
        return f"{self._cookie}={session}; Path=/; HttpOnly; SameSite=Strict".encode()

    def _refusal(self, scope: Message, headers: _Headers, session: bytes) -> tuple[int, str] | None:
        """Status and reason, or None where the request may pass."""
        method = scope.get("method", "GET")
        host = headers.one(b"host")
        if host not in self._hosts:
            return 421, "this server does not go by that name; use the address it printed"
        if method not in _METHODS:
            return 405, "this server knows no such method"
        if scope["type"] == "websocket" and scope.get("scheme", "ws") != "ws":
            return 403, "the socket comes by another scheme"
        origin = headers.one(b"origin")
        alters = scope["type"] == "websocket" or method not in _READS
        if origin != f"http://{host}" and (alters or origin is not None):
            return 403, "the request does not come from a page of this server"
        site = headers.one(b"sec-fetch-site")
        if not session and site not in {None, "same-origin", "none"}:
            return 403, "the request comes from a page of another site"
        if not session and not self._known(headers):
            return 401, "open the address that the server printed last; it is good once"
        length = headers.one(b"content-length") or "0"
        if not length.isdecimal() or int(length[:20]) > self._limit(scope["path"]):
            return 413, f"more than {self._limit(scope['path'])} bytes are not taken here"
        return None

    def _known(self, headers: _Headers) -> bool:
        """Whether the cookie is one that was given out."""
        try:
            cookies = SimpleCookie(headers.one(b"cookie") or "")
        except CookieError:
            return False
        morsel = cookies.get(self._cookie)
        value = "" if morsel is None else morsel.value
        # every one is compared, so that the time says nothing
        return any([hmac.compare_digest(value.encode(), known) for known in self._sessions])


class _Headers:
    """Headers of a request; one that stands twice is as good as a wrong one."""

    def __init__(self, pairs: Iterable[tuple[bytes, bytes]]) -> None:
        self._values: dict[bytes, str] = {}
        for name, value in pairs:
            key = bytes(name).lower()
            twice = key in self._values
            self._values[key] = "\0twice" if twice else bytes(value).decode("latin-1")

    def one(self, name: bytes) -> str | None:
        """The value, or None where there is none."""
        return self._values.get(name)


def _same(given: str, token: str) -> bool:
    return hmac.compare_digest(given.encode(), token.encode())


def _counted(receive: Receive, limit: int) -> Receive:
    """``receive`` that ends a body which grows beyond its limit as if the sender had left."""
    count = 0

    async def counted() -> Message:
        nonlocal count
        message = await receive()
        count += len(message.get("body", b""))
        return {"type": "http.disconnect"} if count > limit else message

    return counted


def _dressed(send: Send, cookie: bytes) -> Send:
    """``send`` with the headers that every answer has, and the cookie of a new session."""

    async def dressed(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = list(message.get("headers", ()))
            present = {name for name, _ in headers}
            wanted = {b"content-security-policy": _POLICY.encode(), **_HEADERS}
            headers += [pair for pair in wanted.items() if pair[0] not in present]
            if cookie:
                headers.append((b"set-cookie", cookie))
            message = {**message, "headers": headers}
        await send(message)

    return dressed


async def _refuse(send: Send, status: int, reason: str) -> None:
    headers = [(b"content-type", b"text/plain; charset=utf-8"), (b"connection", b"close")]
    answer = _dressed(send, b"")
    await answer({"type": "http.response.start", "status": status, "headers": headers})
    await answer({"type": "http.response.body", "body": f"ambrose: {reason}\n".encode()})
