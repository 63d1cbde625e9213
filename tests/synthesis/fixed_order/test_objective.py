"""The equations of synthesis/fixed_order/objective.py by their numbers, on two masses on springs,
beside sums and derivatives of our own. (3): test_tuning.py.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import logsumexp

from ambrose.core.frequency import schur_form
from ambrose.core.statespace import StateSpace
from ambrose.machine.criteria import CURRENT_PULSE
from ambrose.synthesis.fixed_order.channels import Aims, LoopModel, Settling
from ambrose.synthesis.fixed_order.objective import (
    Objective,
    _barrier,
    _closed_loops,
    _resolvent,
    _theta_slope,
)
from ambrose.synthesis.fixed_order.structure import Structure

EYE, ZERO = np.eye(2), np.zeros((2, 2))
NAMES = ("err_a", "err_b"), ("u_a", "u_b")
# y'' = -k y - 0.4 y' + b u + f, measured at once; rows y, q and i = u
A, B = (
    np.block([[ZERO, EYE], [-np.diag([4.0, 9.0]), -0.4 * EYE]]),
    np.array([[0, 0], [0, 0], [2, 0.3], [0, 1]]),
)
C, F = np.hstack([EYE, ZERO]), np.vstack([ZERO, EYE])
OMEGA = np.geomspace(0.1, 30, 25)
AIMS = Aims(1.6, 3.0, (), (), 0.3, 5.0, 0.1, 30.0, compliance=0.4)
# Theta = [[D, C], [B, A]] of a controller with two states
THETA = np.array([[0.8, 0.1, 1, 0], [0.2, 0.5, 0.3, 1], [2, 0, -5, 1], [0, 3, -0.5, -8.0]])


def model():
    form = schur_form(
        A, np.hstack([B, F]), np.vstack([C, C, 0 * C]), np.kron([[0, 0], [0, 0], [1, 0]], EYE)
    )
    return LoopModel("here", A, B, C, ZERO, form, (np.ones(2), np.ones(2)), None, 0.0)


def objective(omega=OMEGA, **more):
    structure = Structure(np.ones((4, 4), bool), np.ones((4, 4)), *NAMES)
    return Objective(structure, [model()], omega, more.pop("aims", AIMS), **more), THETA.ravel()


def system(theta=THETA):
    return StateSpace(theta[2:, 2:], theta[2:, :2], theta[:2, 2:], theta[:2, :2], *NAMES)


def poles(theta=THETA):
    """Of x' = A x + B u, xk' = Ak xk + Bk err, u = Ck xk + Dk err, err = -C x."""
    D_k, C_k, B_k, A_k = theta[:2, :2], theta[:2, 2:], theta[2:, :2], theta[2:, 2:]
    return np.linalg.eigvals(np.block([[A - B @ D_k @ C, B @ C_k], [-B_k @ C, A_k]]))


def test_1_2_and_6_the_sum_of_all_ratios():
    """S_o, Q and the compliance, frequency by frequency; required over present damping ratios."""
    cost, x = objective()
    p, total = 8, 0.0
    for w in OMEGA:
        inverse = np.linalg.inv(1j * w * np.eye(4) - A)
        G, G_f = C @ inverse @ B, C @ inverse @ F
        K = (
            THETA[:2, :2]
            + THETA[:2, 2:] @ np.linalg.inv(1j * w * EYE - THETA[2:, 2:]) @ THETA[2:, :2]
        )
        S = np.linalg.inv(EYE + G @ K)
        limit = abs((1j * w + 2.0 * 0.01) / (1j * w / 1.6 + 2.0))
        for T in (S / limit, K @ S / 3.0, S @ G_f / 0.4):
            total += (np.linalg.svd(T, compute_uv=False) ** p).sum()
    for pole in poles():
        if abs(pole.imag) > 0.7 * abs(pole):
            total += ((0.3 if abs(pole) < 5.0 else 0.1) / (-pole.real / abs(pole))) ** p
    assert cost(x, p)[0] == pytest.approx(np.log(total) / p, rel=1e-12)


@pytest.mark.parametrize("apart", [True, False])
def test_4_the_controller_s_derivative(apart):
    """Re tr(psi* K) over frequencies, beside differences; also with poles that have one vector."""
    rng, theta = np.random.default_rng(0), THETA.copy()
    if not apart:
        theta[2:, 2:] = [[-5, 1], [0, -5]]
    psi_h = rng.normal(size=(25, 2, 2)) + 1j * rng.normal(size=(25, 2, 2))

    def f(theta):
        K = [
            theta[:2, :2]
            + theta[:2, 2:] @ np.linalg.solve(1j * w * EYE - theta[2:, 2:], theta[2:, :2])
            for w in OMEGA
        ]
        return np.einsum("wij,wji->", psi_h, np.array(K)).real

    X, Y = _resolvent(theta[2:, 2:], theta[2:, :2], theta[:2, 2:], 1j * OMEGA)
    slope, step = _theta_slope(psi_h, X, Y), 1e-6 * rng.normal(size=(4, 4))
    assert (f(theta + step) - f(theta - step)) / 2 == pytest.approx((slope * step).sum(), rel=1e-7)


def test_5_the_pulse_in_time_is_that_of_the_closed_form():
    """H = 1/((s + 3) (s + 40)): its steps' difference once the pulse is over; 0.4 as the power."""
    w, d = np.linspace(0.1, 4000, 20_000), CURRENT_PULSE.duration
    settling = Settling(w, 0.2)
    H = 1 / ((1j * w[settling.at] + 3) * (1j * w[settling.at] + 40))
    ratio, y, band, peak = settling.ratios(H[:, None, None, None])
    after = 0.2 * np.concatenate([np.linspace(1, 2.2, 16), np.geomspace(2.4, 8, 8)])

    def step(t):
        return 1 / 120 - np.exp(-3 * t) / 111 + np.exp(-40 * t) / 1480

    expected = step(after + d) - step(after)
    assert y[:, 0, 0, 0] == pytest.approx(expected, abs=2e-3 * expected.max())
    assert ratio == pytest.approx(np.abs(y) / (0.05 * peak[0, 0])) and band == 0.05 * peak
    share = ((ratio[..., 0, 0, 0] ** 0.4) ** 6).sum()
    assert settling.slope((ratio, y, band, peak), 1.0, 6)[0] == pytest.approx(share)


