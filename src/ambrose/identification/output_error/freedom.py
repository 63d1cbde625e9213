"""What a fit takes out of its own residuals, and the stated variances with them.

r = (I - P) e, P = sum u u' over orthonormal columns u of all that is fitted: J, initial state,
offsets and waves. Of white noise of variance s^2 the autocovariance estimated from r is s^2
(delta_l I - R(l)/k) in the mean, R(l) the sums of products of u that lie l samples apart. The
columns lie where the loop answers, a few percent of all frequencies; there a short record has few
degrees of freedom to lose, and the sandwich estimate comes out small by the share v' R v/k of v'v,
for the combination v of the samples that a parameter is. The share is a matter of frequency: noise
of any colour loses the same at each. (MacKinnon & White 1985 divide by 1 - P_tt for the same
reason, where the samples' noise is independent.)
"""

from __future__ import annotations

import numpy as np
import scipy.fft

from ambrose.core.response import SystemDerivative
from ambrose.core.statespace import StateSpace
from ambrose.identification.output_error import statistics
from ambrose.identification.output_error.lagged_products import coloured_products
from ambrose.identification.output_error.normal_equations import (
    RecordSolution,
    Task,
    explained_columns,
    jacobian_pieces,
)

_LONG = 20_000  # samples from which the share is below a percent or two and not looked for
_MOST = 0.9  # of a variance


def restored(
    middle: np.ndarray,
    loop: StateSpace,
    directions: list[SystemDerivative],
    task: Task,
    part: RecordSolution,
    H: np.ndarray,
) -> np.ndarray:
    """The covariance ``middle`` (q, q) of J'r of one record with what the fit took out of the
    residuals; H (q, q) = J'J of all records.
    """
    if task.samples > _LONG or not len(H):
        return middle

    # H^-1 = L L': L'J has orthonormal rows over all records
    size = np.sqrt(np.diag(H))
    inverse = np.linalg.inv(H / size / size[:, None]) / size / size[:, None]
    J = np.concatenate(list(jacobian_pieces(loop, directions, task, part)), axis=2)
    own = np.tensordot(np.linalg.cholesky(inverse).T, J, 1)
    columns = np.concatenate([own, explained_columns(loop, task)])
    lags = statistics.memory(task.samples)

    # J'(R(l)/k) J, under the window of the residuals' own autocovariance
    taken = coloured_products([J], statistics.tapered(_products(columns, lags), task.samples))

    # v = J H^-1, column i: the share v'Rv/k of v'v of the parameter i
    flat = J.reshape(len(J), -1)
    lost, whole = (
        np.einsum("ij,jk,ki->i", inverse, one, inverse) for one in (taken, flat @ flat.T)
    )
    share = np.clip(lost / np.maximum(whole, 1e-300), 0.0, _MOST)

    # variances over 1 - share, correlations stay; back to the covariance of J'r
    covariance = inverse @ middle @ inverse / np.sqrt((1 - share) * (1 - share)[:, None])
    return np.asarray(H @ covariance @ H)


def _products(columns: np.ndarray, lags: int) -> np.ndarray:
    """Sums (p, p, lags + 1) over columns (c, p, k) and samples of a(t) b(t - lag)."""
    size = scipy.fft.next_fast_len(columns.shape[2] + lags, real=True)
    spectra = np.zeros((columns.shape[1], columns.shape[1], size // 2 + 1), complex)
    for column in columns:
        F = scipy.fft.rfft(column, size, axis=1)
        spectra += F[:, None] * F[None].conj()
    return np.asarray(scipy.fft.irfft(spectra, size, axis=2)[:, :, : lags + 1])
