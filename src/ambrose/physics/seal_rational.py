"""Frequency-dependent seal in the time domain: its tables as a rational model, for simulation.

The table's direct and cross-coupled dynamic stiffness, H_d = K + j w C and H_c = k + j w c, are fitted by

    H(s) = K_0 + C_0 s + sum over i of r_i s/(s + p_i)

with fixed real poles p_i, spread evenly in the logarithm of frequency over the table. Real residues by linear least squares,
relative to the size of H at every frequency. The model is causal and its poles are stable whatever the table says; K_0 is the
static stiffness. Each pole adds two states, the displacements x and y behind a lag. Source of the form: fits of aerodynamic
forces with lag states (Roger 1977), here with H_d and H_c of an isotropic seal.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ambrose.core.checks import InvalidInput, invalid
from ambrose.machine.description import Seal
from ambrose.physics.seal import SealCoefficients, coefficients


@dataclass(frozen=True, slots=True, eq=False)
class RationalSeal:
    """static: K_0, k_0, C_0, c_0 and the added mass M. poles (n,) [rad/s] > 0; direct, cross (n,) [N/m]: residues r_i.

    error [-]: largest deviation of H_d and H_c from the table over the table's frequencies, over the largest of either.
    """

    static: SealCoefficients
    poles: np.ndarray
    direct: np.ndarray
    cross: np.ndarray
    error: float


def rational(seal: Seal, pressure: float = 0.0, speed: float = 0.0, n_poles: int = 2) -> RationalSeal:
    """Fit the seal's table over frequency at a pressure [Pa] and speed [rad/s]; the poles depend on the table alone.

    Without a table over frequency the constants come back, with no poles and no error. The added mass is that at the lowest
    frequency. Raises InvalidInput for fewer than one pole, a table of a single frequency, and as ``seal.coefficients``.
    """
    if n_poles < 1:
        raise invalid("n_poles", n_poles, "at least 1", "2 or 3 suit most seals")
    grid = dict(seal.table.axes).get("frequency") if seal.table is not None else None
    if grid is None:
        return RationalSeal(coefficients(seal, pressure, speed), np.zeros(0), np.zeros(0), np.zeros(0), 0.0)
    w = np.asarray(grid, dtype=float)
    if len(w) < 2:
        raise InvalidInput(f"the table of seal {seal.name} has one frequency; give at least two, or leave the axis out")
    rows = [coefficients(seal, pressure, speed, float(x)) for x in w]
    lowest = w[0] if w[0] > 0 else w[1] / 2
    poles = np.geomspace(lowest, w[-1], n_poles + 2)[1:-1]
    tables = np.array([[c.K + 1j * x * c.C, c.k + 1j * x * c.c] for c, x in zip(rows, w, strict=True)])
    basis = np.stack([np.ones(len(w)), 1j * w, *(1j * w / (1j * w + p) for p in poles)], axis=1)
    fitted = [_least_squares(basis, h) for h in tables.T]
    errors = [np.abs(basis @ r - h).max() for r, h in zip(fitted, tables.T, strict=True)]
    direct, cross = fitted
    static = SealCoefficients(float(direct[0]), float(cross[0]), float(direct[1]), float(cross[1]), rows[0].M)
    size = np.abs(tables).max()
    return RationalSeal(static, poles, direct[2:], cross[2:], float(max(errors) / size) if size > 0 else 0.0)


def linearised(model: RationalSeal, frequency: float) -> SealCoefficients:
    """The model's coefficients at a whirl frequency [rad/s], to compare with the table's."""
    s = 1j * frequency
    lags = s / (s + model.poles)
    direct, cross = complex(model.direct @ lags), complex(model.cross @ lags)
    slopes = model.poles / (frequency**2 + model.poles**2)  # Im(lags)/w, also where w is zero
    return replace(
        model.static,
        K=model.static.K + direct.real,
        k=model.static.k + cross.real,
        C=model.static.C + float(model.direct @ slopes),
        c=model.static.c + float(model.cross @ slopes),
    )


def parameters(model: RationalSeal) -> np.ndarray:
    """One row per pole, (n, 3): pole [rad/s], direct and cross [N/m]. The static part goes to seal.force."""
    return np.stack([model.poles, model.direct, model.cross], axis=1)


def lag(x: float, state: float, p: np.ndarray) -> float:
    """Derivative [m/s] of a pole's lagged displacement [m]; p one row of ``parameters``. Compiles with numba as it stands."""
    return float(p[0] * (x - state))


def force(x: float, y: float, state_x: float, state_y: float, p: np.ndarray) -> tuple[float, float]:
    """What one pole adds to seal.force (x, y) [N]; p one row of ``parameters``. Compiles with numba as it stands."""
    u, v = x - state_x, y - state_y
    return -(p[1] * u + p[2] * v), -(-p[2] * u + p[1] * v)


def _least_squares(basis: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Real factors of the basis' columns (w, m) for a complex target (w,), every frequency weighted by 1/size."""
    size = np.abs(target).max(initial=0.0)
    if size == 0:
        return np.zeros(basis.shape[1])
    weight = size / np.maximum(np.abs(target), 1e-3 * size)
    A = np.concatenate([(basis * weight[:, None]).real, (basis * weight[:, None]).imag])
    b = np.concatenate([(target * weight).real, (target * weight).imag])
    scale = np.linalg.norm(A, axis=0)
    return np.linalg.lstsq(A / scale, b, rcond=1e-12)[0] / scale