def test_6_dampings_of_poles():
    """0.3 below 5 rad/s, 0.1 above; none of poles that hardly ring or are well damped."""
    cost, _ = objective()
    values = np.array([[-0.4 + 2j, -0.4 - 8j, -2 + 1j, -1.0, 0.5 + 1j]])
    ratios, slopes = cost._damping(values, np.array([[False] * 4 + [True]]), [0])
    zeta = 0.4 / np.hypot(0.4, [2, 8])
    assert ratios[0] == pytest.approx([*np.array([0.3, 0.1]) / zeta, 0, 0, 0])
    for h, way in ((1e-6, slopes.real), (1e-6j, slopes.imag)):
        ahead, back = (cost._damping(values + s * h, ratios < 0, [0])[0] for s in (1, -1))
        assert (ahead - back)[0, :2] / 2e-6 == pytest.approx(way[0, :2], rel=1e-6)


def test_7_and_8_closed_loop_poles_and_their_derivatives():
    """Also of a plant with feedthrough, u = D_k (-C x - D u) + ..."""
    D = 0.2 * EYE
    loops = _closed_loops(THETA, [item[None] for item in (A, B, C, 0 * D)])
    assert np.sort_complex(loops.poles()[0]) == pytest.approx(np.sort_complex(poles()))

    # K' = (EYE + D_k D)^-1: the controller that sees C x alone
    theta, inner = THETA.copy(), np.linalg.inv(EYE + THETA[:2, :2] @ D)
    theta[:2] = inner @ THETA[:2]
    theta[2:, 2:] -= THETA[2:, :2] @ D @ theta[:2, 2:]
    theta[2:, :2] -= THETA[2:, :2] @ D @ theta[:2, :2]
    loops = _closed_loops(THETA, [item[None] for item in (A, B, C, D)])
    assert np.sort_complex(loops.poles()[0]) == pytest.approx(np.sort_complex(poles(theta)))

    rng = np.random.default_rng(1)
    step, found = 1e-6 * rng.normal(size=(4, 4)), loops.eigen()
    for k in range(6):
        weight = np.zeros((1, 6), complex)
        weight[0, k] = 1 - 2j
        ahead, back = (
            _closed_loops(THETA + s * step, [item[None] for item in (A, B, C, D)]).poles()[0]
            for s in (1, -1)
        )
        value = found.values[0, k]
        moved = ahead[np.abs(ahead - value).argmin()] - back[np.abs(back - value).argmin()]
        along = (found.slope(weight) * step).sum()
        assert (np.conj(1 - 2j) * moved / 2).real == pytest.approx(along, rel=1e-6, abs=1e-12)


def test_9_the_distance_from_the_reference():
    """All gains 1.3 times the reference's: ln 1.3 over the limit, at every frequency."""
    reference = replace(system(), C=system().C / 1.3, D=system().D / 1.3)
    cost, x = objective(reference=reference, match=0.1)
    assert cost.ratios(x)["match"].value == pytest.approx(np.log(1.3) / 0.1)


@pytest.mark.parametrize("clear", [0.0, 0.25])
def test_10_the_barrier_at_the_fence(clear):
    """-ln of the room, of what is beyond ``clear`` of the fence's square; without a kink there."""
    fence, own = 10.0, np.array([[-3.0, 4.0], [-4.0, -3.0]])
    matrix = np.block([[own, ZERO], [ZERO, np.diag([-1.0, -9.0])]])  # |lambda|: 5, 5, 1, 9
    part = np.maximum(np.array([25, 25, 1, 81]) / 100 - clear, 0) / (1 - clear)
    value, slope = _barrier(matrix, fence, clear)
    expected = -np.log(1 - part) - (part if clear else 0)
    assert value == pytest.approx(0.02 * expected.sum())
    step = 1e-6 * np.random.default_rng(2).normal(size=(4, 4))
    change = _barrier(matrix + step, fence, clear)[0] - _barrier(matrix - step, fence, clear)[0]
    assert change / 2 == pytest.approx((slope * step).sum(), rel=1e-5)
    assert _barrier(matrix, 8.9, clear)[0] == np.inf


def test_12_what_a_narrowing_leaves_out():
    """All terms give f; those without their exact value, of small matrices, are nothing beside."""
    cost, x = objective()
    theta = cost.structure.theta(x)
    everything = cost(x, 40)[0]
    shares, f = cost._shares(x, 40, cost._read(theta))
    assert f == pytest.approx(everything, abs=1e-9) and f <= everything + 1e-14
    assert (shares[0] == 0).any() and (shares[0] > 0).any()
    assert cost.narrow(x, 40)
    assert cost._active.omega.size < OMEGA.size
    assert everything - 1e-8 < cost(x, 40)[0] <= everything


def test_11_the_soft_maximum_of_real_parts():
    cost, x = objective()
    expected = logsumexp(20.0 * poles().real / 2.0) / 20.0
    assert cost.unstable(x, 20.0, 2.0)[0] == pytest.approx(expected, rel=1e-12)
