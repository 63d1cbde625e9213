"""The machine file's own PID as a synthesis: certified on a plant, and as it runs."""

from __future__ import annotations

from dataclasses import replace

from ambrose.core.checks import InvalidInput, named_failure
from ambrose.judge.result import OF_MACHINE, Status, Synthesis, certify, certify_as_it_runs
from ambrose.law.loop import Timing, machine_timing
from ambrose.law.pid import pid_controller
from ambrose.machine.machine import Machine
from ambrose.machine.part import PidSettings
from ambrose.model.plant import Plant


def pid_synthesis(
    plant: Plant, settings: PidSettings | None = None, timing: Timing | None = None
) -> Synthesis:
    """The PID controller of the settings (None: of the plant's machine), certified on the plant.

    The controller returned is continuous. With a timing (None: that of the settings) the sampled
    and delayed one is certified as well (``certify_as_it_runs``), and both must be stable for the
    status "verified"; otherwise it is "unstable", which is a verdict and raises nothing. Raises
    InvalidInput for settings that describe no controller.
    """
    result = continuous_pid(plant, settings)
    machine = replace(plant.machine, controller=result.filters)
    return certify_as_it_runs(plant, result, timing or machine_timing(machine))


def machine_pid(machine: Machine) -> Synthesis:
    """The PID of the machine file as it stands there, nothing shown of it. Raises InvalidInput
    where it states none.
    """
    settings = machine.reference
    if settings is None:
        remedy = machine.in_file("add a [controller] with its gain")
        raise InvalidInput(f"{machine.name} has no PID of its own; give a controller, or {remedy}")
    return Synthesis(pid_controller(settings, machine), OF_MACHINE, filters=settings)


@named_failure("the PID controller")
def continuous_pid(plant: Plant, settings: PidSettings | None = None) -> Synthesis:
    """``pid_synthesis`` without the loop as it runs. Raises InvalidInput."""
    settings = plant.machine.reference if settings is None else settings
    if settings is None:
        remedy = plant.machine.in_file("add a [controller] with its gain or pass PidSettings")
        raise InvalidInput(f"machine {plant.machine.name!r} has no reference controller; {remedy}")
    law = pid_controller(settings, plant.machine)
    certificate = certify(plant, law)
    status = Status.VERIFIED if certificate.stable else Status.UNSTABLE
    return Synthesis(law, "pid", float("nan"), status, certificate, filters=settings)
