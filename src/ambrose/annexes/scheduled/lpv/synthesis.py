"""Gridded LPV synthesis: one controller whose matrices follow measured parameters, such as the
speed.

A quadratic Lyapunov function common to all values of the parameter bounds the gain from w to z by
gamma however the parameter moves; with a bound on its rate the function may depend on it, and gamma
falls. Sources: Apkarian & Adams 1998, IEEE Trans. Control Systems Technology 6; Wu, Yang, Packard &
Becker 1996, Int. J. Robust Nonlinear Control 6.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from ambrose.annexes.scheduled.lpv.family import (
    Family,
    Lyapunov,
    Shape,
    Varying,
    best_level,
    named,
    scaled_family,
    smallest_gamma,
    well_conditioned,
)
from ambrose.core.checks import (
    AmbroseError,
    NumericalFailure,
    check_positive,
    invalid,
    named_failure,
)
from ambrose.core.hinf_lmi import lower_bound
from ambrose.core.hinf_riccati import (
    Matrices,
    ScaledPlant,
    check_plant,
    normal_form,
    original_matrices,
    scale_plant,
    unavoidable,
)
from ambrose.core.lft import GeneralizedPlant, lft
from ambrose.core.scheduled import AND, ScheduledSystem, check_axes, grid_points, interval_points
from ambrose.core.statespace import StateSpace, balance_system
from ambrose.judge.result import Certificate, Status, Synthesis, generalized_certificate

# The controller at one point of the parameters from R and S there: explicit, thus as smooth in the
# parameter as they are.
#
# With N M^T = I - S R the controller's states are common to all values, and no rate of the
# parameter enters, when M does not depend on it (R constant) or N does not (S constant): the terms
# S R' + N M'^T cancel. Sources: Gahinet 1996, Automatica 32 (explicit formulas); Apkarian & Adams
# 1998, IEEE Trans. Control Systems Technology 6, sec. III ("practically valid" choices).


@dataclass(frozen=True, slots=True, eq=False)
class Factors:
    """M (n, n) for a constant R, or N for a constant S; the other one follows from N M^T = I - S
    R.
    """

    lyapunov: Lyapunov
    varying: Varying
    fixed: np.ndarray

    def at(self, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """N and M (n, n) at the relative parameters (d,)."""
        R, S = self.lyapunov.at(p)
        E = np.eye(len(R)) - S @ R
        if self.varying == "R":
            return self.fixed, np.linalg.solve(self.fixed, E).T
        return np.linalg.solve(self.fixed, E.T).T, self.fixed

    def certificate(self, p: np.ndarray) -> np.ndarray:
        """The closed loop's Lyapunov matrix X (2n, 2n) in the states (plant, controller)."""
        # X [R I; M^T 0] = [I S; 0 N^T] gives X = [S N; N^T -N^T R M^-T], symmetric up to rounding.
        R, S = self.lyapunov.at(p)
        N, M = self.at(p)
        lower = -np.linalg.solve(M, (R @ N)).T  # -N^T R M^-T
        return np.block([[S, N], [N.T, (lower + lower.T) / 2]])

    def certificate_moved(self, p: np.ndarray, rates: np.ndarray) -> np.ndarray:
        """dX/dt (2n, 2n) while the parameters move at ``rates`` (d,), exact."""
        dR, dS = self.lyapunov.moved(p, rates)
        R, S = self.lyapunov.at(p)
        N, M = self.at(p)

        # E = I - S R = N M^T:   E' = -(S' R + S R') = N' M^T + N M'^T, one of N' and M' being zero
        dE = -(dS @ R + S @ dR)
        zero = np.zeros_like(dE)
        dN, dM = (
            (zero, np.linalg.solve(N, dE).T)
            if self.varying == "R"
            else (np.linalg.solve(M, dE.T).T, zero)
        )

        # (-N^T R M^-T)' = -(N^T R' + N'^T R) M^-T - lower M'^T M^-T
        lower = -np.linalg.solve(M, R @ N).T
        slope = -np.linalg.solve(M, dR @ N + R @ dN).T - np.linalg.solve(M, dM @ lower.T).T
        return np.block([[dS, dN], [dN.T, (slope + slope.T) / 2]])


