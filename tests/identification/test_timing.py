"""What docs/theory/timing.md says of when y, e, u and i act, on the virtual rig and on the linear loop."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from benchmarks import waveforms

import ambrose as amb
from ambrose.core.response import simulate
from ambrose.core.sampling import c2d, delayed
from ambrose.identification.findings import Code
from ambrose.identification.loop import identify_loop
from ambrose.identification.output_error.problem import FitOptions
from ambrose.identification.parameters import nominal_values
from ambrose.identification.validation import suspects
from ambrose.law.loop import closed_loop, timing_of
from ambrose.record.record import Record
from ambrose.rig.scenario import load_scenario, read_scenario
from linear_rig import AXES, DT, E, Y, rig

U = tuple(f"u_{axis}" for axis in AXES)
KNOWN = tuple(
    f"bearing.{name}"
    for name in (
        "A.negative_stiffness.zeta",
        "A.force_per_current.zeta",
        "B.negative_stiffness.zeta",
    )
)
KNOWN += ("seal.center.k",)


@pytest.mark.parametrize("delay", [0, 1, 2])
def test_the_recorded_u_is_the_one_that_acts(delay):
    """On the rig: row k holds what was computed from row k - delay."""
    pid = amb.design("seal-rig", "pid").controller
    excite = read_scenario(
        {
            "name": "short",
            "duration": 0.05,
            "prbs": [{"signal": "e_A_zeta", "amplitude": 0.05, "bit_time": 1e-3}],
        }
    )
    record = amb.simulate("seal-rig", pid, excite, rate=1 / DT, delay_samples=delay).record
    law = c2d(pid, DT, "tustin")
    x = np.zeros(pid.n_states)
    computed = []
    for error in -np.array([record[name] for name in Y]).T:
        computed.append(law.C @ x + law.D @ error)
        x = law.A @ x + law.B @ error
    computed, u = (
        np.diff(rows, axis=0)[50:]
        for rows in (np.array(computed), np.array([record[name] for name in U]).T)
    )
    last = len(u) - delay
    late = np.abs(u[delay:] - computed[:last]).max() / np.abs(u).max()
    assert late < 1e-6
    assert np.abs(u[delay:] - np.roll(computed, 1, axis=0)[:last]).max() > 1e-3 * np.abs(u).max()


@pytest.mark.parametrize("delay", [0, 1, 2])
def test_an_excitation_acts_from_its_row_on_and_a_command_after_the_delay(delay):
    _, plant, _, law = rig()
    loop = closed_loop(plant, delayed(law, delay))
    e = np.zeros((len(loop.inputs), 20))
    e[loop.inputs.index("e_A_zeta"), 5] = 0.1
    rows = dict(zip(loop.outputs, simulate(loop, e), strict=True))
    first = {
        name: int(np.flatnonzero(rows[name])[0]) for name in ("y_A_zeta", "i_A_zeta", "u_A_zeta")
    }
    assert first == {"y_A_zeta": 6, "i_A_zeta": 6, "u_A_zeta": 6 + delay}


def test_a_delay_is_rounded_up_and_the_hold_adds_half_a_sample():
    machine = amb.load_machine("seal-rig")
    reference = replace(machine.controller, sample_time=1e-4)
    for late, samples in ((None, 1), (1.4e-4, 2), (1e-4, 1)):
        timing = timing_of(replace(machine, controller=replace(reference, delay=late)))
        assert timing.delay_samples == samples and timing.lag == pytest.approx(
            (samples + 0.5) * 1e-4
        )
    assert 360 * 100 * timing.lag == pytest.approx(5.4)


@cache
def rows():
    """e, y and u of the loop with one sample of delay; noise enters with the sensors, so that u
    follows it.
    """
    _, plant, _, law = rig()
    loop, k = closed_loop(plant, delayed(law, 1)), 5000
    given = np.zeros((len(loop.inputs), k))
    for i, axis in enumerate(AXES):
        given[loop.inputs.index(f"e_{axis}")] = 0.1 * waveforms.prbs(9, 10, k, shift=127 * i)
        given[loop.inputs.index(f"d_{axis}")] = 2e-8 * np.random.default_rng(i).standard_normal(k)
    found = simulate(loop, given)
    return {
        **dict(zip(loop.inputs, given, strict=True)),
        **dict(zip(loop.outputs, found, strict=True)),
    }


@pytest.mark.parametrize(
    ("late", "delay", "samples", "words", "error"),
    [
        ("", 1, 0, "", (0, 2e-3)),
        ("e", 1, -1, "", (0.02, 0.03)),
        ("y", 1, 1, "after 0 samples, not 1", (0.02, 0.03)),
        ("u", 1, 0, "after 2 samples, not 1", (0, 2e-3)),
        ("", 0, 0, "after 1 sample, not 0", (0.05, 0.09)),
    ],
)
def test_how_one_row_late_looks(late, delay, samples, words, error, monkeypatch):
    monkeypatch.setattr(
        suspects, "FURTHER_MODES", 0
    )  # the recorded rotor is rigid, which no rotor is
    machine, plant, controller, _ = rig()
    values = np.vstack([np.roll(rows()[name], int(name[0] == late)) for name in (*Y, *E, *U)])[
        :, 3:-3
    ]
    record = Record("seal-rig", 1 / DT, (*Y, *E, *U), ("m",) * 4 + ("A",) * 8, values, plant.point)
    options = FitOptions(bending_modes=0, computing_delay=delay)
    done = identify_loop(machine, [record], controller, KNOWN, options=options)
    told = [item.what for item in done.checks if item.code == Code.OTHER_DELAY]
    assert any(words in what for what in told) if words else not told
    largest = np.abs(done.result.values / nominal_values(plant, KNOWN) - 1).max()
    assert error[0] <= largest < error[1]
    if samples:
        step, _, part = done.result.verdict.partition("the likeliest first: excitation.delay ")[
            2
        ].split()[:3]
        assert float(step) == pytest.approx(100 * samples, rel=0.02) and float(part[1:]) > 95


@pytest.mark.parametrize("told", [True, False])
def test_a_delay_that_the_record_shows_goes_into_the_file(told, monkeypatch):
    """u follows the controller after two samples, the machine file says one: fitted where the fit
    can tell it, else as seen.
    """
    if not told:
        monkeypatch.setattr("ambrose.identification.loop._unsure", lambda result, dt: True)
    machine = amb.load_machine("seal-rig")
    machine = replace(machine, controller=replace(machine.controller, sample_time=DT, delay=DT))
    pid = amb.design(machine, "pid").controller
    record = amb.simulate(
        machine, pid, replace(load_scenario("prbs"), duration=0.6), linear=True, delay_samples=2
    ).record
    done = amb.identify(
        machine, record, controller=pid, unknown=("controller.delay", *KNOWN[:2]), bending_modes=3
    )
    assert done.seen_delay == (None if told else 2) and len(done.result.paths) == (3 if told else 2)
    assert ("after 2 samples" in " ".join(done.remarks)) is not told
    assert done.machine.controller.delay == pytest.approx(2 * DT, rel=1e-3)
