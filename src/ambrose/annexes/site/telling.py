"""Which lines of a measured loop tell anything of a limit, and where to excite for the others.

Where the excitation has no power, or the noise is as large as what is sought, a response comes out
as anything: such a line speaks neither for the loop nor against it. The sensitivity of no loop at
all is 1. Of the way from there to the limit a third is left to the loop itself, one to the noise in
the value and one to its half-width; where noise takes more, a good loop would fail.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ambrose.judge.checks import Check
from ambrose.judge.criteria import judge
from ambrose.machine.criteria import TWO_PI, Demand

_PART = 1 / 3  # of the way from 1, no loop, to the limit: for loop, noise and half-width each
# half-widths that noise alone reaches once in half a million lines, of 20 degrees of freedom:
# (1 + (3 t)^2 / 40)^-20 with t = 2.02
_STANDS_OUT = 3.0
_NO_LIMIT = 3.0  # sensitivity that is asked about where none is a limit: zone A of ISO 14839-3
_ENOUGH = 0.95  # of the band, that has to tell; assumed
_NEAR_PEAK = 0.9  # of the predicted peak, where a line has to tell; assumed
_MOST = 3  # bands that are named


def _part(limit: float | None) -> float:
    return _PART * ((_NO_LIMIT if limit is None else limit) - 1)


def telling(
    value: np.ndarray, noise: np.ndarray, limit: float | None, lift: float | np.ndarray = 0.0
) -> np.ndarray:
    """Whether every value (w,) of a sensitivity with that 95 % half-width of noise tells on which
    side of ``limit`` it is (None: of zone A's), or stands out of its noise. lift (w,): what noise
    alone makes of the value where that is more.
    """
    allowed = _part(limit)
    alone = np.maximum(noise, lift)
    return np.asarray((noise <= allowed) | (value > _STANDS_OUT * alone))


def share(omega: np.ndarray, told: np.ndarray) -> float:
    """Of the band that the lines omega (w,) span, the part around those that tell."""
    width = np.gradient(omega) if len(omega) > 1 else np.ones(1)
    return float(width[told].sum() / width.sum())


def silent_bands(omega: np.ndarray, told: np.ndarray) -> list[tuple[float, float]]:
    """First and last of every run of lines that tell nothing [rad/s], the widest first."""
    edge = np.diff(np.r_[0, ~told, 0].astype(int))
    first, last = np.flatnonzero(edge == 1), np.flatnonzero(edge == -1) - 1
    found = [(float(omega[i]), float(omega[k])) for i, k in zip(first, last, strict=True)]
    return sorted(found, key=lambda ends: ends[0] - ends[1])


def where(omega: np.ndarray, told: np.ndarray) -> str:
    """The bands that tell nothing, in words, as they lie; empty without any."""
    bands = silent_bands(omega, told)
    named = ", ".join(
        f"{low / TWO_PI:.4g} Hz" if low == high else f"{low / TWO_PI:.4g} to {high / TWO_PI:.4g} Hz"
        for low, high in sorted(bands[:_MOST])
    )
    more = f" and {len(bands) - _MOST} more" if len(bands) > _MOST else ""
    return f"{named}{more}"


def judged_reach(
    names: Sequence[str],
    omega: np.ndarray,
    told: np.ndarray,
    predicted: np.ndarray,
    limits: Sequence[float | None],
) -> Check:
    """Whether the lines that tell, told (w, n), are enough of the band and about those peaks of
    predicted (w, n) that take more of the way to their limit than is the loop's, where a gap would
    hide what is asked for.
    """
    parts = np.array([share(omega, column) for column in told.T])
    title = "Part of the band in which the lines tell something, least of all axes"
    wanted = Demand(_ENOUGH, ">=", "")
    if told.all():
        return judge("sensitivity.told", title, 1.0, "-", wanted, "every line")
    high = np.array([1 + _part(limit) for limit in limits])
    hidden = ~told & (predicted >= np.maximum(_NEAR_PEAK * predicted.max(axis=0), high))
    at_peak = [
        f"the predicted peak of {name} at {omega[predicted[:, i].argmax()] / TWO_PI:.4g} Hz is "
        "not told"
        for i, name in enumerate(names)
        if hidden[:, i].any()
    ]
    low = f"{names[int(parts.argmin())]}: " if parts.min() < parts.max() else ""
    detail = "; ".join(
        [
            f"{low}excite there: {where(omega, told[:, int(parts.argmin())])}, where noise hides "
            "it; a binary sequence has no power at 1 over its bit time",
            *at_peak[:_MOST],
        ]
    )
    value = float(parts.min())
    check = judge("sensitivity.told", title, value, "-", wanted, detail)
    return replace(check, passed=False) if at_peak else check
