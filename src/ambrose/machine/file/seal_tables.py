"""The tables [[seal]], [seal.table] and [seal.geometry] of a machine file; see file/tables.py."""

from __future__ import annotations

from typing import Annotated, Any

from ambrose.machine import seals as nouns
from ambrose.machine.file.fields import Choice, Choices, Count, ListOf, NestedOf, PairOf, Quantity
from ambrose.machine.file.table import (
    Damping,
    Length,
    Mass,
    Name,
    Pressure,
    Rate,
    Ratio,
    Stiffness,
    Table,
    optional,
    required,
)

Friction = Annotated[tuple[float, float], PairOf("plain number", "coefficient, exponent", scalar=False)]


class SealTableTable(Table):
    """Coefficients over any of pressure, speed and frequency; a coefficient listed here replaces the seal's constant."""

    axes: Annotated[tuple[str, ...], Choices(nouns.SEAL_AXES)] = optional(
        "order of nesting; default: pressure, speed, frequency"
    )
    pressure: Annotated[tuple[float, ...], ListOf("pressure")] = optional("pressure axis, ascending")
    speed: Annotated[tuple[float, ...], ListOf("angular rate")] = optional("spin speed axis, ascending")
    frequency: Annotated[tuple[float, ...], ListOf("angular rate")] = optional("whirl frequency axis, ascending")
    K: Annotated[Any, NestedOf("stiffness")] = optional("direct stiffness")
    k: Annotated[Any, NestedOf("stiffness")] = optional("cross-coupled stiffness")
    C: Annotated[Any, NestedOf("damping")] = optional("direct damping")
    c: Annotated[Any, NestedOf("damping")] = optional("cross-coupled damping")
    M: Annotated[Any, NestedOf("mass")] = optional("added mass")

    def build(self) -> nouns.SealTable:
        given = self.given()
        order = given.get("axes", nouns.SEAL_AXES)
        axes = tuple((axis, given[axis]) for axis in order if axis in given)
        rest = tuple((axis, given[axis]) for axis in nouns.SEAL_AXES if axis in given and axis not in order)
        return nouns.SealTable(axes + rest, tuple((c, given[c]) for c in nouns.SEAL_COEFFICIENTS if c in given))


class GasSealTable(Table):
    """The seal's geometry and gas, from which the bulk-flow model computes K, k, C and c at every operating point."""

    noun = nouns.GasSealGeometry
    length: Length = required("axial length of the gap")
    diameter: Length = required("diameter of the rotor there")
    inlet_clearance: Length = required("radial clearance on the high-pressure side")
    exit_clearance: Length = required("radial clearance on the low-pressure side")
    temperature: Annotated[float, Quantity("temperature")] = required("temperature of the gas, absolute")
    exit_pressure: Pressure = optional(
        "absolute pressure behind the seal; before it, the point's seal_pressure is added; or give inlet_pressure"
    )
    inlet_pressure: Pressure = optional("absolute pressure before the seal; behind it, the point's seal_pressure is taken off")
    hole_depth: Length = optional("depth of the stator's holes or honeycomb cells; 0: a smooth seal")
    hole_area_ratio: Ratio = optional("area of the holes over the stator's")
    stator_friction: Friction = optional("Fanning factor coefficient Re^exponent of the stator; the default is a smooth wall's")
    rotor_friction: Friction = optional("the same of the rotor")
    inlet_loss: Ratio = optional("pressure lost at the inlet, in dynamic pressures")
    exit_recovery: Ratio = optional("share of the dynamic pressure that comes back behind the exit")
    preswirl: Ratio = optional("circumferential speed of the gas at the inlet over the rotor's surface speed")
    speed: Rate = optional("spin speed for which the flow is computed; default: the operating point's")
    max_frequency: Rate = optional("highest whirl frequency at which the coefficients may be asked for")
    gas_constant: Annotated[float, Quantity("specific gas constant")] = optional("specific gas constant; the default is air's")
    viscosity: Annotated[float, Quantity("viscosity")] = optional("dynamic viscosity of the gas; default: air's")
    compressibility: Ratio = optional("compressibility factor of the gas")


class SealEntry(Table):
    """An annular seal; f = -([[K, k], [-k, K]] x + [[C, c], [-c, C]] x' + M x'')."""

    noun = nouns.Seal
    identity = "name"
    name: Name = required("name, different from all other attachments")
    position: Length = required("axial position, from the left end")
    K: Stiffness = optional("direct stiffness")
    k: Stiffness = optional("cross-coupled stiffness, positive where it drives forward whirl")
    C: Damping = optional("direct damping")
    c: Damping = optional("cross-coupled damping")
    M: Mass = optional("added mass")
    reference_pressure: Pressure = optional("differential pressure at which the coefficients hold")
    scales_with_pressure: Annotated[tuple[str, ...], Choices(nouns.SEAL_COEFFICIENTS)] = optional(
        "coefficients proportional to the pressure; the others stay"
    )
    table: SealTableTable = optional("coefficients over pressure, speed, frequency")
    geometry: GasSealTable = optional("geometry and gas, from which K, k, C and c are computed")
    frequency_dependence: Annotated[str, Choice(nouns.FREQUENCY_DEPENDENCE)] = optional(
        "what becomes of coefficients that depend on the whirl frequency: constants read at the point's, or states of the plant"
    )
    poles: Annotated[int, Count()] = optional("poles of the rational function behind the states, two states each")
