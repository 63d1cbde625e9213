"""The certificate: peaks and margins against direct computation and against moving the loop to its
limit.
"""

from __future__ import annotations

import re

import control
import numpy as np
import pytest
from benchmarks.published_p5 import published_p5_pid

from ambrose.annexes.site.retuning import designed_in_words
from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import frequency_response
from ambrose.core.sampling import c2d
from ambrose.core.statespace import (
    StateSpace,
    append,
    poles,
    rename,
    series,
    static_gain,
    transfer_function,
)
from ambrose.judge.result import (
    Certificate,
    Status,
    Synthesis,
    certify,
    continuous_equivalent,
    disk_margins,
    fastest_pole,
)
from ambrose.law.pid import axes_controller
from ambrose.machine.part import PidSettings
from eigenvalue_margins import loop_margins, opened

AXES = ("A", "B")
PD = PidSettings(gain=(1.0,), derivative_time=3.5e-3)


def levitated(stiffness: float, coupling: float = 0.0) -> StateSpace:
    """Two unit masses on negative stiffness [rad2/s2], with cross-coupling that pulls them around;
    u -> y.
    """
    K = np.array([[-stiffness, coupling], [-coupling, -stiffness]])
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-K, np.zeros((2, 2))]])
    B = np.vstack([np.zeros((2, 2)), np.eye(2)])
    return StateSpace(
        A, B, np.eye(2, 4), np.zeros((2, 2)), [f"u_{a}" for a in AXES], [f"y_{a}" for a in AXES]
    )


def pd_controller(gain: float) -> StateSpace:
    return axes_controller(PidSettings(gain=(gain,), derivative_time=3.5e-3), AXES)


def with_lag(item: StateSpace, corner: float = 1500.0) -> StateSpace:
    lags = [
        rename(transfer_function([corner], [1, corner]), [name], [f"i_{name}"])
        for name in item.inputs
    ]
    return series(append(*lags), item)


