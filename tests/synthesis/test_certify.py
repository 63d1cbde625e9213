"""The certificate: margins from eigenvalues against closed forms and against moving the loop to its limit."""

from __future__ import annotations

import control
import numpy as np
import pytest

from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import frequency_response
from ambrose.core.sampling import c2d
from ambrose.core.statespace import (
    StateSpace,
    append,
    feedback,
    poles,
    rename,
    series,
    spectral_abscissa,
    static_gain,
    transfer_function,
)
from ambrose.machine.description import PidSettings
from ambrose.plant.published import published_p5_pid
from ambrose.synthesis.certify import certify, continuous_equivalent, disk_margins, fastest_pole, opened
from ambrose.synthesis.margins import loop_margins
from ambrose.synthesis.pid import axes_controller, discrete

AXES = ("A", "B")
PD = PidSettings(gain=(1.0,), derivative_time=3.5e-3)


def levitated(stiffness: float, coupling: float = 0.0) -> StateSpace:
    """Two unit masses on negative stiffness [rad2/s2], with cross-coupling that pulls them around; u -> y."""
    K = np.array([[-stiffness, coupling], [-coupling, -stiffness]])
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-K, np.zeros((2, 2))]])
    B = np.vstack([np.zeros((2, 2)), np.eye(2)])
    return StateSpace(A, B, np.eye(2, 4), np.zeros((2, 2)), [f"u_{a}" for a in AXES], [f"y_{a}" for a in AXES])


def pd_controller(gain: float) -> StateSpace:
    return axes_controller(PidSettings(gain=(gain,), derivative_time=3.5e-3), AXES)


def with_lag(item: StateSpace, corner: float = 1500.0) -> StateSpace:
    lags = [rename(transfer_function([corner], [1, corner]), [name], [f"i_{name}"]) for name in item.inputs]
    return series(append(*lags), item)


def random_loops(count: int):
    """Stable closed scalar loops from random open ones, unstable and lightly damped open poles among them."""
    rng = np.random.default_rng(7)
    while count:
        n = int(rng.integers(1, 9))
        A = rng.standard_normal((n, n)) * 10.0 ** rng.uniform(0, 3)
        loop = StateSpace(
            A, rng.standard_normal((n, 1)), rng.standard_normal((1, n)), rng.standard_normal((1, 1)) * rng.choice([0, 0.3])
        )
        k = 10.0 ** rng.uniform(0, 3)
        loop = StateSpace(loop.A, loop.B * k, loop.C, loop.D)
        if spectral_abscissa(feedback(loop, static_gain([[1.0]]))) < -1e-3:
            count -= 1
            yield loop


