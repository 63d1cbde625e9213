"""A plan: what is computed how often over what, and its cases; the TOML file of it.

    [campaign]
    task = "screen"                     # screen, verify, design, simulate, identify
    plan = "grid"                       # or "random", "latin-hypercube" with cases and seed
    machine = "seal-rig"
    controller = "pid"                  # a file, or a method to design with

    [vary]
    "point.speed" = { from = "0 rpm", to = "9000 rpm", count = 10 }
    "machine.bearing.*.air_gap" = { from = 0.9, to = 1.1, count = 3, times = true }
    "tolerance.seal.center.pressure" = [-1, 0, 1]

The words before the first dot of a path say what it changes: see ``plan.py``.
"""

import copy
import hashlib
import json
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from functools import cached_property, lru_cache
from itertools import product
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, invalid
from ambrose.judge.result import Synthesis, synthesis_of
from ambrose.law.law import LawLike, law_of
from ambrose.machine.description import OperatingPoint
from ambrose.machine.file.toml import machine_from_document, read_toml
from ambrose.machine.machine import SUFFIX, Machine
from ambrose.machine.parameters import operating_point
from ambrose.machine.units import DIMENSIONS, read_quantity, shown, suggestion
from ambrose.rig.scenario import Scenario, read_scenario
from ambrose.version import __version__

TASKS = ("screen", "verify", "design", "simulate", "identify")
PLANS = ("grid", "random", "latin-hypercube")
MODELS = ("full", "reduced")
BASES = ("machine", "controller", "scenario", "point")  # that a path may name whole
SECTIONS = (*BASES, "tolerance", "option")
MOST_CASES = 1_000_000  # of one plan
_QUANTITY = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*")
_KEYS = ("task", "plan", "cases", "seed", "model", "machine", "controller", "scenario", "point")


@dataclass(frozen=True, slots=True)
class Times:
    """A factor on what the machine or scenario file has."""

    factor: float

    def __str__(self) -> str:
        return f"{self.factor:.6g} times"


Value = str | int | float | bool | Times


@dataclass(frozen=True, slots=True)
class Variable:
    """What is varied: ``values`` one after another (a grid), or anything from ``low`` to ``high``
    in ``unit``.
    """

    path: str
    values: tuple[Value, ...] = ()
    low: float = 0.0
    high: float = 0.0
    unit: str = ""
    times: bool = False

    def at(self, share: float) -> Value:
        """The value at a share of the way, 0 to 1: between the ends, or one of the list."""
        if self.values:
            return self.values[min(int(share * len(self.values)), len(self.values) - 1)]
        return in_unit(self.low + share * (self.high - self.low), self.unit, self.times)


@dataclass(frozen=True, slots=True)
class Case:
    """One case: its settings by path, and the key of all that it depends on."""

    key: str
    settings: tuple[tuple[str, Value], ...]

    @property
    def by_path(self) -> dict[str, Value]:
        return dict(self.settings)


