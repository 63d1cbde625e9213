"""The loop that is tuned: a plant at one operating point with the controller as it runs there,
sampled and late.

The sampled loop is exact and yet rational in a continuous variable: with w = (2/T) (z - 1)/(z + 1)
Tustin's map leaves the controller as it is, and the plant, sampled behind its hold and late by
whole samples, becomes another continuous plant (Franklin, Powell & Workman 1998, sec. 7.3).
Frequency responses are taken at true frequencies: the plant's times hold and delay, the
controller's at (2/T) tan(w T/2); aliasing is left out, as in verification.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ambrose.core.aliasing import FastModes, fast_modes
from ambrose.core.frequency import SchurForm, evaluate, schur_form
from ambrose.core.realisation.balancing import balance_system
from ambrose.core.sampling import c2d, delayed, hold
from ambrose.core.statespace import select
from ambrose.law.timing import Timing
from ambrose.model.plant import Plant
from ambrose.model.static_load import magnet_coefficients


@dataclass(frozen=True, slots=True, eq=False)
class LoopModel:
    """A, B, C, D: currents u to displacements y in the variable w; form: u, f at the bearings -> y,
    q at the bearings, i.

    magnet: k_i (a,) [N/A] and k_s (a,) [N/m]. speed [rad/s]: of the operating point. fast: the
    plant's modes above half the sample rate in these states, right (N, h), left (h, N); None
    without any.
    """

    label: str
    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    form: SchurForm
    magnet: tuple[np.ndarray, np.ndarray]
    timing: Timing | None
    speed: float
    fast: FastModes | None = None

    def response(self, omega: np.ndarray) -> np.ndarray:
        """u, f -> y, q, i at omega (w,) [rad/s]: (w, 3a, 2a), with hold and delay on u."""
        P = evaluate(self.form, 1j * omega)
        if self.timing is not None:
            P[:, :, : P.shape[1] // 3] *= lateness(omega, self.timing)[:, None, None]
        return P


def loop_model(plant: Plant, timing: Timing | None, label: str = "") -> LoopModel:
    """The model of a plant, full or reduced, for a controller that runs with ``timing`` (None:
    continuous).
    """
    part = select(plant.system, plant.named("u"), plant.named("y"))
    A = part.A
    B = part.B
    C = part.C
    D = part.D
    fast = None
    if timing is not None:
        T = timing.sample_time
        fast = fast_modes(A, T)

        # z = (1 + w T/2) / (1 - w T/2) in C (zI - A)^-1 B + D, with E = (A + I)^-1:
        # A_w = 2/T E (A - I),  B_w = 2/sqrt(T) E B,  C_w = 2/sqrt(T) C E,  D_w = D - C E B.
        late = delayed(c2d(part, T), timing.delay_samples)
        E = np.linalg.inv(late.A + np.eye(late.n_states))
        A, B = (2 / T) * E @ (late.A - np.eye(late.n_states)), E @ late.B * (2 / np.sqrt(T))
        C, D = late.C @ E * (2 / np.sqrt(T)), late.D - late.C @ E @ late.B
    A, B, C, t = balance_system(A, B, C)
    if fast is not None:
        # Tustin's map keeps the states but for a factor that they all share: the delay's come
        # first, then the plant's, and the controller's whatever its own are.
        fast = fast.behind(len(A) - len(fast.right)).scaled(t)

    # Responses come from the plant in s, at true frequencies; A to D above serve the poles.
    outer = select(
        plant.system,
        [*plant.named("u"), *plant.bearing_named("f")],
        [*plant.named("y"), *plant.bearing_named("q"), *plant.named("i")],
    )
    form = schur_form(outer.A, outer.B, outer.C, outer.D, expand=True)
    magnet = magnet_coefficients(plant.machine, plant.point)
    return LoopModel(
        label or plant.point.label, A, B, C, D, form, magnet, timing, plant.point.speed, fast
    )


def lateness(omega: np.ndarray, timing: Timing) -> np.ndarray:
    """Hold and delay of the currents at omega (w,) [rad/s], (w,)."""
    T = timing.sample_time
    return np.asarray(hold(omega, T) * np.exp(-1j * omega * T * timing.delay_samples))


def warped(omega: np.ndarray, timing: Timing | None) -> np.ndarray:
    """Where on the w axis a frequency [rad/s] of the sampled loop lies; continuous loops:
    unchanged.
    """
    if timing is None:
        return omega
    T = timing.sample_time
    return np.asarray(2 / T * np.tan(omega * T / 2))


def unwarped(omega: np.ndarray, timing: Timing | None) -> np.ndarray:
    """The inverse of ``warped``."""
    if timing is None:
        return omega
    T = timing.sample_time
    return np.asarray(2 / T * np.arctan(omega * T / 2))
