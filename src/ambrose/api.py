"""The front door: what ``import ambrose as amb`` offers, one verb per step of the chain. READ FIRST.

    machine = amb.load_machine("seal-rig")
    result = amb.design(machine, "mu")
    verdict = amb.verify(machine, result)
    run = amb.simulate(machine, result, "levitation")
    amb.export(result, "code", to="c")
    amb.plot(verdict)

Each function checks what it is given, then hands over to the package that does the work. A machine may be a ``Machine``, the
name of a bundled one or the path of a file; a controller a ``Synthesis``, a ``StateSpace`` or anything else with A, B, C, D; an
operating point its label, the beginning of it, or an ``OperatingPoint``. Everything wrong raises InvalidInput in one sentence.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ambrose.core.checks import InvalidInput

if TYPE_CHECKING:
    from ambrose.deployment.pipeline import Delivery, ExportOptions
    from ambrose.identification.pipeline import Identification
    from ambrose.machine.description import OperatingPoint
    from ambrose.machine.machine import Machine
    from ambrose.plant.model import Plant
    from ambrose.simulation.trace import Trace
    from ambrose.synthesis.result import Synthesis
    from ambrose.verification.verification import Verification
    from ambrose.workflow import Study

Progress = Callable[[str], None]


def _quiet(stage: str) -> None:
    """Progress that nobody watches."""


def assemble(machine: Machine | str, point: OperatingPoint | str | None = None, **values: float) -> Plant:
    """The full finite-element plant at an operating point: amplifiers, rotor on its bearings and seals, sensors.

    point: a label or its beginning, or an OperatingPoint; None: the point that designs are made for. values: what differs from
    it, SI: speed [rad/s], seal_pressure [Pa], bias_current [A]. Raises InvalidInput for an unknown label or value, and where
    the point lies outside a seal's table or a bearing's measured bias currents.
    """
    from ambrose.machine.parameters import operating_point
    from ambrose.plant.assemble import assemble as assembled

    description = machine_of(machine)
    return assembled(description, operating_point(description, point, **values))


def reduce(plant: Plant, bending_modes: int | None = None) -> Plant:
    """The plant with its rotor reduced to rigid-body and ``bending_modes`` per plane; a perturbed plant stays perturbed.

    None: all bending modes below the frequency to which the plant acts (twice the top speed or the fastest amplifier lag), plus
    one; ``plant.bending_modes`` says how many that is. Raises InvalidInput.
    """
    from ambrose.plant.model import Plant as PlantType
    from ambrose.plant.reduce import default_bending_modes
    from ambrose.plant.reduce import reduce as reduced

    if not isinstance(plant, PlantType):
        raise _no("plant", plant, "what assemble() gives")
    return reduced(plant, default_bending_modes(plant) if bending_modes is None else bending_modes)


def design(
    machine: Machine | Plant | str,
    method: str = "mu",
    *,
    point: OperatingPoint | str | None = None,
    rate: float | None = None,
    delay_samples: int = 1,
    order: int | None = None,
    loss: float | None = None,
    bending_modes: int = 0,
    speeds: tuple[float, float] | None = None,
    progress: Progress = _quiet,
) -> Synthesis:
    """A controller: designed on the reduced plant of one operating point, certified on the full one.

    method: "pid" (the machine's reference controller), "hinf", "mu" (D-K iteration over the tolerances), "polish" (mu refined
    at fixed order) or "lpv" (scheduled over ``speeds``, lowest and highest [rad/s]). rate [Hz]: the loop that it is for runs
    sampled, ``delay_samples`` late; order: states of the polished controller; loss: with a rate, lower the order until the
    worst sampled sensitivity has risen by this share. A controller that does not hold the full plant comes back with status
    "unstable". Raises InvalidInput.
    """
    from ambrose.synthesis.design import design as designed

    return designed(
        _plant_of(machine, point), method, rate=rate, delay_samples=delay_samples, order=order, loss=loss,
        bending_modes=bending_modes, speeds=speeds, progress=progress,
    )  # fmt: skip


def verify(
    machine: Machine | Plant | str,
    controller: Any,
    *,
    points: Iterable[OperatingPoint | str] | None = None,
    tolerances: bool = True,
    progress: Progress = _quiet,
) -> Verification:
    """The controller judged on the full plant: at every operating point (or ``points``), over all tolerances at the first.

    A Plant: at its operating point. Raises InvalidInput where the controller is not one for this machine.
    """
    from ambrose.evaluation import verify_controller
    from ambrose.machine.parameters import operating_point
    from ambrose.plant.model import Plant as PlantType

    law = law_of(controller)
    if isinstance(machine, PlantType):
        return verify_controller((machine,), law, tolerances=tolerances, progress=progress)
    description = machine_of(machine)
    labels = None if points is None else tuple(operating_point(description, point) for point in _listed(points))
    return verify_controller(_plants(description, labels), law, tolerances=tolerances, progress=progress)


def simulate(
    machine: Machine | str,
    controller: Any,
    scenario: Any = "levitation",
    *,
    point: OperatingPoint | str | None = None,
    linear: bool = False,
    **options: Any,
) -> Trace:
    """A scenario on the nonlinear virtual rig (``linear``: on the linear loop): its record and its outcome.

    scenario: the name of a bundled one, the path of a file, or a Scenario. point: where the loop runs before anything happens
    (None: the scenario's own, else the nominal one). options: as for ``simulation.virtual_rig.run``: seed, bending_modes, path,
    second, progress. Raises InvalidInput.
    """
    from ambrose.evaluation import simulate_scenario
    from ambrose.machine.parameters import operating_point

    description = machine_of(machine)
    where = None if point is None else operating_point(description, point)
    return simulate_scenario(description, law_of(controller), scenario, point=where, linear=linear, **options)


def identify(
    machine: Machine | str,
    records: Any,
    controller: Any = None,
    *,
    method: str = "closed-loop",
    unknown: Sequence[str] = (),
    **options: Any,
) -> Identification:
    """What closed-loop records tell about the machine: checked records, fitted parameters with intervals, the machine updated.

    records: a Record, a path, or several. controller: the one that ran (methods "closed-loop" and "youla"). unknown: parameters
    as the tolerances name them, "*" for every name or axis; none: what the machine file marks as uncertain, K_i and K_s of
    every axis, the amplifiers' lag. Raises InvalidInput, naming what is wrong with a record that cannot be believed.
    """
    from ambrose.identification.pipeline import identify as identified

    law = None if controller is None else law_of(controller)
    return identified(machine_of(machine), records, law, method=method, unknown=tuple(unknown), **options)


def export(
    controller: Any,
    directory: str | os.PathLike[str],
    *,
    to: str,
    machine: Machine | str | None = None,
    options: ExportOptions | None = None,
) -> Delivery:
    """The controller as files for a target, verified as it will run: "c" (C99), "mat", "fmu" (FMI 2 and 3), "st" (IEC 61131-3).

    machine: the one it is for; None: the bundled machine that it was made for. Raises InvalidInput, and UnstableSystem where
    the sampled loop does not hold the machine.
    """
    from ambrose.deployment.pipeline import export as exported

    description = None if machine is None else machine_of(machine)
    return exported(controller, Path(directory), to=to, machine=description, options=options)


def study(machine: Machine | str, directory: str | os.PathLike[str] = "study", *, progress: Progress = _quiet) -> Study:
    """The whole chain: every controller that the machine file allows, verified, tried, compared in report.html."""
    from ambrose.workflow import study as studied

    return studied(machine_of(machine), Path(directory), progress)


def plot(item: Any, **options: Any) -> Any:
    """A plotly figure of a machine, plant, controller, verification, trace, record, identification, response or study.

    Raises InvalidInput for anything else.
    """
    from ambrose.report.plot import plot as plotted

    return plotted(item, **options)


def machine_of(machine: Any) -> Machine:
    """A Machine as it is; a name or path loaded. Raises InvalidInput."""
    from ambrose.machine.file.toml import load_machine

    return load_machine(machine)


def law_of(controller: Any) -> Any:
    """What runs: of a Synthesis its law, else the system itself. Raises InvalidInput for what is no controller."""
    from ambrose.core.statespace import StateSpace
    from ambrose.synthesis.controller_file import read_controller
    from ambrose.synthesis.result import Synthesis

    if isinstance(controller, str | os.PathLike):
        controller = read_controller(controller)
    if isinstance(controller, Synthesis):
        return controller.law
    if all(hasattr(controller, letter) for letter in "ABCD"):
        return controller if isinstance(controller, StateSpace) else StateSpace(controller)
    if hasattr(controller, "at") or hasattr(controller, "step"):
        return controller  # a schedule, or a program such as compiled code
    raise _no("controller", controller, "a Synthesis, a StateSpace, the path of a controller file, or a system with A, B, C, D")


def _plant_of(machine: Any, point: Any) -> Plant:
    from ambrose.plant.model import Plant as PlantType

    if not isinstance(machine, PlantType):
        return assemble(machine, point)
    if point is not None:
        raise InvalidInput(
            f"a plant is at its operating point already ({machine.point.label}); give the machine to choose another"
        )
    return machine


def _plants(machine: Machine, points: Any) -> tuple[Plant, ...]:
    from ambrose.stages.plants import full_plants

    return full_plants(machine) if points is None else tuple(assemble(machine, point) for point in points)


def _listed(points: Any) -> list[Any]:
    return [points] if isinstance(points, str) or not isinstance(points, Iterable) else list(points)


def _no(what: str, item: Any, meant: str) -> InvalidInput:
    return InvalidInput(f"{what} is {type(item).__name__}, but must be {meant}; give one of these")
