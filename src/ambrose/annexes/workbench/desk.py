"""Where screens are computed: one process beside the server, so that nothing that takes long or
goes wrong there touches the live rig or what is served.

It is asked one thing at a time, is ended where an answer takes too long, and begins anew with the
next question. It ends with the server, also where that is killed.
"""

from __future__ import annotations

import asyncio
import os
import signal
import threading
import time
from collections.abc import Mapping
from multiprocessing import connection, get_context, parent_process
from typing import Any

from ambrose.annexes.workbench.blocks import Refusal
from ambrose.annexes.workbench.project import Project
from ambrose.core.checks import AmbroseError

_LONGEST = 60.0  # [s] of an answer


class Desk:
    """The process of a project's screens, begun with the first question at the latest."""

    def __init__(self, project: Project, longest: float = _LONGEST) -> None:
        self._root = str(project.root)
        self._longest = longest
        self._context = get_context("spawn")
        self._process: Any = None
        self._pipe: Any = None
        self._turn = asyncio.Lock()

    async def ask(self, screen: str, action: str, given: Mapping[str, Any]) -> dict[str, Any]:
        """What a screen shows, or what an action made of it. Raises Refusal."""
        async with self._turn:
            status, told = await asyncio.to_thread(self._ask, (screen, action, dict(given)))
        if status == "refused":
            raise Refusal(told["error"], told["fields"], told["stale"])
        answer: dict[str, Any] = told
        return answer

    def begin(self) -> None:
        """The process starts, where there is none."""
        if self._process is not None and self._process.is_alive():
            return
        self._pipe, other = self._context.Pipe()
        self._process = self._context.Process(target=_work, args=(other, self._root), daemon=True)
        self._process.start()
        other.close()

    def close(self) -> None:
        """The process is ended."""
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._pipe.close()
            self._process = None

    def _ask(self, words: tuple[str, str, dict[str, Any]]) -> tuple[str, dict[str, Any]]:
        self.begin()
        try:
            self._pipe.send(words)
            if self._pipe.poll(self._longest):
                status, told = self._pipe.recv()
                return status, told
            cause = f"it took longer than {self._longest:g} s"
        except (EOFError, OSError):
            cause = "its process ended suddenly, perhaps for want of memory"
        self.close()
        raise Refusal(f"this could not be computed: {cause}; try a job or the command line")


def _work(pipe: Any, root: str) -> None:
    """The process: a question, an answer, until the server is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_the_server, daemon=True).start()
    from ambrose.annexes.workbench.screens import answer, load_all

    project = Project(root)
    load_all()
    while True:
        try:
            screen, action, given = pipe.recv()
        except EOFError:
            return
        begun = time.perf_counter()
        try:
            told = answer(project, screen, action, given)
            status = "told"
            told["computing"] = round(1e3 * (time.perf_counter() - begun), 1)
        except Refusal as error:
            status, told = "refused", error.content
        except AmbroseError as error:
            status, told = "refused", Refusal(str(error)).content
        except Exception as error:  # a mistake of ours: it is said, and the next question answered
            words = f"this could not be computed, by a mistake of the program: {error!r}"
            status, told = "refused", Refusal(words).content
        pipe.send((status, told))


def _end_with_the_server() -> None:
    server = parent_process()
    if server is not None:
        connection.wait([server.sentinel])
        os._exit(1)
