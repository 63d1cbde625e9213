"""The controller file: a Synthesis as JSON, with units, certificate and provenance, versioned and
checked.

Numbers are written with the digits that give back the same double; a file is complete or absent,
never half written. The reader takes nothing on trust: unknown keys, other versions, sizes that do
not fit, NaN and truncated text are refused. The JSON schema of what it takes is
docs/controller.schema.json.
"""

import json
import os
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    FailFast,
    Field,
    ValidationError,
    WithJsonSchema,
)
from pydantic.json_schema import GenerateJsonSchema

from ambrose.core.checks import InvalidInput, check_path, invalid
from ambrose.core.hinf_riccati import Matrices
from ambrose.core.scheduled import AND, ScheduledSystem
from ambrose.core.statespace import StateSpace
from ambrose.judge.result import Certificate, Provenance, Status, Synthesis, synthesis_of
from ambrose.law.design_problem import Weights
from ambrose.law.filter_table import (
    DEFAULT_AXES,
    FACTS,
    controller_of,
    csv_table,
    is_modal,
    is_table,
    mat_table,
    named_for,
)
from ambrose.law.law import LawLike, scheduling_named
from ambrose.machine.file.tables import table_of
from ambrose.machine.file.toml import machine_hash, read_table
from ambrose.machine.machine import THRUST, Machine
from ambrose.machine.ordinary_file import (
    CONTROLLER_BYTES,
    CONTROLLER_NUMBERS,
    DELAY_SAMPLES,
    GRID_POINTS,
    SAMPLE_TIME,
    STATES,
    parse_json,
    read_text,
    write_text,
)
from ambrose.machine.part import PidSettings, Synchronous
from ambrose.machine.units import one_line, quoted
from ambrose.machine.validation.controller import synchronous_problems
from ambrose.record.apart import tree_of
from ambrose.version import __version__

FORMAT = "ambrose-controller"
VERSION = 3  # 1 and 2 told less than a Synthesis says and are refused
_UNITS = {"inputs": ("err_", "m"), "outputs": ("u_", "A")}
_AGAIN = "write the file again"


def _date(text: str) -> str:
    try:
        datetime.fromisoformat(text)
    except ValueError:
        raise ValueError("a date such as 2026-01-31T12:00:00+00:00") from None
    return text


Number = Annotated[float, Field(allow_inf_nan=False)]
Loose = Annotated[
    float,
    BeforeValidator(lambda value: float(value) if value in ("nan", "inf", "-inf") else value),
    WithJsonSchema({"anyOf": [{"type": "number"}, {"enum": ["nan", "inf", "-inf"]}]}),
]
Text = Annotated[str, Field(min_length=1)]
# a file of wrong numbers has one complaint
Matrix = Annotated[list[Annotated[list[Number], FailFast()]], FailFast()]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


class ErrorSignal(_Table):
    """A displacement error r - y."""

    name: Annotated[str, Field(pattern=r"^err_.", description="err_<axis>")]
    unit: Literal["m"]


class CurrentSignal(_Table):
    """A control current."""

    name: Annotated[str, Field(pattern=r"^u_.", description="u_<axis>")]
    unit: Literal["A"]


class SystemTable(_Table):
    """x' = A x + B u, y = C x + D u; row by row."""

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix


class AxisTable(_Table):
    """A measured parameter that a controller follows."""

    parameter: Literal["speed", "pressure"] = Field(
        description="of the machine's operating point: spin speed, seal pressure"
    )
    unit: Literal["rad/s", "Pa"]
    grid: Annotated[
        list[Number],
        FailFast(),
        Field(max_length=GRID_POINTS, description="ascending values of the parameter"),
    ]


