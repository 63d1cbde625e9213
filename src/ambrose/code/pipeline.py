"""From a controller to files for a target: sampled, verified on its machine, limited by it,
written.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from ambrose.code.block.block import ControlBlock, build_block, check_limits
from ambrose.code.block.cascade import build_cascade
from ambrose.code.block.scheduled import (
    ScheduledBlock,
    build_scheduled_block,
    check_told_limits,
    supervise,
)
from ambrose.code.c.code import check_precision
from ambrose.code.interface import AllAxes, Base, Law
from ambrose.code.processor_trial import Trial
from ambrose.code.sampled import (
    Deployment,
    Difference,
    Progress,
    ScheduledDeployment,
    deploy,
    deploy_scheduled,
    parameter_difference,
    unmet_limits,
    verdict,
)
from ambrose.code.targets import TARGETS, C, Target
from ambrose.core.checks import (
    InvalidInput,
    UnstableSystem,
    invalid,
    named_failure,
    same_clock,
)
from ambrose.core.presentation import Presented, with_unit
from ambrose.core.scheduled import ScheduledSystem
from ambrose.core.statespace import StateSpace, rename
from ambrose.judge.checks import Check, Checks
from ambrose.judge.result import Synthesis, synthesis_of
from ambrose.law.law import BOTH, LawLike, extension, law_of
from ambrose.law.loop import DEFAULT, Timing, check_side, match_axes, timing_of
from ambrose.law.supervision import check_pair, supervision_limits
from ambrose.machine.file.toml import bundled_machines, load_machine, machine_hash
from ambrose.machine.machine import THRUST, Machine
from ambrose.machine.ordinary_file import check_place, claimed, write_files
from ambrose.machine.part import Synchronous
from ambrose.model.assemble import assemble
from ambrose.model.plant import holds_only
from ambrose.options import choose
from ambrose.version import __version__

# The lines of a generated file's header: where the controller comes from and what it was verified
# on.


def provenance_lines(
    synthesis: Synthesis,
    deployment: Deployment | ScheduledDeployment,
    machine: Machine | None = None,
) -> Sequence[str]:
    """Origin, sampling, verification, and what speaks against the controller, one line each."""
    made = synthesis.provenance
    written = f"written {made.date}" if made.date else "made"
    lines = [
        f"Controller {synthesis.method}, {written} by ambrose {made.package_version}; code by "
        f"ambrose {__version__}.",
        f"Machine    {made.machine or 'not recorded'}, hash {made.machine_hash or 'not recorded'}.",
    ]
    lines += deployment.lines()
    if machine is not None and (only := holds_only(machine)):
        lines.append(f"Valid      {only}.")
    if not deployment.checks:
        lines.append("Verified   NOT: the sampled loop was not examined.")
    for box in deployment.box:
        count, label = box["sampled.stability.box"], box.label.removesuffix(", sampled")
        lines.append(f"Verified   {label}: {count.value:.0f} unstable of {count.detail}.")
    lines += [
        f"Outside    the range, clamped, {c.label}: {verdict(c)}." for c in deployment.outside
    ]
    lines += [f"Forced     although {problem}." for problem in deployment.problems]
    return lines + [f"Unmet      {text}." for text in unmet_limits(deployment)]


# Synchronous blocks of an export: which there are, their verdict in the loop as it will run, and
# the unit that runs them beside the controller.


_DIVERGES = ("synchronous.margin", "synchronous.gain")


def blocks_beside(
    synthesis: Synthesis, machine: Machine | None, target: Target
) -> tuple[Synchronous, ...]:
    """The blocks of a controller, else of its machine. Raises InvalidInput where the target, or a
    missing machine, leaves no way to write them.
    """
    blocks = synthesis.synchronous if machine is None else synthesis.blocks_on(machine)
    if blocks:
        target.check_beside()
        if machine is None:
            raise InvalidInput(
                "the synchronous blocks need the machine file for the signals they read; name it "
                "(--machine my.toml)"
            )
        extension("refuse")(blocks, machine)
    return blocks


def diverging(judged: Sequence[Checks]) -> tuple[str, ...]:
    """What of the checks speaks of a block that is not proved to converge, in words."""
    return tuple(
        f"{item.label}: {_said(check)}"
        for item in judged
        for check in item.failed
        if check.name.startswith(_DIVERGES)
    ) + tuple(f"{item.label}: {' '.join(item.notes)}" for item in judged if not item.stable)


def missed_beside(judged: Sequence[Checks]) -> tuple[str, ...]:
    """The other limits that the blocks miss, in words."""
    return tuple(
        f"{item.label}: {_said(check)}"
        for item in judged
        for check in item.failed
        if not check.name.startswith(_DIVERGES)
    )


def _said(check: Check) -> str:
    value, limit = with_unit(check.value, check.unit), check.limit or 0.0
    detail = f", {check.detail}" if check.detail else ""
    return f"{check.title} {value} (limit {check.relation} {limit:.4g}){detail}"


# How the axial controller is written beside the radial one, and what comes of it.


@dataclass(frozen=True, slots=True, eq=False)
class AxialPart:
    """The axial controller beside a radial one: its verification as it runs, and its block."""

    deployment: Deployment
    block: ControlBlock


def axial_target(target: Target, machine: Machine | None, timing: Timing | None) -> Target:
    """How the axial part is written: as the radial one, under its own name.

    timing: the axial controller's own, None where it states none. Raises InvalidInput for a machine
    without a thrust bearing, and what is tried part by part.
    """
    part = target.along_shaft()
    if machine is None or THRUST not in machine.groups:
        raise InvalidInput(
            "the machine has no thrust bearing; name its file with --machine, without #axial, or "
            "leave the axial controller out"
        )
    rate = target.rate
    if timing is not None and rate is not None and not same_clock(1 / rate, timing.sample_time):
        raise invalid(
            "the axial controller",
            str(timing),
            f"sampled at the radial one's {rate:g} Hz",
            f"design it with --rate-hz {rate:g}: one processor runs both",
        )
    return part


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Delivery(Presented):
    """What was written for a target, and what it was verified on; fallback: the same of the
    controller that takes over; synchronous: of the blocks beside it; trial: on its processor.
    difference: what leads from the code of a replaced controller to this one (None: none was
    named); not_alike: why there is none although one was. axial: the part along the shaft of a unit
    of all axes; apart: why it is a unit of its own ("": it is not).
    """

    target: str
    deployment: Deployment | ScheduledDeployment
    block: ControlBlock | ScheduledBlock
    paths: tuple[Path, ...]
    fallback: Deployment | None = None
    synchronous: tuple[Checks, ...] = ()
    difference: Difference | None = None
    not_alike: str = ""
    trial: Trial | None = None
    axial: AxialPart | None = None
    apart: str = ""

    @property
    def _parts(self) -> list[tuple[str, Deployment]]:
        """What runs besides, and what it is called."""
        axial = None if self.axial is None else self.axial.deployment
        both = (("of the fallback", self.fallback), ("along the shaft", axial))
        return [(who, part) for who, part in both if part is not None]

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
        tried = {} if self.trial is None else {"trial": dict(self.trial.facts())}
        return facts | tried | {name: items for name, items in found.items() if items}

    @property
    def verified(self) -> bool:
        """Whether the controller, and the one that takes over, is stable wherever it has to be."""
        return not self.problems

    @property
    def problems(self) -> tuple[str, ...]:
        """What speaks against it, one sentence each."""
        return (
            *self.deployment.problems,
            *diverging(self.synchronous),
            *(f"{who}: {what}" for who, part in self._parts for what in part.problems),
        )

    @property
    def unmet_limits(self) -> tuple[str, ...]:
        """The limits that the loop misses as it runs, at an operating point or over the tolerances,
        in words.
        """
        return (
            *unmet_limits(self.deployment),
            *missed_beside(self.synchronous),
            *(f"{who}: {what}" for who, part in self._parts for what in unmet_limits(part)),
            *(self.trial.problems if self.trial else ()),
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
            **({"not_alike": self.not_alike} if self.not_alike else {}),
            **({"two_units": self.apart} if self.apart else {}),
            **({} if self.trial is None else {"trial": self.trial.to_dict()}),
        }


@named_failure("the exported controller")
def export(
    controller: LawLike,
    directory: str | Path,
    *,
    to: Target | str,
    machine: Machine | None = None,
    fallback: LawLike | None = None,
    replaces: LawLike | None = None,
    axial: LawLike | None = None,
    axes: str | None = None,
    progress: Progress = lambda stage: None,
    **options: Any,
) -> Delivery:
    """Write a controller for a target into ``directory``, after its sampled loop was verified at
    every point of ``machine``.

    controller: a Synthesis, or a system from errors [m] to currents [A] (StateSpace,
    python-control); signals not called err_<axis> are the machine's axes in their order. A
    scheduled controller is written in floating point. to: a target with its options, or the name of
    one, its options then by name: ``C`` (C99), ``Mat`` (MATLAB, Octave), ``Fmu`` (FMI 2.0 and 3.0),
    ``St`` (IEC 61131-3), "c", "mat", "fmu" and "st". machine: None: the bundled one that the
    controller was made for, if it is unchanged. fallback: the fixed controller that takes over from
    one scheduled over pressure where the reading cannot be trusted (C only). replaces: the fixed
    controller that runs now (C only): beside the whole unit parameters.json, what changes in the
    tables of its code, and parameters-back.json, the way back, where both have one structure.
    axial: the fixed controller of the thrust axis (None: that of ``controller``): in C and FMU both
    are one unit whose step takes the errors of all axes, elsewhere two. axes: the one group of axes
    that is written (None: all whose controllers are given).
    Raises InvalidInput, and UnstableSystem for a controller that is refused (``deploy``).
    """
    target = choose(TARGETS, "the target", to, options)
    machine = machine if machine is None or axes is None else machine.only(axes)
    given = law_of(controller)
    if axes == THRUST or (machine is not None and machine.group == THRUST):
        given = given.thrust or given
    elif axes is None and axial is None:
        axial = given.thrust
    synthesis = _synthesis(given, machine)
    _check_target(synthesis, target)
    machine = bundled_machine(synthesis) if machine is None else machine
    if machine is not None and axial is None:
        check_side((synthesis.scheduled or synthesis.controller).inputs, machine)
    around = blocks_beside(synthesis, machine, target)
    other = _fallback(fallback, synthesis, target, machine)
    running = _replaced(replaces, synthesis, target, machine, alone=not around)
    limits = _limits(synthesis, machine, target)
    along = None if axial is None else _along(axial, synthesis, target, machine)
    check_place(directory)  # all this before the verification, which takes seconds
    target.check_tools()
    target.check_trial(lambda: _unverified(synthesis, machine, target, limits))
    with claimed(directory, "folder"):
        deployment, block = _deploy(synthesis, machine, target, limits, progress, other is not None)
        lines, beside = provenance_lines(synthesis, deployment, machine), None
        if other is not None:
            beside, waiting = _deploy_beside(
                "the fallback", block, other, machine, target, limits, progress
            )
            # of a schedule over pressure and for C alone: anything else was refused
            whole, schedule = cast(C, target), cast(ScheduledSystem, synthesis.scheduled)
            stuck = math.inf if whole.stuck_after is None else whole.stuck_after
            band = whole.pressure_error or 0.0
            watch = supervision_limits(schedule, machine, whole.pressure_rate, band, stuck)
            block = supervise(cast(ScheduledBlock, block), waiting, watch)
            lines = [*lines, "Fallback:", *provenance_lines(other, beside)]
        judged: tuple[Checks, ...] = ()
        law: Law = block
        if around and machine is not None:
            runs = (
                synthesis if isinstance(deployment, ScheduledDeployment) else deployment.controller
            )
            law, judged = extension("unit")(
                around, machine, runs, block, progress, force=target.force
            )
        part: AxialPart | None = None
        shaft: Sequence[str] = ()
        if along is not None and machine is not None:
            part, shaft = _axial_part(*along, machine.axial, block, progress)
        apart = "" if part is None else target.apart
        unit = law if part is None or apart else AllAxes(law, part.block)
        files = target.files(unit, lines, shaft, (synthesis, deployment))
        if part is not None and along is not None and apart:
            made = along[0], part.deployment
            files = {**files, **along[1].files(part.block, shaft, (), made)}
        difference, not_alike = None, ""
        if running is not None:
            # its loop is not judged again: it runs
            as_it_is, described = replace(target, force=True), machine if target.cascade else None
            as_deployed, old = _deploy_beside(
                "what is replaced", block, running, described, as_it_is, limits, progress
            )
            before = target.files(old, (), (), (running, as_deployed))
            own = f"{target.name}.c"
            try:
                difference = parameter_difference(str(before[own]), str(files[own]))
            except InvalidInput as error:
                not_alike = str(error)
            else:
                files = {**files, **difference.files()}
        trial = target.tried(law, files, progress)
        if trial is not None:
            files = {**files, f"{block.name}_{trial.processor.name}.md": trial.report()}
        progress("writing")
        paths = tuple(write_files(directory, files, held=True))
        return Delivery(
            *(target.to, deployment, block, paths, beside, judged, difference, not_alike, trial),
            axial=part,
            apart=apart,
        )


def unverified_block(
    controller: LawLike, machine: Machine, target: C
) -> ControlBlock | ScheduledBlock:
    """The block that ``export`` would write, before its loop is verified. Raises InvalidInput."""
    synthesis = _synthesis(controller, machine)
    _check_target(synthesis, target)
    if blocks_beside(synthesis, machine, target):
        raise InvalidInput(
            "the target's binary runs in the loop without synchronous blocks; leave them out of "
            "the controller's file"
        )
    return _unverified(synthesis, machine, target, _limits(synthesis, machine, target))


def _unverified(
    synthesis: Synthesis,
    machine: Machine | None,
    target: Target,
    limits: tuple[ArrayLike, ArrayLike],
) -> ControlBlock | ScheduledBlock:
    """The controller's block before any verification: how large its code is."""
    timing = timing_of(machine, synthesis, target.rate, target.delay_samples) or DEFAULT
    early = replace(target, rate=timing.rate, delay_samples=timing.delay_samples, force=True)
    return _deploy(synthesis, None, early, limits, lambda stage: None)[1]


