"""H-infinity synthesis by Riccati equations: closed forms, invariances, what is verified, what is
refused and how.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from ambrose.core.checks import InvalidInput, NumericalFailure
from ambrose.core.lft import GeneralizedPlant, lft
from ambrose.core.matrix_equations import solve_riccati
from ambrose.core.norms import hinf_norm
from ambrose.core.statespace import StateSpace, spectral_abscissa, static_gain
from ambrose.judge.result import generalized_certificate
from ambrose.synthesis import hinf
from ambrose.synthesis.hinf import hinf_synthesis
from random_plants import KINDS, random_plant


def parted(A, B, C, D, m, p) -> GeneralizedPlant:
    """The last m inputs are u, the last p outputs y."""
    s = StateSpace(A, B, C, D)
    return GeneralizedPlant(s, s.inputs[:-m], s.inputs[-m:], s.outputs[:-p], s.outputs[-p:])


def scalar(a: float, b: float = 1.0, c: float = 1.0) -> GeneralizedPlant:
    """x' = a x + w1 + b u, z = (x, u), y = c x + w2."""
    return parted([[a]], [[1, 0, b]], [[1], [0], [c]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]], 1, 1)


def bracket(synthesis) -> tuple[float, float]:
    return synthesis.certificate.margins["gamma_lower"], synthesis.certificate.margins[
        "gamma_optimal"
    ]


def coprime(A, B, C, D) -> tuple[GeneralizedPlant, float]:
    """Normalised coprime factor stabilisation of G: z = (u, y), y = G (u + w2) + w1; and the closed
    form of its optimum.

    gamma^2 = 1 + lambda_max(X Z) with both Riccati solutions of the factors (McFarlane & Glover
    1990; Zhou, Doyle & Glover 1996, cor. 18.2). D11 and D22 are not zero when G is not strictly
    proper.
    """
    p, m = D.shape
    R, S = np.eye(p) + D @ D.T, np.eye(m) + D.T @ D
    F = A - B @ np.linalg.solve(S, D.T @ C)
    X = solve_riccati(F, B @ np.linalg.solve(S, B.T), C.T @ np.linalg.solve(R, C)).X
    Z = solve_riccati(F.T, C.T @ np.linalg.solve(R, C), B @ np.linalg.solve(S, B.T)).X
    wide = np.hstack([np.zeros((len(A), p)), B, B])
    tall = np.vstack([np.zeros((m, len(A))), C, C])
    zero, one = np.zeros((m, m)), np.eye(m)
    direct = np.block([[np.zeros((m, p)), zero, one], [np.eye(p), D, D], [np.eye(p), D, D]])
    return parted(A, wide, tall, direct, m, p), float(
        np.sqrt(1 + np.linalg.eigvals(X @ Z).real.max())
    )


@pytest.mark.parametrize("a", [-2.0, -0.1, 0.0, 1.0, 50.0])
def test_scalar_closed_form(a):
    """X = Y, and X = gamma at the optimum: gamma^2 - 2 a gamma - 2 = 0."""
    lower, upper = bracket(hinf_synthesis(scalar(a), tolerance=1e-8))
    exact = a + np.sqrt(a * a + 2)
    assert lower * (1 - 1e-9) <= exact <= upper * (1 + 1e-9)
    assert upper / lower <= 1 + 1.1e-8


@pytest.mark.parametrize("seed", range(8))
def test_coprime_factor_closed_form(seed):
    rng = np.random.default_rng(seed)
    n, m, p = (int(rng.integers(low, high)) for low, high in ((2, 9), (1, 4), (1, 4)))
    A = rng.standard_normal((n, n))
    B = rng.standard_normal((n, m))
    C = rng.standard_normal((p, n))
    plant, exact = coprime(A, B, C, (seed % 2) * rng.standard_normal((p, m)))
    result = hinf_synthesis(plant, tolerance=1e-7)
    np.testing.assert_allclose(bracket(result), exact, rtol=2e-7)
    assert exact * (1 - 1e-6) < result.gamma <= 1.03 * exact * (1 + 1e-6)


def test_static_plant_is_parrott():
    """Without states gamma is max(|[D1111 D1112]|, |[D1111; D1121]|), with controls and
    measurements that cancel the rest.
    """
    rng = np.random.default_rng(5)
    D11 = rng.standard_normal((5, 4))
    D = np.block([[D11, np.eye(5, 2, -3)], [np.eye(2, 4, 2), rng.standard_normal((2, 2))]])
    result = hinf_synthesis(
        parted([], np.zeros((0, 6)), np.zeros((7, 0)), D, 2, 2), tolerance=1e-6, backoff=1.0001
    )
    exact = max(np.linalg.norm(D11[:3], 2), np.linalg.norm(D11[:, :2], 2))
    np.testing.assert_allclose(bracket(result), exact, rtol=2e-6)
    assert result.gamma <= 1.0002 * exact
    assert result.notes == ()
    assert result.controller.n_states == 0


