"""The unknown parameters of a machine: paths with "*" spelled out, their values and units, the
plant with others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from ambrose.core.checks import InvalidInput, invalid
from ambrose.machine.attachment import by_table
from ambrose.machine.axial import AxialMachine
from ambrose.machine.description import OperatingPoint, Tolerance
from ambrose.machine.machine import Machine
from ambrose.machine.parameters import (
    BENDING,
    CONTROLLER_DELAY,
    QUANTITIES,
    TIMING,
    find_uncertain,
    parse_parameter,
)
from ambrose.machine.rotor_model import BendingMode
from ambrose.machine.units import DIMENSIONS
from ambrose.model.assemble import assemble
from ambrose.model.basis import bending_modes_of
from ambrose.model.plant import Plant
from ambrose.model.reduce import free_mode_reduction
from ambrose.model.uncertainty import channels, perturbed

COVERAGE = 1.96  # standard deviations of a normal 95 % interval
# of a mode's frequency or damping: a tolerance is what gives it ports, its width is of no matter
_PORT = 0.01


class Estimate(Protocol):
    """What every method gives: values and standard_deviations (q,) of the parameters at ``paths``,
    SI, at ``point``.
    """

    @property
    def machine(self) -> str: ...
    @property
    def point(self) -> OperatingPoint: ...
    @property
    def paths(self) -> tuple[str, ...]: ...
    @property
    def values(self) -> np.ndarray: ...
    @property
    def standard_deviations(self) -> np.ndarray: ...


def unit_of(path: str) -> str:
    """The SI unit of a parameter."""
    return "s" if path in TIMING else DIMENSIONS[parse_parameter(path).dimension].unit


def half_width(tolerance: Tolerance, value: float) -> float:
    """Of a tolerance about a parameter's value, SI."""
    return (tolerance.absolute or 0.0) + (tolerance.relative or 0.0) * abs(value)


QUANTITIES_OF_MAGNETS = ("force_per_current", "negative_stiffness")


def magnet_paths(machine: Machine) -> list[str]:
    """The paths of every magnet's force per current, then of every negative stiffness."""
    if isinstance(machine, AxialMachine):
        return [f"thrust_bearing.{machine.thrust.name}.{q}" for q in QUANTITIES_OF_MAGNETS]
    return [
        f"bearing.{item.name}.{quantity}.{axis}"
        for quantity in QUANTITIES_OF_MAGNETS
        for item in machine.bearings
        for axis in ("zeta", "eta")
    ]


def part_names(machine: Machine) -> dict[str, list[str]]:
    """Table of the machine file -> the names of its parts."""
    return {
        "bearing": [item.name for item in machine.bearings],
        "seal": [item.name for item in machine.seals],
        **{
            table: [item.name for item in items]
            for table, items in by_table(machine.attached).items()
        },
    }


def expand(machine: Machine, paths: Sequence[str]) -> tuple[str, ...]:
    """The paths with every "*" replaced by all names (second part), both axes (fourth part) or a
    seal's entries: "bearing.*.negative_stiffness.*", "seal.*.K_*"; "bending" (the first mode),
    "bending_2" and so on by frequency and damping of the mode.

    Raises InvalidInput for a path that leads nowhere, and for two that name the same number.
    """
    if isinstance(paths, str):
        paths = [paths]
    names = part_names(machine)
    expanded: list[str] = []
    for path in paths:
        parts = path.split(".")
        if len(parts) == 1 and path.startswith(BENDING.rstrip("_")):
            mode = f"rotor.{BENDING}1" if path == BENDING.rstrip("_") else f"rotor.{path}"
            expanded += [f"{mode}.frequency", f"{mode}.damping"]
            continue
        spelled = [parts]
        if len(parts) > 1 and parts[1] == "*":
            spelled = [[parts[0], name, *parts[2:]] for name in names.get(parts[0], [])]
        letter = parts[2].removesuffix("_*") if len(parts) > 2 else ""
        if parts[0] == "seal" and letter != parts[-1] and letter in QUANTITIES["seal"]:
            spelled = [
                [*item[:2], f"{letter}_{entry}"]
                for item in spelled
                for entry in QUANTITIES["seal"][letter][1]
            ]
        if len(parts) > 3 and parts[3] == "*":
            spelled = [[*item[:3], axis] for item in spelled for axis in ("zeta", "eta")]
        if not spelled:
            raise InvalidInput(
                f'parameter "{path}" names nothing: the machine has no [[{parts[0]}]]'
            )
        expanded += [".".join(item) for item in spelled]
    if not expanded:
        raise InvalidInput(
            "no unknown parameter was named; give paths such as bearing.*.negative_stiffness.*"
        )
    parameters = [find_uncertain(machine, path) for path in expanded]
    for i, one in enumerate(parameters):
        if one.quantity == "core_scale":
            raise InvalidInput(
                f'parameter "{one.path}" is not identified from records; measure the response of '
                "force per current, and state its corner as core_corner"
            )
        if one.quantity == "pressure":
            remedy = f"name its coefficients, seal.{one.name}.k and so on"
            raise InvalidInput(
                f'parameter "{one.path}" is an operating point\'s, known with the record; {remedy}'
            )
        for other in parameters[:i]:
            if one.overlaps(other):
                raise InvalidInput(
                    f'parameters "{other.path}" and "{one.path}" are the same number; name it once'
                )
    return tuple(expanded)


