"""Paper P4 on the nonlinear rig: bearings, coupling and seal; each test has its id.

The figures quoted in docs/research/reproduction.md are printed by `python -m benchmarks.campaign_p4`, which
runs the same functions.
"""

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest
from benchmarks import campaign_p4_results as results

from ambrose.core.frequency import frequency_response
from ambrose.core.statespace import poles

pytestmark = [pytest.mark.literature, pytest.mark.study]
HZ, BAR = 2 * np.pi, 1e5


@pytest.fixture(scope="module")
def p4():
    """The campaign's module, which is a command and not part of the package."""
    root = str(Path(__file__).parents[2])
    sys.path.insert(0, root)
    try:
        return importlib.import_module("benchmarks.campaign_p4")
    finally:
        sys.path.remove(root)


@pytest.fixture(scope="module")
def swept(p4):
    return p4.chirps(duration=10.0)


@pytest.fixture(scope="module")
def cosines(p4):
    return p4.cosines((1e-3, 10e-3, 20e-3))


@pytest.fixture(scope="module")
def sines(p4):
    return p4.stepped_sines(frequencies=(5, 15, 25, 35, 45, 55, 75, 95), dwell=1.0)


def test_P4_1_the_model_follows_the_chirp(swept):
    """Printed: to about 100 Hz, by eye. Identified from the same rig, the model follows; to where
    depends on the tolerance: with the thesis' eight rigid states 98 Hz at 2 %, but beyond 140 Hz at
    5 %, and with bending modes at 2 %.
    """
    for item in swept:
        limit, rigid = item.limits["identified"], item.limits["identified, 8 rigid states"]
        assert limit[0.02] > 135
        assert 70 < rigid[0.02] < rigid[0.03] < 115
        assert rigid[0.05] > 140
        assert item.limits["file values"][0.05] < 10 < item.limits["file values"][0.1]
        assert item.validity["identified"].valid_to[0, 0] / HZ == limit[0.02]
        direct, cross = item.measured.coherence.T
        assert np.median(direct) > 0.98
        assert direct.min() > 0.95
        assert cross.min() < 0.8  # lower across, where the motion is a tenth
        size = np.abs(item.measured.values[:, :, 0])
        assert np.median(size[:, 1] / size[:, 0]) == pytest.approx(0.1, abs=0.03)


def test_P4_2_columns_of_stiffness_and_current_gain(cosines):
    """Printed: K_i-K_s of one axis -0.95, across axes 0; these come out. K_iA-K_iB -0.08, K_sA-K_sB
    -0.09: no clock of the sequence gives them together with the first, and the second never comes
    out: it is +0.2.
    """
    together = []
    for found in cosines.values():
        J = found[0].column_cosine
        own = np.array([J[i, 4 + i] for i in range(4)])
        assert ((own > -0.97) & (own < -0.8)).all()
        assert np.abs(J[np.ix_([0, 2, 4, 6], [1, 3, 5, 7])]).max() < 1e-3
        assert J[4, 6] > 0.15 and J[5, 7] > 0.15  # printed -0.09
        together.append(own.min() < -0.94 and J[0, 2] < 0)
        # the parameters' correlation has the other sign
        assert all(found[0].correlation[i, 4 + i] > 0.8 for i in range(4))
    slow, fast = cosines[20e-3][0].column_cosine, cosines[1e-3][0].column_cosine
    assert min(slow[i, 4 + i] for i in range(4)) == pytest.approx(-0.95, abs=0.01)
    assert slow[0, 2] == pytest.approx(0.20, abs=0.02)
    assert all(-0.87 < fast[i, 4 + i] < -0.81 for i in range(4))
    assert fast[0, 2] == pytest.approx(-0.06, abs=0.02)
    assert not any(together)


def test_P4_3_coupling_in_a_separate_experiment(p4):
    """Inputs recovered: the printed 0.40e6 and 0.42e6 N/m are the rig's.

    Bearings from a record without coupling; wrong or simultaneous ones do worse."""
    found = p4.coupling()
    want = np.array([0.40e6, 0.42e6])
    separate = found.separate.values
    assert np.all(np.abs(separate - want) < 4 * found.separate.standard_deviations + 1e3)
    assert np.all(np.abs(separate / want - 1) < 5e-3)
    assert np.all(found.untrue_bearings.values < 0.8 * want)
    assert not all(test.passed for test in found.untrue_bearings.tests)  # and the residuals say so
    assert np.all(found.at_once.standard_deviations[-2:] > 10 * found.separate.standard_deviations)
    assert found.at_once.column_cosine[4, 8] < -0.95