class SchedulingTable(AxisTable):
    """The controller over a range of a measured parameter, or of two: matrices at every point of a
    grid.
    """

    interpolation: Literal["linear"] = Field(
        description="between the points, in each parameter by itself"
    )
    outside: Literal["refuse", "clamp"] = Field(description="what happens beyond the grid")
    second: AxisTable | None = Field(default=None, description="the pressure, beside the speed")
    points: Annotated[list[SystemTable], FailFast()] = Field(
        description="one for each value of the grid, of the controller's own sizes; with a second "
        "grid one for each of its "
        "values at each value of the first"
    )


class CertificateTable(_Table):
    """What was recomputed for the controller on the plant that it was made for."""

    stable: bool = Field(description="whether the closed loop was shown to be")
    spectral_abscissa: Loose = Field(description="of the closed loop [rad/s]")
    closed_loop_norm: Loose = Field(description="the H-infinity norm that the method minimises [-]")
    fastest_pole: Loose = Field(description="largest modulus of the controller's poles [rad/s]")
    margins: dict[str, Loose] = Field(description="further numbers by name")
    plant: str = Field(description="what it was verified on")
    envelope: dict[str, Loose] = Field(
        default_factory=dict,
        description="spectral abscissa of the loop as it runs [rad/s] at each operating point of "
        "the machine",
    )


class WeightsTable(_Table):
    """The weights of the design problem, the same for every axis."""

    performance: SystemTable = Field(description="W_p [-]")
    control: SystemTable = Field(description="W_u [-]")
    error_scale: Number = Field(description="D_e, the largest acceptable error [m]")
    current_scale: Number = Field(description="D_u, the largest control current [A]")
    current_disturbance: Number = Field(description="size of w1 in units of D_u [-]")
    output_disturbance: Number = Field(description="size of w2 in units of D_e [-]")
    control_factor: Number = Field(
        description="what W_u was multiplied by since the machine file stated it [-]"
    )


class ProvenanceTable(_Table):
    """Where the controller comes from."""

    package: Literal["ambrose"]
    package_version: Text
    machine: Text | None = Field(description="the machine's name")
    machine_hash: Text | None = Field(
        description="SHA-256 of everything in the machine file that is computed with"
    )
    date: Annotated[str, AfterValidator(_date)] = Field(description="UTC, ISO 8601")
    settings: dict[str, Any] | None = Field(description="what the design was asked for")
    digest: Text | None = Field(
        default=None, description="SHA-256 of all else but the date, for resuming a study"
    )


class GroupTable(_Table):
    """A controller of one group of axes, with its certificate."""

    method: Text
    status: Annotated[Status, Field(strict=False)]
    stopped_early: Text | None = Field(description="why the iteration ended before its end")
    gamma: Loose = Field(description="the norm that the method reached [-]")
    inputs: Annotated[list[ErrorSignal], FailFast(), Field(min_length=1)]
    outputs: Annotated[list[CurrentSignal], FailFast(), Field(min_length=1)]
    sample_time: Number | None = Field(description="[s]; null: continuous")
    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix
    scheduling: SchedulingTable | None
    certificate: CertificateTable | None = Field(description="null: the status is uncertified")
    weights: WeightsTable | None
    history: Annotated[list[dict[str, Loose]], FailFast()] = Field(
        description="a row for each iteration"
    )
    notes: Annotated[list[str], FailFast()]
    provenance: ProvenanceTable
    filters: dict[str, Any] | None = Field(
        default=None, description="the [controller] table of a machine file that gives the same"
    )
    synchronous: Annotated[list[dict[str, Any]], Field(max_length=16)] | None = Field(
        default=None,
        description="the [[controller.synchronous]] tables of a machine file: blocks beside the "
        "controller",
    )


class ControllerTable(GroupTable):
    """A controller from displacement errors to control currents, with its certificate; made by
    `ambrose synthesize`.
    """

    format: Literal["ambrose-controller"]
    version: Literal[3]
    thrust: GroupTable | None = Field(
        default=None, description="the controller of the thrust axis, beside the radial axes"
    )