def _fallback(
    fallback: LawLike | None, synthesis: Synthesis, target: Target, machine: Machine | None
) -> Synthesis | None:
    """What takes over, its signals in the schedule's order; None: nothing does. Raises
    InvalidInput.
    """
    if fallback is None:
        for name in ("pressure_error", "stuck_after"):
            if (value := getattr(target, name, None)) is not None:
                raise invalid(
                    name,
                    value,
                    "left out",
                    "it belongs to a fallback: name the fixed controller",
                )
        return None
    check_pair(synthesis, fallback)
    if not target.whole:
        raise invalid(
            "a fallback",
            f"given for the target {target.to!r}",
            "left out",
            "write C, which has the supervision",
        )
    if target.pressure_limit is not None:
        remedy = "a reading beyond the range counts as lost: leave it out"
        raise invalid(
            "pressure_limit", f"{target.pressure_limit:g} Pa", "left out with a fallback", remedy
        )
    found = _synthesis(fallback, machine)
    axes = [name.removeprefix("err_") for name in synthesis.controller.inputs]
    found = replace(
        found,
        controller=match_axes(found.controller, axes, found.provenance.machine or "this machine"),
    )
    own, given = timing_of(machine, synthesis) or DEFAULT, timing_of(machine, found)
    alike = given is None or (
        same_clock(own.sample_time, given.sample_time) and own.delay_samples == given.delay_samples
    )
    if target.rate is None and not alike:
        remedy = f"design it with --rate-hz {own.rate:g}, or say at which rate both run"
        raise invalid("the fallback", str(given), f"the schedule's: {own}", remedy)
    return found


