"""From y and u to the plant: the smallest structure whose predictor leaves white noise, both
estimates, both halves of the record, and a prediction of what was not fitted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm, solve_toeplitz
from scipy.signal import lfilter
from scipy.stats import chi2

# The plant of one levitated axis in samples, and the predictor of its displacement.
#
# Between samples, with the input held (zero-order hold),
#
#     y'' = a y + b w(t) + f,    T w' + w = u(t - tau),
#
# a > 0: it falls, with the pole p = sqrt(a); f is a constant force over mass (the weight, an
# offset). T = 0: no actuator. In samples, exactly,
#
#     A(q) y = B(q) u + c + C(q)/D(q) e,    A = 1 - 2 cosh(p h) q^-1 + q^-2,
#
# h the sample time, e white. Process noise (forces) and sensor noise, each white, give C of order 2
# and D = 1: the innovations form of the Kalman filter, whose noise shares the plant's unstable
# pole, so that the predictor
#
#     e = D/C (A y - B u - c)
#
# is stable although the plant is not (Ljung, System Identification, 2nd ed., 1999, sections 4.2 and
# 13.4: the direct method in closed loop, consistent where the noise model holds the truth).
# Coloured forces ask for more of C and D.
#
# Everything here is in the record's own scale: time in samples, y and u over their deviations.


STIFFNESS, GAIN, DELAY, LAG = range(4)  # places of a, b, tau and T among the unknowns
_AHEAD = -0.8  # samples, the smallest delay
_SLOWEST = 0.998  # root of the noise model: a predictor forgets its start in 500 samples


@dataclass(frozen=True, slots=True)
class Structure:
    """What is unknown: ``lag``: a first-order actuator; ``colour``: orders of C beyond 2, and
    of D.

    The unknowns, in this order: a [1/sample^2], b, tau [samples], T [samples] with lag, c, then the
    coefficients of C (2 + colour) and of D (colour) after their leading 1.
    """

    lag: bool = False
    colour: int = 0

    @property
    def plant(self) -> int:
        """How many unknowns are the plant's."""
        return 3 + self.lag

    @property
    def size(self) -> int:
        return self.plant + 3 + 2 * self.colour

    def split(self, unknowns: np.ndarray) -> tuple[np.ndarray, float, np.ndarray, np.ndarray]:
        """The plant's unknowns, c, and the polynomials C and D."""
        noise = unknowns[self.plant + 1 :]
        ahead = 2 + self.colour
        numerator = np.concatenate([[1.0], noise[:ahead]])
        denominator = np.concatenate([[1.0], noise[ahead:]])
        return unknowns[: self.plant], float(unknowns[self.plant]), numerator, denominator


def own_polynomial(stiffness: float) -> np.ndarray:
    """A (3,): 1 - 2 cosh(sqrt(a)) q^-1 + q^-2, with the cosine where a < 0."""
    root = np.sqrt(complex(stiffness))
    return np.array([1.0, -2.0 * np.cosh(root).real, 1.0])