@pytest.mark.parametrize("kind", [k for k in KINDS if k != "singular"])
@pytest.mark.parametrize("seed", range(3))
def test_result_is_verified_on_the_original_plant(kind, seed):
    """Certificate, gamma and promise recomputed from the returned controller alone; names and sizes
    as stated.
    """
    plant = parted(*random_plant(kind, seed))
    result = hinf_synthesis(plant)
    assert result.status == "verified"
    loop = lft(plant, result.controller)
    assert spectral_abscissa(loop) < 0
    norm = hinf_norm(loop, tolerance=1e-4).value
    margins = result.certificate.margins
    assert result.gamma == pytest.approx(norm, rel=2e-4)
    assert margins["gamma_lower"] * (1 - 2e-4) <= norm <= margins["gamma_designed"] * (1 + 2e-4)
    assert margins["gamma_designed"] == pytest.approx(1.03 * margins["gamma_optimal"], rel=1e-12)
    assert margins["gamma_optimal"] <= margins["gamma_lower"] * 1.0010001
    assert (result.controller.inputs, result.controller.outputs) == (plant.y, plant.u)
    assert result.controller.n_states == plant.system.n_states
    assert result.history


@pytest.mark.parametrize("seed", range(6))
def test_gamma_does_not_depend_on_units(seed):
    """States, u and y in other units leave gamma as it is; w and z in other units multiply it."""
    A, B, C, D, m, p = random_plant("plain", seed)
    rng = np.random.default_rng(seed)
    before = hinf_synthesis(parted(A, B, C, D, m, p), tolerance=1e-5)
    t, u, y = (10 ** rng.uniform(-9, 9, k) for k in (len(A), m, p))
    A = A * t / t[:, None] * 1e4
    B = B / t[:, None] * 1e4
    C = C * t
    D = D.copy()
    B[:, -m:] *= u
    D[:, -m:] *= u
    C[-p:] *= y[:, None]
    D[-p:] *= y[:, None]
    for size in (1.0, 1e7, 1e-7):
        parts = B.copy(), D.copy()
        for part in parts:
            part[:, :-m] *= size
        after = hinf_synthesis(parted(A, parts[0], C, parts[1], m, p), tolerance=1e-5)
        assert bracket(after)[1] == pytest.approx(size * bracket(before)[1], rel=2e-5)


def test_backoff_slows_the_controller_and_costs_no_more_than_it_says():
    plant = parted(*random_plant("rotor", 3))
    results = [hinf_synthesis(plant, backoff=b, tolerance=1e-6) for b in (1.0001, 1.02, 1.05, 1.2)]
    fastest = [r.certificate.fastest_pole for r in results]
    assert fastest == sorted(fastest, reverse=True)
    assert fastest[0] > 50 * fastest[2]
    best = bracket(results[0])[1]
    for result, backoff in zip(results, (1.0001, 1.02, 1.05, 1.2), strict=True):
        assert best * (1 - 1e-5) < result.gamma <= backoff * best * (1 + 1e-5)


def test_no_controller_beats_the_lower_bound():
    """Perturbed controllers, and those of a related plant, stay above gamma_lower."""
    plant = parted(*random_plant("weights", 1))
    result = hinf_synthesis(plant, backoff=1.0005, tolerance=1e-5)
    lower = bracket(result)[0]
    rng = np.random.default_rng(0)
    K = result.controller
    stable = 0
    for _ in range(30):
        factor = 1 + 0.02 * rng.standard_normal(K.C.shape)
        other = generalized_certificate(plant, StateSpace(K.A, K.B, K.C * factor, K.D))
        stable += other.stable
        assert other.closed_loop_norm >= lower * (1 - 1e-6)
    assert stable > 5


def test_progress_is_told_and_history_matches():
    lines: list[str] = []
    result = hinf_synthesis(scalar(1.0), progress=lines.append)
    assert sum(line.startswith("gamma ") for line in lines) == len(result.history)
    assert lines[-1].startswith("verified: norm")
    feasible = [row["gamma"] for row in result.history if row["feasible"]]
    assert min(feasible) == bracket(result)[1]


def test_zero_control_is_stated_where_it_is_optimal():
    """u reaches nothing that matters: gamma is the open norm, and the note says so; elsewhere there
    is no such note.
    """
    useless = hinf_synthesis(scalar(-1.0, b=1e-12))
    assert "no control does as well" in useless.notes[0]
    assert useless.gamma == pytest.approx(1.0, rel=1e-5)
    assert hinf_synthesis(scalar(-0.1)).notes == ()


@pytest.mark.parametrize("method", ["riccati", "lmi"])
def test_time_limit(method):
    with pytest.raises(NumericalFailure, match="time limit of 1e-09 s; take fewer states"):
        hinf_synthesis(scalar(1.0), time_limit=1e-9, method=method)


