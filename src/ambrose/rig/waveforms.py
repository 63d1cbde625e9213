"""A scenario's disturbances as cubics between the samples: exact for pulses, to (w dt)^4/384 for
all that turns.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from itertools import pairwise

import numpy as np

from ambrose.core.checks import InvalidInput, check_finite, invalid
from ambrose.core.response import hermite
from ambrose.core.statespace import index_of
from ambrose.rig.disturbances import Chirp, Disturbance, Failure, Prbs, Pulse, Unbalance
from ambrose.rig.scenario import Scenario

_STRETCHED = 0.1  # share by which a duration or a bit may be rounded to whole samples
FASTEST = 0.32  # largest (w dt) of a sine between samples: an error of 3e-5


def waveforms(
    scenario: Scenario,
    inputs: Sequence[str],
    dt: float,
    k: int,
    mass: float | None = None,
    first: int = 0,
    turning: bool = True,
) -> tuple[list[str], np.ndarray]:
    """The driven inputs' names, and the cubics c (4, m, k) they follow from sample to sample
    (core/response.py: hermite).

    inputs: the names that the loop has. dt [s], k samples from number ``first`` on; mass [kg] of
    the rotor; turning False: without the unbalances. Raises InvalidInput for an unknown signal
    (listing the known ones), a length of few samples that rounding would stretch, or a sine too
    fast for dt. Edges move to the nearest sample.
    """
    rows: dict[str, np.ndarray] = {}

    def row(name: str) -> np.ndarray:
        index_of(name, inputs, "input")
        return rows.setdefault(name, np.zeros((4, k)))

    def smooth(
        item: Disturbance, angle_and_rate: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
    ) -> None:
        for start, stop, offset in _windows(item, dt, first, k):
            angle, rate = angle_and_rate(np.arange(offset, offset + stop - start + 1) * dt)
            value, slope = item.amplitude * np.sin(angle), item.amplitude * rate * np.cos(angle)
            row(item.signal)[:, start:stop] += hermite(value[None], slope[None], dt)[:, 0]

    for item in scenario.all_windows:
        row(item.signal)
    for pulse in scenario.pulses:
        for start, stop, _ in _windows(pulse, dt, first, k):
            row(pulse.signal)[0, start:stop] += pulse.amplitude
    for prbs in scenario.sequences:
        for start, stop, offset in _windows(prbs, dt, first, k):
            row(prbs.signal)[0, start:stop] += prbs.amplitude * _levels(
                prbs, dt, offset, stop - start
            )
    for sine in scenario.all_sines:
        _check_smooth(sine.frequency, dt, f"the sine on {sine.signal}")
        w, phase = sine.frequency, sine.phase
        smooth(sine, lambda t, w=w, phase=phase: (w * t + phase, np.full_like(t, w)))  # type: ignore[misc]
    for chirp in scenario.chirps:
        _check_smooth(max(chirp.frequency, chirp.to_frequency), dt, f"the chirp on {chirp.signal}")
        smooth(chirp, _sweep(chirp, scenario.duration))
    for unbalance in scenario.unbalances if turning else ():
        names = directions(unbalance.port, inputs)
        for start, stop, force, rate in _turning(scenario, unbalance, dt, first, k, mass):
            for name, part in zip(names, (np.real, np.imag), strict=True):
                row(name)[:, start:stop] += hermite(part(force)[None], part(rate)[None], dt)[:, 0]
    driven = [name for name in inputs if name in rows]
    return driven, np.stack([rows[name] for name in driven], axis=1) if driven else np.zeros(
        (4, 0, k)
    )


def without_power(failure: Failure, dt: float, first: int, count: int) -> slice:
    """Those among the samples first .. first + count - 1 of dt [s]."""
    end = count if failure.until is None else sample_of(failure.until, dt) - first
    return slice(max(sample_of(failure.time, dt) - first, 0), max(end, 0))


def sample_of(time: float, dt: float) -> int:
    """The number of the sample that is nearest to an edge at a time [s]: an edge moves by half a
    sample at most.
    """
    return round(min(time / dt, 1e15))


def samples_in(length: float, dt: float, what: str) -> int:
    """How many samples a length [s] is, to the nearest. Raises InvalidInput where that changes it
    by more than a tenth.
    """
    count = sample_of(length, dt)
    if abs(count * dt - length) > _STRETCHED * length:
        least = f"{math.ceil(0.5 / _STRETCHED) * dt:.3g} s"
        remedy = (
            f"choose a shorter sample time, or a multiple of it ({least} and more are met well "
            "enough)"
        )
        raise invalid(what, f"{length:g} s", f"within a tenth of whole samples of {dt:g} s", remedy)
    return count


def directions(port: str, inputs: Sequence[str]) -> tuple[str, str]:
    """The two force inputs of a port; raises InvalidInput where there are none."""
    for first, second in (("zeta", "eta"), ("x", "y")):
        if f"f_{port}_{first}" in inputs and f"f_{port}_{second}" in inputs:
            return f"f_{port}_{first}", f"f_{port}_{second}"
    known = sorted({name[2:].rpartition("_")[0] for name in inputs if name.startswith("f_")})
    raise InvalidInput(
        f"the unbalance is at port {port!r}, which the loop has not; it has "
        f"{', '.join(known) or 'none'}"
    )


def _windows(item: Disturbance, dt: float, first: int, k: int) -> Iterator[tuple[int, int, int]]:
    """First and past-the-last column of a disturbance and of its repetitions, and how long it then
    has been on [samples].
    """
    what = f"of the disturbance on {item.signal}"
    begin, end = sample_of(item.start, dt), first + k
    length = end if item.duration is None else samples_in(item.duration, dt, f"the duration {what}")
    every = (
        samples_in(item.every, dt, f"the period {what}")
        if isinstance(item, Pulse) and item.every is not None
        else 0
    )

    # from the last repetition that begins at or before this piece
    if every and begin < first:
        begin += (first - begin) // every * every
    while begin < end:
        start, stop = max(begin, first), min(begin + length, end)
        if start < stop:
            yield start - first, stop - first, start - begin
        if not every:
            break
        begin += every


@lru_cache(maxsize=8)
def _sequence(order: int, shift: int) -> np.ndarray:
    """One period of +-1."""
    from scipy.signal import max_len_seq

    bits = np.roll(2.0 * max_len_seq(order)[0] - 1.0, shift)
    bits.flags.writeable = False
    return bits


def _levels(prbs: Prbs, dt: float, offset: int, count: int) -> np.ndarray:
    """+-1 for ``count`` samples of a sequence that has been on for ``offset`` samples."""
    bit_samples = samples_in(prbs.bit_time, dt, f"the bit_time on {prbs.signal}")
    if bit_samples < 1:
        raise invalid(
            f"the bit_time on {prbs.signal}",
            f"{prbs.bit_time:g} s",
            f"at least dt = {dt:g} s",
            "lengthen it",
        )
    bits = _sequence(prbs.order, prbs.shift)
    return bits[(np.arange(offset, offset + count) // bit_samples) % len(bits)]


def _sweep(chirp: Chirp, end: float) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Angle and frequency over the time [s] since its start."""
    T = end - chirp.start if chirp.duration is None else chirp.duration
    a, b = chirp.frequency, chirp.to_frequency
    # w = a + (b - a) t/T, angle its integral
    if chirp.spacing == "linear" or a == b:
        return lambda t: (a * t + (b - a) / T * t**2 / 2, a + (b - a) / T * t)
    # w = a e^(g t), angle int w dt = a/g (e^(g t) - 1)
    g = np.log(b / a) / T
    return lambda t: (a / g * np.expm1(g * t), a * np.exp(g * t))


