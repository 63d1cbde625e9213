"""The first look at the record of one axis, before anything is fitted."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.signal import coherence

from ambrose.identification.data_quality.one_axis import (
    coarse_steps,
    coil_equation,
    dead_channels,
    levitation,
    longest_run,
    rate_by_weight,
)
from ambrose.identification.data_quality.signals import flat_tops
from ambrose.identification.findings import ERROR, WARNING, Code, Finding
from ambrose.identification.one_axis.axis_record import AxisRecord

_AT_RAIL = 0.02  # of the samples at a flat top; assumed
# different values of a signal, from which on its ends are rails; assumed: a square wave or a coarse
# converter lies at its ends without being cut off
_LEVELS = 50
# periods 2 pi/pole of the plant in a segment of the coherence; assumed: what a segment begins with
# has died away in it
_SEGMENT = 4.0
_SHORTEST, _LEAST_COUNT = 64, 8  # samples of a segment, segments of a record; assumed
_SLOWEST = 1e-9  # [rad/s] of a plant's pole, so that none is divided by


def look(record: AxisRecord, travel: float | None = None) -> tuple[Finding, ...]:
    """What is wrong with it. travel [m]: between the stops, where the displacement is the distance
    from the magnet; None: it is counted from anywhere.
    """
    signals = {"displacement": record.position, "drive": record.drive}
    for name in ("current", "voltage"):
        if getattr(record, name) is not None:
            signals[name] = getattr(record, name)
    dead = tuple(dead_channels(signals))
    if dead:
        return dead
    current = record.drive if record.current is None and record.unit == "A" else record.current
    coil = {}
    if record.voltage is not None and current is not None:
        coil = {"voltage": record.voltage, "current": current}
    return (
        *(levitation(record.time, record.position, travel) if travel else ()),
        *(rate_by_weight(record.time, record.position) if travel else ()),
        *(() if travel else _rails(record)),
        *_silent_reference(record),
        *coarse_steps({name: signals[name] for name in ("displacement", "drive")}),
        *(coil_equation(record.time, coil) if coil else ()),
    )


def _rails(record: AxisRecord) -> Iterator[Finding]:
    """A share of samples at the very ends of a signal: a stop, a sensor's or a converter's end."""
    for name, values in (("displacement", record.position), ("drive", record.drive)):
        count, level = flat_tops(values)
        share = count / len(values)
        if share > _AT_RAIL and len(np.unique(values)) >= _LEVELS:
            first, last = longest_run(values != level)
            start, stop = record.time[first], record.time[last]
            yield Finding(
                Code.TOUCHDOWN if name == "displacement" else Code.SATURATED,
                ERROR,
                f"the {name} is at an end of its range",
                f"{100 * share:.2g} % of its samples lie at {level:.4g}, in flat tops",
                f"cut out a part without (the longest: {start:.4g} to {stop:.4g} s), or record "
                "again",
            )


def _silent_reference(record: AxisRecord) -> Iterator[Finding]:
    if record.reference is not None and np.ptp(record.reference) == 0:
        yield Finding(
            Code.NO_EXCITATION,
            WARNING,
            "the reference never changes",
            f"{record.reference[0]:.3g} throughout",
            "it is left out; name the column of what was driven, if there was one",
        )


def coherence_with(
    driving: np.ndarray, position: np.ndarray, rate: float, pole: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """Frequencies (k,) [Hz], coherence (k,) of the displacement (n,) with what drives the loop
    (n,), and the value that is exceeded by chance in 5 of 100.

    pole [rad/s]: the plant's, which sets the segments. Of K segments that share no samples,
    1 - 0.05^(1/(K - 1)) (Bendat and Piersol, Random Data, 4th ed., 2010, section 9.2).
    """
    n = len(position)
    wanted = _SEGMENT * 2 * np.pi / max(pole, _SLOWEST) * rate
    length = int(min(max(wanted, _SHORTEST), n // _LEAST_COUNT))
    frequency, value = coherence(driving, position, rate, nperseg=length)
    segments = max(n // length, 2)
    return frequency, np.nan_to_num(value), float(1 - 0.05 ** (1 / (segments - 1)))
