"""A controller judged on measured frequency responses: stability, sensitivities and margins with
their intervals, at the lines and between them, without a model of the plant.

Signs are those of core/lft.py. With Y = S_run G, the running loop from excitation currents to
displacements, D = K - K_run and A = (I + Y D)^-1,

    S = A S_run,  S_run = I - Y K_run                                                        (1)
    det(I + G K) = det(I + G K_run) det(I + Y D)                                             (2)
    |dS + A dY (K_run + D S)| <= |dS| |A dY D|                                               (3)

T = Y K_run and K_run Y are linear in Y, so that an error of the analyser's goes through (3) as it
is. The plant alone is the case K_run = 0, Y = G.

Stability. On a circle just outside the unit circle the phase of det(I + Y D) turns as often as the
new loop has fewer unstable poles than the running one, which has none, but for those of K and K_run
themselves (principle of the argument). Where |A dY D| < 1 for all that dY may be, no error changes
that count (Rouche).

Between the lines Y is a cubic through the four nearest ones. What the ends of an interval are off
the cubic through lines as far apart as it is wide bounds what the cubic misses within, for every
resonance whose half-width is at least _SEEN of the spacing: for a pole at distance g from the real
axis and lines h apart the ratio of both is 2.84 g/h. Narrower ones miss by their part more.

verify_controller(machine, controller, measured=["responses.h5"], running=running)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path as File

import numpy as np

from ambrose.core.checks import InvalidInput, as_several, invalid
from ambrose.core.frequency import evaluate, frequency_response, largest_gain, schur_form
from ambrose.core.sampling import hold
from ambrose.core.statespace import StateSpace, poles, select
from ambrose.judge.checks import Checks, Curve, judge, zone_lines
from ambrose.judge.loop_response import ALL_AXES, add_poles, loop_evaluator
from ambrose.judge.nominal import sensitivity_range
from ambrose.judge.plants import judge_stability
from ambrose.law.law import LawLike
from ambrose.law.loop import Timing, closed_loop, running_law
from ambrose.machine.criteria import SENSITIVITY, TWO_PI, Demand, demand
from ambrose.model.plant import Plant, top_speed
from ambrose.record.response import (
    CURRENT,
    SCATTER_DOF,
    SENSOR,
    Agreement,
    Path,
    Response,
    agreement,
    cubic,
    distance,
    predicted,
    readings,
    scale_error,
    scatter,
    usable,
    whole,
)
from ambrose.record.response_files import read_response

MEASURED = ", measured"  # after the label of an operating point
UNDECIDED = "not decided"  # in the detail of a check whose interval holds the limit
_FEW = 12  # lines at least
_SEEN = 0.35  # half-widths per spacing from which a resonance is bounded by its neighbours
_LEAST = 0.002  # damping that is assumed of a resonance that a line shows and no other resolves
_NEAR = 0.2  # relative, about a mode of the machine file in which its damping is assumed
# half-widths about a mode within which it bends a response, lines that show that at least
_BEND, _BENT = 1.5, 4
# of the bend's square what a model may leave that has the mode, of the noise's what adds to that,
# and what the bend must be at least
_LEFT, _NOISY = 0.1, 1.2
_SHOWN = 0.5
_QUIET = 0.5  # of the noise's deviation: a mode whose bend is less is none
_BETWEEN = 6  # steps between two lines
_COVERAGE = 0.05  # what all lines together may miss by chance
_LOUD = 2.0  # scatter over the stated variance from which the scatter counts
_LIGHT = 0.3  # damping ratio of a mode that may hide between lines
_OUTSIDE = 1e-7  # of the circle outside the unit circle: an integrator counts as stable
_ALIKE = 0.8  # of the largest singular value, from which others move with it
_RAN = 0.05  # by which a path may be off what the others and the running controller make
_NOTHING = 1e-9  # of the largest entry of a controller
_NEAR_ONE = 0.3  # of the closed loop, about 1: displacement per excitation is then K^-1
_MISREAD, _NEARER = 0.05, 3.0  # off the model, and so much nearer as another sign or unit reads it
_OTHER = 0.3  # by which the plant may be off the machine file's
_BEYOND = 0.5  # loop gain that the model may have beyond the last line: half of what turns anything


@dataclass(frozen=True, slots=True, eq=False)
class Lines:
    """One kind of square response X (w, a, a) of the loop that ran, at omega (w,) [rad/s], with its
    variance. kind: "motion", "T" at the sensors, "K Y" at the currents, "G"; dof: of the variance.
    """

    kind: str
    omega: np.ndarray
    X: np.ndarray
    variance: np.ndarray
    dof: float = np.inf

    @property
    def reach(self) -> float:
        """Radius over deviation of a complex value that all lines together keep to."""
        share = len(self.omega) / _COVERAGE
        if np.isinf(self.dof):
            return float(np.sqrt(np.log(share)))  # P(|e| > r s) = exp(-r^2)
        return float(np.sqrt(self.dof / 2 * (share ** (2 / self.dof) - 1)))


_KINDS = (
    ("motion", ("motion",), None),
    ("T", ("T", "S", "L"), SENSOR),
    ("K Y", ("T", "S", "L"), CURRENT),
    ("G", ("G",), None),
)


def lines_of(response: Response, axes: Sequence[str]) -> Lines:
    """The first kind of response that is there between all axes. Raises InvalidInput."""
    found = {}
    for kind, quantities, at in _KINDS:
        cells: dict[tuple[int, int], list[Path]] = {}
        for path in response.paths:
            if path.quantity in quantities and at in {None, path.at}:
                place = axes.index(path.read), axes.index(path.injected)
                cells.setdefault(place, []).append(_as_closed(path))
        found[kind] = cells
        if len(cells) == len(axes) ** 2:
            return _filled(kind, response.omega, cells, len(axes))
    kind, cells = max(found.items(), key=lambda item: len(item[1]))
    missing = [
        one if one == other else f"{one}/{other}"
        for i, one in enumerate(axes)
        for j, other in enumerate(axes)
        if (i, j) not in cells
    ]
    raise InvalidInput(
        f"{len(missing)} of {len(axes) ** 2} responses between the axes are missing, the first of "
        f"{missing[0]}: another controller couples all axes; sweep every axis while all "
        "displacements are recorded, change one axis at a time, or identify the machine from what "
        "is there"
    )


def own_lines(response: Response, axes: Sequence[str], K: np.ndarray) -> dict[int, Lines]:
    """By axis what was measured of it alone, the other loops closed; K (w, a, a): that ran. All but
    T at the sensor tells an axis only where its controller has nothing to do with the others.
    """
    found = {}
    for i, axis in enumerate(axes):
        for kind, quantities, at in (_KINDS[1], *(_KINDS if apart(K, i) else ())):
            same = [
                _as_closed(path)
                for path in response.paths
                if path.quantity in quantities
                and at in {None, path.at}
                and path.read == path.injected == axis
            ]
            if same:
                found[i] = _filled(kind, response.omega, {(0, 0): same}, 1)
                break
    return found


def apart(K: np.ndarray, axis: int) -> bool:
    """Whether an axis of K (w, a, a) has nothing to do with the others."""
    size = np.abs(K).max(axis=0)
    beside = (
        np.delete(size[axis], axis).max(initial=0.0),
        np.delete(size[:, axis], axis).max(initial=0),
    )
    return bool(max(beside) <= _NOTHING * size.max())


def sensitivity_of(
    response: Response,
    axes: Sequence[str],
    law: StateSpace,
    modes: np.ndarray,
    plant: Modelled,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Output sensitivity S (w, a, a) of the loop with the law that ran, the deviation (w, a + 1) of
    its diagonal and of its largest singular value, and the largest (w - 1, a + 1) that both may be
    between two lines; NaN where it was not measured. modes: as for ``between``; plant: G (w, a, a)
    of their model. Raises InvalidInput where an axis was not measured.
    """
    n, a = len(response.omega), len(axes)
    if n < _FEW:
        raise invalid("the number of lines", n, f"at least {_FEW}", "sweep more")
    K = frequency_response(law, response.omega).values
    try:
        blocks = {tuple(range(a)): lines_of(response, axes)}
    except InvalidInput:
        own = own_lines(response, axes, K)
        if len(own) < a:
            raise
        blocks = {(i,): lines for i, lines in own.items()}
    S, sd = np.full((n, a, a), np.nan, complex), np.full((n, a + 1), np.nan)
    rise = np.full((n - 1, a + 1), np.nan)
    dense = np.zeros((0, a, a))
    for places, lines in blocks.items():
        points = between(lines, _poles_of(law), modes, _as_modelled(lines, places, plant, law))
        part = np.ix_(range(len(points.omega)), places, places)
        if not len(dense):  # the same for every block
            dense = frequency_response(law, points.omega).values
        judged = judge_lines(points, lines, dense[part], dense[part])
        at = np.searchsorted(points.omega, lines.omega)
        sizes, radius = np.abs(np.einsum("wii->wi", judged.S)), judged.radius
        columns = list(places)
        if len(places) == a:
            columns.append(a)
            sizes = np.column_stack([sizes, judged.largest])
            radius = np.column_stack([radius, judged.largest_radius])
        S[np.ix_(range(n), places, places)] = judged.S[at]
        sd[:, columns] = radius[at] / lines.reach
        rise[:, columns] = np.maximum.reduceat(sizes + radius, at[:-1], axis=0)
    return S, sd, rise


