"""Paper P2 on the nonlinear rig: K_i, K_s and tau_e by closed-loop identification, K_i by static
loads; each test has its id.

A short form (two repeats, 0.6 s, few loads) of `python -m benchmarks.campaign_p2`, which prints the
figures quoted in docs/research/reproduction.md.
"""

import importlib
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from ambrose.identification.output_error import closed_loop
from ambrose.identification.parameters import expand
from ambrose.machine.description import OperatingPoint
from ambrose.model.effects import magnet
from ambrose.rig import virtual_rig

pytestmark = [pytest.mark.literature, pytest.mark.study]


@pytest.fixture(scope="module")
def p2():
    """The campaign's module, which is a command and not part of the package."""
    root = str(Path(__file__).parents[2])
    sys.path.insert(0, root)
    try:
        return importlib.import_module("benchmarks.campaign_p2")
    finally:
        sys.path.remove(root)


@pytest.fixture(scope="module")
def campaign(p2):
    """What is found at the bias currents."""
    machine = p2.rig()

    @cache
    def at(bias):
        return p2.one_bias(machine, bias, 2, 0.6, most=600.0, steps=3, hold=0.9)

    return at


def test_P2_1_nine_parameters_converge_together_from_one_record(p2):
    machine = p2.rig()
    law, point = p2.controller(machine, 6.0), OperatingPoint(bias_current=6.0)
    record = virtual_rig.run(machine, law, p2.sequences(machine, 1, 0.5), point=point).record
    given = [magnet.linearised(bearing, 6.0) for bearing in machine.bearings]
    known = np.ravel([[c.force_per_current for c in given], [c.negative_stiffness for c in given]])
    begin = np.append(known, 1 / p2.LAG) * (1 + 0.15 * np.array([1, -1, 1, 1, -1, 1, -1, -1, 1]))
    paths = expand(machine, p2.NINE)
    found = closed_loop.identify(
        machine, record, law, p2.NINE, start=dict(zip(paths, begin, strict=True))
    )
    truth = np.append(p2.at_work(machine, record, 6.0), 1 / p2.LAG)
    assert found.converged and found.iterations <= 15
    np.testing.assert_allclose(found.values, truth, rtol=0.02)


@pytest.mark.parametrize("bias", [6.0, 8.0, 10.0])
def test_P2_2_negative_stiffness_over_bias(p2, campaign, bias):
    """Inputs recovered: the printed rows are the rig's own. Within 1.5 % of its force; of the print
    within the 3 % by which weight shifts the working point.
    """
    K_s = campaign(bias).dynamic.mean[4:8]
    np.testing.assert_allclose(K_s, campaign(bias).truth[4:8], rtol=0.015)
    np.testing.assert_allclose(K_s, p2.PRINTED_K_S[bias], rtol=0.03)
    # the axes of a bearing
    assert abs(K_s[0] / K_s[1] - 1) < 0.08 and abs(K_s[2] / K_s[3] - 1) < 0.09
    assert (K_s[2:] > K_s[:2]).all()
    if bias > 6:
        assert (K_s > campaign(bias - 2).dynamic.mean[4:8]).all()


def test_P2_2_scatter_does_not_grow_with_bias(p2, campaign):
    """Printed RSD of K_s: 2.3 to 7.7 % at 10 A, 1.4 to 4 times that of 6 A. Sensor noise alone:
    below 0.6 %, everywhere.
    """
    scatter = {
        bias: campaign(bias).dynamic.predicted[4:8] / campaign(bias).dynamic.mean[4:8]
        for bias in (6.0, 8.0, 10.0)
    }
    for bias, values in scatter.items():
        assert (values < 0.006).all() and (
            100 * values < 0.6 * np.array(p2.PRINTED_RSD[bias])
        ).all()
    assert (scatter[10.0] < 1.5 * scatter[6.0]).all()
    assert (np.array(p2.PRINTED_RSD[10.0]) > 1.4 * np.array(p2.PRINTED_RSD[6.0])).all()


@pytest.mark.parametrize("bias", [6.0, 8.0, 10.0])
def test_P2_3_both_methods_agree(campaign, bias):
    """Printed: within 10 %. Here within 2 %, and each within 2 % of the rig's own force."""
    found = campaign(bias)
    np.testing.assert_allclose(found.static.mean, found.dynamic.mean[:4], rtol=0.02)
    np.testing.assert_allclose(found.dynamic.mean[:4], found.truth[:4], rtol=0.01)
    np.testing.assert_allclose(found.static.mean, found.truth[:4], rtol=0.02)


