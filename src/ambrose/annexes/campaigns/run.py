"""A plan computed: cases to workers by the standard executor interface, rows to disk as they come.

Rows are lines of ``rows.jsonl`` in the campaign's folder, appended block by block and flushed to
the disk: whatever ends a run, the next one takes them up from there and computes what is missing. A
line cut off by a kill is dropped. Only keys are held in memory, and few blocks are under way at a
time.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ambrose.annexes.campaigns.case import Bases, subject
from ambrose.annexes.campaigns.plan import Case, Plan
from ambrose.annexes.campaigns.tasks import WORDS, Row, check_options, compute, group_of, line_of
from ambrose.annexes.campaigns.workers import MakeExecutor
from ambrose.core.checks import AmbroseError, InvalidInput, NumericalFailure
from ambrose.machine.atomic_write import make_folder, write_text
from ambrose.machine.claim import claimed
from ambrose.machine.file.toml import AXIAL, load_machine, parse_toml, read_machine_text
from ambrose.machine.json_text import parse_json
from ambrose.machine.limits import TOML_BYTES
from ambrose.machine.ordinary_file import check_source, read_text

ROWS = "rows.jsonl"
_START = b'{"key": "'  # of every row, so also of one that a kill cut off
# cases of one call; some seconds
_BLOCK = {"screen": 64, "verify": 8, "design": 1, "simulate": 8, "identify": 1}
_UNDER_WAY = 3  # blocks per worker
_ATTEMPTS = 3  # of a block whose worker dies
_DIED = (
    f"the processes that computed them died {_ATTEMPTS} times (short of memory?); the next run "
    "tries them again"
)
_TRIED = 20  # cases, spread over all, that are made ready before any is computed
_EVERY = 2.0  # [s] between two words of progress, later a tenth of the time gone
Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Count:
    """How a run ended: cases asked for, rows there, computed now, failures among them; time [s].

    lost: cases that have no row because the processes that computed them died.
    """

    cases: int
    rows: int
    computed: int
    failed: int
    seconds: float
    interrupted: bool = False
    lost: int = 0


@dataclass(frozen=True, slots=True)
class _Lost:
    """A block of so many cases that kills the processes that compute it."""

    cases: int


def run_plan(
    plan: Plan,
    directory: str | Path,
    *,
    make: MakeExecutor,
    workers: int = 1,
    progress: Progress = lambda stage: None,
    most: int | None = None,
) -> Count:
    """Compute what ``directory`` lacks of a plan. make: an executor, called again where its workers
    died.

    most: at most so many cases now. At Ctrl-C all that was finished is on the disk. A case whose
    process dies has no row: that says nothing of the case, and the next run computes it. Raises
    InvalidInput, also where no case can be made ready, and NumericalFailure where the processes die
    before they return anything.
    """
    check_options(plan)
    folder = make_folder(directory)
    with claimed(folder, "campaign"):
        begun = time.monotonic()
        progress("reading the plan's machines, controllers and scenarios")
        bases, fixed = bases_of(plan, progress), fixed_of(plan)
        stored = keys_there(folder / ROWS)
        cases = list({case.key: case for case in plan.drawn()}.values())
        missing = sorted((case for case in cases if case.key not in stored), key=group_of)[:most]
        progress(f"{len(cases)} cases, {len(cases) - len(missing)} of them computed before")
        _check_some(missing, bases, fixed)
        failed = computed = lost = 0
        last_report = begun
        with open(folder / ROWS, "ab") as file:
            for rows in _computed(
                _blocks(missing, _BLOCK[plan.task]), plan.task, bases, fixed, make, workers
            ):
                if isinstance(rows, _Lost):
                    lost += rows.cases
                    progress(f"{rows.cases} cases without a row: {_DIED}")
                    continue
                file.write("".join(f"{line_of(row)}\n" for row in rows).encode())
                file.flush()
                os.fsync(file.fileno())
                for row in rows:
                    for name, text in (row.files or {}).items():
                        write_text(make_folder(folder / "cases") / f"{row.key}-{name}", text, name)
                computed, failed = (
                    computed + len(rows),
                    failed + sum(bool(row.failure) for row in rows),
                )
                now = time.monotonic()
                if now - last_report > max(_EVERY, 0.1 * (now - begun)):
                    last_report = now
                    left = (now - begun) / computed * (len(missing) - computed)
                    progress(
                        f"{computed} of {len(missing)} cases, {failed} failed, {_duration(left)} "
                        "to go"
                    )
        seconds = time.monotonic() - begun
        return Count(
            len(cases), len(cases) - len(missing) + computed, computed, failed, seconds, lost=lost
        )


def _check_some(cases: Sequence[Case], bases: Bases, fixed: Mapping[str, Any]) -> None:
    """Raises InvalidInput where none of some cases, spread over all, can be made ready."""
    some = cases[:: max(1, len(cases) // _TRIED)]
    reasons = []
    for case in some:
        try:
            subject(case, bases, fixed)
        except AmbroseError as error:
            reasons.append(str(error))
        else:
            return
    if reasons:
        counted = (
            f"none of {len(reasons)} cases that were tried can"
            if len(reasons) > 1
            else "the only case cannot"
        )
        raise InvalidInput(f"{counted} be made ready: {Counter(reasons).most_common(1)[0][0]}")


def _duration(seconds: float) -> str:
    return (
        f"{seconds:.0f} s"
        if seconds < 100
        else f"{seconds / 60:.0f} min"
        if seconds < 6000
        else f"{seconds / 3600:.1f} h"
    )


def keys_there(path: Path) -> set[str]:
    """The keys of the rows in a file; what a kill left half written at its end is cut off. Raises
    InvalidInput.
    """
    if not path.exists():
        return set()
    keys, end = set(), 0
    with open(check_source(path, "file of rows"), "rb+") as file:
        for line in file:
            if not line.endswith(b"\n"):
                if line[: len(_START)] != _START[: len(line)]:
                    raise _foreign(path)
                break
            end += len(line)
            keys.add(_parsed(line, path)["key"])
        file.truncate(end)
    return keys


def rows_of(path: Path) -> Iterator[dict[str, Any]]:
    """Every row of a file of rows. Raises InvalidInput."""
    with open(path, "rb") as file:
        yield from (_parsed(line, path) for line in file if line.endswith(b"\n"))


def _parsed(line: bytes, path: Path) -> dict[str, Any]:
    try:
        row: dict[str, Any] = parse_json(line, "compute it again")
        known = isinstance(row["key"], str) and isinstance(row["failure"], str)
        if not (known and all(_fits(name, value) for name, value in row["values"].items())):
            raise ValueError
    except (InvalidInput, ValueError, KeyError, TypeError, AttributeError):
        raise _foreign(path) from None
    return row


def _fits(name: str, value: object) -> bool:
    """Whether a value of a row is what every task writes under its name: words under some, and a
    number, "inf", "-inf", "nan" or none under all others.
    """
    if name in WORDS:
        return value is None or isinstance(value, str)
    if isinstance(value, str):
        return value in {"inf", "-inf", "nan"}
    return value is None or isinstance(value, int | float)


def _foreign(path: Path) -> InvalidInput:
    return InvalidInput(
        f"{path} holds a line that is no row of a campaign; move the file away to begin anew"
    )


def bases_of(plan: Plan, progress: Progress = lambda stage: None) -> Bases:
    """Machines, controllers and scenarios of a plan, read or designed once. Raises InvalidInput."""
    from ambrose.judge.controller_file import read_controller
    from ambrose.model.assemble import assemble
    from ambrose.rig.scenario import bundled_scenarios, load_scenario, scenario_text
    from ambrose.synthesis.design import design

    def place(name: str) -> Any:
        return plan.place(name) if plan.place(name).is_file() else name

    machines = {}
    controllers = {}
    scenarios = {}
    for name in plan.named("machine"):
        file = place(name.removesuffix(AXIAL))  # the axis along the shaft is of the same file
        machines[name] = json.dumps(parse_toml(read_machine_text(file), name))
        for controller in plan.named("controller") if plan.task != "design" else ():
            if plan.place(controller).is_file():
                controllers[controller, name] = read_controller(plan.place(controller))
            elif Path(controller).suffix:
                raise InvalidInput(
                    f"no controller file {plan.place(controller)}; give its path from the plan's "
                    "folder"
                )
            else:
                progress(f"{controller}: controller for {name}")
                machine = load_machine(file)
                machine = machine.axial if name.endswith(AXIAL) else machine
                controllers[controller, name] = design(
                    assemble(machine, machine.operation.design), controller
                )
    for name in plan.named("scenario"):
        load_scenario(place(name))  # refuses what is none
        text = (
            scenario_text(name)
            if name in bundled_scenarios()
            else read_text(place(name), "scenario", TOML_BYTES)
        )
        scenarios[name] = json.dumps(parse_toml(text, name))
    return Bases(machines, controllers, scenarios)


def fixed_of(plan: Plan) -> dict[str, Any]:
    """What holds for all cases of a plan."""
    whole = {
        name: getattr(plan, name)
        for name in ("machine", "controller", "scenario", "point", "model")
    }
    return {**whole, "options": dict(plan.options)}


def _blocks(cases: Sequence[Case], size: int) -> deque[list[Case]]:
    """Cases that are computed together: neighbours that share a rotor, and whole arrays up to 8
    times the size.
    """
    blocks: deque[list[Case]] = deque()
    last: Any = None
    for case in cases:
        group = group_of(case)
        if not blocks or len(blocks[-1]) >= (8 * size if group == last else size):
            blocks.append([])
        blocks[-1].append(case)
        last = group
    return blocks


def _computed(
    blocks: deque[list[Case]],
    task: str,
    bases: Bases,
    fixed: Mapping[str, Any],
    make: MakeExecutor,
    workers: int,
) -> Iterator[list[Row] | _Lost]:
    """The rows of every block in the order in which they are ready, or that it is lost.

    Where a worker's death takes a process pool with it, the blocks that were under way are computed
    one at a time in a new one, so that the one at fault is known; it is halved until the case at
    fault is alone. Raises NumericalFailure where two cases, or the only one, are lost before any
    row.
    """
    blocks_lost, rows_there = 0, False

    def lost(block: list[Case]) -> _Lost:
        nonlocal blocks_lost
        blocks_lost += 1
        if not rows_there and (blocks_lost > 1 or not (blocks or suspects or under_way)):
            raise NumericalFailure(f"no case was computed: {_DIED}")
        return _Lost(len(block))

    attempts: Counter[tuple[str, int]] = Counter()  # by the first case of a block, and its length
    # the first block compiles the rig into the cache of all
    compiled = task not in {"simulate", "identify"}
    suspects: deque[list[Case]] = deque()
    while blocks or suspects:
        executor = make()
        under_way: dict[Future[list[Row]], list[Case]] = {}
        broken = False
        try:
            while under_way or ((blocks or suspects) and not broken):
                while (
                    (blocks or suspects)
                    and not broken
                    and len(under_way) < (1 if suspects or not compiled else _UNDER_WAY * workers)
                ):
                    block = suspects.popleft() if suspects else blocks.popleft()
                    try:
                        future = executor.submit(compute, task, block, bases, fixed)
                    except BrokenProcessPool:
                        broken = True
                        blocks.appendleft(block)
                        break
                    under_way[future] = block
                done, _ = wait(under_way, return_when=FIRST_COMPLETED)
                for future in done:
                    block = under_way.pop(future)
                    try:
                        yield future.result()
                        compiled = rows_there = True
                    except (BrokenProcessPool, CancelledError):
                        broken = True
                        attempts[block[0].key, len(block)] += 1
                        if attempts[block[0].key, len(block)] < (
                            _ATTEMPTS if len(block) == 1 else _ATTEMPTS - 1
                        ):
                            suspects.append(block)
                        elif len(block) == 1:
                            yield lost(block)
                        else:  # one of them is at fault
                            half = len(block) // 2
                            suspects += [block[:half], block[half:]]
                    except MemoryError:
                        yield lost(block)
                    except Exception as error:  # as Dask says that a block's workers died
                        if type(error).__name__ != "KilledWorker":
                            raise
                        yield lost(block)
            executor.shutdown()
        except BaseException:  # Ctrl-C, a full disk, or nobody who takes the rows
            executor.shutdown(wait=False, cancel_futures=True)
            for child in multiprocessing.active_children():
                child.terminate()
            raise
