"""The generalized plant made ready for computing: states, controls and measurements scaled, D22
taken out; and the way back.

States, u and y may be measured in any unit without a change of gamma; the algorithms are not
indifferent. Here the states are balanced, each u is given the size at which its direct effect on z
(the column of D12) has norm 1, each y the size at which the direct effect of w on it (the row of
D21) has norm 1. w and z stay as they are: their sizes are the specification.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ambrose.core.checks import NumericalFailure, invalid
from ambrose.core.frequency import evaluate, schur_form
from ambrose.core.lft import GeneralizedPlant
from ambrose.core.realisation.balancing import balance_system
from ambrose.core.statespace import StateSpace

_SAMPLES = 200  # frequencies at which the unavoidable gain is looked for
# a direct term below this fraction of its channel's largest gain counts as zero
_NEGLIGIBLE = 1e-10
Matrices = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True, slots=True, eq=False)
class ScaledPlant:
    """x' = A x + B1 w + B2 u, z = C1 x + D11 w + D12 u, y = C2 x + D21 w in scaled units, without
    D22.

    A (n, n), B1 (n, q), B2 (n, m), C1 (r, n), C2 (p, n), D11 (r, q), D12 (r, m), D21 (p, q);
    u_scale (m,), y_scale (p,): u = u_scale u_scaled, y_scaled = y_scale y; D22 (p, m) in original
    units; gain: the largest sampled gain from w to z.
    """

    A: np.ndarray
    B1: np.ndarray
    B2: np.ndarray
    C1: np.ndarray
    C2: np.ndarray
    D11: np.ndarray
    D12: np.ndarray
    D21: np.ndarray
    D22: np.ndarray
    u_scale: np.ndarray
    y_scale: np.ndarray
    gain: float

    def dual(self) -> ScaledPlant:
        """The transposed plant: what holds for control there holds for estimation here."""
        return ScaledPlant(
            self.A.T,
            self.C1.T,
            self.C2.T,
            self.B1.T,
            self.B2.T,
            self.D11.T,
            self.D21.T,
            self.D12.T,
            self.D22.T,
            self.y_scale,
            self.u_scale,
            self.gain,
        )

    def in_states(self, T: np.ndarray, inverse: np.ndarray) -> ScaledPlant:
        """In the states x = T x', T (n, n) with its inverse."""
        B1 = inverse @ self.B1
        B2 = inverse @ self.B2
        C1 = self.C1 @ T
        C2 = self.C2 @ T
        return replace(self, A=inverse @ self.A @ T, B1=B1, B2=B2, C1=C1, C2=C2)

    def in_time(self, rate: float) -> ScaledPlant:
        """With time measured in 1/rate, rate in [rad/s]."""
        root = np.sqrt(rate)
        B1 = self.B1 / root
        B2 = self.B2 / root
        C1 = self.C1 / root
        C2 = self.C2 / root
        return replace(self, A=self.A / rate, B1=B1, B2=B2, C1=C1, C2=C2)

    def in_units(self, gamma: float) -> ScaledPlant:
        """With w and z in units in which ``gamma`` is 1."""
        root = np.sqrt(gamma)
        B1 = self.B1 / root
        C1 = self.C1 / root
        D12 = self.D12 / root
        D21 = self.D21 / root
        return replace(self, B1=B1, C1=C1, D11=self.D11 / gamma, D12=D12, D21=D21)

    def extended(self, rows: np.ndarray, columns: np.ndarray, epsilon: float) -> ScaledPlant:
        """With the outputs z' = epsilon rows [x; u] and the inputs [x'; y] += epsilon columns w'
        added; the rest unchanged.

        rows (k, n + m), columns (n + p, l). Every controller has a larger or equal norm on this
        plant than on the original.
        """
        n = len(self.A)
        more_z = len(rows)
        more_w = columns.shape[1]
        rows, columns = epsilon * rows, epsilon * columns
        q, r = self.B1.shape[1], len(self.C1)
        return replace(
            self,
            B1=np.hstack([self.B1, columns[:n]]),
            C1=np.vstack([self.C1, rows[:, :n]]),
            D11=np.block([[self.D11, np.zeros((r, more_w))], [np.zeros((more_z, q + more_w))]]),
            D12=np.vstack([self.D12, rows[:, n:]]),
            D21=np.hstack([self.D21, columns[n:]]),
        )


