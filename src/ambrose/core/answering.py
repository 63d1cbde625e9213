"""A process beside this one that answers one question after the other.

What takes long or goes wrong there touches nothing here: a question that takes too long ends it,
and the next one begins it anew. It ends with this process, also where that is killed.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable
from multiprocessing import connection, parent_process
from typing import Any

from ambrose.core.processes import context

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
