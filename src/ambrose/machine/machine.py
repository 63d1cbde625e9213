"""Machine: a description that was checked; the noun that everything else starts from."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar

from ambrose.core.checks import InvalidInput, names_wrong_types
from ambrose.core.presentation import html_table
from ambrose.machine.attachment import TILTED, Station, attached, attachment_of, by_table
from ambrose.machine.description import (
    DAMPINGS,
    SCHEMA_VERSION,
    Amplifier,
    DesignWeights,
    MachineDescription,
    OperatingPoint,
    Operation,
    Requirements,
    Tolerance,
)
from ambrose.machine.part import BendingMode, Material, Part, PidSettings, Sensor
from ambrose.machine.thrust import AxialRequirements, ThrustBearing
from ambrose.machine.validation.machine import InvalidMachine, axial_problems, check_machine

RADIAL, THRUST = "radial", "thrust"  # groups of axes
_OF_MAGNETS = ("force_per_current", "negative_stiffness")
# keys of [machine]
_HEAD = (
    *("name", "description", "source", "beam_theory", "modal_damping"),
    *(*DAMPINGS, "rotating_share", "gravity_direction"),
)


@dataclass(frozen=True, slots=True, repr=False)
class Machine(MachineDescription):
    """A rotor on magnetic bearings; its fields are those of MachineDescription.

    It is checked as a whole whenever one is made, from a file, in code or with ``replace``. Making
    one raises InvalidInput with a line for each problem: what belongs together (a seal and its
    tolerance, a bearing and its sensor) is replaced together.

    lateral: whether its axes lie across the shaft, where the rotor bends, whirls and is unbalanced.
    """

    lateral: ClassVar[bool] = True

    @names_wrong_types
    def __post_init__(self) -> None:
        # in the order in which a file gives them back
        ordered = tuple(part for parts in by_table(self.effects).values() for part in parts)
        if len(ordered) != len(self.effects):
            for part in self.effects:
                attachment_of(part)
        object.__setattr__(self, "effects", ordered)
        check_machine(self)
        for effect, _ in attached(self):
            if effect.axis is not None:
                effect.axis(self)  # what is wrong with it is refused with the machine

    @property
    def group(self) -> str:
        """The group whose axes ``axes`` are."""
        return RADIAL

    @property
    def groups(self) -> dict[str, Machine]:
        """Its groups of axes by name, each as the machine of these alone, its own first."""
        along = (effect.axis(self) for effect, _ in attached(self) if effect.axis is not None)
        return {self.group: self, **{machine.group: machine for machine in along}}

    def only(self, group: str) -> Machine:
        """The machine of one group of axes. Raises InvalidInput where it has none."""
        if group in (groups := self.groups):
            return groups[group]
        if group == THRUST:
            raise InvalidInput(
                f"{self.name} has no axis along its shaft to control; add a [[thrust_bearing]]"
            )
        raise InvalidInput(
            f'{self.name} is the thrust axis alone; take the machine without "{SUFFIX}"'
        )

    @property
    def axial(self) -> Machine:
        """The axis along the shaft (``machine.machine.AxialMachine``). Raises InvalidInput where
        there is no [[thrust_bearing]].
        """
        return self.only(THRUST)

    @property
    def whole(self) -> Machine | None:
        """The machine that this one is a group of axes of."""
        return self

    @property
    def stations(self) -> tuple[Station, ...]:
        """Where forces act along its axes: bearings in the order of the axes, registered effects,
        seals, discs.
        """
        bearings = [Station(b.name, b.position, b.angle, TILTED) for b in self.bearings]
        effects = [station for effect, part in attached(self) for station in effect.stations(part)]
        seals = [Station(seal.name, seal.position) for seal in self.seals]
        discs = [Station(disc.name, disc.position) for disc in self.discs]
        return (*bearings, *effects, *seals, *discs)

    @property
    def magnets(self) -> tuple[str, ...]:
        """Where the magnets' current forces act, as many for every axis: the pair of a radial axis
        at its port, as one.
        """
        return self.axes

    @property
    def magnet_paths(self) -> tuple[str, ...]:
        """The parameters of every force per current, then of every negative stiffness."""
        return tuple(
            f"bearing.{bearing.name}.{quantity}.{axis}"
            for quantity in _OF_MAGNETS
            for bearing in self.bearings
            for axis in TILTED
        )

    @property
    def conditions(self) -> tuple[Condition, ...]:
        """What its operating points hold besides, of an axis along the shaft."""
        return ()

    @property
    def thrust(self) -> ThrustBearing:
        """Its thrust bearing. Raises InvalidInput where it has none."""
        if found := self.parts(ThrustBearing):
            return found[0]
        raise InvalidInput(f"{self.name} has no [[thrust_bearing]]; add one")

    def condition(self, point: OperatingPoint) -> Condition:
        """Thrust and place at an operating point: by its label, else of the first one at its speed
        and pressure (a record keeps no more); none where there is no such point.
        """
        points = [*zip(self.operation.points, self.conditions, strict=False)]
        for own, item in points:
            if point.label and own.label == point.label:
                return item
        for own, item in points:
            if (own.speed, own.seal_pressure) == (point.speed, point.seal_pressure):
                return item
        return Condition(point.label, 0.0, 0.0)

    @property
    def reach(self) -> tuple[tuple[float, ...] | None, tuple[float, ...] | None]:
        """Per axis the largest plausible displacement [m] and the largest current [A]; None where a
        bearing does not say.
        """
        gaps = [
            (b.touchdown_gap and 2 * b.touchdown_gap) if b.gap is None else b.gap
            for b in self.bearings
        ]
        first, second = (
            tuple(float(value) for value in values for _ in range(2) if value is not None)
            for values in (gaps, [b.max_current for b in self.bearings])
        )
        count = len(self.axes)
        return first if len(first) == count else None, second if len(second) == count else None

    def in_file(self, words: str) -> str:
        """Words that name tables of the machine file, as they stand there for these axes."""
        return words

    def across_the_shaft(self, what: str, remedy: str = "") -> None:
        """Refuses the thrust axis for a verb of the radial axes: why it is theirs alone, as
        a clause, and what to do instead (default: to narrow to them). Raises InvalidInput.
        """

    def facts(self) -> Mapping[str, Any]:
        counts = {
            "discs": len(self.discs),
            "seals": len(self.seals),
            "tolerances": len(self.tolerances),
        }
        points = len(self.operation.envelope)
        return {
            "name": self.name,
            "length": f"{self.length:.4g} m",
            "axes": list(self.axes),
            **counts,
            "points": points,
        }

    def _repr_html_(self) -> str:
        rows = [
            ("", self.description),
            ("shaft", f"{len(self.shaft)} sections, {self.length:.4g} m, {self.beam_theory}"),
            ("bearings", _places(self.bearings)),
            (
                "sensors",
                ", ".join(
                    f"of {sensor.bearing} at {sensor.position:.4g} m" for sensor in self.sensors
                ),
            ),
            (
                "discs",
                ", ".join(
                    f"{disc.name} at {disc.position:.4g} m, {disc.mass:.4g} kg"
                    for disc in self.discs
                ),
            ),
            ("bending modes as measured", ", ".join(map(_mode_in_words, self.bending_modes))),
            ("seals", _places(self.seals)),
            ("couplings", _places(self.couplings)),
            *(
                (f"{table.replace('_', ' ')}s", ", ".join(part.name for part in parts))
                for table, parts in by_table(self.effects).items()
            ),
            (
                "supports",
                ", ".join(f"of {item.bearing}, {item.mass[0]:.4g} kg" for item in self.supports),
            ),
            (
                "casing modes",
                ", ".join(f"{item.frequency:.4g} rad/s" for item in self.casing_modes),
            ),
            (
                "operating points",
                "; ".join(point_in_words(point) for point in self.operation.envelope),
            ),
            ("tolerances", "; ".join(tolerance_in_words(item) for item in self.tolerances)),
        ]
        return html_table([row for row in rows if row[1]], f"Machine {self.name}")

    def to_dict(self, *, defaults: bool = False) -> dict[str, Any]:
        """The machine as the nested tables of its file, SI; keys at their default only with
        ``defaults``.
        """
        stated = Part.to_dict(self, defaults=defaults)
        materials = _material_names(self)
        head = {"schema": SCHEMA_VERSION, **{key: stated[key] for key in _HEAD if key in stated}}
        if self.assumed:
            head["assumed"] = dict(self.assumed)
        document: dict[str, Any] = {"machine": head}
        if materials:
            document["material"] = {
                name: material.to_dict(defaults=defaults) for material, name in materials.items()
            }
        document["shaft"] = stated["shaft"]
        for table, section in zip(document["shaft"], self.shaft, strict=True):
            table.pop("material", None)
            if section.material in materials:
                table["material"] = materials[section.material]
        several = (
            "disc",
            "bearing",
            "sensor",
            "seal",
            "coupling",
            "support",
            "casing_mode",
            "bending_mode",
            "chain",
            "tolerance",
        )
        document.update({key: stated[key] for key in several if key in stated})
        for table, parts in by_table(self.effects).items():
            document[table] = [part.to_dict(defaults=defaults) for part in parts]
        # a file must name the order
        document["amplifier"] = {"order": self.amplifier.order, **stated.get("amplifier", {})}
        document.update(
            {
                key: stated[key]
                for key in (
                    *("controller", "weights", "operation", "requirements"),
                    *("measured_rotor", "coast_down"),
                )
                if key in stated
            }
        )
        return document


def _material_names(machine: Machine) -> dict[Material, str]:
    """A different name for every material that is not the default one: its own where it has one."""
    names: dict[Material, str] = {}
    for section in machine.shaft:
        material = section.material
        if material != Material() and material not in names:
            name = wanted = material.name or "material"
            number = 1
            while name in names.values():
                number += 1
                name = f"{wanted}-{number}"
            names[material] = name
    return names


def _places(entries: Any) -> str:
    return ", ".join(f"{entry.name} at {entry.position:.4g} m" for entry in entries)


def _mode_in_words(mode: BendingMode) -> str:
    quantities = [("", mode.frequency, " rad/s"), ("damping ratio ", mode.damping, "")]
    return f"{mode.number}: " + ", ".join(
        f"{name}{value:.4g}{unit}" for name, value, unit in quantities if value is not None
    )


def point_in_words(point: OperatingPoint) -> str:
    """Label, speed and seal pressure."""
    return (
        f"{point.label or 'without label'} ({point.speed:.4g} rad/s, {point.seal_pressure:.4g} Pa)"
    )


def tolerance_in_words(tolerance: Tolerance) -> str:
    """ "seal.center.k ± 40 %", or with the absolute half-width [SI]."""
    if tolerance.relative is not None:
        return f"{tolerance.parameter} ± {100 * tolerance.relative:.4g} %"
    return f"{tolerance.parameter} ± {tolerance.absolute:.4g}"


def require_magnets(machine: MachineDescription) -> None:
    """Refuses a machine that nothing can control. Raises InvalidInput."""
    if not machine.axes:
        raise InvalidInput(
            f"{machine.name} has no magnetic bearings, so that there is nothing to control; give "
            "it [[bearing]] tables, or use a command that needs none: check, convert, lateral"
        )


# The axis along the shaft as a machine of its own: machine.axial, in a file's address
# ``machine.toml#axial``.
#
# It is the same rotor with one axis, <thrust bearing>_z, in place of the radial ones: every verb
# takes it. Its operating points are those of the machine, each with its process thrust, and where
# the sensor's target grows with heat, each also with the collar off centre by as much.


# where the name of a table begins that the axis has of its own, and what stands before it
_TABLES = re.compile(r"(\[\[?)(?=(?:controller|weights|requirements|tolerance)\b)")
_OWN = "thrust_bearing."
SUFFIX = "#axial"  # of the machine's name, as of its file's address
AXIS = "_z"


@dataclass(frozen=True, slots=True)
class Condition:
    """What an axial operating point holds: the process thrust [N], and the collar's place [m] when
    its sensor reads zero.
    """

    label: str
    load: float
    place: float


@dataclass(frozen=True, slots=True, repr=False)
class AxialMachine(Machine):
    """A rotor on its thrust bearing, one axis; made by ``Machine.axial``.

    whole: the machine that it is part of. conditions: of its operating points, by label. The
    radial parts (bearings, seals, couplings, supports) are left out: decoupled, as built.
    """

    lateral: ClassVar[bool] = False
    whole: Machine | None = field(default=None, compare=False)
    conditions: tuple[Condition, ...] = field(default=(), compare=False)

    @names_wrong_types
    def __post_init__(self) -> None:
        if lines := tuple(axial_problems(self, self.thrust)):
            raise InvalidMachine(f'machine "{self.name}"', lines)

    @property
    def group(self) -> str:
        """That of its one axis."""
        return THRUST

    @property
    def groups(self) -> dict[str, Machine]:
        """Its own: it has no other."""
        return {THRUST: self}

    @property
    def axes(self) -> tuple[str, ...]:
        """The one axis."""
        return (f"{self.thrust.name}{AXIS}",)

    @property
    def stations(self) -> tuple[Station, ...]:
        """Its bearing."""
        return (Station(self.thrust.name, self.thrust.position, axes=(AXIS[1:],)),)

    @property
    def magnets(self) -> tuple[str, ...]:
        """The left one and the right one, each before its core's lag."""
        return tuple(f"{side}{self.axes[0]}" for side in ("left_", "right_"))

    @property
    def magnet_paths(self) -> tuple[str, ...]:
        """Of both magnets as one."""
        return tuple(f"thrust_bearing.{self.thrust.name}.{name}" for name in _OF_MAGNETS)

    @property
    def axis_bearings(self) -> tuple[Any, ...]:
        """The bearing of the axis."""
        return (self.thrust,)

    @property
    def sensor_pairs(self) -> tuple[Sensor, ...]:
        """The axial sensor, as the pair whose first direction is z."""
        sensor = self.thrust.sensor
        return (
            Sensor(
                self.thrust.name,
                sensor.position,
                (sensor.gain, sensor.gain),
                sensor.bandwidth,
                sensor.noise,
                (0.0, 0.0),
                sensor.resolution,
                (),
                0.0,
                1.0,
            ),
        )

    @property
    def reach(self) -> tuple[tuple[float, ...] | None, tuple[float, ...] | None]:
        """Of its one axis."""
        most = self.thrust.max_current
        return (max(self.thrust.gap),), None if most is None else (most,)

    def in_file(self, words: str) -> str:
        """ "[weights]" is its "[thrust_bearing.weights]"."""
        return _TABLES.sub(rf"\1{_OWN}", words)

    def across_the_shaft(self, what: str, remedy: str = "") -> None:
        """It is that axis."""
        remedy = remedy or f'take the machine without "{SUFFIX}"'
        raise InvalidInput(f"{self.name} is the axis along the shaft, but {what}; {remedy}")

    def facts(self) -> Any:
        """The axis in a line."""
        return {
            "name": self.name,
            "axes": list(self.axes),
            "points": len(self.operation.points),
            "tolerances": len(self.tolerances),
        }


