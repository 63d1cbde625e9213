"""From records to an updated machine: READ FIRST; the one function for notebook, command line and
commissioning.

    done = identify(machine, ["prbs.h5"], controller)
    done.machine, done.parameters, done.findings

Check the records, fit (loop.py, seal/pipeline.py, static_load/identify.py), check the result, write
it into the machine.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from ambrose.core.arguments import names_wrong_types
from ambrose.core.checks import InvalidInput, check_finite, invalid
from ambrose.identification.loop import Progress, identify_loop, usual_unknowns
from ambrose.identification.output_error.problem import FitOptions
from ambrose.identification.parameters import COVERAGE, split_timing
from ambrose.identification.result import (
    Identification,
    IdentifiedParameter,
    LoopIdentification,
    Provenance,
    StaticIdentification,
)
from ambrose.identification.seal.pipeline import identify_seal
from ambrose.identification.static_load import identify as static_load
from ambrose.identification.validation.repeatability import of_estimates
from ambrose.law.law import LawLike, law_of
from ambrose.machine.machine import Machine
from ambrose.machine.parameters import TIMING
from ambrose.record.files import read_record
from ambrose.record.record import Record

__all__ = [
    "Identification",
    "IdentifiedParameter",
    "LoopIdentification",
    "Provenance",
    "StaticIdentification",
    "identify",
]

METHODS = ("closed-loop", "youla", "static")
_LOOP, _STATIC = ("closed-loop", "youla"), ("static",)
_GOES_WITH = {  # argument -> the methods that it goes with; those not named go with all
    "controller": _LOOP,
    "unknown": _LOOP,
    "start": _LOOP,
    "seal_form": ("closed-loop",),
    "seal": ("closed-loop",),
    **{item.name: _LOOP for item in fields(FitOptions)},
    **dict.fromkeys(("signals", "weights", "period"), ("closed-loop",)),
    **dict.fromkeys(("average", "drift"), _STATIC),
}
_WHY = {
    "closed-loop": "the closed loop is fitted over the whole record",
    "youla": "the Youla residual takes every u_ and y_<axis> of one operating point",
    "static": "static loads give K_i of every axis from forces and currents; no loop is modelled",
}


@names_wrong_types
def identify(
    machine: Machine,
    records: Record | str | Path | Sequence[Record | str | Path],
    controller: LawLike | None = None,
    *,
    method: str = "closed-loop",
    unknown: str | Sequence[str] = (),
    start: Mapping[str, float] | None = None,
    repeats: bool = False,
    seal_form: str | None = None,
    seal: str | None = None,
    provenance: Provenance | None = None,
    progress: Progress = lambda stage: None,
    **options: Any,
) -> Identification:
    """The machine's parameters from records of it running, checked before and after the fit, and
    the machine with them.

    records: as they are or their files, with excitations e_<axis> [A] and displacements y_<axis>
    [m]; with u_<axis> [A] the controller is checked, too. controller: the one that ran, a
    StateSpace, a Synthesis (with the delay that it states, where none is given) or anything with A,
    B, C, D. method: "closed-loop"; "youla" (needs every u_<axis>); "static" (loads f_<port> and
    currents give K_i, no controller). unknown: paths such as "bearing.*.negative_stiffness.*"
    (none: what the machine marks as uncertain, K_i and K_s of every axis, the amplifier's lag;
    "delay" and "bending" alone are added to these); start: path -> SI value to begin at. repeats:
    the records repeat one experiment. seal_form: "line" or "table", the seal at every pressure of
    the records; seal: which one. provenance: the names of the files. options: those of FitOptions
    (output_error/problem.py), and for static loads average and drift (static_load/identify.py).
    Raises InvalidInput with every reason why no number can be trusted.
    """
    given = {
        "controller": controller,
        "unknown": unknown,
        "start": start,
        "seal_form": seal_form,
        "seal": seal,
    }
    passed = {name for name, value in given.items() if value is not None and value != ()}
    check_arguments(method, passed | set(options) | ({"repeats"} if repeats else set()))
    if not isinstance(machine, Machine):
        raise invalid(
            "the machine", type(machine).__name__, "a Machine", "load it with load_machine"
        )
    start = _start_values(start)
    unknown = _paths(unknown)
    measured, names = _read(records, progress)
    provenance = provenance or Provenance(names)
    if seal_form is not None:  # those without pressure first, as they are numbered
        order = sorted(range(len(measured)), key=lambda i: float(measured[i].point.seal_pressure))
        measured = tuple(measured[i] for i in order)
        if len(provenance.records) == len(order):
            provenance = replace(provenance, records=tuple(provenance.records[i] for i in order))
    if repeats and len(measured) < 2:
        raise invalid(
            "the number of records",
            len(measured),
            "at least 2 for repeats",
            "give every repeat as a record",
        )
    done: Identification
    if method == "static":
        done = _identify_static(machine, measured, repeats, progress, options)
    else:
        if controller is None:
            raise InvalidInput(
                f"the method {method} needs the controller that ran; give a StateSpace or a "
                "Synthesis"
            )
        law = law_of(controller, functions=False)
        stated = law.delay_samples
        how = FitOptions(**({} if stated is None else {"computing_delay": stated}) | options)
        # delays and "bending" alone: beside what is usual
        if all("." not in path or path in TIMING for path in unknown):
            unknown = (*usual_unknowns(machine, measured), *unknown)
            progress(
                "unknown: "
                f"{', '.join(path for kind in split_timing(machine, unknown) for path in kind)}"
            )
        pressures = {record.point.seal_pressure for record in measured}
        if seal_form is None and method == "closed-loop" and machine.seals and len(pressures) > 2:
            progress(
                f"{len(pressures)} seal pressures, fitted together: --seal-fit line (seal_form) "
                "finds the seal at each"
            )
        if seal_form is not None:
            done = identify_seal(
                machine,
                measured,
                law,
                seal_form,
                unknown,
                seal=seal,
                start=start,
                options=how,
                progress=progress,
            )
        else:
            done = identify_loop(
                machine,
                measured,
                law,
                unknown,
                method=method,
                start=start,
                repeats=repeats,
                progress=progress,
                options=how,
            )
    return replace(done, provenance=provenance).updated()


def check_arguments(
    method: str, given: Collection[str], names: Mapping[str, str] | None = None
) -> None:
    """Refuse arguments that do not go together; raises InvalidInput. names: what the caller calls
    them ("--seal-fit").
    """
    called = {
        name: (names or {}).get(name, name) for name in (*_GOES_WITH, *given, "method", "repeats")
    }
    if method not in METHODS:
        raise invalid("method", repr(method), f"one of {', '.join(METHODS)}", "correct it")
    for name in given:
        if name not in _GOES_WITH and name != "repeats":
            raise invalid(
                "an option",
                repr(name),
                f"one of {', '.join(sorted(_GOES_WITH))}",
                "correct its name",
            )
    for name, methods in _GOES_WITH.items():
        if name in given and method not in methods:
            goes_with = f"{called['method']} {' or '.join(methods)}"
            raise InvalidInput(
                f"{called[name]} goes with {goes_with}, not {method}: {_WHY[method]}; leave it out"
            )
    if "controller" not in given and method != "static":
        text = (
            "the loop is modelled with the controller that ran; give it (on the command line its "
            "file, *.json)"
        )
        raise InvalidInput(f"{called['controller']} is missing: {text}")
    if "seal" in given and "seal_form" not in given:
        form = called["seal_form"]
        raise InvalidInput(
            f"{called['seal']} names the seal of {form}, which is missing; give {form} line or "
            "table, or leave it out"
        )
    if {"seal_form", "repeats"} <= set(given):
        text = "records at several pressures repeat nothing; leave one out"
        raise InvalidInput(f"{called['repeats']} does not go with {called['seal_form']}: {text}")


def _read(
    records: Record | str | Path | Sequence[Record | str | Path], progress: Progress
) -> tuple[tuple[Record, ...], tuple[str, ...]]:
    """The records, and the names of those that are files (none where some are not)."""
    if isinstance(records, Record | str | Path):
        records = (records,)
    if not isinstance(records, Sequence) or not records:
        raise invalid(
            "records",
            repr(records),
            "a Record or a file, or a list of them",
            "record the machine running",
        )
    for number, item in enumerate(records, 1):
        if not isinstance(item, Record | str | Path):
            raise invalid(
                f"record {number}",
                f"a {type(item).__name__}",
                "a Record or the path of one",
                "read it with read_record",
            )
    files = [Path(item) for item in records if not isinstance(item, Record)]
    if files:
        progress(f"reading {len(files)} record{'s' if len(files) > 1 else ''}")
    names = tuple(path.name for path in files) if len(files) == len(records) else ()
    return tuple(item if isinstance(item, Record) else read_record(item) for item in records), names


def _paths(unknown: str | Sequence[str]) -> tuple[str, ...]:
    paths = (unknown,) if isinstance(unknown, str) else tuple(unknown)
    for path in paths:
        if not isinstance(path, str):
            raise invalid(
                "an unknown", repr(path), "a path", "write bearing.*.negative_stiffness.*"
            )
    return paths


def _start_values(start: Mapping[str, float] | None) -> dict[str, float] | None:
    if start is None:
        return None
    if not isinstance(start, Mapping):
        raise invalid(
            "start",
            repr(start),
            "a mapping from paths to SI values",
            'write {"seal.center.k": 3e6}',
        )
    return {
        str(path): float(check_finite(value, f"the start value of {path}"))
        for path, value in start.items()
    }


def _identify_static(
    machine: Machine,
    records: Sequence[Record],
    repeats: bool,
    progress: Callable[[str], None],
    options: Mapping[str, Any],
) -> StaticIdentification:
    progress("averaging the load levels")
    done = StaticIdentification(
        given=machine, machine=machine, result=static_load.identify(machine, records, **options)
    )
    if not repeats:
        return done
    estimates = []
    for number, record in enumerate(records, 1):
        progress(f"record {number} of {len(records)} alone")
        estimates.append(static_load.identify(machine, record, **options))
    scatter = of_estimates(estimates)
    return replace(done, result=done.result.widened(scatter.half_width / COVERAGE), repeats=scatter)
