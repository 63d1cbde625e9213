"""The tables of a machine file as pydantic models: which keys a table has, what each takes, and the noun it becomes.

Keys that may be left out have no default here: description.py has the defaults, and only what a file gives is passed on.
"""

from __future__ import annotations

from typing import Annotated, Any, get_args

from pydantic import Field, ValidationInfo, field_validator
from pydantic_core import PydanticCustomError

from ambrose.core.checks import InvalidInput
from ambrose.machine import description as nouns
from ambrose.machine.file.fields import Choice, Count, ListOf, PairOf, Quantity, Text, Version
from ambrose.machine.file.seal_tables import SealEntry
from ambrose.machine.file.table import (
    Angle,
    Current,
    Damping,
    Force,
    ForcePerCurrentPair,
    Inertia,
    Length,
    Mass,
    Name,
    Pressure,
    Rate,
    Ratio,
    Stiffness,
    StiffnessPair,
    Table,
    Time,
    Words,
    optional,
    required,
)
from ambrose.machine.parameters import AMPLIFIER_PARAMETERS, parse_parameter


class MachineTable(Table):
    """The machine as a whole."""

    version: Annotated[int, Version(nouns.SCHEMA_VERSION)] = Field(alias="schema", description="version of the file format")
    name: Name = required("name of the machine")
    description: Words = optional("what it is, in a sentence")
    source: Words = optional("where its figures come from")
    beam_theory: Annotated[str, Choice(nouns.BEAM_THEORIES)] = optional("theory of the shaft's beam elements")
    modal_damping: Ratio = optional("damping ratio of every bending mode")
    gravity_direction: Angle = optional(
        "where the rotor's weight points, from the global x towards y; default: no weight; for the virtual rig"
    )
    assumed: dict[str, Any] = optional("key = reason, for every figure that was chosen and is neither measured nor published")


class MaterialTable(Table):
    """A material, [material.NAME], that shaft sections refer to by name."""

    noun = nouns.Material
    density: Annotated[float, Quantity("density")] = optional("mass density")
    youngs_modulus: Annotated[float, Quantity("elastic modulus")] = optional("Young's modulus")
    poisson_ratio: Ratio = optional("Poisson's ratio")


class ShaftTable(Table):
    """A cylindrical piece of shaft; the sections follow each other from the left end to the right."""

    noun = nouns.ShaftSection
    length: Length = required("axial length")
    outer_diameter: Length = required("outer diameter, for the stiffness")
    inner_diameter: Length = optional("bore")
    mass_diameter: Length = optional(
        "outer diameter for the mass, where laminations add mass without stiffness; default: outer_diameter"
    )
    elements: Annotated[int, Count()] = optional("number of finite elements")
    material: Annotated[str, Text("the name of a [material.NAME] table")] = optional(
        "name of a [material.NAME] table; default: steel"
    )
    start: Length = optional("where the section starts; default: the end of the previous one")
    label: Words = optional("a name for drawings and messages")


class DiscTable(Table):
    """A rigid disc on the shaft: an impeller, a wheel, a thrust collar."""

    noun = nouns.Disc
    identity = "name"
    name: Name = required("name, different from all other attachments")
    position: Length = required("axial position of its centre of mass, from the left end")
    mass: Mass = required("mass")
    polar_inertia: Inertia = optional("moment of inertia about the shaft's axis")
    diametral_inertia: Inertia = optional("moment of inertia about a diameter through its centre of mass")


class GeometryTable(Table):
    """The magnet's geometry, from which its coefficients are computed when they are not given."""

    noun = nouns.MagnetGeometry
    turns: Annotated[float, Quantity("plain number")] = required("turns of one horseshoe")
    pole_area: Annotated[float, Quantity("area")] = required("area of one pole face")
    gap: Length = required("nominal radial air gap")
    pole_half_angle: Angle = optional("half the angle between the two poles of a horseshoe")


