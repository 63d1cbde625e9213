"""The server of one project: routes, and how it starts and ends."""

from __future__ import annotations

import asyncio
import os
import re
import signal
import socket
import stat
import threading
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import uvicorn
from starlette.applications import Starlette
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, JSONResponse, PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import Receive, Scope, Send
from starlette.websockets import WebSocket
from uvicorn.protocols.http.h11_impl import H11Protocol

from ambrose.annexes.workbench import blocks
from ambrose.annexes.workbench import project as uploads
from ambrose.annexes.workbench.blocks import Refusal
from ambrose.annexes.workbench.desk import Desk
from ambrose.annexes.workbench.guard import BODY, PAGE_POLICY, App, Guard
from ambrose.annexes.workbench.jobs import Jobs
from ambrose.annexes.workbench.live import THREAD, Clock, LiveRoom
from ambrose.annexes.workbench.project import KINDS, Project
from ambrose.annexes.workbench.screens import TITLES
from ambrose.core.checks import AmbroseError, InvalidInput
from ambrose.core.processes import names_of
from ambrose.machine.ordinary_file import claimed

if TYPE_CHECKING:
    import h11

_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".svg": "image/svg+xml",
}
ALL_JOBS = blocks.content(
    [blocks.words("lead", "What was started on the other screens, the newest first.")], jobs=["*"]
)
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
) -> App:
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


def settings(app: App) -> uvicorn.Config:
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
            self.send_400_response("the handshake is too long or holds control characters")
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
