"""Excitation signals as arrays, peak 1 (the rig makes its own,
ambrose/rig/scenario.py).
"""

from __future__ import annotations

import numpy as np

from ambrose.core.checks import check_positive, invalid
from ambrose.identification.findings import _count

ORDERS = (3, 20)  # of a binary sequence


def prbs(order: int, clock: int, samples: int, shift: int = 0) -> np.ndarray:
    """A pseudo-random binary sequence (samples,) of +-1: maximum length 2^order - 1 bits, each held
    for ``clock`` samples.

    It repeats when the samples outlast it; ``shift`` starts it that many bits later, which makes
    nearly uncorrelated sequences for several axes. Flat spectrum up to about 0.44/(clock dt) Hz.
    Raises InvalidInput. Golomb (1967), ch. 3.
    """
    from scipy.signal import max_len_seq

    if not ORDERS[0] <= order <= ORDERS[1]:
        raise invalid(
            "the order of the sequence",
            order,
            f"from {ORDERS[0]} to {ORDERS[1]}",
            "10 repeats after 1023 bits",
        )
    clock, samples = _count(clock, "clock"), _count(samples, "samples")
    bits = 2.0 * max_len_seq(int(order))[0] - 1.0
    return bits[(np.arange(samples) // clock + shift) % len(bits)]


def chirp(start: float, stop: float, samples: int, dt: float) -> np.ndarray:
    """A sine (samples,) whose frequency goes linearly from ``start`` to ``stop`` [rad/s]. Raises
    InvalidInput past Nyquist.
    """
    dt = check_positive(dt, "dt", "give the sample time in seconds")
    for name, frequency in (("start", start), ("stop", stop)):
        _below_nyquist(
            check_positive(frequency, name, "give it in rad/s", zero_allowed=True), name, dt
        )
    t = np.arange(_count(samples, "samples")) * dt
    return np.sin(start * t + (stop - start) * t**2 / (2 * max(len(t) * dt, dt)))


def _below_nyquist(frequency: float, name: str, dt: float) -> None:
    if frequency * dt >= np.pi:
        raise invalid(
            name,
            f"{frequency:g} rad/s",
            f"below Nyquist, {np.pi / dt:g} rad/s",
            "sample faster, or sweep less far",
        )
