"""Polishing: gradient, form, reduction against independent computations; order 12 against D-K at 24
on the published plant.
"""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.published_p5 import published_p5_problem
from scipy.linalg import block_diag
from scipy.optimize import rosen, rosen_der

from ambrose.core.checks import InvalidInput, NumericalFailure
from ambrose.core.frequency import frequency_response
from ambrose.core.lft import ComplexBlock, GeneralizedPlant, RealBlock, close_uncertainty, lft
from ambrose.core.mu import all_frequencies
from ambrose.core.norms import hinf_norm
from ambrose.core.statespace import StateSpace, is_stable, spectral_abscissa
from ambrose.law.design_problem import with_performance_block
from ambrose.synthesis.fixed_order.polish import Cost, block_form, descend, polish_synthesis
from ambrose.synthesis.fixed_order.structure import reduce_controller
from ambrose.synthesis.hinf import hinf_synthesis
from ambrose.synthesis.mu import mu_synthesis

pytestmark = pytest.mark.study  # minutes

OMEGA = np.geomspace(1e-3, 1e4, 50)


@pytest.fixture(scope="module")
def plant() -> GeneralizedPlant:
    return published_p5_problem()


@pytest.fixture(scope="module")
def start(plant):
    return mu_synthesis(plant, order=1, iterations=2).controller


def at(plant: GeneralizedPlant, **delta: float) -> GeneralizedPlant:
    """The plant at parameter values, without blocks; a name's underscores stand for dots."""
    system = close_uncertainty(
        plant, {name.replace("_", "."): value for name, value in delta.items()}
    )
    return GeneralizedPlant(
        system, plant.w[plant.n_w_blocks :], plant.u, plant.z[plant.n_z_blocks :], plant.y
    )


def models(plant: GeneralizedPlant) -> list[GeneralizedPlant]:
    return [at(plant, seal_k=value) for value in (-1.0, 0.0, 1.0)]


def worst(plant: GeneralizedPlant, controller: StateSpace, count: int = 33) -> float:
    loops = [lft(at(plant, seal_k=float(v)), controller) for v in np.linspace(-1, 1, count)]
    return max(hinf_norm(loop).value if is_stable(loop) else np.inf for loop in loops)


# the pieces


def test_block_form_keeps_the_controller(start):
    form, x = block_form(start)
    found = form.controller(x)
    a, b = (frequency_response(item, OMEGA).values for item in (start, found))
    np.testing.assert_allclose(b, a, rtol=1e-6, atol=1e-9 * np.abs(a).max())
    np.testing.assert_allclose(form.unknowns(found.A, found.B, found.C, found.D), x)
    assert np.abs(x).max() < 1e3  # numbers of similar size


def test_block_form_of_real_and_odd_poles():
    rng = np.random.default_rng(1)
    A = block_diag([[-1.0, 5.0], [-5.0, -1.0]], [[-0.01]], [[-200.0]], [[-3.0]])
    controller = StateSpace(
        A, rng.normal(size=(5, 2)), rng.normal(size=(3, 5)), rng.normal(size=(3, 2))
    )
    form, x = block_form(controller)
    a, b = (frequency_response(item, OMEGA).values for item in (controller, form.controller(x)))
    np.testing.assert_allclose(b, a, rtol=1e-9, atol=1e-10)
    assert form.mask.sum() == 4 + 4 + 1


def test_cost_is_the_norm_and_its_gradient_is_exact(plant, start):
    reduced, _ = reduce_controller(models(plant), start, 12)
    form, x = block_form(reduced)
    cost = Cost(form, models(plant), OMEGA)
    loops = [
        frequency_response(lft(model, form.controller(x)), OMEGA).values for model in models(plant)
    ]
    sigma = np.linalg.svd(np.array(loops), compute_uv=False)
    np.testing.assert_allclose(cost.gains(x), sigma[..., 0], rtol=1e-6)
    power = 12.0
    value, gradient = cost(x, power)
    assert value == pytest.approx(np.log((sigma**power).sum()) / power, rel=1e-4)
    assert cost.abscissa(x) == pytest.approx(
        max(spectral_abscissa(lft(m, form.controller(x))) for m in models(plant)), rel=1e-6
    )
    rng = np.random.default_rng(0)
    for _ in range(4):
        direction = rng.normal(size=len(x))
        direction /= np.linalg.norm(gradient) * np.linalg.norm(direction)
        steps = [1e-4, 5e-5]
        slopes = [
            (cost(x + h * direction, power)[0] - cost(x - h * direction, power)[0]) / (2 * h)
            for h in steps
        ]
        slope = (4 * slopes[1] - slopes[0]) / 3  # Richardson
        assert slope == pytest.approx(gradient @ direction, rel=1e-5, abs=1e-7)


