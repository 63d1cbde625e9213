"""The direct method: the unknowns that make the predictor's errors smallest, by Levenberg and
Marquardt's steps from the best of a grid of poles and delays.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from ambrose.identification.one_axis.model import (
    DELAY,
    Structure,
    admissible,
    equation_error,
    innovations,
    largest_root,
)

_POLES = np.geomspace(0.002, 0.9, 10)  # rad/sample
_DELAYS = range(-1, 9)  # samples
_ENOUGH = 20_000  # samples to begin from
_STARTS = 3  # of the grid, from which the search begins
_STEPS = 60  # of the search from one start, at most; assumed
_ORTHOGONAL = 3e-3  # cosine of the errors with a sensitivity, at most, in a minimum
_STEP = 1e-6  # of a difference quotient


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """unknowns (m,) in the record's own scale; errors (n,) of the predictor, those before ``first``
    are not counted; jacobian (n - first, m); loss: their mean square.
    """

    structure: Structure
    unknowns: np.ndarray
    errors: np.ndarray
    jacobian: np.ndarray
    first: int
    loss: float
    converged: bool

    @property
    def counted(self) -> np.ndarray:
        return self.errors[self.first :]

    @property
    def criterion(self) -> float:
        """Schwarz: n log(loss) + m log(n)."""
        n = len(self.counted)
        return float(n * np.log(self.loss) + len(self.unknowns) * np.log(n))


def fit_from(
    structure: Structure, start: np.ndarray, y: np.ndarray, u: np.ndarray, first: int
) -> Fit:
    """The nearest minimum of the mean square of the predictor's errors.

    y, u (n,) in the record's own scale; first: errors before it are not counted.
    """
    unknowns = start.copy()
    errors = innovations(structure, unknowns, y, u)[first:]
    loss = float(np.mean(errors**2))
    damping = 1e-3
    for _ in range(_STEPS):
        jacobian = sensitivities(structure, unknowns, y, u)[first:]
        scale = np.sqrt((jacobian**2).mean(axis=0)) + 1e-300
        scaled = jacobian / scale
        normal = scaled.T @ scaled / len(errors)
        slope = scaled.T @ errors / len(errors)
        for _ in range(12):
            step = -np.linalg.solve(normal + damping * np.eye(len(slope)), slope) / scale
            trial = unknowns + step
            if admissible(structure, trial):
                new = innovations(structure, trial, y, u)[first:]
                new_loss = float(np.mean(new**2))
                if new_loss < loss:
                    break
            damping *= 5
        else:
            break  # no step lowers it any more
        gain = (loss - new_loss) / loss
        unknowns, errors = trial, new
        loss, damping = new_loss, max(damping / 10, 1e-9)
        if gain < 1e-9:
            break
    jacobian = sensitivities(structure, unknowns, y, u)[first:]
    whole = innovations(structure, unknowns, y, u)
    # at a minimum the errors are orthogonal to what the plant's unknowns would change
    columns = jacobian[:, : structure.plant]
    size = np.sqrt((columns**2).sum(axis=0) * np.sum(whole[first:] ** 2)) + 1e-300
    cosine = float(np.abs(columns.T @ whole[first:] / size).max())
    return Fit(structure, unknowns, whole, jacobian, first, loss, cosine < _ORTHOGONAL)


def sensitivities(
    structure: Structure, unknowns: np.ndarray, y: np.ndarray, u: np.ndarray
) -> np.ndarray:
    """d e / d unknowns (n, m): of the noise model by filters, of the plant by differences."""
    _, _, C, D = structure.split(unknowns)
    left = equation_error(structure, unknowns, y, u)
    errors = lfilter(D, C, left)
    columns = []
    for place in range(structure.plant):
        step = _STEP * max(abs(unknowns[place]), 1e-2)
        ahead = unknowns.copy()
        ahead[place] += step
        change = (equation_error(structure, ahead, y, u) - left) / step
        columns.append(lfilter(D, C, change))
    # d/dc: -D/C 1; d/dC_i: -q^-i e / C; d/dD_i: q^-i (A y - B u - c) / C
    columns.append(lfilter(D, C, -np.ones_like(y)))
    late = lfilter([1.0], C, errors)
    columns += [-_delayed(late, i) for i in range(1, len(C))]
    plain = lfilter([1.0], C, left)
    columns += [_delayed(plain, i) for i in range(1, len(D))]
    return np.column_stack(columns)


def _delayed(values: np.ndarray, samples: int) -> np.ndarray:
    return np.concatenate([np.zeros(samples), values[:-samples]])


def starts(y: np.ndarray, u: np.ndarray) -> list[np.ndarray]:
    """Unknowns (6,) of the plainest structure to begin from, the best of a grid first.

    For every pole p on the grid, C = (1 - e^-p q^-1)^2 makes a stable filter of A y = B u + c; for
    every delay of whole samples, cosh p and b then follow by least squares.
    """
    found = []
    y, u = y[:_ENOUGH], u[:_ENOUGH]
    ahead = np.append(u[1:], u[-1])
    for pole in _POLES:
        C = np.convolve([1.0, -np.exp(-pole)], [1.0, -np.exp(-pole)])
        bend = lfilter([1.0, -2.0, 1.0], C, y)
        own = lfilter([0.0, 1.0], C, y)
        level = lfilter([1.0], C, np.ones_like(y))
        for delay in _DELAYS:
            held = np.zeros(delay + 4)
            held[delay + 2 : delay + 4] = 0.5  # of b w, b/2 (q^-1 + q^-2): the double integrator's
            drive = lfilter(held, C, ahead)
            columns = np.column_stack([own, drive, level])
            first = min(len(y) // 5, 20 + int(5 / pole))
            solution = np.linalg.lstsq(columns[first:], bend[first:], rcond=None)[0]
            loss = float(np.mean((bend - columns @ solution)[first:] ** 2))
            stiffness = float(np.arccosh(1 + solution[0] / 2) ** 2) if solution[0] > 0 else 1e-6
            guess = [stiffness, solution[1], delay + 0.3, solution[2], C[1], C[2]]
            found.append((loss, np.array(guess)))
    found.sort(key=lambda item: item[0])
    return [guess for _, guess in found]


def fit_plainest(y: np.ndarray, u: np.ndarray) -> Fit:
    """The minimum with C of order 2 and no actuator, from several starts."""
    structure = Structure()
    best: Fit | None = None
    tried: set[int] = set()
    for guess in starts(y, u):
        delay = int(guess[DELAY])
        if len(tried) >= _STARTS or delay in tried or not admissible(structure, guess):
            continue
        tried.add(delay)
        fit = fit_from(structure, guess, y, u, settled_after(guess[4:6], len(y)))
        if best is None or fit.loss < best.loss:
            best = fit
    if best is None:
        guess = np.array([1e-3, 1e-3, 1.0, 0.0, -1.6, 0.64])
        best = fit_from(structure, guess, y, u, settled_after(guess[4:6], len(y)))
    C = np.concatenate([[1.0], best.unknowns[4:6]])
    return fit_from(structure, best.unknowns, y, u, settled_after(C[1:], len(y)))


def settled_after(noise: np.ndarray, n: int) -> int:
    """Samples after which the filter 1/C has forgotten its start, at most a tenth of the record."""
    root = largest_root(np.concatenate([[1.0], noise]))
    return int(min(n // 10, 30 + 5 / max(1 - root, 1e-6)))


def enlarge(fit: Fit, structure: Structure, root: float = 0.5) -> np.ndarray:
    """The unknowns of a larger structure that predicts alike, but for the actuator: C and D get the
    same root, which the search parts.
    """
    plant, constant, C, D = fit.structure.split(fit.unknowns)
    values = list(plant)
    if structure.lag and not fit.structure.lag:
        share = max(0.2 * values[DELAY], 0.2)
        values[DELAY] = max(values[DELAY] - share, 0.05)
        values.append(share)
    for _ in range(structure.colour - fit.structure.colour):
        C, D = np.convolve(C, [1.0, -root]), np.convolve(D, [1.0, -root])
    return np.concatenate([values, [constant], C[1:], D[1:]])
