"""From y and u to the plant: the smallest structure whose predictor leaves white noise, both
estimates, both halves of the record, and a prediction of what was not fitted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter
from scipy.stats import chi2

from ambrose.identification.one_axis.curvature import curvature
from ambrose.identification.one_axis.instruments import (
    Instrumented,
    disagreement,
    follows,
    long_run,
    outside_part,
    solve,
)
from ambrose.identification.one_axis.model import (
    DELAY,
    GAIN,
    LAG,
    STIFFNESS,
    Structure,
    innovations,
    own_polynomial,
)
from ambrose.identification.one_axis.prediction_error import (
    Fit,
    enlarge,
    fit_from,
    fit_plainest,
    settled_after,
)

COLOURS = (0, 1, 2)  # orders of the noise model beyond the Kalman filter's, tried in turn
ACTUATORS = ("auto", "none", "lag")
LEVEL = 0.01  # probability below which a test of the residual fails
ANSWERS = 1e-6  # below which a reference is none
_PART = 0.001  # and below which the two estimates do not agree
_LAG_SHOWS = 3.84  # of twice the gain in log-likelihood, chi-squared with one freedom at 5 %
_COLOUR_SHOWS = 5.99  # with two freedoms
_ROOTS = (0.95, 0.4)  # of the larger noise model, from which it is searched
_WHITE_LAGS = 20  # of the test whether the errors are white; assumed
_AHEAD = 11  # lags of the same test, from now on
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
    spread, size = float(position.std()), float(drive.std())
    y = (position - position.mean()) / spread
    u = (drive - drive.mean()) / size
    z = outside_part(y, u) if reference is None else _normal(reference)
    fit, other, white, share = _smallest(y, u, actuator)
    structure, count = fit.structure, fit.structure.plant
    second = None if z is None else solve(fit, y, u, z)
    formal = _direct_covariance(fit)[:count, :count]
    watched = z if reference is not None and z is not None else u
    stride = _stride(fit)
    chance, followed = _follows_direct(fit, watched, stride)
    answering = 1.0
    if reference is not None:
        ahead = np.concatenate([watched[_AHEAD * stride :], np.zeros(_AHEAD * stride)])
        answering, _ = follows(fit.counted, fit.jacobian, fit.jacobian, ahead[fit.first :], stride)
    way, errors = "direct", fit.errors
    plant = fit.unknowns[:count]
    agree = None if second is None else _agree(fit, second)
    believed = white >= LEVEL and chance >= LEVEL and (agree is None or agree >= _PART)
    exogenous = reference is not None and answering >= ANSWERS
    if not believed and exogenous and second is not None:
        free = follows(
            second.errors[fit.first :],
            fit.jacobian[:, : count + 1],
            second.instruments,
            watched[fit.first :],
            stride,
        )
        if free[0] >= LEVEL:
            way, errors = "instruments", second.errors
            plant = second.plant
            formal = second.covariance
            chance, followed = free
    settled = [_half(fit, part, y, u, z, way) for part in _halves(len(y))]
    parts = [unknowns for unknowns, _, _ in settled]
    noise = np.sqrt(np.diag(formal))
    curved, tangent = curvature(fit, y, u)
    bend = np.abs(tangent) if curved < _PART else np.zeros(count)
    deviations = np.sqrt(noise**2 + _difference(fit, other) ** 2 + bend**2)
    # the halves part by so many of their own deviations, which may be unequal (a chirp's are)
    own = np.sqrt(settled[0][1] ** 2 + settled[1][1] ** 2)
    apart = np.abs(parts[1][:count] - parts[0][:count]) / np.maximum(own, 1e-300)
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
        fit.converged and all(converged for _, _, converged in settled),
    )


def _normal(values: np.ndarray) -> np.ndarray | None:
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


def _agree(fit: Fit, second: Instrumented) -> float:
    return disagreement(fit, second, _FLOOR)


def _halves(n: int) -> tuple[slice, slice]:
    return slice(0, n // 2), slice(n // 2, n)


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
