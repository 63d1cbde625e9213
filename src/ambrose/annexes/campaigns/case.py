"""What a case's settings make of machine, operating point, controller and scenario.

machine | controller | scenario | point          another one, whole (a point by its label)
machine.<table>[.<name|number|*>].<key>          a key of the machine file; scenario.<...> the same
                                                 of a scenario file
point.speed | seal_pressure | bias_current | whirl_frequency
controller.gain                                  a factor on the controller's output
tolerance.<parameter>                            where in its tolerance a parameter stands, -1 to 1;
                                                 "*" for every name or axis
option.<name>                                    of the task: seed, rate, delay_samples, method, ...
"""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import lru_cache
from typing import Any

from ambrose.annexes.campaigns.plan import Case, Times, Value, number_of
from ambrose.core.checks import InvalidInput, invalid
from ambrose.judge.result import Synthesis, synthesis_of
from ambrose.law.law import LawLike, law_of
from ambrose.machine.axial import SUFFIX
from ambrose.machine.description import OperatingPoint
from ambrose.machine.file.parse import machine_from_document
from ambrose.machine.machine import Machine
from ambrose.machine.messages import suggestion
from ambrose.machine.parameters import operating_point
from ambrose.machine.units import DIMENSIONS, read_quantity
from ambrose.rig.scenario import Scenario, read_scenario

_POINT = {
    "speed": "angular rate",
    "seal_pressure": "pressure",
    "bias_current": "current",
    "whirl_frequency": "angular rate",
}
_NAMES = ("name", "label", "bearing", "parameter")


@dataclass(frozen=True, slots=True)
class Bases:
    """What cases start from, ready to be sent to another process: machine files and scenarios as
    JSON text by name, controllers by (controller, machine).
    """

    machines: Mapping[str, str]
    controllers: Mapping[tuple[str, str], LawLike]
    scenarios: Mapping[str, str]


@dataclass(frozen=True, slots=True, eq=False)
class Subject:
    """A case made ready: what the tasks work on. offsets: tolerance by parameter, -1 to 1."""

    machine: Machine
    base: Machine
    point: OperatingPoint
    controller: LawLike | None
    scenario: Scenario | None
    offsets: Mapping[str, float]
    options: Mapping[str, Any]


def subject(case: Case, bases: Bases, fixed: Mapping[str, Any]) -> Subject:
    """The case made ready; fixed: what holds for all cases (names of the bases, "options"). Raises
    InvalidInput.
    """
    values = {
        **{name: fixed[name] for name in ("machine", "controller", "scenario", "point")},
        **case.by_path,
    }
    parts: dict[str, dict[str, Value]] = {}
    for path, value in values.items():
        section, _, rest = path.partition(".")
        if rest:
            parts.setdefault(section, {})[rest] = value
    name = str(values["machine"])
    machine = machine_with(bases.machines[name], tuple(parts.get("machine", {}).items()))
    base = machine_with(bases.machines[name], ())
    if name.endswith(SUFFIX):
        machine, base = machine.axial, base.axial
    controller: LawLike | None = bases.controllers.get((str(values["controller"]), name))
    gains = parts.get("controller", {})
    if other := [key for key in gains if key != "gain"]:
        raise InvalidInput(
            f'"controller.{other[0]}" is nothing that varies; controller.gain does, and '
            "controller whole"
        )
    if gains and controller is not None:
        controller = _scaled(controller, _number("controller.gain", gains["gain"]))
    scenario = None
    if values["scenario"]:
        document = json.loads(bases.scenarios[str(values["scenario"])])
        for path, value in parts.get("scenario", {}).items():
            assign(document, path, value, "scenario")
        scenario = read_scenario(document)
    point = _point(machine, str(values["point"]), parts.get("point", {}))
    options = {**fixed["options"], **parts.get("option", {})}
    return Subject(
        machine,
        base,
        point,
        controller,
        scenario,
        _offsets(machine, parts.get("tolerance", {})),
        options,
    )


@lru_cache(maxsize=32)
def machine_with(document: str, settings: tuple[tuple[str, Value], ...]) -> Machine:
    """The machine in a parsed file (JSON text) with other values at some paths. Raises
    InvalidInput.
    """
    tables = json.loads(document)
    for path, value in settings:
        assign(tables, path, value, "machine")
    return machine_from_document(tables, "machine of the plan")