def split_timing(machine: Machine, paths: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The machine's parameters among ``paths``, with "*" spelled out, and those of timing:
    "controller.delay" (or "delay") and "excitation.delay". Raises InvalidInput as ``expand`` does.
    """
    paths = [paths] if isinstance(paths, str) else paths
    named = [CONTROLLER_DELAY if path == "delay" else path for path in paths]
    timing = [path for path in named if path in TIMING]
    for path in set(timing):
        if timing.count(path) > 1:
            raise InvalidInput(f'parameter "{path}" is named twice; name it once')
    rest = [path for path in named if path not in TIMING]
    return expand(machine, rest) if rest or not timing else (), tuple(timing)


def nominal_values(plant: Plant, paths: Sequence[str]) -> np.ndarray:
    """The values (q,) of the parameters at ``paths`` at the plant's operating point, SI.

    Raises InvalidInput for a path that names two different numbers (both axes of a bearing).
    """
    values = []
    for path in paths:
        nominal = {channel.nominal for channel in channels(plant, path)}
        if len(nominal) > 1:
            text = " and ".join(f"{value:g}" for value in sorted(nominal))
            raise invalid(
                f'parameter "{path}"',
                f"{text} on the two axes",
                "one number",
                f'write "{path}.*", each on its own',
            )
        values.append(nominal.pop())
    return np.array(values)


def reduced_plant(
    machine: Machine, point: OperatingPoint, bending_modes: int, paths: Sequence[str] = ()
) -> Plant:
    """The plant at an operating point with the rotor's free modes, ``bending_modes`` per plane or
    as many as the mesh has, and ports for the modes among ``paths``. Raises InvalidInput for a mode
    that is not kept.
    """
    named = {item.parameter for item in machine.tolerances}
    wanted = [path for path in paths if path.startswith("rotor.")]
    for path in wanted:
        if mode_number(path) > bending_modes:
            remedy = f"take {mode_number(path)} bending modes (--bending-modes), or leave it out"
            raise InvalidInput(
                f'parameter "{path}" is not in a model of {bending_modes} bending modes; {remedy}'
            )
    ports = tuple(Tolerance(path, relative=_PORT) for path in wanted if path not in named)
    plant = assemble(
        replace(machine, tolerances=(*machine.tolerances, *ports)) if ports else machine, point
    )
    return free_mode_reduction(plant, min(bending_modes, bending_modes_of(plant.rotor_model)))


def mode_number(path: str) -> int:
    """k of "rotor.bending_k.frequency" or damping."""
    return int(parse_parameter(path).name.removeprefix(BENDING))


def with_bending(machine: Machine, values: Mapping[str, float]) -> Machine:
    """The machine with frequencies [rad/s] and damping ratios of bending modes, by their paths, as
    measured ones.
    """
    modes = {mode.number: mode for mode in machine.bending_modes}
    for path, value in values.items():
        k = mode_number(path)
        modes[k] = replace(modes.get(k, BendingMode(k)), **{parse_parameter(path).quantity: value})  # type: ignore[arg-type]
    return (
        replace(machine, bending_modes=tuple(modes[k] for k in sorted(modes)))
        if values
        else machine
    )


def plant_at(
    machine: Machine, point: OperatingPoint, values: Mapping[str, float], bending_modes: int = 3
) -> Plant:
    """The reduced plant at an operating point with these values, SI, at these paths but those of
    delays.

    Raises InvalidInput.
    """
    machine = with_bending(
        machine, {path: value for path, value in values.items() if path.startswith("rotor.")}
    )
    values = {path: value for path, value in values.items() if not path.startswith("rotor.")}
    plant = reduced_plant(machine, point, bending_modes)
    moves = {
        path: value - channels(plant, path)[0].nominal
        for path, value in values.items()
        if path not in TIMING
    }
    moves = {path: move for path, move in moves.items() if move}
    if not moves:
        return plant
    tolerances = [Tolerance(path, absolute=abs(move)) for path, move in moves.items()]
    return perturbed(
        plant, {path: 1.0 if move > 0 else -1.0 for path, move in moves.items()}, tolerances
    )


def ratios(reference: Plant, plant: Plant, paths: Sequence[str]) -> np.ndarray:
    """By what each parameter (q,) of ``reference`` is to be multiplied at another operating point
    of the same machine.

    A coefficient of a seal that follows the pressure keeps its law and shares the value at the
    reference; couplings and amplifiers do not change. Raises InvalidInput for a bearing whose bias
    differs (its gain and stiffness are then other numbers, tied by no law that a record could
    confirm), and for a coefficient that only exists at one of the points.
    """
    factors = np.ones(len(paths))
    for i, path in enumerate(paths):
        parameter = find_uncertain(reference.machine, path)
        if parameter.table == "thrust_bearing":
            # another load, or another place of the collar
            ends = (channels(item, path)[0].nominal for item in (plant, reference))
            factors[i] = next(ends) / next(ends)
        if parameter.table == "bearing":
            bearing = next(
                item for item in reference.machine.bearings if item.name == parameter.name
            )
            bias = [
                bearing.bias_current if p.bias_current is None else p.bias_current
                for p in (reference.point, plant.point)
            ]
            if abs(bias[0] - bias[1]) > 1e-9 * abs(bias[0]):
                raise invalid(
                    f'parameter "{path}" at the bias {bias[1]:g} A',
                    "another number",
                    f"that at {bias[0]:g} A",
                    "identify each bias current on its own, or take the bearings as known in this "
                    "fit",
                )
        nominal_reference, nominal_plant = (
            nominal_values(reference, [path])[0],
            nominal_values(plant, [path])[0],
        )
        if nominal_reference != 0:
            factors[i] = nominal_plant / nominal_reference
        elif nominal_plant != 0:
            raise invalid(
                f'parameter "{path}"',
                f"zero at the first operating point and {nominal_plant:g} at another",
                "non-zero at the first",
                "identify the points one by one",
            )
    return factors