def factors(lyapunov: Lyapunov, varying: Varying) -> Factors:
    """N and M share the singular values evenly at mid-range. Raises NumericalFailure when I - S R
    is singular there.
    """
    R, S = lyapunov.at(np.zeros(len(lyapunov.shape.largest)))

    # I - S R = U s V^T:   N = U s^1/2, M = V s^1/2
    U, s, Vt = np.linalg.svd(np.eye(len(R)) - S @ R)
    if len(s) and not s[-1] > 1e-12 * s[0]:
        raise NumericalFailure(
            "R S is I in some direction: the controller would need infinitely fast poles"
        )
    return Factors(lyapunov, varying, U * np.sqrt(s) if varying == "R" else Vt.T * np.sqrt(s))


def controller(plant: ScaledPlant, point: Factors, p: np.ndarray) -> Matrices:
    """(A, B, C, D) at gamma = 1 for a scaled plant at the relative parameters p (d,). Raises
    NumericalFailure.

    With D first put into the plant (A + B2 D C2 for A, and so on) and hats for what the
    inequalities determine,

        A_k = N^-1 (A_hat - S A R - B_hat C2 R - S B2 C_hat) M^-T,    B_k = N^-1 B_hat,
        C_k = C_hat M^-T,

    where B_hat and C_hat solve the two bordered systems of linear equations and A_hat makes the
    off-diagonal block vanish (Apkarian & Adams 1998, whose X and Y are S and R here; Gahinet 1996).
    """
    R, S = point.lyapunov.at(p)
    N, M = point.at(p)

    # D first: A + B2 D C2, B1 + B2 D D21, C1 + D12 D C2, D11 + D12 D D21; what is left has no D.
    D = _direct(plant)
    A, B1 = plant.A + plant.B2 @ D @ plant.C2, plant.B1 + plant.B2 @ D @ plant.D21
    C1, D11 = plant.C1 + plant.D12 @ D @ plant.C2, plant.D11 + plant.D12 @ D @ plant.D21
    r, q = D11.shape

    # B_hat from [0 [D21 0]; [D21 0]^T -inner] [B_hat^T; *] = -[C2; B1^T S; C1]
    inner = np.block([[np.eye(q), -D11.T], [-D11, np.eye(r)]])
    B_hat = _bordered(plant.D21, inner, plant.C2, np.vstack([B1.T @ S, C1])).T

    # C_hat the same way from [0 [D12^T 0]; [D12^T 0]^T -flipped] [C_hat; *] = -[B2^T; C1 R; B1^T]
    flipped = np.block([[np.eye(r), -D11], [-D11.T, np.eye(q)]])
    C_hat = _bordered(plant.D12.T, flipped, plant.B2.T, np.vstack([C1 @ R, B1.T]))

    # A_hat = -A^T - [S B1 + B_hat D21, C1^T] inner^-1 [B1^T; C1 R + D12 C_hat]
    left = np.hstack([S @ B1 + B_hat @ plant.D21, C1.T])
    right = np.vstack([B1.T, C1 @ R + plant.D12 @ C_hat])
    A_hat = -A.T - left @ np.linalg.solve(inner, right)

    # back from the hats: A_k = N^-1 (..) M^-T, B_k = N^-1 B_hat, C_k = C_hat M^-T
    A_k = A_hat - S @ A @ R - B_hat @ plant.C2 @ R - S @ plant.B2 @ C_hat
    return (
        np.linalg.solve(N, np.linalg.solve(M, A_k.T).T),
        np.linalg.solve(N, B_hat),
        np.linalg.solve(M, C_hat.T).T,
        D,
    )


