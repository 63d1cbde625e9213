"""The controller at one point of the parameters from R and S there: explicit, thus as smooth in the
parameter as they are.

With N M^T = I - S R the controller's states are common to all values, and no rate of the parameter
enters, when M does not depend on it (R constant) or N does not (S constant): the terms S R' + N
M'^T cancel. Sources: Gahinet 1996, Automatica 32 (explicit formulas); Apkarian & Adams 1998, IEEE
Trans. Control Systems Technology 6, sec. III ("practically valid" choices).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ambrose.annexes.scheduled.lpv.inequalities import Lyapunov, Varying
from ambrose.core.checks import NumericalFailure
from ambrose.core.hinf.riccati import normal_form
from ambrose.core.hinf.scaling import Matrices, ScaledPlant


@dataclass(frozen=True, slots=True, eq=False)
class Factors:
    """M (n, n) for a constant R, or N for a constant S; the other one follows from N M^T = I - S
    R.
    """

    lyapunov: Lyapunov
    varying: Varying
    fixed: np.ndarray

    def at(self, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """N and M (n, n) at the relative parameters (d,)."""
        R, S = self.lyapunov.at(p)
        E = np.eye(len(R)) - S @ R
        if self.varying == "R":
            return self.fixed, np.linalg.solve(self.fixed, E).T
        return np.linalg.solve(self.fixed, E.T).T, self.fixed

    def certificate(self, p: np.ndarray) -> np.ndarray:
        """The closed loop's Lyapunov matrix X (2n, 2n) in the states (plant, controller)."""
        # X [R I; M^T 0] = [I S; 0 N^T] gives X = [S N; N^T -N^T R M^-T], symmetric up to rounding.
        R, S = self.lyapunov.at(p)
        N, M = self.at(p)
        lower = -np.linalg.solve(M, (R @ N)).T  # -N^T R M^-T
        return np.block([[S, N], [N.T, (lower + lower.T) / 2]])

    def certificate_moved(self, p: np.ndarray, rates: np.ndarray) -> np.ndarray:
        """dX/dt (2n, 2n) while the parameters move at ``rates`` (d,), exact."""
        dR, dS = self.lyapunov.moved(p, rates)
        R, S = self.lyapunov.at(p)
        N, M = self.at(p)

        # E = I - S R = N M^T:   E' = -(S' R + S R') = N' M^T + N M'^T, one of N' and M' being zero
        dE = -(dS @ R + S @ dR)
        zero = np.zeros_like(dE)
        dN, dM = (
            (zero, np.linalg.solve(N, dE).T)
            if self.varying == "R"
            else (np.linalg.solve(M, dE.T).T, zero)
        )

        # (-N^T R M^-T)' = -(N^T R' + N'^T R) M^-T - lower M'^T M^-T
        lower = -np.linalg.solve(M, R @ N).T
        slope = -np.linalg.solve(M, dR @ N + R @ dN).T - np.linalg.solve(M, dM @ lower.T).T
        return np.block([[dS, dN], [dN.T, (slope + slope.T) / 2]])


def factors(lyapunov: Lyapunov, varying: Varying) -> Factors:
    """N and M share the singular values evenly at mid-range. Raises NumericalFailure when I - S R
    is singular there.
    """
    R, S = lyapunov.at(np.zeros(len(lyapunov.shape.largest)))

    # I - S R = U s V^T:   N = U s^1/2, M = V s^1/2
    U, s, Vt = np.linalg.svd(np.eye(len(R)) - S @ R)
    if len(s) and not s[-1] > 1e-12 * s[0]:
        raise NumericalFailure(
            "R S is I in some direction: the controller would need infinitely fast poles"
        )
    return Factors(lyapunov, varying, U * np.sqrt(s) if varying == "R" else Vt.T * np.sqrt(s))


