"""Where a loop with real parameters has a pole on the imaginary axis, and the smallest perturbation
that puts one there.

A point (delta, omega) of the crossing surface has an eigenvalue 1 of M11(j omega) diag(delta).
Along one direction v the eigenvalues mu of M11 diag(v) over frequency are real where the direction
crosses, at the factor 1 / mu: all crossings at once, without a step in the factor that could miss a
range of instability. M11 is the nominal loop's, smooth between its own poles. Parameters that act
at one place share inputs: M11 = N E with r < n columns of M11 and a constant E (r, n), and the
eigenvalues other than zero are those of E diag(v) N. From a crossing the surface is followed
downhill: a step in delta that lowers the largest entry and keeps the eigenvalue real to first order
(a linear program with one equation, solved exactly), then back onto the surface.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla

from ambrose.core.checks import named_failure
from ambrose.core.mu.structure import osborne, structure_of
from ambrose.core.worst_case.loop import BoxLoop, corners, default_grid

LARGEST_BOX = 20.0  # in boxes
_ANGLES = 25  # frequencies beside every lightly damped pole
_CHUNK = 60_000  # matrices whose eigenvalues are computed at once
_DIRECTIONS = 40  # at random, per parameter beyond the first
_FEW_CORNERS = 5  # parameters up to which all corners are directions
_STARTS = 6  # per round
_STEPS = 60  # along the surface of the crossing, at most
_HALVINGS = 12  # of a grid interval in which an eigenvalue crosses the real axis
_NEWTON = 12  # steps of Newton's method, at most
_SAME = 1e-12  # of a column, to which it must be made of others
_STILL = 1e-10  # relative imaginary part of the eigenvalue that counts as none


@dataclass(frozen=True, slots=True, eq=False)
class BoxMargin:
    """The box may grow by ``factor`` before a perturbation in it destabilises: delta (k,), largest
    entry ``factor``, does.

    frequency [rad/s] of the pole on the axis. factor is infinite (delta NaN) when none was found up
    to 20 times the box. It is found by search: a smaller perturbation may exist where there are
    several parameters.
    """

    factor: float
    delta: np.ndarray
    frequency: float


@named_failure("the margin of the box")
def box_margin(loop: BoxLoop, also: np.ndarray | None = None, seed: int = 0) -> BoxMargin:
    """The smallest destabilising perturbation found, up to 20 times the box. also (d, k): more
    directions to try.
    """
    rng = np.random.default_rng(seed)
    grid = _grid(loop)
    n = len(loop.owner)
    shared = _shared_inputs(loop)
    M = loop.at(grid)[:, :n, :n]
    M[0] = M[0].real  # at rest, exactly: its real eigenvalues are crossings, of poles at zero
    # no crossing below 1 / reach there
    reach = np.linalg.norm(osborne(M, structure_of(loop.blocks))[0], 2, axis=(1, 2))
    directions = _main_directions(loop.parameters, rng)
    if also is not None:
        size = np.abs(also).max(axis=1, keepdims=True)
        directions = np.vstack([(also / np.where(size > 0, size, 1.0))[size[:, 0] > 0], directions])
    best = BoxMargin(float("inf"), np.full(loop.parameters, np.nan), float("nan"))
    for number in range(3 if loop.parameters > 1 else 1):
        # corners and axes first, then points of the faces, then the best direction with noise
        if number == 1:
            directions = _scattered(loop.parameters, rng)
        elif number == 2:
            if not np.isfinite(best.factor):
                break
            directions = best.delta / best.factor + rng.normal(
                0, 0.4, (_DIRECTIONS, loop.parameters)
            )
            directions /= np.abs(directions).max(axis=1, keepdims=True)

        # below the best so far, mu > 1 / top; with a neighbour on each side
        top = min(best.factor, LARGEST_BOX)
        kept = reach >= 1 / top
        kept[1:] |= kept[:-1]
        kept[:-1] |= kept[1:]
        starts = _candidates(grid, M, kept, loop, shared, directions, top)
        crossings = [
            landed
            for start in starts
            if (landed := _followed(loop, start)) and landed.factor <= LARGEST_BOX
        ]
        best = min([best, *crossings], key=lambda item: item.factor)
    return best


def _grid(loop: BoxLoop) -> np.ndarray:
    """Frequencies (w,) [rad/s] between which the eigenvalues turn by a few degrees: equal angles as
    seen from each pole.
    """
    turned = np.tan(np.linspace(-1.5, 1.5, _ANGLES))
    light = loop.poles[(loop.poles.imag > 0) & (-loop.poles.real < 0.3 * np.abs(loop.poles))]
    beside = (light.imag[:, None] - light.real[:, None] * turned).ravel()
    return np.unique(np.concatenate([[0.0], default_grid(loop, 40), beside[beside > 0]]))


def _main_directions(parameters: int, rng: np.random.Generator) -> np.ndarray:
    """Corners of the box, not more than 32, and the axes (d, k)."""
    if parameters == 1:
        return np.array([[-1.0], [1.0]])
    ends = corners(parameters)
    if parameters > _FEW_CORNERS:
        ends = ends[rng.choice(len(ends), 2**_FEW_CORNERS, replace=False)]
    return np.vstack([ends, np.eye(parameters), -np.eye(parameters)])


def _scattered(parameters: int, rng: np.random.Generator) -> np.ndarray:
    """Random points (d, k) of the faces of the box."""
    inside = rng.uniform(-1, 1, (min(_DIRECTIONS * (parameters - 1), 160), parameters))
    side = rng.integers(0, parameters, len(inside))
    inside[np.arange(len(inside)), side] = rng.choice([-1.0, 1.0], len(inside))
    return inside


@dataclass(frozen=True, slots=True, eq=False)
class _Inputs:
    """M11 = M11[:, columns] E, for E (r, n)."""

    columns: np.ndarray
    E: np.ndarray

    def eigenvalues(self, M: np.ndarray, wide: np.ndarray) -> np.ndarray:
        """Those of M11 diag(wide) (..., r) but for n - r zeros, M11 (..., n, n), wide (..., n)."""
        return np.linalg.eigvals((self.E * wide[..., None, :]) @ M[..., self.columns])


def _shared_inputs(loop: BoxLoop) -> _Inputs:
    n = len(loop.owner)
    columns = np.vstack([loop.system.B[:, :n], loop.system.D[:, :n]])
    size = np.linalg.norm(columns, axis=0)
    size[size == 0] = 1.0

    # columns / size = Q R P^T; those beyond the rank are R11^-1 R12 of the first ones
    R, order = sla.qr(columns / size, mode="r", pivoting=True)
    rank = max(int((np.abs(np.diag(R)) > _SAME).sum()), 1)
    E = np.zeros((rank, n))
    E[:, order] = np.linalg.lstsq(R[:rank, :rank], R[:rank], rcond=None)[0]
    return _Inputs(order[:rank], E * size / size[order[:rank], None])


def _candidates(
    grid: np.ndarray,
    M: np.ndarray,
    kept: np.ndarray,
    loop: BoxLoop,
    shared: _Inputs,
    directions: np.ndarray,
    limit: float,
) -> list[BoxMargin]:
    """Crossings of the directions below ``limit``, to first order; the lowest, and of those in one
    band of frequency a few.
    """
    index = np.flatnonzero(kept)
    if len(index) < 2:
        return []
    rows: list[tuple[float, int, float]] = []
    step = max(1, _CHUNK // len(index))
    for start in range(0, len(directions), step):
        part = directions[start : start + step]
        values = shared.eigenvalues(M[index], part[:, None, loop.owner])
        through, touching = _real_crossings(values, grid[index], np.diff(index) == 1, limit)
        rows += [
            (factor, start + d, omega)
            for factor, d, omega in [*_narrowed(loop, shared, part, through), *touching]
        ]
    rows.sort()
    chosen: list[BoxMargin] = []
    bands: dict[int, int] = {}
    # three at most of an eighth of an octave
    for factor, i, omega in rows:
        band = round(8 * np.log2(max(omega, grid[1])))
        if bands.get(band, 0) < 3:
            bands[band] = bands.get(band, 0) + 1
            chosen.append(BoxMargin(factor, factor * directions[i], omega))
        if len(chosen) == _STARTS:
            break
    return chosen


@dataclass(frozen=True, slots=True, eq=False)
class _Brackets:
    """Eigenvalues (r,) at the two ends (r, 2) [rad/s] of an interval in which they cross the real
    axis, each of a direction.
    """

    direction: np.ndarray
    omega: np.ndarray
    values: np.ndarray


def _real_crossings(
    values: np.ndarray, omega: np.ndarray, beside: np.ndarray, limit: float
) -> tuple[_Brackets, list[tuple[float, int, float]]]:
    """Where an eigenvalue (d, w, n) crosses the positive real axis; and (factor, direction,
    frequency) where it nearly does.
    """
    # real but for rounding, as at zero
    values = np.where(np.abs(values.imag) <= _STILL * np.abs(values), values.real, values)

    # each eigenvalue with the nearest at the next frequency: the imaginary part changes its sign
    a, b = values[:, :-1], values[:, 1:]
    near = np.abs(a[..., :, None] - b[..., None, :]).argmin(axis=-1)
    b = np.take_along_axis(b, near, axis=-1)
    through = (
        (a.imag * b.imag <= 0) & (np.maximum(a.real, b.real) > 1 / limit) & beside[None, :, None]
    )
    d, w, i = np.nonzero(through)
    brackets = _Brackets(
        d, np.stack([omega[w], omega[w + 1]], axis=1), np.stack([a[d, w, i], b[d, w, i]], axis=1)
    )

    # nearly: |Im| is smallest at a grid point and below a tenth of Re; the factor 5 % larger
    turn = np.abs(values.imag)
    touch = (
        (turn[:, 1:-1] <= turn[:, :-2])
        & (turn[:, 1:-1] <= turn[:, 2:])
        & (turn[:, 1:-1] < 0.1 * values.real[:, 1:-1])
    )
    d, w, i = np.nonzero(touch & (values.real[:, 1:-1] > 1 / limit))
    sizes = 1.05 / values.real[d, w + 1, i]
    return brackets, list(zip(sizes.tolist(), d.tolist(), omega[w + 1].tolist(), strict=True))


def _narrowed(
    loop: BoxLoop, shared: _Inputs, directions: np.ndarray, brackets: _Brackets
) -> list[tuple[float, int, float]]:
    """(factor, direction, frequency) of the crossings, their brackets halved: the eigenvalues may
    turn fast in between.
    """
    if not len(brackets.direction):
        return []
    n = len(loop.owner)
    low, high = brackets.omega.T.copy()
    a, b = brackets.values.T.copy()
    wide = directions[brackets.direction][:, loop.owner]
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        M = loop.at(middle)[:, :n, :n]
        values = shared.eigenvalues(np.where(middle[:, None, None] > 0, M, M.real), wide)
        at = np.abs(values - 0.5 * (a + b)[:, None]).argmin(axis=1)
        value = values[np.arange(len(at)), at]
        upper = value.imag * a.imag > 0  # the crossing is in the upper half
        low, a = np.where(upper, middle, low), np.where(upper, value, a)
        high, b = np.where(upper, high, middle), np.where(upper, b, value)

    # the rest of the bracket by linear interpolation to Im = 0
    share = np.where(
        a.imag == b.imag, 0.0, a.imag / np.where(a.imag == b.imag, 1.0, a.imag - b.imag)
    )
    size, omega = a.real + share * (b.real - a.real), low + share * (high - low)
    kept = size > 0
    return list(
        zip(
            (1 / size[kept]).tolist(),
            brackets.direction[kept].tolist(),
            omega[kept].tolist(),
            strict=True,
        )
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Eigenvalue:
    """An eigenvalue of M11(j omega) diag(v), and its derivatives with respect to omega and v
    (k,).
    """

    value: complex
    over_omega: complex
    over_v: np.ndarray


def _eigenvalue(loop: BoxLoop, v: np.ndarray, omega: float, near: complex) -> _Eigenvalue | None:
    at, n = np.array([omega]), len(loop.owner)
    M, slope = loop.model.at(at)[0, :n, :n], loop.model.slope(at)[0, :n, :n]
    wide = v[loop.owner]
    M = M if omega > 0 else M.real

    # the eigenvalue nearest to ``near``, x and y with y x = 1
    values, X = np.linalg.eig(M * wide)
    i = int(np.abs(values - near).argmin())
    try:
        y = np.linalg.inv(X)[i]
    except np.linalg.LinAlgError:
        return None
    x = X[:, i]

    # d mu = y dM diag(v) x + y M diag(dv) x, the channels of a parameter added
    gradient = (y @ M) * x
    over = np.bincount(loop.owner, gradient.real, len(v)) + 1j * np.bincount(
        loop.owner, gradient.imag, len(v)
    )
    return _Eigenvalue(complex(values[i]), complex(y @ (slope * wide) @ x), over)


def _on_surface(
    loop: BoxLoop, delta: np.ndarray, omega: float
) -> tuple[BoxMargin, _Eigenvalue] | None:
    """The crossing in the direction of delta near (delta, omega), by Newton's iteration: where the
    eigenvalue is real.
    """
    near: complex = 1.0
    for _ in range(_NEWTON):
        found = _eigenvalue(loop, delta, omega, near)
        if found is None or found.value.real <= 0:
            return None
        if abs(found.value.imag) <= _STILL * abs(found.value):
            scaled = delta / found.value.real
            return BoxMargin(float(np.abs(scaled).max()), scaled, omega), found
        if omega == 0.0 or found.over_omega.imag == 0:
            return None

        # Im mu = 0 by Newton, omega by at most 30 %; mu is followed to first order
        step = -found.value.imag / found.over_omega.imag
        if abs(step) > 0.3 * omega:
            step = float(np.sign(step)) * 0.3 * omega
        omega, near = omega + step, found.value + step * found.over_omega
        if abs(found.value.imag) > 0.8 * abs(found.value):
            return None
    return None


def _followed(loop: BoxLoop, start: BoxMargin) -> BoxMargin | None:
    """Down the crossing surface from a start near it, to where no direction lowers the largest
    entry any more.
    """
    landed = _on_surface(loop, start.delta, start.frequency)
    if landed is None:
        return None
    here, slope = landed
    radius = 0.3
    for _ in range(_STEPS if loop.parameters > 1 else 0):
        # mu = r at v, so that it is 1 at here.delta = v / r:
        # d mu = over_v . d delta + over_omega d omega / r = 0, omega eliminated:
        # Im(r over_v conj(over_omega)) . d delta = 0; at rest omega stays zero and over_v is real
        scale = slope.value.real
        turned = (
            slope.over_v * scale * np.conj(slope.over_omega)
            if here.frequency > 0
            else slope.over_v * scale * 1j
        )
        step = _downhill(turned.imag, here.delta, radius * here.factor)
        moved = here.delta + step
        omega = here.frequency
        if omega > 0:
            # omega from the same equation, by its real part
            guess = (
                -float((np.conj(slope.over_omega) * (slope.over_v @ step) * scale).real)
                / abs(slope.over_omega) ** 2
            )
            omega = float(np.clip(omega + guess, 0.5 * omega, 2 * omega))
        landed = _on_surface(loop, moved, omega)
        if landed is not None and landed[0].factor < here.factor:
            gain = 1 - landed[0].factor / here.factor
            here, slope = landed
            radius = min(2 * radius, 0.5)
            if gain < 1e-7:
                break
        else:
            radius /= 4
            if radius < 1e-5:
                break
    return here


def _downhill(a: np.ndarray, delta: np.ndarray, radius: float) -> np.ndarray:
    """The step with a . step = 0 and |step| <= radius that makes the largest entry of |delta +
    step| smallest, by bisection.

    With the largest entry at most t each coordinate has a range; a . step can be zero when the
    extremes of the sum enclose it.
    """
    low, high = np.abs(delta).max() - radius, float(np.abs(delta).max())
    low = max(low, 0.0)

    def ends(t: float) -> tuple[np.ndarray, np.ndarray]:
        least, most = np.maximum(-t - delta, -radius), np.minimum(t - delta, radius)
        # of the smallest and the largest sum
        return np.where(a > 0, least, most), np.where(a > 0, most, least)

    for _ in range(30):
        t = 0.5 * (low + high)
        smallest, largest = ends(t)
        if a @ smallest <= 0 <= a @ largest:
            high = t
        else:
            low = t
    smallest, largest = ends(high)
    bottom, span = a @ smallest, a @ (largest - smallest)
    return smallest + (largest - smallest) * (
        np.clip(-bottom / span, 0.0, 1.0) if span > 0 else 0.5
    )
