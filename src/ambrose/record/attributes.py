"""The attributes of a record's file, the same in every format, as a pydantic model with a published
schema.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    PlainValidator,
    ValidationError,
    ValidationInfo,
    WithJsonSchema,
)

from ambrose.core.checks import InvalidInput, invalid
from ambrose.machine.description import OperatingPoint
from ambrose.machine.file.json_schema import DIALECT, tidy_schema, write_schema
from ambrose.machine.messages import quoted
from ambrose.record.record import FORMAT, POINT_KEYS, VERSION, Record, si_values


def _format(value: object) -> str:
    if value != FORMAT:
        remedy = (
            f"a record names its format and version {VERSION}; another program's becomes one by "
            "ambrose convert FILE --columns MAP -o record.h5 (the map: docs/records.md)"
        )
        raise invalid("the format", quoted(value), repr(FORMAT), remedy)
    return FORMAT


def _version(value: object) -> int:
    if str(value) != str(VERSION):
        raise invalid(
            "the version", quoted(value), str(VERSION), "update ambrose or convert the file"
        )
    return VERSION


def _number(value: Any, info: ValidationInfo) -> float:
    """An attribute as a finite number; CSV has it as a text."""
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if not math.isfinite(number):
        name = str(info.field_name)
        raise invalid(
            POINT_KEYS.get(name, name), quoted(value), "a finite number", "correct the attribute"
        )
    return number


_Number = Annotated[float, PlainValidator(_number), WithJsonSchema({"type": "number"})]
_Optional = Annotated[float | None, PlainValidator(_number), WithJsonSchema({"type": "number"})]
_Text = Annotated[str, PlainValidator(str), WithJsonSchema({"type": "string"})]


class RecordAttributes(BaseModel):
    """The attributes of a record: in HDF5 those of the root, in CSV the lines "# key: value" before
    the header.

    Any further attribute is a note: a key in lower case with a text.
    """

    model_config = ConfigDict(extra="allow", frozen=True, defer_build=True)
    format: Annotated[str, PlainValidator(_format), WithJsonSchema({"const": FORMAT})] = Field(
        description="that of a record"
    )
    version: Annotated[int, PlainValidator(_version), WithJsonSchema({"const": VERSION})] = Field(
        description="version of the format"
    )
    machine: _Text = Field(description="name of the machine")
    speed_rad_s: _Number = Field(description="spin speed [rad/s]")
    seal_pressure_pa: _Number = Field(description="differential pressure of every seal [Pa]")
    bias_current_a: _Optional = Field(
        default=None, description="bias current [A]; default: that of each bearing"
    )
    whirl_frequency_rad_s: _Optional = Field(
        default=None,
        description="frequency [rad/s] at which frequency-dependent seals are read; default: the "
        "speed",
    )
    point: _Text = Field(default="", description="label of the operating point")
    sample_rate_hz: _Optional = Field(
        default=None, description="sampling frequency [Hz]; CSV may leave it to the time column"
    )
    start_time_s: _Number = Field(
        default=0.0, description="time of the first sample [s]; CSV has it in the time column"
    )
    samples: _Optional = Field(
        default=None, description="number of rows of a CSV file, so that a truncated one is noticed"
    )

    @property
    def operating_point(self) -> OperatingPoint:
        return OperatingPoint(**{name: getattr(self, key) for key, name in POINT_KEYS.items()})

    @property
    def notes(self) -> tuple[tuple[str, str], ...]:
        return tuple((key, str(value)) for key, value in (self.model_extra or {}).items())


def read_attributes(attributes: Mapping[str, Any]) -> RecordAttributes:
    """The attributes of a file, checked; refuses what is no record, of another version, or without
    its operating point.

    Raises InvalidInput.
    """
    try:
        return RecordAttributes.model_validate({"format": None, "version": None, **attributes})
    except ValidationError as error:
        problems = error.errors()
    missing = [str(problem["loc"][0]) for problem in problems if problem["type"] == "missing"]
    for problem in problems:
        if problem["type"] == "value_error" and (
            problem["loc"][0] in {"format", "version"} or not missing
        ):
            raise problem["ctx"]["error"]
    raise InvalidInput(
        f"the attribute {' and '.join(missing)} is missing; the operating point must be known, "
        "add it"
    )


def record_schema() -> dict[str, Any]:
    """JSON schema (draft 2020-12) of a record's attributes: every key with its meaning and form."""
    title = f"attributes of an ambrose record, version {VERSION}"
    schema = {"title": title, **tidy_schema(RecordAttributes.model_json_schema())}
    return {
        "$schema": DIALECT,
        **schema,
        "additionalProperties": {"type": "string", "description": "a note"},
    }


def record_of(
    attributes: RecordAttributes,
    signals: Sequence[tuple[str, str]],
    values: np.ndarray,
    rate: float,
    start: float,
) -> Record:
    """A Record from file attributes, (name, unit) pairs and values (p, k) in these units.

    ``values`` becomes the record's own: it is converted to SI in place and kept without a copy.
    """
    units = []
    for i, (name, unit) in enumerate(signals):
        values[i], si = si_values(name, unit, values[i])
        units.append(si)
    values.flags.writeable = False
    names = tuple(name for name, _ in signals)
    return Record(
        attributes.machine,
        rate,
        names,
        tuple(units),
        values,
        attributes.operating_point,
        start,
        attributes.notes,
    )


if __name__ == "__main__":  # python -m ambrose.record.attributes docs/record.schema.json
    write_schema(record_schema(), sys.argv[1])
