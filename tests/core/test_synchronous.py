"""core/synchronous.py: shifts against exact poles, the rigid one-axis check number, sectors,
limits.
"""

import numpy as np
import pytest

from ambrose.core.checks import InvalidInput
from ambrose.core.sampling import c2d
from ambrose.core.statespace import StateSpace, spectral_abscissa
from ambrose.core.synchronous import (
    best_inverse,
    borders,
    convergence,
    convergence_angle,
    hermitian,
    largest_gain,
    largest_step,
    project,
    sector_angle,
    slowest_pole,
    with_resonator,
)

MASS = 10.0
KS = 2e6
KP = 5e6
DAMPING = 4e3


def missed_share(frequency_error, gain):
    """What is left of the synchronous part [-] while the frequency is off by a constant error
    [rad/s].

    The notch passes |(s^2 + W^2)/(s^2 + eps s + W^2)| at W + dW: 2 dW/sqrt(4 dW^2 + eps^2) near W.
    """
    # s = j (W + dW): W^2 + s^2 = -2 W dW - dW^2, over W: 2 dW/|2 dW - j eps| for dW << W
    return 2 * abs(frequency_error) / float(np.hypot(2 * frequency_error, gain))


def rigid(dt: float = 2e-5) -> StateSpace:
    """c -> e = y - c of a rigid mass on k_s with the PD's stiffness and damping, sampled finely."""
    # m q'' = k_s q - k_P (q - c) - d (q' - c'); the derivative of c by a fast pole
    fast = 2e5
    A = np.array(
        [[0, 1, 0], [(KS - KP - DAMPING * fast) / MASS, 0, DAMPING * fast / MASS], [fast, 0, -fast]]
    )
    B = np.array([[0], [(KP + DAMPING * fast) / MASS], [-fast]])
    return c2d(StateSpace(A, B, [[1.0, 0, 0]], [[-1.0]]), dt)


def response(loop: StateSpace, w: float) -> np.ndarray:
    z = np.exp(1j * w * loop.dt)
    return -(loop.C @ np.linalg.solve(z * np.eye(loop.n_states) - loop.A, loop.B) + loop.D)


@pytest.mark.literature
def test_the_plain_notch_on_a_rigid_axis_with_pd_is_stable_exactly_above_its_rigid_critical():
    """T = 1 converges for small gains where W^2 > (k_P - k_s)/m."""
    expected = np.sqrt((KP - KS) / MASS)
    S = lambda w: (-MASS * w**2 - KS) / (-MASS * w**2 - KS + KP + 1j * w * DAMPING)  # noqa: E731
    exact = borders(lambda w: float(np.real(S(w))), np.linspace(50, 3000, 30))
    assert [(pytest.approx(expected, rel=1e-6), True)] == [(b.value, b.stable_above) for b in exact]
    loop = rigid()
    one = np.eye(1)
    assert (
        slowest_pole(loop, one, 1.01 * expected, 1e-2)
        < 0
        < slowest_pole(loop, one, 0.99 * expected, 1e-2)
    )


@pytest.mark.parametrize("turn", [0.0, 0.7, -1.1])
def test_a_small_gain_shifts_the_pole_by_half_the_eigenvalue(turn):
    loop = rigid()
    w = 900.0
    eps = 0.05
    R = response(loop, w)
    T = np.exp(1j * turn) / R
    poles = np.log(np.linalg.eigvals(with_resonator(loop, T, w, eps)).astype(complex)) / loop.dt
    near = poles[np.argmin(np.abs(poles - 1j * w))]
    assert near == pytest.approx(1j * w - eps / 2 * np.exp(1j * turn), abs=5e-4 * eps)


def test_the_mean_of_two_stable_matrices_may_be_unstable_and_the_hermitian_test_says_so():
    first = np.array([[1, 10], [0, 1]], complex)
    one = np.eye(2)
    assert convergence(first, one) > 0
    assert convergence(first.T, one) > 0
    assert convergence((first + first.T) / 2, one) < 0
    assert np.linalg.eigvalsh(hermitian(first))[0] < 0  # no proof rests on either


