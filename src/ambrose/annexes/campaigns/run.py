"""A plan computed: cases to workers by the standard executor interface, rows to disk as they come.

Rows are lines of ``rows.jsonl`` in the campaign's folder, appended block by block and flushed to
the disk: whatever ends a run, the next one takes them up from there and computes what is missing. A
line cut off by a kill is dropped. Only keys are held in memory, and few blocks are under way at a
time.
"""

import json
import math
import multiprocessing
import os
import time
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Executor, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ambrose.annexes.campaigns.plan import Bases, Case, Plan, Subject, subject
from ambrose.core.checks import (
    AmbroseError,
    InvalidInput,
    NumericalFailure,
    UnstableSystem,
    annotations_of,
    unfit,
)
from ambrose.core.frequency import largest_gain
from ambrose.core.presentation import json_text, to_plain
from ambrose.core.processes import one_thread_in_workers, pool, without_script
from ambrose.core.statespace import StateSpace, poles
from ambrose.core.worst_case_loop import BoxLoop, default_grid, gains, unstable_poles
from ambrose.judge import nominal
from ambrose.judge.loop_response import frequency_grid, loop_evaluator, solid_cores
from ambrose.judge.robust import box_loops
from ambrose.law.law import LawLike
from ambrose.law.loop import closed_loop, match_controller, running_law, timing_of
from ambrose.machine.criteria import SENSITIVITY_RANGE, SPEED_RANGE_FACTOR, TWO_PI
from ambrose.machine.description import Tolerance
from ambrose.machine.file.toml import AXIAL, load_machine, parse_toml, read_machine_text
from ambrose.machine.ordinary_file import (
    TOML_BYTES,
    check_source,
    claimed,
    make_folder,
    parse_json,
    read_text,
    write_text,
)
from ambrose.machine.units import shown, suggestion
from ambrose.model.assemble import assemble
from ambrose.model.plant import Plant, top_speed
from ambrose.model.uncertainty import default_bending_modes, perturbed, reduce, tolerances_around
from ambrose.options import AsItRuns, Simulating
from ambrose.rig.trial import simulate_scenario

# The tasks: a row of numbers and words for every case, failures as their reason. This is what
# worker processes run.
#
# screen: stability and the largest singular value of the output sensitivity of the linear loop, by
# cases that share all but where they stand in the tolerances: these are one array. verify: every
# check of ``judge.nominal`` on the full plant. design: status and certificate. simulate: outcome
# and peaks on the virtual rig. identify: a run on the rig of the case's machine, and the parameters
# found from it, starting at the machine of the file.


STABLE = "stable"
PEAK = "sensitivity.output.max"
WHERE = "sensitivity.output.at"
WORDS = ("status", "failed", "outcome", "findings")  # values of rows that are no numbers
_LOWEST = 0.5 * TWO_PI  # [rad/s], as for the nominal checks
_FINER = 9  # frequencies between the neighbours of a peak on the grid


@dataclass(frozen=True, slots=True)
class Row:
    """What came of a case: values by name, or why there are none; files that belong to it, by
    name.
    """

    key: str
    values: Mapping[str, Any]
    failure: str = ""
    files: Mapping[str, str] | None = None


def check_options(plan: Plan) -> None:
    """Raises InvalidInput for an option of a plan that its task does not have, or whose value has a
    wrong type.
    """
    known = _options_of(plan.task)
    stated = [(name, [value]) for name, value in plan.options.items()]
    stated += [
        (v.path.partition(".")[2], list(v.values))
        for v in plan.variables
        if v.path.startswith("option.")
    ]
    for name, values in stated:
        if name not in known:
            raise InvalidInput(
                f"a campaign of task {plan.task} has no option {name!r}; {suggestion(name, known)}"
            )
        for value in values:
            if wanted := unfit(value, known[name]):
                raise InvalidInput(
                    f"option {name} is {shown(value)}, but must be {wanted}; see "
                    "help(ambrose.campaign)"
                )


def _options_of(task: str) -> dict[str, Any]:
    """The options of a task by name, with the annotation of each."""
    from ambrose.synthesis.methods import methods

    if task in {"screen", "verify"}:
        return annotations_of(AsItRuns)
    if task == "design":
        asked = [annotations_of(kind) for kind in methods().values()]
        return {"method": str, **{name: kind for part in asked for name, kind in part.items()}}
    reserved = {"fallback", "second", "path", "computing_delay"}  # not by an option
    run = annotations_of(Simulating).items()
    options = {name: kind for name, kind in run if name not in reserved}
    identified = {"method": str, "unknown": str | list[str], "repeats": bool}
    return {**options, **identified} if task == "identify" else options


