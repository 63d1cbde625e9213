"""From a controller file to files for a target: sampled, verified on its machine, limited by it, written."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, cast

import numpy as np
from numpy.typing import ArrayLike

from ambrose import __version__
from ambrose.core.checks import invalid
from ambrose.core.sampling import Method
from ambrose.deployment.block.fixed import HOLD_SAMPLES, WINDUP_TIME, ControlBlock, check_limits, control_block
from ambrose.deployment.block.names import check_identifier
from ambrose.deployment.block.scheduled import ScheduledBlock, check_speed_limits, scheduled_block
from ambrose.deployment.c.fixed import Arithmetic, generate
from ambrose.deployment.c.scheduled import generate_scheduled
from ambrose.deployment.discretisation.fixed import Deployment, Progress, deploy, unmet
from ambrose.deployment.discretisation.scheduled import ScheduledDeployment, deploy_scheduled
from ambrose.deployment.fmu.archive import fmu_files
from ambrose.deployment.mat import mat_files
from ambrose.deployment.scheduled_pipeline import check_deliverable, scheduled_provenance
from ambrose.deployment.structured_text import Precision, structured_text
from ambrose.machine.atomic_write import check_place, write_files
from ambrose.machine.file.toml import bundled_machines, load_machine, machine_hash
from ambrose.machine.machine import Machine
from ambrose.plant.assemble import assemble
from ambrose.synthesis.result import Synthesis

SAMPLE_TIME = 1e-4  # s, where neither the caller nor the controller says one
Target = Literal["c", "mat", "fmu", "st"]
Files = Mapping[str, str | bytes]


@dataclass(frozen=True, slots=True, eq=False)
class Order:
    """What a target writes from: the controller file, its deployment and block, the lines of provenance, and the options."""

    file: Synthesis
    deployment: Deployment
    block: ControlBlock
    lines: Sequence[str]
    arithmetic: Arithmetic
    sources_only: bool


TARGETS: Mapping[Target, Callable[[Order], Files]] = {
    "c": lambda order: generate(order.block, order.arithmetic, order.lines),
    "mat": lambda order: mat_files(order.block, order.deployment, order.file, order.lines),
    "fmu": lambda order: fmu_files(order.block, order.arithmetic, order.lines, sources_only=order.sources_only),
    "st": lambda order: structured_text(order.block, cast(Precision, order.arithmetic), order.lines),
}
_ARITHMETIC: Mapping[Target, tuple[Arithmetic, ...]] = {
    "c": ("double", "float", "fixed32", "fixed16"), "fmu": ("double", "float", "fixed32", "fixed16"),
    "mat": ("double",), "st": ("double", "float"),
}  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Delivery:
    """What was written, and what it was verified on."""

    deployment: Deployment | ScheduledDeployment
    block: ControlBlock | ScheduledBlock
    paths: tuple[Path, ...]


def deliver(
    file: Synthesis,
    directory: str | Path,
    machine: Machine | None = None,
    *,
    target: Target = "c",
    name: str = "controller",
    arithmetic: Arithmetic = "double",
    sample_time: float | None = None,
    delay_samples: int = 1,
    method: Method = "tustin",
    prewarp: float | None = None,
    error_limit: ArrayLike | None = None,
    current_limit: ArrayLike | None = None,
    windup_time: float = WINDUP_TIME,
    hold_samples: int = HOLD_SAMPLES,
    speed_limit: float | None = None,
    speed_rate: float | None = None,
    sources_only: bool = False,
    force: bool = False,
    progress: Progress = lambda stage: None,
) -> Delivery:
    """Files of a controller file, in ``directory``, after its sampled loop was verified at every point of ``machine``.

    target: "c" (C99), "mat" (MATLAB, Octave), "fmu" (FMI 2.0 and 3.0), "st" (IEC 61131-3); sources_only: an FMU without binary.
    machine: None: the bundled one that the file names, if it is unchanged. sample_time [s]: None: the controller's own, or
    0.1 ms. error_limit [m], current_limit [A]: None: the bearings' gaps (or twice their touchdown gaps) and largest currents.
    speed_limit [rad/s], speed_rate [rad/s^2]: of a scheduled controller, which is written as C in floating point
    (``scheduled_block``). The other arguments: ``deploy``, ``deploy_scheduled``, ``control_block``, ``generate``. Raises
    InvalidInput, UnstableSystem.
    """
    _check_order(file, target, name, arithmetic, delay_samples)
    if file.scheduled is None and not (speed_limit is None and speed_rate is None):
        raise invalid("speed_limit or speed_rate", "given", "left out", "this controller is not scheduled over speed")
    machine = bundled_machine(file) if machine is None else machine
    error_limit, current_limit = _limits(file, machine, error_limit, current_limit)
    check_place(directory)  # all this before the verification, which takes seconds
    dt = sample_time or file.controller.dt or SAMPLE_TIME
    if file.scheduled is not None:
        check_speed_limits(file.scheduled.grid, speed_limit, speed_rate)
        over = deploy_scheduled(
            file, dt, delay_samples * dt, method=method, prewarp=prewarp, machine=machine, force=force, progress=progress
        )
        law = scheduled_block(
            over, name, error_limit, current_limit, windup_time=windup_time, hold_samples=hold_samples,
            speed_limit=speed_limit, rate_limit=speed_rate,
        )  # fmt: skip
        progress("writing")
        written = generate_scheduled(law, cast(Precision, arithmetic), scheduled_provenance(file, machine, over))
        return Delivery(over, law, tuple(write_files(directory, written)))
    plants = [] if machine is None else [assemble(machine, point) for point in machine.operation.points]
    deployment = deploy(
        file, dt, delay_samples * dt, method=method, prewarp=prewarp, plants=plants, force=force, progress=progress
    )
    block = control_block(deployment, name, error_limit, current_limit, windup_time=windup_time, hold_samples=hold_samples)
    progress("writing")
    order = Order(file, deployment, block, provenance(file, machine, deployment), arithmetic, sources_only)
    return Delivery(deployment, block, tuple(write_files(directory, TARGETS[target](order))))


def _check_order(file: Synthesis, target: Target, name: str, arithmetic: str, delay_samples: int) -> None:
    """What can be refused before anything is computed. Raises InvalidInput."""
    check_identifier(name, "the name of the block", "choose letters, digits and underscores")
    if target not in TARGETS:
        raise invalid("the target", repr(target), " or ".join(TARGETS), "choose one of them")
    if file.scheduled is not None:
        check_deliverable(file.scheduled, target, arithmetic)
    if arithmetic not in _ARITHMETIC[target]:
        allowed = " or ".join(_ARITHMETIC[target])
        raise invalid("arithmetic", repr(arithmetic), f"{allowed} for the target {target!r}", "choose it, or another target")
    if isinstance(delay_samples, bool) or not isinstance(delay_samples, int) or delay_samples < 0:
        raise invalid("delay_samples", delay_samples, "a whole number, zero or more", "1 is usual")


def bundled_machine(file: Synthesis) -> Machine | None:
    """The bundled machine that the file was made for; None where there is none, or it has changed since."""
    if file.provenance.machine not in bundled_machines():
        return None
    machine = load_machine(str(file.provenance.machine))
    return machine if machine_hash(machine) == file.provenance.machine_hash else None


def limits(machine: Machine) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Per axis the largest plausible displacement [m] and the largest current [A]; None where a bearing does not say."""
    gaps, currents = [], []
    for bearing in machine.bearings:
        gap = bearing.gap if bearing.gap is not None else bearing.touchdown_gap and 2 * bearing.touchdown_gap
        gaps += [gap, gap]
        currents += [bearing.max_current] * 2
    known = [None if None in values else np.array(values, float) for values in (gaps, currents)]
    return known[0], known[1]