def test_descent_solves_rosenbrock_and_respects_the_fence():
    start = np.array([-1.2, 1.0, -0.5, 0.8])
    x, used = descend(
        lambda v: (rosen(v), rosen_der(v)), lambda v: True, start, 300, 1e-12, lambda: True
    )
    np.testing.assert_allclose(x, 1.0, atol=1e-4)
    assert used < 300
    x, _ = descend(
        lambda v: (rosen(v), rosen_der(v)),
        lambda v: bool(v[0] < 0.5),
        start,
        300,
        0.0,
        lambda: True,
    )
    assert x[0] < 0.5
    assert rosen(x) < rosen(start)
    same, used = descend(
        lambda v: (rosen(v), rosen_der(v)), lambda v: True, start, 300, 0.0, lambda: False
    )
    np.testing.assert_array_equal(same, start)
    near, _ = descend(
        lambda v: (rosen(v), rosen_der(v)), lambda v: True, start, 300, 0.0, lambda: True, least=1.0
    )
    assert 1e-3 < rosen(near) < 1.0  # no further than asked for


def test_a_cost_that_is_renewed_on_the_way_is_asked_again():
    """Every ten steps it may change: a value that jumps then is no reason to end."""
    calls = []

    def renew(x):
        calls.append(np.array(x))
        return True

    def cost(v):
        return rosen(v) + 10.0 * len(calls), rosen_der(v)

    start = np.array([-1.2, 1.0, -0.5, 0.8])
    x, used = descend(cost, lambda v: True, start, 300, 1e-12, lambda: True, renew)
    np.testing.assert_allclose(x, 1.0, atol=1e-4)
    assert len(calls) == 2 + used // 10 and (calls[0] == start).all()


def test_a_descent_goes_back_where_its_cost_had_left_something_out():
    """x[0] > 0.3 is not allowed, which the cost sees only once it was told so."""
    told = []

    def renew(x):
        told.append(x[0] <= 0.3)
        return told[-1]

    def cost(v):
        barred = not all(told) and v[0] > 0.3
        return (np.inf, np.zeros(4)) if barred else (rosen(v), rosen_der(v))

    start = np.array([-1.2, 1.0, -0.5, 0.8])
    x, _ = descend(cost, lambda v: True, start, 300, 1e-12, lambda: True, renew)
    assert not all(told) and x[0] <= 0.3 and rosen(x) < rosen(start)


def test_reduction_keeps_the_gain_at_zero_and_cuts_no_pair(plant, start):
    same, values = reduce_controller(models(plant), start, start.n_states)
    assert same is start
    assert (np.diff(values) <= 0).all()
    loop = worst(plant, start, 5)
    for order in (20, 16, 12):
        small, _ = reduce_controller(models(plant), start, order)
        assert small.n_states in (order, order - 1)
        if small.n_states < order:
            assert values[order] > 0.9 * values[order - 1]
        zero = np.array([0.0])
        a, b = (frequency_response(item, zero).values for item in (start, small))
        np.testing.assert_allclose(b, a, rtol=1e-6, atol=1e-6 * np.abs(a).max())
        assert worst(plant, small, 5) < 1.5 * loop
    with pytest.raises(InvalidInput, match="order"):
        reduce_controller(models(plant), start, 99)


# the whole


@pytest.fixture(scope="module")
def polished(plant, start):
    return polish_synthesis(plant, start, order=12, iterations=600, rounds=4)


def test_order_12_does_the_work_of_24(plant, start, polished):
    """The target: the polished controller of order 12 is no worse than D-K's of order 24, over the
    whole range of k.
    """
    assert start.n_states == 24
    assert polished.controller.n_states == 12
    before, after = worst(plant, start), worst(plant, polished.controller)
    assert after < 0.97 * before
    assert polished.certificate.margins["start_norm"] == pytest.approx(before, rel=1e-3)
    assert polished.gamma == pytest.approx(after, rel=5e-3)
    assert after <= polished.certificate.margins["proved_norm"] < 1.06 * polished.gamma


def test_polish_history_and_certificate(polished):
    gammas = [row["gamma"] for row in polished.history]
    assert polished.gamma == min(gammas)
    assert gammas[0] == polished.certificate.margins["reduced_norm"]
    assert polished.gamma < 0.9 * gammas[0]
    assert polished.status == "verified"
    assert polished.certificate.stable
    assert polished.certificate.spectral_abscissa < 0
    assert polished.certificate.fastest_pole < 1e5


