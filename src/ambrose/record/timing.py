"""The sample rate of a column of times, and what is wrong with the times."""

from __future__ import annotations

import numpy as np

from ambrose.core.checks import invalid

# largest deviation of one time step from the others, as a fraction: beyond it, a sample was
# mistimed
_JITTER = 0.05


def uniform_rate(time: np.ndarray, stated: float | None) -> float:
    """The sample rate [Hz] of uniformly increasing times (k,) [s]; raises InvalidInput at a gap or
    a mistimed sample.
    """
    if len(time) < 2:
        raise invalid("the number of samples", len(time), "at least 2", "one row has no time step")
    if not np.isfinite(time).all():
        raise invalid(
            "a time",
            "not finite",
            "a number",
            f"look at data row {int(np.argmin(np.isfinite(time))) + 1}",
        )
    with np.errstate(over="ignore"):
        step = np.diff(time)
        usual = float(np.median(step))
        bad = np.flatnonzero(~(np.abs(step - usual) <= _JITTER * abs(usual)))
    if usual <= 0 or len(bad):
        i = int(bad[0]) if len(bad) else 0
        what = f"{step[i]:g} s after t = {time[i]:.9g} s"
        missing = round(step[i] / usual) - 1 if usual > 0 and abs(step[i]) < 1e15 * usual else 0
        remedy = (
            f"{missing} samples are missing there"
            if missing > 0
            else "resample the signals uniformly"
        )
        raise invalid("a time step", what, f"positive and uniform (here {usual:g} s)", remedy)
    rate = (len(time) - 1) / float(time[-1] - time[0])
    if stated is None:
        return float(f"{rate:.12g}")
    if abs(stated - rate) > 1e-3 * rate:
        raise invalid(
            "sample_rate_hz",
            stated,
            f"that of the time column, {rate:.9g} Hz",
            "correct one of them",
        )
    return stated
