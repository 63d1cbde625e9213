"""Repeated experiments: mean, relative standard deviation, confidence intervals; predicted against observed scatter.

A single identification states its own standard deviation (output_error/statistics.py, from the colour of the residuals).
Repeats show the scatter itself, whatever causes it: noise, run-out, temperature, a model wrong in another way each time.
Means have Student's t intervals (papers P2: five repeats, 95 %), scatters have chi-square ones: the standard deviation of five
repeats is itself uncertain by a factor between 0.6 and 2.9.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ambrose.core.checks import InvalidInput, check_shape, invalid
from ambrose.identification.parameters import Estimate


@dataclass(frozen=True, slots=True, eq=False)
class Repeats:
    """r repeats of q parameters, SI, in the order of ``paths``.

    values (r, q); predicted (q,): root mean square of the standard deviations that the single experiments state (NaN where they
    state none). level [-] of all intervals. mean (q,); deviation (q,): sample standard deviation of one repeat.
    """

    paths: tuple[str, ...]
    values: np.ndarray
    predicted: np.ndarray
    level: float

    @property
    def count(self) -> int:
        return len(self.values)

    @property
    def mean(self) -> np.ndarray:
        return np.asarray(self.values.mean(axis=0))

    @property
    def deviation(self) -> np.ndarray:
        return np.asarray(self.values.std(axis=0, ddof=1))

    @property
    def rsd(self) -> np.ndarray:
        """Relative standard deviation (q,) [%]; NaN where the mean is zero."""
        mean = np.abs(self.mean)
        return np.divide(100 * self.deviation, mean, out=np.full(len(mean), np.nan), where=mean > 0)

    @property
    def half_width(self) -> np.ndarray:
        """The mean lies within +- this (q,) with probability ``level``: t s/sqrt(r), Student's t with r - 1 degrees."""
        from scipy.special import stdtrit

        return np.asarray(stdtrit(self.count - 1, (1 + self.level) / 2) * self.deviation / np.sqrt(self.count))

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready data, SI."""
        return {
            "count": self.count, "values": self.values.tolist(), "mean": self.mean.tolist(),
            "half_width_95": self.half_width.tolist(), "rsd_percent": self.rsd.tolist(),
        }  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class ScatterStudy:
    """Predicted against observed scatter over many repeats with a known truth, per parameter (q,).

    ratio: predicted over observed standard deviation, with ratio_range (2, q), where it lies by chance if the prediction is
    right. bias [-]: (mean - truth) in standard errors of the mean. covered [-]: share of the experiments whose stated interval
    (``level``, normal) holds the truth. verdict: one sentence.
    """

    repeats: Repeats
    truth: np.ndarray
    ratio: np.ndarray
    ratio_range: np.ndarray
    bias: np.ndarray
    covered: np.ndarray
    verdict: str


def repeats(paths: Sequence[str], values: ArrayLike, predicted: ArrayLike | None = None, level: float = 0.95) -> Repeats:
    """Repeats from values (r, q) and the standard deviations (r, q) that each experiment states. Raises InvalidInput."""
    values = check_shape(values, "values", "(r, q)", q=len(paths))
    if len(values) < 2:
        raise invalid("the number of repeats", len(values), "at least 2", "one experiment shows no scatter; repeat it")
    if not 0 < level < 1:
        raise invalid("level", level, "between 0 and 1", "0.95 is usual")
    stated = np.full(values.shape, np.nan) if predicted is None else check_shape(predicted, "predicted", "(r, q)", q=len(paths))
    return Repeats(tuple(paths), values, np.sqrt(np.mean(stated**2, axis=0)), float(level))


def of_estimates(estimates: Sequence[Estimate], level: float = 0.95) -> Repeats:
    """Repeats from identifications (or static loads) of the same parameters. Raises InvalidInput where those differ."""
    if not estimates:
        raise InvalidInput("no experiment was given; repeats need at least two")
    first = estimates[0].paths
    for number, item in enumerate(estimates, 1):
        if item.paths != first:
            raise invalid(
                f"the parameters of experiment {number}", ", ".join(item.paths), f"{', '.join(first)}, as in the first",
                "identify the same parameters each time",
            )  # fmt: skip
    values, predicted = ([getattr(item, name) for item in estimates] for name in ("values", "standard_deviations"))
    return repeats(first, values, predicted, level)


def deviation_factors(count: int, level: float = 0.95) -> tuple[float, float]:
    """(low, high): the true standard deviation lies within low s and high s, s that of ``count`` normal values."""
    from scipy.special import chdtri

    free = count - 1
    low, high = (free / float(chdtri(free, tail)) for tail in ((1 - level) / 2, (1 + level) / 2))
    return low**0.5, high**0.5


def scatter_study(
    experiment: Callable[[int], Estimate], runs: int, truth: ArrayLike, level: float = 0.95, progress: Any = None
) -> ScatterStudy:
    """Monte Carlo: ``experiment`` called with the seeds 0 to runs - 1, its predicted scatter against the one that appears.

    truth (q,): the parameters as they are. progress: told the number of the run. Raises InvalidInput for fewer than 10 runs.
    """
    if runs < 10:
        raise invalid("runs", runs, "at least 10", "50 tell a standard deviation to about 10 %")
    estimates = []
    for seed in range(runs):
        estimates.append(experiment(seed))
        if progress is not None:
            progress(seed + 1)
    return study(estimates, truth, level)


def study(estimates: Sequence[Estimate], truth: ArrayLike, level: float = 0.95) -> ScatterStudy:
    """The same from experiments that are done. Raises InvalidInput."""
    from scipy.special import ndtri

    all_of = of_estimates(estimates, level)
    truth = check_shape(truth, "truth", "(q)", q=len(all_of.paths))
    stated = np.array([item.standard_deviations for item in estimates])
    if not (all_of.deviation > 0).all() or not (stated > 0).all():
        raise InvalidInput("a parameter has no scatter at all; give every run its own noise (seed)")
    ratio = all_of.predicted / all_of.deviation
    low, high = deviation_factors(all_of.count, level)
    bias = (all_of.mean - truth) / (all_of.deviation / np.sqrt(all_of.count))
    covered = np.mean(np.abs(all_of.values - truth) <= float(ndtri((1 + level) / 2)) * stated, axis=0)
    verdict = _verdict(all_of, ratio, (low, high), bias)
    return ScatterStudy(all_of, truth, ratio, np.array([low, high])[:, None] * np.ones(len(truth)), bias, covered, verdict)


def _verdict(all_of: Repeats, ratio: np.ndarray, by_chance: tuple[float, float], bias: np.ndarray) -> str:
    q = len(ratio)
    wrong = [i for i in range(q) if not by_chance[0] <= ratio[i] <= by_chance[1]]
    text = (
        f"predicted over observed standard deviation is {ratio.min():.2f} to {ratio.max():.2f} over {q} parameters and "
        f"{all_of.count} runs ({by_chance[0]:.2f} to {by_chance[1]:.2f} may be chance)"
    )
    if wrong:
        worst = max(wrong, key=lambda i: abs(np.log(ratio[i])))
        text += f"; outside are {len(wrong)}, the worst {all_of.paths[worst]} with {ratio[worst]:.2f}"
    return text + f"; the largest bias is {np.abs(bias).max():.1f} standard errors"
