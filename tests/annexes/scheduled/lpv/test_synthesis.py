"""LPV synthesis: against H-infinity where the family is one plant, along trajectories, between grid
points, and bad input.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from ambrose.annexes.scheduled.lpv.synthesis import lpv_synthesis
from ambrose.core.checks import InvalidInput, NumericalFailure
from ambrose.core.lft import GeneralizedPlant, lft
from ambrose.core.norms import hinf_norm
from ambrose.core.response import simulate_piecewise
from ambrose.core.sampling import c2d
from ambrose.core.statespace import StateSpace, spectral_abscissa
from ambrose.synthesis.hinf import hinf_synthesis

GRID = np.linspace(1.0, 5.0, 4)


def oscillator(stiffness: float, damping: float = 0.1) -> GeneralizedPlant:
    """m x'' + d x' + k x = u + w1, y = -(x + 0.1 w2), a slow weight on y and 0.2 u in z; unstable
    where k < 0.
    """
    A = np.array([[0.0, 1.0, 0.0], [-stiffness, -damping, 0.0], [-1.0, 0.0, -0.05]])
    B = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 1.0], [0.0, -0.1, 0.0]])
    C = np.array([[0.0, 0.0, 0.3], [0.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
    D = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.2], [0.0, -0.1, 0.0]])
    return GeneralizedPlant(
        StateSpace(A, B, C, D, ["w1", "w2", "u"], ["z1", "z2", "err"]),
        ["w1", "w2"],
        "u",
        ["z1", "z2"],
        "err",
    )


def optimum(plant: GeneralizedPlant) -> float:
    return hinf_synthesis(plant, tolerance=1e-6).certificate.margins["gamma_optimal"]


@pytest.fixture(scope="module")
def designed():
    return lpv_synthesis(oscillator, GRID)


@pytest.mark.parametrize("stiffness", [3.0, -1.0])
def test_a_family_of_one_plant_has_its_hinf_value(stiffness):
    """An independent oracle: the Riccati equations."""
    plant = oscillator(stiffness)
    result = lpv_synthesis([plant] * 3, [0.0, 1.0, 2.0])
    margins = result.certificate.margins
    assert margins["gamma_optimal"] == pytest.approx(optimum(plant), rel=1e-4)
    assert margins["gamma_lower"] <= margins["gamma_optimal"] * (1 + 1e-6)
    for system in result.scheduled.systems:
        np.testing.assert_allclose(system.A, result.scheduled.systems[0].A, rtol=1e-6)


def test_gamma_is_no_smaller_than_at_any_single_point(designed):
    largest = max(optimum(oscillator(k)) for k in GRID)
    margins = designed.certificate.margins
    assert margins["pointwise_largest"] == pytest.approx(largest, rel=2e-3)
    assert margins["gamma_optimal"] >= largest * (1 - 1e-4)
    assert designed.gamma >= margins["gamma_designed"] >= margins["gamma_optimal"]


def test_frozen_norms_are_below_gamma_everywhere_also_off_the_grid(designed):
    for k in np.linspace(GRID[0], GRID[-1], 23):
        loop = lft(oscillator(k), designed.scheduled.at(k))
        assert spectral_abscissa(loop) < 0
        assert hinf_norm(loop).value <= designed.gamma
    assert designed.certificate.stable
    assert len(designed.history) == designed.certificate.margins["checked_points"] == 13


def test_inequality_recomputed_by_hand(designed):
    """A common X from another solver proves the same gamma for the returned controllers: no trust
    in ours is needed.
    """
    clarabel = pytest.importorskip("clarabel")
    from scipy import sparse

    from ambrose.core.hinf_lmi import symmetric_basis
    from ambrose.core.matrix_inequalities import svec

    loops = [lft(oscillator(k), designed.scheduled.at(k)) for k in np.linspace(1, 5, 9)]
    n, g = loops[0].n_states, designed.gamma * 1.001
    basis = symmetric_basis(n)

    def inequality(s: StateSpace, X: np.ndarray, constant: float) -> np.ndarray:
        q, r = s.D.shape[::-1]
        return -np.block(
            [
                [X @ s.A + s.A.T @ X, X @ s.B, constant * s.C.T],
                [s.B.T @ X, -constant * g * np.eye(q), constant * s.D.T],
                [constant * s.C, constant * s.D, -constant * g * np.eye(r)],
            ]
        )

    rows = [np.array([svec(inequality(s, E, 0.0)) for E in basis]).T for s in loops] + [
        np.array([svec(E) for E in basis]).T
    ]
    constants = [svec(inequality(s, np.zeros((n, n)), 1.0)) for s in loops] + [
        -1e-6 * svec(np.eye(n))
    ]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    cones = [clarabel.PSDTriangleConeT(n + 4)] * len(loops) + [clarabel.PSDTriangleConeT(n)]
    empty = sparse.csc_matrix((len(basis), len(basis)))
    matrix = sparse.csc_matrix(-np.vstack(rows))
    solution = clarabel.DefaultSolver(
        empty, np.zeros(len(basis)), matrix, np.concatenate(constants), cones, settings
    ).solve()
    assert str(solution.status) in ("Solved", "AlmostSolved")


def gain_along(result, stiffness: np.ndarray, dt: float, seed: int) -> float:
    """|z|/|w| for random w while the stiffness (k,) jumps from one value to the next after every
    five samples.
    """
    rng = np.random.default_rng(seed)
    systems = [c2d(lft(oscillator(k), result.scheduled.at(k)), dt) for k in stiffness]
    w = rng.standard_normal((2, 5 * len(stiffness)))
    w[:, len(stiffness) :] = 0.0
    z = simulate_piecewise(systems, [w[:, 5 * i : 5 * i + 5] for i in range(len(systems))])
    return float(np.linalg.norm(z) / np.linalg.norm(w))


@pytest.mark.parametrize("seed", range(4))
def test_gain_along_fast_trajectories_is_below_gamma(designed, seed):
    stiffness = GRID[0] + (GRID[-1] - GRID[0]) * np.random.default_rng(seed).random(120)
    assert gain_along(designed, stiffness, 0.02, seed) < designed.gamma


def test_survives_the_switching_that_destroys_controllers_designed_point_by_point():
    """A spring that is switched in step with the motion pumps energy into every frozen loop, but
    not past a common X.
    """
    values = np.array([-3.0, 9.0])
    common = lpv_synthesis([oscillator(k, 0.0) for k in values], values)
    assert common.gamma < np.inf

    def growth(loops: list[StateSpace]) -> float:
        """The largest spectral radius over one period, over a search of switching times."""
        from scipy.linalg import expm

        steps = np.linspace(0.05, 2.0, 24)
        parts = [[expm(loop.A * t) for t in steps] for loop in loops]
        return max(
            float(np.abs(np.linalg.eigvals(a @ b)).max()) for a in parts[0] for b in parts[1]
        )

    assert growth([lft(oscillator(k, 0.0), common.scheduled.at(k)) for k in values]) < 1
    no_control = [
        lft(oscillator(k, 0.0), StateSpace([[-1.0]], [[0.0]], [[0.0]], [[0.0]])) for k in (1.0, 9.0)
    ]
    assert growth(no_control) > 1


def test_a_bounded_rate_lowers_gamma_towards_the_pointwise_value():
    values = np.linspace(-2.0, 6.0, 4)
    margins = [
        lpv_synthesis(
            oscillator, values, rate=rate, degree=degree, points_between=1
        ).certificate.margins
        for rate, degree in ((None, 1), (10.0, 1), (0.01, 1), (0.01, 2))
    ]
    gammas = [m["gamma_optimal"] for m in margins]
    assert all(b <= a * (1 + 1e-4) for a, b in pairwise(gammas))
    assert gammas[-1] >= margins[0]["pointwise_largest"] * (1 - 2e-3)
    assert gammas[-1] < 0.98 * gammas[0]


@pytest.mark.parametrize("varying", ["R", "S"])
def test_rate_bounded_controller_keeps_its_gain_while_the_parameter_moves_at_that_rate(varying):
    result = lpv_synthesis(oscillator, GRID, rate=2.0, varying=varying)
    dt, k = 0.02, 150
    # a triangle at 2 per second
    stiffness = 3 + 2 * np.abs((np.arange(k) * 5 * dt * 2.0 / 2 % 4) - 2) - 2
    assert np.abs(np.diff(stiffness)).max() <= 2.0 * 5 * dt * (1 + 1e-9)
    for seed in range(3):
        assert gain_along(result, stiffness, dt, seed) < result.gamma


def test_interpolated_controller_changes_smoothly(designed):
    """A common state basis: halving the grid step moves the controller in between little."""
    fine = lpv_synthesis(oscillator, np.linspace(1.0, 5.0, 7))
    omega = np.array([0.1, 1.0, 3.0])
    for k in (1.7, 3.2, 4.6):
        a, b = (_response(result.scheduled.at(k), omega) for result in (designed, fine))
        assert np.abs(a - b).max() < 0.05 * np.abs(b).max()


def _response(system: StateSpace, omega: np.ndarray) -> np.ndarray:
    eye = np.eye(system.n_states)
    return np.array(
        [
            (system.C @ np.linalg.solve(1j * w * eye - system.A, system.B) + system.D)[0, 0]
            for w in omega
        ]
    )


def test_a_plant_that_bends_between_grid_points_gets_more_of_them():
    """Two grid points see a spring of 1 at both ends, and nothing of the negative one in the
    middle.
    """
    said: list[str] = []
    result = lpv_synthesis(
        lambda p: oscillator(1 - 4 * p * (1 - p)), [0.0, 1.0], progress=said.append
    )
    assert result.certificate.margins["grid_points"] > 2
    assert any("added to the grid" in text for text in said)
    for p in np.linspace(0, 1, 9):
        assert spectral_abscissa(lft(oscillator(1 - 4 * p * (1 - p)), result.scheduled.at(p))) < 0


def test_what_is_guaranteed_is_said(designed):
    assert "however fast it changes" in designed.notes[0]
    assert "linear in the parameter between grid points" in designed.notes[1]
    assert designed.method == "lpv"
    assert designed.controller.inputs == ("err",)
    assert designed.controller.outputs == ("u",)


def test_direct_terms_everywhere_and_d22():
    """General D11 and D22: the controller is still verified on the plant as given."""
    rng = np.random.default_rng(3)
    A = rng.standard_normal((4, 4)) - 1.5 * np.eye(4)
    B, C, D = (
        rng.standard_normal((4, 4)),
        rng.standard_normal((4, 4)),
        0.3 * rng.standard_normal((4, 4)),
    )
    D[2:, :2] += np.eye(2)
    D[:2, 2:] += np.eye(2)
    change = 0.3 * rng.standard_normal((4, 4))

    def plant(p: float) -> GeneralizedPlant:
        s = StateSpace(A + p * change, B, C, D)
        return GeneralizedPlant(s, s.inputs[:2], s.inputs[2:], s.outputs[:2], s.outputs[2:])

    result = lpv_synthesis(plant, [-1.0, 0.0, 1.0])
    assert result.certificate.margins["gamma_optimal"] >= max(
        optimum(plant(p)) for p in (-1, 0, 1)
    ) * (1 - 1e-4)
    for p in (-1, -0.3, 0.6, 1):
        assert hinf_norm(lft(plant(p), result.scheduled.at(p))).value <= result.gamma


def test_plant_without_noise_or_control_cost_is_regularised():
    def plant(p: float) -> GeneralizedPlant:
        s = oscillator(p).system
        D = s.D.copy()
        D[2, 1] = 0.0
        bare = StateSpace(s.A, s.B, s.C, D, s.inputs, s.outputs)
        return GeneralizedPlant(bare, ["w1", "w2"], "u", ["z1", "z2"], "err")

    result = lpv_synthesis(plant, [1.0, 3.0])
    assert "D21 has not full row rank" in result.notes[0]
    assert result.certificate.closed_loop_norm <= result.gamma


def spring_and_damper(point: tuple[float, float]) -> GeneralizedPlant:
    return oscillator(*point)


RECTANGLE = (np.linspace(1.0, 5.0, 3), np.linspace(0.1, 2.0, 3))
TWO = {"parameter": "k and d", "unit": "N/m and Ns/m"}


@pytest.fixture(scope="module")
def rectangle():
    return lpv_synthesis(spring_and_damper, RECTANGLE, **TWO)


def test_a_second_parameter_that_changes_nothing_changes_nothing(designed):
    """The rectangle of one parameter and an idle one is the line."""
    idle = lpv_synthesis(lambda p: oscillator(p[0]), (GRID, np.array([0.0, 1.0])), **TWO)
    for name in ("gamma_optimal", "pointwise_largest"):
        assert idle.certificate.margins[name] == pytest.approx(
            designed.certificate.margins[name], rel=2e-4
        )


def test_a_rectangle_costs_no_less_than_its_edges_and_holds_between(rectangle):
    margins = rectangle.certificate.margins
    edges = [
        lpv_synthesis(lambda k, d=d: oscillator(k, d), RECTANGLE[0]).certificate.margins
        for d in RECTANGLE[1][[0, -1]]
    ]
    assert margins["gamma_optimal"] >= max(edge["gamma_optimal"] for edge in edges) * (1 - 1e-4)
    for point in np.random.default_rng(2).uniform([1.0, 0.1], [5.0, 2.0], (25, 2)):
        loop = lft(oscillator(*point), rectangle.scheduled.at(point))
        assert spectral_abscissa(loop) < 0
        assert hinf_norm(loop).value <= rectangle.gamma
    assert "linear in each parameter" in rectangle.notes[1]


@pytest.mark.parametrize(
    "rate",
    [
        None,
        *(pytest.param(r, marks=pytest.mark.study) for r in ((1.0, None), (None, 0.5))),
        (1.0, 0.5),
    ],
)
def test_gain_while_two_parameters_move_is_below_gamma(rectangle, rate):
    """Random motions as fast as was allowed: jumps where no rate was given, steps at the largest
    rate where one was.
    """
    result = (
        rectangle
        if rate is None
        else lpv_synthesis(spring_and_damper, RECTANGLE, rate=rate, points_between=1, **TWO)
    )
    dt, steps = 0.02, 120
    for seed in range(3):
        rng = np.random.default_rng(seed)
        paths = []
        for axis, fastest in zip(RECTANGLE, rate or (None, None), strict=True):
            path = rng.uniform(axis[0], axis[-1], steps)
            if fastest is not None:
                for i in range(1, steps):
                    path[i] = np.clip(
                        path[i], path[i - 1] - 5 * dt * fastest, path[i - 1] + 5 * dt * fastest
                    )
            paths.append(path)
        systems = [
            c2d(lft(oscillator(*p), result.scheduled.at(p)), dt) for p in zip(*paths, strict=True)
        ]
        w = rng.standard_normal((2, 5 * steps))
        w[:, steps:] = 0.0
        z = simulate_piecewise(systems, [w[:, 5 * i : 5 * i + 5] for i in range(steps)])
        assert np.linalg.norm(z) / np.linalg.norm(w) < result.gamma
    if rate is not None:
        assert (
            result.certificate.margins["gamma_optimal"]
            < rectangle.certificate.margins["gamma_optimal"]
        )


class TestBadInput:
    def test_rates_of_a_rectangle(self):
        with pytest.raises(InvalidInput, match=r"number of rates is 3, but must be 2"):
            lpv_synthesis(spring_and_damper, RECTANGLE, rate=(1.0, 1.0, 1.0), **TWO)

    def test_plants_of_a_rectangle(self):
        with pytest.raises(InvalidInput, match=r"number of plants is 3, but must be 9"):
            lpv_synthesis([oscillator(1.0)] * 3, RECTANGLE, **TWO)

    def test_one_point(self):
        with pytest.raises(InvalidInput, match=r"at least 2; one point needs no scheduling"):
            lpv_synthesis(oscillator, [1.0])

    def test_unsorted(self):
        with pytest.raises(InvalidInput, match="ascending"):
            lpv_synthesis(oscillator, [1.0, 3.0, 2.0])

    def test_number_of_plants(self):
        with pytest.raises(InvalidInput, match=r"number of plants is 1, but must be 2"):
            lpv_synthesis([oscillator(1.0)], [1.0, 2.0])

    def test_orders_differ(self):
        larger = oscillator(1.0).system
        A = np.block([[larger.A, np.zeros((3, 1))], [np.zeros((1, 3)), -np.ones((1, 1))]])
        other = StateSpace(
            A,
            np.vstack([larger.B, np.zeros((1, 3))]),
            np.hstack([larger.C, np.zeros((3, 1))]),
            larger.D,
            larger.inputs,
            larger.outputs,
        )
        plants = [oscillator(1.0), GeneralizedPlant(other, ["w1", "w2"], "u", ["z1", "z2"], "err")]
        with pytest.raises(InvalidInput, match=r"n_states of .* is 4, but must be that of .* 1, 3"):
            lpv_synthesis(plants, [1.0, 2.0])

    def test_roles_differ(self):
        s = oscillator(1.0).system
        plants = [oscillator(1.0), GeneralizedPlant(s, ["w2", "w1"], "u", ["z1", "z2"], "err")]
        with pytest.raises(InvalidInput, match="must be"):
            lpv_synthesis(plants, [1.0, 2.0])

    @pytest.mark.parametrize(
        "arguments",
        [
            {"backoff": 1.0},
            {"backoff": 3.0},
            {"rate": -1.0},
            {"varying": "X"},
            {"degree": 0},
            {"nominal": 9.0},
        ],
    )
    def test_arguments(self, arguments):
        with pytest.raises(InvalidInput):
            lpv_synthesis(oscillator, [1.0, 2.0], **arguments)

    def test_a_point_that_no_controller_stabilises_is_named(self):
        def plant(p: float) -> GeneralizedPlant:
            s = oscillator(-1.0).system
            B = s.B.copy()
            B[1, 2] = p  # no actuator at p = 0
            return GeneralizedPlant(
                StateSpace(s.A, B, s.C, s.D, s.inputs, s.outputs),
                ["w1", "w2"],
                "u",
                ["z1", "z2"],
                "err",
            )

        with pytest.raises((InvalidInput, NumericalFailure), match=r"grid point 0"):
            lpv_synthesis(plant, [0.0, 1.0, 2.0])

    def test_no_common_solution_is_explained(self):
        """An actuator whose sign changes: each side can be controlled, but no function is common to
        both.
        """

        def plant(p: float) -> GeneralizedPlant:
            s = oscillator(-1.0).system
            B = s.B.copy()
            B[1, 2] = p
            return GeneralizedPlant(
                StateSpace(s.A, B, s.C, s.D, s.inputs, s.outputs),
                ["w1", "w2"],
                "u",
                ["z1", "z2"],
                "err",
            )

        with pytest.raises(NumericalFailure, match=r"narrow the range|no controller|grid"):
            lpv_synthesis([plant(-1.0), plant(1.0)], [-1.0, 1.0])

    def test_time_limit(self):
        with pytest.raises(NumericalFailure, match=r"time_limit"):
            lpv_synthesis(oscillator, GRID, time_limit=1e-9)