def assign(document: dict[str, Any], path: str, value: Value, what: str) -> None:
    """Set a value, or multiply by a factor, wherever ``path`` leads in a parsed file. Raises
    InvalidInput where it does not.
    """
    *above, last = path.split(".")
    places = list(_places(document, above))
    if not places:
        first = path.split(".", maxsplit=1)[0]
        raise InvalidInput(
            f'"{what}.{path}" leads nowhere in the {what} file; '
            f"{suggestion(first, map(str, document))}"
        )
    for table in places:
        if not isinstance(value, Times):
            table[last] = copy.copy(value)
        elif last in table:
            table[last] = _times(table[last], value.factor, f"{what}.{path}")
        else:
            raise InvalidInput(
                f'"{what}.{path}" is to be multiplied, but is not in the {what} file; give it a '
                "value there"
            )


def _places(node: Any, path: list[str]) -> Iterator[dict[str, Any]]:
    if not path:
        if isinstance(node, dict):
            yield node
        elif isinstance(node, list):
            yield from (entry for entry in node if isinstance(entry, dict))
        return
    if isinstance(node, dict):
        for key in [key for key in node if fnmatchcase(key, path[0])]:
            yield from _places(node[key], path[1:])
    elif isinstance(node, list):
        for number, entry in enumerate(node):
            names = (
                [str(entry[key]) for key in _NAMES if key in entry]
                if isinstance(entry, dict)
                else []
            )
            if any(fnmatchcase(name, path[0]) for name in [*names, str(number + 1)]):
                yield from _places(entry, path[1:])


def _times(value: Any, factor: float, path: str) -> Any:
    if isinstance(value, list):
        return [_times(entry, factor, path) for entry in value]
    parsed = (
        None
        if isinstance(value, bool) or not isinstance(value, str | int | float)
        else number_of(value)
    )
    if parsed is None:
        raise invalid(
            f'"{path}"', repr(value), "a quantity to be multiplied", "give values instead of times"
        )
    return (
        f"{parsed[0] * factor!r} {parsed[1]}".rstrip()
        if isinstance(value, str)
        else parsed[0] * factor
    )


def _number(path: str, value: Value) -> float:
    if isinstance(value, str | bool | Times):
        raise invalid(f'"{path}"', str(value), "a number", "write it without quotes and unit")
    return float(value)


def _point(machine: Machine, label: str, values: Mapping[str, Value]) -> OperatingPoint:
    numbers = {}
    for name, value in values.items():
        if name not in _POINT:
            raise InvalidInput(f'"point.{name}" leads nowhere; {suggestion(name, _POINT)}')
        try:
            numbers[name] = read_quantity(value, DIMENSIONS[_POINT[name]])
        except ValueError as error:
            raise InvalidInput(f'"point.{name}" {error}') from error
    return operating_point(machine, label or None, **numbers)


def _offsets(machine: Machine, values: Mapping[str, Value]) -> dict[str, float]:
    known = [item.parameter for item in machine.tolerances]
    offsets: dict[str, float] = {}
    for pattern, value in values.items():
        names = [name for name in known if fnmatchcase(name, pattern)]
        if not names:
            nothing = "the machine file has no [[tolerance]]"
            raise InvalidInput(
                f'"tolerance.{pattern}" names no tolerance; {suggestion(pattern, known, nothing)}'
            )
        share = _number(f"tolerance.{pattern}", value)
        if not -1 <= share <= 1:
            raise invalid(
                f'"tolerance.{pattern}"',
                share,
                "within -1 to 1",
                "widen the tolerance in the machine file",
            )
        offsets |= dict.fromkeys(names, share)
    return offsets


def _scaled(controller: LawLike, gain: float) -> Synthesis:
    law = law_of(controller).fixed
    if law is None:
        raise InvalidInput(
            "controller.gain needs a fixed linear controller; leave it out for a scheduled one or "
            "a filter program"
        )
    scaled = replace(law, C=gain * law.C, D=gain * law.D)
    return Synthesis(scaled, provenance=synthesis_of(controller).provenance)
