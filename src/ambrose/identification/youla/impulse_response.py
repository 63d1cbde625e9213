"""S without a model: its pulse response from alpha and eps by linear least squares, and whether
S(theta) agrees with it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg as sla

from ambrose.core.checks import InvalidInput, check_shape, invalid
from ambrose.core.presentation import Presented
from ambrose.core.response import impulse_response
from ambrose.core.statespace import as_statespace

_MOST = 4000  # unknowns per output


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class FiniteResponse(Presented):
    """Pulse response h (p, m, taps) of S, from the sample of the pulse on, and its standard
    deviations (p, m, taps).

    normal (m * taps, m * taps): the normal matrix, the same for every output; noise (p,): standard
    deviation of what the response does not explain; freedom: samples beyond the unknowns.
    """

    h: np.ndarray
    deviation: np.ndarray
    normal: np.ndarray
    noise: np.ndarray
    freedom: int

    def disagreement(self, system: Any) -> np.ndarray:
        """(p,): mean square distance of a sampled system's response, over what the noise makes;
        about 1 where it is S.

        The ratio follows F(m * taps, freedom) for white noise: a few per cent above 1 is much when
        taps are many.
        """
        p, m, taps = self.h.shape
        expected = impulse_response(as_statespace(system), taps)

        # (h - h_S)' X'X (h - h_S) over the unknowns and the noise's variance
        difference = (self.h - expected).reshape(p, m * taps)
        return (
            np.einsum("pi,ij,pj->p", difference, self.normal, difference)
            / (m * taps)
            / self.noise**2
        )


def finite_response(alpha: np.ndarray, eps: np.ndarray, taps: int) -> FiniteResponse:
    """The response of eps (p, k) to alpha (m, k) over ``taps`` samples, and its noise; offsets are
    taken out.

    Raises InvalidInput where the record is too short or alpha does not excite as many taps. The
    response must have decayed after ``taps``, and the noise be white for the deviations to hold, as
    it is in eps. Ljung (1999), section 4.2.
    """
    alpha = check_shape(alpha, "alpha", "(m, k)")
    m, k = alpha.shape
    eps = check_shape(eps, "eps", "(p, k)", k=k)
    if isinstance(taps, bool) or not isinstance(taps, int | np.integer) or not 1 <= taps:
        raise invalid(
            "taps",
            repr(taps),
            "a whole number from 1",
            "cover the decay of S: 3 / |slowest pole| / dt",
        )
    unknowns = m * taps + 1
    freedom = k - taps + 1 - unknowns
    if freedom < unknowns // 4 or unknowns > _MOST:
        raise invalid(
            "taps",
            taps,
            f"at most {min((k * 4 // 5 - 1) // (m + 1), _MOST // m)} for {k} samples",
            "record longer",
        )
    # (m, k - taps + 1, taps)
    lagged = np.lib.stride_tricks.sliding_window_view(alpha, taps, axis=1)[:, :, ::-1]

    # eps(t) = sum over taps of h(tau) alpha(t - tau); means out for the offset
    X = lagged.transpose(1, 0, 2).reshape(k - taps + 1, m * taps)
    X = X - X.mean(axis=0)
    Y = eps[:, taps - 1 :].T
    Y = Y - Y.mean(axis=0)

    # scaled to a unit diagonal before it is factored
    normal = X.T @ X
    size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    try:
        factor = sla.cho_factor(normal / size / size[:, None])
    except np.linalg.LinAlgError as error:
        raise InvalidInput(
            f"alpha does not excite {taps} taps of every channel; excite longer, or each axis on "
            "its own"
        ) from error
    taps_by_output = sla.cho_solve(factor, X.T @ Y / size[:, None]) / size[:, None]
    noise = np.sqrt(np.sum((Y - X @ taps_by_output) ** 2, axis=0) / freedom)

    # diag((X'X)^-1)^1/2; standard deviations: noise times it
    spread = np.sqrt(np.diag(sla.cho_solve(factor, np.eye(m * taps)))) / size
    p = len(eps)
    shape = (p, m, taps)
    return FiniteResponse(
        taps_by_output.T.reshape(shape),
        np.outer(noise, spread).reshape(shape),
        normal,
        noise,
        freedom,
    )
