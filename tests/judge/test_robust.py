"""Robust verification against perturbed plants verified one by one, eigenvalues, and the main loop
theorem.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.published_p5 import published_p5, published_p5_problem, published_p5_weights

from ambrose.core import worst_case as bounds
from ambrose.core.checks import InvalidInput, NumericalFailure
from ambrose.core.frequency import frequency_response
from ambrose.core.lft import GeneralizedPlant, close_uncertainty, lft
from ambrose.core.norms import hinf_norm
from ambrose.core.sampling import c2d
from ambrose.core.statespace import StateSpace, select, spectral_abscissa, static_gain
from ambrose.judge import robust
from ambrose.judge.checks import Checks
from ambrose.law.design_problem import Weights, control_weight, design_plant, performance_weight
from ambrose.law.loop import closed_loop
from ambrose.machine.description import Requirements, Tolerance
from ambrose.model.plant import Plant
from ambrose.model.uncertainty import perturbed, reduce
from ambrose.synthesis.hinf import hinf_synthesis

K = "seal.center.k"
SEAL = (Tolerance(K, relative=1.0),)
PAIR = (Tolerance(K, relative=0.25), Tolerance("bearing.A.negative_stiffness", relative=0.2))
WEIGHTS = Weights(performance_weight(3.0, 1.5), control_weight(0.315), 20e-6, 1.0)


@pytest.fixture(scope="module")
def rigid(rig_plants) -> Plant:
    return reduce(rig_plants["nominal"])


@pytest.fixture(scope="module")
def robust_controller(rigid) -> StateSpace:
    """An H-infinity controller of the nominal plant: it holds the whole range of the seal's
    stiffness.
    """
    return hinf_synthesis(design_plant(rigid, WEIGHTS, uncertain=False)).controller


@pytest.fixture(scope="module")
def over_the_range(rigid, robust_controller) -> Checks:
    return robust.check(rigid, robust_controller, SEAL, WEIGHTS)


def sensitivity_peak(plant: Plant, controller: StateSpace) -> float:
    """H-infinity norm of S_o, from the loop of law/loop.py."""
    loop = closed_loop(plant, controller)
    return hinf_norm(select(loop, [f"d_{a}" for a in plant.axes], plant.named("y"))).value


def test_sensitivities_equal_those_of_perturbed_plants(rigid, robust_controller, over_the_range):
    for delta in robust.FAMILY:
        found = over_the_range[f"robust.sensitivity.at{delta:+g}"].value
        assert found == pytest.approx(
            sensitivity_peak(perturbed(rigid, {K: delta}, SEAL), robust_controller), rel=1e-6
        )


def test_worst_case_is_attained_bounded_and_nowhere_exceeded(
    rigid, robust_controller, over_the_range
):
    worst, bound = (
        over_the_range["robust.sensitivity.worst"],
        over_the_range["robust.sensitivity.bound"],
    )
    peaks = [
        sensitivity_peak(perturbed(rigid, {K: d}, SEAL), robust_controller)
        for d in np.linspace(-1, 1, 21)
    ]
    # at a corner here, which the scan contains
    assert worst.value == pytest.approx(max(peaks), rel=1e-6)
    assert worst.value <= bound.value <= 1.01 * worst.value
    assert f"{K} +1" in worst.detail or f"{K} -1" in worst.detail


def test_margin_is_where_eigenvalues_cross(rigid, robust_controller, over_the_range):
    def abscissa(delta: float) -> float:
        return spectral_abscissa(closed_loop(perturbed(rigid, {K: delta}, SEAL), robust_controller))

    margin = over_the_range["robust.stability.margin"]
    assert margin.passed
    crossing = [
        d for d in (margin.value, -margin.value) if abscissa(0.9999 * d) < 0 < abscissa(1.0001 * d)
    ]
    assert crossing
    scan = np.linspace(-0.999, 0.999, 41) * margin.value
    assert max(abscissa(d) for d in scan) < 0
    proved = over_the_range["robust.stability.proved"].value
    assert 0.95 * margin.value < proved < margin.value
    assert over_the_range["robust.stability.box"].value == 0


def test_requirement_judges_the_worst_case(rigid, robust_controller, over_the_range):
    assert over_the_range["robust.sensitivity.worst"].limit is None
    limit = 0.99 * over_the_range["robust.sensitivity.worst"].value
    found = robust.check(
        rigid, robust_controller, SEAL, requirements=Requirements(sensitivity_peak=limit)
    )
    assert found["robust.sensitivity.worst"].passed is False and not found.passed
    assert over_the_range.passed


def test_families_hold_the_transfer_functions(rigid, robust_controller, over_the_range):
    curve = over_the_range.curve("robust.sensitivity")
    assert curve.labels == tuple(f"{K} {d:+g}" for d in robust.FAMILY)
    pick = slice(5, None, 90)
    omega = curve.x[pick]
    for row, delta in zip(curve.y, robust.FAMILY, strict=True):
        moved = perturbed(rigid, {K: delta}, SEAL)
        G, C = (
            response(moved.system, moved.named("u"), moved.named("y"), omega),
            response(robust_controller, None, None, omega),
        )
        S = np.linalg.inv(np.eye(4) + G @ C)
        np.testing.assert_allclose(row[pick], np.linalg.norm(S, 2, axis=(1, 2)), rtol=1e-6)
        S_i = np.linalg.inv(np.eye(4) + C @ G)
        inner = over_the_range.curve("robust.sensitivity.input")
        np.testing.assert_allclose(
            inner.y[curve.labels.index(f"{K} {delta:+g}")][pick],
            np.linalg.norm(S_i, 2, axis=(1, 2)),
            rtol=1e-6,
        )


def response(system: StateSpace, inputs, outputs, omega: np.ndarray) -> np.ndarray:
    return frequency_response(select(system, inputs, outputs), omega).values


def test_pid_is_reported_unstable_in_the_range(rig_plants, rig_controller):
    """On the full model: the PID holds the nominal pressure, not the whole range (P5)."""
    found = robust.check(rig_plants["nominal"], rig_controller, SEAL)
    assert found.stable and not found.passed
    margin = found["robust.stability.margin"]
    assert 0 < margin.value < 1
    assert found["robust.stability.box"].value > 0
    assert np.isinf(found["robust.sensitivity.worst"].value)
    assert np.isinf(found["robust.sensitivity.at+1"].value)
    for delta, stable in ((0.99 * margin.value, True), (1.01 * margin.value, False)):
        loop = closed_loop(perturbed(rig_plants["nominal"], {K: delta}, SEAL), rig_controller)
        assert (spectral_abscissa(loop) < 0) is stable
    labels = found.curve("robust.sensitivity").labels
    assert f"{K} +1" not in labels and f"{K} -1" in labels
    proved = found["robust.stability.proved"]  # on the full model, all of whose modes are in it
    assert 0.9 * margin.value < proved.value < margin.value
    assert f"{closed_loop(rig_plants['nominal'], rig_controller).n_states} states" in proved.detail


def test_titles_say_how_each_number_was_come_by(over_the_range):
    how = {"margin": "found by search", "proved": "proved at all frequencies"}
    for name, words in how.items():
        assert words in over_the_range[f"robust.stability.{name}"].title
    assert "found by search" in over_the_range["robust.sensitivity.worst"].title
    assert "proved at all frequencies" in over_the_range["robust.sensitivity.bound"].title
    assert "on a frequency grid" in over_the_range["robust.performance"].title


@pytest.mark.parametrize(
    "failure", [NumericalFailure("it overflows"), np.linalg.LinAlgError("singular pencil")]
)
def test_a_proof_that_fails_takes_no_result_with_it(rigid, robust_controller, monkeypatch, failure):
    """What the searches found stays; the proof says why there is none, and the bound falls back on
    a grid and says so.
    """

    def fail(*arguments, **options):
        raise failure

    monkeypatch.setattr(bounds, "proved_level", fail)
    found = robust.check(rigid, robust_controller, SEAL)
    assert found["robust.stability.proved"].value == 0
    assert f"not proved: {failure}" in found["robust.stability.proved"].detail
    assert "on a frequency grid" in found["robust.sensitivity.bound"].title
    assert found["robust.sensitivity.bound"].value >= found["robust.sensitivity.worst"].value > 1
    assert found["robust.stability.margin"].value > 1
    monkeypatch.setattr(bounds, "least_level", fail)
    found = robust.check(rigid, robust_controller, SEAL)
    assert (
        np.isinf(found["robust.sensitivity.bound"].value)
        and "not available" in found["robust.sensitivity.bound"].title
    )


def test_two_parameters(rigid, robust_controller):
    found = robust.check(rigid, robust_controller, PAIR)
    worst, bound = found["robust.sensitivity.worst"].value, found["robust.sensitivity.bound"].value
    peaks = [
        sensitivity_peak(perturbed(rigid, {K: a, PAIR[1].parameter: b}, PAIR), robust_controller)
        for a in (-1, 0, 1)
        for b in (-1, 0, 1)
    ]
    assert worst >= max(peaks) * (1 - 1e-6)
    assert worst <= bound <= 1.1 * worst
    assert found.curve("robust.sensitivity").labels == (
        "nominal",
        "largest of the stable corners",
        "worst case",
    )
    assert not any(check.name.startswith("robust.sensitivity.at") for check in found.checks)


def test_mu_below_one_means_performance_everywhere(rigid, robust_controller):
    """Main loop theorem: with weights relaxed until mu < 1, the weighted norm of every perturbed
    loop is below 1.
    """
    half = (Tolerance(K, relative=0.5),)
    relaxed = replace(WEIGHTS, current_disturbance=0.2, output_disturbance=0.2)
    mu = robust.check(rigid, robust_controller, half, relaxed)["robust.performance"].value
    assert mu < 1
    problem = design_plant(rigid, relaxed, half)
    norms = [
        hinf_norm(closed_by(problem, robust_controller, d)).value
        for d in (-1.0, -0.5, 0.0, 0.5, 1.0)
    ]
    assert max(norms) < 1
    assert max(norms) > 0.3 * mu  # and the bound is not empty
    nominal = hinf_norm(closed_by(problem, robust_controller, 0.0)).value
    assert mu >= nominal * (1 - 1e-3)  # mu with the parameter contains the nominal performance


def closed_by(problem: GeneralizedPlant, controller: StateSpace, delta: float) -> StateSpace:
    w, z = problem.w[problem.n_w_blocks :], problem.z[problem.n_z_blocks :]
    return lft(
        GeneralizedPlant(close_uncertainty(problem, {K: delta}), w, problem.u, z, problem.y),
        controller,
    )


def test_generalized_plant_is_taken_as_it_is():
    controller = hinf_synthesis(published_p5_problem(uncertain=False)).controller
    found = robust.check(published_p5(), controller, weights=published_p5_weights())
    assert found.stable and found["robust.stability.box"].value == 0
    assert found["robust.sensitivity.worst"].limit is None


def test_unstable_nominal_loop_is_a_verdict(rigid):
    found = robust.check(rigid, static_gain(np.zeros((4, 4))), SEAL)
    assert not found.stable and not found.passed
    assert [check.name for check in found.checks] == ["stability.abscissa"]
    assert found.checks[0].value > 0


def test_own_grid_and_progress(rigid, robust_controller):
    told: list[float] = []
    omega = np.geomspace(10, 1e4, 30)
    found = robust.check(
        rigid,
        robust_controller,
        SEAL,
        omega=omega,
        progress=lambda stage, fraction: told.append(fraction),
    )
    np.testing.assert_array_equal(found.curve("robust.sensitivity").x, omega)
    assert told == sorted(told) and told[-1] == 1.0


def test_refusals(rigid, robust_controller):
    with pytest.raises(InvalidInput, match="continuous"):
        robust.check(rigid, c2d(robust_controller, 1e-4, "tustin"), SEAL)
    with pytest.raises(InvalidInput, match="has no tolerance"):
        robust.check(rigid, robust_controller, ())
    with pytest.raises(InvalidInput, match="omega"):
        robust.check(rigid, robust_controller, SEAL, omega=[3.0, 2.0, 1.0])
    with pytest.raises(InvalidInput, match="controller's size"):
        robust.check(rigid, static_gain(np.eye(2)), SEAL)
