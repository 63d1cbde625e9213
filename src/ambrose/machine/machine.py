"""Machine: a description that was checked; the noun that everything else starts from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ambrose.core.arguments import names_wrong_types
from ambrose.core.checks import InvalidInput
from ambrose.core.presentation import html_table
from ambrose.machine.attachment import attached, attachment_of, by_table
from ambrose.machine.description import (
    SCHEMA_VERSION,
    MachineDescription,
    OperatingPoint,
    Tolerance,
)
from ambrose.machine.part import Part
from ambrose.machine.rotor_model import BendingMode, Material
from ambrose.machine.validation.machine import check_machine

# keys of [machine]
_HEAD = ("name", "description", "source", "beam_theory", "modal_damping", "gravity_direction")


@dataclass(frozen=True, slots=True, repr=False)
class Machine(MachineDescription):
    """A rotor on magnetic bearings; its fields are those of MachineDescription.

    It is checked as a whole whenever one is made, from a file, in code or with ``replace``. Making
    one raises InvalidInput with a line for each problem: what belongs together (a seal and its
    tolerance, a bearing and its sensor) is replaced together.
    """

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
    def has_axis(self) -> bool:
        """Whether it has an axis along its shaft."""
        return any(effect.axis is not None for effect, _ in attached(self))

    @property
    def axial(self) -> Machine:
        """The axis along the shaft as a machine of its own (``machine.axial.AxialMachine``). Raises
        InvalidInput where there is no [[thrust_bearing]].
        """
        for effect, _ in attached(self):
            if effect.axis is not None:
                machine: Machine = effect.axis(self)
                return machine
        raise InvalidInput(
            f"{self.name} has no axis along its shaft to control; add a [[thrust_bearing]]"
        )

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
            ("tolerances", "; ".join(_tolerance_in_words(item) for item in self.tolerances)),
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
                for key in ("controller", "weights", "operation", "requirements", "coast_down")
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


def _tolerance_in_words(tolerance: Tolerance) -> str:
    if tolerance.relative is not None:
        return f"{tolerance.parameter} ± {100 * tolerance.relative:.4g} %"
    return f"{tolerance.parameter} ± {tolerance.absolute:.4g}"


def require_magnets(machine: MachineDescription) -> None:
    """Refuses a machine that nothing can control. Raises InvalidInput."""
    if not machine.axes:
        raise InvalidInput(
            f"{machine.name} has no magnetic bearings, so that there is nothing to control; give "
            "it [[bearing]] tables, or take a command that does without: check, convert, lateral"
        )