@dataclass(frozen=True)
class Plan:
    """What a plan file says; ``folder`` is where the files it names are looked for. Raises
    InvalidInput.
    """

    variables: tuple[Variable, ...]
    task: str = "screen"
    plan: str = "grid"
    cases: int = 0
    seed: int = 0
    model: str = "full"
    machine: str = ""
    controller: str = ""
    scenario: str = ""
    point: str = ""
    options: Mapping[str, Any] = field(default_factory=dict)
    folder: Path = Path()

    def __post_init__(self) -> None:
        for name, known in (("task", TASKS), ("plan", PLANS), ("model", MODELS)):
            if getattr(self, name) not in known:
                raise InvalidInput(
                    f"{name} is {shown(getattr(self, name))}; "
                    f"{suggestion(str(getattr(self, name)), known)}"
                )
        whole = {variable.path for variable in self.variables}
        needed = ["machine", *(["controller"] if self.task != "design" else [])]
        needed += ["scenario"] if self.task in {"simulate", "identify"} else []
        for name in needed:
            if not getattr(self, name) and name not in whole:
                raise InvalidInput(
                    f"a campaign of task {self.task} needs a {name}; name one in [campaign] or "
                    "[vary]"
                )
        if not self.variables:
            raise InvalidInput("the plan varies nothing; add [vary] with a path and its values")
        if self.plan != "grid" and self.cases < 1:
            raise InvalidInput(
                f"a {self.plan} plan needs the number of its cases; add cases = 1000 to [campaign]"
            )
        if self.plan == "grid" and (ranges := [v.path for v in self.variables if not v.values]):
            raise InvalidInput(
                f"{ranges[0]} has no count, which a grid needs; add count = 10, or list its values"
            )
        if self.size > MOST_CASES:
            raise invalid(
                "the number of cases",
                self.size,
                f"at most {MOST_CASES}",
                "vary less, or draw a random plan",
            )

    @property
    def size(self) -> int:
        """How many cases there are."""
        return prod(len(v.values) for v in self.variables) if self.plan == "grid" else self.cases

    @cached_property
    def shares(self) -> np.ndarray:
        """Where in the ranges the cases of a random plan are (c, v), 0 to 1."""
        random = np.random.default_rng(self.seed)
        if self.plan == "random":
            return random.random((self.cases, len(self.variables)))
        from scipy.stats import qmc

        return np.asarray(qmc.LatinHypercube(len(self.variables), rng=random).random(self.cases))

    def drawn(self) -> Iterator[Case]:
        """Every case in its order; those with the same settings have the same key."""
        paths = [variable.path for variable in self.variables]
        rows: Iterator[Sequence[Value]]
        if self.plan == "grid":
            rows = product(*(variable.values for variable in self.variables))
        else:
            rows = (
                [v.at(s) for v, s in zip(self.variables, row, strict=True)]
                for row in self.shares.tolist()
            )
        start = hashlib.sha256(self._common.encode())
        for values in rows:
            settings = tuple(zip(paths, values, strict=True))
            digest = start.copy()
            digest.update(
                json.dumps(
                    [(p, self.content(p, v)) for p, v in sorted(settings)], sort_keys=True
                ).encode()
            )
            yield Case(digest.hexdigest()[:20], settings)

    @cached_property
    def _common(self) -> str:
        """All that is the same for every case, as text."""
        fixed = {
            name: self.content(name, getattr(self, name)) for name in BASES if getattr(self, name)
        }
        return json.dumps(
            [__version__, self.task, self.model, fixed, dict(self.options)],
            sort_keys=True,
            default=str,
        )

    @cached_property
    def _contents(self) -> dict[tuple[str, str], str]:
        return {}

    def content(self, path: str, value: Value) -> Any:
        """What stands for a value in a key: of a file its content."""
        if path not in {"machine", "controller", "scenario"} or not isinstance(value, str):
            return [value.factor, "times"] if isinstance(value, Times) else value
        if (path, value) not in self._contents:
            place = self.place(value)
            text = hashlib.sha256(place.read_bytes()).hexdigest() if place.is_file() else value
            self._contents[path, value] = text
        return self._contents[path, value]

    def place(self, name: str) -> Path:
        """A file that the plan names, relative to the plan's own folder."""
        return self.folder / name

    def named(self, base: str) -> tuple[str, ...]:
        """Every machine, controller or scenario of the plan."""
        varied = next((v.values for v in self.variables if v.path == base), ())
        return tuple(
            dict.fromkeys(
                str(value)
                for value in varied or ([getattr(self, base)] if getattr(self, base) else [])
            )
        )


def in_unit(number: float, unit: str, times: bool) -> Value:
    """A number as a machine file writes it."""
    return Times(number) if times else f"{number!r} {unit}" if unit else number


def number_of(value: Value) -> tuple[float, str] | None:
    """The number and the unit of a value; None for a text that is none."""
    if isinstance(value, Times):
        return value.factor, "times"
    if not isinstance(value, str):
        return float(value), ""
    match = _QUANTITY.fullmatch(value)
    return (float(match[1]), match[2]) if match else None


def read_plan(path: str | Path) -> Plan:
    """The plan in a TOML file. Raises InvalidInput that names table and key."""
    document = read_toml(path, "plan")
    try:
        return plan_of(document, Path(path).resolve().parent)
    except InvalidInput as error:
        raise InvalidInput(f"plan {path}: {error}") from error


def plan_of(document: Mapping[str, Any], folder: Path = Path()) -> Plan:
    """The plan in a parsed document. Raises InvalidInput."""
    for key in document:
        if key not in {"campaign", "vary", "options"}:
            raise InvalidInput(
                f"[{key}]: unknown table; {suggestion(key, ('campaign', 'vary', 'options'))}"
            )
    head, vary = document.get("campaign", {}), document.get("vary", {})
    for name, table in (
        ("campaign", head),
        ("vary", vary),
        ("options", document.get("options", {})),
    ):
        if not isinstance(table, Mapping):
            raise InvalidInput(f"{name} is not a table; write [{name}]")
    for key, value in head.items():
        if key not in _KEYS:
            raise InvalidInput(f"[campaign]: unknown key {key!r}; {suggestion(key, _KEYS)}")
        counted = key in {"cases", "seed"}
        right = (
            isinstance(value, int) and not isinstance(value, bool) and value >= 0
            if counted
            else isinstance(value, str)
        )
        if not right:
            what = "a whole number, not negative" if counted else "a text"
            raise invalid(f"[campaign] {key}", shown(value), what, "correct it")
    grid = head.get("plan", "grid") == "grid"
    if grid:
        _check_size(vary)
    variables = tuple(_variable(path, value, grid) for path, value in _flat(vary))
    return Plan(variables, **head, options=dict(document.get("options", {})), folder=folder)


