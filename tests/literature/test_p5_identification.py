"""Paper P5, section 3.3, on the nonlinear rig: seal coefficients against pressure from impulses;
each test has its id.

The figures quoted in docs/research/reproduction.md are printed by `python -m benchmarks.campaign_p4`.
"""

import importlib
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from benchmarks import campaign_p4_results as results

from ambrose.identification.seal.by_pressure import update_seal
from ambrose.model.assemble import assemble

pytestmark = pytest.mark.literature
BAR = 1e5


@pytest.fixture(scope="module")
def p4():
    root = str(Path(__file__).parents[2])
    sys.path.insert(0, root)
    try:
        return importlib.import_module("benchmarks.campaign_p4")
    finally:
        sys.path.remove(root)


@pytest.fixture(scope="module")
def pulses(p4):
    return p4.impulses(tuple(p * BAR for p in (0.45, 0.95, 1.45, 1.9)), repeats=6)


def test_P5_1_impulse_responses_are_matched(pulses):
    """Printed: matched at 0.95 and 1.90 bar; the cross response grows; A moves less than B, for the
    coupling near A.
    """
    peaks = {}
    for pressure in (0.95 * BAR, 1.9 * BAR):
        _, measured, model = pulses.responses[pressure]
        noise = measured[:, :400].std(axis=1)  # before the impulse
        rest = (measured - model).std(axis=1)
        assert np.all(rest < 1.1 * noise)  # nothing is left but the sensors' noise
        peaks[pressure] = np.abs(model).max(axis=1)
    low, high = peaks.values()
    assert np.all(high[[1, 3]] > 1.6 * low[[1, 3]])
    assert np.all(np.abs(high[[0, 2]] / low[[0, 2]] - 1) < 0.1)
    for peak in peaks.values():
        assert peak[0] < 0.85 * peak[2]
        assert peak[1] < peak[3]


def test_P5_2_cross_coupled_stiffness_rises_linearly(p4, pulses):
    """Printed: k follows its line closely; the uncertainty of damping is large against its size.
    The line is the rig's own (k, C, c in proportion to the pressure): what comes out was put in,
    save how certain each coefficient is.
    """
    for i, letter in enumerate("KkCc"):
        line = pulses.lines[letter]
        assert abs(line.at(results.NOMINAL) - results.truth(results.NOMINAL)[i]) < line.prediction(
            results.NOMINAL, 0.99
        )
    relative = {
        x: float(
            pulses.lines[x].confidence(results.NOMINAL) / abs(pulses.lines[x].at(results.NOMINAL))
        )
        for x in "kCc"
    }
    assert pulses.lines["k"].r_squared > 0.998
    assert pulses.lines["k"].slope * results.NOMINAL == pytest.approx(3.203e6, rel=0.03)
    assert min(relative["C"], relative["c"]) > 3 * relative["k"]
    errors = (
        np.abs(pulses.fit.values - [results.truth(p) for p in pulses.fit.pressure])
        / pulses.fit.deviations
    )
    assert np.sqrt(np.mean(errors**2)) < 1.8


def test_the_machine_that_results_predicts_the_nominal_pressure(p4, pulses):
    """The line goes into the machine; at 2.04 bar, where nothing was measured, its unstable poles
    are the true seal's.
    """
    known = p4.known_but_for_the_seal()
    made = update_seal(known, pulses.fit)
    found, true = (
        np.linalg.eigvals(assemble(m).system.A)
        for m in (made, replace(known, seals=p4.rig().seals))
    )
    found, true = (np.sort_complex(p[(p.real > 0) & (p.imag > 0)]) for p in (found, true))
    assert len(found) == len(true) == 2
    assert np.abs(found - true).max() < 0.02 * np.abs(true).max()