def input_polynomials(plant: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """B over its own denominator (1 with T = 0), from the exact step from sample to sample.

    With tau = d + r samples, 0 <= r < 1, the input of the last sample but one acts for r, the last
    one for the rest:

        x+ = Phi x + Gamma_1 u[k-d-1] + Gamma_0 u[k-d],
        Gamma_0 = integral_0^(1-r) e^(F s) G ds,   Gamma_1 = e^(F (1-r)) integral_0^r e^(F s) G ds.
    """
    stiffness, gain, delay = plant[:3]
    lag = plant[LAG] if len(plant) > LAG else 0.0
    whole = int(np.floor(delay))
    part = delay - whole
    if lag > 0:
        F = np.array([[0, 1, 0], [stiffness, 0, gain], [0, 0, -1 / lag]])
        G = np.array([0, 0, 1 / lag])
    else:
        F = np.array([[0.0, 1.0], [stiffness, 0.0]])
        G = np.array([0.0, gain])
    early, early_step = _step(F, G, 1 - part)
    _, late_step = _step(F, G, part)
    Phi, _ = _step(F, G, 1.0)
    gammas = (early_step, early @ late_step)
    # B from the first Markov parameters: B = (denominator * impulse response), cut at the order
    order = len(F)
    denominator = own_polynomial(stiffness)
    actuator = np.array([1.0, -np.exp(-1 / lag)]) if lag > 0 else np.ones(1)
    whole_denominator = np.convolve(denominator, actuator)
    numerator = np.zeros(whole + order + 2)
    for shift, gamma in enumerate(gammas):
        state = gamma
        markov = np.zeros(order + 1)
        for k in range(order):
            markov[k + 1] = state[0]
            state = Phi @ state
        polynomial = np.convolve(whole_denominator, markov)[: order + 1]
        numerator[whole + shift : whole + shift + order + 1] += polynomial
    return numerator, actuator


def _step(F: np.ndarray, G: np.ndarray, time: float) -> tuple[np.ndarray, np.ndarray]:
    """e^(F t) and integral_0^t e^(F s) G ds."""
    n = len(F)
    block = np.zeros((n + 1, n + 1))
    block[:n, :n] = F
    block[:n, n] = G
    exponential = expm(block * time)
    return exponential[:n, :n], exponential[:n, n]


def equation_error(
    structure: Structure, unknowns: np.ndarray, y: np.ndarray, u: np.ndarray
) -> np.ndarray:
    """A y - B u - c (n,); the first samples, which know no past, are left at 0."""
    plant, constant, _, _ = structure.split(unknowns)
    # u is taken a sample ahead, so that a delay near zero may be searched from both sides
    shifted = plant.copy()
    shifted[DELAY] += 1
    numerator, actuator = input_polynomials(shifted)
    driven = lfilter(numerator, actuator, np.append(u[1:], u[-1]))
    A_y = lfilter(own_polynomial(plant[STIFFNESS]), [1.0], y)
    left = A_y - driven - constant
    left[: len(numerator)] = 0.0
    return np.asarray(left)


def innovations(
    structure: Structure, unknowns: np.ndarray, y: np.ndarray, u: np.ndarray
) -> np.ndarray:
    """e = D/C (A y - B u - c), (n,)."""
    _, _, C, D = structure.split(unknowns)
    return np.asarray(lfilter(D, C, equation_error(structure, unknowns, y, u)))


def largest_root(polynomial: np.ndarray) -> float:
    """Largest magnitude of its roots in z; below 1: the filter 1/polynomial is stable."""
    if len(polynomial) < 2:
        return 0.0
    return float(np.abs(np.roots(polynomial)).max())


def admissible(structure: Structure, unknowns: np.ndarray) -> bool:
    """Whether the predictor is stable, the lag positive, and y not before u but for a skew."""
    plant, _, C, D = structure.split(unknowns)
    if not _AHEAD <= plant[DELAY] < 60 or not abs(plant[STIFFNESS]) < 4:
        return False
    if structure.lag and not 1e-3 < plant[LAG] < 200:
        return False
    return largest_root(C) < _SLOWEST and largest_root(D) < _SLOWEST


# Whether the motion is large enough to see that a magnet is no spring: quadratic and cubic terms of
# the force, and by how much the tangent differs from what a straight plant finds.
#
# F = c (i/s)^2 about a working point is k_s y + k_i i + q_1 y^2 + q_2 y i + q_3 i^2 + cubic terms.
# The cubic ones act on the linear fit like another k_s and k_i, by about the square of motion over
# gap.


_POWERS = ((2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3))  # of y and u


def curvature(fit: Fit, y: np.ndarray, u: np.ndarray) -> tuple[float, np.ndarray]:
    """Probability by chance of what these seven terms explain, and the plant (m,) at the tangent
    less the straight one.

    y, u (n,) in the record's own scale. One step of Gauss and Newton with the terms as further
    unknowns; they enter linearly, so that it is exact but for the plant's own change.
    """
    structure = fit.structure
    plant, _, C, D = structure.split(fit.unknowns)
    shift = max(round(float(plant[DELAY])), 0)
    late = np.concatenate([np.zeros(shift), u[: len(u) - shift]])
    numerator, _ = input_polynomials(np.array([plant[STIFFNESS], 1.0, 0.0]))
    columns = [
        -lfilter(D, C, lfilter(numerator, [1.0], y**power_y * late**power_u))[fit.first :]
        for power_y, power_u in _POWERS
    ]
    jacobian = np.column_stack([fit.jacobian, *columns])
    size = np.sqrt((jacobian**2).sum(axis=0)) + 1e-300
    solution = np.linalg.lstsq(jacobian / size, -fit.counted, rcond=1e-10)[0] / size
    left = fit.counted + jacobian @ solution
    gain = len(left) * float(np.log(np.sum(fit.counted**2) / np.sum(left**2)))
    return float(chi2.sf(gain, len(_POWERS))), solution[: structure.plant]


# The second way, which needs no noise model: instruments made of what drives the loop from outside.
#
# With the predictor's filter kept, the plant's unknowns solve
#
#     sum_k zeta_k e_k = 0,    e = D/C (A y - B u - c),
#
# zeta: what the sensitivities of e would be, were y and u no more than the loop's answers to z, an
# excitation that knows nothing of the noise (Young, Recursive Estimation, 2nd ed., 2011, chapter 9;
# Soderstrom and Stoica, System Identification, 1989, chapter 8 and section 10.5: consistent in
# closed loop whatever colours the noise). z is the recorded reference; where none was recorded, the
# part of u that no linear law of three to ten samples makes of y and of u's own past.


_OWN, _SEEN = 6, 10  # past samples of u and of y in the law that might make u
_BLOCKS = 8  # of the record
_FUNCTIONS = 16  # of Laguerre, over which the loop's answers to z are written
_ROUNDING = 1e-7  # of u's deviation: below it nothing drives the loop from outside
_LONG = 6.0  # lags over n^(1/3) where the residual is coloured
_TURNS = 8  # Newton steps of the instruments' equation, at most
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


# The direct method: the unknowns that make the predictor's errors smallest, by Levenberg and
# Marquardt's steps from the best of a grid of poles and delays.


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
    guesses = []
    y, u = y[:_ENOUGH], u[:_ENOUGH]
    ahead = np.append(u[1:], u[-1])
    for pole in _POLES:
        C = np.convolve([1.0, -np.exp(-pole)], [1.0, -np.exp(-pole)])
        bend = lfilter([1.0, -2.0, 1.0], C, y)
        past = lfilter([0.0, 1.0], C, y)
        level = lfilter([1.0], C, np.ones_like(y))
        for delay in _DELAYS:
            held = np.zeros(delay + 4)
            held[delay + 2 : delay + 4] = 0.5  # of b w, b/2 (q^-1 + q^-2): the double integrator's
            drive = lfilter(held, C, ahead)
            columns = np.column_stack([past, drive, level])
            first = min(len(y) // 5, 20 + int(5 / pole))
            solution = np.linalg.lstsq(columns[first:], bend[first:], rcond=None)[0]
            loss = float(np.mean((bend - columns @ solution)[first:] ** 2))
            stiffness = float(np.arccosh(1 + solution[0] / 2) ** 2) if solution[0] > 0 else 1e-6
            guess = [stiffness, solution[1], delay + 0.3, solution[2], C[1], C[2]]
            guesses.append((loss, np.array(guess)))
    guesses.sort(key=lambda item: item[0])
    return [guess for _, guess in guesses]


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


COLOURS = (0, 1, 2)  # orders of the noise model beyond the Kalman filter's, tried in turn
ACTUATORS = ("auto", "none", "lag")
LEVEL = 0.01  # probability below which a test of the residual fails
ANSWERS = 1e-6  # below which a reference is none
_PART = 0.001  # and below which the two estimates do not agree
_LAG_SHOWS = 3.84  # of twice the gain in log-likelihood, chi-squared with one freedom at 5 %
_COLOUR_SHOWS = 5.99  # with two freedoms
_ROOTS = (0.95, 0.4)  # of the larger noise model, from which it is searched
_WHITE_LAGS = 20  # of the test whether the errors are white; assumed
_AHEAD_OF = 11  # lags of the same test, from now on
_FLOOR = 0.2  # of a deviation: what two estimates may always differ by


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """The plant (m,) in SI, a [1/s^2], b [m/s^2 per unit of u], tau [s] and T [s] with a lag.

    deviations (m,): the larger of ``formal`` and of ``halves``, what the scatter between both
    halves of the record makes of it (each (m,)); covariance (m, m) to match. formal holds what an
    actuator would change that the record does not show, and the magnet's curvature where it shows.
    apart (m,): the halves' difference over its own deviation. answering: probability by chance of
    what the reference later on knows of the residual now; curved: of the curvature; bend (m,): what
    it changes, 0 where it does not show. way: "direct" or "instruments". white, follows:
    probability by chance of the residual's colour, and of its following what drives the loop (of
    u's past where no reference was recorded), with the shares of its variance; agree: of the
    difference between both ways; None: not known. outside: |b| of the second way over its
    deviation, 0 where nothing drives the loop from outside.
    """

    structure: Structure
    plant: np.ndarray
    deviations: np.ndarray
    formal: np.ndarray
    halves: np.ndarray
    covariance: np.ndarray
    way: str
    fit: Fit
    errors: np.ndarray
    white: float
    white_share: float
    follows: float
    follows_share: float
    agree: float | None
    outside: float
    second: np.ndarray | None
    second_deviations: np.ndarray | None
    prediction: Prediction
    scale: np.ndarray
    spread: float  # of y [m]
    apart: np.ndarray
    answering: float
    curved: float
    bend: np.ndarray
    settled: bool  # whether the searches, over the record and its halves, ended in a minimum

    @property
    def is_believable(self) -> bool:
        """Whether the way that was taken passes its tests."""
        if self.way == "instruments":
            return self.follows >= LEVEL
        agree = self.agree is None or self.agree >= _PART
        return self.white >= LEVEL and self.follows >= LEVEL and agree


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """The second half of the record, predicted ``horizon`` [s] ahead from what the first half
    taught: error and what the model expects of it, both rms [m]; still: error of "it stays where it
    is" [m]; times (k,) [s], measured and predicted (k,) [m].
    """

    horizon: float
    error: float
    expected: float
    still: float
    times: np.ndarray
    measured: np.ndarray
    predicted: np.ndarray

    @property
    def excess(self) -> float:
        """Error over what the model expects; 1: as good as it says."""
        return self.error / self.expected


def estimate(
    position: np.ndarray,
    drive: np.ndarray,
    rate: float,
    reference: np.ndarray | None = None,
    *,
    actuator: str = "auto",
) -> Estimate:
    """The plant of one axis from its displacement (n,) [m] and drive (n,), sampled at rate [Hz].

    reference (n,): what drives the loop from outside. actuator: "lag": first order, "none", or
    "auto": one where it shows.
    """
    # the record's own scale; z: what drives the loop from outside
    spread, size = float(position.std()), float(drive.std())
    y = (position - position.mean()) / spread
    u = (drive - drive.mean()) / size
    z = outside_part(y, u) if reference is None else _normal(reference)

    # the direct estimate; other: the same with an actuator, where that does not show
    fit, other, white, share = _smallest(y, u, actuator)
    structure, count = fit.structure, fit.structure.plant
    second = None if z is None else solve(fit, y, u, z)
    formal = _direct_covariance(fit)[:count, :count]

    # whether its residual follows the reference (else u), and answering: the other way round
    watched = z if reference is not None and z is not None else u
    stride = _stride(fit)
    chance, followed = _follows_direct(fit, watched, stride)
    answering = 1.0
    if reference is not None:
        ahead = np.concatenate([watched[_AHEAD_OF * stride :], np.zeros(_AHEAD_OF * stride)])
        answering, _ = follows(fit.counted, fit.jacobian, fit.jacobian, ahead[fit.first :], stride)

    # which of both ways: instruments where the direct way fails its tests and they pass theirs
    way, errors = "direct", fit.errors
    plant = fit.unknowns[:count]
    agree = None if second is None else disagreement(fit, second, _FLOOR)
    believed = white >= LEVEL and chance >= LEVEL and (agree is None or agree >= _PART)
    exogenous = reference is not None and answering >= ANSWERS
    if not believed and exogenous and second is not None:
        second_follows = follows(
            second.errors[fit.first :],
            fit.jacobian[:, : count + 1],
            second.instruments,
            watched[fit.first :],
            stride,
        )
        if second_follows[0] >= LEVEL:
            way, errors = "instruments", second.errors
            plant = second.plant
            formal = second.covariance
            chance, followed = second_follows

    # deviations: noise, an actuator that does not show, curvature; the scatter of both halves
    middle = len(y) // 2
    halves = [_half(fit, part, y, u, z, way) for part in (slice(middle), slice(middle, None))]
    parts = [unknowns for unknowns, _, _ in halves]
    noise = np.sqrt(np.diag(formal))
    curved, tangent = curvature(fit, y, u)
    bend = np.abs(tangent) if curved < _PART else np.zeros(count)
    deviations = np.sqrt(noise**2 + _difference(fit, other) ** 2 + bend**2)
    # the halves part by so many of their own deviations, which may be unequal (a chirp's are)
    deviation = np.sqrt(halves[0][1] ** 2 + halves[1][1] ** 2)
    apart = np.abs(parts[1][:count] - parts[0][:count]) / np.maximum(deviation, 1e-300)
    scatter = apart * noise
    larger = np.maximum(deviations, scatter)
    stretch = larger / np.maximum(noise, 1e-300)
    scale = _scale(structure, rate, spread, size)
    prediction = _predict(structure, parts[0], fit.loss, y, u, rate, spread)
    outside = 0.0
    beside = beside_deviations = None
    if second is not None:
        spreads = np.sqrt(np.diag(second.covariance))
        outside = abs(float(second.plant[GAIN])) / max(float(spreads[GAIN]), 1e-300)
        beside, beside_deviations = second.plant * scale, spreads * scale
    return Estimate(
        structure,
        plant * scale,
        larger * scale,
        deviations * scale,
        scatter * scale,
        formal * np.outer(stretch * scale, stretch * scale),
        way,
        fit,
        errors,
        white,
        share,
        chance,
        followed,
        agree,
        outside,
        beside,
        beside_deviations,
        prediction,
        scale,
        spread,
        apart,
        answering,
        curved,
        bend * scale,
        fit.converged and all(converged for _, _, converged in halves),
    )


def _normal(values: np.ndarray) -> np.ndarray | None:
    """A signal (n,) of mean 0 and deviation 1; None of one that never changes."""
    size = float(values.std())
    return None if size == 0 else (values - values.mean()) / size


def _scale(structure: Structure, rate: float, spread: float, size: float) -> np.ndarray:
    """SI over the record's own units: a in rate^2, b in rate^2 y/u, tau and T in samples."""
    values = [rate**2, rate**2 * spread / size, 1 / rate, 1 / rate]
    return np.array(values[: structure.plant])


def _difference(fit: Fit, other: Fit | None) -> np.ndarray:
    """By how much the plant (m,) would be another with an actuator that does not show."""
    count = fit.structure.plant
    if other is None:
        return np.zeros(count)
    lagged = other.unknowns[:count].copy()
    lagged[DELAY] += other.unknowns[LAG]  # without an actuator its lag counts as delay
    return np.asarray(lagged - fit.unknowns[:count])


def _smallest(y: np.ndarray, u: np.ndarray, actuator: str) -> tuple[Fit, Fit | None, float, float]:
    """The first structure, by size, whose residual is white and to which a larger noise model adds
    nothing; else the one with the best of Schwarz's criterion. Second: the same with an actuator,
    where that was tried and does not show.
    """
    plain = fit_plainest(y, u)
    before = _log_likelihood(plain)
    tried: list[tuple[Fit, Fit | None, float, float]] = []
    for colour in COLOURS:
        if colour:
            larger = Structure(False, colour)
            plain = min(
                (_refit(plain, larger, y, u, root) for root in _ROOTS), key=lambda item: item.loss
            )
            gain = 2 * _log_likelihood(plain) - 2 * before
            if tried[-1][2] >= LEVEL and gain < _COLOUR_SHOWS:
                return tried[-1]
        before = _log_likelihood(plain)
        fit, other = plain, None
        if actuator != "none":
            lagged = _refit(plain, Structure(True, colour), y, u)
            if actuator == "lag" or 2 * (_log_likelihood(lagged) - before) > _LAG_SHOWS:
                fit = lagged
            else:
                other = lagged
        tried.append((fit, other, *whiteness(fit)))
    return next(
        (item for item in reversed(tried) if item[2] >= LEVEL),
        min(tried, key=lambda item: item[0].criterion),
    )


def _log_likelihood(fit: Fit) -> float:
    return -len(fit.counted) / 2 * float(np.log(fit.loss))


def _refit(fit: Fit, structure: Structure, y: np.ndarray, u: np.ndarray, root: float = 0.5) -> Fit:
    """A larger structure, searched from the smaller one's values, over the same samples."""
    return fit_from(structure, enlarge(fit, structure, root), y, u, fit.first)


def whiteness(fit: Fit) -> tuple[float, float]:
    """Ljung and Box (1978) over 20 lags: probability by chance, and the share of the residual's
    variance that its own past tells.
    """
    errors = fit.counted - fit.counted.mean()
    n = len(errors)
    power = float(errors @ errors)
    correlations = np.array(
        [float(errors[lag:] @ errors[:-lag]) / power for lag in range(1, _WHITE_LAGS + 1)]
    )
    lags = np.arange(1, _WHITE_LAGS + 1)
    statistic = n * (n + 2) * float(np.sum(correlations**2 / (n - lags)))
    freedom = _WHITE_LAGS - (2 + 2 * fit.structure.colour)
    # of an autoregression, by the Yule-Walker equations: share = r' R^-1 r
    row = np.concatenate([[1.0], correlations[:-1]])
    share = float(correlations @ solve_toeplitz(row, correlations))
    return float(chi2.sf(statistic, freedom)), share


def _direct_covariance(fit: Fit) -> np.ndarray:
    """The larger, unknown by unknown, of sigma^2 (J'J)^-1 and of what every sample does to the
    estimate.
    """
    normal = np.linalg.pinv(fit.jacobian.T @ fit.jacobian)
    formal = fit.loss * normal
    influence = (fit.jacobian * fit.counted[:, None]) @ normal
    robust = long_run(influence) * len(influence)
    ratio = np.sqrt(np.maximum(np.diag(robust) / np.maximum(np.diag(formal), 1e-300), 1.0))
    return np.asarray(formal * np.outer(ratio, ratio))


def _stride(fit: Fit) -> int:
    """Samples between the lags of a test, so that all of them span three time constants."""
    pole = np.sqrt(max(float(fit.unknowns[STIFFNESS]), 1e-4))
    return int(min(max(1, round(3 / pole / 12)), len(fit.counted) // 100))


def _follows_direct(fit: Fit, watched: np.ndarray, stride: int) -> tuple[float, float]:
    late = np.concatenate([np.zeros(1), watched[:-1]])  # u of now may hold the noise of now
    return follows(fit.counted, fit.jacobian, fit.jacobian, late[fit.first :], stride)


def _half(
    fit: Fit, part: slice, y: np.ndarray, u: np.ndarray, z: np.ndarray | None, way: str
) -> tuple[np.ndarray, np.ndarray, bool]:
    """The unknowns from one half of the record, the plant's deviations (m,), and whether the search
    ended in a minimum.
    """
    structure = fit.structure
    first = settled_after(structure.split(fit.unknowns)[2][1:], len(y[part]))
    half = fit_from(structure, fit.unknowns, y[part], u[part], first)
    unknowns = half.unknowns.copy()
    count = structure.plant
    covariance = _direct_covariance(half)[:count, :count]
    if way == "instruments" and z is not None:
        second = solve(half, y[part], u[part], z[part])
        unknowns[:count] = second.plant
        covariance = second.covariance
    return unknowns, np.sqrt(np.diag(covariance)), half.converged


def _predict(
    structure: Structure,
    unknowns: np.ndarray,
    loss: float,
    y: np.ndarray,
    u: np.ndarray,
    rate: float,
    spread: float,
) -> Prediction:
    """y one time constant ahead, u known: the predictor's errors through the first samples of the
    noise's impulse response, e_h[k] = sum_(j<h) g_j e[k-j], G = C / (A D).
    """
    plant, _, C, D = structure.split(unknowns)
    pole = np.sqrt(max(float(plant[STIFFNESS]), 1e-6))
    n = len(y)
    ahead = int(min(max(1, round(1 / pole)), n // 20))
    impulse = np.zeros(ahead)
    impulse[0] = 1.0
    response = lfilter(C, np.convolve(own_polynomial(plant[STIFFNESS]), D), impulse)
    errors = innovations(structure, unknowns, y, u)
    error = lfilter(response, [1.0], errors)
    half = slice(n // 2, n)
    still = y[half] - y[n // 2 - ahead : n - ahead]
    shown = slice(n // 2, min(n, n // 2 + 12 * ahead))
    return Prediction(
        ahead / rate,
        spread * float(np.sqrt(np.mean(error[half] ** 2))),
        spread * float(np.sqrt(loss * np.sum(response**2))),
        spread * float(np.sqrt(np.mean(still**2))),
        np.arange(n)[shown] / rate,
        spread * y[shown],
        spread * (y - error)[shown],
    )