class IronTable(Table):
    """The magnet's iron, whose flux density levels off; for the virtual rig and for coefficients from geometry."""

    noun = nouns.MagnetIron
    turns: Annotated[float, Quantity("plain number")] = required("turns of one horseshoe, both of its poles together")
    flux_density: Annotated[float, Quantity("magnetic flux density")] = required(
        "flux density in the air gap that full saturation never passes"
    )
    equivalent_gap: Length = required("air gap that the unsaturated iron is worth, its path length/(2 mu_r)")


class TouchdownTable(Table):
    """Contact in the touchdown bearing, for the virtual rig."""

    noun = nouns.Touchdown
    stiffness: Stiffness = optional("contact stiffness; the default is assumed")
    damping: Damping = optional("contact damping; the default is assumed")
    friction: Ratio = optional("Coulomb friction; the default is assumed")
    radius: Length = optional("radius of the contact; default: the shaft's there")
    sliding_speed: Annotated[float, Quantity("velocity")] = optional("sliding speed below which friction fades to zero")


class MeasuredTable(Table):
    """Coefficients measured at another bias current."""

    noun = nouns.BiasPoint
    identity = "bias_current"
    bias_current: Current = required("bias current of the measurement")
    force_per_current: ForcePerCurrentPair = required("force per control current, k_i")
    negative_stiffness: StiffnessPair = required("negative stiffness k_s, positive where it destabilises")


class BearingTable(Table):
    """A radial magnetic bearing with two axes; f = k_i i + k_s x on each."""

    noun = nouns.MagneticBearing
    identity = "name"
    name: Name = required("name, first part of its axes' names: A gives A_zeta and A_eta")
    position: Length = required("axial position of the magnets' middle, from the left end")
    bias_current: Current = required("bias (premagnetisation) current")
    angle: Angle = optional("angle of the axis zeta from the global x")
    force_per_current: ForcePerCurrentPair = optional(
        "force per control current k_i at bias_current; or give geometry or measured"
    )
    negative_stiffness: StiffnessPair = optional("negative stiffness k_s at bias_current, positive where it destabilises")
    geometry: GeometryTable = optional("the magnet's geometry")
    measured: list[MeasuredTable] = optional("coefficients at other bias currents")
    gap: Length = optional("radial air gap, a limit in verification")
    touchdown_gap: Length = optional("radial gap of the touchdown bearing")
    max_current: Current = optional("largest control current")
    max_force: Force = optional("largest force")
    iron: IronTable = optional("the magnet's iron")
    touchdown: TouchdownTable = optional("contact in the touchdown bearing")
    cross_coupling: Ratio = optional("part of the other axis' control current that acts on an axis; for the virtual rig")
    magnetic_offset: Annotated[tuple[float, float], PairOf("length")] = optional(
        "magnetic centre from the sensors' zero; for the virtual rig"
    )


class RunoutTable(Table):
    """One harmonic of the sensor track's profile: amplitude cos(order (spin angle - axis angle) + phase)."""

    noun = nouns.Runout
    order: Annotated[int, Count()] = required("periods per revolution")
    amplitude: Length = required("amplitude, zero to peak")
    phase: Angle = optional("phase")


class SensorTable(Table):
    """The pair of displacement sensors that serves a bearing, in that bearing's axes."""

    noun = nouns.Sensor
    identity = "bearing"
    bearing: Annotated[str, Text("the name of a [[bearing]]")] = required("name of the bearing")
    position: Length = required("axial position, from the left end")
    gain: Annotated[tuple[float, float], PairOf("ratio")] = optional("indicated per true displacement")
    bandwidth: Rate = optional("corner frequency of a first-order lag; default: no lag")
    noise: Length = optional("root mean square of the noise in every sample; for the virtual rig")
    offset: Annotated[tuple[float, float], PairOf("length")] = optional("indicated at zero displacement; for the virtual rig")
    resolution: Length = optional("step of the converter, 0 for none; for the virtual rig")
    runout: list[RunoutTable] = optional("harmonics of the sensor track's run-out")