def _along(
    axial: LawLike, synthesis: Synthesis, target: Target, machine: Machine | None
) -> tuple[Synthesis, Target]:
    """The axial controller and how it is written. Raises InvalidInput before anything is
    computed.
    """
    if machine is not None and machine.group == THRUST:
        raise InvalidInput(
            "the axial controller is exported together with the radial one; name the radial "
            "controller first, and the machine without #axial"
        )
    known = None if machine is None else machine.groups.get(THRUST)
    found = _synthesis(axial, known)
    if found.scheduled is not None or len(found.controller.inputs) != 1:
        raise invalid(
            "the axial controller",
            f"one of {len(found.controller.inputs)} errors"
            if found.scheduled is None
            else "a schedule",
            "a fixed one of the one axis along the shaft",
            "give the file that was designed with --axes thrust",
        )
    own = timing_of(machine, synthesis, target.rate, target.delay_samples) or DEFAULT
    same = replace(target, rate=own.rate, delay_samples=own.delay_samples)
    return found, axial_target(same, machine, timing_of(known, found))


def _axial_part(
    synthesis: Synthesis,
    target: Target,
    machine: Machine,
    radial: ControlBlock | ScheduledBlock,
    progress: Progress,
) -> tuple[AxialPart, Sequence[str]]:
    """The axial controller verified at the radial one's rate, and where it comes from."""
    progress("the axis along the shaft")
    limits = _limits(synthesis, machine, target)
    part = AxialPart(
        *_deploy_beside(
            "the axis along the shaft", radial, synthesis, machine, target, limits, progress
        )
    )
    return part, provenance_lines(synthesis, part.deployment)


