"""What polishing minimises: the p-norm, over frequencies and models of the plant, of the closed
loop's singular values.

For M = P11 + P12 K (I - P22 K)^-1 P21 and f = ln(sum sigma_i^p)/p, the derivative is exact: dM = L
dK R with L = P12 (I - K P22)^-1, R = (I - P22 K)^-1 P21, and dK follows from the matrices of K
(Apkarian & Noll 2006 work with the subgradients of the largest singular value; the p-norm is
smooth).

The controller is block-diagonal, 2 x 2 blocks (one 1 x 1 for an odd order): A_ij = sqrt(w_i w_j)
a_ij, B_i = sqrt(w_i) b_i, C_j = sqrt(w_j) c_j with the modulus w of the block's first poles, and
inputs and outputs scaled to comparable gains, so that all unknowns are numbers of similar size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla

from ambrose.core.frequency import frequency_response, largest_gain
from ambrose.core.lft import GeneralizedPlant
from ambrose.core.statespace import StateSpace
from ambrose.synthesis.fixed_order.structure import decoupled_blocks

_PARALLEL = 1e8  # condition of the eigenvectors above which they give no form


@dataclass(frozen=True, slots=True, eq=False)
class Form:
    """The structure of the controller: mask (n, n) of A's free entries, rate (n,) [rad/s], u_scale
    (m,), y_scale (p,).
    """

    mask: np.ndarray
    rate: np.ndarray
    u_scale: np.ndarray
    y_scale: np.ndarray
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    def controller(self, x: np.ndarray) -> StateSpace:
        """The controller of the unknowns x (k,)."""
        return StateSpace(*self.matrices(x), self.inputs, self.outputs)

    def matrices(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        n = len(self.rate)
        m = len(self.u_scale)
        p = len(self.y_scale)
        count = int(self.mask.sum())
        a, b, c, d = np.split(x, np.cumsum([count, n * p, m * n]))
        root = np.sqrt(self.rate)
        A = np.zeros((n, n))
        A[self.mask] = a
        A *= root[:, None] * root
        B = root[:, None] * b.reshape(n, p) / self.y_scale
        C = self.u_scale[:, None] * c.reshape(m, n) * root
        return A, B, C, self.u_scale[:, None] * d.reshape(m, p) / self.y_scale

    def unknowns(self, A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray) -> np.ndarray:
        """x (k,) of matrices in this form."""
        root = np.sqrt(self.rate)
        return np.concatenate(
            [
                (A / root[:, None] / root)[self.mask],
                (B / root[:, None] * self.y_scale).ravel(),
                (C / self.u_scale[:, None] / root).ravel(),
                (D / self.u_scale[:, None] * self.y_scale).ravel(),
            ]
        )

    def gradient(
        self, dA: np.ndarray, dB: np.ndarray, dC: np.ndarray, dD: np.ndarray
    ) -> np.ndarray:
        """df/dx from df/dA .. df/dD."""
        # df/da = df/dA dA/da: each slope times the size of its entry
        root = np.sqrt(self.rate)
        return np.concatenate(
            [
                (dA * root[:, None] * root)[self.mask],
                (dB * root[:, None] / self.y_scale).ravel(),
                (dC * self.u_scale[:, None] * root).ravel(),
                (dD * self.u_scale[:, None] / self.y_scale).ravel(),
            ]
        )


def block_form(controller: StateSpace) -> tuple[Form, np.ndarray]:
    """The form of a controller and its unknowns: poles in complex pairs, real ones paired by size;
    each block balanced.
    """
    n = controller.n_states
    values, V = np.linalg.eig(controller.A) if n else (np.zeros(0, complex), np.zeros((0, 0)))
    pairs = [i for i in np.argsort(np.abs(values)) if values[i].imag > 0]
    real = [i for i in np.argsort(np.abs(values)) if values[i].imag == 0]

    # Columns of T: Re v and Im v of every complex pair, then the real eigenvectors two by two.
    T = np.zeros((n, n))
    mask = np.zeros((n, n), bool)
    rate = np.zeros(n)
    k = 0
    for i in pairs:
        T[:, k], T[:, k + 1] = V[:, i].real, V[:, i].imag
        mask[k : k + 2, k : k + 2], rate[k : k + 2] = True, abs(values[i])
        k += 2
    for group in [real[j : j + 2] for j in range(0, len(real), 2)]:
        size = len(group)
        T[:, k : k + size] = V[:, group].real
        mask[k : k + size, k : k + size] = True
        rate[k : k + size] = np.maximum(
            np.abs(values[group]), 1e-9 * max(np.abs(values).max(initial=0.0), 1e-300)
        )
        k += size
    # equal poles in series: as 2 x 2 blocks they would be another controller
    if n and np.linalg.cond(T) > _PARALLEL:
        A, B, C, mask, rate = _merged(controller)
    else:
        A = np.linalg.solve(T, controller.A @ T)
        B = np.linalg.solve(T, controller.B)
        C = controller.C @ T

    # Largest gain (m, p) of every entry over the controller's own frequencies.
    omega = np.geomspace(max(rate.min(initial=1.0), 1e-6), max(rate.max(initial=1.0), 1.0), 40)
    gain = np.abs(frequency_response(controller, omega).values).max(axis=0)
    u_scale = np.sqrt(
        np.maximum(gain.max(axis=1), 1e-30) / np.maximum(gain.max(), 1e-30)
    ) * np.sqrt(max(gain.max(), 1e-30))
    y_scale = u_scale.max() / np.maximum(gain.max(axis=0), 1e-30)
    # every state: the same size of input and output in scaled units
    into = np.linalg.norm(B / np.sqrt(rate)[:, None] * y_scale, axis=1)
    out = np.linalg.norm(C / u_scale[:, None] / np.sqrt(rate), axis=0)
    # one number for all states of a block
    into, out = (np.array([np.linalg.norm(v[mask[i]]) for i in range(n)]) for v in (into, out))
    # x = diag(s) x'
    s = np.sqrt(np.maximum(into, 1e-30) / np.maximum(out, 1e-30))  # the same within a block
    A = A * s / s[:, None]
    B = B / s[:, None]
    C = C * s
    form = Form(mask, rate, u_scale, y_scale, controller.inputs, controller.outputs)
    return form, form.unknowns(np.where(mask, A, 0.0), B, C, controller.D)


def _merged(
    controller: StateSpace,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A, B, C, mask and rate, poles that cannot be separated in larger blocks
    (core/realisation/modal_form).
    """
    parts = decoupled_blocks(controller, np.arange(controller.n_states))
    A = sla.block_diag(*[p[0] for p in parts])
    B = np.vstack([p[1] for p in parts])
    C = np.hstack([p[2] for p in parts])
    mask = sla.block_diag(*[np.ones_like(p[0], bool) for p in parts])
    moduli = [np.abs(np.linalg.eigvals(p[0])) for p in parts]
    return (
        A,
        B,
        C,
        mask,
        np.maximum(np.concatenate(moduli), 1e-9 * max(size.max() for size in moduli)),
    )