class AmplifierTable(Table):
    """Current amplifier and coil of every axis, unit gain at standstill."""

    noun = nouns.Amplifier
    order: Annotated[str, Choice(tuple(AMPLIFIER_PARAMETERS))] = required("the model's form")
    bandwidth: Rate = optional('corner frequency, for "first" and "twice-first"')
    eddy_bandwidth: Rate = optional('second corner frequency, for "twice-first"')
    natural_frequency: Rate = optional('natural frequency, for "second"')
    damping: Rate = optional('damping term d in s^2 + d s + natural_frequency^2, for "second"')
    max_voltage: Annotated[float, Quantity("voltage")] = optional(
        "largest voltage at the coil, which limits the slope of the current; for the virtual rig"
    )
    inductance: Annotated[float, Quantity("inductance")] = optional("inductance of a coil; for the virtual rig")


class CouplingTable(Table):
    """A flexible coupling to ground."""

    noun = nouns.Coupling
    identity = "name"
    name: Name = required("name, different from all other attachments")
    position: Length = required("axial position, from the left end")
    stiffness: StiffnessPair = required("stiffness")
    damping: Annotated[tuple[float, float], PairOf("damping")] = optional("damping")
    angle: Angle = optional("angle of the axis zeta from the global x")


class NotchTable(Table):
    """A notch filter (s^2 + 2 zero_damping w s + w^2)/(s^2 + 2 pole_damping w s + w^2)."""

    noun = nouns.Notch
    frequency: Rate = required("centre frequency w")
    pole_damping: Ratio = required("damping ratio of the poles")
    zero_damping: Ratio = required("damping ratio of the zeros")


class ControllerTable(Table):
    """The reference controller K_p (1 + 1/(T_i s) + T_d s/(eps T_d s + 1)) per axis."""

    noun = nouns.PidSettings
    gain: Annotated[tuple[float, ...], ListOf("current per displacement", scalar=True)] = required(
        "K_p, one for all axes or one per axis"
    )
    integral_time: Time = optional("T_i; default: no integral part")
    derivative_time: Time = optional("T_d; default: no derivative part")
    derivative_filter: Ratio = optional("eps")
    notch: list[NotchTable] = optional("notch filters in series")
    lead: Annotated[tuple[float, float], PairOf("angular rate", "zero, pole", scalar=False)] = optional(
        "lead filter [zero, pole]"
    )
    low_pass: Rate = optional("corner frequency of a second-order low pass")
    low_pass_damping: Ratio = optional("damping ratio of the low pass")
    coordinates: Annotated[str, Choice(nouns.CONTROLLER_COORDINATES)] = optional("controlled coordinates")
    tilt_gain: Ratio = optional("gain of the tilting part relative to the translating part")
    sample_time: Time = optional("sample time of the deployed controller; default: continuous")
    delay: Time = optional("computing delay of the deployed controller")

    def given(self) -> dict[str, Any]:
        given = super().given()
        return {"notches" if key == "notch" else key: value for key, value in given.items()}


class PointTable(Table):
    """An operating point; the first one is the nominal point."""

    noun = nouns.OperatingPoint
    identity = "label"
    label: Words = optional("its name in reports")
    speed: Rate = optional("spin speed")
    seal_pressure: Pressure = optional("differential pressure of every seal")
    bias_current: Current = optional("bias current; default: that of each bearing")
    whirl_frequency: Rate = optional("frequency at which frequency-dependent seals are read; default: the speed")


class OperationTable(Table):
    """Where the machine runs."""

    noun = nouns.Operation
    speed_range: Annotated[tuple[float, float], PairOf("angular rate", "lowest, highest", scalar=False)] = optional(
        "[lowest, highest] spin speed"
    )
    design_point: Words = optional("label of the point that controllers are designed for; default: the nominal one")
    point: list[PointTable] = optional("operating points at which the machine is verified; default: standstill")

    def given(self) -> dict[str, Any]:
        given = super().given()
        return {"points" if key == "point" else key: value for key, value in given.items()}