def compute(task: str, cases: Sequence[Case], bases: Bases, fixed: Mapping[str, Any]) -> list[Row]:
    """A row for each case, in their order. Nothing that a case does wrong takes the others with
    it.
    """
    if task == "screen":
        return _screened(cases, bases, fixed)
    perform = _TASKS[task]
    rows = []
    for case in cases:

        def work(case: Case = case) -> Mapping[str, Any]:
            return perform(subject(case, bases, fixed))

        rows.append(_row(case.key, work))
    return rows


def _row(key: str, work: Callable[[], Mapping[str, Any]]) -> Row:
    try:
        values = dict(work())
    except AmbroseError as error:
        return Row(key, {}, str(error))
    except MemoryError:  # of this computer, not of the case
        raise
    except Exception as error:  # a fault of the program, too, is one row's and not the campaign's
        return Row(key, {}, f"{type(error).__name__}: {error}")
    files = values.pop("files", None)
    return Row(key, to_plain(values), "", files)


def group_of(case: Case) -> tuple[Any, ...]:
    """What cases of one array share: all but the tolerances; the machine's first, so that
    neighbours share a rotor.
    """
    kept = [(path, value) for path, value in case.settings if not path.startswith("tolerance.")]
    return tuple(
        sorted(((not path.startswith("machine"), path, repr(value)) for path, value in kept))
    )


def _screened(cases: Sequence[Case], bases: Bases, fixed: Mapping[str, Any]) -> list[Row]:
    groups: dict[tuple[Any, ...], list[Case]] = {}
    for case in cases:
        groups.setdefault(group_of(case), []).append(case)
    answers: dict[str, Row] = {}
    for group in groups.values():
        subjects: dict[str, Subject] = {}
        for case in group:
            try:
                subjects[case.key] = subject(case, bases, fixed)
            except AmbroseError as error:
                answers[case.key] = Row(case.key, {}, str(error))
        if not subjects:
            continue
        try:
            rows = _screen(list(subjects.values()), fixed["model"])
            answers |= {
                key: Row(key, to_plain(values)) for key, values in zip(subjects, rows, strict=True)
            }
        except AmbroseError as error:
            answers |= {key: Row(key, {}, str(error)) for key in subjects}
        except MemoryError:
            raise
        except Exception as error:
            answers |= {key: Row(key, {}, f"{type(error).__name__}: {error}") for key in subjects}
    return [answers[case.key] for case in cases]


def _screen(group: Sequence[Subject], model: str) -> list[dict[str, Any]]:
    """The rows of cases that differ by nothing but their offsets."""
    first = group[0]
    plant = assemble(first.machine, first.point)
    if model == "reduced":
        plant = reduce(plant, default_bending_modes(plant))
    timing = timing_of(
        first.machine,
        first.controller,
        first.options.get("rate"),
        first.options.get("delay_samples"),
    )
    law = match_controller(_controller(first), plant)
    if law.dt is not None:
        raise InvalidInput(
            "a sampled controller cannot be screened as a continuous loop; take the task verify"
        )
    law = law if timing is None else timing.late(law)
    highest = max(
        SENSITIVITY_RANGE.limits[0].value,
        SPEED_RANGE_FACTOR * max(top_speed(first.machine), first.point.speed),
    )
    tolerances = _held(plant, {name for item in group for name in item.offsets})
    if not tolerances:
        return [_alone(plant, law, highest)] * len(group)
    try:
        loop = box_loops(plant, law, tolerances)[0]
    except UnstableSystem:  # no array without a stable centre
        loop = None
    if loop is None or solid_cores(plant):  # whose half order no array of rational models has
        return [
            _alone(perturbed(plant, _inside(item, tolerances), tolerances), law, highest)
            for item in group
        ]
    delta = np.array([list(_inside(item, tolerances).values()) for item in group])
    return _array(loop, delta, highest)


def _controller(item: Subject) -> LawLike:
    """What controls in a case; plans of tasks that need it name it. Raises InvalidInput."""
    if item.controller is None:
        raise InvalidInput("this task needs a controller; name it in the plan")
    return item.controller


def _held(plant: Plant, names: Collection[str]) -> tuple[Tolerance, ...]:
    """The tolerances that are moved: where a case says so they hold at every point; what is zero
    there stays zero.
    """
    return tolerances_around(
        plant,
        [replace(one, around=()) for one in plant.machine.tolerances if one.parameter in names],
    )


def _inside(item: Subject, tolerances: Sequence[Any]) -> dict[str, float]:
    return {
        tolerance.parameter: item.offsets.get(tolerance.parameter, 0.0) for tolerance in tolerances
    }