def _direct(plant: ScaledPlant) -> np.ndarray:
    """D with |D11 + D12 D D21| < 1: the central one of Parrott's theorem. Raises
    NumericalFailure.
    """
    # D11 in blocks [D_11 D_12; D_21 D_22], the last rows reached by u, the last columns seen by y.
    normal, T_u, T_y = normal_form(plant)
    k, j = len(plant.C1) - plant.B2.shape[1], plant.B1.shape[1] - len(plant.C2)
    D = normal.D11

    # No D changes the first rows or the first columns.
    for part in (D[:k], D[:, :j]):
        if part.size and np.linalg.norm(part, 2) >= 1:
            raise NumericalFailure(
                "gamma is below the plant's gain at infinite frequency; increase the back-off"
            )

    # -D_21 D_11^T (I - D_11 D_11^T)^-1 D_12 - D_22, then out of the normal form's u and y
    core = np.eye(k) - D[:k, :j] @ D[:k, :j].T
    central = -D[k:, :j] @ D[:k, :j].T @ np.linalg.solve(core, D[:k, j:]) - D[k:, j:]
    return T_u @ central @ T_y


def _bordered(
    corner: np.ndarray, inner: np.ndarray, first: np.ndarray, rest: np.ndarray
) -> np.ndarray:
    """X (p, n) of [0 [corner 0]; [corner 0]^T -inner] [X; *] = -[first; rest], corner (p, q)."""
    p, k = len(corner), len(inner)

    # second row: * = inner^-1 (edge^T X + rest);   first row:
    # edge inner^-1 edge^T X = -(first + edge inner^-1 rest)
    edge = np.hstack([corner, np.zeros((p, k - corner.shape[1]))])
    weighted = np.linalg.solve(inner, np.hstack([edge.T, rest]))
    return -np.linalg.solve(edge @ weighted[:, :p], first + edge @ weighted[:, p:])


# What is recomputed for a scheduled controller on the original plants before it is returned.
#
# At every grid point and at frozen points between: stability and H-infinity norm of the closed
# loop; and the inequality that holds along every trajectory of the parameter, with the Lyapunov
# matrix X(p) that the synthesis found (bounded real lemma),
#
#   [A^T X + X A + X'   X B      C^T   ]
#   [B^T X             -gamma I  D^T   ]  < 0     with A, B, C, D of the closed loop as it will run.
#   [C                  D       -gamma I]
#
# Where the plant and the controller are linear in the parameter (in each of several) between
# neighbouring points, B2, C2, D12, D21 constant and X constant, it holds in between when it holds
# at these points, for it is affine in A, B, C and D, which are the same mean of theirs; a plant
# that bends between its grid points is checked at the points in between.


_RAISED = 1.5  # how far above the designed gamma a guarantee between grid points is looked for
_STEPS = 20  # halvings of the interval, at most


@dataclass(frozen=True, slots=True)
class Frozen:
    """The closed loop held at one point of the parameters.

    guaranteed: smallest gamma, at least the designed one, for which the inequality holds there; inf
    where none does. slack: largest eigenvalue of the inequality at the designed gamma, with X = I
    and time in the family's units (negative: it holds).
    """

    value: Any
    on_grid: bool
    stable: bool
    spectral_abscissa: float
    norm: float
    fastest_pole: float
    slack: float
    guaranteed: float

    def row(self) -> dict[str, float]:
        """For the history of a Synthesis."""
        names = ("spectral_abscissa", "norm", "fastest_pole", "slack", "guaranteed")
        where = {"parameter": self.value}
        if isinstance(self.value, tuple):
            where = {f"parameter_{i}": part for i, part in enumerate(self.value, start=1)}
        return {
            **where,
            "on_grid": float(self.on_grid),
            **{name: getattr(self, name) for name in names},
        }


def frozen(
    plant_at: Callable[[Any], GeneralizedPlant],
    controller: ScheduledSystem,
    family: Family,
    point: Factors,
    values: Sequence[Any],
    relative_rates: Sequence[np.ndarray],
) -> tuple[Frozen, ...]:
    """The closed loop at every one of the points ``values``; the family's unit is the designed
    gamma.
    """
    result = []
    for value in values:
        plant, K = plant_at(value), controller.at(value)
        certificate = generalized_certificate(plant, K)
        p = family.to_relative(value)
        slacks = [_BoundedReal(lft(plant, K), family, point, p, rates) for rates in relative_rates]
        worst = max(slacks, key=lambda item: item.largest(1.0))
        result.append(
            Frozen(
                value,
                family.on_grid(value),
                certificate.stable,
                certificate.spectral_abscissa,
                certificate.closed_loop_norm,
                certificate.fastest_pole,
                worst.largest(1.0),
                worst.smallest() * family.unit,
            )
        )
    return tuple(result)


