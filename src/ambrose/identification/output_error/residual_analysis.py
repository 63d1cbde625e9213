"""What the residual of one record says: fit per signal, autocovariance, and whether it still
follows an excitation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.fft

from ambrose.core.statespace import StateSpace
from ambrose.identification.output_error import statistics
from ambrose.identification.output_error.lagged_products import lagged_sums
from ambrose.identification.output_error.normal_equations import (
    RecordSolution,
    Task,
    residual_pieces,
)

_LAGS = 100  # samples over which the residual is compared with the excitation
_PIECE = 2**15  # samples from which it is taken how a signal follows the excitations
_EXACT = 1e-7  # residual over signal below which a record is noise-free and no test says anything


@dataclass(frozen=True, slots=True, eq=False)
class ResidualScores:
    """fit (p,) [%], NRMSE; covariance (p, p, span + 1) of the residuals at the lags 0 to span;
    tests: one per pair of signal and distinct excitation.
    """

    fit: np.ndarray
    covariance: np.ndarray
    tests: tuple[statistics.ResidualTest, ...]


def residual_scores(
    loop: StateSpace,
    task: Task,
    solution: RecordSolution,
    excitations: Sequence[str],
    signals: Sequence[str],
    count: int,
) -> ResidualScores:
    """The scores of a record at the theta of ``loop``, in one pass over its pieces.

    excitations: what to call the task's distinct signals; signals: the fitted ones; count: of all
    tests of the run.
    """
    p, k = len(signals), task.samples
    remembered = statistics.memory(k)
    lags = min(_LAGS, k - 1)
    span = max(remembered, lags)

    # signals: the residuals (p), then the distinct excitations
    auto_pairs = [(i, i) for i in range(p, p + len(task.e))]
    pairs = [(i, j) for i in range(p) for j in range(p)]
    crossed = [(i, e) for i in range(p) for e, _ in auto_pairs]
    sums = lagged_sums(residual_pieces(loop, task, solution), [*pairs, *crossed, *auto_pairs], span)
    covariance = statistics.tapered(sums.values[: p * p, : remembered + 1], k).reshape(
        p, p, remembered + 1
    )
    spread = np.array([_spread(task, i) for i in range(p)])
    with np.errstate(divide="ignore", invalid="ignore"):
        fit = 100.0 * (1.0 - np.sqrt(sums.squares[:p] / spread))
    followed = _followed(task, solution, lags)
    tests = []
    for i, signal in enumerate(signals):
        own_r = sums.about_the_means(i, i)
        size = float(np.sum(task.measured(i, 0, k) ** 2))
        quiet = bool(own_r[0] <= _EXACT**2 * size)
        for e, name in enumerate(excitations, p):
            products = sums.about_the_means(i, e)[: lags + 1], own_r[: remembered + 1]
            own_e = sums.about_the_means(e, e)[: remembered + 1]
            tests.append(
                statistics.input_test(
                    *products, own_e, k, signal, name, count, quiet, float(followed[i, e - p])
                )
            )
    return ResidualScores(fit, covariance, tuple(tests))


def _spread(task: Task, i: int) -> float:
    """The sum of squares of a measured signal about its mean."""
    y = task.measured(i, 0, task.samples)
    return float(np.sum((y - y.mean()) ** 2))


def _followed(task: Task, solution: RecordSolution, lags: int) -> np.ndarray:
    """The largest sum (p, r) over the record of a signal, less what turns with the rotor, and an
    excitation before it.
    """
    n = min(task.samples, _PIECE)
    waves = task.waves_at(0, n)
    y = np.array([task.measured(i, 0, n) - solution.b[i] @ waves for i in range(len(task.y))])
    size, e = scipy.fft.next_fast_len(n + lags, real=True), np.array([wave[:n] for wave in task.e])
    Y, E = (
        scipy.fft.rfft(rows - rows.mean(axis=1, keepdims=True), size, axis=1) for rows in (y, e)
    )

    # y(t) e(t - lag) over the first piece, scaled to the whole record
    sums = scipy.fft.irfft(Y[:, None] * E[None].conj(), size, axis=2)[:, :, : lags + 1]
    return np.asarray(np.abs(sums).max(axis=2) * task.samples / n)
