"""The controller file: JSON with matrices, signals, units, sample time, certificate and provenance, versioned and checked.

Numbers are written with the digits that give back the same double; a file is complete or absent, never half written. The
reader takes nothing on trust: unknown keys, other versions, sizes that do not fit, NaN and truncated text are refused.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from ambrose import __version__
from ambrose.core.checks import InvalidInput, invalid
from ambrose.core.presentation import to_plain
from ambrose.core.scheduled import ScheduledSystem
from ambrose.core.statespace import StateSpace, as_statespace
from ambrose.machine.atomic_write import write_text
from ambrose.machine.description import Machine
from ambrose.machine.file.toml import machine_hash
from ambrose.synthesis.certificate import match_controller
from ambrose.synthesis.controller_parsing import (
    parse_date,
    parse_keys,
    parse_matrix,
    parse_number,
    parse_scheduling,
    parse_signals,
    parse_text,
    read_json,
)
from ambrose.synthesis.result import Certificate, Synthesis, is_verified

__all__ = ["ControllerFile", "Provenance", "machine_hash", "match_controller", "read_controller", "write_controller"]

FORMAT = "ambrose-controller"
VERSION = 1
SCHEDULED_VERSION = 2  # the same with a table in "scheduling"; version 1 has null there
INPUT_UNIT = ("err_", "m")
OUTPUT_UNIT = ("u_", "A")
STATUSES = ("verified", "unstable", "uncertified")  # as in Synthesis; uncertified: a controller written alone
KEYS = (
    "format", "version", "method", "status", "gamma", "inputs", "outputs", "sample_time", "A", "B", "C", "D",
    "scheduling", "certificate", "provenance",
)  # fmt: skip
CERTIFICATE_KEYS = ("stable", "spectral_abscissa", "closed_loop_norm", "fastest_pole", "margins", "plant")
PROVENANCE_KEYS = ("package", "package_version", "machine", "machine_hash", "date")


@dataclass(frozen=True, slots=True)
class Provenance:
    """Where a controller file comes from: versions, the machine's name and hash (None: not given), date in UTC (ISO 8601)."""

    package_version: str
    machine: str | None
    machine_hash: str | None
    date: str


@dataclass(frozen=True, slots=True, eq=False)
class ControllerFile:
    """What a controller file says. controller: StateSpace from err_<axis> [m] to u_<axis> [A], continuous or sampled;
    gamma is NaN where the method has none; certificate None where the controller was written without one. scheduled: the
    controller over a range of speeds, of which ``controller`` is the one at the nominal speed; None for a fixed one."""

    controller: StateSpace
    method: str
    status: str
    gamma: float
    certificate: Certificate | None
    provenance: Provenance
    scheduled: ScheduledSystem | None = None

    @property
    def law(self) -> StateSpace | ScheduledSystem:
        """What runs: the scheduled controller where there is one."""
        return self.controller if self.scheduled is None else self.scheduled


def write_controller(
    path: str | os.PathLike[str],
    result: Synthesis | StateSpace | Any,
    machine: Machine | None = None,
    date: datetime | None = None,
) -> Path:
    """Write a Synthesis, or a controller alone, to ``path``; the file appears complete or not at all. Returns the path.

    The controller's inputs are err_<axis> [m] and its outputs u_<axis> [A]. machine: recorded by name and hash; date (None:
    now). Raises InvalidInput for other signals or a path that cannot be written.
    """
    if not isinstance(result, Synthesis):
        controller = as_statespace(result)
        content = _content(controller, "given", "uncertified", math.nan, None, machine, date)
    else:
        content = _content(result.controller, result.method, result.status, result.gamma, result.certificate, machine, date)
        if result.scheduled is not None:
            content |= {"version": SCHEDULED_VERSION, "scheduling": _scheduling(result.scheduled)}
    return write_text(path, _layout(content), "controller file")


def _content(
    controller: StateSpace,
    method: str,
    status: str,
    gamma: float,
    certificate: Certificate | None,
    machine: Machine | None,
    date: datetime | None,
) -> dict[str, Any]:
    moment = (date or datetime.now(UTC)).astimezone(UTC)
    return {
        "format": FORMAT,
        "version": VERSION,
        "method": method,
        "status": status,
        "gamma": to_plain(float(gamma)),
        "inputs": _signals(controller.inputs, *INPUT_UNIT, "inputs"),
        "outputs": _signals(controller.outputs, *OUTPUT_UNIT, "outputs"),
        "sample_time": controller.dt,
        **{letter: getattr(controller, letter).tolist() for letter in "ABCD"},
        "scheduling": None,
        "certificate": None if certificate is None else certificate.to_dict(),
        "provenance": {
            "package": "ambrose",
            "package_version": __version__,
            "machine": None if machine is None else machine.name,
            "machine_hash": None if machine is None else machine_hash(machine),
            "date": moment.isoformat(timespec="seconds"),
        },
    }


