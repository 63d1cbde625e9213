"""Whether the excitation of a record is enough: its order, and the rows of its signals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from ambrose.core.checks import check_shape, invalid
from ambrose.record.record import Record


def excitation_order(signals: ArrayLike, order: int = 100, threshold: float = 1e-8) -> int:
    """The order to which signals (m, k) excite persistently, at most ``order``: as many parameters
    per channel can be told.

    The largest n for which n successive samples of all channels have a covariance of full rank:
    smallest over largest eigenvalue above ``threshold``; Ljung (1999), definition 13.2. The best of
    every, every second, every fourth ... sample counts: slow signals hardly differ between samples,
    and leaving samples out adds no frequency. 0: not excited at all.
    """
    u = check_shape(signals, "signals", "(m, k)")
    order = _count(order, "order")
    step = 1
    best = 0
    if not u.any(axis=1).all():
        return 0
    while step == 1 or (best < order and u.shape[1] // step > 4 * order * len(u)):
        best = max(best, _rank_order(u[:, ::step], order, threshold))
        step *= 2
    return best


def signal_rows(record: Record, names: Sequence[str]) -> list[np.ndarray]:
    """The signals (k,) as views; zeros that take no memory for excitations e_, f_ and r_ that the
    record does not hold.
    """
    zeros = np.broadcast_to(0.0, (record.values.shape[1],))
    return [
        zeros if name[:2] in {"e_", "f_", "r_"} and name not in record.signals else record[name]
        for name in names
    ]


def _rank_order(u: np.ndarray, order: int, threshold: float) -> int:
    m, k = u.shape
    n = min(order, (k + 1) // (m + 1))
    if n < 1:
        return 0
    rows = (
        np.lib.stride_tricks.sliding_window_view(u, k - n + 1, axis=1)
        .transpose(1, 0, 2)
        .reshape(n * m, k - n + 1)
    )
    R = rows @ rows.T

    def full(count: int) -> bool:
        values = np.linalg.eigvalsh(R[: count * m, : count * m])
        return bool(values[0] > threshold * values[-1])

    low, high = 0, n
    while low < high:  # the leading blocks: once deficient, deficient for every larger count
        middle = (low + high + 1) // 2
        low, high = (middle, high) if full(middle) else (low, middle - 1)
    return low


def _count(value: int, name: str) -> int:
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 1:
        raise invalid(name, repr(value), "a whole number, at least 1", "give a number of samples")
    return int(value)