def _check_smooth(frequency: float, dt: float, what: str) -> None:
    if float(check_finite(frequency, f"the frequency of {what}")) * dt > FASTEST * (1 + 1e-9):
        requirement = f"at most {FASTEST / dt:g} rad/s at dt = {dt:g} s"
        raise invalid(
            f"the frequency of {what}", f"{frequency:g} rad/s", requirement, "sample faster"
        )


def _turning(
    scenario: Scenario, unbalance: Unbalance, dt: float, first: int, k: int, mass: float | None
) -> Iterator[tuple[int, int, np.ndarray, np.ndarray]]:
    """Stretches of constant angular acceleration a: first and past-the-last column, force and its
    rate (complex) at all ends.

    F = U (W^2 - j a) exp(j phi), real part in the first direction and imaginary part in the second:
    minus the mass times the acceleration of a point that turns with phi'' = a.
    """
    amount = unbalance.mass_times_radius(mass)
    times, speeds = scenario.speed_knots
    _check_smooth(max(map(abs, speeds)), dt, f"the unbalance at {unbalance.port}")

    # corners of the speed at the nearest samples, and its slope between them
    turns = [round(time / dt) for time in times]
    at = [scenario.speed_at(turn * dt) for turn in turns]
    pieces = [
        (i, j, (w - v) / ((j - i) * dt))
        for (i, j), (v, w) in zip(pairwise(turns), pairwise(at), strict=True)
        if j > i
    ]
    start, angle = at[0], unbalance.phase
    for begin, end, acceleration in (*pieces, (turns[-1], max(first + k, turns[-1]), 0.0)):
        low, high = max(begin, first), min(end, first + k)
        if low < high:
            # W = W_0 + a t, phi = phi_0 + W_0 t + a t^2/2
            t = np.arange(low - begin, high - begin + 1) * dt
            W, phi = start + acceleration * t, angle + start * t + acceleration * t**2 / 2
            # F = U e^(j phi) (W^2 - j a), F' = U e^(j phi) (2 W a + j W (W^2 - j a))
            size = W**2 - 1j * acceleration
            turned = amount * np.exp(1j * phi)
            yield (
                low - first,
                high - first,
                turned * size,
                turned * (2 * W * acceleration + 1j * W * size),
            )
        # speed and angle at the start of the next stretch
        length = (end - begin) * dt
        start, angle = (
            start + acceleration * length,
            angle + start * length + acceleration * length**2 / 2,
        )
