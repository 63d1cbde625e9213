"""Annular seals as the user writes them down: constants, tables, or the geometry from which a flow model computes them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ambrose.machine.part import Part, to_plain_values

SEAL_COEFFICIENTS = ("K", "k", "C", "c", "M")
SEAL_AXES = ("pressure", "speed", "frequency")
FREQUENCY_DEPENDENCE = ("synchronous", "states")


@dataclass(frozen=True, slots=True, repr=False)
class SealTable(Part):
    """Seal coefficients on a grid: any of the axes pressure [Pa], speed [rad/s], frequency [rad/s], each ascending.

    values: coefficient name -> array nested in the order of ``axes``.
    """

    axes: tuple[tuple[str, tuple[float, ...]], ...]
    values: tuple[tuple[str, object], ...]

    def facts(self) -> Mapping[str, Any]:
        axes = {name: len(grid) for name, grid in self.axes}
        return {
            "axes": " x ".join(f"{size} {name}" for name, size in axes.items()),
            "values": [name for name, _ in self.values],
        }

    def to_dict(self, *, defaults: bool = False) -> dict[str, Any]:
        """The axes' names in the order of nesting, then axes and coefficients as lists, SI."""
        return {"axes": [name for name, _ in self.axes], **{key: to_plain_values(x) for key, x in (*self.axes, *self.values)}}


@dataclass(frozen=True, slots=True, repr=False)
class GasSealGeometry(Part):
    """An annular gas seal, smooth or with holes in its stator, from which a bulk-flow model computes K, k, C and c.

    length, diameter (of the rotor), radial clearances at inlet and exit, hole_depth [m]; hole_area_ratio [-] of holes to stator
    wall. Friction of a wall (coefficient, exponent) [-]: f = coefficient Re^exponent, Blasius' smooth wall by default.
    temperature [K] of the gas; its pressure [Pa, absolute] on one side, exit_pressure or inlet_pressure: the operating point's
    differential pressure gives the other. inlet_loss, exit_recovery [-]; preswirl [-] over the surface speed. speed [rad/s] for
    which the flow is computed (None: the operating point's). max_frequency [rad/s]: the highest whirl frequency at which the
    coefficients may be asked for. gas_constant [J/(kg K)], viscosity [Pa s] (None: air's at the temperature) and
    compressibility Z [-] of the gas.
    """

    length: float
    diameter: float
    inlet_clearance: float
    exit_clearance: float
    temperature: float
    exit_pressure: float | None = None
    inlet_pressure: float | None = None
    hole_depth: float = 0.0
    hole_area_ratio: float = 0.0
    stator_friction: tuple[float, float] = (0.079, -0.25)
    rotor_friction: tuple[float, float] = (0.079, -0.25)
    inlet_loss: float = 0.1
    exit_recovery: float = 0.0
    preswirl: float = 0.0
    speed: float | None = None
    max_frequency: float = 9424.77796076938
    gas_constant: float = 287.05
    viscosity: float | None = None
    compressibility: float = 1.0


@dataclass(frozen=True, slots=True, repr=False)
class Seal(Part):
    """An annular seal: f = -([[K, k], [-k, K]] x + [[C, c], [-c, C]] x' + M x''), k > 0 drives forward whirl.

    position [m]; K, k [N/m], C, c [N s/m], M [kg] at ``reference_pressure`` [Pa]. ``scales_with_pressure`` names the
    coefficients proportional to the pressure difference; the others stay. A ``table`` replaces the constants it lists;
    a ``geometry`` replaces K, k, C and c. frequency_dependence of either: "synchronous" reads the coefficients at the operating
    point's whirl frequency (by default its speed) and holds them constant; "states" keeps the dependence, as a rational
    function with ``poles`` poles, two states each, in the plant and on the virtual rig.
    """

    name: str
    position: float
    K: float = 0.0
    k: float = 0.0
    C: float = 0.0
    c: float = 0.0
    M: float = 0.0
    reference_pressure: float | None = None
    scales_with_pressure: tuple[str, ...] = ()
    table: SealTable | None = None
    geometry: GasSealGeometry | None = None
    frequency_dependence: str = "synchronous"
    poles: int = 3