def _limits(
    file: Synthesis, machine: Machine | None, error_limit: ArrayLike | None, current_limit: ArrayLike | None
) -> tuple[ArrayLike, ArrayLike]:
    """The limits given, else those of the machine. Raises InvalidInput where neither says one."""
    errors, currents = (None, None) if machine is None else limits(machine)
    error = _given(errors if error_limit is None else error_limit, "the error limit", "m")
    current = _given(currents if current_limit is None else current_limit, "the current limit", "A")
    check_limits(error, len(file.controller.inputs), "error_limit", "the bearing's gap is the largest")
    check_limits(current, len(file.controller.outputs), "current_limit", "give the largest control current in A")
    return error, current


def _given(value: ArrayLike | None, what: str, unit: str) -> ArrayLike:
    if value is None:
        remedy = "state it, or name the machine (no bundled one is the machine that this controller was made for)"
        raise invalid(what, "unknown", f"given in {unit}", remedy)
    return value


def provenance(file: Synthesis, machine: Machine | None, deployment: Deployment) -> Sequence[str]:
    """The lines of the header that say where the controller comes from and what it was verified on."""
    made = file.provenance
    lines = [
        f"Controller {file.method}, written {made.date} by ambrose {made.package_version}; code by ambrose {__version__}.",
        f"Machine    {made.machine or 'not recorded'}, hash {made.machine_hash or 'not recorded'}.",
        f"Sampled    by {deployment.method}, {deployment.delay} samples of computing delay in the loop.",
    ]
    if machine is None:
        lines.append("Verified   NOT: the sampled loop was not examined.")
    for checks in deployment.checks:
        verdict = "stable" if checks.stable else "UNSTABLE"
        with suppress(KeyError):
            verdict += f", sensitivity peak {checks['sensitivity.output.max'].value:.3g}"
        lines.append(f"Verified   {checks.label}: {verdict}.")
    if deployment.box is not None:
        count = deployment.box.checks[0]
        lines.append(f"Verified   over the tolerances: {count.value:.0f} unstable of {count.detail}.")
    lines += [f"Forced     although {problem}." for problem in deployment.problems]
    return lines + [f"Unmet      {text}." for text in unmet(deployment)]


__all__ = ["TARGETS", "Delivery", "Order", "Target", "bundled_machine", "deliver", "limits", "provenance"]