def test_P2_4_the_gain_levels_off_and_a_wrong_actuator_over_predicts_it(p2, campaign):
    """From 8 to 10 A, in proportion to 25 %: A grows by 14 %, B by 3 and 8 %, with either method;
    and the chord of the static loads lies below the tangent. The closed loop over-predicts nothing
    here (printed: at 10 A), unless its model lacks the computing delay: then the more the higher
    the bias.
    """
    np.testing.assert_allclose(
        campaign(10.0).dynamic.mean[:4], campaign(10.0).static.mean[:4], rtol=0.01
    )
    for which in ("static", "dynamic"):
        growth = (
            getattr(campaign(10.0), which).mean[:4] / getattr(campaign(8.0), which).mean[:4] - 1
        )
        assert (
            (growth[:2] > 0.11).all()
            and (growth < 0.17).all()
            and growth[2] < 0.05
            and growth[3] < 0.10
        )
    for bias in (6.0, 8.0, 10.0):
        loaded = campaign(bias).loaded[0]
        assert (loaded.values < loaded.at_rest).all() and (loaded.linearity < 0.01).all()
    over = {}
    for bias in (6.0, 10.0):
        law = p2.controller(p2.rig(), bias)
        machine, point = p2.rig(), OperatingPoint(bias_current=bias)
        record = virtual_rig.run(
            machine, law, p2.sequences(machine, 1, 0.6), point=point, seed=1
        ).record
        result = closed_loop.identify(machine, record, law, p2.NINE, computing_delay=0)
        over[bias] = result.values[:4] / p2.at_work(machine, record, bias)[:4] - 1
        assert not any(test.passed for test in result.tests)
    assert (over[6.0] > 0.005).all() and (over[10.0] > over[6.0]).all() and over[10.0].min() > 0.025


def test_P2_5_the_fit_falls_with_bias(campaign):
    """The same noise over a response that the stiffer loop makes smaller; printed 95.2, 93.4 and
    84.5 %.
    """
    fits = [float(np.mean(campaign(bias).fit)) for bias in (6.0, 8.0, 10.0)]
    assert fits[0] > fits[1] > fits[2]
    np.testing.assert_allclose(fits[:2], [95.2, 93.4], atol=1.5)
    assert fits[2] > 90


def test_P2_6_the_lag_is_identified_alike_at_every_bias(p2, campaign):
    """Printed: trustworthy at 6 A (RSD 5.9 %), not at 8 A (59 %) nor at 10 A. Here within 3 % and
    below 1 % at all three.
    """
    for bias in (6.0, 8.0, 10.0):
        found = campaign(bias)
        np.testing.assert_allclose(found.dynamic.mean[-1], p2.LAG, rtol=0.03)
        assert found.dynamic.predicted[-1] < 0.01 * p2.LAG
    assert campaign(10.0).dynamic.predicted[-1] < 1.5 * campaign(6.0).dynamic.predicted[-1]


@pytest.mark.parametrize(("bias", "found"), [(6.0, 8.2e-3), (10.0, 3.9e-3)])
def test_P2_6_no_pid_was_found_for_the_printed_lags(p2, bias, found):
    """A search, not a proof. The lags found are several times what 15 PIDs on a grid had shown (2.1
    and 1.0 ms).
    """
    largest = p2.largest_lag(p2.rig(), bias)
    assert largest == pytest.approx(found, rel=0.1)
    assert largest < min(lag for lag, _ in p2.PRINTED_LAG.values())


def test_P2_without_the_coupling_bearing_A_seems_weaker(p2):
    """P2 takes the magnets for the only forces on the rotor; on a rig with the coupling that costs
    15 to 22 % of K_s at A.
    """
    rows = {
        what: errors
        for what, errors, *_ in p2.wrong_models(p2.rig(), 6.0, 0.6, ["the model", "no coupling"])
    }
    without = rows["no coupling in the model (as P2)"][4:8]
    assert (
        (without[:2] < -13).all() and (without[:2] > -24).all() and (np.abs(without[2:]) < 5).all()
    )
    assert np.abs(rows["the model as the rig is"][:8]).max() < 2
