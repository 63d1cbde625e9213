"""A seal's frequency dependence in the time domain: its table or its flow as a rational model with
a few states.

    H_d(s) = K_0 + C_0 s + d (s - A)^-1 b,   H_c(s) = k_0 + c_0 s + e (s - A)^-1 b

meet the direct and cross-coupled dynamic stiffness K + j w C and k + j w c of the coefficients. The
poles (``core.rational_fit``) are stable and common to both, and to every pressure and speed of a
table; a seal from geometry has those of its reference pressure. So the model is causal, and its
states keep their meaning while the operating point varies. The linear plant and the virtual rig
hold the same model: q_x' = A q_x + b x and q_y' = A q_y + b y are the states.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from ambrose.core.checks import InvalidInput, invalid
from ambrose.core.rational_fit import RationalFit, fit_on_poles, fit_rational
from ambrose.core.statespace import StateSpace
from ambrose.machine.part import Seal
from ambrose.model.effects.seal import SealCoefficients, coefficients, gas_flow

# [rad/s] of the fit of a seal from geometry, up to its max_frequency
_LOWEST, _POINTS = 2 * np.pi * 2.0, 40


@dataclass(frozen=True, slots=True, eq=False)
class RationalSeal:
    """The model above, n poles: static has K_0, k_0, C_0, c_0 and the added mass M; A (n, n)
    [rad/s], b (n,) [rad/s].

    direct, cross (n,) [N/m]: d and e. error [-]: largest deviation from the coefficients at the
    fitted frequencies, of H_d and H_c each over its largest magnitude.
    """

    static: SealCoefficients
    A: np.ndarray
    b: np.ndarray
    direct: np.ndarray
    cross: np.ndarray
    error: float

    @property
    def n_states(self) -> int:
        """Of the two directions together."""
        return 2 * len(self.b)


def has_states(seal: Seal) -> bool:
    """Whether the frequency dependence of this seal is part of the plant."""
    return seal.frequency_dependence == "states"


def rational(
    seal: Seal, pressure: float = 0.0, speed: float = 0.0, poles: np.ndarray | None = None
) -> RationalSeal:
    """The model at a pressure [Pa] and speed [rad/s], on given poles (n,) [rad/s] or on
    ``poles_of`` the seal there.

    Raises InvalidInput: a seal that depends on no frequency, and as ``seal.coefficients``.
    """
    poles = poles_of(seal, speed) if poles is None else poles
    if seal.geometry is not None and pressure == 0:  # no flow: states without force
        return _model(np.zeros((2, len(poles))), np.zeros(2), np.zeros(2), seal.M, poles, 0.0)
    omega, data, mass = _samples(seal, pressure, speed)
    fit = fit_on_poles(omega, data, poles, slope=seal.geometry is None)
    return _model(fit.residues, fit.constant, fit.slope, mass, poles, float(fit.error.max()))


def poles_of(seal: Seal, speed: float = 0.0) -> np.ndarray:
    """The poles (n,) [rad/s] of the seal's model; the speed [rad/s] counts only for a geometry
    without one of its own.

    Raises InvalidInput.
    """
    if seal.geometry is not None:
        if seal.reference_pressure is None:
            raise invalid(
                f"the reference_pressure of seal {seal.name}",
                "missing",
                "given",
                "the poles are fitted there",
            )
        speed = speed if seal.geometry.speed is None else seal.geometry.speed
        omega, samples, _ = _samples(seal, seal.reference_pressure, speed)
        return _fitted(tuple(omega.tolist()), samples.tobytes(), seal.poles).poles
    axes = dict(seal.table.axes) if seal.table is not None else {}
    if len(axes.get("frequency", ())) < 2:
        raise InvalidInput(
            f"seal {seal.name} has no table over at least two frequencies, and no geometry; give "
            "one of them"
        )
    # common poles of all pressures and speeds of the table; rows that are nothing beside the
    # largest have no say
    data = [
        _samples(seal, pressure, at)[1]
        for pressure in axes.get("pressure", (seal.reference_pressure or 0.0,))
        for at in axes.get("speed", (speed,))
    ]
    rows = np.concatenate(data)
    alive = rows[np.abs(rows).max(axis=1) > 1e-9 * np.abs(rows).max()]
    return fit_rational(_grid(seal), alive if len(alive) else rows, seal.poles, slope=True).poles


def linearised(model: RationalSeal, frequency: float) -> SealCoefficients:
    """The model's coefficients at a whirl frequency [rad/s], to compare with the seal's."""
    eye = np.eye(len(model.b))
    s = 1j * max(frequency, 1e-3)
    # (s - A)^-1 b at s = j w, so that d times it is K + j w C beyond K_0 + C_0 s
    lags = np.linalg.solve(s * eye - model.A, model.b) if len(model.b) else np.zeros(0)
    direct, cross = complex(model.direct @ lags), complex(model.cross @ lags)
    m = model.static
    return replace(
        m,
        K=m.K + direct.real,
        k=m.k + cross.real,
        C=m.C + direct.imag / abs(s),
        c=m.c + cross.imag / abs(s),
    )


def system(model: RationalSeal, name: str) -> StateSpace:
    """The part with states: displacements q_<name>_x, q_<name>_y [m] -> forces h_<name>_x,
    h_<name>_y [N] on the rotor.

    Further outputs d_<name>_x, d_<name>_y, e_<name>_x, e_<name>_y [N]: d (s - A)^-1 b and e (s -
    A)^-1 b of each displacement.
    """
    zero, none = np.zeros_like(model.A), np.zeros_like(model.b)[:, None]
    b = model.b[:, None]
    direct = model.direct
    cross = model.cross
    no = np.zeros_like(model.b)
    # over the states of x, then of y: h, d, e
    C = np.block(
        [[-direct, -cross], [cross, -direct], [direct, no], [no, direct], [cross, no], [no, cross]]
    )
    outputs = [f"{letter}_{name}_{axis}" for letter in "hde" for axis in "xy"]
    A, B = np.block([[model.A, zero], [zero, model.A]]), np.block([[b, none], [none, b]])
    return StateSpace(A, B, C, np.zeros((6, 2)), [f"q_{name}_x", f"q_{name}_y"], outputs)


def parts(model: RationalSeal) -> tuple[tuple[float, float], tuple[float, float]]:
    """(K(0), k(0)), the static stiffness [N/m], and (d A^-1 b, e A^-1 b) [N/m].

    The second times the displacement, and C_0 times the velocity, complete the states' d (s - A)^-1
    b to H(s) - H(0), the part that comes with motion and vanishes at rest.
    """
    if not len(model.b):
        return (model.static.K, model.static.k), (0.0, 0.0)
    still = np.linalg.solve(model.A, model.b)
    direct, cross = float(model.direct @ still), float(model.cross @ still)
    return (model.static.K - direct, model.static.k - cross), (direct, cross)


def lag(x: float, states: np.ndarray, row: np.ndarray) -> float:
    """Derivative [m/s] of one state of a direction, from its displacement [m] and that direction's
    states (n,) [m].

    row (n + 1,): the row of A, then the element of b. Compiles with numba as it stands.
    """
    total = float(row[row.shape[0] - 1] * x)
    for j in range(row.shape[0] - 1):
        total += row[j] * states[j]
    return total


def force(state_x: float, state_y: float, direct: float, cross: float) -> tuple[float, float]:
    """What one state of each direction adds to seal.force (x, y) [N]. Compiles with numba as it
    stands.
    """
    return -(direct * state_x + cross * state_y), -(-cross * state_x + direct * state_y)


def rows(model: RationalSeal) -> np.ndarray:
    """A with b beside it (n, n + 1), as ``lag`` takes it row by row."""
    return np.column_stack([model.A, model.b])


def _grid(seal: Seal) -> np.ndarray:
    if seal.geometry is not None:
        return np.geomspace(_LOWEST, seal.geometry.max_frequency, _POINTS)
    grid = np.asarray(
        dict(seal.table.axes)["frequency"] if seal.table is not None else (), dtype=float
    )
    return grid[grid > 0]


def _samples(seal: Seal, pressure: float, speed: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Frequencies (w,) [rad/s], H_d and H_c there (2, w) [N/m], added mass [kg] at the lowest."""
    omega = _grid(seal)
    if seal.geometry is not None:
        flow, share = gas_flow(seal, pressure, speed, tuple(omega.tolist()))
        impedance = (
            np.zeros((2, len(omega)), dtype=complex)
            if flow is None
            else share * np.array(flow.impedance)
        )
        return omega, impedance, seal.M
    at = [coefficients(seal, pressure, speed, float(w)) for w in omega]
    table = np.array(
        [[c.K + 1j * w * c.C, c.k + 1j * w * c.c] for c, w in zip(at, omega, strict=True)]
    ).T
    return omega, table, at[0].M


@lru_cache(maxsize=64)
def _fitted(omega: tuple[float, ...], data: bytes, poles: int) -> RationalFit:
    return fit_rational(omega, np.frombuffer(data, dtype=complex).reshape(2, -1), poles)


def _model(
    residues: np.ndarray,
    constant: np.ndarray,
    slope: np.ndarray,
    mass: float,
    poles: np.ndarray,
    error: float,
) -> RationalSeal:
    """States in metres: each counts its pole's modulus."""
    # b times |pole| and C over it: in metres b is a rate
    A, b, C = RationalFit(poles, residues, constant, slope, np.zeros(2)).real_form()
    size = np.abs(poles)
    static = SealCoefficients(
        float(constant[0]), float(constant[1]), float(slope[0]), float(slope[1]), mass
    )
    return RationalSeal(static, A, b * size, C[0] / size, C[1] / size, error)
