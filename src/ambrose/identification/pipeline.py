"""From records to an updated machine: READ FIRST; the one function for notebook, command line and
commissioning.

    done = identify(machine, ["prbs.h5"], controller)
    done.machine, done.parameters, done.findings

Check the records, fit (loop.py, seal/pipeline.py, identification/static_load.py), check the result,
write it into the machine.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, cast

from ambrose.core.checks import InvalidInput, as_several, check_finite, invalid, names_wrong_types
from ambrose.identification import static_load
from ambrose.identification.data_quality.signals import left_out, settled, taken
from ambrose.identification.loop import Progress, identify_loop, usual_unknowns
from ambrose.identification.methods import (
    METHODS,
    ClosedLoop,
    Identifying,
    LoopMethod,
    StaticLoads,
)
from ambrose.identification.parameters import COVERAGE, split_timing
from ambrose.identification.responses import as_responses, identify_responses
from ambrose.identification.result import (
    Identification,
    IdentifiedParameter,
    LoopIdentification,
    Provenance,
    StaticIdentification,
)
from ambrose.identification.seal.pipeline import identify_seal
from ambrose.identification.validation.places import at_place
from ambrose.identification.validation.repeatability import of_estimates
from ambrose.law.law import Law, LawLike, law_of
from ambrose.law.loop import laws_of
from ambrose.machine.machine import Machine
from ambrose.machine.parameters import TIMING
from ambrose.options import choose, either
from ambrose.record.files import names_of_files, read_record
from ambrose.record.record import Record
from ambrose.record.response import Measured, Response

__all__ = [
    "Identification",
    "IdentifiedParameter",
    "LoopIdentification",
    "Provenance",
    "StaticIdentification",
    "identify",
]


@names_wrong_types
def identify(
    machine: Machine,
    records: Measured | Sequence[Measured],
    controller: LawLike | None = None,
    *,
    method: Identifying | str = "closed-loop",
    repeats: bool = False,
    between: tuple[float, float] | None = None,
    provenance: Provenance | None = None,
    progress: Progress = lambda stage: None,
    **options: Any,
) -> Identification:
    """The machine's parameters from records of it running, checked before and after the fit, and
    the machine with them.

    records: as they are or their files, with excitations e_<axis> [A] and displacements y_<axis>
    [m]; with u_<axis> [A] the controller is checked, too. controller: the one that ran, a
    StateSpace, a Synthesis (with the delay that it states, where none is given) or anything with A,
    B, C, D. method: ``ClosedLoop``, ``Youla`` (needs every u_<axis>) or ``StaticLoads`` (loads
    f_<port> and currents give K_i, no controller) with its options; or the name of one,
    "closed-loop", "youla", "static", its options then by name. repeats: the records repeat one
    experiment. between: the seconds (from, to) of every record that are taken; else a beginning at
    which the rotor had not settled is left out, with a remark. provenance: the names of the files.
    Raises InvalidInput with every reason why no number can be trusted.
    """
    chosen = choose(METHODS, "method", method, options)
    check_controller(chosen, controller is not None, repeats)
    if not isinstance(machine, Machine):
        raise invalid(
            "the machine", type(machine).__name__, "a Machine", "load it with load_machine"
        )
    done: StaticIdentification | LoopIdentification
    # before any record is read
    loop = chosen if isinstance(chosen, LoopMethod) else None
    start = None if loop is None else _start_values(loop.start)
    unknown = () if loop is None else _paths(loop.unknown)
    if responses := as_responses(records):
        done = _identify_responses(
            machine, responses, controller, chosen, unknown, start, repeats or between, progress
        )
        return replace(done, provenance=provenance or Provenance()).updated()
    measured, names = _read(records, progress)
    provenance = provenance or Provenance(names)
    seal_form = getattr(chosen, "seal_form", None)
    if seal_form is not None:  # those without pressure first, as they are numbered
        order = sorted(range(len(measured)), key=lambda i: float(measured[i].point.seal_pressure))
        measured = tuple(measured[i] for i in order)
        if len(provenance.records) == len(order):
            provenance = replace(provenance, records=tuple(provenance.records[i] for i in order))
    whole = measured
    if between is not None:
        measured = tuple(record.between(*between) for record in whole)
        provenance = replace(provenance, part=taken(measured))
    elif loop is not None:
        measured = tuple(settled(machine, record) for record in whole)
        provenance = replace(provenance, part=left_out(whole, measured))
    machine = at_place(machine, measured)
    if repeats and len(measured) < 2:
        raise invalid(
            "the number of records",
            len(measured),
            "at least 2 for repeats",
            "give every repeat as a record",
        )
    if loop is None:
        done = _identify_static(machine, measured, repeats, progress, cast(StaticLoads, chosen))
    else:
        if controller is None:
            raise InvalidInput(
                f"the method {loop.method} needs the controller that ran; give a StateSpace or a "
                "Synthesis"
            )
        law = _law_that_ran(controller, machine)
        how = loop.fit_options(law.delay_samples)
        # delays and "bending" alone: beside what is usual
        usual = all("." not in path or path in TIMING for path in unknown)
        if usual:
            unknown = (*usual_unknowns(machine, measured), *unknown)
            progress(
                "unknown: "
                f"{', '.join(path for kind in split_timing(machine, unknown) for path in kind)}"
            )
        pressures = {record.point.seal_pressure for record in measured}
        if (
            seal_form is None
            and hasattr(loop, "seal_form")
            and machine.seals
            and len(pressures) > 2
        ):
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
                seal=cast(ClosedLoop, loop).seal,
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
                method=loop.method,
                start=start,
                repeats=repeats,
                along=usual,
                more_modes=loop.bending_modes is None,
                progress=progress,
                options=how,
            )
    return replace(done, provenance=provenance).updated()


def _identify_responses(
    machine: Machine,
    responses: tuple[Response, ...],
    controller: LawLike | None,
    method: Identifying,
    unknown: Sequence[str],
    start: Mapping[str, float] | None,
    of_time: object,
    progress: Progress,
) -> LoopIdentification:
    """Of frequency responses, which are neither repeated nor cut in time."""
    if not isinstance(method, ClosedLoop) or method.seal_form or method.period or of_time:
        raise InvalidInput(
            "frequency responses are identified by the method closed-loop, all of them together; "
            "leave out other methods, repeats, between, period and --seal-fit"
        )
    if controller is None:
        raise InvalidInput(
            "the controller that ran is missing; give a StateSpace or a Synthesis (on the command "
            "line its file, *.json)"
        )
    if all("." not in path for path in unknown):
        unknown = (*usual_unknowns(machine, responses), *unknown)
    return identify_responses(
        machine,
        responses,
        _law_that_ran(controller, machine),
        unknown,
        start=start,
        computing_delay=method.computing_delay,
        bending_modes=method.bending_modes,
        max_iterations=method.max_iterations,
        progress=progress,
    )


def _law_that_ran(controller: LawLike, machine: Machine) -> Law:
    """That of the machine's own axes, of a controller that holds the thrust axis' too."""
    return laws_of(machine, law_of(controller, functions=False))[machine.group][1]


def check_controller(method: Identifying, given: bool, repeats: bool, option: str = "") -> None:
    """Refuse a method without the controller that it needs, or with one that it does not; repeats
    of records at several pressures. option: "--", as the command line spells them. Raises
    InvalidInput.
    """
    name = f"{option}controller"
    if given and not method.looped:
        loops = either([key for key, kind in METHODS.items() if issubclass(kind, LoopMethod)])
        raise invalid(
            name,
            "given",
            f"left out with {option}method static",
            f"it goes with {loops}: {method.why}",
        )
    if not given and method.looped:
        text = (
            "the loop is modelled with the controller that ran; give it (on the command line its "
            "file, *.json)"
        )
        raise InvalidInput(f"{name} is missing: {text}")
    if repeats and getattr(method, "seal_form", None) is not None:
        form = "--seal-fit" if option else "seal_form"
        text = "records at several pressures repeat nothing; leave one out"
        raise InvalidInput(f"{option}repeats does not go with {form}: {text}")


def _read(
    records: Measured | Sequence[Measured], progress: Progress
) -> tuple[tuple[Record, ...], tuple[str, ...]]:
    """The records, and the names of those that are files (none where some are not)."""
    given, records = records, as_several(records)
    if not records:
        raise invalid(
            "records",
            repr(given),
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
    if names := names_of_files(records):
        progress(f"reading {len(names)} record{'s' if len(names) > 1 else ''}")
    read = tuple(map(read_record, records))
    return read, names if len(names) == len(records) else ()


def _paths(unknown: object) -> tuple[str, ...]:
    if not isinstance(unknown, str | Sequence):
        remedy = "write bearing.*.negative_stiffness.*"
        raise invalid("unknown", repr(unknown), "a path, or a list of them", remedy)
    paths = as_several(unknown)
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
    method: StaticLoads,
) -> StaticIdentification:
    progress("averaging the load levels")
    options = asdict(method)
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