def check_plant(plant: Any) -> GeneralizedPlant:
    """``plant``, after refusing what is no generalized plant. Raises InvalidInput."""
    if not isinstance(plant, GeneralizedPlant):
        raise invalid(
            "plant",
            type(plant).__name__,
            "a GeneralizedPlant",
            "GeneralizedPlant(system, w, u, z, y) makes one",
        )
    return plant


def scale_plant(plant: GeneralizedPlant) -> ScaledPlant:
    """``plant`` scaled. Raises InvalidInput for a sampled plant and for empty w, u, z or y."""
    for side, what in zip(
        "wuzy", ("disturbance", "control", "performance output", "measurement"), strict=True
    ):
        if not getattr(plant, side):
            raise invalid(
                f"the number of {what} signals {side}", 0, "at least 1", f"name the plant's {side}"
            )
    system = plant.system
    if system.dt is not None:
        raise invalid(
            "the plant's sample time",
            system.dt,
            "None (continuous time)",
            "design in continuous time, sample the controller",
        )
    q, r = len(plant.w), len(plant.z)

    # balanced for the sampled gains, which u and y without a direct term are scaled by
    A, B, C, _ = balance_system(system.A, system.B, system.C)
    gains = _gains(A, B, C, system.D)
    u_scale = _channel_scale(np.linalg.norm(system.D[:r, q:], axis=0), gains[:, :r, q:], axis=1)
    y_scale = _channel_scale(np.linalg.norm(system.D[r:, :q], axis=1), gains[:, r:, :q], axis=2)

    # columns (w, u) of B and rows (z, y) of C in the new units, which change the balance
    B = np.hstack([B[:, :q], B[:, q:] * u_scale])
    C = np.vstack([C[:r], C[r:] * y_scale[:, None]])
    A, B, C, _ = balance_system(A, B, C)

    # A direct term that is rounding beside its channel's gain is no direct term.
    D12, D21 = system.D[:r, q:] * u_scale, system.D[r:, :q] * y_scale[:, None]
    D12[:, np.linalg.norm(D12, axis=0) < _NEGLIGIBLE] = 0.0
    D21[np.linalg.norm(D21, axis=1) < _NEGLIGIBLE] = 0.0
    gain = float(np.linalg.norm(gains[:, :r, :q], axis=(1, 2)).max())
    return ScaledPlant(
        A,
        B[:, :q],
        B[:, q:],
        C[:r],
        C[r:],
        system.D[:r, :q],
        D12,
        D21,
        system.D[r:, q:],
        u_scale,
        y_scale,
        gain,
    )


def _gains(A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray) -> np.ndarray:
    """|P(s)| (w, r + p, q + m) at points near the imaginary axis with the moduli of the poles,
    and at infinity.
    """
    form = schur_form(A, B, C, D)
    moduli = np.abs(form.poles)
    moduli = np.unique(moduli[moduli > 1e3 * form.pole_errors])
    if not moduli.size:
        moduli = np.array([max(1e-3, np.abs(A).max(initial=0.0))])
    return np.abs(np.concatenate([evaluate(form, moduli * np.exp(1.3j)), D[None]]))


