"""What a least-squares fit is worth: covariance under coloured noise, correlations, goodness of fit, what residuals hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ambrose.core.checks import InvalidInput

_VISIBLE = 1e-12  # of the strongest parameter's effect; and the least eigenvalue of J'J with a unit diagonal
_CONFIDENCE = 0.99
_LONGEST = 4096  # samples of the noise's memory that are looked at


@dataclass(frozen=True, slots=True)
class ResidualTest:
    """Whether the residual of ``signal`` still follows an ``excitation``: correlation (-1..1) at its worst lag [samples]
    against its limit; ``passed`` where it stays within."""

    signal: str
    excitation: str
    correlation: float
    limit: float
    lag: int
    passed: bool


def check_visible(names: Sequence[str], H: np.ndarray, scale: np.ndarray) -> None:
    """Refuse parameters of which the outputs say nothing, alone or together, before a step is made of rounding errors.

    H (q, q) = J'J, scale (q,): the sizes of the parameters. Raises InvalidInput naming them.
    """
    effect = np.sqrt(np.maximum(np.diag(H), 0.0)) * scale
    for name, value in zip(names, effect, strict=True):
        if not value > _VISIBLE * effect.max():
            raise InvalidInput(f"these records say nothing about {name}; excite its axis, or take it as known")
    values, vectors = np.linalg.eigh(H * scale * scale[:, None] / effect / effect[:, None])
    if values[0] < _VISIBLE:
        together = [name for name, part in zip(names, vectors[:, 0], strict=True) if abs(part) > 0.1]
        raise InvalidInput(
            f"these records cannot tell {' from '.join(together)}; excite where they differ, or take all but one as known"
        )


def memory(samples: int) -> int:
    """Over how many samples noise is taken to remember, in a record of ``samples``."""
    return max(2, min(samples // 10, _LONGEST))


def tapered(products: np.ndarray, samples: int) -> np.ndarray:
    """The autocovariance (..., span + 1) under Parzen's window from sums of products at the lags 0 to span."""
    span = products.shape[-1] - 1
    return products / samples * _parzen(np.arange(span + 1) / span)


def _parzen(x: np.ndarray) -> np.ndarray:
    return np.where(x <= 0.5, 1 - 6 * x**2 + 6 * x**3, 2 * (1 - x) ** 3)


def sandwich_covariance(H: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """H^-1 middle H^-1 (q, q), symmetric, with H = J'J (q, q); both scaled by H's diagonal first."""
    size = np.sqrt(np.diag(H))
    inverse = np.linalg.inv(H / size / size[:, None])
    covariance = inverse @ (middle / size / size[:, None]) @ inverse / size / size[:, None]
    return (covariance + covariance.T) / 2


def correlation_of(covariance: np.ndarray) -> np.ndarray:
    """The correlation matrix (q, q) of a covariance (q, q)."""
    size = np.sqrt(np.diag(covariance))
    return covariance / size / size[:, None]


def column_cosine(H: np.ndarray) -> np.ndarray:
    """The cosines (q, q) of the angles between the columns of J, from H = J'J: NOT a correlation, mostly of the other sign."""
    return correlation_of(H)


def parameter_correlation(H: np.ndarray) -> np.ndarray:
    """The parameters' correlation (q, q) from (J'J)^-1, as white noise would make it."""
    size = np.sqrt(np.diag(H))
    return correlation_of(np.linalg.inv(H / size / size[:, None]))


def input_test(
    crossed: np.ndarray, own_r: np.ndarray, own_e: np.ndarray, k: int, signal: str, name: str, tests: int, quiet: bool = False
) -> ResidualTest:
    """Does the residual r (k,) still follow the excitation e (k,), 0 to some lags later? 99 % over all ``tests`` of a run.

    From the sums over k samples of r(t) e(t - lag) (lags,), r(t) r(t - lag) and e(t) e(t - lag) (both of the same length),
    means taken off; quiet: the residual is only rounding. The limit is the normal one with the variance sum_l R_r(l) R_e(l)/k,
    which allows for the colour of both; Ljung (1999), section 16.6.
    """
    from scipy.special import ndtri

    energy = float(np.sqrt(max(own_r[0], 0.0) * max(own_e[0], 0.0)))
    if quiet or energy == 0:
        return ResidualTest(signal, name, 0.0, 1.0, 0, True)
    lags, span, rho = len(crossed) - 1, len(own_r) - 1, crossed / energy
    product = own_r / own_r[0] * own_e / own_e[0] * _parzen(np.arange(span + 1) / span)
    variance = max(float(product[0] + 2 * product[1:].sum()), 0.1) / k
    limit = float(-ndtri((1 - _CONFIDENCE) / 2 / (tests * (lags + 1)))) * variance**0.5
    worst = int(np.argmax(np.abs(rho)))
    return ResidualTest(signal, name, float(rho[worst]), limit, worst, bool(abs(rho[worst]) <= limit))