class TestLoopMargins:
    def test_third_order_textbook_loop(self):
        """k/(s+1)^3 closes on -1 at k = 8 and w = sqrt(3)."""
        margins = loop_margins(transfer_function([2.0], [1, 3, 3, 1]))
        np.testing.assert_allclose(margins.gain_margin, 4.0, rtol=1e-9)
        assert margins.gain_reduction == 0.0
        w = np.sqrt(2.0 ** (2 / 3) - 1)
        np.testing.assert_allclose(margins.phase_margin, np.pi - 3 * np.arctan(w), rtol=1e-9)

    def test_conditionally_stable_integrating_loop(self):
        """k (s+1)^2/s^3: stable for k > 1/2 only, by Routh (k s^2 + ... : 2 k^2 > k)."""
        margins = loop_margins(transfer_function(np.array([1.0, 2.0, 1.0]) * 3.0, [1, 0, 0, 0]))
        np.testing.assert_allclose(margins.gain_reduction, 1 / 6, rtol=1e-9)
        assert margins.gain_margin == np.inf

    def test_limit_at_zero_frequency(self):
        """PD on a unit mass with negative stiffness: the static stiffness K - k_s vanishes at the factor k_s/K."""
        item = series(
            axes_controller(PidSettings(gain=(5e4,), derivative_time=3.5e-3), ("A",)), transfer_function([1], [1, 0, -1e4])
        )
        margins = loop_margins(item)
        np.testing.assert_allclose(margins.gain_reduction, 0.2, rtol=1e-9)

    def test_limit_at_infinite_frequency(self):
        """-0.25 (s + 2)/(s + 1) with feedback: 1 - 0.25 k = 0 at infinity for k = 4, before 1 - 0.5 k = 0 at DC for k = 2."""
        margins = loop_margins(transfer_function([-0.25, -0.5], [1, 1]))
        np.testing.assert_allclose(margins.gain_margin, 2.0, rtol=1e-12)
        margins = loop_margins(transfer_function([-0.5, -0.25], [1, 1]))
        np.testing.assert_allclose(margins.gain_margin, 2.0, rtol=1e-12)

    def test_constant_loop(self):
        margins = loop_margins(static_gain([[-0.5]]))
        assert (margins.gain_margin, margins.gain_reduction, margins.phase_margin) == (2.0, 0.0, np.pi)

    def test_resonance_between_grid_points(self):
        """A resonance of damping 1e-7 that alone brings |l| above 1: no grid finds it; the phase there decides."""
        w, z = 100.0, 1e-7
        loop = transfer_function([1e-6 * w**2], [1, 2 * z * w, w**2])
        margins = loop_margins(loop)
        # |l| = 1 where (1 - v^2)^2 + (2 z v)^2 = 1e-12; v^2 - 1 = +-sqrt(1e-12 - 4 z^2)
        d = np.sqrt(1e-12 - 4 * z**2)
        np.testing.assert_allclose(margins.phase_margin, np.arctan2(2 * z, d), rtol=1e-4)

    def test_spectrum_of_nine_decades(self):
        """Twelve poles at 1e8..1e9 rad/s, as a fine mesh has them, hide no crossing at 1 rad/s."""
        loop = transfer_function([2.0], [1, 3, 3, 1])
        for corner in np.geomspace(1e8, 1e9, 12):
            loop = series(loop, transfer_function([corner], [1, corner]))
        margins = loop_margins(loop)
        np.testing.assert_allclose(margins.gain_margin, 4.0, rtol=1e-6)
        assert margins.gain_reduction == 0.0
        np.testing.assert_allclose(margins.phase_margin, np.pi - 3 * np.arctan(np.sqrt(2.0 ** (2 / 3) - 1)), rtol=1e-6)

    def test_random_loops_reach_instability_exactly_at_the_margin(self):
        """Scaled or turned by a little less than the margin the loop is stable, by a little more it is not."""
        step, limits = 1e-6, 0
        for loop in random_loops(150):
            margins = loop_margins(loop)

            def scaled(k: float, loop=loop) -> float:
                return spectral_abscissa(feedback(StateSpace(loop.A, loop.B * k, loop.C, loop.D * k), static_gain([[1.0]])))

            for factor, outward in ((margins.gain_margin, 1 + step), (margins.gain_reduction, 1 - step)):
                if 0 < factor < np.inf:
                    limits += 1
                    assert scaled(factor / outward) < 0
                    assert scaled(factor * outward) > 0
            for inside in np.linspace(max(margins.gain_reduction, 0.02), min(margins.gain_margin, 50.0), 12)[1:-1]:
                assert scaled(inside) < 0
        assert limits > 100

    def test_random_loops_against_python_control(self):
        found = 0
        for loop in random_loops(60):
            margins = loop_margins(loop)
            omega = np.geomspace(1e-4, 1e6, 20001)
            values = frequency_response(loop, omega).values[:, 0, 0]
            crossing = np.flatnonzero(np.diff(np.sign(np.abs(values) - 1)))
            if not len(crossing):
                continue
            _, phase, _, _, _, _ = control.stability_margins(loop.to_control(), returnall=True)
            if len(phase):
                found += 1
                phases = (np.asarray(phase) + 180) % 360 - 180
                np.testing.assert_allclose(margins.phase_margin, np.radians(np.abs(phases).min()), rtol=1e-5)
        assert found > 20

    def test_two_outputs_are_refused(self):
        with pytest.raises(InvalidInput, match="one input and one output"):
            loop_margins(static_gain(np.eye(2)))


