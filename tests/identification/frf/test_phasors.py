"""Phasors of steady sines against what the signals were made of: harmonics, offset and drift are no
sine of order 1.
"""

import numpy as np
import pytest

from ambrose.identification.frf import Step, phasors
from ambrose.record.record import Record

RATE = 1e4


def found(wave, frequency, turns, rate=RATE):
    """The phasor of a signal, a function of angle and time, over so many turns."""
    t = np.arange(int(turns * rate / frequency) + 1) / rate
    record = Record("m", rate, ("y_A_zeta",), ("m",), wave(2 * np.pi * frequency * t, t)[None])
    return phasors(record, Step(2 * np.pi * frequency, 0.0, len(t) / rate), ["y_A_zeta"], 0.0)


@pytest.mark.parametrize("turns", [3, 8, 20, 70])
@pytest.mark.parametrize("order", [2, 3, 5, 8])
def test_a_harmonic_is_no_sine_of_order_one(order, turns):
    only = found(lambda angle, t: np.cos(order * angle + 0.4), 23.7, turns)
    assert np.abs(only.blocks).max() < 1e-9


@pytest.mark.parametrize("turns", [3, 20])
def test_offset_and_drift_are_none_either(turns):
    """Beside a sine of a known phasor, with a second harmonic of its size."""
    made = found(lambda angle, t: 5 + 40 * t + np.cos(angle + 0.7) + np.sin(2 * angle), 31.3, turns)
    assert np.abs(made.blocks - np.exp(0.7j)).max() < 1e-9


@pytest.mark.parametrize("samples", [4.7, 7.3, 12.1])
def test_few_samples_in_a_turn_tell_what_they_can(samples):
    """The orders that half the sample rate allows are told apart; the sine alone is exact always."""
    made = found(lambda angle, t: np.cos(angle + 0.7) + 0.3, RATE / samples, 400)
    assert made.mean[0] == pytest.approx(np.exp(0.7j), abs=1e-9)


def test_noise_is_no_larger_than_that_of_a_sine_alone():
    """The variance of a phasor from k samples of unit noise is 4/k, harmonics and drift or not."""
    rng = np.random.default_rng(0)
    spread = [
        found(lambda angle, t: rng.standard_normal(len(t)), 100.0, 12).mean[0] for _ in range(300)
    ]
    assert np.mean(np.abs(spread) ** 2) == pytest.approx(4 / 1200, rel=0.2)