def test_P4_4_coefficients_over_frequency(p4, sines):
    """Inputs recovered: K = 0 and k, C, c in proportion to the pressure, at all frequencies, are
    the rig's own (printed: K near 0, k large, growing with pressure and independent of frequency; C
    and c low).
    """
    for pressure in sines.fit.pressures:
        rows = sines.fit.at(pressure)
        want = results.truth(pressure)
        assert np.ptp(rows.values[:, 1]) < 0.06 * want[1]
        error = np.abs(rows.values - want) / rows.deviations
        assert np.median(error) < 1.5
        mean = sines.constants.at(pressure)
        assert abs(mean.values[0, 0]) < 0.015 * want[1]
        np.testing.assert_allclose(mean.values[0, 1], want[1], rtol=0.01)
        np.testing.assert_allclose(mean.values[0, 2:], want[2:], rtol=0.04)
    assert np.all(np.diff(sines.constants.values[:, 1]) > 0)
    assert np.all(np.diff(sines.constants.values[:, 2]) > 0)


def test_P4_4_damping_that_falls_with_frequency_is_the_amplifiers(p4):
    """P4 finds direct damping falling with frequency, with and without pressure, and disregards it.
    An amplifier whose damping is misjudged does exactly that; the reference takes it off, measured
    currents do not have it.
    """
    found = p4.misjudged_amplifier()
    apparent = found["commanded"].systematic[:, 2]
    assert np.all(np.diff(apparent) < -300)
    assert apparent[-1] < -4000
    assert np.abs(found["measured"].systematic[:, 2]).max() < 200
    true = results.truth(1.2 * BAR)[2]
    for fit in found.values():
        assert np.abs(fit.values[:, 2] / true - 1).max() < 0.2


def test_P4_5_coefficients_are_uncorrelated_only_without_pressure(p4):
    """Printed at 40 Hz: at most 0.04. So it is without pressure; with it the whirl is nearly a
    circle, where K and c, k and C act alike. Forward whirl together with stronger backward whirl
    tells them apart again.
    """
    found = p4.correlations(40.0, (0.0, 1.2 * BAR))
    calm, whirling = found[0.0], found[1.2 * BAR]
    assert np.abs(calm - np.eye(4)).max() < 0.07
    assert whirling[0, 3] > 0.95  # K, c
    assert whirling[1, 2] < -0.95  # C, k
    assert np.abs(whirling[[0, 0, 1, 2], [1, 2, 3, 3]]).max() < 0.05  # the other four pairs stay so
    plane, opposed = p4.opposed()
    assert plane.cosine[0][0, 3] > 0.8
    assert abs(opposed.cosine[0][0, 3]) < 0.2


def test_P4_6_a_resonance_appears_and_one_constant_model_fits(p4, sines):
    """Printed: no resonance at 0.7 bar, one at 1.2 bar. Resonance: a peak of more than sqrt(2) over
    the lowest frequency.
    """
    peaks = {}
    for pressure, measured in sines.measured.items():
        size = np.abs(measured.values[:, 0, 0])
        peaks[pressure] = size.max() / size[0]
        if pressure in sines.model:
            error = np.abs(sines.model[pressure].values - measured.values) / size[:, None, None]
            assert error[measured.omega < 100 * HZ].max() < 0.02
    assert list(peaks.values()) == sorted(peaks.values())
    assert peaks[0.7 * BAR] < np.sqrt(2) < peaks[1.2 * BAR]
    system = p4.loop(p4.rig(), 1.2 * BAR)
    assert np.abs(poles(system)).max() < 1
    omega = 2 * np.pi * np.arange(20.0, 60.0, 1.0)
    size = np.abs(frequency_response(system, omega).select("e_A_zeta", "y_A_zeta").values[:, 0, 0])
    assert omega[size.argmax()] / HZ == pytest.approx(39, abs=4)


def test_P4_7_measured_currents_hardly_lower_the_correlation(cosines):
    """The thesis guesses that they "possibly" lower it significantly. Between no weight on the
    currents and nothing but them it falls by at most 0.07 here: with a known controller they are a
    filtered copy of the displacements.
    """
    for without, with_currents, only in cosines.values():
        before, after, limit = (
            np.array([f.correlation[i, 4 + i] for i in range(4)])
            for f in (without, with_currents, only)
        )
        assert (limit < before).all() and (after < before).all()
        assert (before - np.minimum(limit, after) < 0.07).all()