def _as_closed(path: Path) -> Path:
    """T for S and L of the same place: T = 1 - S, T = L/(1 + L)."""
    if path.quantity == "S":
        return replace(path, values=float(path.read == path.injected) - path.values)
    if path.quantity == "L":
        slope = np.abs(1 / (1 + path.values)) ** 4
        variance = None if path.variance is None else path.variance * slope
        return replace(path, values=path.values / (1 + path.values), variance=variance)
    return path


def _filled(
    kind: str, omega: np.ndarray, cells: dict[tuple[int, int], list[Path]], a: int
) -> Lines:
    """Paths of the same place averaged by their variances; these from the scatter where a path
    states none, or less than half of it.
    """
    X = np.zeros((len(omega), a, a), complex)
    variance = np.zeros(X.shape)
    dof = np.inf
    for (i, j), same in cells.items():
        weights = []
        for path in same:
            alone = scatter(omega, path.values)
            known = path.variance
            ratio = np.inf if known is None else float(np.median(alone / known))
            dof = SCATTER_DOF if ratio > _LOUD else dof
            weights.append(1 / (alone if known is None else known * max(ratio / _LOUD, 1.0)))
        total = np.sum(weights, axis=0)
        X[:, i, j] = np.sum([w * p.values for w, p in zip(weights, same, strict=True)], 0) / total
        variance[:, i, j] = 1 / total
    return Lines(kind, omega, X, variance, dof)


