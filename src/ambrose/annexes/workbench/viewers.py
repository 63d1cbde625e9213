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

from ambrose.annexes.workbench.live import SAMPLES, LiveSession, packed, starting_form
from ambrose.annexes.workbench.project import Project
from ambrose.core.checks import AmbroseError
from ambrose.core.presentation import json_text
from ambrose.machine.json_text import parse_json

FRAMES = 40.0  # a second
THREAD = "live-rig"
_LONGEST = 4000  # characters of what a page says
_UNSENT = 20  # frames of which samples are kept for a page that is late


class _Viewer:
    """One page: the newest frame waits until the page has confirmed the one before."""

    def __init__(self, socket: WebSocket) -> None:
        self.socket = socket
        self.confirmed = asyncio.Event()
        self.confirmed.set()
        self.fresh = asyncio.Event()
        self.head: Mapping[str, Any] = {}
        self.samples: list[np.ndarray] = []

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
            self.fresh.clear()
            self.confirmed.clear()
            samples = np.concatenate(self.samples)[-SAMPLES:]
            self.samples = []
            await self.socket.send_bytes(packed(self.head, samples))

    async def tell(self, **content: Any) -> None:
        """A message in words or data, beside the frames."""
        await self.socket.send_text(json_text(content))


class LiveRoom:
    """The one live rig of a server and the pages that look at it."""

    def __init__(self, project: Project) -> None:
        self._project = project
        self._viewers: list[_Viewer] = []
        self._session: LiveSession | None = None
        # the rig is no matter for several threads: one thread builds it, advances it, knocks it
        self._thread = ThreadPoolExecutor(1, thread_name_prefix=THREAD)
        self._drive: asyncio.Task[None] | None = None
        self._building = asyncio.Lock()
        self._starting = False

    async def join(self, socket: WebSocket) -> None:
        """A page looks on until it leaves."""
        await socket.accept()
        viewer = _Viewer(socket)
        self._viewers.append(viewer)
        sender = asyncio.create_task(viewer.send_frames())
        try:
            if self._starting:
                await viewer.tell(building=True)
            if self._session is not None:
                await viewer.tell(**await self._in_thread(self._described))
            else:
                await self._start_first()
            await self._listen(viewer)
        except (WebSocketDisconnect, RuntimeError):  # it left, also while it was told something
            pass
        finally:
            sender.cancel()
            with suppress(asyncio.CancelledError, Exception):
                await sender
            self._viewers.remove(viewer)
            if not self._viewers:
                await self._stop_driving()

    async def close(self) -> None:
        """The server ends: the rig stops, a record is finished; a first rig is not waited for."""
        await self._stop_driving()
        self._thread.shutdown(wait=self._session is not None)

    async def settled(self) -> None:
        """Once a rig that is there has done what it was told, and its record is a file."""
        if not self._starting:
            await self._in_thread(int)

    async def _listen(self, viewer: _Viewer) -> None:
        self._ensure_driven()
        while True:
            said = await viewer.socket.receive()
            if said["type"] == "websocket.disconnect":
                return
            text = said.get("text") or ""
            if text == "ok":
                viewer.confirmed.set()
                continue
            try:
                if len(text) > _LONGEST:
                    raise ValueError
                message = parse_json(text, "reload the page")
            except (ValueError, RecursionError):
                await viewer.tell(refused="that is no message of this page; reload it")
                continue
            if isinstance(message, dict) and message.get("do") == "restart":
                await self._start(message)
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

    async def _start_first(self) -> None:
        """A rig for the first page; one that comes while it is built waits for the same."""
        async with self._building:
            if self._session is None:
                await self._start({})

    async def _start(self, message: dict[str, Any]) -> None:
        """A new rig in place of the one that was there, or the reason why there is none."""
        await self._stop_driving()
        await self._tell_all(building=True)
        self._starting = True
        controller, initial = message.get("controller", ""), message.get("initial", "levitated")
        try:
            self._session = await self._in_thread(
                LiveSession, self._project, str(controller), str(initial)
            )
            described = await self._in_thread(self._described)
        except AmbroseError as error:
            # the one before goes on
            await self._tell_all(failed=str(error), start=starting_form(self._project))
        else:
            for viewer in self._viewers:
                viewer.forget()
            await self._tell_all(**described)
        finally:
            self._starting = False
        self._ensure_driven()

    def _described(self) -> dict[str, Any]:
        return {} if self._session is None else {"rig": self._session.describe()}

    async def _tell_all(self, **content: Any) -> None:
        for viewer in list(self._viewers):
            with suppress(WebSocketDisconnect, RuntimeError):
                await viewer.tell(**content)

    def _ensure_driven(self) -> None:
        if self._drive is None and self._session is not None and self._viewers:
            self._drive = asyncio.create_task(self._advance(self._session))

    async def _stop_driving(self) -> None:
        drive, self._drive = self._drive, None
        if drive is not None:
            drive.cancel()
            with suppress(asyncio.CancelledError):
                await drive
        if self._session is not None:
            await self._in_thread(self._session.pause)

    async def _advance(self, session: LiveSession) -> None:
        """Frame after frame; what took too long is not made up for."""
        clock = asyncio.get_running_loop()
        due = clock.time()
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
            due = max(due + 1.0 / FRAMES, clock.time())
            await asyncio.sleep(due - clock.time())

    async def _in_thread(self, function: Callable[..., Any], *arguments: Any) -> Any:
        return await asyncio.get_running_loop().run_in_executor(self._thread, function, *arguments)