class _BoundedReal:
    """The inequality at one point, in states in which X is I, gamma in units of the designed
    one.
    """

    def __init__(
        self, loop: StateSpace, family: Family, point: Factors, p: np.ndarray, rates: np.ndarray
    ) -> None:
        n = family.n
        X = point.certificate(p)
        try:
            L = np.linalg.cholesky(X)
        except np.linalg.LinAlgError as error:
            raise NumericalFailure(
                f"the Lyapunov matrix is not positive definite at the relative parameter {named(p)}"
            ) from error

        # States (plant, controller): x = T x_s for the plant's, the controller's are those of X.
        T, inverse = np.eye(2 * n), np.eye(2 * n)
        T[:n, :n], inverse[:n, :n] = family.T, family.inverse

        # x = T L^-T x' makes X = I
        to_whole, back = np.linalg.solve(L, T.T).T, L.T @ inverse  # X = L L^T

        # time t rate, and w and z in which the designed gamma is 1
        A = back @ loop.A @ to_whole / family.rate
        B = back @ loop.B / np.sqrt(family.rate * family.unit)
        C = loop.C @ to_whole / np.sqrt(family.rate * family.unit)

        # A^T X + X A + X' becomes A^T + A + L^-1 X' L^-T
        moved = np.linalg.solve(L, np.linalg.solve(L, point.certificate_moved(p, rates)).T)
        q, r = B.shape[1], len(C)
        D = loop.D / family.unit

        # gamma is still missing: zeros in its two blocks
        self.n = 2 * n
        self.matrix = np.block(
            [[A + A.T + moved, B, C.T], [B.T, np.zeros((q, q)), D.T], [C, D, np.zeros((r, r))]]
        )

    def largest(self, gamma: float) -> float:
        """The largest eigenvalue at a relative gamma."""
        matrix = self.matrix.copy()
        diagonal = np.arange(self.n, len(matrix))
        matrix[diagonal, diagonal] = -gamma
        return float(np.linalg.eigvalsh(matrix)[-1])

    def smallest(self) -> float:
        """The smallest relative gamma from 1 to _RAISED, where the inequality holds; inf when there
        is none.
        """
        if self.largest(1.0) < 0:
            return 1.0
        low, high = 1.0, _RAISED
        if self.largest(high) >= 0:
            return np.inf
        for _ in range(_STEPS):
            middle = (low + high) / 2
            low, high = (low, middle) if self.largest(middle) < 0 else (middle, high)
        return high


def between(
    plants: Sequence[GeneralizedPlant], axes: tuple[np.ndarray, ...], parameter: str, unit: str
) -> Callable[[Any], GeneralizedPlant]:
    """The plants with matrices linear between the grid points, for want of others."""
    schedule = ScheduledSystem(axes, [plant.system for plant in plants], parameter, unit)
    first = plants[0]
    return lambda value: GeneralizedPlant(
        schedule.at(value), first.w, first.u, first.z, first.y, first.blocks
    )


# the back-off less 1 is doubled up to this before giving up; assumed: a gamma half above the
# smallest says little of what the plants allow
_WIDEST = 0.5
# how often the grid is refined where the guarantee fails between its points; assumed: every round
# solves all inequalities again
_REFINED = 2
# gamma guaranteed between grid points over the designed one, above which the grid is refined;
# assumed: less than the default back-off of 5 % costs
_HOLDS = 1.02
_NORM_ERROR = 1e-6  # relative, of the computed H-infinity norm of a frozen loop
_KEPT = 1e-9  # relative change of B2, C2, D12, D21 over the grid that counts as none
PlantAt = Callable[[Any], GeneralizedPlant]