class TestCertify:
    def test_peaks_and_poles_agree_with_a_direct_computation(self):
        plant, controller = with_lag(levitated(1e4, 3e3)), pd_controller(5e4)
        certificate = certify(plant, controller)
        loop = control.series(controller.to_control(), plant.to_control())
        closed = control.feedback(control.ss([], [], [], np.eye(2)), loop)
        np.testing.assert_allclose(certificate.spectral_abscissa, closed.poles().real.max(), rtol=1e-9)
        omega = np.linspace(1, 2000, 20001)
        G = frequency_response(loop, omega).values
        S = np.linalg.inv(np.eye(2) + G)
        np.testing.assert_allclose(certificate.closed_loop_norm, np.linalg.norm(S, 2, (1, 2)).max(), rtol=1e-5)
        np.testing.assert_allclose(certificate.margins["complementary_peak"], np.linalg.norm(G @ S, 2, (1, 2)).max(), rtol=1e-5)
        assert certificate.margins["sensitivity_peak"] == certificate.closed_loop_norm
        np.testing.assert_allclose(certificate.fastest_pole, 1 / (0.1 * 3.5e-3), rtol=1e-12)

    def test_axis_margins_reach_the_limit_in_their_axis_alone(self):
        plant = with_lag(levitated(1e4, 3e3))
        certificate = certify(plant, pd_controller(5e4))
        for number, axis in enumerate(AXES):
            for name in ("gain_margin", "gain_reduction"):
                limit = certificate.margins[f"{name}.{axis}"]
                for change, stable in ((0.999, name == "gain_margin"), (1.001, name == "gain_reduction")):
                    factors = np.ones(2)
                    factors[number] = limit * change
                    other = series(pd_controller(5e4), static_gain(np.diag(factors)))
                    assert certify(plant, other).stable == stable
        assert certificate.margins["gain_margin"] == min(certificate.margins[f"gain_margin.{a}"] for a in AXES)
        assert certificate.margins["gain_reduction"] == max(certificate.margins[f"gain_reduction.{a}"] for a in AXES)

    def test_disk_margins_hold_for_every_corner_and_bound_the_axis_margins(self):
        plant, controller = with_lag(levitated(1e4, 3e3)), pd_controller(5e4)
        margins = certify(plant, controller).margins
        assert margins["disk_gain_margin"] <= margins["gain_margin"]
        assert margins["disk_gain_reduction"] >= margins["gain_reduction"]
        assert margins["disk_phase_margin_rad"] <= margins["phase_margin_rad"]
        ends = [margins["disk_gain_reduction"], margins["disk_gain_margin"]]
        for first in ends:
            for second in ends:
                assert certify(plant, series(controller, static_gain(np.diag([first, second])))).stable

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
            np.vstack([item.B, np.zeros((1, 2))]), np.hstack([item.C, np.zeros((2, 1))]), item.D,
        )  # fmt: skip
        certificate = certify(hidden, pd_controller(5e4))
        assert not certificate.stable
        np.testing.assert_allclose(certificate.spectral_abscissa, 2.0)

    @pytest.mark.parametrize("delay", [0, 1, 2])
    def test_sampled_controller_closes_the_sampled_loop(self, delay):
        dt = 2e-4
        plant, sampled = with_lag(levitated(1e4, 3e3)), discrete(pd_controller(5e4), dt, delay * dt)
        certificate = certify(plant, sampled)
        loop = series(sampled, c2d(plant, dt))
        closed = loop.A - loop.B @ loop.C
        np.testing.assert_allclose(
            certificate.spectral_abscissa, np.log(np.abs(np.linalg.eigvals(closed)).max()) / dt, rtol=1e-6
        )
        omega = np.linspace(1, 3000, 30001)
        S = np.linalg.inv(np.eye(2) + frequency_response(loop, omega).values)
        np.testing.assert_allclose(certificate.closed_loop_norm, np.linalg.norm(S, 2, (1, 2)).max(), rtol=1e-5)
        first = opened(loop, 0)
        values = frequency_response(first, omega).values[:, 0, 0]
        crossing = np.flatnonzero(np.diff(np.sign(np.abs(values) - 1)))
        np.testing.assert_allclose(
            certificate.margins["phase_margin_rad.A"], np.abs(np.angle(-values[crossing])).min(), rtol=1e-3
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
