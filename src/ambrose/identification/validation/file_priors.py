"""The machine file's own numbers found beside those that were asked for, each held to the file.

A fit takes the numbers of the machine file as they are, which no drawing gives exactly: c, one of
them, is c_0 (1 + s z), z normal, s = 3 % (assumed; suspects.FILE). Where a record does not follow
them, the likeliest values are those of Bayes' rule (maximum a posteriori; Ljung 1999, section 7.4).
With H = J'J, g = J'r and M the covariance of g under the colour of the residuals, a step d from
theta leaves g - H d, and the best one is the least of

    (g - H d)' M^-1 (g - H d) + (theta + d - theta_0)' L (theta + d - theta_0)

L: diagonal, 1/(s c_0)^2 for the file's numbers and zero for those asked for
(statistics.step_with_prior), which also holds where the records cannot tell two numbers apart: then
the file does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ambrose.core.checks import AmbroseError
from ambrose.identification.output_error import statistics
from ambrose.identification.output_error.closed_loop import (
    LeastSquares,
    ParameterEstimate,
    excitation_names,
)
from ambrose.identification.output_error.levenberg_marquardt import Minimum
from ambrose.identification.output_error.normal_equations import normal_equations, synchronised
from ambrose.identification.output_error.problem import (
    Experiment,
    FitOptions,
    build_experiment,
    slowest,
)
from ambrose.identification.output_error.residual_analysis import residual_scores
from ambrose.identification.parameters import COVERAGE
from ambrose.identification.validation.suspects import FILE, equations_at, file_numbers
from ambrose.law.law import LawLike
from ambrose.machine.machine import Machine
from ambrose.record.record import Record

_STEPS = 4  # of Gauss and Newton; the numbers are few per cent off, so two do
_SETTLED = 0.05  # standard deviations of a last step
# of the file's own uncertainty: numbers that the records know better, or move by more, are found
_TOLD, _MOVED = 0.7, 0.5


@dataclass(frozen=True, slots=True, eq=False)
class _Posterior:
    """Values theta (q,) of an experiment's parameters, their covariance (q, q), and J'J (q, q)."""

    theta: np.ndarray
    covariance: np.ndarray
    H: np.ndarray

    @property
    def deviations(self) -> np.ndarray:
        return np.sqrt(np.diag(self.covariance))


def fit_with_priors(
    machine: Machine,
    records: Sequence[Record],
    controller: LawLike,
    result: ParameterEstimate,
    options: FitOptions,
) -> tuple[Experiment, ParameterEstimate] | None:
    """The estimate of ``result``'s parameters and of the file's numbers that the records tell, and
    its experiment; None where one would have to move by more than the file may be off.
    """
    asked, options = len(result.paths), replace(options, period=None)
    try:
        whole = build_experiment(
            machine,
            records,
            controller,
            (*result.paths, *file_numbers(machine, result.paths)),
            options,
        )
        first = _posterior(whole, _begin(whole, result), asked)
        if first is None:
            return None

        # those that the records tell, alone: the others stay what the file says
        prior = FILE * np.abs(whole.nominal)
        told = first.deviations < _TOLD * prior
        told |= np.abs(first.theta - whole.nominal) > _MOVED * prior
        chosen = [path for path, one in zip(whole.paths, told, strict=True) if one]
        chosen = [path for path in chosen if path not in result.paths]
        if not chosen:
            return None
        paths = (*result.paths, *chosen)
        experiment = build_experiment(machine, records, controller, paths, options)
        found = _posterior(experiment, _begin(experiment, result), asked)
    except AmbroseError:  # one of them cannot be an unknown here
        return None
    if found is None or experiment.paths != paths:
        return None

    # beyond its 95 % interval and the file's, a number is no correction: that is another machine
    moved = np.abs(found.theta - experiment.nominal)[asked:]
    width = FILE * np.abs(experiment.nominal) + found.deviations
    if (moved > COVERAGE * width[asked:]).any():
        return None
    return experiment, _estimate(experiment, found, result)


def prior_of(experiment: Experiment, asked: int) -> np.ndarray:
    """The standard deviations (q,) that the file's numbers have before a record; the first
    ``asked`` are not known.
    """
    prior = FILE * np.abs(experiment.nominal)
    prior[:asked] = np.inf
    return prior


def _begin(experiment: Experiment, result: ParameterEstimate) -> np.ndarray:
    """The file's values (q,), but for those found."""
    theta = experiment.nominal.copy()
    theta[[experiment.paths.index(path) for path in result.paths]] = result.values
    return theta


