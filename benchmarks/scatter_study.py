"""Monte Carlo: the scatter that identifications predict against the one that appears over many
seeds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ambrose.core.checks import InvalidInput, check_shape, invalid
from ambrose.identification.parameters import Estimate
from ambrose.identification.validation.repeatability import Repeats, of_estimates


@dataclass(frozen=True, slots=True, eq=False)
class ScatterStudy:
    """Predicted against observed scatter over many repeats with a known truth, per parameter (q,).

    ratio: predicted over observed standard deviation, with ratio_range (2, q), where it lies by
    chance if the prediction is right. bias [-]: (mean - truth) in standard errors of the mean.
    covered [-]: share of the experiments whose stated interval (``level``, normal) holds the truth.
    verdict: one sentence.
    """

    repeats: Repeats
    truth: np.ndarray
    ratio: np.ndarray
    ratio_range: np.ndarray
    bias: np.ndarray
    covered: np.ndarray
    verdict: str


def deviation_factors(count: int, level: float = 0.95) -> tuple[float, float]:
    """(low, high): the true standard deviation lies within low s and high s, s that of ``count``
    normal values.
    """
    from scipy.special import chdtri

    free = count - 1
    low, high = (free / float(chdtri(free, tail)) for tail in ((1 - level) / 2, (1 + level) / 2))
    return low**0.5, high**0.5


def scatter_study(
    experiment: Callable[[int], Estimate],
    runs: int,
    truth: ArrayLike,
    level: float = 0.95,
    progress: Any = None,
) -> ScatterStudy:
    """Monte Carlo: ``experiment`` called with the seeds 0 to runs - 1, its predicted scatter
    against the one that appears.

    truth (q,): the parameters as they are. progress: told the number of the run. Raises
    InvalidInput for fewer than 10 runs.
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
    covered = np.mean(
        np.abs(all_of.values - truth) <= float(ndtri((1 + level) / 2)) * stated, axis=0
    )
    verdict = _verdict(all_of, ratio, (low, high), bias)
    return ScatterStudy(
        all_of,
        truth,
        ratio,
        np.array([low, high])[:, None] * np.ones(len(truth)),
        bias,
        covered,
        verdict,
    )


def _verdict(
    all_of: Repeats, ratio: np.ndarray, by_chance: tuple[float, float], bias: np.ndarray
) -> str:
    q = len(ratio)
    wrong = [i for i in range(q) if not by_chance[0] <= ratio[i] <= by_chance[1]]
    text = (
        f"predicted over observed standard deviation is {ratio.min():.2f} to {ratio.max():.2f} "
        f"over {q} parameters and "
        f"{all_of.count} runs ({by_chance[0]:.2f} to {by_chance[1]:.2f} may be chance)"
    )
    if wrong:
        worst = max(wrong, key=lambda i: abs(np.log(ratio[i])))
        text += (
            f"; outside are {len(wrong)}, the worst {all_of.paths[worst]} with {ratio[worst]:.2f}"
        )
    return text + f"; the largest bias is {np.abs(bias).max():.1f} standard errors"