def _array(loop: BoxLoop, delta: np.ndarray, highest: float) -> list[dict[str, Any]]:
    """Stability and peak sensitivity at many points delta (d, k) of the tolerances together."""
    unstable = unstable_poles(loop, delta)
    omega = default_grid(loop)
    omega = np.unique([_LOWEST, *omega[(omega > _LOWEST) & (omega < highest)], highest])
    curves = gains(loop.at(omega), loop, delta)
    rows = []
    for i, (count, curve) in enumerate(zip(unstable.tolist(), curves, strict=True)):
        if count:
            rows.append(_unstable())
            continue
        at = int(curve.argmax())
        fine = np.geomspace(omega[max(at - 1, 0)], omega[min(at + 1, len(omega) - 1)], _FINER)
        closer = gains(loop.at(fine), loop, delta[i : i + 1])[0]
        rows.append(
            _peak(
                *max(
                    (float(curve[at]), float(omega[at])),
                    (float(closer.max()), float(fine[closer.argmax()])),
                )
            )
        )
    return rows


def _alone(plant: Plant, law: StateSpace, highest: float) -> dict[str, Any]:
    """The same of one loop, by its poles and its response."""
    eigenvalues = poles(closed_loop(plant, law))
    if eigenvalues.real.max() >= 0:
        return _unstable()
    omega = frequency_grid(eigenvalues, _LOWEST, highest)
    curve = largest_gain(loop_evaluator(plant, law)(omega).output_sensitivity())
    return _peak(float(curve.max()), float(omega[curve.argmax()]))


def _unstable() -> dict[str, Any]:
    return {STABLE: False, PEAK: math.inf, WHERE: math.nan}


def _peak(value: float, omega: float) -> dict[str, Any]:
    return {STABLE: True, PEAK: value, WHERE: omega / TWO_PI}


def full_plant(item: Subject) -> Plant:
    """The full plant of a case, its parameters moved within their tolerances."""
    plant = assemble(item.machine, item.point)
    if item.offsets:
        tolerances = _held(plant, item.offsets)
        plant = perturbed(plant, _inside(item, tolerances), tolerances) if tolerances else plant
    return plant


def checks_of(item: Subject) -> Any:
    """The nominal checks of a case on its full plant, of the loop as it runs."""
    plant = full_plant(item)
    timing = timing_of(
        item.machine, item.controller, item.options.get("rate"), item.options.get("delay_samples")
    )
    return nominal.check(plant, running_law(_controller(item), plant, timing))


def _verify(item: Subject) -> dict[str, Any]:
    checks = checks_of(item)
    values = {check.name: check.value for check in checks.checks}
    unstable = {} if checks.stable else {PEAK: math.inf}
    return {
        "passed": checks.passed,
        STABLE: checks.stable,
        **values,
        **unstable,
        "failed": ", ".join(c.name for c in checks.failed),
    }


def _design(item: Subject) -> dict[str, Any]:
    from ambrose.judge.controller_file import controller_text
    from ambrose.synthesis.design import design

    options = dict(item.options)
    result = design(
        assemble(item.machine, item.point), str(options.pop("method", "tuned")), **options
    )
    certificate = result.certificate
    return {
        "status": str(result.status),
        STABLE: certificate.stable,
        "norm": certificate.closed_loop_norm,
        "abscissa": certificate.spectral_abscissa,
        "states": result.controller.n_states,
        **certificate.margins,
        "files": {"controller.json": controller_text(result, item.machine)},
    }


def run(item: Subject) -> Any:
    """The case's run on the rig, or with ``linear`` on the linear loop, which alone has offsets
    within tolerances.
    """
    options = dict(item.options)
    linear = bool(options.pop("linear", False))
    for name in ("method", "unknown", "repeats"):  # of the identification after it
        options.pop(name, None)
    if item.offsets and not linear:
        raise InvalidInput(
            "the rig has no tolerances; vary the machine's own keys, machine.<table>..., or set "
            "linear = true"
        )
    place = full_plant(item) if linear else item.machine
    return simulate_scenario(
        place, _controller(item), item.scenario or "", point=item.point, linear=linear, **options
    )


def _simulate(item: Subject) -> dict[str, Any]:
    from ambrose.rig.trace import peaks, settling

    trace = run(item)
    largest = {name: value for name, value in peaks(trace).items() if name[:2] in {"y_", "i_"}}
    moved = max(
        (value for name, value in largest.items() if name.startswith("y_")), default=math.nan
    )
    return {
        "outcome": trace.outcome,
        STABLE: trace.stable,
        "completed": trace.outcome == "completed",
        "displacement.max": moved,
        "settling": settling(trace),
        **{f"peak.{name}": value for name, value in largest.items()},
    }


def _identify(item: Subject) -> dict[str, Any]:
    from ambrose.identification.pipeline import identify

    options = {
        name: item.options[name]
        for name in ("method", "unknown", "repeats")
        if name in item.options
    }
    identification = identify(item.base, run(item).record, item.controller, **options)
    values: dict[str, Any] = {"passed": identification.passed}
    for parameter in identification.parameters:
        values |= {
            parameter.path: parameter.value,
            f"{parameter.path}.deviation": parameter.standard_deviation,
        }
    return {**values, "findings": "; ".join(str(finding) for finding in identification.findings)}


