"""First look at a record of one levitated axis, whatever controlled it: whether anything can be
identified from it, before anything is fitted.

findings = first_look(time, position, current, voltage=u, gap=0.02)

The plant is m y'' = k_s y + k_i i about the mean position, with the pole p = sqrt(k_s / m). Under
its own weight, f ~ (i / y)^2 holds it with k_s = 2 m g / y, so that p = sqrt(2 g / y): the rate
that a record needs is known before the plant is.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ambrose.core.checks import check_shape, invalid
from ambrose.identification.findings import ERROR, WARNING, Code, Finding

_GRAVITY = 9.81  # m/s^2
# samples per time constant 1/p of the plant: needed (measured: at 3 a fit's intervals hold the
# truth), and recommended
_LEAST_RATE, _GOOD_RATE = 3.0, 10.0
_COARSE = 0.05  # of a signal's rms, its smallest step; assumed
_AT_STOP = (
    0.02  # of the samples at an end of the travel, from which on it did not levitate; assumed
)
_BELONGS = 0.95  # of the voltage's variance that R i + L di/dt explains at least; assumed
_LEAST = 50  # samples


def first_look(
    time: np.ndarray,
    position: np.ndarray,
    current: np.ndarray,
    *,
    voltage: np.ndarray | None = None,
    gap: float | None = None,
) -> tuple[Finding, ...]:
    """What is wrong with a record of one levitated axis.

    time (n,) [s]; position (n,) [m], the distance from the magnet; current (n,) [A] and voltage
    (n,) [V] of its coil (None: not recorded); gap [m]: the travel (None: the largest position).
    Raises InvalidInput for arrays that do not belong together.
    """
    t = check_shape(time, "time", "(n)").astype(float)
    signals = {"position": position, "current": current}
    if voltage is not None:
        signals["voltage"] = voltage
    for name, values in signals.items():
        if np.shape(values) != t.shape:
            remedy = "record all signals together"
            raise invalid(f"the shape of {name}", np.shape(values), f"{t.shape}, as time", remedy)
    if len(t) < _LEAST or not (np.diff(t) > 0).all():
        wanted = f"{_LEAST} or more, ascending"
        raise invalid("time", f"{len(t)} values", wanted, "give the record as it was taken")
    dead = tuple(dead_channels(signals))
    alive = {name: np.asarray(values, float) for name, values in signals.items()}
    if dead:
        return dead
    return (
        *levitation(t, alive["position"], gap),
        *rate_by_weight(t, alive["position"]),
        *coarse_steps(alive),
        *coil_equation(t, alive),
    )


def dead_channels(signals: dict[str, np.ndarray]) -> Iterator[Finding]:
    """A signal of two values or fewer measures nothing."""
    for name, values in signals.items():
        count = len(np.unique(values))
        if count <= 2:
            yield Finding(
                Code.DEAD_CHANNEL,
                ERROR,
                f"{name} is dead",
                f"{count} value{'s' if count > 1 else ''} in {len(values)} samples",
                "look for another channel of it, or mend the sensor",
            )


def levitation(t: np.ndarray, position: np.ndarray, gap: float | None) -> Iterator[Finding]:
    """Samples (n,) at either end of the travel [m]: it fell, or it stuck."""
    far = position.max() if gap is None else gap
    edge = _AT_STOP * far
    stopped = (position <= edge) | (position >= far - edge)
    share = float(np.mean(stopped))
    if share > _AT_STOP:
        first, last = longest_run(~stopped)
        yield Finding(
            Code.TOUCHDOWN,
            ERROR,
            "it did not levitate all the time",
            f"{100 * share:.2g} % of the samples are at an end of the travel of {far:.3g} m",
            f"cut out the part in which it hovers (the longest: {t[first]:.4g} to {t[last]:.4g} s)"
            ", or record again",
        )


def longest_run(good: np.ndarray) -> tuple[int, int]:
    """First and last sample of the longest run of True in (n,); (0, 0) where there is none."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], good, [False]]).astype(int)))
    if not len(edges):
        return 0, 0
    starts, ends = edges[0::2], edges[1::2]
    longest = int(np.argmax(ends - starts))
    return int(starts[longest]), int(ends[longest]) - 1


def rate_by_weight(t: np.ndarray, position: np.ndarray) -> Iterator[Finding]:
    """Samples per time constant of the plant, p = sqrt(2 g / y) at the median position."""
    middle = float(np.median(position))
    if middle <= 0:
        return
    pole, step = np.sqrt(2 * _GRAVITY / middle), float(np.median(np.diff(t)))
    if pole * step * _LEAST_RATE > 1:
        yield Finding(
            Code.SAMPLE_RATE,
            ERROR,
            "the rate is too low for this plant",
            f"{1 / (pole * step):.2g} samples in the time in which a fall grows by e (by its "
            f"weight, f ~ (i/y)^2, the pole is at {pole:.3g} rad/s)",
            f"record at {_GOOD_RATE * pole:.2g} Hz or more",
        )


def coarse_steps(signals: dict[str, np.ndarray]) -> Iterator[Finding]:
    """The smallest step between values, over the signal's rms."""
    for name, values in signals.items():
        step = float(np.diff(np.unique(values)).min())
        share = step / float(values.std())
        if share > _COARSE:
            yield Finding(
                Code.CLIPPED,
                WARNING,
                f"{name} is coarse",
                f"its steps of {step:.2g} are {100 * share:.2g} % of its rms",
                "use more of the converter's range",
            )


def coil_equation(t: np.ndarray, signals: dict[str, np.ndarray]) -> Iterator[Finding]:
    """u = R i + L di/dt + c by least squares: how much of the voltage the current explains."""
    if "voltage" not in signals:
        return
    i, u = signals["current"], signals["voltage"]
    columns = np.column_stack([i, np.gradient(i, t), np.ones_like(i)])
    found = np.linalg.lstsq(columns, u, rcond=None)[0]
    share = 1 - float(np.sum((u - columns @ found) ** 2) / np.sum((u - u.mean()) ** 2))
    if share < _BELONGS:
        yield Finding(
            Code.MIXED_CHANNELS,
            ERROR,
            "the current does not belong to the voltage",
            f"R i + L di/dt explains {100 * share:.3g} % of it, at best with R = {found[0]:.3g} "
            f"ohm and {found[2]:+.2g} V beside",
            "record the voltage at the coil, or an average over its modulation, at the current's "
            "instants",
        )
