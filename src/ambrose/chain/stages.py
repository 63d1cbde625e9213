"""A chain of stages as one list: what each is called, what it needs, what makes it.

    made = walk(STAGES, {"machine": machine, "directory": directory, "progress": progress})

A stage is a plain function of results before it, named by ``needs``; what it makes is kept under
its own name. Stages that leave files take up, on their own, what an earlier run left there.
"""

import multiprocessing
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ambrose.core.checks import AmbroseError
from ambrose.core.processes import context, one_thread_in_workers, pool
from ambrose.judge.controller_file import read_controller, write_controller
from ambrose.judge.plants import Progress
from ambrose.judge.result import Synthesis, contradiction, sampled_margins
from ambrose.machine.ordinary_file import set_aside
from ambrose.model.plant import Plant
from ambrose.synthesis.design import design, provenance
from ambrose.synthesis.methods import Method

REQUIRED = object()
# what a stage may end with besides a refusal: a defect of one is none of the others' results
FAILURES = (AmbroseError, ArithmeticError, LookupError, TypeError, ValueError, OSError)


@dataclass(frozen=True, slots=True)
class Stage:
    """name: of what it makes; needs: the names of its arguments, in order; make: the function;
    announced: what progress is told before it begins ("": the function tells it itself);
    otherwise: what stands in its place where it fails (REQUIRED: the chain ends there).
    """

    name: str
    needs: tuple[str, ...]
    make: Callable[..., Any]
    announced: str = ""
    otherwise: Any = REQUIRED


def walk(stages: Sequence[Stage], given: Mapping[str, Any]) -> dict[str, Any]:
    """All that the stages make, in order, beside what was given, by name; and "failures", a list of
    (stage, why) of those that failed and have something else in their place.

    stages: each needs only what was given or made before it. given: the results at the beginning,
    with ``progress`` among them, a function that is told the stages' announcements. Raises what
    the required stages raise.
    """
    failures: list[tuple[str, str]] = []
    results = {**given, "failures": failures}
    for stage in stages:
        if stage.announced:
            results["progress"](stage.announced)
        try:
            results[stage.name] = stage.make(*(results[name] for name in stage.needs))
        except FAILURES as error:
            if stage.otherwise is REQUIRED:
                raise
            known = isinstance(error, AmbroseError)
            why = str(error) if known else f"{type(error).__name__}: {error}"
            name = stage.name.replace("_", " ")
            results["progress"](f"no {name}; {why}")
            failures.append((name, why))
            results[stage.name] = stage.otherwise
    return results


# Work of a chain in processes beside this one, which says its progress here.
#
#     with beside(2, progress) as work:
#         futures = [work.start(function, *arguments) for ...]
#         work.wait(futures)
#
# ``function`` is called with its arguments and, last, a function that takes words of progress.
# Where a process dies the work that it had fails with ``BrokenProcessPool``; however the block is
# left, no process stays behind.


SaidBeside = Callable[[str], None]
_EVERY = 0.1  # s between two looks at what the processes say

_words: ContextVar[Any] = ContextVar("words")  # of a process: the queue that takes its progress


@dataclass(frozen=True, slots=True, eq=False)
class Beside:
    """Processes, and the queue into which they put their progress."""

    executor: ProcessPoolExecutor
    said: Any
    progress: SaidBeside

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
def beside(workers: int, progress: SaidBeside) -> Iterator[Beside]:
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


# Stage: one controller, designed or taken up again from an earlier run.


def resume_or_design(plant: Plant, method: Method, path: Path, progress: Progress) -> Synthesis:
    """The very Synthesis at ``path`` if the same design made it, else a new one, written there and
    read back.

    The same: package version, machine, operating point, method with its options, and not a byte
    changed since. What is taken up is certified again on the full plant, a scheduled controller at
    every speed of its grid. A file that is not taken up is called ``earlier-<name>``, and
    ``progress`` is told why.
    """
    if path.exists():
        try:
            kept = read_controller(path)
            wrong = _objection(plant, method, kept)
        except AmbroseError as error:
            wrong = str(error)
        if not wrong:
            return kept
        progress(f"{path.name} is not taken up: {wrong}; designing it anew")
        set_aside(path)
    return read_controller(write_controller(path, design(plant, method, progress=progress)))


def _objection(plant: Plant, method: Method, kept: Synthesis) -> str:
    """Why a kept controller is not what this design would give; "" where nothing speaks against
    it.
    """
    kept_key, key = kept.provenance.key, provenance(plant, method).key
    if other := [name for name in {**key, **kept_key} if kept_key.get(name) != key.get(name)]:
        return f"it was made for another {', '.join(other)}"
    wrong = contradiction(
        plant, kept, sampled_margins(plant, kept.law, method.on(plant.machine).timing())
    )
    if not wrong and kept.provenance.digest != kept.digest:
        return "it was changed after it was written"
    return wrong