def _scheduling(scheduled: ScheduledSystem) -> dict[str, Any]:
    """The grid and the matrices at each of its points; inputs, outputs and sample time are those of the file."""
    return {
        "parameter": scheduled.parameter,
        "unit": scheduled.unit,
        "interpolation": "linear",
        "outside": scheduled.outside,
        "grid": scheduled.grid.tolist(),
        "points": [{letter: getattr(system, letter).tolist() for letter in "ABCD"} for system in scheduled.systems],
    }


def _signals(names: Sequence[str], prefix: str, unit: str, side: str) -> list[dict[str, str]]:
    for name in names:
        if not name.startswith(prefix):
            raise invalid(f"one of the controller's {side}", repr(name), f"{prefix}<axis> [{unit}]", "rename() its signals")
    return [{"name": name, "unit": unit} for name in names]


def _layout(content: Mapping[str, Any]) -> str:
    """JSON with one key, and of matrices and lists one row, per line."""
    lines = []
    for key, value in content.items():
        if isinstance(value, list) and value:
            rows = ",\n".join(f"  {json.dumps(row, allow_nan=False)}" for row in value)
            lines.append(f"{json.dumps(key)}: [\n{rows}\n ]")
        else:
            lines.append(f"{json.dumps(key)}: {json.dumps(value, allow_nan=False)}")
    return "{\n " + ",\n ".join(lines) + "\n}\n"


def read_controller(path: str | os.PathLike[str]) -> ControllerFile:
    """The controller file at ``path``, every part of it checked; nothing in it is ever executed.

    Raises InvalidInput that names the file, the key, its value and the remedy.
    """
    path = Path(path)
    try:
        return _parse(read_json(path))
    except InvalidInput as error:
        raise InvalidInput(f"controller file {path}: {error}") from error


def _parse(content: Any) -> ControllerFile:
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        found = repr(content.get("format")) if isinstance(content, dict) else type(content).__name__
        raise invalid("format", found, repr(FORMAT), "this is no controller file; write one with `ambrose synthesize -o`")
    version = content.get("version")
    if type(version) is not int or version not in (VERSION, SCHEDULED_VERSION):
        raise invalid("version", repr(version), f"{VERSION} or {SCHEDULED_VERSION}", "it needs another version of ambrose")
    parse_keys(content, KEYS, "the file")
    if version == VERSION and content["scheduling"] is not None:
        raise invalid("scheduling", "given", "null in version 1", "it needs another version of ambrose")
    inputs = parse_signals(content["inputs"], "inputs", *INPUT_UNIT)
    outputs = parse_signals(content["outputs"], "outputs", *OUTPUT_UNIT)
    A = parse_matrix(content["A"], "A", None, None)
    n, m, p = len(A), len(inputs), len(outputs)
    B = parse_matrix(content["B"], "B", n, m)
    C = parse_matrix(content["C"], "C", p, n)
    D = parse_matrix(content["D"], "D", p, m)
    dt = None if content["sample_time"] is None else parse_number(content["sample_time"], "sample_time")
    controller = StateSpace(A, B, C, D, inputs, outputs, dt)
    certificate = _parse_certificate(content["certificate"])
    status = parse_text(content["status"], "status")
    if status not in STATUSES and not is_verified(status):
        raise invalid("status", repr(status), " or ".join(STATUSES), "it needs another version of ambrose")
    if is_verified(status) and (certificate is None or not certificate.stable):
        raise InvalidInput("status is 'verified', but the certificate does not say stable; design the controller again")
    return ControllerFile(
        controller,
        parse_text(content["method"], "method"),
        status,
        parse_number(content["gamma"], "gamma", any_value=True),
        certificate,
        _parse_provenance(content["provenance"]),
        parse_scheduling(content["scheduling"], controller) if version == SCHEDULED_VERSION else None,
    )


def _parse_certificate(content: Any) -> Certificate | None:
    if content is None:
        return None
    parse_keys(content, CERTIFICATE_KEYS, "certificate")
    if not isinstance(content["stable"], bool):
        raise invalid("certificate.stable", repr(content["stable"]), "true or false", "write the file again")
    if not isinstance(content["margins"], dict):
        raise invalid("certificate.margins", repr(content["margins"]), "a table of numbers", "write the file again")
    numbers = {
        key: parse_number(content[key], f"certificate.{key}", any_value=True)
        for key in ("spectral_abscissa", "closed_loop_norm", "fastest_pole")
    }
    margins = {
        name: parse_number(value, f"certificate.margins.{name}", any_value=True) for name, value in content["margins"].items()
    }
    return Certificate(
        stable=content["stable"],
        margins=margins,
        plant=parse_text(content["plant"], "certificate.plant", empty=True),
        **numbers,
    )


def _parse_provenance(content: Any) -> Provenance:
    parse_keys(content, PROVENANCE_KEYS, "provenance")
    if content["package"] != "ambrose":
        raise invalid("provenance.package", repr(content["package"]), "'ambrose'", "write the file with ambrose")
    texts = [
        None if content[key] is None else parse_text(content[key], f"provenance.{key}") for key in ("machine", "machine_hash")
    ]
    return Provenance(
        parse_text(content["package_version"], "provenance.package_version"),
        texts[0],
        texts[1],
        parse_date(content["date"], "provenance.date"),
    )