def controller_schema() -> dict[str, Any]:
    """The JSON schema (draft 2020-12) of controller files."""

    class Untitled(GenerateJsonSchema):
        def field_title_should_be_set(self, schema: Any) -> bool:
            return False

    made = ControllerTable.model_json_schema(schema_generator=Untitled)
    head = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"ambrose controller file, version {VERSION}",
    }
    return {**head, **made, **head}


def made_for(known: Provenance, machine: Machine) -> str:
    """For which other machine, or other numbers of this one, a controller of that provenance was
    made, in words; "": for this one, or nothing is known.
    """
    if known.machine_hash in {None, machine_hash(machine)}:
        return ""
    other = known.machine != machine.name
    return f"another machine, {known.machine}" if other else f"other numbers of {machine.name}"


def write_controller(
    path: str | os.PathLike[str],
    result: LawLike,
    machine: Machine | None = None,
    date: datetime | None = None,
) -> Path:
    """Write a Synthesis, or a controller alone, to ``path``; the file appears complete or not at
    all. Returns the path.

    The controller's inputs are err_<axis> [m] and its outputs u_<axis> [A]. machine: recorded by
    name and hash, of the thrust axis that of this axis; None: the one of the synthesis. date: None:
    that of the synthesis, else now. Raises InvalidInput for other signals or a path that cannot be
    written.
    """
    path = check_path(path, "controller file")
    return write_text(path, controller_text(result, machine, date), "controller file")


def controller_text(
    result: LawLike,
    machine: Machine | None = None,
    date: datetime | None = None,
) -> str:
    """What ``write_controller`` writes. Raises InvalidInput."""
    content = _recorded(synthesis_of(result), machine, date).to_dict()
    for part in (content, content["thrust"]) if "thrust" in content else (content,):
        part |= {side: _signals(part[side], side) for side in _UNITS}
    return _layout({"format": FORMAT, "version": VERSION, **content})


def _recorded(synthesis: Synthesis, machine: Machine | None, date: datetime | None) -> Synthesis:
    """With machine, date and digest, of the thrust axis as well."""
    if synthesis.thrust is not None:
        along = None if machine is None else machine.only(THRUST)
        synthesis = replace(synthesis, thrust=_recorded(synthesis.thrust, along, date))
    origin = synthesis.provenance
    if machine is not None:
        origin = replace(
            origin,
            package_version=__version__,
            machine=machine.name,
            machine_hash=machine_hash(machine),
        )
    if date is not None or not origin.date:
        when = (date or datetime.now(UTC)).astimezone(UTC).isoformat(timespec="seconds")
        origin = replace(origin, date=when)
    written = replace(synthesis, provenance=origin)
    return replace(written, provenance=replace(origin, digest=written.digest))


def _signals(names: Sequence[str], side: str) -> list[dict[str, str]]:
    prefix, unit = _UNITS[side]
    for name in names:
        if not name.startswith(prefix):
            raise invalid(
                f"one of the controller's {side}",
                repr(name),
                f"{prefix}<axis> [{unit}]",
                "give the signals such names",
            )
    return [{"name": name, "unit": unit} for name in names]


def _layout(content: Mapping[str, Any]) -> str:
    """JSON with one key, and of matrices and lists one row, per line."""
    lines = []
    for key, value in content.items():
        if isinstance(value, list) and value:
            rows = ",\n".join(f"  {json.dumps(row, allow_nan=False)}" for row in value)
            lines.append(f"{json.dumps(key)}: [\n{rows}\n ]")
        elif key == "thrust":
            lines.append(f"{json.dumps(key)}: {_layout(value).rstrip()}")
        else:
            lines.append(f"{json.dumps(key)}: {json.dumps(value, allow_nan=False)}")
    return "{\n " + ",\n ".join(lines) + "\n}\n"