def _replaced(
    replaces: LawLike | None,
    synthesis: Synthesis,
    target: Target,
    machine: Machine | None,
    *,
    alone: bool,
) -> Synthesis | None:
    """The controller that is replaced, its signals in the other's order; None: none is named.
    Raises InvalidInput.
    """
    if replaces is None:
        return None
    found = _synthesis(replaces, machine)
    if not target.whole:
        raise invalid(
            "a controller to replace",
            f"given for the target {target.to!r}",
            "left out",
            "write C, whose tables can be compared",
        )
    if not alone or found.scheduled is not None or synthesis.scheduled is not None:
        raise invalid(
            "a controller to replace",
            "given with synchronous blocks or a schedule",
            "left out",
            "such a unit is replaced as a whole",
        )
    axes = [name.removeprefix("err_") for name in synthesis.controller.inputs]
    name = found.provenance.machine or "this machine"
    return replace(found, controller=match_axes(found.controller, axes, name))


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


def _check_target(synthesis: Synthesis, target: Target) -> None:
    """What can be refused before anything is computed. Raises InvalidInput."""
    scheduled, along = synthesis.scheduled, synthesis.scheduled_over
    for other in BOTH.parts:
        if (along is None or other not in along.each) and target.schedule_limits(other) != (
            (None,),
            (None,),
        ):
            what = f"{other.name}_limit or {other.name}_rate"
            raise invalid(
                what, "given", "left out", f"this controller is not scheduled over {other.name}"
            )
    if along is not None and along.parts and not target.whole:
        what = "write C, or design over one with --speeds-hz or --pressures-bar alone"
        raise invalid(
            f"a schedule over {along.name}",
            f"for the target {target.to!r}",
            "for the target 'c'",
            what,
        )
    if scheduled is not None and along is not None:
        check_precision(target.arithmetic)
        if target.cascade:
            raise invalid(
                "form",
                "'cascade'",
                "'modal' for a scheduled controller",
                f"its sections change with the {scheduled.parameter}",
            )
        check_told_limits(scheduled.axes, along, *target.schedule_limits(along))


