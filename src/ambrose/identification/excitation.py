"""Excitation signals: sequences, chirps, pulses; patterns over the axes; whether they are enough.

A waveform (k,) [-] has the peak 1; a pattern makes of it the excitation (axes, k) [A] that is added to the controller's output.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from ambrose.core.checks import check_positive, check_shape, invalid
from ambrose.machine.machine import Machine
from ambrose.machine.record.record import Record

PATTERNS = ("parallel", "tilt", "single")
ORDERS = (3, 20)  # of a binary sequence


def prbs(order: int, clock: int, samples: int, shift: int = 0) -> np.ndarray:
    """A pseudo-random binary sequence (samples,) of +-1: maximum length 2^order - 1 bits, each held for ``clock`` samples.

    It repeats when the samples outlast it; ``shift`` starts it that many bits later, which makes nearly uncorrelated sequences
    for several axes. Flat spectrum up to about 0.44/(clock dt) Hz. Raises InvalidInput. Golomb (1967), ch. 3.
    """
    from scipy.signal import max_len_seq

    if not ORDERS[0] <= order <= ORDERS[1]:
        raise invalid("the order of the sequence", order, f"from {ORDERS[0]} to {ORDERS[1]}", "10 repeats after 1023 bits")
    clock, samples = _count(clock, "clock"), _count(samples, "samples")
    bits = 2.0 * max_len_seq(int(order))[0] - 1.0
    return bits[(np.arange(samples) // clock + shift) % len(bits)]


def chirp(start: float, stop: float, samples: int, dt: float) -> np.ndarray:
    """A sine (samples,) whose frequency goes linearly from ``start`` to ``stop`` [rad/s]. Raises InvalidInput past Nyquist."""
    dt = check_positive(dt, "dt", "give the sample time in seconds")
    for name, frequency in (("start", start), ("stop", stop)):
        _below_nyquist(check_positive(frequency, name, "give it in rad/s", zero_allowed=True), name, dt)
    t = np.arange(_count(samples, "samples")) * dt
    return np.sin(start * t + (stop - start) * t**2 / (2 * max(len(t) * dt, dt)))


def pattern(machine: Machine, kind: str, wave: ArrayLike, amplitude: float, axis: str = "") -> dict[str, np.ndarray]:
    """The excitation e_<axis> (k,) [A] of every control axis for one waveform (k,) [-] of peak 1, times ``amplitude`` [A].

    "parallel": the same on all axes; "tilt": opposite at the second bearing; "single": on ``axis`` ("A_zeta") alone.
    Raises InvalidInput.
    """
    wave = check_shape(wave, "wave", "(k)")
    amplitude = check_positive(amplitude, "amplitude", "give the peak current in A")
    axes = machine.axes
    if kind not in PATTERNS:
        raise invalid("kind", repr(kind), f"one of {', '.join(PATTERNS)}", "choose one of them")
    if kind == "single" and axis not in axes:
        raise invalid("axis", repr(axis), f"one of {', '.join(axes)}", "name the axis that is excited")
    if kind == "tilt" and len(machine.bearings) != 2:
        raise invalid("the number of bearings", len(machine.bearings), "2 for a tilt pattern", "use parallel or single")
    single = [float(name == axis) for name in axes]
    signs = {"parallel": [1.0] * len(axes), "tilt": [1.0, 1.0, -1.0, -1.0], "single": single}[kind]
    return {f"e_{name}": amplitude * sign * wave for name, sign in zip(axes, signs, strict=True)}


def excitation_order(signals: ArrayLike, order: int = 100, threshold: float = 1e-8) -> int:
    """The order to which signals (m, k) excite persistently, at most ``order``: as many parameters per channel can be told.

    The largest n for which n successive samples of all channels have a covariance of full rank: smallest over largest
    eigenvalue above ``threshold``; Ljung (1999), definition 13.2. The best of every, every second, every fourth ... sample
    counts: slow signals hardly differ between samples, and leaving samples out adds no frequency. 0: not excited at all.
    """
    u = check_shape(signals, "signals", "(m, k)")
    order, step, best = _count(order, "order"), 1, 0
    if not u.any(axis=1).all():
        return 0
    while step == 1 or (best < order and u.shape[1] // step > 4 * order * len(u)):
        best = max(best, _rank_order(u[:, ::step], order, threshold))
        step *= 2
    return best


def signal_rows(record: Record, names: Sequence[str]) -> list[np.ndarray]:
    """The signals (k,) as views; zeros that take no memory for excitations e_, f_ and r_ that the record does not hold."""
    zeros = np.broadcast_to(0.0, (record.values.shape[1],))
    return [zeros if name[:2] in {"e_", "f_", "r_"} and name not in record.signals else record[name] for name in names]


def _rank_order(u: np.ndarray, order: int, threshold: float) -> int:
    m, k = u.shape
    n = min(order, (k + 1) // (m + 1))
    if n < 1:
        return 0
    rows = np.lib.stride_tricks.sliding_window_view(u, k - n + 1, axis=1).transpose(1, 0, 2).reshape(n * m, k - n + 1)
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


def _below_nyquist(frequency: float, name: str, dt: float) -> None:
    if frequency * dt >= np.pi:
        raise invalid(name, f"{frequency:g} rad/s", f"below Nyquist, {np.pi / dt:g} rad/s", "sample faster, or sweep less far")