@named_failure("the scheduled controller")
def lpv_synthesis(
    plants: Sequence[GeneralizedPlant] | PlantAt,
    grid: ArrayLike | Sequence[ArrayLike],
    *,
    rate: float | Sequence[float | None] | None = None,
    varying: Literal["R", "S"] = "R",
    degree: int = 1,
    backoff: float = 1.05,
    points_between: int = 3,
    nominal: float | tuple[float, ...] | None = None,
    parameter: str = "speed",
    unit: str = "rad/s",
    time_limit: float = 300.0,
    progress: Callable[[str], None] | None = None,
) -> Synthesis:
    """A controller scheduled over the ``grid`` (k,) of a parameter, verified on the plants and
    between them.

    Of several parameters, ``parameter`` "a and b", the grid has an array for each, a point is a
    tuple, plants count with the last parameter first, ``rate`` has an entry for each, and the
    Lyapunov function follows those whose rate is bounded. plants: a function from the parameter to
    its generalized plant (then the plant between grid points is checked as it is), or one plant per
    grid point (then it is taken as linear in between); all with the same signals, in states that
    mean the same everywhere. rate [unit of the parameter per s]: the fastest it changes, either
    way; None: arbitrarily fast, with R and S constant. With a rate, ``varying`` R (or S) is a
    polynomial of ``degree`` in the parameter and the other constant, so that the controller needs
    the parameter but not its rate. backoff [-] > 1: how far above the smallest gamma to stay, which
    keeps the poles slow. points_between: frozen points that are verified in every interval.
    nominal: the value whose frozen controller is the result's ``controller`` (None: the middle of
    the grid); ``scheduled`` is the whole one. time_limit [s]: of each call of the solver.

    ``gamma`` bounds the gain from w to z along every trajectory within the range (and rate), as
    verified at all these points. certificate.margins: gamma_optimal of the inequalities,
    gamma_lower (that no controller comes below at one of the grid points alone), gamma_designed,
    pointwise_largest (of the grid points' own optimal H-infinity
    values), guaranteed_between (the largest gamma needed at a point between). history: a row for
    each verified value. Raises InvalidInput and NumericalFailure; nothing unverified is returned.
    """
    axes = check_axes(grid, parameter)
    rates: tuple[Any, ...] = tuple(rate) if isinstance(rate, list | tuple) else (rate,) * len(axes)
    if not 1 < check_positive(backoff, "backoff", "1.05 to 1.1 suits most uses") < 1 + _WIDEST:
        raise invalid(
            "backoff", backoff, f"above 1 and below {1 + _WIDEST:g}", "1.05 to 1.1 suits most uses"
        )
    if len(rates) != len(axes):
        raise invalid(
            "the number of rates",
            len(rates),
            f"{len(axes)}, for {parameter}",
            "give one for each, None for any",
        )
    for item in rates:
        if item is not None:
            check_positive(
                item,
                "rate",
                f"give the fastest change in {unit}/s, or None for arbitrarily fast changes",
            )
    if varying not in ("R", "S") or not isinstance(degree, int) or not 1 <= degree <= 4:
        raise invalid(
            "varying, degree", f"{varying!r}, {degree}", '"R" or "S" and 1 to 4', "leave them out"
        )
    if not callable(plants) and not isinstance(plants, list | tuple):
        raise invalid(
            "plants",
            type(plants).__name__,
            "a list, or a function of the parameter",
            "give one for each grid point",
        )
    if not callable(plants) and len(plants) != len(grid_points(axes)):
        count = f"{len(grid_points(axes))}, one per grid point"
        raise invalid("the number of plants", len(plants), count, "give one for each")
    plant_at = (
        plants
        if callable(plants)
        else between([check_plant(plant) for plant in plants], axes, parameter, unit)
    )
    job = _Job(
        plant_at,
        rates,
        varying if set(rates) != {None} else "none",
        degree,
        backoff,
        points_between,
        parameter,
        unit,
        check_positive(time_limit, "time_limit", "give seconds"),
        progress or (lambda _: None),
    )
    for _ in range(_REFINED + 1):
        design = _design(job, axes)
        weak = [f.value for f in design.found if not f.guaranteed <= _HOLDS * design.family.unit]
        if not weak or not callable(plants):
            break
        job.say(
            f"the guarantee is weak at {'; '.join(named(v) for v in weak)} {unit}: added to the "
            "grid"
        )
        axes = _with(axes, weak)
    return _result(job, design, nominal)


def _with(axes: tuple[np.ndarray, ...], points: Sequence[Any]) -> tuple[np.ndarray, ...]:
    """The axes with the values of further points."""
    added = zip(axes, np.array([np.atleast_1d(point) for point in points]).T, strict=True)
    return tuple(np.unique(np.append(axis, more)) for axis, more in added)