def _deploy(
    synthesis: Synthesis,
    machine: Machine | None,
    target: Target,
    limits: tuple[ArrayLike, ArrayLike],
    progress: Progress,
    supervised: bool = False,
) -> tuple[Deployment | ScheduledDeployment, ControlBlock | ScheduledBlock]:
    asked = (
        target.delay_samples
        if target.rate is not None or timing_of(machine, synthesis) is not None
        else None
    )
    timing = timing_of(machine, synthesis, target.rate, asked) or replace(
        DEFAULT,
        delay_samples=DEFAULT.delay_samples
        if target.delay_samples is None
        else target.delay_samples,
    )
    dt = timing.sample_time
    delay, sampling = (
        timing.delay_samples * dt,
        {"method": target.sampling, "prewarp": target.prewarp},
    )
    how: dict[str, Any] = {**sampling, "force": target.force, "progress": progress}
    guards: dict[str, Any] = {
        name: value
        for name in ("windup_time", "hold_samples")
        if (value := getattr(target, name)) is not None
    }
    if synthesis.scheduled is None:
        plants = (
            []
            if machine is None
            else [assemble(machine, point) for point in machine.operation.envelope]
        )
        fixed = deploy(synthesis, dt, delay, plants=plants, **how)
        if target.cascade:
            guards["prewarp"] = target.prewarp
            return fixed, build_cascade(
                fixed, synthesis.filters, machine, target.name, *limits, **guards
            )
        return fixed, build_block(fixed, target.name, *limits, **guards)
    over = deploy_scheduled(synthesis, dt, delay, machine=machine, **how)
    if not supervised:
        guards |= dict(
            zip(("told_limit", "rate_limit"), target.schedule_limits(over.along), strict=True)
        )
    return over, build_scheduled_block(over, target.name, *limits, **guards)


def _deploy_beside(
    called: str,
    block: Base,
    synthesis: Synthesis,
    machine: Machine | None,
    target: Target,
    limits: tuple[ArrayLike, ArrayLike],
    progress: Progress,
) -> tuple[Deployment, ControlBlock]:
    """A fixed controller of the same unit, at the clock of its block; called: what a refusal names.
    Raises InvalidInput, UnstableSystem.
    """
    same = replace(target, rate=1 / block.sample_time, delay_samples=block.delay)
    try:
        found = _deploy(synthesis, machine, same, limits, progress)
    except UnstableSystem as error:
        raise UnstableSystem(f"{called}: {error}") from error
    return cast(tuple[Deployment, ControlBlock], found)


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
    gaps, currents = (None if most is None else np.array(most) for most in machine.reach)
    return gaps, currents


def _limits(
    synthesis: Synthesis, machine: Machine | None, target: Target
) -> tuple[ArrayLike, ArrayLike]:
    """The limits given, else those of the machine. Raises InvalidInput where neither says one."""
    errors, currents = (None, None) if machine is None else machine_limits(machine)
    error = _known(
        errors if target.error_limit is None else target.error_limit, "the error limit", "m"
    )
    current = _known(
        currents if target.current_limit is None else target.current_limit,
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
            "state it, or name the machine file (--machine my.toml); the controller was made for "
            "none of the bundled machines"
        )
        raise invalid(what, "unknown", f"given in {unit}", remedy)
    return value
