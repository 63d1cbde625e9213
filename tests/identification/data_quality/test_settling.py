"""The beginning of a record at which the rotor had not settled."""

from dataclasses import replace

import numpy as np
import pytest

from ambrose.identification.data_quality.settling import left_out, settled
from ambrose.record.record import Record

AXES = ("zeta", "eta")
RATE = 5000.0


def record(seconds=4.0, off=0.0, within=0.1, excitation=None, seed=0):
    """Displacements [m] that begin ``off`` from their middle and come back ``within`` a time
    constant, under a binary sequence or the excitation given.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * RATE)) / RATE
    e = rng.choice([-0.1, 0.1], (2, len(t))) if excitation is None else excitation(t)
    # a rotor in its bearings: 40 Hz, well damped
    y = np.array([np.convolve(row, np.exp(-np.arange(400) / 50) * 2e-6)[: len(t)] for row in e])
    y += off * np.exp(-t / within) + rng.normal(0, 1e-7, y.shape) + 3e-6
    names = [*(f"e_{axis}" for axis in AXES), *(f"y_{axis}" for axis in AXES)]
    return Record("toy", RATE, tuple(names), ("A", "A", "m", "m"), np.array([*e, *y]))


def test_a_record_that_has_settled_is_taken_whole():
    for seed in range(200):
        whole = record(1.0 + 0.02 * seed, seed=seed)
        assert settled(whole, AXES) is whole


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("off", [-40e-6, 60e-6])
def test_lift_off_is_left_out(off, seed):
    whole = record(8.0, off, seed=seed)
    kept = settled(whole, AXES)
    # exp(-t/0.1) falls to the signal's own size, a few micrometres, between these
    assert 0.15 < kept.start_time < 1.0
    assert abs(kept["y_zeta"][:500].mean() - 3e-6) < 3e-6
    assert "0." in left_out([whole], [kept]) and "record 1" in left_out([whole], [kept])
    assert left_out([whole], [whole]) == ""


def test_a_slow_chirp_is_no_lift_off():
    """It begins at its largest amplitude, and the excitation does it."""

    def chirp(t):
        return 0.2 * np.cos(2 * np.pi * (1.0 + 10 * t) * t)[None].repeat(2, axis=0)

    whole = record(8.0, excitation=chirp)
    assert settled(whole, AXES) is whole


def test_what_never_settles_is_not_cut():
    """A drift over the whole record is for the checks, not for scissors."""
    drifting = record(4.0, 60e-6, within=4.0)
    assert settled(drifting, AXES) is drifting
    short = record(0.1, 60e-6)
    assert settled(short, AXES) is short


def test_where_the_rotor_is_off_matters_not_which_axis():
    whole = record(8.0)
    values = whole.values.copy()
    values[-1, :1000] += 50e-6 * np.exp(-np.arange(1000) / 300)
    kept = settled(replace(whole, values=values), AXES)
    assert kept.start_time > 0.05
