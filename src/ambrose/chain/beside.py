"""Work of a chain in processes beside this one, which says its progress here.

    with beside(2, progress) as work:
        futures = [work.start(function, *arguments) for ...]
        work.wait(futures)

``function`` is called with its arguments and, last, a function that takes words of progress. Where
a process dies the work that it had fails with ``BrokenProcessPool``; however the block is left, no
process stays behind.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Collection, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any

from ambrose.core.processes import context, one_thread_in_workers, pool

Progress = Callable[[str], None]
_EVERY = 0.1  # s between two looks at what the processes say

_words: ContextVar[Any] = ContextVar("words")  # of a process: the queue that takes its progress


@dataclass(frozen=True, slots=True, eq=False)
class Beside:
    """Processes, and the queue into which they put their progress."""

    executor: ProcessPoolExecutor
    said: Any
    progress: Progress

    def start(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """The function with its arguments, and a progress, in one of the processes."""
        return self.executor.submit(_called, function, arguments)

    def wait(self, futures: Collection[Future[Any]]) -> set[Future[Any]]:
        """Those that are done, once one is; meanwhile what is said is passed on."""
        while True:
            done, _ = wait(futures, timeout=_EVERY, return_when=FIRST_COMPLETED)
            while not self.said.empty():
                self.progress(self.said.get())
            if done:
                return done


@contextmanager
def beside(workers: int, progress: Progress) -> Iterator[Beside]:
    """So many processes, for as long as the block lasts."""
    others = set(multiprocessing.active_children())
    said = context().SimpleQueue()
    with one_thread_in_workers():
        executor = pool(workers, _say_into, said)
        try:
            yield Beside(executor, said, progress)
            executor.shutdown()
        except BaseException:  # Ctrl-C, or what the work of one process failed with
            executor.shutdown(wait=False, cancel_futures=True)
            for child in set(multiprocessing.active_children()) - others:
                child.terminate()
            raise
        finally:
            said.close()


def _say_into(queue: Any) -> None:
    _words.set(queue)


def _called(function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
    return function(*arguments, _words.get().put)
