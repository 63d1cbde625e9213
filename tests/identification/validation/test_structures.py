"""Loops of another structure than the model's: filters, samplings and bending modes that nobody
stated. Linear loops of the tests' own, run from sample to sample.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from benchmarks import waveforms
from scipy.signal import cont2discrete

import ambrose as amb
from ambrose.core.sampling import c2d
from ambrose.core.statespace import select
from ambrose.identification.findings import Code
from ambrose.law.loop import match_controller
from ambrose.machine.description import Amplifier
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import free_mode_reduction
from ambrose.record.record import Record
from linear_rig import DT, E, Y

BANDWIDTH, FILTER = 4000, 4500  # Hz, of the amplifier and of a filter
U = tuple(name.replace("y_", "u_") for name in Y)


@cache
def machine():
    """The seal rig with an amplifier of first order, and its continuous PID."""
    given = replace(
        amb.load_machine("seal-rig"),
        amplifier=Amplifier("first", bandwidth=2 * np.pi * BANDWIDTH),
        tolerances=(),
        seals=(),
    )
    return given, amb.design(given, "pid")


def run(modes=3, filtered=0.0, method="tustin", kinds="ye", samples=4000, noise=2e-8):
    """y behind a Butterworth filter of second order at ``filtered`` [Hz], under the PID sampled by
    ``method`` and a sample late, with e added to u.
    """
    given, pid = machine()
    plant = free_mode_reduction(assemble(given), modes)
    system = select(plant.system, plant.named("u"), plant.named("y"))
    A, B, C = system.A, system.B, system.C
    if filtered:
        w, n = 2 * np.pi * filtered, len(C)
        one, none = np.eye(n), np.zeros((n, n))
        # v'' = w^2 (y - v) - sqrt(2) w v'
        F = np.block([[none, one], [-(w**2) * one, -np.sqrt(2) * w * one]])
        into = np.vstack([none, w**2 * one]) @ C
        A = np.block([[A, np.zeros((len(A), 2 * n))], [into, F]])
        B, C = np.vstack([B, np.zeros((2 * n, n))]), np.hstack([np.zeros_like(C), one, none])
    A, B, *_ = cont2discrete((A, B, C, np.zeros((4, 4))), DT)
    K = c2d(match_controller(pid, plant), DT, method)
    e = np.stack([0.1 * waveforms.prbs(9, 10, samples, shift=127 * i) for i in range(4)])
    seen = noise * np.random.default_rng(0).standard_normal((4, samples))
    x, z, late = np.zeros(len(A)), np.zeros(K.n_states), np.zeros(4)
    y, u = np.zeros((4, samples)), np.zeros((4, samples))
    for k in range(samples):
        y[:, k], u[:, k] = C @ x + seen[:, k], late
        x = A @ x + B @ (late + e[:, k])
        late, z = K.C @ z - K.D @ y[:, k], K.A @ z - K.B @ y[:, k]
    rows = {"y": (Y, "m", y), "u": (U, "A", u), "e": (E, "A", e)}
    names = sum((rows[kind][0] for kind in kinds), ())
    units = sum(((rows[kind][1],) * 4 for kind in kinds), ())
    values = np.vstack([rows[kind][2] for kind in kinds])
    return Record("seal-rig", 1 / DT, names, units, values, plant.point)


def of_values(done):
    """Off the file, which is right, in standard deviations, but for the amplifier's lag."""
    return [
        (row.value - row.start) / row.standard_deviation
        for row in done.parameters
        if not row.path.startswith("amplifier")
    ]


def test_a_filter_that_the_file_lacks_is_named_with_what_states_it():
    given, pid = machine()
    done = amb.identify(given, run(filtered=FILTER), pid)
    (found,) = [item for item in done.findings if "whole chain" in str(item)]
    assert found.code == Code.FAR_FROM_FILE and "anti-alias" in found.remedy
    corner = float(found.remedy.split("second order at ")[1].split(" kHz")[0])
    assert corner == pytest.approx(FILTER / 1e3, rel=0.1)

    # as told: the first-order lag of the same delay in every [[sensor]]
    told = float(found.remedy.split('"')[1].split(" kHz")[0])
    sensors = tuple(replace(item, bandwidth=2 * np.pi * 1e3 * told) for item in given.sensors)
    again = amb.identify(replace(given, sensors=sensors), run(filtered=FILTER), pid)
    assert not any("whole chain" in str(item) for item in again.findings)
    assert again.parameters[-1].value == pytest.approx(2 * np.pi * BANDWIDTH, rel=0.1)


def test_a_right_record_ends_without_a_doubt_and_the_lag_has_its_name():
    given, pid = machine()
    done = amb.identify(given, run(kinds="yue"), pid)
    assert done.passed and max(map(abs, of_values(done))) < 3
    assert any("lag of the whole chain" in item for item in done.remarks)
    assert not any("no u_<axis>" in item for item in done.remarks)


def test_what_is_not_checked_is_said_and_another_sampling_is_named():
    """A continuous PID's file; what ran was made by backward differences, and u not recorded."""
    given, pid = machine()
    right = amb.identify(given, run(), pid)
    assert right.passed
    assert any("Tustin's rule at 10000 Hz, 1 sample late" in item for item in right.remarks)
    other = amb.identify(given, run(method="backward-euler"), pid)
    assert not other.passed or max(map(abs, of_values(other))) < 3
    assert "controller sampled by backward-euler instead of Tustin's rule" in other.verdict


@pytest.mark.parametrize("modes", [3, pytest.param(8, marks=pytest.mark.study)])
def test_as_many_bending_modes_are_modelled_as_the_record_tells(modes):
    """With more than the usual three the values are several times nearer to the truth."""
    given, pid = machine()
    record = run(modes=modes, noise=2e-10)
    done = amb.identify(given, record, pid)
    assert done.passed
    assert any("bending modes per plane" in item for item in done.remarks) == (modes > 3)
    if modes == 3:
        assert done.bending_modes == 3 and max(map(abs, of_values(done))) < 3
        return
    asked = amb.identify(given, record, pid, bending_modes=3)
    assert asked.bending_modes == 3 and done.bending_modes >= 6

    def off(found):
        return max(abs(row.value / row.start - 1) for row in found.parameters[:8])

    assert off(done) < off(asked) / 3
