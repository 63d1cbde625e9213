"""Closed-loop identification: records of the running machine -> its parameters, with what they are
worth.

Output error: the loop is simulated as it runs (sampled controller, computing delay, plant held
between the samples) from the recorded excitation, and the parameters are moved until its signals
are the measured ones. No noise model enters, so the estimate is unbiased whatever the colour of the
noise; its covariance allows for that colour (sandwich). Lauridsen's papers P2 and P4 identify in
this way.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.fft

from ambrose.core.checks import InvalidInput, NumericalFailure
from ambrose.core.response import SystemDerivative
from ambrose.core.statespace import StateSpace
from ambrose.identification.findings import Code, Finding
from ambrose.identification.output_error import statistics
from ambrose.identification.output_error.loop_model import ParametricModel, over_weights
from ambrose.identification.output_error.normal_equations import (
    Linearised,
    Minimum,
    RecordSolution,
    Task,
    explained_columns,
    jacobian_pieces,
    minimise,
    normal_equations,
    synchronised,
    turned,
)
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
    FitOptions,
    admitted,
    build_experiment,
    check_start,
    slowest,
    start_values,
)
from ambrose.identification.output_error.statistics import coloured_products, residual_scores
from ambrose.law.law import LawLike
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.record.record import Record

# What a fit takes out of its own residuals, and the stated variances with them.
#
# r = (I - P) e, P = sum u u' over orthonormal columns u of all that is fitted: J, initial state,
# offsets and waves. Of white noise of variance s^2 the autocovariance estimated from r is s^2
# (delta_l I - R(l)/k) in the mean, R(l) the sums of products of u that lie l samples apart. The
# columns lie where the loop answers, a few percent of all frequencies; there a short record has few
# degrees of freedom to lose, and the sandwich estimate comes out small by the share v' R v/k of
# v'v, for the combination v of the samples that a parameter is. The share is a matter of frequency:
# noise of any colour loses the same at each. (MacKinnon & White 1985 divide by 1 - P_tt for the
# same reason, where the samples' noise is independent.)


_LONG = 20_000  # samples from which the share is below a percent or two and not looked for
_MOST = 0.9  # of a variance


def restored(
    middle: np.ndarray,
    loop: StateSpace,
    directions: list[SystemDerivative],
    task: Task,
    part: RecordSolution,
    H: np.ndarray,
) -> np.ndarray:
    """The covariance ``middle`` (q, q) of J'r of one record with what the fit took out of the
    residuals; H (q, q) = J'J of all records.
    """
    if task.samples > _LONG or not len(H):
        return middle

    # H^-1 = L L': L'J has orthonormal rows over all records
    size = np.sqrt(np.diag(H))
    inverse = np.linalg.inv(H / size / size[:, None]) / size / size[:, None]
    J = np.concatenate(list(jacobian_pieces(loop, directions, task, part)), axis=2)
    own = np.tensordot(np.linalg.cholesky(inverse).T, J, 1)
    columns = np.concatenate([own, explained_columns(loop, task)])
    lags = statistics.memory(task.samples)

    # J'(R(l)/k) J, under the window of the residuals' own autocovariance
    taken = coloured_products([J], statistics.tapered(_products(columns, lags), task.samples))

    # v = J H^-1, column i: the share v'Rv/k of v'v of the parameter i
    flat = J.reshape(len(J), -1)
    lost, whole = (
        np.einsum("ij,jk,ki->i", inverse, one, inverse) for one in (taken, flat @ flat.T)
    )
    share = np.clip(lost / np.maximum(whole, 1e-300), 0.0, _MOST)

    # variances over 1 - share, correlations stay; back to the covariance of J'r
    covariance = inverse @ middle @ inverse / np.sqrt((1 - share) * (1 - share)[:, None])
    return np.asarray(H @ covariance @ H)


def _products(columns: np.ndarray, lags: int) -> np.ndarray:
    """Sums (p, p, lags + 1) over columns (c, p, k) and samples of a(t) b(t - lag)."""
    size = scipy.fft.next_fast_len(columns.shape[2] + lags, real=True)
    spectra = np.zeros((columns.shape[1], columns.shape[1], size // 2 + 1), complex)
    for column in columns:
        F = scipy.fft.rfft(column, size, axis=1)
        spectra += F[:, None] * F[None].conj()
    return np.asarray(scipy.fft.irfft(spectra, size, axis=2)[:, :, : lags + 1])


_EARLY = 5000  # samples on which a good start is found
# a gain of this many variances of the noise: steps of 0.01 standard deviations need no second look
_NEGLIGIBLE = 1e-4
_NEAR = 10.0  # the same for the start, which all samples improve on
_TURNS = 6  # times the rotor's angle is looked for
_FEW = 150  # lines on which a good start is found
_EXACT = 1e-24  # of the squared signals: a sum of squared residuals below it is rounding

Loop = tuple[StateSpace, list[SystemDerivative]]


@dataclass(frozen=True, slots=True, eq=False)
class ParameterEstimate:
    """Parameters (q,) found at the operating point ``point``, SI, in the order of ``paths``;
    ``start`` is where they began.

    covariance (q, q): under the colour of the residuals (sandwich); standard_deviations (q,).
    correlation (q, q): of the parameters, from (J'J)^-1; column_cosine (q, q): between the columns
    of J, which is no correlation and mostly has the other sign. fit: (record number, signal, NRMSE
    percent). tests: does a residual still follow an excitation. condition [-] of J'J scaled to a
    unit diagonal. warnings: what makes the result doubtful; verdict: one sentence. turning: what
    every fitted signal holds at multiples of the speed and at the tones, whatever the excitation
    does.
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
    warnings: tuple[Finding, ...]
    verdict: str
    turning: tuple[statistics.TurningWave, ...] = ()

    @property
    def standard_deviations(self) -> np.ndarray:
        return np.sqrt(np.diag(self.covariance))

    @property
    def adequate(self) -> bool:
        """Whether what the residuals still hold of the excitation leaves the values as they are, or
        nearly so.
        """
        return all(finding.code != Code.RESIDUALS for finding in self.warnings)

    def widened(self, least: np.ndarray) -> ParameterEstimate:
        """The same with standard deviations of at least ``least`` (q,); correlations stay."""
        wider = np.maximum(least / self.standard_deviations, 1.0)
        return replace(self, covariance=self.covariance * wider * wider[:, None])


def identify(
    machine: Machine,
    records: Record | Sequence[Record],
    controller: LawLike,
    unknown: Sequence[str],
    *,
    start: Mapping[str, float] | None = None,
    **options: Any,
) -> ParameterEstimate:
    """The parameters at the paths ``unknown`` (machine/parameters.py; "*" for every name or axis)
    from closed-loop records.

    records: with excitations e_<axis> [A] (or f_<port> [N]) and measured y_<axis> [m], at one rate.
    controller: from errors [m] to currents [A]; continuous, it is sampled by Tustin's map. start:
    path -> value to begin at (else the machine's). options: those of FitOptions
    (output_error/problem.py). Raises InvalidInput for records that do not belong to this machine,
    hold too little excitation or say nothing about a parameter, and for a start at which the loop
    is unstable.
    """
    return fit(
        build_experiment(machine, records, controller, unknown, FitOptions(**options)), start
    )


def fit(experiment: Experiment, start: Mapping[str, float] | None = None) -> ParameterEstimate:
    """``identify`` for an experiment that was built before; start: path -> value to begin at.
    Raises InvalidInput.
    """
    begin = start_values(experiment.paths, experiment.nominal, start)
    check_start(experiment.models, begin)
    if experiment.options.period is not None:
        return _fit_lines(experiment, begin, experiment.options.period)
    return fit_samples(experiment, begin)


class LeastSquares:
    """The least squares of an experiment on tasks, or on the lines of their spectra: ``equations``
    makes an item's normal equations from its loop over the weights, and its derivatives.
    """

    def __init__(
        self,
        experiment: Experiment,
        equations: Callable[[StateSpace, list[SystemDerivative], Any], Any],
    ) -> None:
        self.experiment, self.equations = experiment, equations
        self._last: tuple[bytes, list[Loop]] = (b"", [])

    def loops(self, theta: np.ndarray) -> list[Loop]:
        """One per model, remembered for the last theta (q,) asked for."""
        key = theta.tobytes()
        if key != self._last[0]:
            experiment = self.experiment
            self._last = (
                key,
                [over_weights(model, theta, experiment.sizes) for model in experiment.models],
            )
        return self._last[1]

    def synchronised(
        self, minimum: Minimum, tasks: Sequence[Task], by_step: bool = False
    ) -> tuple[Task, ...]:
        """The tasks with the rotor's angle by what the model leaves at a minimum; by_step: near it,
        together with theta.
        """
        loops = self.loops(minimum.x)
        if not by_step:
            return tuple(synchronised(loops[task.place][0], task) for task in tasks)
        H = np.sum([part.equations.H for part in minimum.parts], axis=0)
        return tuple(turned(*loops[task.place], task, H) for task in tasks)

    def minimise(
        self, items: Sequence[Task] | Sequence[Lines], begin: np.ndarray, **limits: Any
    ) -> Minimum:
        experiment = self.experiment

        def linearise(theta: np.ndarray) -> Linearised:
            loops = self.loops(theta)
            parts = tuple(self.equations(*loops[item.place], item) for item in items)
            H = np.sum([part.equations.H for part in parts], axis=0)
            statistics.check_visible(experiment.paths, H, experiment.scale)
            g = np.sum([part.equations.g for part in parts], axis=0)
            return Linearised(sum(part.equations.cost for part in parts), H, g, parts)

        def is_stable(theta: np.ndarray) -> bool:
            return (
                admitted(experiment.models, theta)
                and slowest(loop for loop, _ in self.loops(theta)) < 1
            )

        return minimise(
            linearise,
            begin,
            experiment.scale,
            is_stable,
            experiment.options.max_iterations,
            **limits,
        )

    def approach(
        self, items: Sequence[Task] | Sequence[Lines], begin: np.ndarray, small: float
    ) -> Minimum | None:
        """The minimum over a part of the data, or None where it says too little for one, or leads
        nowhere.
        """
        try:
            minimum = self.minimise(items, begin, tolerance=1e-4, negligible=small)
        except (
            InvalidInput,
            NumericalFailure,
        ):  # the part does not show every parameter; all of it may
            return None
        return minimum if minimum.converged else None


def fit_samples(experiment: Experiment, begin: np.ndarray) -> ParameterEstimate:
    """Least squares on all samples from theta = begin (q,), by way of a start found on the first
    ones; with covariance, residual tests, warnings and verdict.
    """
    problem, tasks = LeastSquares(experiment, normal_equations), experiment.tasks

    # A start from the first samples alone, where the record is long enough to be worth it.
    early = [task.first(_EARLY) for task in tasks]
    _check_driven(problem, begin, early)
    start = begin
    begun = 0
    excited = all(np.any(wave) for task in early for wave in task.e)
    if excited and max(task.samples for task in tasks) > 3 * _EARLY:
        small = _NEAR / sum(task.samples * len(task.y) for task in early)
        near = problem.approach(early, begin, small)
        # a good start from the first second; what is found is decided by all samples
        if near is not None:
            start, begun = near.x, near.iterations

    # All samples; total = |y|^2, below a part of which the residual is rounding.
    total = sum(
        float(np.vdot(y, y))
        for task in tasks
        for y in (task.measured(i, 0, task.samples) for i in range(len(task.y)))
    )
    small = _NEGLIGIBLE / sum(task.samples * len(task.y) for task in tasks)
    minimum = problem.minimise(tasks, start, floor=_EXACT * total, negligible=small)
    for turns in range(_TURNS):  # the rotor's angle, by what is left; nothing to do at standstill
        further = problem.synchronised(minimum, tasks, by_step=turns > 0)
        if not any(one.differs(other) for one, other in zip(further, tasks, strict=True)):
            break
        tasks, begun = further, begun + minimum.iterations
        minimum = problem.minimise(tasks, minimum.x, floor=_EXACT * total, negligible=small)

    # Cov theta = H^-1 (sum over records of J' Gamma J) H^-1, with what the fit took out of Gamma.
    loops = problem.loops(minimum.x)
    signals = experiment.models[0].signals
    models = experiment.models
    H = np.sum([part.equations.H for part in minimum.parts], axis=0)
    middle = np.zeros_like(H)
    fits: list[tuple[int, str, float]] = []
    tests: list[statistics.ResidualTest] = []
    turning: list[statistics.TurningWave] = []
    unused: list[str] = []
    count = sum(len(signals) * len(task.e) for task in tasks)
    for number, (task, part) in enumerate(zip(tasks, minimum.parts, strict=True), 1):
        loop, directions = loops[task.place]
        names = [excitation_names(models[task.place], mix) for mix in task.mix.T]
        scores = residual_scores(loop, task, part, names, signals, count)
        coloured = coloured_products(
            jacobian_pieces(loop, directions, task, part), scores.covariance
        )
        middle += restored(coloured, loop, directions, task, part, H)
        fits += [(number, name, percent) for name, percent in zip(signals, scores.fit, strict=True)]
        tests += scores.tests
        if task.synchronous is not None:
            hertz = task.synchronous.frequencies(task.samples) / (2 * np.pi * experiment.dt)

            # amplitudes and autocovariance back from over the weights to SI
            b = part.b[:, int(task.offset) :] * experiment.sizes[:, None]
            noise = scores.covariance * experiment.sizes[:, None, None] ** 2
            turning += statistics.turning_waves(
                number,
                signals,
                (hertz, task.synchronous.orders),
                b,
                noise,
                task.samples,
                experiment.dt,
            )
            for wave, name in zip(task.e, names, strict=True):
                unused += [
                    f"{name} at {hertz[n - 1]:.4g} Hz, {n} x the speed"
                    for n in task.synchronous.coinciding(wave)
                ]
    done = _estimate(
        experiment,
        begin,
        replace(minimum, iterations=minimum.iterations + begun),
        middle,
        fits,
        tests,
    )
    said = (
        f"; not used, for the rotor turns with it: {', '.join(dict.fromkeys(unused))}"
        if unused
        else ""
    )
    return replace(done, turning=tuple(turning), verdict=done.verdict + said)


def _check_driven(problem: LeastSquares, begin: np.ndarray, early: Sequence[Task]) -> None:
    """Refuse parameters of which the excitation shows nothing at the start values; what noise makes
    of an initial state is no sign of them. The first samples mostly do; else all of them decide.
    """
    experiment, loops = problem.experiment, problem.loops(begin)
    if any(len(task.tail) for task in experiment.tasks):
        return
    for chosen in (early, experiment.tasks):
        # without an initial state: one that noise made would drive the loop, too
        still = [replace(task, initial_state=False) for task in chosen]
        H = np.sum(
            [normal_equations(*loops[task.place], task).equations.H for task in still], axis=0
        )
        try:
            statistics.check_visible(experiment.paths, H, experiment.scale)
        except InvalidInput:
            if chosen is experiment.tasks:
                raise
        else:
            return


def _fit_lines(experiment: Experiment, begin: np.ndarray, period: float | str) -> ParameterEstimate:
    """The same from the spectrum of a periodic excitation (output_error/periodic.py)."""
    problem = LeastSquares(experiment, line_equations)
    start = begin
    begun = 0
    tasks = experiment.tasks
    every = chosen = [lines_of(task, period_of(task, period, experiment.dt)) for task in tasks]

    # A start from a few of the lines.
    few = [one.only(slice(None, None, max(len(one.z) // _FEW, 1))) for one in every]
    near = problem.approach(few, begin, _NEAR / sum(2 * one.Y.size for one in few))
    if near is not None:  # a good start, and where the lines begin to tell nothing
        start, begun = near.x, near.iterations
        told = told_below(near.parts, few)
        chosen = [one.only(slice(int(np.searchsorted(np.angle(one.z), told)) + 1)) for one in every]
    total = sum(one.weight * float(np.vdot(one.Y, one.Y).real) for one in chosen)
    negligible = _NEGLIGIBLE / sum(2 * one.Y.size for one in chosen)
    minimum = problem.minimise(chosen, start, floor=_EXACT * total, negligible=negligible)
    for turns in range(_TURNS):
        further = problem.synchronised(minimum, tasks, by_step=turns > 0)
        if not any(one.differs(other) for one, other in zip(further, tasks, strict=True)):
            break

        # the waves at the lines move with the angle; which lines are used stays
        tasks = further
        every = [lines_of(task, old.length) for task, old in zip(further, every, strict=True)]
        chosen = [one.only(slice(len(old.z))) for one, old in zip(every, chosen, strict=True)]
        begun += minimum.iterations
        minimum = problem.minimise(chosen, minimum.x, floor=_EXACT * total, negligible=negligible)
    middle = np.zeros_like(minimum.parts[0].equations.H)
    fits: list[tuple[int, str, float]] = []
    tests: list[statistics.ResidualTest] = []
    for number, (one, used, part) in enumerate(zip(every, chosen, minimum.parts, strict=True), 1):
        middle += line_middle(part, used)
        residual = line_residual(problem.loops(minimum.x)[one.task.place][0], one, part)
        percent, line_tests = line_scores(
            residual, one, experiment.signals, "the periodic excitation"
        )
        fits += [
            (number, name, value) for name, value in zip(experiment.signals, percent, strict=True)
        ]
        tests += line_tests
    return _estimate(
        experiment,
        begin,
        replace(minimum, iterations=minimum.iterations + begun),
        middle,
        fits,
        tests,
    )


def _estimate(
    experiment: Experiment,
    begin: np.ndarray,
    minimum: Minimum,
    middle: np.ndarray,
    fits: Sequence[tuple[int, str, float]],
    tests: Sequence[statistics.ResidualTest],
) -> ParameterEstimate:
    """``middle`` (q, q): the covariance of J'r."""
    H = np.sum([part.equations.H for part in minimum.parts], axis=0)
    covariance = statistics.sandwich_covariance(H, middle)
    correlation, cosine = statistics.parameter_correlation(H), statistics.column_cosine(H)
    condition = float(np.linalg.cond(cosine))
    verdict = statistics.verdict_of(tests, minimum.converged)
    warnings = tuple(
        statistics.warnings_of(experiment.paths, minimum, covariance, correlation, tests, verdict)
    )
    return ParameterEstimate(
        experiment.machine,
        experiment.point,
        experiment.paths,
        minimum.x,
        begin,
        covariance,
        correlation,
        cosine,
        tuple(fits),
        tuple(tests),
        condition,
        minimum.converged,
        minimum.iterations,
        warnings,
        verdict,
    )


def excitation_names(model: ParametricModel, mix: np.ndarray) -> str:
    """The excitations that a distinct signal drives: "e_A_zeta", or "e_A_zeta, -e_B_zeta"."""
    return ", ".join(
        ("-" if sign < 0 else "") + name
        for name, sign in zip(model.excitations, mix, strict=True)
        if sign
    )