def read_controller(
    path: str | os.PathLike[str], machine: Machine | None = None, **stated: Any
) -> Synthesis:
    """The controller file at ``path``, every part of it checked; nothing in it is ever executed.

    machine: whose it is; channels translate_x, tilt_y ... are then set between its axes, and those
    without names are its axes in their order. A table of another program (law/filter_table.py),
    *.csv, *.mat or JSON without "format", is a controller that nothing is known of. stated: what
    such a table leaves open: rate_hz; delay_samples; input, "error" (r - y) or "displacement" (y,
    whose sign is turned); input_unit ("um"), output_unit ("mA"); feedback, "subtracted" or "added"
    (a1 and a2 are of the other sign); axes, names for its channels in their order. Raises
    InvalidInput that names the file, the key, its value and the remedy.
    """
    if unknown := [key for key in stated if key not in (*FACTS, DEFAULT_AXES)]:
        raise invalid(
            "what is stated of a controller",
            quoted(unknown[0]),
            f"one of {', '.join(FACTS)}",
            "correct its name",
        )
    suffix = Path(path).suffix.lower()
    if machine is not None and machine.axes:
        stated = {DEFAULT_AXES: machine.axes, **stated}
    try:
        return replace(_read(path, suffix, machine, stated), file=one_line(Path(path).name))
    except InvalidInput as error:
        raise InvalidInput(
            f"controller file {path}: {str(error).removeprefix(f'{path}: ')}"
        ) from error


def _read(
    path: str | os.PathLike[str], suffix: str, machine: Machine | None, stated: Mapping[str, Any]
) -> Synthesis:
    if suffix == ".mat":
        return _imported(mat_table(tree_of(Path(path))), machine, stated)
    text = read_text(path, "controller file", CONTROLLER_BYTES)
    content = csv_table(text) if suffix == ".csv" else _content(text)
    foreign = isinstance(content, dict) and not {"format", "provenance"} & {*content}
    if foreign and is_table(content):
        return _imported(content, machine, stated)
    return _placed(_restated(_both(_parse(content)), stated), machine)


def _imported(
    table: Mapping[str, Any], machine: Machine | None, stated: Mapping[str, Any]
) -> Synthesis:
    system, delay = controller_of(table, **stated)
    settings = None if delay is None else {"delay_samples": delay}
    result = Synthesis(system, provenance=Provenance(settings=settings))
    if machine is not None and not is_modal(system):
        return replace(result, controller=named_for(machine, system))
    return _placed(result, machine)


def _placed(result: Synthesis, machine: Machine | None) -> Synthesis:
    """The controller between the machine's axes, where its channels are the rotor's coordinates.
    Raises InvalidInput.
    """
    if machine is None or result.scheduled is not None or not is_modal(result.controller):
        return result
    channels = ", ".join(name.removeprefix("err_") for name in result.controller.inputs)
    note = f"its channels {channels} act between the axes {', '.join(machine.axes)}"
    system = named_for(machine, result.controller)
    return replace(result, controller=system, notes=(*result.notes, note))


def _restated(result: Synthesis, stated: Mapping[str, Any]) -> Synthesis:
    """A controller file with another delay; all else it says itself. Raises InvalidInput."""
    delay = stated.get("delay_samples")
    for key, value in stated.items():
        if value is not None and key not in ("delay_samples", DEFAULT_AXES):
            raise InvalidInput(
                f"{key} was stated, but a file of this package states it already; leave it out"
            )
    if delay is None:
        return result
    settings = {**(result.provenance.settings or {}), "delay_samples": delay}
    return replace(result, provenance=replace(result.provenance, settings=settings))


def _content(text: str) -> Any:
    """The parsed content of a JSON file; NaN, Infinity and repeated keys are refused. Raises
    InvalidInput.
    """
    if (numbers := text.count(",")) > CONTROLLER_NUMBERS:
        raise invalid(
            "the count of numbers",
            f"about {numbers}",
            f"at most {CONTROLLER_NUMBERS}",
            "reduce the controller's order",
        )
    try:
        return parse_json(text, _AGAIN, sys.float_info.max)
    except InvalidInput:
        if re.search(r"^\[\[?[a-z_.]+\]", text, re.MULTILINE):
            given = "a machine file, or another in TOML"
            raise invalid(
                "it", given, "a controller file in JSON", "make one with `ambrose synthesize -o`"
            ) from None
        raise