class TestCertify:
    def test_peaks_and_poles_agree_with_a_direct_computation(self):
        plant, controller = with_lag(levitated(1e4, 3e3)), pd_controller(5e4)
        certificate = certify(plant, controller)
        loop = control.series(controller.to_control(), plant.to_control())
        closed = control.feedback(control.ss([], [], [], np.eye(2)), loop)
        np.testing.assert_allclose(
            certificate.spectral_abscissa, closed.poles().real.max(), rtol=1e-9
        )
        omega = np.linspace(1, 2000, 20001)
        G = frequency_response(loop, omega).values
        S = np.linalg.inv(np.eye(2) + G)
        np.testing.assert_allclose(
            certificate.closed_loop_norm, np.linalg.norm(S, 2, (1, 2)).max(), rtol=1e-5
        )
        np.testing.assert_allclose(
            certificate.margins["complementary_peak"],
            np.linalg.norm(G @ S, 2, (1, 2)).max(),
            rtol=1e-5,
        )
        assert certificate.margins["sensitivity_peak"] == certificate.closed_loop_norm
        np.testing.assert_allclose(certificate.fastest_pole, 1 / (0.1 * 3.5e-3), rtol=1e-12)

    def test_disk_margins_hold_for_every_corner_and_bound_the_axis_margins(self):
        plant, controller = with_lag(levitated(1e4, 3e3)), pd_controller(5e4)
        margins = certify(plant, controller).margins
        for axis in range(2):
            alone = loop_margins(opened(series(controller, plant), axis))
            assert margins["disk_gain_margin"] <= alone.gain_margin
            assert margins["disk_gain_reduction"] >= alone.gain_reduction
            assert margins["disk_phase_margin_rad"] <= alone.phase_margin
        ends = [margins["disk_gain_reduction"], margins["disk_gain_margin"]]
        for first in ends:
            for second in ends:
                assert certify(
                    plant, series(controller, static_gain(np.diag([first, second])))
                ).stable

    def test_disk_margins_of_known_peaks(self):
        known = disk_margins(2.0, 1.0)
        assert known["disk_gain_margin"] == 2.0
        np.testing.assert_allclose(known["disk_gain_reduction"], 0.0, atol=1e-15)
        np.testing.assert_allclose(known["disk_phase_margin_rad"], np.pi / 3)
        assert disk_margins(1.0, 0.5)["disk_gain_margin"] == np.inf

    def test_an_unstable_loop_is_a_verdict(self):
        certificate = certify(levitated(1e4), pd_controller(0.9e4))
        assert not certificate.stable
        assert certificate.spectral_abscissa > 0
        assert certificate.closed_loop_norm == np.inf
        assert not certificate.margins

    def test_hidden_unstable_states_are_seen(self):
        """A pole in the plant that the controller can neither see nor move counts."""
        item = levitated(1e4)
        hidden = StateSpace(
            np.block([[item.A, np.zeros((4, 1))], [np.zeros((1, 4)), np.array([[2.0]])]]),
            np.vstack([item.B, np.zeros((1, 2))]),
            np.hstack([item.C, np.zeros((2, 1))]),
            item.D,
        )
        certificate = certify(hidden, pd_controller(5e4))
        assert not certificate.stable
        np.testing.assert_allclose(certificate.spectral_abscissa, 2.0)

    @pytest.mark.parametrize("delay", [0, 1, 2])
    def test_sampled_controller_closes_the_sampled_loop(self, delay):
        dt = 2e-4
        plant, sampled = (
            with_lag(levitated(1e4, 3e3)),
            c2d(pd_controller(5e4), dt, "tustin", delay * dt),
        )
        certificate = certify(plant, sampled)
        loop = series(sampled, c2d(plant, dt))
        closed = loop.A - loop.B @ loop.C
        np.testing.assert_allclose(
            certificate.spectral_abscissa,
            np.log(np.abs(np.linalg.eigvals(closed)).max()) / dt,
            rtol=1e-6,
        )
        omega = np.linspace(1, 3000, 30001)
        S = np.linalg.inv(np.eye(2) + frequency_response(loop, omega).values)
        np.testing.assert_allclose(
            certificate.closed_loop_norm, np.linalg.norm(S, 2, (1, 2)).max(), rtol=1e-5
        )

    def test_bilinear_equivalent_keeps_the_values_on_the_circle(self):
        sampled = c2d(with_lag(levitated(1e4, 3e3)), 1e-3)
        angle = np.linspace(0.1, 3.0, 9)
        found = frequency_response(continuous_equivalent(sampled), np.tan(angle / 2)).values
        wanted = frequency_response(sampled, angle / 1e-3).values
        np.testing.assert_allclose(found, wanted, atol=1e-10 * np.abs(wanted).max())

    def test_fastest_pole_of_a_sampled_controller_is_in_rad_per_second(self):
        continuous = pd_controller(1.0)
        assert abs(fastest_pole(c2d(continuous, 1e-4)) / np.abs(poles(continuous)).max() - 1) < 1e-9
        assert fastest_pole(static_gain(np.eye(2))) == 0.0

    def test_sizes_that_do_not_fit(self):
        with pytest.raises(InvalidInput, match="controller's size"):
            certify(levitated(1e4), axes_controller(published_p5_pid(), ("A", "B", "C")))
        with pytest.raises(InvalidInput, match="sample time"):
            certify(c2d(levitated(1e4), 1e-3), pd_controller(5e4))


@pytest.mark.parametrize(
    ("margins", "missed", "words"),
    [
        (
            {"ratio_gain": 1.2, "guard_gain": 1.2, "ratio_orbit": 0.9},
            False,
            "no requirement .* gain",
        ),
        ({"ratio_gain": 1.2, "guard_gain": 1.2, "ratio_orbit": 1.1}, True, "not every requirement"),
        ({"ratio_gain": 1.2, "ratio_orbit": 0.9}, True, "not every requirement"),
        ({}, True, "not every requirement"),  # of an older file, which says no more
    ],
)
def test_a_guard_of_the_search_is_no_requirement(margins, missed, words):
    law = StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
    shown = Certificate(True, -1.0, 1.0, 1.0, margins)
    made = Synthesis(law, "tuned", 1.2, Status.VERIFIED, shown)
    assert made.missed == missed
    assert re.search(words, made.verdict)
    # a retuning leaves requirements to the verification
    assert "requirement is met" not in designed_in_words(made)
