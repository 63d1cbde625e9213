"""A chain of stages as one list: what each is called, what it needs, what makes it.

    made = walk(STAGES, {"machine": machine, "directory": directory, "progress": progress})

A stage is a plain function of results before it, named by ``needs``; what it makes is kept under
its own name. Stages that leave files take up, on their own, what an earlier run left there.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ambrose.chain.check import (
    along_doubts,
    axial_facts,
    entry_doubts,
    insight,
    without_coefficients,
)
from ambrose.core.checks import AmbroseError, named_failure
from ambrose.core.processes import context, one_thread_in_workers, pool
from ambrose.core.statespace import poles
from ambrose.judge.controller_file import read_controller, write_controller
from ambrose.judge.plants import Progress
from ambrose.judge.result import Synthesis, contradiction, sampled_margins
from ambrose.machine.machine import AxialMachine, Machine
from ambrose.machine.ordinary_file import set_aside
from ambrose.machine.units import listed
from ambrose.model.assemble import assemble
from ambrose.model.effects.rotor import finite_element_rotor, mass_properties
from ambrose.model.plant import Plant
from ambrose.model.uncertainty import reduce_from
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


# Stage: the plants of a machine, and what they tell about it.


def facts(machine: Machine, file: str | None = None) -> dict[str, Any]:
    """What `ambrose check` tells about a machine, SI units: mass properties, bending frequencies,
    open-loop poles, sizes.

    file: what a failure is named after; default: the machine. Raises InvalidInput where a point has
    no model, NumericalFailure where numbers are too far apart, with every part without coefficients
    at an operating point, and every entry that is implausible, its probable cause.
    """
    try:
        # what overflows on the way is no figure
        with np.errstate(over="raise", divide="raise", invalid="raise"):
            return _facts(machine)
    except AmbroseError as error:
        raise type(error)(listed(file or machine.name, _reasons(machine, str(error)))) from error


def _reasons(machine: Machine, failure: str) -> list[str]:
    """The failure, or all that are like it, and what may be its cause."""
    if isinstance(machine, AxialMachine):
        return [failure]
    found = [*without_coefficients(machine)]
    found = found if failure in found else [failure, *found]
    return [*found, *(line for line in entry_doubts(machine) if line not in "".join(found))]


@named_failure("the model of the machine")
def _facts(machine: Machine) -> dict[str, Any]:
    if isinstance(machine, AxialMachine):
        return axial_facts(machine)
    rotor = finite_element_rotor(machine)
    properties = mass_properties(rotor)
    plant = assemble(machine)
    reduced = reduce_from(plant, 0)
    values = poles(plant.rotor)
    known = {
        "machine": machine.name,
        "description": machine.description,
        "mass_kg": properties.mass,
        "centre_m": properties.centre,
        "diametral_inertia_kg_m2": properties.diametral_inertia,
        "polar_inertia_kg_m2": properties.polar_inertia,
        "unstable_poles_rad_s": [[float(p.real), float(p.imag)] for p in values if p.real > 0],
        "rotor_states": plant.rotor.n_states,
        "plant_states": plant.system.n_states,
        "reduced_rotor_states": reduced.rotor.n_states,
        "reduced_plant_states": reduced.system.n_states,
        "operating_points": [point.label for point in machine.operation.envelope],
        "tolerances": [tolerance.parameter for tolerance in machine.tolerances],
        "assumed": len(machine.assumed),
        **insight(
            plant
            if machine.operation.design is plant.point
            else assemble(machine, machine.operation.design)
        ),
    }
    known["doubts"] = [*known["doubts"], *along_doubts(machine)]
    return known


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
