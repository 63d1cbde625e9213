"""Coprime factors and the residual system: identities of P1, at frequencies, for random plants and
controllers of any kind.
"""

import numpy as np
import pytest
import scipy.linalg as sla

from ambrose.core.checks import InvalidInput, NumericalFailure, UnstableSystem
from ambrose.core.frequency import frequency_response
from ambrose.core.lft import GeneralizedPlant, RealBlock, close_uncertainty
from ambrose.core.realisation import (
    coprime_factors,
    exchange,
    injection_gain,
    observer_controller,
    residual_lft,
    residual_system,
)
from ambrose.core.sampling import c2d
from ambrose.core.statespace import (
    StateSpace,
    feedback,
    is_stable,
    poles,
    select,
    spectral_abscissa,
    transfer_function,
)

OMEGA = np.array([0.0, 0.1, 0.7, 2.0, 9.0, 60.0])
DT = 0.05


def plant(seed, dt=None, n=5, m=2, p=3):
    """An uncertain plant with unstable poles: w, z one uncertain entry; u (m) and y (p)."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n)) + 0.3 * np.eye(n)
    B, C = rng.standard_normal((n, m + 1)), rng.standard_normal((p + 1, n))
    u, y = [f"u{i}" for i in range(m)], [f"y{i}" for i in range(p)]
    system = StateSpace(A, B, C, np.zeros((p + 1, m + 1)), ["w", *u], ["z", *y])
    if dt:
        system = c2d(system, dt)
    return GeneralizedPlant(system, ["w"], u, ["z"], y, [RealBlock("k")])


def at(system):
    return frequency_response(system, OMEGA).values


def nominal(general):
    return select(general.system, general.u, general.y)


def stabilising(G, decay=0.5):
    F = injection_gain(G.A.T, G.B.T, G.dt, decay)[0].T
    L = injection_gain(G.A, G.C, G.dt, decay)[0]
    return observer_controller(G, F, L), L, F


def close_to(a, b, tolerance=1e-8):
    np.testing.assert_allclose(a, b, rtol=0, atol=tolerance * max(1.0, np.abs(b).max()))


@pytest.mark.parametrize("dt", [None, DT])
@pytest.mark.parametrize("seed", range(6))
def test_double_bezout_identity_with_eight_stable_factors(seed, dt):
    G = nominal(plant(seed, dt))
    K, L, _ = stabilising(G)
    general = StateSpace(K.A, K.B, K.C, K.D + 0.0, K.inputs, K.outputs, dt)
    for factors in (coprime_factors(G, general), coprime_factors(G, K, L, -G.B)):
        eight = [
            getattr(factors, side)
            for side in ("M", "N", "U", "V", "M_left", "N_left", "U_left", "V_left")
        ]
        assert all(is_stable(one) for one in eight)
        M, N, U, V, Ml, Nl, Ul, Vl = (at(one) for one in eight)
        left, right = np.block([[Vl, -Ul], [-Nl, Ml]]), np.block([[M, U], [N, V]])
        rounding = 1e-11 * np.abs(left).max() * np.abs(right).max()  # controller gains up to 1e3
        close_to(left @ right, np.broadcast_to(np.eye(5), left.shape), rounding)
        close_to(right @ left, np.broadcast_to(np.eye(5), left.shape), rounding)
        close_to(N @ np.linalg.inv(M), at(G))
        close_to(np.linalg.solve(Ml, Nl), at(G))
        close_to(U @ np.linalg.inv(V), at(K))
        close_to(np.linalg.solve(Vl, Ul), at(K))


def test_a_complex_pair_outside_the_unit_circle_is_moved():
    """Its real part inside the circle: a test of real parts alone, as SciPy 1.14 makes it of a real
    matrix, leaves it there.
    """
    A = 2.5 * np.array([[np.cos(1.3), np.sin(1.3)], [-np.sin(1.3), np.cos(1.3)]])
    L, _ = injection_gain(A, [[1.0, 0.0]], DT)
    np.testing.assert_allclose(np.abs(np.linalg.eigvals(A + L @ [[1.0, 0.0]])), 1 / 2.5, rtol=1e-9)


def test_the_observer_based_controller_has_the_printed_factors():
    """U = -F (sI - A - B F)^-1 L and M~ = I + C (sI - A - L C)^-1 L, as P1 (13) needs them."""
    G = nominal(plant(0))
    K, L, F = stabilising(G)
    factors = coprime_factors(G, K, L, -G.B)

    def printed(A, B, C, D):
        return at(StateSpace(A, B, C, D))

    n = G.n_states
    p = len(G.outputs)
    m = len(G.inputs)
    close_to(at(factors.U), printed(G.A + G.B @ F, -L, F, np.zeros((m, p))))
    close_to(at(factors.M), printed(G.A + G.B @ F, G.B, F, np.eye(m)))
    close_to(at(factors.M_left), printed(G.A + L @ G.C, L, G.C, np.eye(p)))
    close_to(at(factors.U_left), printed(G.A + L @ G.C, -L, F, np.zeros((m, p))))
    assert n == factors.left.n_states - K.n_states


@pytest.mark.parametrize("dt", [None, DT])
@pytest.mark.parametrize("seed", range(4))
def test_residual_system_carries_the_plant(seed, dt):
    general = plant(seed, dt)
    G = nominal(general)
    K, *_ = stabilising(G)
    factors = coprime_factors(G, K)
    moved = close_uncertainty(general, {"k": 0.05})
    S = residual_system(factors, moved)
    s = at(S)
    M, N, U, V = (at(one) for one in (factors.M, factors.N, factors.U, factors.V))
    Ml, Nl, Ul, Vl = (
        at(one) for one in (factors.M_left, factors.N_left, factors.U_left, factors.V_left)
    )
    true = at(moved)
    close_to(Ml @ (true - at(G)) @ np.linalg.inv(np.eye(2) - at(K) @ true) @ np.linalg.inv(Vl), s)
    close_to((N + V @ s) @ np.linalg.inv(M + U @ s), true, 1e-7)
    close_to(np.linalg.solve(Ml + s @ Ul, Nl + s @ Vl), true, 1e-7)
    close_to(at(residual_system(factors, G)), 0 * s)
    lft = residual_lft(factors, general)
    close_to(at(close_uncertainty(lft, {"k": 0.05})), s)
    # P1 (13), block by block
    part = {
        name: at(select(general.system, inputs, outputs))
        for name, inputs, outputs in (
            ("yw", ["w"], general.y),
            ("zu", general.u, ["z"]),
            ("zw", ["w"], ["z"]),
        )
    }
    close_to(at(select(lft.system, ["w"], factors.eps)), Ml @ part["yw"])
    close_to(at(select(lft.system, factors.alpha, ["z"])), part["zu"] @ M)
    # Formed from a product up to 1e7 times as large (seed 3): rounding is measured against it,
    # 2e-12 at most on 24 plants.
    product = np.prod([np.abs(factor).max() for factor in (part["zu"], U, Ml, part["yw"])])
    np.testing.assert_allclose(
        at(select(lft.system, ["w"], ["z"])),
        part["zw"] + part["zu"] @ U @ Ml @ part["yw"],
        rtol=0,
        atol=1e-11 * product,
    )
    close_to(at(select(lft.system, factors.alpha, factors.eps)), 0 * s)


def test_printed_equation_9_is_wrong_and_its_correction_right():
    """(M + S U)^-1 (N + S V)^-1 for a square plant is not the plant; (N + V S)(M + U S)^-1 is."""
    general = plant(3, m=2, p=2)
    G = nominal(general)
    factors = coprime_factors(G, stabilising(G)[0])
    moved = close_uncertainty(general, {"k": 0.05})
    s, true = at(residual_system(factors, moved)), at(moved)
    M, N, U, V = (at(one) for one in (factors.M, factors.N, factors.U, factors.V))
    printed = np.linalg.inv(M + s @ U) @ np.linalg.inv(N + s @ V)
    assert np.linalg.norm(printed - true) > 0.5 * np.linalg.norm(true)
    close_to((N + V @ s) @ np.linalg.inv(M + U @ s), true, 1e-7)


@pytest.mark.parametrize("dt", [None, DT])
def test_residual_system_is_stable_exactly_while_the_controller_holds_the_plant(dt):
    both = set()
    for seed in range(4):
        general = plant(seed, dt)
        G = nominal(general)
        K, *_ = stabilising(G, 1.0)
        factors = coprime_factors(G, K)
        for k in np.linspace(-2, 2, 41):
            moved = close_uncertainty(general, {"k": k})
            loop = feedback(moved, K, sign=1)
            S = residual_system(factors, moved)
            assert is_stable(S) == is_stable(loop), (seed, k)
            both.add(is_stable(S))
            for pole in poles(loop):
                # at k = 0 they are double: root of eps
                assert np.abs(poles(S) - pole).min() < 1e-4 * (1 + abs(pole))
    assert both == {True, False}


def test_injection_gain_moves_only_what_is_slow_and_keeps_white_noise_white():
    A = sla.block_diag([[0.3, 2.0], [-2.0, 0.3]], [[-0.01]], [[-5.0]])
    C = np.random.default_rng(0).standard_normal((2, 4))
    for decay in (0.0, 0.5):
        L, _ = injection_gain(A, C, None, decay)
        expected = [
            -0.3 - 2 * decay + 2j,
            -0.3 - 2 * decay - 2j,
            -0.01 if decay == 0 else 0.01 - 2 * decay,
            -5.0,
        ]
        found = np.linalg.eigvals(A + L @ C)
        assert max(np.abs(found - value).min() for value in expected) < 1e-9
    noise = np.array([0.5, 2.0])
    for dt in (None, DT):
        system = StateSpace(A, np.eye(4), C, np.zeros((2, 4)))
        system = c2d(system, dt) if dt else system
        L, covariance = injection_gain(system.A, system.C, dt, 0.0, noise)
        M = at(StateSpace(system.A + L @ system.C, L, system.C, np.eye(2), dt=dt))
        spectrum = M @ np.diag(noise**2) @ M.conj().transpose(0, 2, 1)
        close_to(spectrum, np.broadcast_to(covariance, spectrum.shape), 1e-9)  # all-pass


def test_exchange_is_its_own_inverse():
    rng = np.random.default_rng(5)
    system = StateSpace(*(rng.standard_normal(shape) for shape in ((3, 3), (3, 3), (4, 3), (4, 3))))
    there = exchange(system, ["u2", "u3"], ["y4", "y1"])
    assert there.inputs == ("y4", "y1", "u1") and there.outputs == ("u2", "u3", "y2", "y3")
    back = select(exchange(there, ["y4", "y1"], ["u2", "u3"]), system.inputs, system.outputs)
    close_to(at(back), at(system))
    x, w = rng.standard_normal(3), at(system)[2]
    y = w @ x
    close_to(at(there)[2] @ np.array([y[3], y[0], x[0]]), np.array([x[1], x[2], y[1], y[2]]))


def test_bad_input():
    general = plant(0)
    G = nominal(general)
    K, L, F = stabilising(G)
    with pytest.raises(UnstableSystem, match="does not stabilise the plant"):
        coprime_factors(G, StateSpace(K.A, K.B, -K.C, K.D, K.inputs, K.outputs), L)
    with pytest.raises(InvalidInput, match="controller's size"):
        coprime_factors(G, select(K, inputs=["y0"]))
    with pytest.raises(InvalidInput, match="A \\+ L C of the plant is unstable"):
        coprime_factors(G, K, 0 * L)
    factors = coprime_factors(G, K)
    with pytest.raises(InvalidInput, match="plant's inputs"):
        residual_system(factors, select(G, inputs=["u0"]))
    with pytest.raises(InvalidInput, match="dt"):
        residual_system(factors, c2d(G, DT))
    with pytest.raises(InvalidInput, match="does not show in the outputs"):
        injection_gain(np.diag([1.0, -1.0]), [[0.0, 1.0]])
    with pytest.raises(InvalidInput, match="cannot be mirrored"):
        injection_gain(np.diag([-2.0, -1.0]), [[1.0, 1.0]], None, 1.0)
    with pytest.raises(NumericalFailure, match="feedthrough between the exchanged signals"):
        exchange(transfer_function([1.0], [1.0, 1.0]), ["u1"], ["y1"])
    with pytest.raises(InvalidInput, match="noise"):
        injection_gain(G.A, G.C, None, 0.0, [-1.0, 1.0, 1.0])
    assert spectral_abscissa(factors.right) < 0 and F.shape == (2, 5)
