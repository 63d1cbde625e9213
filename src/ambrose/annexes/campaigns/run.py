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
import signal
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ambrose.annexes.campaigns.case import Bases
from ambrose.annexes.campaigns.plan import Case, Plan
from ambrose.annexes.campaigns.tasks import Row, compute, group_of, line_of
from ambrose.core.checks import InvalidInput
from ambrose.machine.atomic_write import make_folder, write_text
from ambrose.machine.claim import claimed
from ambrose.machine.file.toml import load_machine, parse_toml, read_machine_text
from ambrose.machine.limits import TOML_BYTES
from ambrose.machine.ordinary_file import read_text

ROWS = "rows.jsonl"
PROCESSES, DASK = "processes", "dask"
# cases of one call; some seconds
_BLOCK = {"screen": 64, "verify": 8, "design": 1, "simulate": 8, "identify": 1}
_UNDER_WAY = 3  # blocks per worker
_ATTEMPTS = 3  # of a block whose worker dies
_EVERY = 2.0  # [s] between two words of progress, later a tenth of the time gone
Progress = Callable[[str], None]
MakeExecutor = Callable[[], Executor]


@dataclass(frozen=True, slots=True)
class Count:
    """How a run ended: cases asked for, rows there, computed now, failures among them; time [s]."""

    cases: int
    rows: int
    computed: int
    failed: int
    seconds: float
    interrupted: bool = False


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

    most: at most so many cases now. At Ctrl-C all that was finished is on the disk. Raises
    InvalidInput.
    """
    folder = make_folder(directory)
    with claimed(folder, "campaign"):
        begun = time.monotonic()
        progress("reading the plan's machines, controllers and scenarios")
        bases, fixed = bases_of(plan, progress), fixed_of(plan)
        there = keys_there(folder / ROWS)
        cases = list({case.key: case for case in plan.drawn()}.values())
        missing = sorted((case for case in cases if case.key not in there), key=group_of)[:most]
        progress(f"{len(cases)} cases, {len(cases) - len(missing)} of them computed before")
        failed = computed = 0
        told = begun
        with open(folder / ROWS, "ab") as file:
            for rows in _computed(
                _blocks(missing, _BLOCK[plan.task]), plan.task, bases, fixed, make, workers
            ):
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
                if now - told > max(_EVERY, 0.1 * (now - begun)):
                    told = now
                    left = (now - begun) / computed * (len(missing) - computed)
                    progress(
                        f"{computed} of {len(missing)} cases, {failed} failed, {_duration(left)} "
                        "to go"
                    )
        return Count(
            len(cases),
            len(cases) - len(missing) + computed,
            computed,
            failed,
            time.monotonic() - begun,
        )


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
    with open(path, "rb+") as file:
        for line in file:
            if not line.endswith(b"\n"):
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
        row: dict[str, Any] = json.loads(line)
        assert isinstance(row["key"], str)
    except (ValueError, KeyError, TypeError, AssertionError):
        raise InvalidInput(
            f"{path} holds a line that is no row of a campaign; move the file away to begin anew"
        ) from None
    return row


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
        machines[name] = json.dumps(parse_toml(read_machine_text(place(name)), name))
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
                machine = load_machine(place(name))
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
) -> Iterator[list[Row]]:
    """The rows of every block, in the order in which they are ready.

    Where a worker's death takes a process pool with it, the blocks that were under way are computed
    one at a time in a new one, so that the one at fault is known.
    """
    attempts: Counter[str] = Counter()
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
                        compiled = True
                    except (BrokenProcessPool, CancelledError):
                        broken = True
                        attempts[block[0].key] += 1
                        if attempts[block[0].key] < _ATTEMPTS:
                            suspects.append(block)
                        else:
                            yield [_dead(case) for case in block]
                    except MemoryError:
                        yield [_dead(case) for case in block]
                    except Exception as error:  # as Dask says that a block's workers died
                        if type(error).__name__ != "KilledWorker":
                            raise
                        yield [_dead(case) for case in block]
            executor.shutdown()
        except BaseException:  # Ctrl-C, a full disk, or nobody who takes the rows
            executor.shutdown(wait=False, cancel_futures=True)
            for child in multiprocessing.active_children():
                child.terminate()
            raise


def _dead(case: Case) -> Row:
    return Row(
        case.key,
        {},
        f"the process that computed it died {_ATTEMPTS} times (short of memory?); compute it alone",
    )


def _quiet_worker() -> None:
    """Ctrl-C is the parent's to handle; one thread for each worker's BLAS."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def executors(engine: str, workers: int) -> Iterator[tuple[MakeExecutor, int]]:
    """How to make executors, and their number of workers.

    engine: "processes" on this computer; "dask", a cluster of processes on this computer; or the
    address of a running scheduler ("tcp://host:8786", or its scheduler file *.json). Raises
    InvalidInput.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # handed down to the workers
    if engine == PROCESSES:
        context = multiprocessing.get_context("spawn")
        yield (
            lambda: ProcessPoolExecutor(workers, mp_context=context, initializer=_quiet_worker),
            workers,
        )
        return
    try:
        from distributed import Client, LocalCluster
    except ImportError:
        raise InvalidInput(
            f"engine {engine} needs Dask, which is not installed; pip install 'ambrose[campaign]'"
        ) from None
    if engine == DASK:
        with (
            LocalCluster(
                n_workers=workers, threads_per_worker=1, dashboard_address=None
            ) as cluster,
            Client(cluster) as client,
        ):
            yield client.get_executor, workers
        return
    if "://" not in engine and not engine.endswith(".json"):
        raise InvalidInput(
            f'engine "{engine}" is unknown; take processes, dask, or the address of a scheduler '
            "(tcp://...)"
        )
    try:
        found = (
            Client(scheduler_file=engine)
            if engine.endswith(".json")
            else Client(engine, timeout=20)
        )
    except (OSError, TimeoutError, ValueError) as error:
        raise InvalidInput(
            f"no scheduler answers at {engine}: {error}; start one with `dask scheduler`"
        ) from error
    with found as client:
        yield client.get_executor, max(1, sum(client.nthreads().values()), workers)


def processors() -> int:
    """How many this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