@dataclass(frozen=True, slots=True, eq=False)
class _Job:
    plant_at: PlantAt
    rates: tuple[float | None, ...]
    varying: Varying
    degree: int
    backoff: float
    points_between: int
    parameter: str
    unit: str
    time_limit: float
    say: Callable[[str], None]

    def shape(self, family: Family) -> Shape:
        return Shape(self.varying, self.degree, family.relative_rates(self.rates))


@dataclass(frozen=True, slots=True, eq=False)
class _Design:
    """family: in units of the designed gamma; optimal: of the inequalities; lower: of any scheduled
    controller; pointwise (k,): the grid points' own optima.
    """

    scheduled: ScheduledSystem
    family: Family
    found: tuple[Frozen, ...]
    optimal: float
    lower: float
    pointwise: np.ndarray
    backoff: float
    notes: tuple[str, ...]


def _design(job: _Job, axes: tuple[np.ndarray, ...]) -> _Design:
    """Both passes on one grid, at growing back-offs until the controller passes its verification at
    the grid points.
    """
    values = grid_points(axes)
    plants = [check_plant(job.plant_at(value)) for value in values]
    family = scaled_family(plants, axes)
    pointwise = np.array(
        [_optimum(plant, family, value) for plant, value in zip(family.plants, values, strict=True)]
    )
    # a parameter that rests at a grid point is one of the motions; regularised plants bound nothing
    alone = [
        unavoidable(scale_plant(plant)) if family.notes else family.unit * lower_bound(own)
        for plant, own in zip(plants, family.plants, strict=True)
    ]
    job.say(
        f"{len(values)} points, {family.n} states; the largest pointwise H-infinity value is "
        f"{pointwise.max():.6g}"
    )
    shape = job.shape(family)
    begun = time.monotonic()
    reached, active = smallest_gamma(family, shape, job.time_limit)
    optimal = reached[0] * family.unit
    job.say(f"smallest gamma {optimal:.6g} ({time.monotonic() - begun:.1f} s)")
    notes = family.notes
    if active:
        notes += (
            f"gamma_optimal {optimal:.4g} is not the smallest of the inequalities: R or S is at "
            f"its bound {active:g}. Bring the poles of plant and weights closer together",
        )
    reasons = []
    for smallest in reached:
        try:
            scheduled, chosen, at_points, backoff = _near(job, family, shape, smallest)
        except NumericalFailure as failure:
            reasons.append(str(failure))
            continue
        if reasons:
            notes += (
                f"designed for gamma {chosen.unit:.4g}, the smallest {optimal:.4g} needs larger R "
                "and S than a controller can be computed from. Bring the poles of plant and "
                "weights closer together",
            )
        return _Design(scheduled, chosen, at_points, optimal, max(alone), pointwise, backoff, notes)
    raise NumericalFailure(
        f"no scheduled controller passed its verification ({reasons[0]}); narrow the range, take "
        "more grid points, or give a rate"
    )


def _near(
    job: _Job, family: Family, shape: Shape, smallest: float
) -> tuple[ScheduledSystem, Family, tuple[Frozen, ...], float]:
    """Schedule, family in units of its gamma, what was found of it, and its back-off. Raises
    NumericalFailure with the last reason.
    """
    # gamma = (1 + step) times the smallest: away from the optimum, where R and S are nearly
    # singular and the controller's poles run away; twice the step where the verification fails
    step, reason = job.backoff - 1, ""
    while step <= _WIDEST:
        chosen = family.in_units(smallest * (1 + step))
        try:
            point = factors(well_conditioned(chosen, shape, job.time_limit), shape.varying)
            scheduled, at_points = _verified(job, chosen, point, shape)
        except (AmbroseError, np.linalg.LinAlgError) as failure:
            reason = f"back-off {1 + step:.4g}: {failure}"
            job.say(reason)
            step *= 2
            continue
        fastest = max(f.fastest_pole for f in at_points)
        job.say(
            f"gamma {chosen.unit:.6g}: verified at {len(at_points)} points, fastest pole "
            f"{fastest:.3g} rad/s"
        )
        return scheduled, chosen, at_points, 1 + step
    raise NumericalFailure(reason)