def controller(plant: ScaledPlant, point: Factors, p: np.ndarray) -> Matrices:
    """(A, B, C, D) at gamma = 1 for a scaled plant at the relative parameters p (d,). Raises
    NumericalFailure.

    With D first put into the plant (A + B2 D C2 for A, and so on) and hats for what the
    inequalities determine,

        A_k = N^-1 (A_hat - S A R - B_hat C2 R - S B2 C_hat) M^-T,    B_k = N^-1 B_hat,
        C_k = C_hat M^-T,

    where B_hat and C_hat solve the two bordered systems of linear equations and A_hat makes the
    off-diagonal block vanish (Apkarian & Adams 1998, whose X and Y are S and R here; Gahinet 1996).
    """
    R, S = point.lyapunov.at(p)
    N, M = point.at(p)

    # D first: A + B2 D C2, B1 + B2 D D21, C1 + D12 D C2, D11 + D12 D D21; what is left has no D.
    D = _direct(plant)
    A, B1 = plant.A + plant.B2 @ D @ plant.C2, plant.B1 + plant.B2 @ D @ plant.D21
    C1, D11 = plant.C1 + plant.D12 @ D @ plant.C2, plant.D11 + plant.D12 @ D @ plant.D21
    r, q = D11.shape

    # B_hat from [0 [D21 0]; [D21 0]^T -inner] [B_hat^T; *] = -[C2; B1^T S; C1]
    inner = np.block([[np.eye(q), -D11.T], [-D11, np.eye(r)]])
    B_hat = _bordered(plant.D21, inner, plant.C2, np.vstack([B1.T @ S, C1])).T

    # C_hat the same way from [0 [D12^T 0]; [D12^T 0]^T -flipped] [C_hat; *] = -[B2^T; C1 R; B1^T]
    flipped = np.block([[np.eye(r), -D11], [-D11.T, np.eye(q)]])
    C_hat = _bordered(plant.D12.T, flipped, plant.B2.T, np.vstack([C1 @ R, B1.T]))

    # A_hat = -A^T - [S B1 + B_hat D21, C1^T] inner^-1 [B1^T; C1 R + D12 C_hat]
    left = np.hstack([S @ B1 + B_hat @ plant.D21, C1.T])
    right = np.vstack([B1.T, C1 @ R + plant.D12 @ C_hat])
    A_hat = -A.T - left @ np.linalg.solve(inner, right)

    # back from the hats: A_k = N^-1 (..) M^-T, B_k = N^-1 B_hat, C_k = C_hat M^-T
    A_k = A_hat - S @ A @ R - B_hat @ plant.C2 @ R - S @ plant.B2 @ C_hat
    return (
        np.linalg.solve(N, np.linalg.solve(M, A_k.T).T),
        np.linalg.solve(N, B_hat),
        np.linalg.solve(M, C_hat.T).T,
        D,
    )


def _direct(plant: ScaledPlant) -> np.ndarray:
    """D with |D11 + D12 D D21| < 1: the central one of Parrott's theorem. Raises
    NumericalFailure.
    """
    # D11 in blocks [D_11 D_12; D_21 D_22], the last rows reached by u, the last columns seen by y.
    normal, T_u, T_y = normal_form(plant)
    k, j = len(plant.C1) - plant.B2.shape[1], plant.B1.shape[1] - len(plant.C2)
    D = normal.D11

    # No D changes the first rows or the first columns.
    for part in (D[:k], D[:, :j]):
        if part.size and np.linalg.norm(part, 2) >= 1:
            raise NumericalFailure(
                "gamma is below what the plant lets through at infinite frequency; increase the "
                "back-off"
            )

    # -D_21 D_11^T (I - D_11 D_11^T)^-1 D_12 - D_22, then out of the normal form's u and y
    core = np.eye(k) - D[:k, :j] @ D[:k, :j].T
    central = -D[k:, :j] @ D[:k, :j].T @ np.linalg.solve(core, D[:k, j:]) - D[k:, j:]
    return T_u @ central @ T_y


def _bordered(
    corner: np.ndarray, inner: np.ndarray, first: np.ndarray, rest: np.ndarray
) -> np.ndarray:
    """X (p, n) of [0 [corner 0]; [corner 0]^T -inner] [X; *] = -[first; rest], corner (p, q)."""
    p, k = len(corner), len(inner)

    # second row: * = inner^-1 (edge^T X + rest);   first row:
    # edge inner^-1 edge^T X = -(first + edge inner^-1 rest)
    edge = np.hstack([corner, np.zeros((p, k - corner.shape[1]))])
    weighted = np.linalg.solve(inner, np.hstack([edge.T, rest]))
    return -np.linalg.solve(edge @ weighted[:, :p], first + edge @ weighted[:, p:])
