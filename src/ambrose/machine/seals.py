"""Annular seals as the user writes them down: constants, tables, or the geometry from which a flow
model computes them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from ambrose.machine.kinds import (
    Choice,
    Choices,
    Count,
    Damping,
    Length,
    Mass,
    Name,
    PairOf,
    Pressure,
    Quantity,
    Rate,
    Ratio,
    Stiffness,
)
from ambrose.machine.part import Part, to_plain_values

SEAL_COEFFICIENTS = ("K", "k", "C", "c", "M")
SEAL_AXES = ("pressure", "speed", "frequency")
FREQUENCY_DEPENDENCE = ("synchronous", "states")
_STRAIGHT = 1e-6  # how far a table may be off a line over the pressure, of its largest value
Friction = Annotated[
    tuple[float, float], PairOf("plain number", "coefficient, exponent", scalar=False)
]


@dataclass(frozen=True, slots=True, repr=False)
class SealTable(Part):
    """Seal coefficients on a grid: any of the axes pressure [Pa], speed [rad/s], frequency [rad/s],
    each ascending.

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
        return {
            "axes": [name for name, _ in self.axes],
            **{key: to_plain_values(x) for key, x in (*self.axes, *self.values)},
        }


@dataclass(frozen=True, slots=True, repr=False)
class GasSealGeometry(Part):
    """An annular gas seal, smooth or with holes in its stator, from which a bulk-flow model
    computes K, k, C and c.

    Friction of a wall (coefficient, exponent) [-]: f = coefficient Re^exponent, Blasius' smooth
    wall by default. Of the gas' absolute pressures one is given; the operating point's differential
    pressure yields the other.
    """

    length: Annotated[Length, "axial length of the gap"]
    diameter: Annotated[Length, "diameter of the rotor there"]
    inlet_clearance: Annotated[Length, "radial clearance on the high-pressure side"]
    exit_clearance: Annotated[Length, "radial clearance on the low-pressure side"]
    temperature: Annotated[float, Quantity("temperature"), "temperature of the gas, absolute"]
    exit_pressure: Annotated[
        Pressure | None,
        "absolute pressure behind the seal; before it, the point's seal_pressure is added; or "
        "give inlet_pressure",
    ] = None
    inlet_pressure: Annotated[
        Pressure | None,
        "absolute pressure before the seal; behind it, the point's seal_pressure is taken off",
    ] = None
    hole_depth: Annotated[
        Length, "depth of the stator's holes or honeycomb cells; 0: a smooth seal"
    ] = 0.0
    hole_area_ratio: Annotated[Ratio, "area of the holes over the stator's"] = 0.0
    stator_friction: Annotated[
        Friction,
        "Fanning factor coefficient Re^exponent of the stator; the default is a smooth wall's",
    ] = (0.079, -0.25)
    rotor_friction: Annotated[Friction, "the same of the rotor"] = (0.079, -0.25)
    inlet_loss: Annotated[Ratio, "pressure lost at the inlet, in dynamic pressures"] = 0.1
    exit_recovery: Annotated[
        Ratio, "share of the dynamic pressure that comes back behind the exit"
    ] = 0.0
    preswirl: Annotated[
        Ratio, "circumferential speed of the gas at the inlet over the rotor's surface speed"
    ] = 0.0
    speed: Annotated[
        Rate | None, "spin speed for which the flow is computed; default: the operating point's"
    ] = None
    max_frequency: Annotated[
        Rate, "highest whirl frequency at which the coefficients may be asked for"
    ] = 9424.77796076938
    gas_constant: Annotated[
        float, Quantity("specific gas constant"), "specific gas constant; the default is air's"
    ] = 287.05
    viscosity: Annotated[
        float | None, Quantity("viscosity"), "dynamic viscosity of the gas; default: air's"
    ] = None
    compressibility: Annotated[Ratio, "compressibility factor of the gas"] = 1.0


