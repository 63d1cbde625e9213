"""The D-step: mu's upper bound over a frequency grid that follows the loop, and D(s) of the order
that suffices for it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ambrose.core.frequency import frequency_response
from ambrose.core.lft import Block, ComplexBlock, FullBlock
from ambrose.core.mu.bounds import mu_bounds
from ambrose.core.mu.structure import Structure, structure_of
from ambrose.core.statespace import StateSpace, poles
from ambrose.synthesis.mu.d_fit import RealRational, constant, fit_magnitude
from ambrose.synthesis.mu.matrix_fit import fit_matrix
from ambrose.synthesis.mu.refine import peak_gain, refine, tube
from ambrose.synthesis.mu.scaling import BlockScaling, Scaling, scalar_scaling, scaled_gain

HIGHEST_ORDER = 5  # tried by order="auto"
_WEIGHT = 6  # power of mu/peak with which a frequency counts in the fit
_TUBE = 0.05  # how far above mu the tube of admissible D reaches, in peaks of mu
_CURVE = 5.0  # tolerances by which sigma_max may exceed mu away from the peak
_NARROW = 5e-3  # least half-width of the tube, in ln d
_FIRST = 12  # frequencies at which mixed mu is computed first; their peak spares most of the others


@dataclass(frozen=True, slots=True, eq=False)
class DStep:
    """The complex upper bound of a loop: omega (w,) [rad/s], M (w, n_z, n_w), upper (w,), D_w (w,
    n_w, n_w) Hermitian.

    structure: of the bound, with repeated blocks as full ones where D is to be scalar; then middle
    and width (w, blocks - 1) of the tube of ln d_i (mu_refine), and empty for matrix scalings.
    """

    omega: np.ndarray
    M: np.ndarray
    upper: np.ndarray
    D_w: np.ndarray
    structure: Structure
    middle: np.ndarray
    width: np.ndarray

    @property
    def peak(self) -> float:
        return float(self.upper.max())


def d_blocks(blocks: Sequence[Block], structure: Literal["scalar", "full"]) -> list[Block]:
    """The blocks whose scalings the D-step may use: d I for a repeated block ("scalar"), or a
    matrix D ("full").
    """
    result: list[Block] = []
    for block in blocks:
        if isinstance(block, FullBlock):
            result.append(block)
        elif structure == "scalar":
            result.append(FullBlock(block.name, block.n_w, block.n_z))
        else:
            result.append(ComplexBlock(block.name, block.repeat))
    return result


def d_step(loop: StateSpace, blocks: Sequence[Block], grid: np.ndarray, rounds: int = 2) -> DStep:
    """The complex upper bound on the grid, on the loop's resonances and between the neighbours of
    its high peaks.
    """
    # The grid with the loop's resonances, lightly damped poles, within its ends.
    p = poles(loop)
    p = p[(p.imag > 0) & (np.abs(p.real) < 0.7 * np.abs(p))]
    extra = np.abs(p.imag)
    omega = np.unique(np.concatenate([grid, extra[(extra > grid[0]) & (extra < grid[-1])]]))
    M, upper, D = _bound(loop, blocks, omega)
    for _ in range(rounds):
        # Peaks of more than 0.9 of the largest: a point between each of them and its neighbours.
        padded = np.concatenate([[-np.inf], upper, [-np.inf]])
        high = (upper >= padded[:-2]) & (upper >= padded[2:]) & (upper > 0.9 * upper.max())
        chosen = high[:-1] | high[1:]
        new = np.sqrt(omega[:-1] * omega[1:])[chosen & (omega[1:] > 1.01 * omega[:-1])]
        if not len(new):
            break
        more = _bound(loop, blocks, new)
        order = np.argsort(np.concatenate([omega, new]))
        omega = np.concatenate([omega, new])[order]
        M, upper, D = (
            np.concatenate([a, b])[order] for a, b in zip((M, upper, D), more, strict=True)
        )

    # Scalar D: one number ln d_i per block, and how far each may move.
    structure = structure_of(blocks)
    middle = width = np.zeros((len(omega), 0))
    if not _matrix_scaled(structure) and upper.max() > 0:
        log_d = np.log(
            np.stack(
                [D[:, place.w.start, place.w.start].real for place in structure.places], axis=1
            )
        )
        middle, width = tube(M, structure, log_d, upper + _TUBE * upper.max())
    return DStep(omega, M, upper, D, structure, middle, np.maximum(width, _NARROW))


def _matrix_scaled(structure: Structure) -> bool:
    return any(
        isinstance(place.block, ComplexBlock) and place.block.repeat > 1
        for place in structure.places
    )


def _bound(
    loop: StateSpace, blocks: Sequence[Block], omega: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    M = frequency_response(loop, omega).values
    bound = mu_bounds(M, blocks, g_scaling=False, lower=False, tolerance=1e-3)
    return M, bound.upper, bound.D_w


def peak_below(
    step: DStep, blocks: Sequence[Block], ceiling: np.ndarray, g_scaling: bool
) -> tuple[float, np.ndarray, np.ndarray]:
    """The largest upper bound of another structure on the step's grid, given that it nowhere
    exceeds ``ceiling`` (w,).

    Only frequencies whose ceiling is above what was found elsewhere are computed. Returns the peak,
    the values (the ceiling where it was not needed) and which were computed.
    """
    values = ceiling.copy()
    known = np.zeros(len(ceiling), bool)
    best = 0.0
    while True:
        open_ = np.flatnonzero(~known & (ceiling > best))
        if not len(open_):
            return best, values, known
        # the highest ceilings first: their peak closes most of the others
        chosen = open_[np.argsort(-ceiling[open_])[: _FIRST if best == 0 else None]]
        found = mu_bounds(
            step.M[chosen], blocks, g_scaling=g_scaling, lower=False, tolerance=1e-3
        ).upper
        values[chosen], known[chosen] = np.minimum(found, ceiling[chosen]), True
        best = max(best, float(values[chosen].max()))


@dataclass(frozen=True, slots=True, eq=False)
class FittedScaling:
    """scaling: D(s); peak: of sigma_max(D M D^-1) on the step's grid; excess: the most by which it
    exceeds the bound there; scalars: the d_i where every D is scalar, else empty.
    """

    scaling: Scaling
    peak: float
    excess: float
    scalars: tuple[RealRational, ...] = ()


def fit_scaling(
    step: DStep, order: int | Literal["auto"], tolerance: float, lowest: int = 0
) -> FittedScaling:
    """D(s) for the step's blocks, last block D = 1 where its scaling is a scalar.

    order: of every D per channel; or "auto": the smallest one from ``lowest`` on with which
    sigma_max(D M D^-1) peaks at most 1 + tolerance times as high as the bound, and follows it
    within five tolerances of the peak at every frequency; then lower ones for single blocks. Scalar
    D are fitted in magnitude, then moved to lower the peak (mu_refine).
    """
    if order != "auto":
        return _fit(step, [order] * len(step.structure.places))

    def enough(item: FittedScaling) -> bool:
        return (
            item.peak <= (1 + tolerance) * step.peak
            and item.excess <= _CURVE * tolerance * step.peak
        )

    found = []
    for n in range(min(lowest, HIGHEST_ORDER), HIGHEST_ORDER + 1):
        found.append(_fit(step, [n] * len(step.structure.places)))
        if enough(found[-1]):
            return _fewer(step, found[-1], enough) if n > lowest else found[-1]
    least = min(item.peak for item in found)
    return next(item for item in found if item.peak <= (1 + tolerance) * least)


def extrapolate(
    step: DStep, used: FittedScaling, fitted: FittedScaling, factor: float
) -> FittedScaling | None:
    """The scaling that goes ``factor`` times as far, in log magnitude, from the one used to the
    middle of the step's tube; its orders are those of ``fitted``. None for matrix scalings.
    """
    if not (used.scalars and fitted.scalars and step.width.shape[1]):
        return None

    # ln d = ln d_used + factor (ln d_middle - ln d_used), fitted with the tube's width
    before = np.stack([d.log_magnitude(step.omega) for d in used.scalars[:-1]], axis=1)
    target = before + factor * (step.middle - before)
    found = [
        fit_magnitude(step.omega, np.exp(values), d.order, width**-2.0)
        for values, width, d in zip(target.T, step.width.T, fitted.scalars, strict=False)
    ]
    return of_scalars(step, [*found, fitted.scalars[-1]])


def of_scalars(step: DStep, d: Sequence[RealRational]) -> FittedScaling:
    """One d_i per block, with the peak on the step's grid."""
    scaling = Scaling(
        tuple(
            scalar_scaling(place.block, x)
            for place, x in zip(step.structure.places, d, strict=True)
        )
    )
    gain = peak_gain(step.M, step.omega, step.structure, d)
    return FittedScaling(scaling, float(gain.max()), float((gain - step.upper).max()), tuple(d))


