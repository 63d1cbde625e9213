"""The attributes of a record's file, the same in every format: from a Record, checked, and back into one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, check_finite, invalid
from ambrose.machine.description import OperatingPoint
from ambrose.machine.record.record import FORMAT, POINT_KEYS, RESERVED, VERSION, Record, si_values

_REQUIRED = ("machine", "speed_rad_s", "seal_pressure_pa")


def attributes_of(record: Record) -> dict[str, Any]:
    """All attributes of a record's file except those of its signals."""
    point = {key: getattr(record.point, name) for key, name in POINT_KEYS.items()}
    return {
        "format": FORMAT, "version": VERSION, "machine": record.machine, "sample_rate_hz": record.sample_rate_hz,
        "start_time_s": record.start_time, **{key: value for key, value in point.items() if value not in {None, ""}},
        **dict(record.notes),
    }  # fmt: skip


def check_format(attributes: Mapping[str, Any]) -> None:
    """Refuse what is no record, of another version, or without its operating point; raises InvalidInput."""
    if attributes.get("format") != FORMAT:
        raise invalid(
            "the format", repr(attributes.get("format")), repr(FORMAT), f"a record names its format and version {VERSION}"
        )
    if str(attributes.get("version")) != str(VERSION):
        raise invalid("the version", repr(attributes.get("version")), str(VERSION), "update ambrose or convert the file")
    missing = [key for key in _REQUIRED if key not in attributes]
    if missing:
        raise InvalidInput(f"the attribute {' and '.join(missing)} is missing; the operating point must be known, add it")


def record_of(
    attributes: Mapping[str, Any], signals: Sequence[tuple[str, str]], values: np.ndarray, rate: float, start: float = 0.0
) -> Record:
    """A Record from file attributes (checked by check_format), (name, unit) pairs and values (p, k) in these units.

    ``values`` becomes the record's own: it is converted to SI in place and kept without a copy.
    """
    point = {name: attributes[key] for key, name in POINT_KEYS.items() if key in attributes}
    numbers = {name: number_of(value, name) for name, value in point.items() if name != "label"}
    units = []
    for i, (name, unit) in enumerate(signals):
        values[i], si = si_values(name, unit, values[i])
        units.append(si)
    values.flags.writeable = False
    return Record(
        str(attributes["machine"]), rate, tuple(name for name, _ in signals), tuple(units), values,
        OperatingPoint(**numbers, label=str(point.get("label", ""))), start,
        tuple((key, str(value)) for key, value in attributes.items() if key not in RESERVED),
    )  # fmt: skip


def number_of(value: Any, name: str) -> float:
    """An attribute as a finite number; raises InvalidInput."""
    try:
        return float(check_finite(float(value), name))
    except (TypeError, ValueError) as error:
        raise invalid(name, repr(value), "a finite number", "correct the attribute") from error
