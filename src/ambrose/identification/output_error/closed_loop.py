"""Closed-loop identification: records of the running machine -> its parameters, with what they are worth.

Output error: the loop is simulated as it runs (sampled controller, computing delay, plant held between the samples) from the
recorded excitation, and the parameters are moved until its signals are the measured ones. No noise model enters, so the
estimate is unbiased whatever the colour of the noise; its covariance allows for that colour (sandwich).
Lauridsen's papers P2 and P4 identify in this way.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, NumericalFailure
from ambrose.core.response import SystemDerivative
from ambrose.core.statespace import StateSpace
from ambrose.identification.output_error import statistics
from ambrose.identification.output_error.lagged_products import coloured_products
from ambrose.identification.output_error.levenberg_marquardt import Linearised, Minimum, minimise
from ambrose.identification.output_error.loop_model import ParametricModel, over_weights
from ambrose.identification.output_error.normal_equations import Task, jacobian_pieces, normal_equations
from ambrose.identification.output_error.periodic import (
    Lines,
    line_equations,
    line_middle,
    line_residual,
    line_scores,
    lines_of,
    period_of,
    told_below,
)
from ambrose.identification.output_error.problem import (
    Experiment,
    admitted,
    check_records,
    check_start,
    deployed_controller,
    driven_inputs,
    experiment,
    slowest,
    start_values,
)
from ambrose.identification.output_error.residual_analysis import residual_scores
from ambrose.identification.output_error.summary import verdict_of, warnings_of
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.machine.record.record import Record

__all__ = [
    "Identification",
    "check_records",
    "check_start",
    "deployed_controller",
    "driven_inputs",
    "identify",
    "solve",
    "start_values",
    "summary",
]

_EARLY = 5000  # samples on which a good start is found
_NEGLIGIBLE = 1e-4  # a gain of this many variances of the noise: steps of 0.01 standard deviations need no second look
_NEAR = 10.0  # the same for the start, which all samples improve on
_FEW = 150  # lines on which a good start is found
_EXACT = 1e-24  # of the squared signals: a sum of squared residuals below it is rounding


@dataclass(frozen=True, slots=True, eq=False)
class Identification:
    """Parameters (q,) found at the operating point ``point``, SI, in the order of ``paths``; ``start`` is where they began.

    covariance (q, q): under the colour of the residuals (sandwich); standard_deviations (q,). correlation (q, q): of the
    parameters, from (J'J)^-1; column_cosine (q, q): between the columns of J, which is no correlation and mostly has the
    other sign. fit: (record number, signal, NRMSE percent). tests: does a residual still follow an excitation. condition [-]
    of J'J scaled to a unit diagonal. warnings: what makes the result doubtful, in words; verdict: one sentence.
    """

    machine: str
    point: OperatingPoint
    paths: tuple[str, ...]
    values: np.ndarray
    start: np.ndarray
    covariance: np.ndarray
    correlation: np.ndarray
    column_cosine: np.ndarray
    fit: tuple[tuple[int, str, float], ...]
    tests: tuple[statistics.ResidualTest, ...]
    condition: float
    converged: bool
    iterations: int
    warnings: tuple[str, ...]
    verdict: str

    @property
    def standard_deviations(self) -> np.ndarray:
        return np.sqrt(np.diag(self.covariance))


def identify(
    machine: Machine,
    records: Record | Sequence[Record],
    controller: Any,
    unknown: Sequence[str],
    *,
    start: Mapping[str, float] | None = None,
    signals: Sequence[str] | None = None,
    weights: Mapping[str, float] | None = None,
    bending_modes: int = 1,
    computing_delay: float = 1,
    initial_state: bool = True,
    offset: bool = True,
    period: float | str | None = None,
    max_iterations: int = 50,
) -> Identification:
    """The parameters at the paths ``unknown`` (machine/parameters.py; "*" for every name or axis) from closed-loop records.

    records: with excitations e_<axis> [A] (or f_<port> [N]) and measured y_<axis> [m], at one rate.
    controller: from errors [m] to currents [A], axes by place; continuous, it is sampled by Tustin's map; its output acts
    ``computing_delay`` samples later. start: path -> value to begin at (else the machine's). signals: those fitted (None:
    every y_<axis>); u_ and i_<axis> are possible. weights: signal -> size of its noise [m] or [A] (None: the signal's rms).
    bending_modes: per plane. initial_state, offset: estimated per record, else zero. period [s], or "auto": the excitation is
    periodic, and the fit goes over the lines of its spectrum (output_error/periodic.py), much faster.
    Raises InvalidInput for records that do not belong to this machine, hold too little excitation or say nothing about a
    parameter, and for a start at which the loop is unstable.
    """
    records = (records,) if isinstance(records, Record) else tuple(records)
    given = experiment(
        machine, records, controller, unknown, signals, weights, bending_modes, computing_delay, initial_state, offset
    )
    begin = start_values(given.paths, given.nominal, start)
    check_start(given.models, begin)
    if period is not None:
        return _from_lines(machine, given, begin, period, records[0].dt, max_iterations)
    found = solve(given.paths, given.models, given.sizes, given.tasks, begin, given.scale, max_iterations)
    return summary(machine, given.point, given.paths, begin, given.models, given.sizes, given.tasks, found)


Models = ParametricModel | Sequence[ParametricModel]


def solve(
    paths: tuple[str, ...],
    model: Models,
    sizes: np.ndarray,
    tasks: Sequence[Task],
    begin: np.ndarray,
    scale: np.ndarray,
    most: int,
) -> Minimum:
    """Least squares for theta on all tasks, from a start found on their first samples.

    model: one, or several of which ``place`` of a task names its own; sizes (p,): the weights of the signals.
    """
    models = _several(model)
    at = _loops(models, sizes)

    def linearise_on(chosen: Sequence[Task]) -> Callable[[np.ndarray], Linearised]:
        def linearise(theta: np.ndarray) -> Linearised:
            loops = at(theta)
            parts = tuple(normal_equations(*loops[task.place], task) for task in chosen)
            H = np.sum([part.equations.H for part in parts], axis=0)
            statistics.check_visible(paths, H, scale)
            g = np.sum([part.equations.g for part in parts], axis=0)
            return Linearised(sum(part.equations.cost for part in parts), H, g, parts)

        return linearise

    def stable(theta: np.ndarray) -> bool:
        return admitted(models, theta) and slowest(loop for loop, _ in at(theta)) < 1

    early = [task.first(_EARLY) for task in tasks]
    _check_driven(paths, at(begin), scale, early, tasks)
    begun, excited = 0, all(np.any(wave) for task in early for wave in task.e)
    if excited and max(task.samples for task in tasks) > 3 * _EARLY:
        small = _NEAR / sum(task.samples * len(task.y) for task in early)
        near = _near(linearise_on(early), begin, scale, stable, most, small)
        if near is not None:  # a good start from the first second; what is found is decided by all samples
            begin, begun = near.x, near.iterations
    total = sum(float(np.vdot(y, y)) for task in tasks for y in (task.measured(i, 0, task.samples) for i in range(len(task.y))))
    small = _NEGLIGIBLE / sum(task.samples * len(task.y) for task in tasks)
    found = minimise(linearise_on(tasks), begin, scale, stable, most, floor=_EXACT * total, negligible=small)
    return replace(found, iterations=found.iterations + begun)


def _check_driven(
    paths: tuple[str, ...],
    loops: Sequence[tuple[StateSpace, list[SystemDerivative]]],
    scale: np.ndarray,
    early: Sequence[Task],
    tasks: Sequence[Task],
) -> None:
    """Refuse parameters of which the excitation shows nothing at the start values; what noise makes of an initial state is no
    sign of them. The first samples mostly do; else all of them decide."""
    if any(len(task.tail) for task in tasks):
        return
    for chosen in (early, tasks):
        still = [replace(task, initial_state=False) for task in chosen]
        H = np.sum([normal_equations(*loops[task.place], task).equations.H for task in still], axis=0)
        try:
            statistics.check_visible(paths, H, scale)
        except InvalidInput:
            if chosen is tasks:
                raise
        else:
            return


def _near(
    linearise: Callable[[np.ndarray], Linearised],
    begin: np.ndarray,
    scale: np.ndarray,
    stable: Callable[[np.ndarray], bool],
    most: int,
    small: float,
) -> Minimum | None:
    """Where a part of the data leads, or None where it says too little for that, or leads nowhere."""
    try:
        near = minimise(linearise, begin, scale, stable, most, tolerance=1e-4, negligible=small)
    except (InvalidInput, NumericalFailure):  # the part does not show every parameter; all of it may
        return None
    return near if near.converged else None


def _several(model: Models) -> Sequence[ParametricModel]:
    return model if isinstance(model, Sequence) else [model]


def summary(
    machine: Machine,
    point: OperatingPoint,
    paths: tuple[str, ...],
    begin: np.ndarray,
    model: Models,
    sizes: np.ndarray,
    tasks: Sequence[Task],
    found: Minimum,
) -> Identification:
    """What was found, with covariance, residual tests, warnings and verdict."""
    models = _several(model)
    loops = _loops(models, sizes)(found.x)
    q, names = len(paths), models[0].signals
    H, middle = np.zeros((q, q)), np.zeros((q, q))
    fits: list[tuple[int, str, float]] = []
    tests: list[statistics.ResidualTest] = []
    count = sum(len(names) * len(task.e) for task in tasks)
    for number, (task, part) in enumerate(zip(tasks, found.parts, strict=True)):
        loop, directions = loops[task.place]
        H += part.equations.H
        scores = residual_scores(loop, task, part, [_names(models[task.place], mix) for mix in task.mix.T], names, count)
        middle += coloured_products(jacobian_pieces(loop, directions, task, part), scores.covariance)
        fits += [(number + 1, name, percent) for name, percent in zip(names, scores.fit, strict=True)]
        tests += scores.tests
    return _identification(machine, point, paths, begin, found, H, middle, fits, tests)


def _loops(
    models: Sequence[ParametricModel], sizes: np.ndarray
) -> Callable[[np.ndarray], list[tuple[StateSpace, list[SystemDerivative]]]]:
    """The loops over their weights at theta, remembered for the last theta asked for."""
    last: dict[bytes, list[tuple[StateSpace, list[SystemDerivative]]]] = {}

    def at(theta: np.ndarray) -> list[tuple[StateSpace, list[SystemDerivative]]]:
        key = theta.tobytes()
        if key not in last:
            last.clear()
            last[key] = [over_weights(model, theta, sizes) for model in models]
        return last[key]

    return at


def _from_lines(
    machine: Machine, given: Experiment, begin: np.ndarray, period: float | str, dt: float, most: int
) -> Identification:
    """``identify`` from the spectrum of a periodic excitation (output_error/periodic.py)."""
    every = [lines_of(task, period_of(task, period, dt)) for task in given.tasks]
    at = _loops(given.models, given.sizes)

    def linearise_on(lines: Sequence[Lines]) -> Callable[[np.ndarray], Linearised]:
        def linearise(theta: np.ndarray) -> Linearised:
            parts = tuple(line_equations(*at(theta)[one.task.place], one) for one in lines)
            H = np.sum([part.equations.H for part in parts], axis=0)
            statistics.check_visible(given.paths, H, given.scale)
            g = np.sum([part.equations.g for part in parts], axis=0)
            return Linearised(sum(part.equations.cost for part in parts), H, g, parts)

        return linearise

    def stable(theta: np.ndarray) -> bool:
        return admitted(given.models, theta) and slowest(loop for loop, _ in at(theta)) < 1

    start, begun, chosen = begin, 0, every
    few = [one.only(slice(None, None, max(len(one.z) // _FEW, 1))) for one in every]
    small = _NEAR / sum(2 * one.Y.size for one in few)
    near = _near(linearise_on(few), begin, given.scale, stable, most, small)
    if near is not None:  # a good start, and where the lines begin to tell nothing
        start, begun = near.x, near.iterations
        told = told_below(near.parts, few)
        chosen = [one.only(slice(int(np.searchsorted(np.angle(one.z), told)) + 1)) for one in every]
    total = sum(one.weight * float(np.vdot(one.Y, one.Y).real) for one in chosen)
    negligible = _NEGLIGIBLE / sum(2 * one.Y.size for one in chosen)
    found = minimise(linearise_on(chosen), start, given.scale, stable, most, floor=_EXACT * total, negligible=negligible)
    H, middle = np.zeros_like(found.parts[0].equations.H), np.zeros_like(found.parts[0].equations.H)
    fits: list[tuple[int, str, float]] = []
    tests: list[statistics.ResidualTest] = []
    for number, (one, used, part) in enumerate(zip(every, chosen, found.parts, strict=True), 1):
        H += part.equations.H
        middle += line_middle(part, used)
        residual = line_residual(at(found.x)[one.task.place][0], one, part.d)
        percent, more = line_scores(residual, one, given.signals, "the periodic excitation")
        fits += [(number, name, value) for name, value in zip(given.signals, percent, strict=True)]
        tests += more
    found = replace(found, iterations=found.iterations + begun)
    return _identification(machine, given.point, given.paths, begin, found, H, middle, fits, tests)


def _identification(
    machine: Machine,
    point: OperatingPoint,
    paths: tuple[str, ...],
    begin: np.ndarray,
    found: Minimum,
    H: np.ndarray,
    middle: np.ndarray,
    fits: Sequence[tuple[int, str, float]],
    tests: Sequence[statistics.ResidualTest],
) -> Identification:
    covariance = statistics.sandwich_covariance(H, middle)
    correlation, cosine = statistics.parameter_correlation(H), statistics.column_cosine(H)
    condition = float(np.linalg.cond(cosine))
    warnings = warnings_of(paths, found, covariance, correlation)
    verdict = verdict_of(tests, found.converged)
    if not all(test.passed for test in tests):
        warnings.append(verdict)
    return Identification(
        machine.name, point, paths, found.x, begin, covariance, correlation, cosine, tuple(fits), tuple(tests), condition,
        found.converged, found.iterations, tuple(warnings), verdict,
    )  # fmt: skip


def _names(model: ParametricModel, mix: np.ndarray) -> str:
    """The excitations that a distinct signal drives: "e_A_zeta", or "e_A_zeta, -e_B_zeta"."""
    return ", ".join(("-" if sign < 0 else "") + name for name, sign in zip(model.excitations, mix, strict=True) if sign)
