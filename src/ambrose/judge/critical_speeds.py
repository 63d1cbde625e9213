"""Critical speeds in an unbalance response: where it peaks sharply enough (API 617, lateral
analysis; recalled).

A peak at N with half-power band N1 to N2, where the response is 1/sqrt(2) of the peak, has the
amplification factor N / (N2 - N1). From 2.5 on it is a critical speed, below it is called
critically damped and needs no separation margin.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from ambrose.judge.checks import Check, Curve
from ambrose.judge.criteria import judge
from ambrose.machine.criteria import TWO_PI, demand
from ambrose.machine.description import Requirements
from ambrose.model.separation import LEAST_AMPLIFICATION, allowed_amplification

_TAKEN = (
    "; no running_speeds in the machine file: taken to run from its slowest to its fastest turning "
    "operating point"
)
_SAME = 0.03  # peaks of two lines this near to each other are one critical speed


def critical_speeds(curve: Curve) -> tuple[tuple[float, float], ...]:
    """(speed [rad/s], amplification factor) of an "unbalance" curve, by speed; of all its lines but
    the envelope "worst case".

    Where only one flank falls to half power inside the curve, twice that flank is the band; a peak
    without any is left out.
    """
    rows = [
        row
        for label, row in zip(curve.labels, curve.y, strict=True)
        if label != "worst case" or len(curve.labels) == 1
    ]
    return tuple(peak for peak in _different(curve.x, rows) if peak[1] >= LEAST_AMPLIFICATION)


def separation_check(
    omega: np.ndarray, orbits: np.ndarray, requirements: Requirements, running: tuple[float, float]
) -> Check:
    """The critical speed of orbits (k, w) over omega (w,) [rad/s] that comes nearest to what API
    617 allows, or past it.

    Its value is the amplification factor over the allowed one: 0 where no peak stands near
    ``running`` [rad/s]. The detail lists all critical speeds, the one that binds first.
    """
    resonances = _different(omega, orbits)
    allowed = allowed_amplification(np.array([speed for speed, _ in resonances]), running)
    ratio = np.array([factor for _, factor in resonances]) / allowed
    listed = "; ".join(
        f"{speed / TWO_PI:.4g} Hz has {factor:.3g}, "
        f"{f'allowed {most:.3g}' if math.isfinite(most) else 'far enough'}"
        for (speed, factor), most in (
            (resonances[k], allowed[k]) for k in np.argsort(-ratio, kind="stable")
        )
        if factor >= LEAST_AMPLIFICATION
    )
    low, high = (speed / TWO_PI for speed in running)
    title = (
        f"Amplification factor near the running speeds, {low:.4g} to {high:.4g} Hz, relative to "
        "the allowed one"
    )
    wanted = demand("separation margin", requirements)
    return judge(
        "unbalance.separation",
        title,
        float(ratio.max(initial=0.0)),
        "-",
        wanted,
        (listed or f"no peak has a factor of {LEAST_AMPLIFICATION:g}: no critical speed")
        + ("" if requirements.running_speeds else _TAKEN),
    )


def _different(x: np.ndarray, rows: Iterable[np.ndarray]) -> list[tuple[float, float]]:
    kept: list[tuple[float, float]] = []
    for speed, factor in sorted(
        (peak for row in rows for peak in _peaks(x, row)), key=lambda item: -item[1]
    ):
        if all(abs(speed - other) > _SAME * other for other, _ in kept):
            kept.append((speed, factor))
    return sorted(kept)


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
    """From the peak y[0] to half power along one side; None where the curve ends or rises above the
    peak before.
    """
    half = y[0] / math.sqrt(2)
    k = int(np.argmax(y < half))
    if y[k] >= half or y[:k].max() > y[0]:
        return None
    return abs(float(np.interp(half, [y[k], y[k - 1]], [x[k], x[k - 1]]) - x[0]))
