"""The phase budget against the loop's own response: a sine through sensor, controller, delay, hold
and amplifier in time, by the equations of this file, its first harmonic read from the samples.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import butter, freqs

import ambrose as amb
from ambrose.annexes.rotordynamics.loop import phase_budgets, shaft_loop
from ambrose.annexes.rotordynamics.stations import lay_out
from ambrose.core.checks import InvalidInput
from ambrose.core.sampling import c2d
from ambrose.law.law import law_of
from ambrose.law.loop import Timing, timing_of
from ambrose.machine.description import Amplifier
from ambrose.machine.part import ChainElement


def budget_of(machine, controller, timing):
    loop = shaft_loop(lay_out(machine), machine.operation.nominal, controller, timing)
    return phase_budgets(loop, timing)


def through_the_loop(machine, controller, timing, omega, axis):
    """Phase [rad] from the displacement along an axis to its current, others at rest."""
    T = timing.sample_time
    K = c2d(law_of(controller).at(machine.operation.nominal), T, "tustin")
    settle = 1500
    t = T * np.arange(settle + 1500)
    # the sensor's first-order lag of sin(w t) has settled; where there is none it is the sine
    corner = machine.sensors[axis // 2].bandwidth
    lag = 1.0 if corner is None else 1 / (1 + 1j * omega / corner)
    y = np.imag(lag * np.exp(1j * omega * t))
    # the controller's difference equation, its output late by whole samples
    x = np.zeros(K.n_states)
    u = np.zeros(len(t))
    for k, value in enumerate(y):
        e = np.zeros(K.B.shape[1])
        e[axis] = value
        u[k] = (K.C @ x + K.D @ e)[axis]
        x = K.A @ x + K.B @ e
    u = np.roll(u, timing.delay_samples)
    # held, through i' = w (u - i), sixteen instants per sample
    w, i, fine = machine.amplifier.bandwidth, 0.0, np.zeros((len(t), 16))
    parts = np.exp(-w * T / 16)
    for k, value in enumerate(u):
        for j in range(16):
            fine[k, j] = i
            i = value + (i - value) * parts
    times = (t[:, None] + T / 16 * np.arange(16)).ravel()
    chosen = times > settle * T
    basis = np.exp(1j * omega * times[chosen])
    # least squares over sine and cosine under a window that keeps the hold's aliases apart
    window = np.hanning(chosen.sum())
    columns = np.column_stack([basis.real, basis.imag]) * window[:, None]
    a, b = np.linalg.lstsq(columns, fine.ravel()[chosen] * window, rcond=None)[0]
    return np.angle(b + 1j * a)


def test_turboexpanders_budget_is_its_loops_own_response():
    machine = amb.load_machine("turboexpander")
    controller = amb.design(machine, "pid")
    timing = Timing(1e-4, 1)
    (budget,) = budget_of(machine, controller, timing)
    assert budget.axes == machine.axes
    assert len(budget.frequencies) >= 3
    for omega, total in zip(budget.frequencies[:3], budget.total, strict=False):
        found = through_the_loop(machine, controller, timing, omega, 0)
        apart = np.angle(np.exp(1j * (total - found)))
        assert abs(np.degrees(apart)) < 0.1


def test_elements_are_their_closed_forms():
    machine = amb.load_machine("turboexpander")
    drive = Amplifier("twice-first", bandwidth=9000.0, eddy_bandwidth=15e3)
    machine = replace(machine, amplifier=drive)
    (budget,) = budget_of(machine, amb.design(machine, "pid"), Timing(5e-5, 2))
    rows = dict(zip(budget.elements, budget.phases, strict=True))
    w = budget.frequencies
    assert rows["computing"] == pytest.approx(-w * 1e-4)
    assert rows["hold"] == pytest.approx(-w * 2.5e-5)
    assert rows["amplifier"] == pytest.approx(-np.arctan(w / 9000.0))
    assert rows["eddy currents"] == pytest.approx(-np.arctan(w / 15e3))
    assert budget.cost == pytest.approx(budget.total - rows["controller"])
    continuous = budget_of(machine, amb.design(machine, "pid"), None)[0]
    assert "hold" not in continuous.elements


CHAIN = (
    ChainElement("carrier", "demodulation", corner=2 * np.pi * 30e3, order=3),
    ChainElement("converter", "adc", 4e-6),
    ChainElement("program", "computation", 75e-6),
    ChainElement("update", "pwm", 12.5e-6),
)


def test_elements_of_the_chain_add_up_to_the_delay_of_the_loop():
    machine = amb.load_machine("turboexpander")
    settings = replace(machine.controller, sample_time=1e-4, delay=None)
    machine = replace(machine, controller=settings, chain=CHAIN)
    seconds = sum(element.dead_time for element in CHAIN)
    timing = timing_of(machine)
    assert 1e-4 < seconds < 1.05e-4
    assert timing.delay_samples == 2
    (budget,) = budget_of(machine, amb.design(machine, "pid"), timing)
    rows = dict(zip(budget.elements, budget.phases, strict=True))
    named = [row for name, row in rows.items() if ": " in name]
    assert len(named) == len(CHAIN)
    w = budget.frequencies
    whole = sum(named) + rows["rest of the whole samples"]
    assert whole == pytest.approx(-w * 2e-4)
    assert rows["rest of the whole samples"] == pytest.approx(-w * (2e-4 - seconds))
    (note,) = budget.notes
    assert note.startswith("carrier")
    # with its filters, as the loop has them: in time, to 0.1 degree
    found = through_the_loop(machine, amb.design(machine, "pid"), timing, w[0], 0)
    assert abs(np.degrees(np.angle(np.exp(1j * (budget.total[0] - found))))) < 0.1
    # a delay that the caller gives is not the file's
    plain = budget_of(machine, amb.design(machine, "pid"), Timing(1e-4, 2))[0]
    assert "computing" in plain.elements


@pytest.mark.parametrize("order", [1, 2, 3, 5])
def test_a_filter_is_scipys(order):
    element = ChainElement("f", "anti-alias", corner=5000.0, order=order)
    b, a = butter(order, 5000.0, analog=True)
    w = np.array([1.0, 2000.0, 5000.0, 12e3])
    phase = np.unwrap(np.angle(freqs(b, a, w)[1]))
    assert [element.phase(x) for x in w] == pytest.approx(phase, abs=1e-9)
    assert element.dead_time == pytest.approx(-phase[0], rel=1e-6)


@pytest.mark.parametrize(
    ("element", "words"),
    [
        (ChainElement("a", "adc"), "one of the two"),
        (ChainElement("a", "dac", 1e-6), "demodulation"),
        (ChainElement("a", "adc", 3e-4), "more than the delay"),
        (ChainElement("a", "anti-alias", corner=1e4, order=20), "from 1 to 8"),
    ],
)
def test_a_wrong_chain_is_refused(element, words):
    machine = amb.load_machine("turboexpander")
    settings = replace(machine.controller, sample_time=1e-4, delay=1e-4)
    with pytest.raises(InvalidInput, match=words):
        replace(machine, controller=settings, chain=(element,))