def _parse(content: Any) -> ControllerTable:
    """The content as tables. Raises InvalidInput for the first thing wrong."""
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        value = repr(content.get("format")) if isinstance(content, dict) else type(content).__name__
        raise invalid(
            "format",
            value,
            repr(FORMAT),
            "this is no controller file; write one with `ambrose synthesize -o`",
        )
    version = content.get("version")
    if type(version) is not int or version != VERSION:
        old = type(version) is int and 1 <= version < VERSION
        remedy = (
            "design it again with `ambrose synthesize`"
            if old
            else "it needs another version of ambrose"
        )
        raise invalid("version", repr(version), str(VERSION), remedy)
    try:
        return ControllerTable.model_validate(content)
    except ValidationError as error:
        raise _complaint(error.errors()[0]) from None


_REQUIREMENTS = {  # by the kind of pydantic's error
    "float_type": "a number",
    "finite_number": "a finite number",
    "list_type": "a list",
    "too_short": "one at least",
    "bool_type": "true or false",
    "string_type": "text",
    "string_too_short": "text that is not empty",
    "dict_type": "a table",
}


def _complaint(detail: Any) -> InvalidInput:
    """One of pydantic's errors as a sentence with key, value, requirement and remedy; indices count
    from 1.
    """
    *above, last = path = detail["loc"]
    kind = detail["type"]
    value = detail["input"]
    context = detail.get("ctx", {})
    if kind == "extra_forbidden":
        return InvalidInput(
            f"{_place(above)} has the unknown key {quoted(last)}; remove it, or use the version "
            "that wrote it"
        )
    if kind == "missing":
        return InvalidInput(
            f"{_place(above)} lacks the key {last!r}; {_AGAIN}, it may come from another version"
        )
    if kind == "model_type":
        return invalid(_place(path), type(value).__name__, "a table", _AGAIN)
    requirement = _REQUIREMENTS.get(kind) or {
        "literal_error": context.get("expected"),
        "enum": context.get("expected"),
        "string_pattern_mismatch": f"{str(context.get('pattern')).strip('^.')}<axis>",
        "value_error": str(context.get("error")),
    }.get(kind)
    shown = repr(value) if not isinstance(value, list | dict | str) or len(value) < 80 else ""
    return invalid(
        _place(path),
        shown if 0 < len(shown) < 80 else type(value).__name__,
        requirement or detail["msg"],
        _AGAIN,
    )


def _place(path: Sequence[str | int]) -> str:
    """("inputs", 2, "unit") as inputs[3].unit."""
    text = "".join(f"[{part + 1}]" if isinstance(part, int) else f".{part}" for part in path)
    return text.removeprefix(".") or "the file"


def _both(table: ControllerTable) -> Synthesis:
    """A file's content as nouns, with the controller of the thrust axis. Raises InvalidInput."""
    found = _synthesis(table)
    if table.thrust is None:
        return found
    try:
        thrust = _synthesis(table.thrust)
    except InvalidInput as error:
        raise InvalidInput(f"thrust: {error}") from error
    if len(thrust.outputs) != 1:
        raise invalid("the number of outputs of thrust", len(thrust.outputs), "1", _AGAIN)
    return replace(found, thrust=thrust)