def axial_machine(machine: Machine) -> AxialMachine:
    """The axis along the shaft of a machine with a [[thrust_bearing]] (``Machine.axial``). Raises
    InvalidInput.
    """
    part = machine.thrust
    points, conditions = _points(machine, part)
    labels = {point.label for point in points}
    design = machine.operation.design_point
    return AxialMachine(
        name=f"{machine.name}{SUFFIX}",
        shaft=machine.shaft,
        bearings=(),
        sensors=(),
        amplifier=_amplifier(machine.amplifier, part),
        discs=machine.discs,
        effects=(part,),
        controller=_controller(machine, part),
        operation=Operation(points, design_point=design if design in labels else ""),
        tolerances=part.tolerances,
        chain=machine.chain,
        requirements=_requirements(machine.requirements, part.requirements),
        weights=None if part.weights is None else DesignWeights(**_stated(part.weights)),
        description=f"the axis along the shaft of {machine.name}",
        source=machine.source,
        modal_damping=machine.modal_damping,
        beam_theory=machine.beam_theory,
        assumed=tuple(row for row in machine.assumed if row[0].startswith("thrust_bearing")),
        whole=machine,
        conditions=conditions,
    )


def _points(
    machine: Machine, part: ThrustBearing
) -> tuple[tuple[OperatingPoint, ...], tuple[Condition, ...]]:
    """The machine's points with their thrust; the first of each thrust once more per end of the
    thermal growth.
    """
    loads = {item.point: item.force for item in part.loads}
    # held where its sensor reads zero, a collar whose sensor reads g at the centre stands at -g
    ends = [-growth for growth in dict.fromkeys(part.growth) if growth]
    points: list[OperatingPoint] = []
    conditions: list[Condition] = []
    seen: set[float] = set()
    for point in machine.operation.envelope:
        load = loads.get(point.label, 0.0)
        places = (0.0,) if load in seen else (0.0, *ends)
        seen.add(load)
        for place in places:
            label = point.label if not place else f"{point.label}, collar at {1e6 * place:+.4g} um"
            at = OperatingPoint(point.speed, point.seal_pressure, label=label)
            points.append(at)
            conditions.append(Condition(label, load, place))
    return tuple(points), tuple(conditions)


