"""The server of one project: who may ask, routes, and how it starts and ends."""

from __future__ import annotations

import asyncio
import hmac
import os
import re
import secrets
import signal
import socket
import stat
import threading
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress
from http.cookies import CookieError, SimpleCookie
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO
from urllib.parse import parse_qs

import uvicorn
from starlette.applications import Starlette
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, JSONResponse, PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket
from uvicorn.protocols.http.h11_impl import H11Protocol

from ambrose.annexes.workbench import blocks, project as uploads
from ambrose.annexes.workbench.blocks import Refusal
from ambrose.annexes.workbench.desk import Desk
from ambrose.annexes.workbench.jobs import Jobs
from ambrose.annexes.workbench.live import THREAD, Clock, LiveRoom
from ambrose.annexes.workbench.project import KINDS, Project
from ambrose.annexes.workbench.screens import TITLES
from ambrose.core.checks import AmbroseError, InvalidInput
from ambrose.core.processes import names_of
from ambrose.machine.ordinary_file import claimed

# Who may ask: one wrapper around the whole server looks at every request and every socket.
#
# 1. Host: only the address that the server was started on, so that no name of a stranger that
#    resolves to 127.0.0.1 reaches it (DNS rebinding).
# 2. Origin: what changes something, and every socket, comes from a page of this server; browsers
#    state it on both (RFC 6454; Fetch, "Origin" and "Sec-Fetch-Site").
# 3. Token: the printed address holds one that is good once and is exchanged for a cookie that
#    scripts cannot read and other sites' requests do not carry (SameSite=Strict). The next is
#    printed then.
# 4. Size: a body above its limit is refused, also one that does not state its length.
#
# What goes out forbids scripts, styles and frames from anywhere but here, and scripts in the text.


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
        app: ASGIApp,
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


if TYPE_CHECKING:
    import h11

_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".svg": "image/svg+xml",
}
ALL_JOBS = blocks.content([], jobs=["*"])  # what was started on the other screens
_SERVED = (
    "another workbench serves this folder; open the address that it printed last, or end it first"
)
_MESSAGE = 65_536  # bytes of a socket's message
_LINES, _LINE = 100, 8000  # headers of a socket's handshake, bytes of each
_CONTROL = re.compile(rb"[\x00-\x08\x0a-\x1f\x7f]").search
_STRANGERS = 100  # connections that have asked for nothing yet
_ENDS = (signal.SIGINT, signal.SIGTERM)
_PATIENCE = 2  # [s] for open requests when the server ends


def build(
    project: Project,
    hosts: list[str],
    announce: Callable[[str], None],
    desk: Desk | None = None,
    clock: Clock | None = None,
) -> ASGIApp:
    """The whole server as an ASGI application behind its guard.

    hosts: "address:port" that it answers to; announce(token): told the first token and every next;
    desk: where screens are computed (None: a process beside it); clock: of the live rig (None: this
    computer's).
    """
    live = LiveRoom(project, clock)
    jobs = Jobs(project)
    desk = desk or Desk(project)

    async def page(request: Request) -> Response:
        return _static("index.html")

    async def static(request: Request) -> Response:
        return _static(request.path_params["name"])

    async def state(request: Request) -> Response:
        return JSONResponse(await asyncio.to_thread(_state, project))

    async def screen(request: Request) -> Response:
        name, action = request.path_params["name"], request.path_params.get("action", "")
        given = await _content(request)
        await live.settled()
        told = ALL_JOBS if name == "jobs" else await desk.ask(name, action, given)
        if told["whole"]:
            shown = [*told["blocks"], *jobs.shown(told["jobs"])]
            if told["jobs"] and "verdict" not in [block["key"] for block in shown]:
                shown.insert(0, jobs.verdict(told["jobs"]))
            told = {**told, "blocks": shown, "ended": jobs.ended()}
        return JSONResponse(told)

    async def file(request: Request) -> Response:
        path = project.path(request.path_params["kind"], request.path_params["name"])
        return await asyncio.to_thread(_file, path)

    async def take(request: Request) -> Response:
        kind, name = request.path_params["kind"], request.path_params["name"]
        path = await asyncio.to_thread(uploads.place, project, kind, name)
        await uploads.receive(path, request.stream())
        return JSONResponse({"file": path.name})

    async def list_jobs(request: Request) -> Response:
        found = jobs.shown((await _content(request)).get("of"))
        return JSONResponse({"blocks": found, "ended": jobs.ended()})

    async def start_job(request: Request) -> Response:
        jobs.start(await _content(request))
        return JSONResponse({})

    async def cancel_job(request: Request) -> Response:
        await jobs.cancel((await _content(request)).get("name"))
        return JSONResponse({})

    async def watch(socket: WebSocket) -> None:
        with suppress(asyncio.CancelledError):  # the server ends
            await live.join(socket)

    @asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        beginning = asyncio.create_task(desk.begin())
        yield
        beginning.cancel()
        desk.process.close()
        await asyncio.gather(jobs.close(), live.close())

    routes: list[Route | WebSocketRoute] = [
        Route("/", page),
        Route("/static/{name}", static),
        Route("/api/state", state),
        Route("/api/screens/{name}", screen, methods=["POST"]),
        Route("/api/screens/{name}/{action}", screen, methods=["POST"]),
        Route("/files/{kind}/{name}", file),
        Route("/api/files/{kind}/{name}", take, methods=["PUT"]),
        Route("/api/jobs", list_jobs, methods=["POST"]),
        Route("/api/jobs/start", start_job, methods=["POST"]),
        Route("/api/jobs/cancel", cancel_job, methods=["POST"]),
        WebSocketRoute("/live", watch),
    ]
    refusals: dict[Any, Callable[[Request, Exception], Awaitable[Response]]] = {
        AmbroseError: _refused,
        Refusal: _refused,
        ClientDisconnect: _cut,
    }
    app = Starlette(routes=routes, lifespan=lifespan, exception_handlers=refusals)
    app.router.redirect_slashes = False
    return Guard(app, hosts, announce, lambda path: uploads.limit(path) or BODY)


