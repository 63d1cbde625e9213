"""Where screens are computed: one process beside the server, so that nothing that takes long or
goes wrong there touches the live rig or what is served.
"""

import asyncio
import os
import signal
import threading
import time
from collections.abc import Callable, Mapping
from multiprocessing import connection, parent_process
from typing import Any

from ambrose.annexes.workbench.blocks import Refusal
from ambrose.annexes.workbench.project import Project
from ambrose.core.checks import AmbroseError
from ambrose.core.processes import context

# A process beside this one that answers one question after the other.
#
# What takes long or goes wrong there touches nothing here: a question that takes too long ends it,
# and the next one begins it anew. It ends with this process, also where that is killed.


Answer = Callable[[Any], Any]


class Unanswered(Exception):
    """No answer came; its words say why."""


class Answering:
    """The process, begun with the first question at the latest.

    make: called in the process with ``given``, it gives the function that answers; all of it, the
    questions and the answers are sent as ``pickle`` does. longest [s]: an answer may take. Not for
    several threads at once.
    """

    def __init__(self, make: Callable[..., Answer], *given: Any, longest: float) -> None:
        self.longest = longest
        self._make, self._given = make, given
        self._process: Any = None
        self._pipe: Any = None

    @property
    def pid(self) -> int | None:
        """The number of the process, None where there is none."""
        return None if self._process is None else self._process.pid

    def begin(self) -> None:
        """The process starts, where there is none."""
        if self._process is not None and self._process.is_alive():
            return
        self._pipe, other = context().Pipe()
        words = (other, self._make, self._given)
        self._process = context().Process(target=_work, args=words, daemon=True)
        self._process.start()
        other.close()

    def ask(self, question: Any) -> Any:
        """The answer. Raises Unanswered; the process is then ended."""
        self.begin()
        try:
            self._pipe.send(question)
            if self._pipe.poll(self.longest):
                return self._pipe.recv()
            cause = f"it took longer than {self.longest:g} s"
        except (EOFError, OSError):
            cause = "its process ended suddenly, perhaps for want of memory"
        self.close()
        raise Unanswered(cause)

    def close(self) -> None:
        """The process is ended."""
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._pipe.close()
            self._process = None


def _work(pipe: Any, make: Callable[..., Answer], given: tuple[Any, ...]) -> None:
    """A question, an answer, until whoever asks is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_the_other, daemon=True).start()
    answer = make(*given)
    while True:
        try:
            question = pipe.recv()
        except EOFError:
            return
        pipe.send(answer(question))


def _end_with_the_other() -> None:
    other = parent_process()
    if other is not None:
        connection.wait([other.sentinel])
        os._exit(1)


_LONGEST = 60.0  # [s] of an answer
_FIRST = 0.7  # [s] that the first page has the processors for itself
_Question = tuple[str, str, Mapping[str, Any]]  # screen, action, what the page gives
_Told = tuple[bool, dict[str, Any]]  # whether it was refused, and what the page is told


class Desk:
    """The process of a project's screens, which is asked one thing at a time."""

    def __init__(self, project: Project, longest: float = _LONGEST) -> None:
        self.process = Answering(_screens, str(project.root), longest=longest)
        self._turn = asyncio.Lock()

    async def begin(self) -> None:
        """The process starts, a moment after the server, unless it was asked before."""
        await asyncio.sleep(_FIRST)
        async with self._turn:
            await asyncio.to_thread(self.process.begin)

    async def ask(self, screen: str, action: str, given: Mapping[str, Any]) -> dict[str, Any]:
        """What a screen shows, or what an action made of it. Raises Refusal."""
        question: _Question = screen, action, dict(given)
        async with self._turn:
            try:
                refused, told = await asyncio.to_thread(self.process.ask, question)
            except Unanswered as error:
                words = f"this could not be computed: {error}; try a job or the command line"
                raise Refusal(words) from None
        if refused:
            raise Refusal(told["error"], told["fields"], told["stale"])
        answer: dict[str, Any] = told
        return answer


def _screens(root: str) -> Callable[[_Question], _Told]:
    """In the process: what answers."""
    from ambrose.annexes.workbench.screens import answer, load_all

    project = Project(root)
    load_all()

    def told(question: _Question) -> _Told:
        begun = time.perf_counter()
        try:
            shown = answer(project, *question)
        except Refusal as error:
            return True, error.content
        except AmbroseError as error:
            return True, Refusal(str(error)).content
        except Exception as error:  # a mistake of ours: it is said, and the next question answered
            words = f"this could not be computed, by a mistake of the program: {error!r}"
            return True, Refusal(words).content
        return False, {**shown, "computing": round(1e3 * (time.perf_counter() - begun), 1)}

    return told