class Cost:
    """f(x) and its gradient for a list of models without blocks, on one grid."""

    __slots__ = ("P11", "P12", "P21", "P22", "form", "omega", "systems")

    def __init__(self, form: Form, models: Sequence[GeneralizedPlant], omega: np.ndarray) -> None:
        first = models[0]
        nz, nw = len(first.z), len(first.w)
        values = np.stack([frequency_response(model.system, omega).values for model in models])
        self.form, self.omega = form, omega
        self.P11, self.P12 = values[..., :nz, :nw], values[..., :nz, nw:]
        self.P21, self.P22 = values[..., nz:, :nw], values[..., nz:, nw:]
        self.systems = [
            (m.system.A, m.system.B[:, nw:], m.system.C[nz:], m.system.D[nz:, nw:]) for m in models
        ]

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
        return largest_gain(M)

    def __call__(self, x: np.ndarray, power: float) -> tuple[float, np.ndarray]:
        """ln of the p-norm, and its gradient (k,)."""
        K, X, Y = self._response(x)

        # R = (I - P22 K)^-1 P21, L = P12 (I + K (I - P22 K)^-1 P22), M = P11 + P12 K R
        E = np.eye(K.shape[2]) - self.P22 @ K  # (models, w, p, p)
        R = np.linalg.solve(E, self.P21)
        L = self.P12 + self.P12 @ (K @ np.linalg.solve(E, self.P22))  # P12 (I - K P22)^-1
        M = self.P11 + self.P12 @ (K @ R)

        size = np.linalg.norm(M, axis=(2, 3))
        largest = float(largest_gain(M.reshape(-1, *M.shape[2:])[size.argmax()]))
        # the others add nothing: sigma_max <= |M|_F <= sqrt(8) sigma_max
        used = size >= max(0.35 * size.max(), largest * 1e-17 ** (1 / power))
        N = M[used]

        # sigma^2 and one side's singular vectors from the smaller of N N^H and N^H N.
        wide = N.shape[1] < N.shape[2]
        squares, V = np.linalg.eigh(
            N @ N.conj().swapaxes(1, 2) if wide else N.conj().swapaxes(1, 2) @ N
        )
        # what squaring loses lies far below the largest, and does not count
        s = np.sqrt(np.maximum(squares, 1e-300))

        # sum sigma^p over the largest sigma^p, for the powers to stay in range
        logs = power * np.log(s)
        top = logs.max()
        share = np.exp(logs - top)
        total = share.sum()

        # G = df/dM = U diag(sigma^(p-1)) V^H / sum sigma^p
        #   = U diag(sigma^(p-2)) U^H N / sum, or N V diag(sigma^(p-2)) V^H / sum
        V_weighted = (V * (share / total / s**2)[:, None, :]) @ V.conj().swapaxes(1, 2)
        G = np.zeros(M.shape, complex)
        G[used] = V_weighted @ N if wide else N @ V_weighted

        # dM = L dK R, all models with one K;   dK = dD + dC X + Y dB + Y dA X
        psi = (L.conj().swapaxes(2, 3) @ G @ R.conj().swapaxes(2, 3)).sum(axis=0)  # (w, m, p)
        XH, YH = X.conj().swapaxes(1, 2), Y.conj().swapaxes(1, 2)
        dA = (YH @ psi @ XH).sum(axis=0).real
        dB, dC = (YH @ psi).sum(axis=0).real, (psi @ XH).sum(axis=0).real
        gradient = self.form.gradient(dA, dB, dC, psi.sum(axis=0).real)
        return float((top + np.log(total)) / power), gradient

    def abscissa(self, x: np.ndarray) -> float:
        """The largest real part of any model's closed-loop pole [rad/s]."""
        A, B, C, D = self.form.matrices(x)
        largest = -np.inf
        for Ap, Bp, Cp, Dp in self.systems:
            E = np.linalg.inv(np.eye(len(D)) - D @ Dp)  # u = E (D C_p x + C x_k)
            into = E @ np.hstack([D @ Cp, C])

            # y = C_p x + D_p u
            y = np.hstack([Cp, np.zeros((len(Cp), len(A)))]) + Dp @ into

            # x' = A_p x + B_p u,   x_k' = A x_k + B y
            joint = np.vstack([np.hstack([Ap, np.zeros((len(Ap), len(A)))]) + Bp @ into, B @ y])
            joint[len(Ap) :, len(Ap) :] += A
            largest = max(largest, float(sla.eigvals(joint, check_finite=False).real.max()))
        return largest