@dataclass(frozen=True, slots=True, repr=False)
class Seal(Part):
    """An annular seal: f = -([[K, k], [-k, K]] x + [[C, c], [-c, C]] x' + M x''), k > 0 drives
    forward whirl.

    A ``table`` replaces the constants it lists; a ``geometry`` replaces K, k, C and c.
    frequency_dependence of either: "synchronous" reads the coefficients at the operating point's
    whirl frequency (by default its speed) and holds them constant; "states" keeps the dependence,
    as a rational function with ``poles`` poles, two states each, in the plant and on the virtual
    rig.
    """

    name: Annotated[Name, "name, different from all other attachments"]
    position: Annotated[Length, "axial position, from the left end"]
    K: Annotated[Stiffness, "direct stiffness"] = 0.0
    k: Annotated[Stiffness, "cross-coupled stiffness, positive where it drives forward whirl"] = 0.0
    C: Annotated[Damping, "direct damping"] = 0.0
    c: Annotated[Damping, "cross-coupled damping"] = 0.0
    M: Annotated[Mass, "added mass"] = 0.0
    reference_pressure: Annotated[
        Pressure | None, "differential pressure at which the coefficients hold"
    ] = None
    scales_with_pressure: Annotated[
        tuple[str, ...],
        Choices(SEAL_COEFFICIENTS),
        "coefficients proportional to the pressure; the others stay",
    ] = ()
    table: Annotated[SealTable | None, "coefficients over pressure, speed, frequency"] = None
    geometry: Annotated[
        GasSealGeometry | None, "geometry and gas, from which K, k, C and c are computed"
    ] = None
    frequency_dependence: Annotated[
        str,
        Choice(FREQUENCY_DEPENDENCE),
        "what becomes of coefficients that depend on the whirl frequency: "
        "constants read at the point's, or states of the plant",
    ] = "synchronous"
    poles: Annotated[
        int, Count(), "poles of the rational function behind the states, two states each"
    ] = 3


def constant_under_pressure(seal: Seal) -> tuple[str, ...]:
    """The coefficients K, k, C, c of a seal that are not zero and stay as they are while others
    follow the pressure.
    """
    tabulated = {} if seal.table is None else dict(seal.table.values)
    stated = [
        name
        for name in SEAL_COEFFICIENTS
        if name != "M" and (name in tabulated or getattr(seal, name) != 0)
    ]
    follow = {
        *seal.scales_with_pressure,
        *(tabulated if seal.table and "pressure" in dict(seal.table.axes) else ()),
    }
    return tuple(name for name in stated if name not in follow) if follow & set(stated) else ()


def not_straight(seal: Seal) -> str:
    """Why, and what to do, where the seal's force is no straight line over the pressure that one
    real block could follow.
    """
    axes = {} if seal.table is None else dict(seal.table.axes)
    values = {} if seal.table is None else dict(seal.table.values)
    over_pressure = len(axes.get("pressure", ())) > 1
    points = "leave the tolerance out and give operating points at several pressures"
    if seal.geometry is not None:
        return f"the flow of [seal.geometry] is not proportional to the pressure; {points}"
    if "M" in seal.scales_with_pressure or (over_pressure and "M" in values):
        return (
            "the added mass follows the pressure, and no port of the plant carries the "
            "acceleration; keep M constant"
        )
    if not (over_pressure or seal.scales_with_pressure):
        return (
            "no coefficient of the seal follows the pressure; name those that do in "
            "scales_with_pressure"
        )
    if seal.frequency_dependence == "states" and (over_pressure or constant_under_pressure(seal)):
        return (
            "the seal's states are not proportional to the pressure; name all coefficients in "
            "scales_with_pressure"
        )
    if over_pressure:
        bent = [
            name
            for name, array in values.items()
            if not _on_a_line(axes["pressure"], array, list(axes).index("pressure"))
        ]
        if bent:
            return (
                f"not on a straight line over the pressure in [seal.table]: {', '.join(bent)}; "
                f"{points}"
            )
    return ""


def _on_a_line(grid: tuple[float, ...], array: object, axis: int) -> bool:
    """Whether a table's array is affine along one axis, to a millionth of its largest value; what
    is ill-formed passes here.
    """
    try:
        rows = np.moveaxis(np.asarray(array, dtype=float), axis, 0)
        share = (np.asarray(grid) - grid[0]) / ((grid[-1] - grid[0]) or 1.0)
        line = rows[0] + np.multiply.outer(share, rows[-1] - rows[0])
        return bool(
            np.abs(rows - line).max(initial=0.0) <= _STRAIGHT * np.abs(rows).max(initial=0.0)
        )
    except (TypeError, ValueError, IndexError):
        return True
