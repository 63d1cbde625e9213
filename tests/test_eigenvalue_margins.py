"""The eigenvalue oracle for margins, itself against closed forms, python-control and loops moved to
their limit.
"""

from __future__ import annotations

import control
import numpy as np
import pytest

from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import frequency_response
from ambrose.core.statespace import (
    StateSpace,
    feedback,
    series,
    spectral_abscissa,
    static_gain,
    transfer_function,
)
from ambrose.law.pid import axes_controller
from ambrose.machine.part import PidSettings
from eigenvalue_margins import loop_margins


def random_loops(count: int):
    """Stable closed scalar loops from random open ones, unstable and lightly damped open poles
    among them.
    """
    rng = np.random.default_rng(7)
    while count:
        n = int(rng.integers(1, 9))
        A = rng.standard_normal((n, n)) * 10.0 ** rng.uniform(0, 3)
        loop = StateSpace(
            A,
            rng.standard_normal((n, 1)),
            rng.standard_normal((1, n)),
            rng.standard_normal((1, 1)) * rng.choice([0, 0.3]),
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
        """PD on a unit mass with negative stiffness: the static stiffness K - k_s vanishes at the
        factor k_s/K.
        """
        item = series(
            axes_controller(PidSettings(gain=(5e4,), derivative_time=3.5e-3), ("A",)),
            transfer_function([1], [1, 0, -1e4]),
        )
        margins = loop_margins(item)
        np.testing.assert_allclose(margins.gain_reduction, 0.2, rtol=1e-9)

    def test_limit_at_infinite_frequency(self):
        """-0.25 (s + 2)/(s + 1) with feedback: 1 - 0.25 k = 0 at infinity for k = 4, before 1 - 0.5
        k = 0 at DC for k = 2.
        """
        margins = loop_margins(transfer_function([-0.25, -0.5], [1, 1]))
        np.testing.assert_allclose(margins.gain_margin, 2.0, rtol=1e-12)
        margins = loop_margins(transfer_function([-0.5, -0.25], [1, 1]))
        np.testing.assert_allclose(margins.gain_margin, 2.0, rtol=1e-12)

    def test_constant_loop(self):
        margins = loop_margins(static_gain([[-0.5]]))
        assert (margins.gain_margin, margins.gain_reduction, margins.phase_margin) == (
            2.0,
            0.0,
            np.pi,
        )

    def test_resonance_between_grid_points(self):
        """A resonance of damping 1e-7 that alone brings |l| above 1: no grid finds it; the phase
        there decides.
        """
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
        np.testing.assert_allclose(
            margins.phase_margin, np.pi - 3 * np.arctan(np.sqrt(2.0 ** (2 / 3) - 1)), rtol=1e-6
        )

    @pytest.mark.parametrize("count", [40, pytest.param(150, marks=pytest.mark.study)])
    def test_random_loops_reach_instability_exactly_at_the_margin(self, count):
        """Scaled or turned by a little less than the margin the loop is stable, by a little more it
        is not.
        """
        step, limits = 1e-6, 0
        for loop in random_loops(count):
            margins = loop_margins(loop)

            def scaled(k: float, loop=loop) -> float:
                return spectral_abscissa(
                    feedback(
                        StateSpace(loop.A, loop.B * k, loop.C, loop.D * k), static_gain([[1.0]])
                    )
                )

            for factor, outward in (
                (margins.gain_margin, 1 + step),
                (margins.gain_reduction, 1 - step),
            ):
                if 0 < factor < np.inf:
                    limits += 1
                    assert scaled(factor / outward) < 0
                    assert scaled(factor * outward) > 0
            for inside in np.linspace(
                max(margins.gain_reduction, 0.02), min(margins.gain_margin, 50.0), 12
            )[1:-1]:
                assert scaled(inside) < 0
        assert limits > 2 * count / 3

    def test_random_loops_against_python_control(self):
        found = 0
        for loop in random_loops(45):
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
                np.testing.assert_allclose(
                    margins.phase_margin, np.radians(np.abs(phases).min()), rtol=1e-5
                )
        assert found > 20

    def test_two_outputs_are_refused(self):
        with pytest.raises(InvalidInput, match="one input and one output"):
            loop_margins(static_gain(np.eye(2)))