def _optimum(plant: ScaledPlant, family: Family, value: Any) -> float:
    """The optimal gamma of the plant at one grid point, in original units. Raises NumericalFailure
    naming the point.
    """
    try:
        return best_level(plant).gamma * family.unit
    except NumericalFailure as failure:
        raise NumericalFailure(
            f"the grid point {named(value)} alone has no H-infinity controller: {failure}"
        ) from failure


def _verified(
    job: _Job, family: Family, point: Factors, shape: Shape
) -> tuple[ScheduledSystem, tuple[Frozen, ...]]:
    """The schedule and what was found of it; it gains points of its own where interpolation spoils
    what R and S allow.
    """
    checked = tuple(interval_points(axis, job.points_between) for axis in family.axes)
    axes = family.axes
    for _ in range(_REFINED + 1):
        scheduled = _scheduled(job, family, point, axes)
        at_points = frozen(
            job.plant_at, scheduled, family, point, grid_points(checked), shape.rates
        )
        _require(job, at_points, family.unit)
        known = grid_points(axes)
        weak = [
            f.value
            for f in at_points
            if not f.guaranteed <= _HOLDS * family.unit and f.value not in known
        ]
        if not weak:
            break
        # the new points join the schedule, and each gets a checked point on either side
        axes = _with(axes, weak)
        checked = tuple(
            np.unique(np.append(old, interval_points(new, 1)))
            for old, new in zip(checked, axes, strict=True)
        )
    return scheduled, at_points


def _scheduled(
    job: _Job, family: Family, point: Factors, axes: tuple[np.ndarray, ...]
) -> ScheduledSystem:
    """The controllers on the grid of ``axes`` in original units and in the states of ``point``;
    values of an axis that is not the family's are left out where a plant has none there.
    """
    # the family's plants are in time t rate, A / rate, B and C / sqrt(rate): back by rate and root
    root = np.sqrt(family.rate)
    systems, without = {}, []
    for value in grid_points(axes):
        model = job.plant_at(value)
        plant = family.scaled(model)
        try:
            A, B, C, D = controller(plant, point, family.to_relative(value))
        except NumericalFailure:
            if family.on_grid(value):
                raise
            without.append(np.atleast_1d(value))
            continue
        # out of the scaled time, then out of the scaled u and y
        matrices = original_matrices(plant, (A * family.rate, B * root, C * root, D))
        systems[value] = StateSpace(*matrices, model.y, model.u)
    for i, axis in enumerate(family.axes):
        lost = [value[i] for value in without if value[i] not in axis]
        axes = (*axes[:i], axes[i][~np.isin(axes[i], lost)], *axes[i + 1 :])
    return ScheduledSystem(
        axes, [systems[value] for value in grid_points(axes)], job.parameter, job.unit
    )


def balanced_states(scheduled: ScheduledSystem) -> ScheduledSystem:
    """The same system in states scaled diagonally, by one scaling for all points: that which
    balances the largest modulus of every entry of A, B and C over the points.
    """
    # x = diag(t) z: A -> T^-1 A T, B -> T^-1 B, C -> C T
    largest = (np.abs([getattr(s, x) for s in scheduled.systems]).max(axis=0) for x in "ABC")
    t = balance_system(*largest)[3]
    systems = [
        StateSpace(s.A * t / t[:, None], s.B / t[:, None], s.C * t, s.D, s.inputs, s.outputs, s.dt)
        for s in scheduled.systems
    ]
    return replace(scheduled, systems=tuple(systems))


def _require(job: _Job, at_points: Sequence[Frozen], gamma: float) -> None:
    """Raises NumericalFailure unless every frozen loop is stable and the grid points keep
    ``gamma``.
    """
    for f in at_points:
        where = f"at {job.parameter} {named(f.value)} {job.unit}"
        if not f.stable:
            raise NumericalFailure(
                f"the loop is unstable {where} (spectral abscissa {f.spectral_abscissa:.4g} rad/s)"
            )
        if f.on_grid and not (f.slack < 0 and f.norm <= gamma * (1 + _NORM_ERROR)):
            raise NumericalFailure(
                f"norm {f.norm:.6g}, largest eigenvalue of the inequality {f.slack:.2g} {where}"
            )