class ToleranceTable(Table):
    """One uncertain parameter, with a relative or an absolute half-width."""

    noun = nouns.Tolerance
    identity = "parameter"
    parameter: Annotated[str, Text("the path of a parameter, such as seal.center.k,")] = required("path of the parameter")
    relative: Ratio = optional("half-width as a fraction of the nominal value")
    absolute: float = optional("half-width in the parameter's own unit")

    @field_validator("absolute", mode="plain", json_schema_input_type=float | str)
    @classmethod
    def _in_the_unit_of_its_parameter(cls, value: object, info: ValidationInfo) -> float:
        try:
            parameter = parse_parameter(info.data.get("parameter", ""))
        except InvalidInput:
            return 0.0  # the path itself is reported
        try:
            return Quantity(parameter.dimension).read(value)
        except ValueError as error:
            raise PydanticCustomError("value", "{problem}", {"problem": str(error)}) from None


class RequirementsTable(Table):
    """What verification demands; a key left out is judged by its standard's default, or not at all."""

    noun = nouns.Requirements
    sensitivity_peak: Ratio = optional("largest sensitivity")
    compliance_peak: Annotated[float, Quantity("compliance")] = optional("largest displacement per force")
    balance_grade: Annotated[float, Quantity("velocity")] = optional('balance grade; G2.5 is "2.5 mm/s"')
    balance_speed: Rate = optional("speed at which the residual unbalance is set")
    unbalance_orbit: Length = optional("largest unbalance response, zero to peak")
    unbalance_to: Rate = optional("speed up to which unbalance_orbit holds")
    settling_time: Time = optional("longest settling after a disturbance")
    gain_margin: Ratio = optional("smallest gain margin, as a factor")
    phase_margin: Angle = optional("smallest phase margin")
    log_decrement: Ratio = optional("smallest logarithmic decrement")
    max_current: Current = optional("largest control current")


class WeightsTable(Table):
    """What a robust design (H-infinity, mu) aims at; weights are the inverse of what is allowed."""

    noun = nouns.DesignWeights
    error_scale: Length = required("D_e, the largest acceptable control error")
    current_scale: Current = required("D_u, the largest control current")
    bandwidth: Rate = required("w_B, below which disturbances are reduced")
    control_level: Ratio = required("W_u at low frequencies, weight of the current in units of current_scale")
    peak: Ratio = optional("M, the largest sensitivity; default: 3")
    low_frequency_error: Ratio = optional("A_w, what is left of a constant disturbance; default: 0.001")
    control_crossover: Rate = optional("frequency above which W_u exceeds 1; default: W_u is constant")
    control_order: Annotated[int, Count()] = optional("order of W_u's rise")
    control_limit: Ratio = optional("W_u far above its crossover; default: 30")
    current_disturbance: Ratio = optional("size of the disturbing current, in units of current_scale; default: 1")
    output_disturbance: Ratio = optional("size of the disturbance of the measurement, in units of error_scale; default: 1")


class MachineFile(Table):
    """A rotor on magnetic bearings."""

    apart = frozenset({"machine", "material", "shaft"})
    machine: MachineTable = required("the machine as a whole")
    material: dict[str, MaterialTable] = optional("materials by name")
    shaft: list[ShaftTable] = required("shaft sections from the left end to the right")
    disc: list[DiscTable] = optional("rigid discs")
    bearing: list[BearingTable] = required("radial magnetic bearings")
    sensor: list[SensorTable] = required("displacement sensors, one pair per bearing")
    amplifier: AmplifierTable = required("amplifier and coil of every axis")
    seal: list[SealEntry] = optional("annular seals")
    coupling: list[CouplingTable] = optional("flexible couplings to ground")
    controller: ControllerTable = optional("the reference controller")
    operation: OperationTable = optional("operating points and speed range")
    tolerance: list[ToleranceTable] = optional("uncertain parameters")
    requirements: RequirementsTable = optional("what verification demands")
    weights: WeightsTable = optional("what a robust design aims at")


def table_below(table: type[Table], key: str) -> type[Table] | None:
    """The model of the table or entries under ``key``, None where the key holds a value."""
    field = table.model_fields.get(key)
    return None if field is None else _table_in(field.annotation)


def _table_in(annotation: Any) -> type[Table] | None:
    if isinstance(annotation, type) and issubclass(annotation, Table):
        return annotation
    return next((table for part in get_args(annotation) if (table := _table_in(part))), None)