def two_parameters() -> GeneralizedPlant:
    """x'' + (0.4 + 0.3 d_c) x' + (1 + 0.6 d_k) x = w + u, z = (x, 0.3 u), y = x + 0.1 n."""
    B = [[0, 0, 0, 0, 0], [-0.6, -0.3, 1, 0, 1]]
    C = [[1, 0], [0, 1], [1, 0], [0, 0], [1, 0]]
    D = np.zeros((5, 5))
    D[3, 4], D[4, 3] = 0.3, 0.1
    system = StateSpace(
        [[0, 1], [-1, -0.4]], B, C, D, ["wk", "wc", "w", "n", "u"], ["zk", "zc", "x", "e", "y"]
    )
    return GeneralizedPlant(
        system,
        ["wk", "wc", "w", "n"],
        ["u"],
        ["zk", "zc", "x", "e"],
        ["y"],
        [RealBlock("k"), RealBlock("c")],
    )


def test_two_parameters_against_the_whole_box():
    plant = two_parameters()
    start = hinf_synthesis(at(plant)).controller
    result = polish_synthesis(plant, start, iterations=200, rounds=3)
    grid = np.linspace(-1, 1, 9)
    norms = [
        hinf_norm(lft(at(plant, k=a, c=b), result.controller)).value for a in grid for b in grid
    ]
    assert max(norms) == pytest.approx(result.gamma, rel=2e-3)
    assert result.gamma < 0.95 * result.certificate.margins["start_norm"]
    assert result.controller.n_states == start.n_states


# ends before the end, and bad input


def test_a_judge_decides_between_the_rounds(plant, start):
    seen = []

    def judge(controller):
        seen.append(controller)
        return -float(len(seen)) if len(seen) < 3 else 0.0  # the second of the start and two rounds

    result = polish_synthesis(plant, start, order=14, iterations=30, rounds=2, judge=judge)
    assert len(seen) == 3
    assert result.controller is seen[1]
    assert result.certificate.stable


def test_a_proof_that_fails_does_not_take_the_controller_with_it(plant, start, monkeypatch):
    def singular(*arguments, **options):
        raise np.linalg.LinAlgError("Singular matrix")

    monkeypatch.setattr(all_frequencies, "upper_bound", singular)
    monkeypatch.setattr(all_frequencies, "osborne", singular)
    result = polish_synthesis(plant, start, order=14, iterations=10, rounds=1)
    assert np.isinf(result.certificate.margins["proved_norm"])
    assert result.controller.n_states <= 14 and np.isfinite(result.gamma)


def test_interruption_and_time_limit(plant, start):
    def interrupt(text: str) -> None:
        if text.startswith("round 1"):
            raise KeyboardInterrupt

    result = polish_synthesis(plant, start, order=14, iterations=20, rounds=2, progress=interrupt)
    assert (result.status, result.stopped_early) == ("verified", "interrupted")
    assert result.gamma == result.certificate.margins["reduced_norm"]
    result = polish_synthesis(plant, start, order=14, time_limit=0.3)
    assert "time limit" in result.stopped_early
    assert np.isfinite(result.gamma)


def test_a_start_that_holds_nothing(plant, start):
    nothing = StateSpace(start.A, start.B, 0 * start.C, start.D * 0)
    with pytest.raises(NumericalFailure, match="stabilise"):
        polish_synthesis(plant, nothing)


def test_bad_input(plant, start):
    with pytest.raises(InvalidInput, match="real parameters"):
        polish_synthesis(published_p5_problem(uncertain=False), start)
    whole = with_performance_block(plant)
    complex_plant = GeneralizedPlant(
        plant.system, plant.w, plant.u, plant.z, plant.y, [ComplexBlock("k", 2)]
    )
    with pytest.raises(InvalidInput, match="real parameters"):
        polish_synthesis(complex_plant, start)
    with pytest.raises(InvalidInput, match="start"):
        polish_synthesis(whole, StateSpace(-1, 1, 1, 0))
    with pytest.raises(InvalidInput, match="deltas"):
        polish_synthesis(plant, start, deltas=(0.0, 2.0))
    with pytest.raises(InvalidInput, match="iterations"):
        polish_synthesis(plant, start, iterations=0)
    with pytest.raises(InvalidInput, match="order"):
        polish_synthesis(plant, start, order=30)