async def _refused(request: Request, error: Exception) -> Response:
    told = error.content if isinstance(error, Refusal) else {"error": str(error)}
    return JSONResponse(told, status_code=400)


async def _cut(request: Request, error: Exception) -> Response:
    return PlainTextResponse("the request ended early, or was too large\n", status_code=413)


async def _content(request: Request) -> dict[str, Any]:
    """The JSON object of a request. Raises InvalidInput."""
    try:
        content = await request.json()
    except (ValueError, RecursionError):
        content = None
    if not isinstance(content, dict):
        raise InvalidInput("the request is not a JSON object; reload the page")
    return content


def _static(name: str) -> Response:
    """A file that comes with the package; it is looked up among those there are."""
    known = {item.name: item for item in files(__package__).joinpath("static").iterdir()}
    if name not in known or Path(name).suffix not in _TYPES:
        return PlainTextResponse("there is no such file\n", status_code=404)
    return Response(known[name].read_bytes(), media_type=_TYPES[Path(name).suffix])


class _Opened(FileResponse):
    """A file that is open: what goes out is what was looked at, whatever its name means by then."""

    def __init__(self, file: BinaryIO, **more: Any) -> None:
        number = file.fileno()
        super().__init__(f"/dev/fd/{number}", stat_result=os.fstat(number), **more)
        self._file = file

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        with self._file:
            await super().__call__(scope, receive, send)


def _file(path: Path) -> Response:
    """A file of the project: pages of results run alone, all others are downloads."""
    try:
        file = _open(path)
    except OSError:
        return PlainTextResponse("there is no such file\n", status_code=404)
    if path.suffix.lower() == ".html":
        headers = {"content-security-policy": PAGE_POLICY}
        return _Opened(file, media_type=_TYPES[".html"], headers=headers)
    return _Opened(file, media_type="application/octet-stream", filename=path.name)


def _open(path: Path) -> BinaryIO:
    """An ordinary file of a folder of the project, neither of them a link. Raises OSError."""
    folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:  # a pipe is not waited for
        number = os.open(path.name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK, dir_fd=folder)
    finally:
        os.close(folder)
    if not stat.S_ISREG(os.fstat(number).st_mode):
        os.close(number)
        raise FileNotFoundError(path.name)
    return os.fdopen(number, "rb")


def _state(project: Project) -> dict[str, Any]:
    """What stands in the folder, for every screen."""
    return {
        "folder": project.root.name,
        "machine": project.machine.is_file(),
        "screens": list(TITLES.items()),
        "files": {kind: project.names(kind) for kind in KINDS},
    }


def serve(project: Project, listener: socket.socket, announce: Callable[[str], None]) -> None:
    """Serve a project until the process is asked to end (SIGINT, SIGTERM).

    announce(address): told the address to open, and every next one. Raises InvalidInput where
    another server has the project.
    """
    hosts = names_of(listener)
    # its jobs are this server's alone: another one would take them for stopped
    with claimed(project.root / "jobs", "jobs", _SERVED):
        app = build(project, hosts, lambda token: announce(f"http://{hosts[0]}/?token={token}"))
        asyncio.run(_Server(settings(app)).serve([listener]))
    if any(thread.name.startswith(THREAD) for thread in threading.enumerate()):
        os._exit(0)  # a rig that is compiled cannot be told to stop, and nothing is lost with it


def settings(app: ASGIApp) -> uvicorn.Config:
    """How uvicorn serves the application."""
    return uvicorn.Config(
        app,
        http=_Http,
        log_level="warning",
        access_log=False,
        proxy_headers=False,
        server_header=False,
        ws_max_size=_MESSAGE,
        ws_per_message_deflate=False,
        ws_ping_interval=10.0,
        ws_ping_timeout=30.0,  # a rig that is compiled leaves little time for answers
        timeout_graceful_shutdown=_PATIENCE,
        lifespan="on",
        backlog=_STRANGERS,
    )


class _Http(H11Protocol):
    """uvicorn's, which also answers a handshake that the reader of sockets leaves unanswered, and
    has room for a new connection whoever holds others open without a word.
    """

    @property
    def _silent(self) -> dict[_Http, asyncio.Transport]:
        """The connections that have not asked for anything yet, the oldest first."""
        found: dict[_Http, asyncio.Transport] = self.app_state.setdefault("silent", {})
        return found

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._silent[self] = transport
        if len(self._silent) > _STRANGERS:
            self._silent.pop(next(iter(self._silent))).close()

    def connection_lost(self, exc: Exception | None) -> None:
        self._silent.pop(self, None)
        super().connection_lost(exc)

    def handle_events(self) -> None:
        super().handle_events()
        if self.headers is not None:  # a request: who has no token is answered and goes
            self._silent.pop(self, None)

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        lines = [event.target, *(value for _, value in event.headers)]
        if len(lines) > _LINES or any(len(line) > _LINE or _CONTROL(line) for line in lines):
            self.send_400_response("the handshake is too long or contains control characters")
        else:
            super().handle_websocket_upgrade(event)


class _Server(uvicorn.Server):
    """uvicorn's, which ends without passing the signal on."""

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """SIGINT and SIGTERM end the server, and the process in order."""

        def end(number: int, frame: Any) -> None:
            self.should_exit = True

        before = {number: signal.signal(number, end) for number in _ENDS}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