def _result(job: _Job, design: _Design, nominal: Any) -> Synthesis:
    """The design as a synthesis, certified by what was found at all checked points. Raises
    NumericalFailure where nothing is guaranteed at one, InvalidInput for a nominal value outside.
    """
    at_points, gamma = design.found, design.family.unit
    worst = max(at_points, key=lambda f: f.guaranteed)
    if not np.isfinite(worst.guaranteed):
        raise NumericalFailure(
            f"between the grid points, at {job.parameter} {named(worst.value)} {job.unit}, "
            "nothing is guaranteed while the "
            f"{job.parameter} changes; add grid points there"
        )
    values = design.scheduled.values
    value = values[len(values) // 2] if nominal is None else nominal
    low, high = (named(end) for end in design.scheduled.range)
    inside = zip(np.atleast_1d(value), design.scheduled.axes, strict=True)
    if not all(axis[0] <= v <= axis[-1] for v, axis in inside):
        raise invalid(
            "nominal",
            f"{named(value)} {job.unit}",
            f"between {low} and {high}",
            "choose it within the grid",
        )
    between_them = [f.guaranteed for f in at_points if not f.on_grid]
    margins = {
        "gamma_optimal": design.optimal,
        "gamma_lower": design.lower,
        "gamma_designed": gamma,
        "pointwise_largest": float(design.pointwise.max()),
        "guaranteed_between": max(between_them, default=float("nan")),
        "grid_points": float(len(design.family.plants)),
        "schedule_points": float(len(design.scheduled.systems)),
        "checked_points": float(len(at_points)),
    }
    certificate = Certificate(
        all(f.stable for f in at_points),
        max(f.spectral_abscissa for f in at_points),
        max(f.norm for f in at_points),
        max(f.fastest_pole for f in at_points),
        margins,
        f"{design.family.n} states, {design.scheduled.words()}, {len(at_points)} points",
    )
    scheduled = balanced_states(design.scheduled)
    return Synthesis(
        scheduled.at(value),
        "lpv",
        worst.guaranteed,
        Status.VERIFIED if certificate.stable else Status.UNSTABLE,
        certificate,
        tuple(f.row() for f in at_points),
        (*design.notes, *_words(job, design, worst)),
        scheduled,
    )


def _words(job: _Job, design: _Design, worst: Frozen) -> tuple[str, ...]:
    """What is guaranteed, in sentences."""
    count, named_rates = (
        len(design.family.plants),
        zip(job.parameter.split(AND), job.unit.split(AND), job.rates, strict=True),
    )
    bounds = [
        (f"the {name} up to ", rate, f" {unit}/s")
        for name, unit, rate in named_rates
        if rate is not None
    ]
    speed = "however fast it changes"
    if bounds:
        alone = len(job.rates) == 1
        speed = ", ".join(
            f"{'up to ' if alone else name}{rate:g}{unit} either way" for name, rate, unit in bounds
        )
        speed += ", the other however fast" if len(bounds) < len(job.rates) else ""
    notes = [
        f"gamma {worst.guaranteed:.4g} holds for a changing {job.parameter}, {speed}: proved at "
        f"{count} grid points and "
        f"checked at {len(design.found) - count} points between, nowhere else"
    ]

    # The inequalities are linear in A, B1 and C1, so that they hold between two points where they
    # hold at both, as far as the other matrices are the same (and R and S constant).
    plants = design.family.plants
    kept = all(
        np.abs(getattr(p, name) - getattr(plants[0], name)).max()
        <= _KEPT * (1 + np.abs(getattr(plants[0], name)).max())
        for p in plants
        for name in ("B2", "C2", "D12", "D21")
    )
    if kept and job.varying == "none":
        each = "the parameter" if len(job.rates) == 1 else "each parameter"
        notes.append(
            f"for a plant that is linear in {each} between grid points it holds in between as well"
        )
    if design.backoff > job.backoff:
        notes.append(
            f"the back-off is {design.backoff:.4g} instead of {job.backoff:g}: closer to the "
            "optimum verification failed"
        )
    return tuple(notes)