def _posterior(experiment: Experiment, theta: np.ndarray, asked: int) -> _Posterior | None:
    """The likeliest values from theta (q,) on, the first ``asked`` without a prior; None where the
    steps do not settle, or leave the stable loops.
    """
    problem = LeastSquares(experiment, normal_equations)
    prior = prior_of(experiment, asked)
    for _ in range(_STEPS):
        H, g, _, middle = equations_at(experiment, theta, coloured=True)
        step, covariance = statistics.step_with_prior(
            H, g, middle, prior, theta - experiment.nominal
        )
        theta = theta + step
        if not slowest(loop for loop, _ in problem.loops(theta)) < 1:
            return None
        if (np.abs(step) < _SETTLED * np.sqrt(np.diag(covariance))).all():
            return _Posterior(theta, covariance, H)
    return None


def _estimate(
    experiment: Experiment, found: _Posterior, result: ParameterEstimate
) -> ParameterEstimate:
    """What ``fit`` would give of these values: fit, residual tests, warnings; with what widened the
    intervals of ``result`` beyond noise.
    """
    theta, asked = found.theta, len(result.paths)
    loops = LeastSquares(experiment, normal_equations).loops(theta)
    count = sum(len(experiment.signals) * len(task.e) for task in experiment.tasks)
    fits: list[tuple[int, str, float]] = []
    tests: list[statistics.ResidualTest] = []
    for number, given in enumerate(experiment.tasks, 1):
        loop, directions = loops[given.place]
        task = synchronised(loop, given)
        part = normal_equations(loop, directions, task)
        names = [excitation_names(experiment.models[task.place], mix) for mix in task.mix.T]
        scores = residual_scores(loop, task, part, names, experiment.signals, count)
        fits += [
            (number, name, float(value))
            for name, value in zip(experiment.signals, scores.fit, strict=True)
        ]
        tests += scores.tests

    # variances add: these, and what else than noise widened the ones before (magnets)
    covariance = found.covariance
    bare = _noise_alone(experiment, theta, asked)
    extra = np.maximum(result.standard_deviations**2 - bare**2, 0.0)
    wider = np.ones(len(theta))
    wider[:asked] = np.sqrt(1 + extra / np.diag(covariance)[:asked])
    covariance = covariance * wider * wider[:, None]
    correlation = covariance / found.deviations / found.deviations[:, None] / wider / wider[:, None]
    verdict = statistics.verdict_of(tests, True)
    minimum = Minimum(theta, 0.0, True, result.iterations, 0)
    warnings = statistics.warnings_of(
        experiment.paths, minimum, covariance, correlation, tests, verdict
    )
    cosine = statistics.column_cosine(found.H)
    return replace(
        result,
        paths=experiment.paths,
        values=theta,
        start=np.concatenate([result.start, experiment.nominal[asked:]]),
        covariance=covariance,
        correlation=correlation,
        column_cosine=cosine,
        fit=tuple(fits),
        tests=tuple(tests),
        condition=float(np.linalg.cond(cosine)),
        warnings=tuple(warnings),
        verdict=verdict,
    )


def _noise_alone(experiment: Experiment, theta: np.ndarray, asked: int) -> np.ndarray:
    """The standard deviations (asked,) of noise alone, the file's numbers known."""
    H, _, _, middle = equations_at(experiment, theta, coloured=True)
    own = np.s_[:asked]
    return np.sqrt(np.diag(statistics.sandwich_covariance(H[own, own], middle[own, own])))


def words(result: ParameterEstimate, asked: int) -> str:
    """One sentence without its stop on the numbers behind the first ``asked``."""
    rows = zip(
        result.paths[asked:],
        result.values[asked:] / result.start[asked:] - 1,
        result.standard_deviations[asked:] / np.abs(result.start[asked:]),
        strict=True,
    )
    numbers = ", ".join(
        f"{path} {100 * off:+.2g} % (deviation {100 * deviation:.2g} %)"
        for path, off, deviation in rows
    )
    return (
        "the records do not follow the machine file's own numbers, so these were found along, each "
        f"taken as known to {100 * FILE:g} % before (assumed): {numbers}; a [[tolerance]] of them "
        "makes them unknowns"
    )
