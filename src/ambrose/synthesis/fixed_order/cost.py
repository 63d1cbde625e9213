"""What polishing minimises: the p-norm, over frequencies and models of the plant, of the closed loop's singular values.

For M = P11 + P12 K (I - P22 K)^-1 P21 and f = ln(sum sigma_i^p)/p, the derivative is exact: dM = L dK R with
L = P12 (I - K P22)^-1, R = (I - P22 K)^-1 P21, and dK follows from the matrices of K, as structure.py has them
(Apkarian & Noll 2006 work with the subgradients of the largest singular value; the p-norm is smooth).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.linalg as sla

from ambrose.core.frequency import frequency_response
from ambrose.core.lft import GeneralizedPlant
from ambrose.synthesis.fixed_order.structure import Structure

_IGNORED = 1e-3  # share of the p-norm below which a frequency is left out


class Cost:
    """f(x) and its gradient for a list of models without blocks, on one grid."""

    __slots__ = ("P11", "P12", "P21", "P22", "form", "omega", "systems")

    def __init__(self, form: Structure, models: Sequence[GeneralizedPlant], omega: np.ndarray) -> None:
        first = models[0]
        nz, nw = len(first.z), len(first.w)
        values = np.stack([frequency_response(model.system, omega).values for model in models])
        self.form, self.omega = form, omega
        self.P11, self.P12 = values[..., :nz, :nw], values[..., :nz, nw:]
        self.P21, self.P22 = values[..., nz:, :nw], values[..., nz:, nw:]
        self.systems = [
            (m.system.A, m.system.B[:, nw:], m.system.C[nz:], m.system.D[nz:, nw:]) for m in models
        ]  # fmt: skip

    def _response(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """K (w, m, p), X = (sI - A)^-1 B (w, n, p), Y = C (sI - A)^-1 (w, m, n)."""
        A, B, C, D = self.form.matrices(x)
        n = len(A)
        inverse = np.linalg.inv(1j * self.omega[:, None, None] * np.eye(n) - A)
        X = inverse @ B
        return C @ X + D, X, C @ inverse

    def gains(self, x: np.ndarray) -> np.ndarray:
        """Largest singular values (models, w)."""
        K, _, _ = self._response(x)
        E = np.eye(K.shape[2]) - self.P22 @ K
        M = self.P11 + self.P12 @ K @ np.linalg.solve(E, self.P21)
        return np.linalg.norm(M, 2, axis=(2, 3))

    def __call__(self, x: np.ndarray, power: float) -> tuple[float, np.ndarray]:
        """ln of the p-norm, and its gradient (k,)."""
        K, X, Y = self._response(x)
        E = np.eye(K.shape[2]) - self.P22 @ K  # (models, w, p, p)
        R = np.linalg.solve(E, self.P21)
        L = self.P12 + self.P12 @ (K @ np.linalg.solve(E, self.P22))  # P12 (I - K P22)^-1
        M = self.P11 + self.P12 @ (K @ R)
        size = np.linalg.norm(M, axis=(2, 3))
        least = size.max() / np.sqrt(min(M.shape[2:]))  # sigma_max <= |M|_F <= sqrt(rank) sigma_max
        used = size >= least * _IGNORED ** (1 / power)
        U, s, Vh = np.linalg.svd(M[used], full_matrices=False)
        logs = power * np.log(np.maximum(s, 1e-300))
        top = logs.max()
        share = np.exp(logs - top)
        total = share.sum()
        weight = share / total / np.maximum(s, 1e-300)
        G = np.zeros(M.shape, complex)
        G[used] = (U * weight[:, None, :]) @ Vh
        psi = (L.conj().swapaxes(2, 3) @ G @ R.conj().swapaxes(2, 3)).sum(axis=0)  # (w, m, p)
        XH, YH = X.conj().swapaxes(1, 2), Y.conj().swapaxes(1, 2)
        slope = np.block([
            [psi.sum(axis=0).real, (psi @ XH).sum(axis=0).real],
            [(YH @ psi).sum(axis=0).real, (YH @ psi @ XH).sum(axis=0).real],
        ])  # fmt: skip
        gradient = self.form.gradient(x, slope)
        return float((top + np.log(total)) / power), gradient

    def abscissa(self, x: np.ndarray) -> float:
        """The largest real part of any model's closed-loop pole [rad/s]."""
        A, B, C, D = self.form.matrices(x)
        largest = -np.inf
        for Ap, Bp, Cp, Dp in self.systems:
            E = np.linalg.inv(np.eye(len(D)) - D @ Dp)  # u = E (D C_p x + C x_k)
            into = E @ np.hstack([D @ Cp, C])
            y = np.hstack([Cp, np.zeros((len(Cp), len(A)))]) + Dp @ into
            joint = np.vstack([np.hstack([Ap, np.zeros((len(Ap), len(A)))]) + Bp @ into, B @ y])
            joint[len(Ap) :, len(Ap) :] += A
            largest = max(largest, float(sla.eigvals(joint, check_finite=False).real.max()))
        return largest
