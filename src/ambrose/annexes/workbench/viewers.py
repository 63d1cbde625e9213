"""Who looks at the live rig: one rig, any number of pages, each at the pace that it can take.

A page confirms a frame before it gets the next one, which is then the newest there is: late frames
are dropped and never queued; what was sampled in them goes with the next, up to a spectrum's
length. With the last page the rig stands still; it goes on from there when a page comes back.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from typing import Any

import numpy as np
from starlette.websockets import WebSocket, WebSocketDisconnect

from ambrose.annexes.workbench.clock import Clock
from ambrose.annexes.workbench.live import SAMPLES, TURNED, LiveSession, packed, starting_form
from ambrose.annexes.workbench.project import Project
from ambrose.core.checks import AmbroseError
from ambrose.core.presentation import json_text
from ambrose.machine.json_text import parse_json

FRAMES = 40.0  # a second
THREAD = "live-rig"
_LONGEST = 4000  # characters of what a page says
_WAITING = 64  # orders of a page that are not done yet
_UNSENT = 20  # frames of which samples are kept for a page that is late


class _Viewer:
    """One page: the newest frame waits until the page has confirmed the one before, and what it
    asks for until the rig has time.
    """

    def __init__(self, socket: WebSocket) -> None:
        self.socket = socket
        self.confirmed = asyncio.Event()
        self.confirmed.set()
        self.fresh = asyncio.Event()
        self.head: Mapping[str, Any] = {}
        self.samples: list[np.ndarray] = []
        self.orders: list[Any] = []
        self.ordered = asyncio.Event()

    def offer(self, head: Mapping[str, Any], samples: np.ndarray) -> None:
        """A frame in place of one that was not sent yet, whose samples go with it."""
        self.head = head
        self.samples = [*self.samples[-_UNSENT:], samples]
        self.fresh.set()

    def forget(self) -> None:
        """What was not sent yet is of another rig."""
        self.samples = []
        self.fresh.clear()

    async def send_frames(self) -> None:
        """Until the socket breaks."""
        while True:
            await self.confirmed.wait()
            await self.fresh.wait()
            if not self.samples:  # forgotten since it was called
                continue
            head, samples = self.head, np.concatenate(self.samples)[-SAMPLES:]
            self.forget()
            self.confirmed.clear()
            await self.socket.send_bytes(packed(head, samples))

    async def tell(self, **content: Any) -> None:
        """A message in words or data, beside the frames."""
        await self.socket.send_text(json_text(content))

    async def listen(self) -> None:
        """Until the page leaves: what it says is written down, of a slider the newest alone."""
        while True:
            said = await self.socket.receive()
            if said["type"] == "websocket.disconnect":
                return
            text = said.get("text") or ""
            if text == "ok":
                self.confirmed.set()
            elif len(self.orders) < _WAITING:
                self._write_down(_read(text))
            else:
                await self.tell(refused="the rig is busy: wait until it has done what it was told")

    def _write_down(self, message: Any) -> None:
        """An order behind the others; a slider's replaces the one before it, unless something else
        was asked for in between.
        """
        name = _wish(message)
        for i in range(len(self.orders) - 1, -1, -1):
            before = _wish(self.orders[i])
            if name not in TURNED or before not in TURNED:
                break
            if before == name:
                del self.orders[i]
                break
        self.orders.append(message)
        self.ordered.set()

    async def next_order(self) -> Any:
        """What the page asked for first of what is not done yet; None: no message of this page."""
        while not self.orders:
            self.ordered.clear()
            await self.ordered.wait()
        return self.orders.pop(0)


def _read(text: str) -> Any:
    """A message of a page, None where it is none."""
    try:
        return parse_json(text, "reload the page") if len(text) <= _LONGEST else None
    except (ValueError, RecursionError):
        return None


def _wish(message: Any) -> str:
    """The name of what a page asks for, "" where it has none."""
    wanted = message.get("do") if isinstance(message, dict) else None
    return wanted if isinstance(wanted, str) else ""


class LiveRoom:
    """The one live rig of a server and the pages that look at it, by a clock (None: this
    computer's).
    """

    def __init__(self, project: Project, clock: Clock | None = None) -> None:
        self._project = project
        self._clock = clock or Clock()
        self._viewers: list[_Viewer] = []
        self._session: LiveSession | None = None
        # the rig is no matter for several threads: one thread builds it, advances it, knocks it
        self._thread = ThreadPoolExecutor(1, thread_name_prefix=THREAD)
        self._drive: asyncio.Task[None] | None = None
        # controller and beginning of the rig that is built, and of the one that is built after it
        self._underway: tuple[str, str] | None = None
        self._wanted: tuple[str, str] | None = None
        self._build: asyncio.Task[None] | None = None

    async def join(self, socket: WebSocket) -> None:
        """A page looks on until it leaves."""
        await socket.accept()
        viewer = _Viewer(socket)
        self._viewers.append(viewer)
        parts = (viewer.send_frames(), viewer.listen(), self._obey(viewer))
        tasks = [asyncio.create_task(part) for part in parts]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._viewers.remove(viewer)
            for task in tasks:
                task.cancel()
            ended = await asyncio.gather(*tasks, return_exceptions=True)
            if not self._viewers:
                await self._stop_driving()
        # it left, also while it was told something; else the socket ends with a mistake of ours,
        # and the page comes back
        left = (WebSocketDisconnect, RuntimeError, asyncio.CancelledError)
        for error in ended:
            if isinstance(error, Exception) and not isinstance(error, left):
                raise error

    async def close(self) -> None:
        """The server ends: the rig stops, a record is finished; a first rig is not waited for."""
        if self._build is not None:
            self._build.cancel()
        await self._stop_driving()
        self._thread.shutdown(wait=self._session is not None)

    async def settled(self) -> None:
        """Once a rig that is there has done what it was told, and its record is a file."""
        if self._build is None or self._build.done():
            await self._in_thread(int)

    async def _obey(self, viewer: _Viewer) -> None:
        """The page is shown the rig, and what it asks for is done, one after the other."""
        if self._underway is not None:
            await viewer.tell(building=True)
        if self._session is not None:
            await viewer.tell(**await self._in_thread(self._described))
            self._ensure_driven()
        else:
            await self._start(self._underway or ("", "levitated"))
        while True:
            message = await viewer.next_order()
            if message is None:
                await viewer.tell(refused="that is no message of this page; reload it")
            elif _wish(message) == "restart":
                given = (message.get("controller", ""), message.get("initial", "levitated"))
                await self._start((str(given[0]), str(given[1])))
            else:
                await self._do(viewer, message)

    async def _do(self, viewer: _Viewer, message: Any) -> None:
        session = self._session
        if session is None:
            await viewer.tell(refused="there is no rig yet; start it first")
            return
        try:
            await self._in_thread(session.do, message)
        except AmbroseError as error:
            await viewer.tell(refused=str(error))

    async def _start(self, wanted: tuple[str, str]) -> None:
        """Once there is a new rig with a controller and a beginning, or a reason why not. What is
        asked for while one is built, is built after it, the newest alone; the same is not built
        twice.
        """
        self._wanted = None if wanted == self._underway else wanted
        if self._build is None or self._build.done():
            self._build = asyncio.create_task(self._build_rigs())
        await asyncio.shield(self._build)  # also for others than the page that asked

    async def _build_rigs(self) -> None:
        while self._wanted is not None:
            self._underway, self._wanted = self._wanted, None
            try:
                await self._build_rig(*self._underway)
            finally:
                self._underway = None
        self._ensure_driven()

    async def _build_rig(self, controller: str, initial: str) -> None:
        """A new rig in place of the one that was there, or the reason why there is none."""
        await self._stop_driving()
        await self._tell_all(building=True)
        make = (LiveSession, self._project, controller, initial, self._clock)
        try:
            self._session = await self._in_thread(*make)
            described = await self._in_thread(self._described)
        except Exception as error:  # the one before goes on
            known = isinstance(error, AmbroseError)
            words = str(error) if known else f"no rig, by a mistake of the program: {error!r}"
            await self._tell_all(failed=words, start=starting_form(self._project))
        else:
            for viewer in self._viewers:
                viewer.forget()
            await self._tell_all(**described)

    def _described(self) -> dict[str, Any]:
        return {} if self._session is None else {"rig": self._session.describe()}

    async def _tell_all(self, **content: Any) -> None:
        for viewer in list(self._viewers):
            with suppress(WebSocketDisconnect, RuntimeError):
                await viewer.tell(**content)

    def _ensure_driven(self) -> None:
        """The rig goes on where somebody looks, unless another one is built."""
        driven = self._drive is not None and not self._drive.done()
        if not driven and self._underway is None and self._session is not None and self._viewers:
            self._drive = asyncio.create_task(self._advance(self._session))

    async def _stop_driving(self) -> None:
        drive, self._drive = self._drive, None
        if drive is not None:
            drive.cancel()
            await asyncio.wait([drive])
        if self._session is not None:
            try:
                await self._in_thread(self._session.pause)
            except AmbroseError as error:  # the record cannot be finished
                await self._tell_all(refused=str(error))

    async def _advance(self, session: LiveSession) -> None:
        """Frame after frame; what took too long is not made up for."""
        due = self._clock.now()
        while True:
            try:
                frame = await self._in_thread(session.frame)
            except AmbroseError as error:
                await self._tell_all(failed=str(error))
                return
            except Exception as error:
                await self._tell_all(failed=f"the rig stopped by a mistake of its own: {error!r}")
                raise
            for viewer in self._viewers:
                viewer.offer(*frame)
            due = max(due + 1.0 / FRAMES, self._clock.now())
            await self._clock.until(due)

    async def _in_thread(self, function: Callable[..., Any], *arguments: Any) -> Any:
        return await asyncio.get_running_loop().run_in_executor(self._thread, function, *arguments)
