"""The beginning of a record at which the rotor had not settled."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from ambrose.identification.data_quality.signals import left_out, settled, signal_findings
from ambrose.identification.findings import Code
from ambrose.record.record import Record
from coarse import coarse

RATE = 5000.0


@cache
def machine():
    return coarse("seal-rig")


def record(seconds=4.0, motion=None, excitation=None, seed=0, more=None):
    """Displacements [m] under a binary sequence, or the excitation given, and the ``motion`` (k,)
    [m] that is nobody's; more: further rows by name.
    """
    rng = np.random.default_rng(seed)
    axes = machine().axes
    t = np.arange(round(seconds * RATE)) / RATE
    e = rng.choice([-0.1, 0.1], (len(axes), len(t))) if excitation is None else excitation(t)
    # a rotor in its bearings: 16 Hz, well damped
    y = np.array([np.convolve(row, np.exp(-np.arange(400) / 50) * 2e-6)[: len(t)] for row in e])
    y += rng.normal(0, 1e-7, y.shape) + 3e-6
    y += 0.0 if motion is None else motion(t)
    more = more or {}
    names = [*(f"e_{axis}" for axis in axes), *(f"y_{axis}" for axis in axes), *more]
    units = (
        ("A",) * len(axes)
        + ("m",) * len(axes)
        + tuple("N" if name[0] == "f" else "A" for name in more)
    )
    values = np.array([*e, *y, *(row(t) for row in more.values())])
    return Record("seal-rig", RATE, tuple(names), units, values)


@pytest.mark.parametrize("step", [16, pytest.param(1, marks=pytest.mark.study)])
def test_a_record_that_has_settled_is_taken_whole(step):
    for seed in range(0, 400, step):
        whole = record(0.5 + 0.02 * seed, seed=seed)
        assert settled(machine(), whole) is whole


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("hertz", [0, 3, 8, 40, 150])
@pytest.mark.parametrize("off", [-40e-6, 60e-6])
def test_what_decays_is_left_out(off, hertz, seed):
    """Also where it swings: a half-wave ends at the middle, and nothing has settled."""

    def motion(t):
        return off * np.exp(-t / 0.15) * np.cos(2 * np.pi * hertz * t)

    whole = record(8.0, motion, seed=seed)
    kept = settled(machine(), whole)
    assert 0.15 < kept.start_time <= 0.3 * 8
    # what is left of it is smaller than what the excitation does
    usual = record(8.0, seed=seed)["y_A_zeta"].std()
    left = np.abs(motion(kept.time - whole.time[0]))
    assert left.max() < 0.5 * usual
    assert "s of record 1 is left out" in left_out([whole], [kept])
    assert left_out([whole], [whole]) == ""


def slow(t):
    """A linear chirp from 1 Hz; it begins at zero."""
    return 0.2 * np.sin(2 * np.pi * (1.0 + 20 * t) * t)[None].repeat(4, axis=0)


def falling(t):
    """It begins at its largest amplitude, and the rotor with it."""
    return 0.2 * np.exp(-2 * t) * np.cos(2 * np.pi * 30 * t)[None].repeat(4, axis=0)


@pytest.mark.parametrize("excitation", [slow, falling])
@pytest.mark.parametrize("seconds", [4.0, 10.0])
def test_what_the_excitation_does_itself_stays(excitation, seconds):
    whole = record(seconds, excitation=excitation)
    assert settled(machine(), whole) is whole


def test_a_step_of_force_is_an_excitation():
    def step(t):
        return np.where(t < 1.0, 0.0, 100.0)

    def quiet(t):
        return np.zeros((4, len(t)))

    def moved(t):
        return np.where(t < 1.0, 0.0, 20e-6)

    whole = record(5.0, moved, quiet, more={"f_A_zeta": step})
    assert settled(machine(), whole) is whole


def test_what_never_settles_is_not_cut():
    """A drift over the whole record is for the checks, not for scissors."""
    drifting = record(4.0, lambda t: 60e-6 * np.exp(-t / 4))
    assert settled(machine(), drifting) is drifting
    short = record(0.1, lambda t: 60e-6 * np.exp(-t / 0.02))
    assert settled(machine(), short) is short


def test_a_knock_in_the_middle_is_not_cut():
    whole = record(8.0, lambda t: np.where(t < 1, 0.0, 60e-6 * np.exp(-(t - 1) / 0.05)))
    assert settled(machine(), whole) is whole


def test_contact_at_the_beginning_stays_to_be_refused():
    """The findings of the record must not be lost with it."""
    gap = machine().bearings[0].touchdown_gap
    gap = min(gap) if isinstance(gap, tuple) else gap
    whole = record(8.0, lambda t: 1.2 * gap * np.exp(-t / 0.1))
    assert settled(machine(), whole) is whole


def test_one_axis_or_the_controllers_output_is_enough():
    whole = record(8.0)
    decay = np.exp(-whole.time / 0.06)
    values = whole.values.copy()
    values[-1] += 50e-6 * decay
    assert settled(machine(), replace(whole, values=values)).start_time > 0.05
    noise = np.random.default_rng(1).normal(0, 0.05, len(whole.time))
    commands = record(8.0, more={"u_A_zeta": lambda t: 0.5 * np.exp(-t / 0.1) + noise})
    assert settled(machine(), commands).start_time > 0.1


@pytest.mark.parametrize(("at", "words"), [(0.1, "--between"), (6.0, "reduce the excitation")])
def test_a_limit_reached_in_the_beginning_alone_has_its_own_remedy(at, words):
    gap = machine().bearings[0].touchdown_gap
    gap = min(gap) if isinstance(gap, tuple) else gap
    whole = record(8.0, lambda t: 1.2 * gap * (np.abs(t - at) < 0.01))
    (found, *_) = [
        item for item in signal_findings(machine(), whole, 1, "e") if item.code == Code.TOUCHDOWN
    ]
    assert words in found.remedy