def test_an_exception_in_progress_ends_the_search():
    def stop(text: str) -> None:
        raise KeyboardInterrupt(text)

    with pytest.raises(KeyboardInterrupt, match="gamma"):
        hinf_synthesis(scalar(1.0), progress=stop)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"backoff": 0.99}, "backoff is 0.99, but must be at least 1"),
        ({"backoff": np.nan}, "backoff is nan, but must be finite"),
        ({"tolerance": 0.0}, "tolerance is 0.0, but must be positive"),
        ({"tolerance": 2.0}, "tolerance is 2.0, but must be between"),
        ({"time_limit": -1.0}, "time_limit is -1.0, but must be positive"),
        ({"method": "guess"}, 'method is \'guess\', but must be "riccati" or "lmi"'),
    ],
)
def test_bad_arguments(change, message):
    with pytest.raises(InvalidInput, match=message):
        hinf_synthesis(scalar(1.0), **change)


def test_sampled_and_incomplete_plants_are_refused():
    s = scalar(-1.0).system
    sampled = StateSpace(s.A, s.B, s.C, s.D, dt=1e-3)
    with pytest.raises(
        InvalidInput, match=r"sample time is 0.001, but must be None \(continuous time\)"
    ):
        hinf_synthesis(GeneralizedPlant(sampled, ["u1", "u2"], ["u3"], ["y1", "y2"], ["y3"]))
    for empty in "wuzy":
        groups = {"w": ["u1", "u2"], "u": ["u3"], "z": ["y1", "y2"], "y": ["y3"], empty: []}
        with pytest.raises(InvalidInput, match=f"signals {empty} is 0, but must be at least 1"):
            hinf_synthesis(GeneralizedPlant(s, **groups))


def test_a_wrong_controller_does_not_pass(monkeypatch):
    """Nothing unverified leaves: with every controller's sign turned, the synthesis fails and says
    what it found.
    """
    right = hinf.original_controller

    def turned(*arguments):
        K = right(*arguments)
        return StateSpace(K.A, K.B, -K.C, -K.D, K.inputs, K.outputs)

    monkeypatch.setattr(hinf, "original_controller", turned)
    with pytest.raises(
        NumericalFailure,
        match=r"passed its verification on the original plant.*the loop is unstable",
    ):
        hinf_synthesis(scalar(1.0))


def test_a_norm_above_gamma_does_not_pass():
    plant = scalar(1.0)
    result = hinf_synthesis(plant)
    assert hinf.verified(plant, result.controller, result.gamma).stable
    with pytest.raises(NumericalFailure, match=r"the norm is 2\.81\d*, above gamma"):
        hinf.verified(plant, result.controller, 0.999 * result.gamma)


def test_wider_backoff_is_tried_and_announced(monkeypatch):
    real = hinf.verified

    def strict(plant, controller, gamma):
        if gamma < 1.1 * (1 + np.sqrt(3)):
            raise NumericalFailure("refused for the test")
        return real(plant, controller, gamma)

    monkeypatch.setattr(hinf, "verified", strict)
    result = hinf_synthesis(scalar(1.0))
    assert result.certificate.margins["gamma_designed"] / bracket(result)[1] == pytest.approx(1.12)
    assert result.notes == (
        "the back-off is 1.12 instead of 1.03: closer to the optimum verification failed",
    )


def test_certificate_of_a_generalized_plant():
    """x' = a x + w1 + u, u = -k y: norms in closed form; marginal and unstable loops are verdicts,
    wrong sizes are refused.
    """
    plant = scalar(1.0)
    found = generalized_certificate(plant, static_gain([[-3.0]]))
    assert found.stable
    assert found.spectral_abscissa == pytest.approx(-2.0)
    # z = (x, -3 x - 3 w2) at zero frequency, x = (w1 - 3 w2)/2
    G0 = np.array([[1, -3], [-3, 9 - 3 * 2]]) / 2
    at_infinity = 3.0
    assert found.closed_loop_norm == pytest.approx(
        max(np.linalg.norm(G0, 2), at_infinity), rel=1e-6
    )
    assert found.fastest_pole == 0.0
    for gain in (-1.0, 0.5):
        verdict = generalized_certificate(plant, static_gain([[gain]]))
        assert not verdict.stable
        assert verdict.closed_loop_norm == np.inf
    with pytest.raises(InvalidInput, match="controller's size"):
        generalized_certificate(plant, static_gain(np.zeros((2, 1))))


def test_large_plant_in_time():
    """Seventy states, so that nothing here is of higher order than it should be; the time itself is
    the benchmark's.
    """
    rng = np.random.default_rng(1)
    n = 70
    A = rng.standard_normal((n, n)) / np.sqrt(n) - 0.5 * np.eye(n)
    B, C = rng.standard_normal((n, 6)), rng.standard_normal((6, n))
    D = np.zeros((6, 6))
    D[2:4, 4:] = D[4:, 2:4] = np.eye(2)
    result = hinf_synthesis(parted(A, B, C, D, 2, 2), time_limit=20.0)
    assert result.status == "verified"
    assert dataclasses.replace(result.certificate, margins={}).stable
