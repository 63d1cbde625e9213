"""Critical speeds in an unbalance response: where it peaks sharply enough (API 617, lateral analysis; recalled).

A peak at N with half-power band N1 to N2, where the response is 1/sqrt(2) of the peak, has the amplification factor
N / (N2 - N1). From 2.5 on it is a critical speed, below it is called critically damped and needs no separation margin.
"""

from __future__ import annotations

import math

import numpy as np

from ambrose.verification.checks import Curve

LEAST_AMPLIFICATION = 2.5
_SAME = 0.03  # peaks of two lines this near to each other are one critical speed


def critical_speeds(curve: Curve) -> tuple[tuple[float, float], ...]:
    """(speed [rad/s], amplification factor) of an "unbalance" curve, by speed; of all its lines but the envelope "worst case".

    Where only one flank falls to half power inside the curve, twice that flank is the band; a peak without any is left out.
    """
    found: list[tuple[float, float]] = []
    for label, row in zip(curve.labels, curve.y, strict=True):
        if label != "worst case" or len(curve.labels) == 1:
            found += _peaks(curve.x, row)
    kept: list[tuple[float, float]] = []
    for speed, factor in sorted(found, key=lambda item: -item[1]):
        if factor >= LEAST_AMPLIFICATION and all(abs(speed - other) > _SAME * other for other, _ in kept):
            kept.append((speed, factor))
    return tuple(sorted(kept))


def _peaks(x: np.ndarray, y: np.ndarray) -> list[tuple[float, float]]:
    tops = np.flatnonzero((y[1:-1] > y[:-2]) & (y[1:-1] >= y[2:])) + 1
    peaks = []
    for top in tops:
        flanks = [_flank(x[top::step], y[top::step]) for step in (-1, 1)]
        known = [flank for flank in flanks if flank is not None]
        if known:
            peaks.append((float(x[top]), float(x[top] / (sum(known) * 2 / len(known)))))
    return peaks


def _flank(x: np.ndarray, y: np.ndarray) -> float | None:
    """From the peak y[0] to half power along one side; None where the curve ends or rises above the peak before."""
    half = y[0] / math.sqrt(2)
    k = int(np.argmax(y < half))
    if y[k] >= half or y[:k].max() > y[0]:
        return None
    return abs(float(np.interp(half, [y[k], y[k - 1]], [x[k], x[k - 1]]) - x[0]))
