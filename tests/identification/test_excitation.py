"""Excitation signals against their defining properties."""

import numpy as np
import pytest
from benchmarks import waveforms

from ambrose.core.checks import InvalidInput
from ambrose.identification import findings as excitation


@pytest.mark.parametrize("order", [3, 7, 10, 13])
def test_prbs_has_maximal_length(order):
    period = 2**order - 1
    bits = waveforms.prbs(order, 1, 2 * period)
    np.testing.assert_array_equal(bits[:period], bits[period:])
    assert bits[:period].sum() in {1, -1}  # balanced to one bit
    runs = {tuple(np.roll(bits[:period], -i)[:order]) for i in range(period)}
    assert len(runs) == period  # every pattern of `order` bits but one, once


def test_prbs_clock_and_shift():
    slow, fast = waveforms.prbs(8, 5, 1000), waveforms.prbs(8, 1, 1000)
    np.testing.assert_array_equal(slow, np.repeat(fast, 5)[:1000])
    np.testing.assert_array_equal(waveforms.prbs(8, 1, 100, shift=30), fast[30:130])


def test_chirp_has_the_frequency_it_should():
    dt, k = 1e-4, 40_000
    wave = waveforms.chirp(100.0, 900.0, k, dt)
    phase = np.unwrap(
        np.angle(np.exp(1j * (100 * np.arange(k) * dt + 100 * (np.arange(k) * dt) ** 2)))
    )
    # 800 rad/s in 4 s: w(t) = 100 + 200 t
    np.testing.assert_allclose(wave, np.sin(phase), atol=1e-9)
    assert abs(wave).max() <= 1


def test_order_of_excitation():
    k, dt = 4000, 1e-3
    t = np.arange(k) * dt
    # slow: 6 numbers only in every 16th sample
    three = sum(np.sin(2 * np.pi * f * t) for f in (5, 11, 23))
    assert excitation.excitation_order(three[None], 20) == 6  # two for each sine
    assert excitation.excitation_order(np.zeros((1, k)), 20) == 0
    assert excitation.excitation_order(np.ones((1, k)), 20) == 1
    noise = np.random.default_rng(0).standard_normal((2, k))
    assert excitation.excitation_order(noise, 20) == 20
    # twice the same channel
    assert excitation.excitation_order(np.vstack([noise[0], noise[0]]), 20) == 0


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: waveforms.prbs(40, 1, 10), "order of the sequence is 40"),
        (lambda: waveforms.prbs(8, 0, 10), "clock is 0"),
        (lambda: waveforms.chirp(1.0, 4e4, 10, 1e-4), "below Nyquist"),
    ],
)
def test_bad_input(call, words):
    with pytest.raises(InvalidInput, match=words):
        call()