def _amplifier(common: Amplifier, part: ThrustBearing) -> Amplifier:
    """The machine's, with the axis' own bandwidth, voltage and coil."""
    own = common
    if part.amplifier_bandwidth is not None:
        own = Amplifier(
            "first",
            part.amplifier_bandwidth,
            max_voltage=common.max_voltage,
            inductance=common.inductance,
        )
    return replace(
        own,
        max_voltage=part.max_voltage or own.max_voltage,
        inductance=part.inductance or own.inductance,
    )


def _controller(machine: Machine, part: ThrustBearing) -> PidSettings | None:
    """The axis' own, with the rate and the delay of the machine's where it states none: one
    processor runs both.
    """
    common, own = machine.controller or PidSettings(), part.controller
    timing: dict[str, Any] = {"sample_time": common.sample_time, "delay": common.delay}
    if own is None:
        return PidSettings(**timing) if common.sample_time is not None else None
    stated = _stated(own)
    if "sample_time" in stated:
        timing = {}
    return PidSettings(**{**timing, **stated, "gain": (own.gain,)})


def _requirements(machine: Requirements, own: AxialRequirements | None) -> Requirements:
    """The axis' own, beside what of the machine's holds for any axis."""
    keys = ("sensitivity_peak", "gain_margin", "phase_margin", "log_decrement")
    common = {key: getattr(machine, key) for key in keys}
    return Requirements(**{**common, **({} if own is None else _stated(own))})


def _stated(part: Part) -> dict[str, Any]:
    """The fields of a part that are not left out."""
    values = ((item.name, getattr(part, item.name)) for item in fields(part))  # type: ignore[arg-type]
    return {name: value for name, value in values if value is not None}
