"""mu of a real matrix with one repeated real block, which is an eigenvalue.

With Delta = delta I and delta real, det(I - delta M) = 0 says that 1/delta is an eigenvalue of M:
mu(M) is the largest modulus of its real eigenvalues, 0 where it has none (Zhou, Doyle & Glover
1996, sec. 11.2, there for the complex block and the spectral radius). The scalings of upper.py
reach that bound only where they may grow without limit.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg as sla

_ROUNDING = 10 * np.finfo(float).eps  # times n: of the norm of M, what eig solves exactly


def real_eigenvalue_bound(M: np.ndarray) -> float:
    """An upper bound of the largest |real eigenvalue| of real M (n, n), above it by rounding alone.

    A simple eigenvalue moves by at most its condition times the rounding error. Two real ones
    that nearly coincide may come out as a complex pair: a pair counts as real where rounding
    makes M - Re(lambda) I singular.
    """
    size = float(np.linalg.norm(M, 2))
    if size == 0:
        return 0.0
    error = _ROUNDING * len(M) * size
    values, left, right = sla.eig(M, left=True, right=True)

    # condition 1/|y^H x| of unit vectors; with a defective eigenvalue it is infinite, and the
    # modulus of all that may be real is at most the norm
    overlap = np.abs(np.einsum("ij,ij->j", left.conj(), right))
    with np.errstate(divide="ignore"):
        moved = error / overlap
    real = values.imag == 0
    for k in np.flatnonzero(~real):
        shifted = M - values[k].real * np.eye(len(M))
        real[k] = np.linalg.svd(shifted, compute_uv=False)[-1] <= error + moved[k]
    return float(min(size, (np.abs(values) + moved)[real].max(initial=0.0)))