_TASKS: dict[str, Callable[[Subject], dict[str, Any]]] = {
    "verify": _verify,
    "design": _design,
    "simulate": _simulate,
    "identify": _identify,
}


def line_of(row: Row) -> str:
    """A row as one line of JSON."""
    return json_text({"key": row.key, "failure": row.failure, "values": dict(row.values)})


# Where the cases of a campaign are computed: processes of this computer, or a Dask cluster.


PROCESSES, DASK = "processes", "dask"
MakeExecutor = Callable[[], Executor]


@contextmanager
def executors(engine: str, workers: int) -> Iterator[tuple[MakeExecutor, int]]:
    """How to make executors, and their number of workers.

    engine: "processes" on this computer; "dask", a cluster of processes on this computer; or the
    address of a running scheduler ("tcp://host:8786", or its scheduler file *.json), which must be
    trusted: what it sends is run. workers: 1 or more. Raises InvalidInput.
    """
    if getattr(multiprocessing.current_process(), "_inheriting", False):
        raise InvalidInput(
            "a campaign cannot start while a worker process imports the script that starts it;"
            ' put the call below `if __name__ == "__main__":`'
        )
    if not isinstance(workers, int) or isinstance(workers, bool) or workers < 1:
        raise InvalidInput(
            f"workers is {workers!r}, but must be a whole number, 1 or more; leave it out"
        )
    if not isinstance(engine, str):
        raise InvalidInput(f"engine is {engine!r}, but must be a text; take processes or dask")
    with one_thread_in_workers():
        yield from _executors(engine, workers)


def _executors(engine: str, workers: int) -> Iterator[tuple[MakeExecutor, int]]:
    if engine == PROCESSES:
        yield lambda: pool(workers), workers
        return
    try:
        from distributed import Client, LocalCluster
    except ImportError:
        remedy = "pip install 'ambrose[campaign]'"
        raise InvalidInput(
            f"engine {engine} needs Dask, which is not installed; {remedy}"
        ) from None
    if engine == DASK:
        with without_script():
            cluster = LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None)
        with cluster, Client(cluster) as client:
            yield client.get_executor, workers
        return
    if "://" not in engine and not engine.endswith(".json"):
        raise InvalidInput(
            f'engine "{engine}" is unknown; take processes, dask, or the address of a scheduler '
            "(tcp://...)"
        )
    try:
        known = engine.endswith(".json")
        dask = Client(scheduler_file=engine) if known else Client(engine, timeout=20)
    except (OSError, TimeoutError, ValueError) as error:
        raise InvalidInput(
            f"no scheduler answers at {engine}: {error}; start one with `dask scheduler`"
        ) from error
    with dask as client:
        yield client.get_executor, max(1, sum(client.nthreads().values()), workers)


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
        stored = keys_there(folder / ROWS)  # a file that is none is refused before a design
        progress("reading the plan's machines, controllers and scenarios")
        bases, fixed = bases_of(plan, progress), fixed_of(plan)
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
    number, "inf", "-inf", "nan" or none under all others; a name is one that netCDF takes.
    """
    if not name.isprintable() or name != name.strip() or not name or "/" in name:
        return False
    if name in WORDS:
        return value is None or isinstance(value, str)
    if isinstance(value, str):
        return value in {"inf", "-inf", "nan"}
    return value is None or isinstance(value, int | float)


def _foreign(path: Path) -> InvalidInput:
    return InvalidInput(
        f"{path} contains a line that is no row of a campaign; move the file away to begin anew"
    )


def bases_of(plan: Plan, progress: Progress = lambda stage: None) -> Bases:
    """Machines, controllers and scenarios of a plan, read or designed once. Raises InvalidInput."""
    from ambrose.judge.controller_file import read_controller
    from ambrose.rig.scenario import bundled_scenarios, load_scenario, scenario_text
    from ambrose.synthesis.design import design

    def place(name: str) -> Any:
        return plan.place(name) if plan.place(name).is_file() else name

    machines = {}
    controllers = {}
    scenarios = {}
    for name in plan.named("machine"):
        file = place(name.removesuffix(AXIAL))  # the axis along the shaft is of the same file
        machine = load_machine(file)
        machine = machine.axial if name.endswith(AXIAL) else machine
        machines[name] = json.dumps(parse_toml(read_machine_text(file), name))
        for controller in plan.named("controller") if plan.task != "design" else ():
            if plan.place(controller).is_file():
                controllers[controller, name] = read_controller(plan.place(controller), machine)
            elif Path(controller).suffix:
                raise InvalidInput(
                    f"no controller file {plan.place(controller)}; give its path from the plan's "
                    "folder"
                )
            else:
                progress(f"{controller}: controller for {name}")
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
