"""The tasks: a row of numbers and words for every case, failures as their reason. This is what
worker processes run.

screen: stability and the largest singular value of the output sensitivity of the linear loop, by
cases that share all but where they stand in the tolerances: these are one array. verify: every
check of ``judge.nominal`` on the full plant. design: status and certificate. simulate: outcome and
peaks on the virtual rig. identify: a run on the rig of the case's machine, and the parameters found
from it, starting at the machine of the file.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ambrose.annexes.campaigns.case import Bases, Subject, subject
from ambrose.annexes.campaigns.plan import Case, Plan
from ambrose.core.arguments import annotations_of, unfit
from ambrose.core.checks import AmbroseError, InvalidInput, UnstableSystem
from ambrose.core.frequency import largest_gain
from ambrose.core.presentation import json_text, to_plain
from ambrose.core.statespace import StateSpace, poles
from ambrose.core.worst_case.loop import BoxLoop, default_grid, gains, unstable_poles
from ambrose.judge import nominal
from ambrose.judge.loop_response import frequency_grid, loop_evaluator, solid_cores
from ambrose.judge.robust import box_loops
from ambrose.law.law import LawLike
from ambrose.law.loop import closed_loop, match_controller, running_law
from ambrose.law.timing import timing_of
from ambrose.machine.criteria import SENSITIVITY_RANGE, SPEED_RANGE_FACTOR, TWO_PI
from ambrose.machine.description import Tolerance
from ambrose.machine.messages import shown, suggestion
from ambrose.model.assemble import assemble
from ambrose.model.plant import Plant, top_speed
from ambrose.model.reduce import default_bending_modes, reduce
from ambrose.model.uncertainty import perturbed, tolerances_around
from ambrose.rig.trial import simulate_scenario

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
    from ambrose.rig import virtual_rig
    from ambrose.synthesis.methods.choice import methods

    trial = annotations_of(simulate_scenario)
    if task in {"screen", "verify"}:
        return {name: trial[name] for name in ("rate", "delay_samples")}
    if task == "design":
        asked = [annotations_of(kind) for kind in methods().values()]
        return {"method": str, **{name: kind for part in asked for name, kind in part.items()}}
    rig = {
        name: annotations_of(virtual_rig.run)[name]
        for name in ("seed", "bending_modes", "dt", "every")
    }
    # not by an option
    reserved = {"machine", "controller", "scenario", "point", "progress", "fallback", "rig"}
    options = {name: kind for name, kind in {**trial, **rig}.items() if name not in reserved}
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