def unavoidable(plant: ScaledPlant, at: Sequence[float] = ()) -> float:
    """A gain from w to z below which no controller comes, stabilising or not, whatever the rank of
    D12 and D21.

    At a frequency the loop is P11 + P12 R P21, with R the controller's choice: what P12 does not
    reach or P21 does not see stays, max(|N^H P11|, |P11 M|) with N, M the complements of P12 and
    P21 (Parrott 1978); the largest over some frequencies, those ``at`` [rad/s] among them.
    """
    q, r = plant.B1.shape[1], len(plant.C1)
    D = np.block(
        [[plant.D11, plant.D12], [plant.D21, np.zeros((len(plant.C2), plant.B2.shape[1]))]]
    )
    form = schur_form(plant.A, np.hstack([plant.B1, plant.B2]), np.vstack([plant.C1, plant.C2]), D)

    # frequencies around the poles; those that rounding cannot tell from zero do not count
    moduli = np.abs(form.poles[np.abs(form.poles) > 1e3 * form.pole_errors])
    omega = (
        np.geomspace(0.1 * moduli.min(), 10.1 * moduli.max(), _SAMPLES)
        if moduli.size
        else np.zeros(0)
    )
    largest = 0.0
    for P in np.concatenate([evaluate(form, 1j * np.append(omega, at)), D[None]]):
        # N and M: bases of what P12 does not reach and of what P21 does not see
        P11 = P[:r, :q]
        P12 = P[:r, q:]
        P21 = P[r:, :q]
        left, right = _complement(P12), _complement(P21.conj().T)
        sizes = [
            np.linalg.norm(part, 2) for part in (left.conj().T @ P11, P11 @ right) if part.size
        ]
        rounding = 1e-12 * np.linalg.norm(P11)
        largest = max([largest, *(float(size - rounding) for size in sizes)])
    return largest


def _complement(M: np.ndarray) -> np.ndarray:
    """An orthonormal basis of what M (r, m) does not reach, (r, k), or reaches only by rounding."""
    U, values, _ = np.linalg.svd(M)
    return U[:, int((values > np.finfo(float).eps * len(M) * values.max(initial=0.0)).sum()) :]


def _channel_scale(direct: np.ndarray, gains: np.ndarray, axis: int) -> np.ndarray:
    """1/direct (k,), or 1/(largest gain) where that is negligible, or 1 where there is no gain at
    all.
    """
    largest = np.linalg.norm(gains, axis=axis).max(axis=0)
    size = np.where(direct > _NEGLIGIBLE * largest, direct, largest)
    return 1 / np.where(size > 0, size, 1.0)


def original_controller(
    plant: ScaledPlant, matrices: Matrices, inputs: Sequence[str], outputs: Sequence[str]
) -> StateSpace:
    """The controller for the original plant from one for the scaled plant without D22; states
    balanced.

    Raises NumericalFailure where the loop around D22 has no solution.
    """
    A, B, C, D = original_matrices(plant, matrices)
    A, B, C, _ = balance_system(A, B, C)
    return StateSpace(A, B, C, D, inputs, outputs)


def original_matrices(plant: ScaledPlant, matrices: Matrices) -> Matrices:
    """The matrices for the original plant, in the same controller states. Raises NumericalFailure
    like its caller.
    """
    A, B, C, D = matrices
    D22 = plant.D22 * plant.u_scale * plant.y_scale[:, None]
    E = np.eye(len(D)) + D @ D22  # u = K0 (y - D22 u)
    if np.linalg.svd(E, compute_uv=False).min(initial=1.0) < 1e-12 * max(
        1.0, float(np.abs(E).max())
    ):
        raise NumericalFailure(
            "the controller and D22 form an algebraic loop; increase the back-off a little"
        )

    # u = C x + D (y - D22 u): E u = C x + D y;   x' = A x + B (y - D22 u)
    C, D = np.linalg.solve(E, C), np.linalg.solve(E, D)
    A, B = A - B @ D22 @ C, B - B @ D22 @ D

    # y_scaled = y_scale y, u = u_scale u_scaled
    return (
        A,
        B * plant.y_scale,
        C * plant.u_scale[:, None],
        D * plant.u_scale[:, None] * plant.y_scale,
    )