def _check_size(vary: Mapping[str, Any]) -> None:
    """Raises InvalidInput where a grid has too many cases, before its ranges are built."""
    size = 1
    for _, value in _flat(vary):
        count = (
            value.get("count")
            if isinstance(value, Mapping)
            else len(value)
            if isinstance(value, list)
            else 1
        )
        if isinstance(count, int) and not isinstance(count, bool):
            size *= max(count, 1)
    if size > MOST_CASES:
        raise invalid(
            "the number of cases", size, f"at most {MOST_CASES}", "vary less, or draw a random plan"
        )


def _flat(table: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    """Paths written with dots outside of quotes arrive as tables within tables."""
    for key, value in table.items():
        if isinstance(value, Mapping) and "from" not in value:
            yield from _flat(value, f"{above}{key}.")
        else:
            yield f"{above}{key}", value


def _variable(path: str, given: Any, grid: bool) -> Variable:
    first, _, rest = path.partition(".")
    if first not in SECTIONS or (not rest and first not in BASES):
        known = ", ".join(f"{name}.<...>" for name in SECTIONS)
        raise InvalidInput(
            f'[vary] "{path}" does not exist; a path is {known}, or one of {", ".join(BASES)} whole'
        )
    values = given if isinstance(given, list) else [given]
    written = given.values() if isinstance(given, Mapping) else values
    # also of what a file writes with hundreds of digits
    if not all(abs(x) <= sys.float_info.max for x in written if isinstance(x, int | float)):
        raise invalid(f'[vary] "{path}"', shown(given), "finite numbers", "correct it")
    if not isinstance(given, Mapping):
        if not values or not all(isinstance(value, str | int | float | bool) for value in values):
            raise invalid(
                f'[vary] "{path}"',
                shown(given),
                "a list of texts or numbers",
                "or { from = ..., to = ..., count = ... }",
            )
        return Variable(path, tuple(values))
    if unknown := [key for key in given if key not in {"from", "to", "count", "times"}]:
        raise InvalidInput(
            f'[vary] "{path}": unknown key {unknown[0]!r}; known: from, to, count, times'
        )
    ends = [
        number_of(given[key]) if isinstance(given.get(key), str | int | float) else None
        for key in ("from", "to")
    ]
    if ends[0] is None or ends[1] is None or ends[0][1] != ends[1][1]:
        raise invalid(
            f'[vary] "{path}"',
            shown(dict(given)),
            "from one quantity to another of the same unit",
            "write both alike",
        )
    low, unit = ends[0]
    high, _ = ends[1]
    times = given.get("times", False)
    if not isinstance(times, bool):
        raise invalid(
            f'[vary] "{path}" times',
            shown(times),
            "true or false",
            "write times = true for a factor on the file's value",
        )
    if times and first not in {"machine", "scenario"}:
        raise InvalidInput(
            f'[vary] "{path}": times = true is for values of a machine or scenario file; '
            "leave it out"
        )
    count = given.get("count")
    if count is None or not grid:
        return Variable(path, (), low, high, unit, times)
    if not isinstance(count, int) or isinstance(count, bool) or not 1 <= count <= MOST_CASES:
        raise invalid(
            f'[vary] "{path}" count', shown(count), "a whole number, 1 or more", "correct it"
        )
    numbers = np.linspace(low, high, count).tolist()
    if all(isinstance(given[key], int) for key in ("from", "to")) and all(
        number.is_integer() for number in numbers
    ):
        return Variable(path, tuple(int(number) for number in numbers))
    return Variable(path, tuple(in_unit(number, unit, times) for number in numbers))


# What a case's settings make of machine, operating point, controller and scenario.
#
# machine | controller | scenario | point        another one, whole (a point by its label)
# machine.<table>[.<name|number|*>].<key>        a key of the machine file; scenario.<...> the same
#                                                of a scenario file
# point.speed | seal_pressure | bias_current | whirl_frequency
# controller.gain                                a factor on the controller's output
# tolerance.<parameter>                          where in its tolerance a parameter stands, -1 to 1;
#                                                "*" for every name or axis
# option.<name>                                  of the task: seed, rate, delay_samples, method, ...


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
            f'"{what}.{path}" does not exist in the {what} file; '
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
            raise InvalidInput(f'"point.{name}" does not exist; {suggestion(name, _POINT)}')
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