def _even(omega: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """For every interval (w-1,) its two ends (w-1, 2), four lines (w-1, 2, 4) by which each end is
    predicted, and their weights: lines that lie as far apart as the interval is wide, since closer
    ones say nothing of what it may hide.
    """
    n, x = len(omega), np.log(omega)
    nodes = np.zeros((n - 1, 2, 4), int)
    for k, h in enumerate(np.diff(omega)):
        steps = h * (1 - 1e-9) * np.arange(1, 5)
        left = np.searchsorted(omega, omega[k] - steps, side="right") - 1
        right = np.searchsorted(omega, omega[k + 1] + steps)
        left, right = np.unique(left[left >= 0])[::-1], np.unique(right[right < n])
        # two on one side, the other end and one beyond it
        before = [*left[:2], k + 1, *right]
        after = [*right[:2], k, *left]
        nearest = np.argsort(np.abs(np.arange(n) - k), kind="stable").tolist()
        spare = [i for i in nearest if i not in (k, k + 1)]
        for row, found in enumerate((before, after)):
            nodes[k, row] = np.sort(list(dict.fromkeys([*found[:4], *spare]))[:4])
    ends = np.stack([np.arange(n - 1), np.arange(1, n)], axis=1)
    weights = cubic(x[ends].ravel(), x[nodes].reshape(-1, 4)).reshape(nodes.shape)
    return ends, nodes, weights


@dataclass(frozen=True, slots=True, eq=False)
class Between:
    """X (w, a, a), its variance and what the cubic may miss, at lines and between; spacing (w,)
    [rad/s] of the lines there.
    """

    omega: np.ndarray
    X: np.ndarray
    variance: np.ndarray
    missed: np.ndarray
    spacing: np.ndarray


Modelled = Callable[[np.ndarray], np.ndarray]


def between(
    lines: Lines, extra: np.ndarray, modes: np.ndarray, modelled: Modelled | None = None
) -> Between:
    """The lines and steps between; extra (p,): poles about which steps are packed; modes (m,):
    complex poles of the machine file's loop, whose damping is assumed of what noise may hide.

    modelled: the same response (w, a, a) by the model of these modes at omega (w,). The cubic goes
    through what the lines are off it, except near the modes that lines may hide (``_hiding``),
    which the model may have at another frequency.
    """
    omega, n = lines.omega, len(lines.omega)
    steps = np.arange(_BETWEEN) / _BETWEEN
    dense = np.exp(np.interp(np.arange(n - 1)[:, None] + steps, np.arange(n), np.log(omega)))
    dense[:, 0] = omega[:-1]  # and not what rounding makes of them
    dense = add_poles(np.append(dense.ravel(), omega[-1]), extra)

    # the cubic: its value, and the variance that it has of the lines'
    at = np.clip(np.searchsorted(omega, dense * (1 + 1e-12), side="right") - 1, 0, n - 2)
    nodes = np.clip(at - 1, 0, n - 4)[:, None] + np.arange(4)
    x, spacing = np.log(omega), np.diff(omega)[at]
    weights = cubic(np.log(dense), x[nodes])
    variance = np.einsum("wk,wkij->wij", weights**2, lines.variance[nodes])

    # what the ends of an interval are off, as far as noise does not explain it
    ends, others, c = _even(omega)
    noise = lines.variance[ends] + np.einsum("wek,wekij->weij", c**2, lines.variance[others])

    def through(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The cubic (d, a, a) of values (w, a, a) at the lines, and what it may miss."""
        off = np.abs(values[ends] - np.einsum("wek,wekij->weij", c, values[others]))
        off = np.maximum(off - lines.reach * np.sqrt(noise), 0.0).max(axis=1)
        return np.einsum("wk,wkij->wij", weights, values[nodes]), off[at]

    X, missed = through(lines.X)
    if modelled is not None:
        modes = _hiding(lines, modelled, modes)
        apart = np.ones(len(dense), bool)
        for pole in modes:  # resolved by the lines there it could not hide
            near = np.abs(dense / np.abs(pole) - 1) < _NEAR
            apart &= ~(near & (-pole.real < _SEEN * spacing))
        rest, left = through(lines.X - modelled(omega))
        X[apart], missed[apart] = (rest + modelled(dense))[apart], left[apart]

    # of the machine file's modes, its damping is assumed beside their frequencies
    damping = np.full(len(dense), np.inf)
    for pole in modes:
        near = np.abs(dense / np.abs(pole) - 1) < _NEAR
        damping[near] = np.minimum(damping[near], -pole.real / np.abs(pole))
    narrow = np.maximum(_SEEN * spacing / (np.minimum(damping, _LEAST) * dense), 1.0)
    missed *= narrow[:, None, None]

    # noise may hide such a mode
    hidden = np.maximum(_SEEN * spacing / (damping * dense), 1.0)
    on_line = np.isin(dense, omega)
    missed[on_line], hidden[on_line] = 0.0, 1.0
    hiding = hidden > 1
    variance[hiding] = (noise.max(axis=1)[at] * (hidden**2)[:, None, None])[hiding]
    return Between(dense, X, variance, missed, spacing)


def _hiding(lines: Lines, modelled: Modelled, modes: np.ndarray) -> np.ndarray:
    """Those of the modes (m,) of a model that lines may hide, (k,): not one that bends the response
    by less than noise does, nor one that the lines show where and as the model has it.
    """
    omega, found = lines.omega, []
    spacing, known = np.diff(omega), modelled(omega)
    for pole in modes:
        half, at = -pole.real, np.abs(pole)
        if not omega[0] < at < omega[-1]:
            found.append(pole)
            continue
        near = np.clip(at + half * np.linspace(-_BEND, _BEND, 9), omega[0], omega[-1])
        noise = lines.variance[np.clip(np.searchsorted(omega, near), 0, len(omega) - 1)]
        size = np.linalg.norm(_bend(near, modelled(near)), axis=(1, 2))
        if (size <= _QUIET * np.sqrt(noise.sum(axis=(1, 2)))).all():
            continue
        # resolved at the model's frequency, and of its bend there little is left
        first, last = np.searchsorted(omega, (at - half / 2, at + half / 2))
        here = slice(*np.searchsorted(omega, (near[0], near[-1])))
        seen = 0 < first and last < len(omega) and here.stop - here.start >= _BENT
        if seen and half >= _SEEN * spacing[first - 1 : last].max():
            left, bend = (
                float(np.sum(np.abs(_bend(omega[here], X)) ** 2))
                for X in (lines.X[here] - known[here], known[here])
            )
            count = here.stop - here.start
            scatter_left = float(lines.variance[here].sum()) * (1 - 2 / count)
            if bend >= _SHOWN * scatter_left and left <= _LEFT * bend + _NOISY * scatter_left:
                continue
        found.append(pole)
    return np.array(found, complex)


def _bend(omega: np.ndarray, X: np.ndarray) -> np.ndarray:
    """X (w, a, a) without its straight part."""
    line = np.column_stack([np.ones(len(omega)), omega / omega.mean() - 1])
    flat = X.reshape(len(X), -1)
    return np.asarray((flat - line @ np.linalg.lstsq(line, flat, rcond=None)[0]).reshape(X.shape))


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """The loop of a controller on the measured plant, at omega (w,) [rad/s].

    S (w, a, a) with radius (w, a) of its diagonal's entries; largest (w,): sigma_max(S), with its
    own; doubt (w,): the bound of |A dY D|, 1 and more where nothing is told; unstable: poles.
    """

    omega: np.ndarray
    S: np.ndarray
    radius: np.ndarray
    largest: np.ndarray
    largest_radius: np.ndarray
    doubt: np.ndarray
    spacing: np.ndarray
    M: np.ndarray


Responses = Response | str | File | Sequence[Response | str | File]
Controller = Callable[[np.ndarray], np.ndarray]


def controller_at(law: StateSpace | None, axes: int) -> Controller:
    """K (w, a, a) at omega (w,), on the circle just outside the unit circle (right of the imaginary
    axis); None: no controller.
    """
    if law is None:
        return lambda omega: np.zeros((len(omega), axes, axes), complex)
    form = schur_form(law.A, law.B, law.C, law.D)
    dt = law.dt

    def at(omega: np.ndarray) -> np.ndarray:
        if dt is None:
            return evaluate(form, 1j * omega + 1e4 * _OUTSIDE)
        return evaluate(form, (1 + _OUTSIDE) * np.exp(1j * omega * dt))

    return at


def _as_modelled(
    lines: Lines, places: tuple[int, ...], plant: Modelled, ran: StateSpace | None
) -> Modelled:
    """The response that lines hold, at these places of the axes, of a model's plant G (w, a, a)."""

    def at(omega: np.ndarray) -> np.ndarray:
        G = plant(omega)
        K = controller_at(ran, G.shape[1])(omega)
        Y = np.linalg.inv(np.eye(G.shape[1]) + G @ K) @ G
        made = {"G": G, "motion": Y, "T": Y @ K, "K Y": K @ Y}[lines.kind]
        return made[np.ix_(range(len(omega)), places, places)]

    return at


def _motion(
    kind: str, X: np.ndarray, K_run: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Y, L and R, each (w, a, a), with dY = L dX R."""
    unit = np.broadcast_to(np.eye(X.shape[1]), X.shape)
    if kind == "G":
        L = np.linalg.inv(unit + X @ K_run)
        return L @ X, L, np.linalg.inv(unit + K_run @ X)
    if kind == "motion":
        return X, unit, unit
    back = np.linalg.inv(K_run)
    return (X @ back, unit, back) if kind == "T" else (back @ X, back, unit)


def judge_lines(points: Between, lines: Lines, K: np.ndarray, K_run: np.ndarray) -> Judged:
    """(1) and (3) at every point; K, K_run (w, a, a)."""
    eye, X = np.eye(K.shape[1]), points.X
    D = K - K_run

    Y, L, R = _motion(lines.kind, X, K_run)
    M = Y @ D
    A = np.linalg.inv(eye + M)
    S = A @ (eye - Y @ K_run)
    left = np.abs(A @ L)

    def size(Q: np.ndarray, P: np.ndarray = left) -> np.ndarray:
        """The radius (w, a, a) of P dX Q."""
        noise = np.sqrt(P**2 @ points.variance @ Q**2)
        return np.asarray(lines.reach * noise + P @ points.missed @ Q)

    doubt = np.linalg.norm(size(np.abs(R @ D)), axis=(1, 2))
    if lines.kind == "G":  # L and R themselves hold dG
        own = np.linalg.norm(size(np.abs(K_run), np.abs(L)), axis=(1, 2))
        doubt = np.where(own < 1, doubt / np.maximum(1 - own, 1e-12), np.inf)
    with np.errstate(divide="ignore"):
        more = np.where(doubt < 1, 1 / np.maximum(1 - doubt, 1e-300), np.inf)
    B = R @ (K_run + D @ S)
    radius = np.einsum("wii->wi", size(np.abs(B))) * more[:, None]

    # of sigma_max: the block of singular values that lie near it
    U, sigma, V = np.linalg.svd(S)
    near = sigma >= _ALIKE * sigma[:, :1]
    block = size(np.abs(B @ V.conj().swapaxes(1, 2)), np.abs(U.conj().swapaxes(1, 2) @ A @ L))
    block = block * near[:, :, None] * near[:, None, :]
    largest_radius = np.linalg.norm(block, axis=(1, 2)) * more
    return Judged(points.omega, S, radius, sigma[:, 0], largest_radius, doubt, points.spacing, M)


def turns(
    judged: Judged, first: np.ndarray, stiffness: np.ndarray, at: Controller, run_at: Controller
) -> int:
    """How often det(I + Y D) goes around the origin, counter-clockwise over the whole circle.

    stiffness (w, a, a): G^-1 [A/m] at the first lines (w,) [rad/s], which are continued below
    them. Beyond the last line the loop gain is below one, as the caller has seen to. Raises
    InvalidInput with the frequencies at which nothing is told.
    """
    open_ = judged.doubt >= 1
    if open_.any():
        at_hz = judged.omega[open_] / TWO_PI
        k = int(np.argmax(np.where(open_, judged.spacing / judged.omega, 0.0)))
        raise InvalidInput(
            f"the responses do not show whether the loop is stable from {at_hz[0]:.4g} to "
            f"{at_hz[-1]:.4g} Hz, where lines are up to {judged.spacing[k] / TWO_PI:.3g} Hz apart; "
            "sweep there with closer lines, longer at each, and S beside T: where one of them is "
            "near zero, the other tells"
        )
    low, phases = _below(first, stiffness, at, run_at)
    q = np.linalg.slogdet(np.eye(judged.M.shape[1]) + judged.M)[0]
    phase = np.unwrap(np.concatenate([phases, np.angle(q)]))
    if np.abs(np.diff(phase)).max() > 2.5:
        k = int(np.argmax(np.abs(np.diff(phase))))
        where = np.concatenate([low, judged.omega])[k] / TWO_PI
        raise InvalidInput(
            f"the phase of the loop turns too far between two lines near {where:.4g} Hz; sweep "
            "there with closer lines"
        )
    # from the last line to the highest frequency each 1 + lambda stays right of the imaginary axis
    end = np.angle(1 + np.linalg.eigvals(judged.M[-1])).sum()
    return round((phase[-1] - end - phase[0]) / np.pi)


def _below(
    first: np.ndarray, stiffness: np.ndarray, at: Controller, run_at: Controller
) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies from 0 to the first line and the phase of det(I + Y D) there: of a plant whose
    dynamic stiffness is D0 + j w D1 - w^2 D2 - j w^3 D3 with real matrices, fitted to its first
    lines.
    """
    even = np.stack([np.ones_like(first), first**2], axis=1)
    flat = stiffness.reshape(len(first), -1)
    real = np.linalg.lstsq(even, flat.real, rcond=None)[0]
    imaginary = np.linalg.lstsq(even * first[:, None], flat.imag, rcond=None)[0]

    def fitted(w: np.ndarray) -> np.ndarray:
        powers = np.stack([np.ones_like(w), w**2], axis=1)
        rows = powers @ real + 1j * w[:, None] * (powers @ imaginary)
        return rows.reshape(len(w), *stiffness.shape[1:])

    left = stiffness - fitted(first)
    low = np.concatenate([[0.0], np.geomspace(1e-9 * first[0], first[0], 300)])
    new, run = fitted(low) + at(low), fitted(low) + run_at(low)
    for loop in (new, run):
        # the mean residual: a line's noise is about three times what it leaves in the fit
        off = largest_gain(np.linalg.inv(loop)[:, None] @ left)
        if (np.mean(off**2, axis=1) >= 1).any():
            raise InvalidInput(
                f"below the first line, {first[0] / TWO_PI:.4g} Hz, the responses do not show "
                "whether the loop is stable; begin the sweep lower, and measure longer there"
            )
    signs = np.linalg.slogdet(new)[0] / np.linalg.slogdet(run)[0]
    return low, np.angle(signs)


# Gain and phase margins of an axis, the others closed, from S_aa with its radius: L = 1/S_aa - 1
# lies in a disc, and every frequency counts at which the disc meets the
# negative real axis, or the unit circle.


def margins(S: np.ndarray, radius: np.ndarray) -> tuple[float, float]:
    """The least gain factor that loses the loop, or its inverse, and the least phase [rad], of all
    loops within the radius (w,) of S (w,); infinite without a crossing.
    """
    known = np.abs(S) > radius
    far = 1 / (np.abs(S) + radius)  # |1 + L| at least

    # the disc about S under 1/S - 1
    scale = np.where(known, np.abs(S) ** 2 - radius**2, 1.0)
    L, slack = S.conj() / scale - 1, np.where(known, radius / scale, 0.0)

    # between neighbours a chord's crossing counts as well
    def crossed(f: np.ndarray) -> np.ndarray:
        change = np.append((f[:-1] >= 0) != (f[1:] >= 0), False)
        return (change | np.append(False, change[:-1])) & known

    # -1/f with f the factor that brings L to -1: the nearest to 1 of those that the disc holds
    real = crossed(L.imag) | (np.abs(L.imag) < slack)
    half = np.sqrt(np.maximum(slack[real] ** 2 - L.imag[real] ** 2, 0.0))
    low, high = -L.real[real] - half, -L.real[real] + half
    nearest = np.clip(1.0, low, high)[high > 0]
    factor = np.maximum(nearest, 1 / np.maximum(nearest, 1e-300))
    size = np.abs(L)
    unit = crossed(size - 1) | (np.abs(size - 1) < slack)
    turn = np.arcsin(np.minimum(slack[unit] / np.maximum(size[unit], 1e-300), 1.0))
    phase = np.maximum(np.abs(np.angle(-L[unit])) - turn, 0.0)

    # where S is not told from 0, L lies nowhere within ``far`` of -1
    factor = np.append(factor, 1 + far[~known])
    phase = np.append(phase, 2 * np.arcsin(far[~known & (far < 2)] / 2))
    return float(factor.min(initial=np.inf)), float(phase.min(initial=np.inf))


def check_measured(
    plant: Plant,
    response: Response,
    controller: LawLike,
    running: LawLike | None,
    timing: Timing | None,
) -> Checks:
    """The checks of a controller on what was measured at the point of a full plant.

    running: the one that ran while it was measured; None for the plant's own responses alone, then
    the machine file says how many unstable poles the plant has. Raises InvalidInput for responses
    that do not tell, or are not of this machine and controller.
    """
    axes, label = plant.axes, plant.point.label or f"{plant.point.speed:g} rad/s"
    law = running_law(controller, plant, timing)
    if law.dt is None:
        raise InvalidInput(
            "the controller's sample rate is unknown; state sample_rate_hz with the responses, "
            "or sample_time in [controller] of the machine file"
        )
    ran = None if running is None else running_law(running, plant, timing)
    response = usable(response, axes, law.dt)
    if len(response.omega) < _FEW:
        raise invalid("the number of lines", len(response.omega), f"at least {_FEW}", "sweep more")
    _refuse_unknown_loop(response, running)
    model = _Model(plant, controller, running, timing)
    at, run_at = controller_at(law, len(axes)), controller_at(ran, len(axes))
    packed = np.concatenate([_poles_of(law), _poles_of(ran)])
    K, K_run = at(response.omega), run_at(response.omega)
    try:
        parts = {tuple(range(len(axes))): lines_of(response, axes)}
    except InvalidInput as missing:
        parts = _parts(response, axes, K, K_run, missing)
    valid = _refuse_others(response, parts, axes, K_run, model, ran is not None)
    told, lost = [], 0
    for places, lines in parts.items():
        block = np.ix_(range(len(K)), places, places)

        def of(there: Controller, places: tuple[int, ...] = places) -> Controller:
            return lambda omega: there(omega)[np.ix_(range(len(omega)), places, places)]

        made = _as_modelled(lines, places, model.plant, ran)
        points = between(lines, packed, model.modes, made)
        judged = judge_lines(points, lines, of(at)(points.omega), of(run_at)(points.omega))
        told.append(judged)
        if len(parts) > 1 or np.abs(K - K_run).max() <= _NOTHING * np.abs(K).max():
            continue  # the loop that ran
        gain, reached = model.beyond(float(lines.omega[-1]))
        last = float(np.abs(np.linalg.eigvals(judged.M[-1])).max())
        if max(gain, last / 2) >= _BEYOND:
            raise InvalidInput(
                f"the last line, {lines.omega[-1] / TWO_PI:.4g} Hz, is too low: the loop's gain "
                f"there is {last:.2g}, and beyond it up to {gain:.2g} by the machine file's model; "
                f"sweep to {reached / TWO_PI:.4g} Hz"
            )
        first = lines.omega <= max(3 * lines.omega[0], lines.omega[5])
        stiffness = _stiffness(lines, K_run[block])[first]
        count = turns(judged, lines.omega[first], stiffness, of(at), of(run_at))
        own, before = _unstable(law), 0 if ran is None else _unstable(ran)
        open_ = model.unstable if ran is None else 0
        lost = own - before + open_ - count
    if lost < 0:
        raise InvalidInput(
            f"the responses make {-lost} unstable poles less than none: the running controller "
            "is another one, or a resonance is between two lines; correct the controller, or "
            "sweep closer"
        )
    lines, judged = next(iter(parts.values())), _together(told)
    named = tuple(i for places in parts for i in places)
    checks = _checks(plant, label, lines, judged, named, lost, model, ran is not None)
    return replace(checks, notes=_notes(lines, judged, valid))


def _refuse_unknown_loop(response: Response, running: LawLike | None) -> None:
    if running is None and not response.kind("G"):
        raise InvalidInput(
            "the responses are those of a closed loop, which tell the plant only with the "
            "controller that ran; give it (--running)"
        )


def measured_plant(
    plant: Plant, response: Response, running: LawLike | None, timing: Timing | None
) -> tuple[np.ndarray, np.ndarray]:
    """omega (w,) [rad/s] and the measured plant G (w, a, a) there, with the hold of a sampled loop
    and without delay. running: the controller that ran, on which what is measured is judged first.
    Raises InvalidInput, as ``check_measured``.
    """
    _refuse_unknown_loop(response, running)
    if running is not None:
        check_measured(plant, response, running, running, timing)
    law = None if running is None else running_law(running, plant, timing)
    lines = lines_of(usable(response, plant.axes, None if law is None else law.dt), plant.axes)
    K_run = controller_at(law, len(plant.axes))(lines.omega)

    # G = (Y^-1 - K_run)^-1 = (I - Y K_run)^-1 Y of the motion Y = (I + G K_run)^-1 G
    Y = _motion(lines.kind, lines.X, K_run)[0]
    return lines.omega, np.linalg.inv(np.eye(Y.shape[1]) - Y @ K_run) @ Y


def modelled(
    plant: Plant, controller: LawLike, response: Response, timing: Timing | None
) -> list[np.ndarray]:
    """Every path of a response of the loop that runs, (w,), as the full plant and the controller
    make it.
    """
    law, axes = running_law(controller, plant, timing), plant.axes
    omega, every = response.omega, whole(response, axes)
    K = controller_at(law, len(axes))(omega)
    G = loop_evaluator(plant, law)(omega).G
    if law.dt is not None:
        G = G * hold(omega, law.dt)[:, None, None]
    Y = np.linalg.inv(np.eye(len(axes)) + G @ K) @ G
    none = np.zeros((0, *Y.shape))
    return [predicted(path, axes, Y, none, K, every)[0] for path in response.paths]


def _parts(
    response: Response,
    axes: Sequence[str],
    K: np.ndarray,
    K_run: np.ndarray,
    missing: InvalidInput,
) -> dict[tuple[int, ...], Lines]:
    """What single axes tell of K beside K_run (w, a, a): all of them where K ran, and the one that
    it changes where that has nothing to do with the others; else raises ``missing``.

    With K - K_run = d e_a e_a' of rank one, det(I + Y D) = 1 + Y_aa d and S_aa = S_run,aa/(1 + Y_aa
    d): (1) and (2) of the axis alone.
    """
    own = own_lines(response, axes, K_run)
    apart_by = np.abs(K - K_run).max(axis=0)
    either = np.maximum(apart_by.max(axis=0), apart_by.max(axis=1))
    moved = np.flatnonzero(either > _NOTHING * np.abs(K).max()).tolist()
    wanted = moved or list(range(len(axes)))
    alone = all(apart(item, i) for i in moved for item in (K, K_run))
    if len(moved) > 1 or not alone or not set(wanted) <= set(own):
        raise missing
    return {(i,): own[i] for i in wanted}


def _together(told: Sequence[Judged]) -> Judged:
    """Axes that were judged by themselves, S (w, n) on the diagonal of one."""
    if len(told) == 1:
        return told[0]
    S = np.einsum("nw,nm->wnm", [item.S[:, 0, 0] for item in told], np.eye(len(told)))
    radius = np.concatenate([item.radius for item in told], axis=1)
    return replace(told[0], S=S, radius=radius)


def _unstable(law: StateSpace) -> int:
    """Poles outside the circle (right of the axis)."""
    values = poles(law)
    if law.dt is None:
        return int((values.real > 1e4 * _OUTSIDE).sum())
    return int((np.abs(values) > 1 + _OUTSIDE).sum())


def _poles_of(law: StateSpace | None) -> np.ndarray:
    """Poles (n,) [rad/s], of a sampled law ln z/T; without those of a pure delay."""
    if law is None:
        return np.zeros(0, complex)
    values = poles(law).astype(complex)
    return values if law.dt is None else np.log(values[np.abs(values) > 1e-6]) / law.dt


def _stiffness(lines: Lines, K_run: np.ndarray) -> np.ndarray:
    """G^-1 (w, a, a) [A/m]: Y = (G^-1 + K_run)^-1."""
    if lines.kind == "G":
        return np.linalg.inv(lines.X)
    return np.linalg.inv(_motion(lines.kind, lines.X, K_run)[0]) - K_run


class _Model:
    """What the machine file says of the same loop, for comparison, and beyond the lines."""

    def __init__(
        self, plant: Plant, controller: LawLike, running: LawLike | None, timing: Timing | None
    ) -> None:
        law = running_law(controller, plant, timing)
        self.stability = judge_stability(plant, controller, timing)
        self.dt, self.axes = law.dt, plant.axes
        self._new = loop_evaluator(plant, law)
        self._run = None if running is None else running_law(running, plant, timing)
        alone = select(plant.system, plant.named("u"), plant.named("y"))
        known = poles(alone) if self._run is None else _poles_of(closed_loop(plant, self._run))
        self.unstable = int((known.real > 0).sum())  # of the plant, where nothing ran
        # modes that nothing but their own damping holds, as the running loop has them
        light = -known.real < _LIGHT * np.abs(known)
        self.modes = known[(known.imag > 0) & (known.real < 0) & light]

    def sensitivity(self, omega: np.ndarray) -> np.ndarray:
        """S (w, a, a)."""
        return self._new(omega).output_sensitivity()

    def plant(self, omega: np.ndarray) -> np.ndarray:
        """G (w, a, a), with the hold of a sampled loop."""
        G = self._new(omega).G
        return G if self.dt is None else G * hold(omega, self.dt)[:, None, None]

    def outside(self, low: float, high: float, highest: float) -> tuple[float, float]:
        """The largest sensitivity of an axis below ``low`` and from ``high`` to ``highest``, and
        where; (0, 0) for nothing.
        """
        bands = [np.geomspace(min(TWO_PI / 2, low / 2), low, 100)]
        if high < highest:
            bands.append(add_poles(np.geomspace(high, highest, 300), self.modes))
        omega = np.concatenate(bands)
        rows = np.abs(np.einsum("wii->wi", self.sensitivity(omega))).max(axis=1)
        k = int(np.argmax(rows))
        return float(rows[k]), float(omega[k])

    def beyond(self, last: float) -> tuple[float, float]:
        """The largest gain of Y D beyond the last line, and from where it is below _BEYOND."""
        top = 10 * last if self.dt is None else 0.999 * np.pi / self.dt
        if top <= last:
            return 0.0, last
        omega = add_poles(np.geomspace(last, top, 300), self.modes)
        new = self._new(omega)
        K_run = np.zeros_like(new.K)
        if self._run is not None:
            K_run = frequency_response(self._run, omega).values
            K_run = K_run if self.dt is None else K_run * hold(omega, self.dt)[:, None, None]
        Y = np.linalg.inv(np.eye(len(self.axes)) + new.G @ K_run) @ new.G
        gain = largest_gain(Y @ (new.K - K_run))
        high = np.flatnonzero(gain >= _BEYOND)
        return float(gain.max()), float(omega[high[-1]] if high.size else last)


def refuse_misread(
    response: Response, axes: Sequence[str], G: np.ndarray, K_run: np.ndarray
) -> np.ndarray:
    """Y (w, a, a) that the model's G and K_run (w, a, a) make. Raises InvalidInput where a path is
    several times what they make, or a quantity is near them only as another sign, unit or phase
    reads it.
    """
    few = evenly(response.omega)
    Y = np.linalg.inv(np.eye(len(axes)) + G @ K_run) @ G
    unity = np.abs(np.einsum("wij,wji->wi", Y, K_run) - 1)[few] < _NEAR_ONE
    none, every = np.zeros((0, *Y.shape)), whole(response, axes)
    groups: dict[tuple[str, str], list[tuple[Path, np.ndarray]]] = {}
    for path in response.paths:
        made = predicted(path, axes, Y, none, K_run, every)[0][few]
        groups.setdefault((path.quantity, path.at), []).append(
            (replace(path, values=path.values[few], variance=None), made)
        )
    for (quantity, _), items in groups.items():
        far, (best, words) = (
            distance([(path.values, made) for path, made in items]),
            min(readings(items)),
        )
        for path, made in items:
            near = unity[:, axes.index(path.read)] if quantity == "motion" else None
            factor = scale_error(path, made, near) if path.read == path.injected else None
            if factor is not None and distance([(path.values / factor, made)]) < best:
                raise InvalidInput(
                    f"{path.name} is about {factor:.2g} times what the machine file and the "
                    "running controller make; correct its scale, or give the controller that ran"
                )
        if far > _MISREAD and best * _NEARER < far:
            what, remedy = words.split(": ")
            raise InvalidInput(
                f"{quantity} as stated is {far:.0%} off what the machine file and the running "
                f"controller make, and {best:.0%} where {what}; {remedy}"
            )
    return np.asarray(Y)


def evenly(omega: np.ndarray) -> np.ndarray:
    """Numbers of lines that are as dense everywhere as at their widest."""
    even = np.geomspace(omega[0], omega[-1], 60)
    return np.unique(np.searchsorted(omega, even * (1 - 1e-9)))


def _refuse_others(
    response: Response,
    parts: Mapping[tuple[int, ...], Lines],
    axes: Sequence[str],
    K_run: np.ndarray,
    model: _Model,
    ran: bool,
) -> Agreement:
    """Up to which frequency model and measurement agree on the plant's diagonal, or on that of an
    axis with the other loops closed. Raises
    InvalidInput where a scale is wrong, the controller is not the one that ran, or the plant none
    of this machine.
    """
    omega, modelled = response.omega, model.plant(response.omega)
    few = evenly(omega)
    closed = refuse_misread(response, axes, modelled, K_run)
    lines = next(iter(parts.values()))
    if lines.X.shape[1] < len(axes):
        # G_a = (1/Y_aa - k_a)^-1, the other loops closed
        pairs = {
            places[0]: [
                1 / _stiffness(one, K_run[:, [[places[0]]], [[places[0]]]])[:, 0, 0],
                1 / (1 / closed[:, places[0], places[0]] - K_run[:, places[0], places[0]]),
            ]
            for places, one in parts.items()
        }
        return _agreed(omega, axes, pairs, few, ran)
    Y = _motion(lines.kind, lines.X, K_run)[0]
    none = np.zeros((0, *Y.shape))
    for path in response.paths if ran else ():
        made = predicted(path, axes, Y, none, K_run, whole(response, axes))[0]
        noise = 0.0 if path.variance is None else float(np.median(np.sqrt(path.variance)))
        level = float(np.median(np.abs(path.values)))
        if path.quantity != "K" and level < 0.1 * max(
            float(np.median(np.abs(p.values))) for p in response.kind(path.quantity)
        ):
            continue  # between axes that hardly couple there is nothing but noise
        off = distance([(path.values, made)])
        if off > _RAN + noise / max(level, 1e-300):
            raise InvalidInput(
                f"{path.name} is {off:.0%} off what the other responses and the running controller "
                "make; give the controller that ran (--running), or correct that path"
            )
    G = np.linalg.inv(_stiffness(lines, K_run))
    own, other = (np.einsum("wii->iw", item) for item in (G, modelled))
    pairs = {i: [own[i], other[i]] for i in range(len(axes))}
    return _agreed(omega, axes, pairs, few, ran)


def _agreed(
    omega: np.ndarray,
    axes: Sequence[str],
    pairs: Mapping[int, Sequence[np.ndarray]],
    few: np.ndarray,
    ran: bool,
) -> Agreement:
    """Of measured and modelled plants (w,) by axis. Raises InvalidInput where they are of two."""
    off = distance([(own[few], other[few]) for own, other in pairs.values()])
    if off > _OTHER:
        raise InvalidInput(
            f"the plant that these responses {'and the running controller ' if ran else ''}make is "
            f"{off:.0%} off the machine file's; give the controller that ran, and the responses of "
            "this machine"
        )
    return agreement(
        [(omega, Path("G", axes[i], axes[i], own), other) for i, (own, other) in pairs.items()]
    )


def _checks(
    plant: Plant,
    label: str,
    lines: Lines,
    judged: Judged,
    told: tuple[int, ...],
    lost: int,
    model: _Model,
    ran: bool,
) -> Checks:
    """The verdict, every figure by the unfavourable end of its interval; told: the axes of judged,
    by themselves where they were not measured together.
    """
    requirements, axes = plant.machine.requirements, [plant.axes[i] for i in told]
    whole = lines.X.shape[1] == len(plant.axes)
    by = (
        "by det(I + G K)/det(I + G K_run) against the loop that ran"
        if ran
        else f"by det(I + G K) and {model.unstable} unstable poles of the plant, as in the machine "
        "file"
    )
    said = "stable" if model.stability.stable else "unstable"
    stability = judge(
        "stability.measured",
        "Unstable poles of the loop on the measured plant",
        lost,
        "-",
        Demand(0.0, "<=", "stability"),
        f"{by}; model: {said}, {model.stability.abscissa:+.4g} 1/s",
    )
    label += MEASURED
    if lost:
        return Checks(label, False, (stability,))
    speed = max(top_speed(plant.machine), plant.point.speed)
    highest = sensitivity_range(speed, model.dt)
    within = judged.omega <= highest
    omega = judged.omega[within]
    S = np.einsum("wii->iw", judged.S)[:, within]
    other = model.sensitivity(omega)
    rows, radii = np.abs(S), judged.radius[within].T
    others = np.abs(np.einsum("wii->iw", other))[list(told)]
    named = list(axes)
    if whole:
        rows = np.vstack([judged.largest[within][None], rows])
        radii = np.vstack([judged.largest_radius[within][None], radii])
        others = np.vstack([largest_gain(other)[None], others])
        named.insert(0, "max")
    checks, curves = [stability], []
    if not whole:
        missing = [axis for axis in plant.axes if axis not in axes]
        reason = "each by itself"
        if missing:
            reason = f"not told: {', '.join(missing)}, which the changed axis couples with"
        wanted = Demand(float(len(plant.axes)), ">=", "")
        title = "Axes whose sensitivity the responses tell"
        checks.append(judge("sensitivity.told", title, float(len(axes)), "-", wanted, reason))
        every = "max"
        checks.append(
            judge(
                f"sensitivity.output.{every}",
                f"Peak output sensitivity, {ALL_AXES}",
                np.nan,
                "-",
                demand("maximum singular value of a sensitivity", requirements),
                "not measured between the axes; sweep every axis while all displacements are "
                "recorded",
            )
        )
    limit = demand("maximum singular value of a sensitivity", requirements).limit
    for name, row, radius, expected in zip(named, rows, radii, others, strict=True):
        rule = (
            "maximum singular value of a sensitivity"
            if name == "max"
            else ("sensitivity of an axis")
        )
        k, low = int(np.argmax(row + radius)), float((row - radius).max())
        high = float((row + radius)[k])
        detail = (
            f"at {omega[k] / TWO_PI:.4g} Hz; measured {row.max():.4g}, {low:.4g} to {high:.4g}; "
            f"model {expected.max():.4g}"
        )
        wanted = demand(rule, requirements)
        if wanted.limit is not None and low < wanted.limit <= high:
            detail += f"; {UNDECIDED}: measure longer there"
        what = ALL_AXES if name == "max" else name
        title = f"Peak output sensitivity, {what}, upper end as measured"
        checks.append(judge(f"sensitivity.output.{name}", title, high, "-", wanted, detail))
    ends = (
        ("", rows),
        (".measured", rows),
        (".lower end", np.maximum(rows - radii, 0.0)),
        (".upper end", rows + radii),
        (".model", others),
    )
    for suffix, values in ends:
        curves.append(
            Curve(
                f"sensitivity.output{suffix}",
                "Output sensitivity" + (", measured and modelled" if suffix else ""),
                "frequency",
                omega,
                values,
                tuple(ALL_AXES if name == "max" else name for name in named),
                "rad/s",
                "-",
                zone_lines(SENSITIVITY, limit, "an axis"),
            )
        )
    for i, axis in enumerate(axes):
        gain, phase = margins(np.einsum("wii->iw", judged.S)[i], judged.radius[:, i])
        for kind, title, value, unit in (
            ("gain", "Gain", gain, "-"),
            ("phase", "Phase", phase, "rad"),
        ):
            wanted = demand(f"{kind} margin", requirements)
            name = f"margin.{kind}.output.{axis}"
            text = f"{title} margin at output {axis}, lower end as measured"
            checks.append(judge(name, text, value, unit, wanted))
    peak, place = model.outside(float(lines.omega[0]), float(lines.omega[-1]), highest)
    checks.append(
        judge(
            "outside.sensitivity",
            "Sensitivity of an axis outside the lines, by the model",
            peak,
            "-",
            demand("sensitivity of an axis", requirements),
            f"at {place / TWO_PI:.4g} Hz",
        )
    )
    return Checks(label, True, tuple(checks), tuple(curves))


def _notes(lines: Lines, judged: Judged, valid: Agreement) -> tuple[str, ...]:
    k = int(np.argmax(judged.spacing / judged.omega))
    narrow = _SEEN * float(judged.spacing[k] / judged.omega[k])
    return (
        f"Measured at {len(lines.omega)} lines from {lines.omega[0] / TWO_PI:.4g} to "
        f"{lines.omega[-1] / TWO_PI:.4g} Hz; outside them the model stands. Of the plant, "
        f"{valid}.",
        "All intervals together hold with 95 % of the noise. A mode that neither the machine file "
        f"nor a line shows could hide between lines if damped by less than {narrow:.2g} (near "
        f"{judged.omega[k] / TWO_PI:.4g} Hz).",
    )


def read_responses(responses: Responses) -> list[Response]:
    """One or several, each read where it is a file. Raises InvalidInput."""
    return [read_response(item) for item in as_several(responses)]


def placed(
    plants: Sequence[Plant], responses: Responses, running: LawLike | None
) -> dict[int, Response]:
    """Which responses are of which plant, by its number. Raises InvalidInput for responses of
    another machine, of no operating point among these, and of the same.
    """
    items = read_responses(responses)
    if running is not None and not items:
        raise InvalidInput("a running controller is given without responses; add them (--measured)")
    places: dict[int, Response] = {}
    for number, one in enumerate(items, 1):
        name = plants[0].machine.name
        if one.machine != name:
            what, remedy = f"the machine of responses {number}", "take that machine's file"
            raise invalid(what, repr(one.machine), repr(name), remedy)
        k = _place(one, plants, number)
        if k in places:
            raise InvalidInput(
                f"responses {number} are of the same operating point as others; give one file for "
                "each point"
            )
        places[k] = one
    return places


def _place(response: Response, plants: Sequence[Plant], number: int) -> int:
    """Which operating point a response is of. Raises InvalidInput."""
    point = response.point
    for k, plant in enumerate(plants):
        own = plant.point
        if np.allclose(
            (own.speed, own.seal_pressure), (point.speed, point.seal_pressure), rtol=0.01, atol=1e-6
        ):
            return k
    known = "; ".join(
        f"{p.point.label} ({p.point.speed / TWO_PI:.4g} Hz, {p.point.seal_pressure / 1e5:.4g} bar)"
        for p in plants
    )
    raise InvalidInput(
        f"responses {number} are of {point.speed / TWO_PI:.4g} Hz and "
        f"{point.seal_pressure / 1e5:.4g} bar, which is no operating point of the machine "
        f"({known}); "
        "correct their point, or add it to the machine file"
    )
