"""From a controller to files for a target: sampled, verified on its machine, limited by it,
written.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, cast, get_args

import numpy as np
from numpy.typing import ArrayLike

from ambrose.code.block.block import HOLD_SAMPLES, WINDUP_TIME, check_limits
from ambrose.code.block.cascade import build_cascade
from ambrose.code.block.fixed import ControlBlock, build_block
from ambrose.code.block.names import check_identifier
from ambrose.code.block.scheduled import ScheduledBlock, build_scheduled_block, check_told_limits
from ambrose.code.block.supervised import supervise
from ambrose.code.c.code import Arithmetic, Precision, check_precision, generate
from ambrose.code.fmu.archive import check_compiler, generate_fmus
from ambrose.code.mat import generate_mat
from ambrose.code.provenance import provenance_lines
from ambrose.code.sampled import (
    Deployment,
    Progress,
    ScheduledDeployment,
    deploy,
    deploy_scheduled,
    unmet_limits,
)
from ambrose.code.structured_text import generate_structured_text
from ambrose.core.checks import UnstableSystem, check_positive, invalid
from ambrose.core.presentation import Presented
from ambrose.core.sampling import Method
from ambrose.core.statespace import StateSpace, rename
from ambrose.judge.result import Synthesis, synthesis_of
from ambrose.law.law import LawLike, law_of
from ambrose.law.loop import match_axes
from ambrose.law.scheduling import BOTH, Scheduling
from ambrose.law.supervision import check_pair, supervision_limits
from ambrose.law.timing import DEFAULT, Timing, timing_of
from ambrose.machine.atomic_write import check_place, write_files
from ambrose.machine.claim import claimed
from ambrose.machine.file.toml import bundled_machines, load_machine, machine_hash
from ambrose.machine.machine import Machine
from ambrose.model.assemble import assemble

Target = Literal["c", "mat", "fmu", "st"]
Form = Literal["modal", "cascade"]
TARGETS: Mapping[Target, tuple[Arithmetic, ...]] = {  # with what each can compute in
    "c": ("double", "float", "fixed32", "fixed16"),
    "mat": ("double",),
    "fmu": ("double", "float", "fixed32", "fixed16"),
    "st": ("double", "float"),
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class ExportOptions(Presented):
    """How a controller is written.

    name: prefix of every name in the code, a C identifier. arithmetic: of the code. rate [Hz]: of
    the samples, delay_samples: from measured errors to currents set (None: as the controller or the
    machine file says, ``law.timing.timing_of``; 10 kHz and one sample where nobody does); sampling,
    prewarp [rad/s]: as in ``core.sampling.c2d``; form: "modal", or of filters "cascade", section by
    section (C only). error_limit [m], current_limit [A]: one number or one per axis (None: the
    bearings' gaps, or twice their touchdown gaps, and largest currents). windup_time [s],
    hold_samples: as in ``build_block``. speed_limit [rad/s], speed_rate [rad/s^2], pressure_limit
    [Pa], pressure_rate [Pa/s]: of a controller that is scheduled over the one, as in
    ``build_scheduled_block``; with a fallback pressure_rate, pressure_error [Pa], stuck_after [s]
    are rate, band and stuck of ``law.supervision.Limits``. sources_only: an FMU without a binary.
    force: write a controller that is not verified, or not stable everywhere. Raises InvalidInput.
    """

    name: str = "controller"
    arithmetic: Arithmetic = "double"
    rate: float | None = None
    delay_samples: int | None = None
    sampling: Method = "tustin"
    prewarp: float | None = None
    form: Form = "modal"
    error_limit: ArrayLike | None = None
    current_limit: ArrayLike | None = None
    windup_time: float = WINDUP_TIME
    hold_samples: int = HOLD_SAMPLES
    speed_limit: float | None = None
    speed_rate: float | None = None
    pressure_limit: float | None = None
    pressure_rate: float | None = None
    pressure_error: float | None = None
    stuck_after: float | None = None
    sources_only: bool = False
    force: bool = False

    def __post_init__(self) -> None:
        check_identifier(
            self.name, "the name of the block", "choose letters, digits and underscores"
        )
        if self.form not in get_args(Form):
            raise invalid(
                "form", repr(self.form), " or ".join(get_args(Form)), "choose one of them"
            )
        if self.rate is not None:
            check_positive(self.rate, "rate", "give it in Hz")
        if self.delay_samples is not None:
            Timing(1.0, self.delay_samples)  # refuses what is no number of samples

    def told(self, along: Scheduling) -> tuple[tuple[float | None, ...], tuple[float | None, ...]]:
        """The limits of what the code is told, of each parameter, and of their rates."""
        limits, rates = (
            tuple(getattr(self, f"{one.name}_{what}") for one in along.each)
            for what in ("limit", "rate")
        )
        return limits, rates


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Delivery(Presented):
    """What was written for a target, and what it was verified on; fallback: the same of the
    controller that takes over.
    """

    target: Target
    deployment: Deployment | ScheduledDeployment
    block: ControlBlock | ScheduledBlock
    paths: tuple[Path, ...]
    fallback: Deployment | None = None

    def facts(self) -> Mapping[str, Any]:
        """Target, verdict, size, rate and files."""
        facts = {
            "target": self.target,
            "verified": self.verified,
            "states": self.block.n_states,
            "rate_hz": 1 / self.block.sample_time,
            "files": [path.name for path in self.paths],
        }
        found = {"problems": list(self.problems), "unmet_limits": list(self.unmet_limits)}
        return facts | {name: items for name, items in found.items() if items}

    @property
    def verified(self) -> bool:
        """Whether the controller, and the one that takes over, is stable wherever it has to be."""
        return not self.problems

    @property
    def problems(self) -> tuple[str, ...]:
        """What speaks against it, one sentence each."""
        return (
            *self.deployment.problems,
            *_of_fallback(self.fallback.problems if self.fallback else ()),
        )

    @property
    def unmet_limits(self) -> tuple[str, ...]:
        """The limits that the loop misses as it runs, at an operating point or over the tolerances,
        in words.
        """
        return (
            *unmet_limits(self.deployment),
            *_of_fallback(unmet_limits(self.fallback) if self.fallback else ()),
        )

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready data: target, paths of the files, whether the controller is verified, and what
        speaks against it.
        """
        paths, problems = [str(path) for path in self.paths], list(self.problems)
        return {
            "target": self.target,
            "files": paths,
            "verified": self.verified,
            "problems": problems,
            "unmet_limits": list(self.unmet_limits),
        }


def _of_fallback(sentences: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(f"of the fallback: {sentence}" for sentence in sentences)


def export(
    controller: LawLike,
    directory: str | Path,
    *,
    to: Target,
    machine: Machine | None = None,
    options: ExportOptions | None = None,
    fallback: LawLike | None = None,
    progress: Progress = lambda stage: None,
) -> Delivery:
    """Write a controller for a target into ``directory``, after its sampled loop was verified at
    every point of ``machine``.

    controller: a Synthesis, or a system from errors [m] to currents [A] (StateSpace,
    python-control); signals not called err_<axis> are the machine's axes in their order. A
    scheduled controller is written in floating point. to: "c" (C99), "mat" (MATLAB, Octave), "fmu"
    (FMI 2.0 and 3.0), "st" (IEC 61131-3). machine: None: the bundled one that the controller was
    made for, if it is unchanged. fallback: the fixed controller that takes over from one scheduled
    over pressure where the reading cannot be trusted (C only). Raises InvalidInput, and
    UnstableSystem for a controller that is refused (``deploy``).
    """
    options = ExportOptions() if options is None else options
    synthesis = _synthesis(controller, machine)
    _check_target(synthesis, to, options)
    machine = bundled_machine(synthesis) if machine is None else machine
    other = _fallback(fallback, synthesis, to, machine, options)
    limits = _limits(synthesis, machine, options)
    check_place(directory)  # all this before the verification, which takes seconds
    if to == "fmu" and not options.sources_only:
        check_compiler()
    with claimed(directory, "folder"):
        deployment, block = _deploy(
            synthesis, machine, options, limits, progress, other is not None
        )
        lines, beside = provenance_lines(synthesis, deployment), None
        if (
            other is not None
            and isinstance(block, ScheduledBlock)
            and synthesis.scheduled is not None
        ):
            same = replace(options, rate=1 / block.sample_time, delay_samples=block.delay)
            try:
                fixed, law = _deploy(other, machine, same, limits, progress)
            except UnstableSystem as error:
                raise UnstableSystem(f"the fallback: {error}") from error
            beside = cast(Deployment, fixed)
            stuck = math.inf if options.stuck_after is None else options.stuck_after
            band = options.pressure_error or 0.0
            watch = supervision_limits(
                synthesis.scheduled, machine, options.pressure_rate, band, stuck
            )
            block = supervise(block, cast(ControlBlock, law), watch)
            lines = [*lines, "Fallback:", *provenance_lines(other, fixed)]
        progress("writing")
        files = _files(to, synthesis, deployment, block, options, lines)
        return Delivery(
            to, deployment, block, tuple(write_files(directory, files, held=True)), beside
        )


def _fallback(
    fallback: LawLike | None,
    synthesis: Synthesis,
    to: Target,
    machine: Machine | None,
    options: ExportOptions,
) -> Synthesis | None:
    """What takes over, its signals in the schedule's order; None: nothing does. Raises
    InvalidInput.
    """
    if fallback is None:
        for name in ("pressure_error", "stuck_after"):
            if getattr(options, name) is not None:
                raise invalid(
                    name,
                    getattr(options, name),
                    "left out",
                    "it belongs to a fallback: name the fixed controller",
                )
        return None
    check_pair(synthesis, fallback)
    if to != "c":
        raise invalid(
            "a fallback",
            f"given for the target {to!r}",
            "left out",
            "write C, which has the supervision",
        )
    if options.pressure_limit is not None:
        remedy = "a reading beyond the range counts as lost: leave it out"
        raise invalid(
            "pressure_limit", f"{options.pressure_limit:g} Pa", "left out with a fallback", remedy
        )
    found = _synthesis(fallback, machine)
    axes = [name.removeprefix("err_") for name in synthesis.controller.inputs]
    found = replace(
        found,
        controller=match_axes(found.controller, axes, found.provenance.machine or "this machine"),
    )
    own, given = timing_of(machine, synthesis) or DEFAULT, timing_of(machine, found)
    alike = given is None or (own.sample_time, own.delay_samples) == (
        given.sample_time,
        given.delay_samples,
    )
    if options.rate is None and not alike:
        remedy = f"design it with --rate-hz {own.rate:g}, or say at which rate both run"
        raise invalid("the fallback", str(given), f"the schedule's: {own}", remedy)
    return found


def _synthesis(controller: LawLike, machine: Machine | None) -> Synthesis:
    """``controller`` with what is known of its origin. Raises InvalidInput."""
    law = law_of(controller)
    synthesis = synthesis_of(law)
    if synthesis is not law and synthesis.scheduled is None:
        synthesis = replace(synthesis, controller=_on_axes(synthesis.controller, machine))
    if synthesis.provenance.date or machine is None:
        return synthesis
    return _made_for(synthesis, machine)


def _made_for(synthesis: Synthesis, machine: Machine) -> Synthesis:
    """A synthesis that was never written to a file, with the machine that a file would record."""
    origin = replace(synthesis.provenance, machine=machine.name, machine_hash=machine_hash(machine))
    return replace(synthesis, provenance=origin)


def _on_axes(system: StateSpace, machine: Machine | None) -> StateSpace:
    """A system with names of its own takes those of the machine's axes, in their order. Raises
    InvalidInput.
    """
    if machine is None or any(name.startswith("err_") for name in system.inputs):
        return system
    count = len(machine.axes)
    if system.D.shape != (count, count):
        required = f"({count}, {count}) for the axes {', '.join(machine.axes)}"
        raise invalid(
            "the controller's size (outputs, inputs)",
            system.D.shape,
            required,
            "design it for this machine",
        )
    return rename(
        system, [f"err_{axis}" for axis in machine.axes], [f"u_{axis}" for axis in machine.axes]
    )


def _check_target(synthesis: Synthesis, to: Target, options: ExportOptions) -> None:
    """What can be refused before anything is computed. Raises InvalidInput."""
    if to not in TARGETS:
        raise invalid("the target", repr(to), " or ".join(TARGETS), "choose one of them")
    scheduled, along = synthesis.scheduled, synthesis.scheduled_over
    for other in BOTH.parts:
        if (along is None or other not in along.each) and options.told(other) != ((None,), (None,)):
            what = f"{other.name}_limit or {other.name}_rate"
            raise invalid(
                what, "given", "left out", f"this controller is not scheduled over {other.name}"
            )
    if along is not None and along.parts and to != "c":
        what = "write C, or design over one with --speeds-hz or --pressures-bar alone"
        raise invalid(
            f"a schedule over {along.name}", f"for the target {to!r}", "for the target 'c'", what
        )
    if scheduled is not None and along is not None:
        check_precision(options.arithmetic)
        if options.form == "cascade":
            raise invalid(
                "form",
                "'cascade'",
                "'modal' for a scheduled controller",
                f"its sections change with the {scheduled.parameter}",
            )
        check_told_limits(scheduled.axes, along, *options.told(along))
    if options.form == "cascade" and to != "c":
        raise invalid(
            "form",
            "'cascade'",
            f"'modal' for the target {to!r}",
            "write C for the sections one by one",
        )
    if options.arithmetic not in TARGETS[to]:
        allowed = f"{' or '.join(TARGETS[to])} for the target {to!r}"
        raise invalid(
            "arithmetic", repr(options.arithmetic), allowed, "choose it, or another target"
        )


def _deploy(
    synthesis: Synthesis,
    machine: Machine | None,
    options: ExportOptions,
    limits: tuple[ArrayLike, ArrayLike],
    progress: Progress,
    supervised: bool = False,
) -> tuple[Deployment | ScheduledDeployment, ControlBlock | ScheduledBlock]:
    asked = (
        options.delay_samples
        if options.rate is not None or timing_of(machine, synthesis) is not None
        else None
    )
    timing = timing_of(machine, synthesis, options.rate, asked) or replace(
        DEFAULT,
        delay_samples=DEFAULT.delay_samples
        if options.delay_samples is None
        else options.delay_samples,
    )
    dt = timing.sample_time
    delay, sampling = (
        timing.delay_samples * dt,
        {"method": options.sampling, "prewarp": options.prewarp},
    )
    how: dict[str, Any] = {**sampling, "force": options.force, "progress": progress}
    guards: dict[str, Any] = {
        "windup_time": options.windup_time,
        "hold_samples": options.hold_samples,
    }
    if synthesis.scheduled is None:
        plants = (
            []
            if machine is None
            else [assemble(machine, point) for point in machine.operation.envelope]
        )
        fixed = deploy(synthesis, dt, delay, plants=plants, **how)
        if options.form == "cascade":
            guards["prewarp"] = options.prewarp
            return fixed, build_cascade(
                fixed, synthesis.filters, machine, options.name, *limits, **guards
            )
        return fixed, build_block(fixed, options.name, *limits, **guards)
    over = deploy_scheduled(synthesis, dt, delay, machine=machine, **how)
    if not supervised:
        guards |= dict(zip(("told_limit", "rate_limit"), options.told(over.along), strict=True))
    return over, build_scheduled_block(over, options.name, *limits, **guards)


def _files(
    to: Target,
    synthesis: Synthesis,
    deployment: Deployment | ScheduledDeployment,
    block: ControlBlock | ScheduledBlock,
    options: ExportOptions,
    lines: Sequence[str],
) -> Mapping[str, str | bytes]:
    if to == "c":
        return generate(block, options.arithmetic, lines)
    if to == "mat":
        return generate_mat(block, deployment, synthesis, lines)
    if to == "st":
        return generate_structured_text(block, cast(Precision, options.arithmetic), lines)
    return generate_fmus(block, options.arithmetic, lines, sources_only=options.sources_only)


def bundled_machine(synthesis: Synthesis) -> Machine | None:
    """The bundled machine that the file was made for; None where there is none, or it has changed
    since.
    """
    if synthesis.provenance.machine not in bundled_machines():
        return None
    machine = load_machine(str(synthesis.provenance.machine))
    return machine if machine_hash(machine) == synthesis.provenance.machine_hash else None


def machine_limits(machine: Machine) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Per axis the largest plausible displacement [m] and the largest current [A]; None where a
    bearing does not say.
    """
    gaps, currents = [], []
    for bearing in machine.bearings:
        gap = (
            bearing.gap
            if bearing.gap is not None
            else bearing.touchdown_gap and 2 * bearing.touchdown_gap
        )
        gaps += [gap, gap]
        currents += [bearing.max_current] * 2
    known = [None if None in values else np.array(values, float) for values in (gaps, currents)]
    return known[0], known[1]


def _limits(
    synthesis: Synthesis, machine: Machine | None, options: ExportOptions
) -> tuple[ArrayLike, ArrayLike]:
    """The limits given, else those of the machine. Raises InvalidInput where neither says one."""
    errors, currents = (None, None) if machine is None else machine_limits(machine)
    error = _known(
        errors if options.error_limit is None else options.error_limit, "the error limit", "m"
    )
    current = _known(
        currents if options.current_limit is None else options.current_limit,
        "the current limit",
        "A",
    )
    check_limits(
        error, len(synthesis.controller.inputs), "error_limit", "the bearing's gap is the largest"
    )
    check_limits(
        current,
        len(synthesis.controller.outputs),
        "current_limit",
        "give the largest control current in A",
    )
    return error, current


def _known(value: ArrayLike | None, what: str, unit: str) -> ArrayLike:
    if value is None:
        remedy = (
            "name the machine file, --machine my.toml (no bundled machine is the one it was made "
            "for), or state it"
        )
        raise invalid(what, "unknown", f"given in {unit}", remedy)
    return value
