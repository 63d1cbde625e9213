"""The second way, which needs no noise model: instruments made of what drives the loop from
outside.

With the predictor's filter kept, the plant's unknowns solve

    sum_k zeta_k e_k = 0,    e = D/C (A y - B u - c),

zeta: what the sensitivities of e would be, were y and u no more than the loop's answers to z, an
excitation that knows nothing of the noise (Young, Recursive Estimation, 2nd ed., 2011, chapter 9;
Soderstrom and Stoica, System Identification, 1989, chapter 8 and section 10.5: consistent in
closed loop whatever colours the noise). z is the recorded reference; where none was recorded, the
part of u that no linear law of three to ten samples makes of y and of u's own past.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter
from scipy.stats import chi2

from ambrose.identification.one_axis.model import DELAY, LAG, STIFFNESS, equation_error
from ambrose.identification.one_axis.prediction_error import Fit, sensitivities

_OWN, _SEEN = 6, 10  # past samples of u and of y in the law that might make u
_BLOCKS = 8  # of the record
_FUNCTIONS = 16  # of Laguerre, over which the loop's answers to z are written
_ROUNDING = 1e-7  # of u's deviation: below it nothing drives the loop from outside
_LONG = 6.0  # lags over n^(1/3) where the residual is coloured
_TURNS = 8
_LAGS = 12  # of z, in the test whether the residual follows it


@dataclass(frozen=True, slots=True, eq=False)
class Instrumented:
    """The second estimate: plant (m,) and its covariance (m, m), both in the record's own scale;
    errors (n,) of the predictor with it; influence (n - first, m): what every sample does to the
    estimate; instruments (n - first, m).
    """

    plant: np.ndarray
    constant: float
    covariance: np.ndarray
    errors: np.ndarray
    influence: np.ndarray
    instruments: np.ndarray


def outside_part(y: np.ndarray, u: np.ndarray) -> np.ndarray | None:
    """What of u (n,) no linear law makes of y up to now and of u's past, over u's deviation; None:
    nothing of it.

    It is the innovation of the reference, and knows nothing of the noise before it.
    """
    y = (y - y.mean()) / y.std()
    u = (u - u.mean()) / u.std()
    depth = max(_OWN, _SEEN)
    n = len(y)
    columns = [np.ones(n - depth)]
    columns += [u[depth - j : n - j] for j in range(1, _OWN + 1)]
    columns += [y[depth - j : n - j] for j in range(_SEEN + 1)]
    design = np.column_stack(columns)
    solution = np.linalg.lstsq(design, u[depth:], rcond=None)[0]
    left = u[depth:] - design @ solution
    if left.std() < _ROUNDING:
        return None
    return np.concatenate([np.zeros(depth), left])


def answers(z: np.ndarray, signal: np.ndarray, pole: float) -> np.ndarray:
    """The part of a signal (n,) that follows z: least squares over Laguerre's functions, for every
    block of the record with the weights of the others (jackknife instruments, Angrist, Imbens and
    Krueger, 1999).

    pole [rad/sample]: the functions' own, near the loop's.
    """
    inside = np.exp(-min(1.5 * pole, 1.0))
    column = lfilter([np.sqrt(1 - inside**2)], [1.0, -inside], z)
    columns = [column]
    for _ in range(_FUNCTIONS - 1):
        column = lfilter([-inside, 1.0], [1.0, -inside], column)
        columns.append(column)
    design = np.column_stack(columns)
    result = np.zeros_like(signal)
    normal = design.T @ design
    moment = design.T @ signal
    for part in np.array_split(np.arange(len(signal)), _BLOCKS):
        rows = design[part]
        # of the other blocks alone: its own noise would come back in its instruments
        rest = normal - rows.T @ rows
        weights = np.linalg.lstsq(rest, moment - rows.T @ signal[part], rcond=1e-12)[0]
        result[part] = rows @ weights
    return result


def solve(fit: Fit, y: np.ndarray, u: np.ndarray, z: np.ndarray) -> Instrumented:
    """The unknowns of the plant by instruments, with the noise filter of the direct fit."""
    structure = fit.structure
    count = structure.plant
    pole = float(np.sqrt(max(fit.unknowns[STIFFNESS], 1e-5)))
    y_of_z, u_of_z = answers(z, y, pole), answers(z, u, pole)
    unknowns = fit.unknowns.copy()
    _, _, C, D = structure.split(unknowns)
    for _ in range(_TURNS):
        zeta = sensitivities(structure, unknowns, y_of_z, u_of_z)[fit.first :, : count + 1]
        slope = sensitivities(structure, unknowns, y, u)[fit.first :, : count + 1]
        errors = lfilter(D, C, equation_error(structure, unknowns, y, u))
        step = np.linalg.lstsq(zeta.T @ slope, zeta.T @ errors[fit.first :], rcond=None)[0]
        trial = unknowns.copy()
        trial[: count + 1] -= step
        trial[DELAY] = min(max(trial[DELAY], -0.8), 50.0)
        trial[STIFFNESS] = min(max(trial[STIFFNESS], -2.0), 2.0)
        if structure.lag:
            trial[LAG] = min(max(trial[LAG], 0.02), 100.0)
        moved = np.abs(trial - unknowns)[:count] / (np.abs(unknowns[:count]) + 1e-6)
        unknowns = trial
        if moved.max() < 1e-6:
            break
    errors = np.asarray(lfilter(D, C, equation_error(structure, unknowns, y, u)))
    inverse = np.linalg.pinv(zeta.T @ slope)
    influence = -(zeta * errors[fit.first :, None]) @ inverse.T
    covariance = long_run(influence, _LONG) * len(influence)
    return Instrumented(
        unknowns[:count],
        float(unknowns[count]),
        covariance[:count, :count],
        errors,
        influence,
        zeta,
    )


def long_run(rows: np.ndarray, reach: float = 1.5) -> np.ndarray:
    """Covariance (m, m) of one row (n, m) with all that follow it (Newey and West, 1987), for the
    sum of correlated rows; reach: lags over n^(1/3).
    """
    n = len(rows)
    lags = int(reach * n ** (1 / 3))
    total = rows.T @ rows / n
    for lag in range(1, lags + 1):
        part = rows[lag:].T @ rows[:-lag] / n
        total = total + (1 - lag / (lags + 1)) * (part + part.T)
    return np.asarray(total)


def follows(
    errors: np.ndarray, slope: np.ndarray, zeta: np.ndarray, z: np.ndarray, stride: int
) -> tuple[float, float]:
    """Whether the residual (n,) follows z: the probability of so much by chance, and the share of
    the residual's variance.

    slope (n, m): its sensitivities; zeta (n, m): the instruments with which these unknowns were
    found (the sensitivities themselves in a least-squares fit); stride: samples between the lags.
    The estimate's own freedom is taken out of the lags:
    g = (Z - zeta (slope' zeta)^-1 slope' Z)' e.
    """
    columns = []
    for j in range(_LAGS):
        shift = j * stride
        columns.append(np.concatenate([np.zeros(shift), z[: len(z) - shift]]))
    Z = np.column_stack(columns)
    Z = Z / (Z.std(axis=0) + 1e-300)
    free = Z - zeta @ (np.linalg.pinv(slope.T @ zeta) @ (slope.T @ Z))
    moment = free.T @ errors
    spread = long_run(free * errors[:, None]) * len(errors)
    statistic = float(moment @ np.linalg.pinv(spread) @ moment)
    solution = np.linalg.lstsq(free, errors, rcond=None)[0]
    share = float(np.sum((free @ solution) ** 2) / np.sum(errors**2))
    return float(chi2.sf(statistic, _LAGS)), share


def disagreement(fit: Fit, second: Instrumented, floor: float) -> float:
    """Probability that the two estimates of the plant part so far by chance (Hausman, 1978): from
    what every sample does to their difference.

    floor: of the direct estimate's deviations; by so much they may always differ.
    """
    count = fit.structure.plant
    normal = np.linalg.pinv(fit.jacobian.T @ fit.jacobian)
    first = -(fit.jacobian * fit.counted[:, None]) @ normal
    spread = long_run(first[:, :count] - second.influence[:, :count]) * len(first)
    spread += np.diag(floor**2 * fit.loss * np.diag(normal)[:count])
    part = fit.unknowns[:count] - second.plant
    return float(chi2.sf(float(part @ np.linalg.pinv(spread) @ part), count))