def _synthesis(table: GroupTable) -> Synthesis:
    """The tables' content as nouns; raises InvalidInput where they do not fit together."""
    inputs, outputs = [item.name for item in table.inputs], [item.name for item in table.outputs]
    if len(table.A) > STATES:
        raise invalid(
            "the number of states", len(table.A), f"at most {STATES}", "reduce the controller"
        )
    _check_timing(table.provenance.settings or {})

    def system(letters: GroupTable | SystemTable, where: str = "") -> StateSpace:
        parts = _matrices(letters, where, len(table.A), len(inputs), len(outputs))
        return StateSpace(*parts, inputs, outputs, table.sample_time)

    scheduled = None
    if (plan := table.scheduling) is not None:
        points = [
            system(point, f"scheduling.points[{i}].")
            for i, point in enumerate(plan.points, start=1)
        ]
        over = [axis for axis in (plan, plan.second) if axis is not None]
        names, units = (
            AND.join(getattr(axis, key) for axis in over) for key in ("parameter", "unit")
        )
        scheduled = ScheduledSystem(
            tuple(axis.grid for axis in over), points, names, units, plan.outside
        )
        scheduling_named(names, units)  # refuses a unit that is not the parameter's
    certificate = (
        Certificate()
        if table.certificate is None
        else Certificate(**table.certificate.model_dump())
    )
    if table.method == "lpv" and scheduled is None:
        raise InvalidInput("method is 'lpv', but scheduling is null; design the controller again")
    if table.certificate is None and table.status is not Status.UNCERTIFIED:
        raise InvalidInput(
            f"status is '{table.status}', but there is no certificate; design the controller again"
        )
    provenance_data = table.provenance.model_dump(exclude={"package"})
    filters = (
        None
        if table.filters is None
        else read_table(table_of(PidSettings), table.filters, "filters").build()
    )
    blocks = tuple(
        read_table(table_of(Synchronous), block, f"synchronous[{i}]").build()
        for i, block in enumerate(table.synchronous or (), start=1)
    )
    axes = len(outputs)
    if problems := tuple(synchronous_problems(blocks, axes, axes // 2, "synchronous")):
        raise InvalidInput(problems[0])
    return Synthesis(
        system(table),
        table.method,
        table.gamma,
        table.status,
        certificate,
        tuple(table.history),
        tuple(table.notes),
        scheduled,
        table.stopped_early,
        None if table.weights is None else _weights(table.weights),
        Provenance(**provenance_data),
        filters,
        blocks,
    )


def _check_timing(settings: Mapping[str, Any]) -> None:
    """What ``law.loop`` reads: the rate and the delay that the controller was designed for."""
    for key, most in (("rate", 1 / SAMPLE_TIME), ("delay_samples", DELAY_SAMPLES)):
        value = settings.get(key)
        if value is not None and (
            isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= most
        ):
            raise invalid(
                f"provenance.settings.{key}",
                quoted(value),
                f"a number from 0 to {most:g}",
                "design it again",
            )


def _weights(table: WeightsTable) -> Weights:
    def system(name: str, source: str, output: str) -> StateSpace:
        part = getattr(table, name)
        return StateSpace(
            *_matrices(part, f"weights.{name}.", len(part.A), 1, 1), [source], [output]
        )

    sizes = table.model_dump(exclude={"performance", "control"})
    return Weights(system("performance", "err", "z1"), system("control", "u", "z2"), **sizes)


def _matrices(table: GroupTable | SystemTable, where: str, n: int, m: int, p: int) -> Matrices:
    """A (n, n), B (n, m), C (p, n), D (p, m). Raises InvalidInput naming the matrix and the row
    that do not fit.
    """

    def array(letter: str, rows: int, columns: int) -> np.ndarray:
        matrix = getattr(table, letter)
        name = f"{where}{letter}"
        remedy = "its sizes must fit A and the signals"
        if len(matrix) != rows:
            raise invalid(f"the number of rows of {name}", len(matrix), str(rows), remedy)
        for i, row in enumerate(matrix, start=1):
            if len(row) != columns:
                raise invalid(f"the length of row {i} of {name}", len(row), str(columns), remedy)
        return np.array(matrix, float).reshape(rows, columns)

    return array("A", n, n), array("B", n, m), array("C", p, n), array("D", p, m)


if __name__ == "__main__":  # python -m ambrose.judge.controller_file docs/controller.schema.json
    Path(sys.argv[1]).write_text(json.dumps(controller_schema(), indent=1) + "\n", encoding="utf-8")