@pytest.mark.parametrize("seed", range(5))
def test_the_sector_angle_is_that_of_the_numerical_range(seed):
    rng = np.random.default_rng(seed)
    M = np.eye(3) * 3 + rng.standard_normal((3, 3)) + 1j * rng.standard_normal((3, 3))
    angle = sector_angle(M)
    x = rng.standard_normal((3, 4000)) + 1j * rng.standard_normal((3, 4000))
    seen = np.pi / 2 - np.abs(np.angle(np.einsum("in,ij,jn->n", x.conj(), M, x))).max()
    if angle > 0:
        assert angle <= seen + 1e-9
        for sign in (1, -1):
            turned = hermitian(np.exp(1j * sign * (angle - 1e-6)) * M)
            assert np.linalg.eigvalsh(turned)[0] > 0
    assert angle <= convergence_angle(M) + 1e-9


def test_one_matrix_for_several_responses_converges_for_each():
    rng = np.random.default_rng(3)
    base = np.eye(2) + 0.3 * (rng.standard_normal((2, 2)) + 1j * rng.standard_normal((2, 2)))
    members = np.array([np.exp(1j * phase) * base for phase in (-0.6, 0.0, 0.8)])
    T = best_inverse(members)
    angles = [sector_angle(T @ R) for R in members]
    # 1.4 rad between the two ends leaves at best pi/2 - 0.7
    assert np.pi / 2 - 0.7 - 0.05 < min(angles) <= np.pi / 2 - 0.7 + 1e-6
    assert np.linalg.norm(T, 2) == pytest.approx(1)


def test_the_largest_gain_is_where_the_exact_poles_leave():
    loop, w = rigid(), 900.0
    T = 1 / response(loop, w)
    limit = largest_gain(loop, T, w, 1e5, 0.01)
    assert 0 < limit < 1e5
    assert slowest_pole(loop, T, w, 0.98 * limit) < 0 < slowest_pole(loop, T, w, 1.03 * limit)
    assert largest_gain(loop, -T, w, 10.0) == 0.0
    assert spectral_abscissa(loop) < 0


def test_a_leak_holds_what_the_gain_alone_would_lose():
    loop, w = rigid(), 900.0
    T = -1 / response(loop, w)
    assert slowest_pole(loop, T, w, 0.1) > 0 > slowest_pole(loop, T, w, 0.1, leak=1.0)


def test_a_frequency_that_is_off_leaves_the_share_of_the_notch():
    eps, w = 0.4, 500.0
    for off in (0.002, 0.1, 2.0):
        s = 1j * (w + off)
        notch = (s**2 + w**2) / (s**2 + eps * s + w**2)
        assert missed_share(off, eps) == pytest.approx(abs(notch), rel=2e-2)
    assert missed_share(0.005 * eps, eps) == pytest.approx(0.01, rel=1e-3)


def test_amplitudes_are_projected_with_their_phase_and_a_step_is_bounded():
    a = np.array([3 + 4j, 0.1j])
    assert project(a, 1.0) == pytest.approx([0.6 + 0.8j, 0.1j])
    assert largest_step(2.0, 1e-4, 3.0, 1e-5, 2e-5, 800.0) == pytest.approx(
        2 * 1e-4 * 3 * 1e-5 + 2e-5 * 800 * 1e-4
    )


def test_a_continuous_loop_and_a_matrix_of_another_size_are_refused():
    with pytest.raises(InvalidInput, match="continuous"):
        with_resonator(StateSpace([[-1.0]], [[1.0]], [[1.0]], [[-1.0]]), np.eye(1), 10.0, 1.0)
    with pytest.raises(InvalidInput, match="T is"):
        with_resonator(rigid(), np.eye(2), 10.0, 1.0)


def test_the_largest_gain_is_stable_even_where_there_are_several_borders(monkeypatch):
    """A band of unstable gains below the highest: what is returned lies below it and is stable."""
    stable = lambda gain: gain < 0.2 or 0.5 < gain < 0.53 or gain > 0.9  # noqa: E731
    monkeypatch.setattr(
        "ambrose.core.synchronous.slowest_pole",
        lambda loop, T, W, gain, leak=0.0: -1.0 if stable(gain) else 1.0,
    )
    for highest in (1.0, 0.52):
        found = largest_gain(rigid(), np.eye(1), 1.0, highest)
        assert stable(found) and 0.19 < found < 0.2
