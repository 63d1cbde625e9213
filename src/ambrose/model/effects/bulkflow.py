"""Annular gas seals from geometry and operating condition: leakage and K, k, C, c against whirl
frequency.

The two-control-volume bulk-flow model of Kleynhans & Childs (1997, ASME J. Eng. Gas Turbines Power
119, 949-956) and of Ha & Childs (1994), isothermal; with holes of zero depth it is a smooth seal
(Nelson 1985). ``bulkflow_static`` has the zeroth-order flow, ``bulkflow_whirl`` the first-order
one. For the whirl x + j y = r e^{j w t} the clearance changes by -r e^{j(w t - theta)} and the
force on the rotor is

    f_x + j f_y = -pi R int p dz = -Z(w) r e^{j w t},   Z(w) = K + c w + j (C w - k),

so that forward and backward whirl, Z(w) and Z(-w), give the four coefficients. The shear on the
rotor is left out: it is smaller by the clearance over the radius.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import pi

import numpy as np
from numpy.typing import ArrayLike

from ambrose.core.checks import NumericalFailure, check_positive, check_shape, invalid
from ambrose.machine.seals import SealTable
from ambrose.model.effects.bulkflow_static import StaticFlow, Walls, static_flow
from ambrose.model.effects.bulkflow_whirl import whirl_flow

_PRESWIRL = 2.0  # surface speeds; inlet swirl measured on test rigs stays below one
_GRID_ERROR = 1e-3  # between the grid and half of it


@dataclass(frozen=True, slots=True)
class Friction:
    """Blasius' law of a wall: Fanning factor f = coefficient Re^exponent, Re = 2 rho H V/mu, tau =
    f rho V^2/2.
    """

    coefficient: float = 0.079
    exponent: float = -0.25


@dataclass(frozen=True, slots=True)
class SealGeometry:
    """An annular seal: length, rotor diameter, radial clearances, hole_depth [m], hole_area_ratio
    of holes to stator wall [-].

    Friction of the walls (Blasius' smooth wall by default), inlet_loss [-] in p_in - p(0) = (1 +
    inlet_loss) rho W^2/2 and exit_recovery [-], the share of rho W^2/2 that becomes pressure again
    behind the exit.
    """

    length: float
    diameter: float
    inlet_clearance: float
    exit_clearance: float
    hole_depth: float = 0.0
    hole_area_ratio: float = 0.0
    rotor_friction: Friction = field(default_factory=Friction)
    stator_friction: Friction = field(default_factory=Friction)
    inlet_loss: float = 0.1
    exit_recovery: float = 0.0

    def __post_init__(self) -> None:
        for name in ("length", "diameter", "inlet_clearance", "exit_clearance"):
            check_positive(
                getattr(self, name),
                f"the {name} [m] of the seal",
                "give it in metres; clearances are radial",
            )
        for name in ("hole_depth", "hole_area_ratio", "inlet_loss", "exit_recovery"):
            check_positive(
                getattr(self, name),
                f"the {name} of the seal",
                "0 stands for none",
                zero_allowed=True,
            )
        for name in ("hole_area_ratio", "exit_recovery"):
            if getattr(self, name) > 1:
                raise invalid(
                    f"the {name} of the seal",
                    getattr(self, name),
                    "between 0 and 1",
                    "it is a share",
                )
        if 2 * max(self.inlet_clearance, self.exit_clearance) > 0.1 * self.diameter:
            clearance = max(self.inlet_clearance, self.exit_clearance)
            raise invalid(
                "the clearance [m] of the seal",
                clearance,
                "below 5 % of its diameter",
                "check its unit; it is radial",
            )
        for wall in ("rotor_friction", "stator_friction"):
            friction = getattr(self, wall)
            check_positive(
                friction.coefficient,
                f"the coefficient of the seal's {wall}",
                "Blasius' smooth wall has 0.079",
            )
            if not -1 <= friction.exponent <= 1:
                raise invalid(
                    f"the exponent of the seal's {wall}",
                    friction.exponent,
                    "within -1 to 1",
                    "-0.25 is Blasius'",
                )


@dataclass(frozen=True, slots=True)
class Gas:
    """gas_constant [J/(kg K)], viscosity [Pa s], compressibility Z [-]: p = Z gas_constant T
    rho.
    """

    gas_constant: float
    viscosity: float
    compressibility: float = 1.0

    def __post_init__(self) -> None:
        for name in ("gas_constant", "viscosity", "compressibility"):
            check_positive(getattr(self, name), f"the {name} of the gas", "give it in SI units")


def air(temperature: float, compressibility: float = 1.0) -> Gas:
    """Dry air at a temperature [K], viscosity by Sutherland's law (1.716e-5 Pa s at 273.15 K,
    constant 110.4 K).
    """
    T = check_positive(temperature, "the temperature [K] of the air", "give it in kelvin")
    return Gas(
        287.05, 1.716e-5 * (T / 273.15) ** 1.5 * (273.15 + 110.4) / (T + 110.4), compressibility
    )


@dataclass(frozen=True, slots=True)
class SealCondition:
    """Absolute pressures before and behind the seal [Pa], temperature [K], speed [rad/s], and the
    gas.

    preswirl [-]: circumferential velocity of the gas at the inlet over the rotor's surface speed,
    positive with the spin.
    """

    inlet_pressure: float
    exit_pressure: float
    temperature: float
    speed: float
    gas: Gas
    preswirl: float = 0.0

    def __post_init__(self) -> None:
        for name in ("inlet_pressure", "exit_pressure", "temperature"):
            check_positive(
                getattr(self, name), f"the {name} of the seal", "give an absolute value in SI units"
            )
        check_positive(
            self.speed,
            "the speed [rad/s] at the seal",
            "turn the frame so that the spin is positive",
            zero_allowed=True,
        )
        if not self.exit_pressure < self.inlet_pressure:
            required = f"below the inlet pressure {self.inlet_pressure:g}"
            raise invalid(
                "the exit_pressure [Pa] of the seal",
                self.exit_pressure,
                required,
                "swap the sides; the flow would reverse",
            )
        if not abs(self.preswirl) <= _PRESWIRL:
            required = f"within {-_PRESWIRL:g} to {_PRESWIRL:g}"
            raise invalid(
                "the preswirl [-] of the seal",
                self.preswirl,
                required,
                "divide the inlet swirl by the surface speed",
            )
        if self.preswirl and not self.speed:
            raise invalid(
                "the preswirl [-] of the seal",
                self.preswirl,
                "0 at rest",
                "it is a share of the surface speed",
            )


@dataclass(frozen=True, slots=True, eq=False)
class BulkFlow:
    """Coefficients (w,) at the frequencies (w,) [rad/s], K, k [N/m], C, c [N s/m], and the flow
    they belong to.

    f = -([[K, k], [-k, K]] x + [[C, c], [-c, C]] x'). leakage [kg/s]; profiles along z [m]:
    pressure [Pa], swirl and axial velocity [m/s], (s,). exit_mach [-]: isothermal Mach number at
    the exit. reynolds [-]: axial, 2 rho H W/mu. grid_error [-]: largest change of Z(w) from half as
    many cells, relative; the error itself is about a fifteenth of it.
    """

    frequencies: np.ndarray
    K: np.ndarray
    k: np.ndarray
    C: np.ndarray
    c: np.ndarray
    leakage: float
    z: np.ndarray
    pressure: np.ndarray
    swirl: np.ndarray
    axial_velocity: np.ndarray
    exit_mach: float
    reynolds: float
    grid_error: float

    @property
    def effective_damping(self) -> np.ndarray:
        """C - k/w (w,) [N s/m]: negative where the seal drives a forward whirl."""
        return self.C - self.k / self.frequencies

    @property
    def impedance(self) -> tuple[np.ndarray, np.ndarray]:
        """Direct K + j w C and cross-coupled k + j w c (w,) [N/m]."""
        return self.K + 1j * self.frequencies * self.C, self.k + 1j * self.frequencies * self.c


def bulk_flow(
    geometry: SealGeometry, condition: SealCondition, frequencies: ArrayLike, cells: int = 100
) -> BulkFlow:
    """Leakage and frequency-dependent coefficients of an annular gas seal.

    frequencies (w,) [rad/s]: whirl frequencies, positive. cells: of the axial grid, even; the
    result is checked against half of them. Raises InvalidInput (reverse or choked flow among
    others), NumericalFailure (no flow found, or the grid too coarse).
    """
    omega = check_shape(np.atleast_1d(frequencies), "frequencies", "(w,)").astype(float)
    if omega.size == 0 or omega.min() <= 0:
        value = omega.min() if omega.size else "empty"
        raise invalid(
            "the lowest whirl frequency [rad/s]",
            value,
            "positive",
            "take the limit from a low frequency, 1 rad/s say",
        )
    if cells < 4 or cells % 2:
        raise invalid("the number of cells", cells, "even and at least 4", "100 is the default")

    # on the grid and on half as many cells: what changes shows the grid's error
    walls = _walls(geometry, condition)
    flow, Z = _solve(walls, omega, cells)
    _, coarse = _solve(walls, omega, cells // 2)
    error = float(np.max(np.abs(Z - coarse) / np.abs(Z)))
    if not error < _GRID_ERROR:
        raise NumericalFailure(
            f"Z(w) of the seal changes by {error:.1e} from {cells // 2} to {cells} cells, more "
            f"than {_GRID_ERROR:g}; "
            f"use more cells, or stay away from choking (exit Mach number {_mach(walls, flow):.3f})"
        )

    # Z(+-w) = K +- c w + j (+-C w - k); leakage 2 pi R G; Re = 2 rho H W/mu = 2 G/mu
    forward, backward = Z
    return BulkFlow(
        frequencies=omega,
        K=(forward.real + backward.real) / 2,
        k=-(forward.imag + backward.imag) / 2,
        C=(forward.imag - backward.imag) / (2 * omega),
        c=(forward.real - backward.real) / (2 * omega),
        leakage=2 * pi * walls.radius * flow.G,
        z=flow.z,
        pressure=flow.p,
        swirl=flow.U,
        axial_velocity=flow.W,
        exit_mach=_mach(walls, flow),
        reynolds=2 * flow.G / walls.viscosity,
        grid_error=error,
    )


def seal_table(
    geometry: SealGeometry,
    condition: SealCondition,
    frequencies: Sequence[float],
    speeds: Sequence[float] | None = None,
    pressures: Sequence[float] | None = None,
) -> SealTable:
    """K, k, C, c over whirl frequencies [rad/s] and, where given, speeds [rad/s] and pressure drops
    [Pa], for a machine's seal.

    All ascending. A pressure drop is reached by the inlet pressure; the exit pressure stays the
    condition's. Raises as ``bulk_flow``.
    """
    axes: list[tuple[str, tuple[float, ...]]] = []
    for name, points in (("pressure", pressures), ("speed", speeds), ("frequency", frequencies)):
        if points is None:
            continue
        grid = check_shape(points, f"the {name} axis of the seal table", "(n,)").astype(float)
        if grid.size == 0 or (np.diff(grid) <= 0).any():
            raise invalid(
                f"the {name} axis of the seal table",
                grid.tolist(),
                "ascending",
                "sort it and drop repeated values",
            )
        axes.append((name, tuple(grid.tolist())))
    drops = [condition.inlet_pressure - condition.exit_pressure] if pressures is None else pressures
    grids: dict[str, list] = {name: [] for name in "KkCc"}
    for drop in drops:
        for speed in [condition.speed] if speeds is None else speeds:
            at = replace(condition, inlet_pressure=condition.exit_pressure + drop, speed=speed)
            result = bulk_flow(geometry, at, frequencies)
            for name, values in grids.items():
                values.append(getattr(result, name))
    shape = tuple(len(grid) for _, grid in axes)
    return SealTable(
        tuple(axes),
        tuple((name, np.reshape(values, shape).tolist()) for name, values in grids.items()),
    )


def _walls(geometry: SealGeometry, condition: SealCondition) -> Walls:
    surface_speed = 0.5 * geometry.diameter * condition.speed
    gas = condition.gas
    return Walls(
        length=geometry.length,
        radius=0.5 * geometry.diameter,
        H_in=geometry.inlet_clearance,
        H_out=geometry.exit_clearance,
        storage=geometry.hole_area_ratio * geometry.hole_depth,
        stator=(geometry.stator_friction.coefficient, geometry.stator_friction.exponent),
        rotor=(geometry.rotor_friction.coefficient, geometry.rotor_friction.exponent),
        inlet_loss=geometry.inlet_loss,
        exit_recovery=geometry.exit_recovery,
        a2=gas.compressibility * gas.gas_constant * condition.temperature,
        viscosity=gas.viscosity,
        surface_speed=surface_speed,
        inlet_swirl=condition.preswirl * surface_speed,
        p_in=condition.inlet_pressure,
        p_out=condition.exit_pressure,
    )


def _solve(walls: Walls, omega: np.ndarray, cells: int) -> tuple[StaticFlow, np.ndarray]:
    """Zeroth-order flow and Z (2, w) [N/m] for forward and backward whirl."""
    flow = static_flow(walls, cells)
    both = whirl_flow(walls, flow, np.concatenate([omega, -omega]))

    # pi R int p dz = Z r and p = -mean_p r
    return flow, -pi * walls.radius * both.mean_p.reshape(2, -1)  # h = -r


def _mach(walls: Walls, flow: StaticFlow) -> float:
    return float(flow.W[-1] / np.sqrt(walls.a2))