def _fewer(
    step: DStep, fitted: FittedScaling, enough: Callable[[FittedScaling], bool]
) -> FittedScaling:
    """Lower orders of single blocks, as long as that is enough; the largest blocks first."""
    orders = list(fitted.scaling.orders)
    places = step.structure.places
    scaled = [i for i in range(len(places)) if orders[i] > 0]
    if len(scaled) < 2:
        return fitted
    for i in sorted(scaled, key=lambda k: -places[k].block.n_w):
        while orders[i] > 0:
            trial = _fit(step, [*orders[:i], orders[i] - 1, *orders[i + 1 :]])
            if not enough(trial):
                break
            fitted, orders[i] = trial, orders[i] - 1
    return fitted


def _fit(step: DStep, orders: Sequence[int]) -> FittedScaling:
    places = step.structure.places

    # Matrix scalings, some block being repeated: D^H D = D_w^2 of a repeated block, |d| of the
    # others; what counts is where mu is high.
    weight = (step.upper / step.peak) ** _WEIGHT if step.peak > 0 else np.ones(len(step.omega))
    if _matrix_scaled(step.structure):
        parts: list[BlockScaling] = []
        for place, n in zip(places, orders, strict=True):
            D = step.D_w[:, place.w, place.w]
            if isinstance(place.block, ComplexBlock) and place.block.repeat > 1:
                parts.append(fit_matrix(step.omega, D @ D, n, weight))
            elif place is places[-1]:
                parts.append(scalar_scaling(place.block, constant(1.0)))
            else:
                parts.append(
                    scalar_scaling(
                        place.block, fit_magnitude(step.omega, D[:, 0, 0].real, n, weight)
                    )
                )
        scaling = Scaling(tuple(parts))
        gain = scaled_gain(step.M, step.omega, scaling)
        return FittedScaling(scaling, float(gain.max()), float((gain - step.upper).max()))

    # Scalar ones: the middle of the tube, with its width as the weight, then moved together.
    fits = [
        fit_magnitude(step.omega, np.exp(middle), n, width**-2.0)
        for middle, width, n in zip(step.middle.T, step.width.T, orders, strict=False)
    ]
    return of_scalars(step, refine(step.M, step.omega, step.structure, [*fits, constant(1.0)]))
