"""The front door: what ``import ambrose as amb`` offers, one verb per step of the chain. READ
FIRST.

    machine = amb.load_machine("seal-rig")
    result = amb.design(machine, "mu")
    verdict = amb.verify(machine, result)
    run = amb.simulate(machine, result, "levitation")
    amb.export(result, "code", to="c")
    amb.plot(verdict)

Each function checks what it is given, then hands over to the package that does the work. A machine
may be a ``Machine``, the name of a bundled one or the path of a file; a controller a ``Synthesis``,
a ``StateSpace`` or anything else with A, B, C, D; an operating point its label, the beginning of
it, or an ``OperatingPoint``. Everything wrong raises InvalidInput in one sentence.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ambrose.core.checks import InvalidInput, invalid

if TYPE_CHECKING:
    from ambrose.chain.study import Study
    from ambrose.code.pipeline import Delivery
    from ambrose.code.targets import Target
    from ambrose.identification.one_axis.identify import GenericIdentification
    from ambrose.identification.record_check import RecordCheck
    from ambrose.identification.result import Identification
    from ambrose.judge.checks import Verification
    from ambrose.judge.result import Synthesis
    from ambrose.law.law import Law
    from ambrose.machine.description import OperatingPoint
    from ambrose.machine.machine import Machine
    from ambrose.model.plant import Plant
    from ambrose.options import Rejecting
    from ambrose.rig.trace import Trace
    from ambrose.synthesis.methods import Method

Progress = Callable[[str], None]


def _quiet(stage: str) -> None:
    """Progress that nobody watches."""


def assemble(
    machine: Machine | str, point: OperatingPoint | str | None = None, **values: float
) -> Plant:
    """The full finite-element plant at an operating point: amplifiers, rotor on its bearings and
    seals, sensors.

    point: a label or its beginning, or an OperatingPoint; None: the point that designs are made
    for. values: what differs from it, SI: speed [rad/s], seal_pressure [Pa], bias_current [A].
    Raises InvalidInput for an unknown label or value, and where the point lies outside a seal's
    table or a bearing's measured bias currents.
    """
    from ambrose.machine.parameters import operating_point
    from ambrose.model.assemble import assemble as assembled

    description = machine_of(machine)
    return assembled(description, operating_point(description, point, **values))


def reduce(plant: Plant, bending_modes: int | None = None) -> Plant:
    """The plant with its rotor reduced to rigid-body and ``bending_modes`` per plane; a perturbed
    plant stays perturbed.

    None: all bending modes below the frequency to which the plant acts (twice the top speed or the
    fastest amplifier lag), plus one; ``plant.bending_modes`` says how many that is. Raises
    InvalidInput.
    """
    from ambrose.model.plant import Plant as PlantType
    from ambrose.model.uncertainty import default_bending_modes, reduce as reduced

    if not isinstance(plant, PlantType):
        raise invalid(
            "plant", type(plant).__name__, "a Plant", "assemble(machine, point) gives one"
        )
    return reduced(plant, default_bending_modes(plant) if bending_modes is None else bending_modes)


def design(
    machine: Machine | Plant | str,
    method: Method | str = "tuned",
    *,
    point: OperatingPoint | str | None = None,
    axes: str | None = None,
    synchronous: str | None = None,
    synchronous_band: tuple[float, float] | None = None,
    synchronous_time: float | None = None,
    synchronous_update: str | None = None,
    base: Any = None,
    progress: Progress = _quiet,
    **options: Any,
) -> Synthesis:
    """A controller: for the whole envelope, or by the thesis' methods for one operating point;
    certified on the full plants.

    method: ``Tuned`` (to the machine's requirements at all its operating points and over the
    tolerances around each); made for one point are ``Pid`` (the machine's reference controller),
    ``Hinf``, ``Mu`` (D-K iteration over the tolerances), ``Polish`` (mu refined at fixed order) and
    ``Lpv`` (scheduled over speed, pressure or both); or the name of one, "tuned", its options then
    by name: ``amb.design(machine, amb.Tuned(order=12))`` is ``amb.design(machine, "tuned",
    order=12)``. What each has stands with it, help(amb.Tuned). point: of the machine (None: the one
    that designs are made for). axes: "radial" or "thrust", the one group of axes (None: all, that
    of the thrust axis in ``thrust``). synchronous: "current-free", "force-free", "vibration-free"
    or "damping" (with a band), a block against unbalance beside it, on within synchronous_band
    [rad/s] (None: from a tenth of the top speed), with the time constant synchronous_time [s]
    (None: as short as the loop allows); base: the controller to add it to, in place of a new
    design. A controller that does not hold the full plant comes back with status "unstable". Raises
    InvalidInput.
    """
    from ambrose.model.plant import Plant as PlantType
    from ambrose.options import Rejecting

    asked = Rejecting(
        synchronous=synchronous,
        synchronous_band=synchronous_band,
        synchronous_time=synchronous_time,
        synchronous_update=synchronous_update,
        base=base,
    )
    own: Any = machine
    others: tuple[Machine, ...] = ()
    if isinstance(machine, PlantType):
        if axes not in (None, machine.machine.group):
            machine.machine.only(str(axes))
    elif axes is not None:
        own = machine_of(machine).only(axes)
    elif base is None:
        own, *rest = machine_of(machine).groups.values()
        others = tuple(rest)
    thrust = [design_thrust(part, method, point, progress, **options) for part in others]
    result, block = design_with_block(own, method, asked, point, progress, **options)
    result = replace(result, thrust=thrust[0]) if thrust else result
    if block is None:
        return result
    left_out = tuple(f"synchronous block: {item}" for item in block.left_out)
    return replace(result, notes=(*result.notes, *left_out, *block.notes))


def design_thrust(
    machine: Machine,
    method: Method | str,
    point: OperatingPoint | str | None,
    progress: Progress,
    **options: Any,
) -> Synthesis:
    """The controller of the thrust axis beside that of the radial axes. Raises InvalidInput that
    says how to leave it out.
    """
    from ambrose.options import Rejecting

    try:
        return design_with_block(machine, method, Rejecting(), point, progress, **options)[0]
    except InvalidInput as error:
        raise InvalidInput(f"{error}; or leave it out: --axes radial") from error


def design_with_block(
    machine: Machine | Plant | str,
    method: Method | str,
    asked: Rejecting,
    point: OperatingPoint | str | None = None,
    progress: Progress = _quiet,
    **options: Any,
) -> tuple[Synthesis, Any]:
    """The controller of ``design``, and the design of the block beside it (None: there is none),
    whose own notes are not the controller's. Raises InvalidInput.
    """
    from ambrose.judge.result import synthesis_of
    from ambrose.law.law import extension
    from ambrose.model.plant import Plant as PlantType
    from ambrose.synthesis.design import design as designed

    name = method if isinstance(method, str) else type(method).__name__.lower()
    described = machine.machine if isinstance(machine, PlantType) else machine_of(machine)
    if asked.synchronous is not None:
        extension("request")(asked, name, described)
    if isinstance(machine, PlantType) and point is not None:
        raise InvalidInput(
            f"the plant is at {machine.point.label!r} already; give the machine to choose another "
            "point"
        )
    if asked.base is None:
        plant = machine if isinstance(machine, PlantType) else assemble(described, point)
        result = designed(plant, method, progress=progress, **options)
    else:
        result = synthesis_of(controller_of(asked.base, described))
    if asked.synchronous is None:
        return result, None
    block = extension("design")(
        described,
        result,
        asked.synchronous,
        band=asked.synchronous_band,
        time_constant=asked.synchronous_time,
        update=asked.synchronous_update or "sample",
        rate=options.get("rate", getattr(method, "rate", None)),
        delay_samples=options.get("delay_samples", getattr(method, "delay_samples", None)),
        progress=progress,
    )
    return replace(result, synchronous=block.blocks), block


def verify(
    machine: Machine | Plant | str,
    controller: Any = None,
    *,
    points: Sequence[OperatingPoint | str] | OperatingPoint | str | None = None,
    axial: Any = None,
    axes: str | None = None,
    tolerances: bool = True,
    everywhere: bool = False,
    informed: bool = True,
    measured: Any = (),
    running: Any = None,
    rate: float | None = None,
    delay_samples: int | None = None,
    pressure_rate: float | None = None,
    pressure_error: float = 0.0,
    speed_rate: float | None = None,
    progress: Progress = _quiet,
) -> Verification:
    """The controller judged on the full plant: at every operating point, and over all tolerances
    around each.

    controller: None: the machine file's own PID. points: of the machine, one or several (None: all,
    the one that designs are made for first). axial: the controller of the thrust axis (None: that
    of ``controller``, else the machine file's PID). axes: "radial" or "thrust", the one group of
    axes to judge (None: all; one without a controller is not passed).
    everywhere: bounds and proofs over the tolerances around every point, not the first alone;
    informed: what no requirement limits over them, too.
    measured: frequency responses or their files, which decide at their operating points; running:
    the controller that ran then (None: they are of the plant alone).
    rate [Hz], delay_samples: the loop as it runs, sampled by Tustin's map and late (None: as the
    controller or the machine file says; where neither knows a rate the continuous loop is judged).
    pressure_rate [Pa/s]: the fastest change of the seal pressure, for a proof while it changes
    (None: the machine file's, or no proof); pressure_error [Pa]: how far off what a controller
    scheduled over it is told may be; speed_rate [rad/s^2]: the fastest run-up, for a proof while
    the speed changes. Points that a schedule does not cover are listed as left out, and the
    verification is not passed. Raises InvalidInput where the controller is not one for this
    machine.
    """
    from ambrose.judge.verdict import verify_controller
    from ambrose.model.plant import Plant as PlantType

    place = machine if isinstance(machine, PlantType) else machine_of(machine)
    law, along = _known_laws(place, controller, axial, axes)
    several: Any = points if points is None or isinstance(points, list | tuple) else [points]
    return verify_controller(
        place,
        law,
        several,
        axial=along,
        axes=axes,
        tolerances=tolerances,
        everywhere=everywhere,
        informed=informed,
        measured=measured,
        running=None if running is None else controller_of(running, place),
        rate=rate,
        delay_samples=delay_samples,
        pressure_rate=pressure_rate,
        pressure_error=pressure_error,
        speed_rate=speed_rate,
        progress=progress,
    )


def simulate(
    machine: Machine | Plant | str,
    controller: Any = None,
    scenario: Any = "levitation",
    *,
    point: OperatingPoint | str | None = None,
    linear: bool = False,
    **options: Any,
) -> Trace:
    """A scenario on the nonlinear virtual rig (``linear``: on the linear loop): its record and its
    outcome.

    controller: None: the machine file's PID, of the thrust axis as well; all axes run together.
    scenario: the name of a bundled one, the path of a file, or a Scenario. point: where the machine
    runs (None: the nominal one). options: rate [Hz] and delay_samples of the controller (None: as
    it or the machine file says); fallback, the fixed controller that takes over from one scheduled
    over pressure where the reading cannot be trusted, with pressure_rate, pressure_error,
    stuck_after and estimate as in ``rig.trial.simulate_scenario``; axial, the controller of the
    thrust axis; axes, "radial" or "thrust", the one group that runs; others as for
    ``rig.virtual_rig.run``: seed, bending_modes, path, second, progress. Raises InvalidInput.
    """
    from ambrose.model.plant import Plant as PlantType
    from ambrose.rig.trial import simulate_scenario

    place = machine if isinstance(machine, PlantType) else machine_of(machine)
    for name in ("fallback", "second"):
        if options.get(name) is not None:
            options[name] = controller_of(options[name], place)
    given = options.pop("axial", None)
    law, along = _known_laws(place, controller, given, options.get("axes"))
    options |= {"thrust": along} if given is None else {"axial": along}
    return simulate_scenario(place, law, scenario, point=point, linear=linear, **options)


def identify(
    machine: Machine | str, records: Any, controller: Any = None, **options: Any
) -> Identification:
    """What closed-loop records tell about the machine: records checked, parameters with intervals,
    the machine updated.

    records: a Record, a path, or several. controller: the one that ran. options, see
    ``identification.pipeline.identify``: method, ``ClosedLoop``, ``Youla`` or ``StaticLoads`` with
    its options, or the name of one, "closed-loop", "youla", "static", its options then by name
    (unknown, parameters as the tolerances name them with "*" for every name or axis; start;
    seal_form); repeats; progress. Raises InvalidInput that names what is wrong with a record.
    """
    from ambrose.identification.pipeline import identify as identified

    described = machine_of(machine)
    law = None if controller is None else controller_of(controller, described)
    return identified(described, records, law, **options)


def check_record(record: Any, machine: Machine | str | None = None, **options: Any) -> RecordCheck:
    """Whether a record can be used, and for what: its contents, findings about its signals, and
    every use with what the record lacks for it.

    record: a Record, or the path of one or of a text table of one axis. machine: whose record it is
    (None: not known). options: columns, sample_rate_hz [Hz], travel [m], as for identify_generic.
    Raises InvalidInput for a file that cannot be read.
    """
    from ambrose.identification.record_check import check_record as checked

    return checked(record, None if machine is None else machine_of(machine), **options)


def identify_generic(record: Any, **options: Any) -> GenericIdentification:
    """One levitated axis from its record alone, whatever controlled it: unstable pole, gain, delay.

    record: a Record, or the path of one or of a text table with displacement, drive and times.
    options, see ``identification.one_axis.identify.identify_generic``: columns, sample_rate_hz
    [Hz], between [s], travel [m], actuator ("auto", "none", "lag"), and a force law by gap [m],
    current [A], mass [kg], hanging. Raises InvalidInput with the reasons where the record can carry
    no identification.
    """
    from ambrose.identification.one_axis.identify import identify_generic as identified

    return identified(record, **options)


def export(
    controller: Any,
    directory: str | os.PathLike[str],
    *,
    to: Target | str,
    machine: Machine | str | None = None,
    fallback: Any = None,
    replaces: Any = None,
    **options: Any,
) -> Delivery:
    """The controller as files for a target, verified as it will run.

    to: ``C`` (C99), ``Mat`` (MATLAB, Octave), ``Fmu`` (FMI 2 and 3), ``St`` (IEC 61131-3), each
    with its options, ``amb.C(arithmetic="float")``; or the name of one, "c", its options then by
    name. machine: the one it is for; None: the bundled machine that it was made for. fallback: the
    fixed controller that takes over from one scheduled over pressure where the reading cannot be
    trusted (C only). replaces: the controller that runs now (C only); parameters.json then says
    what changes in the tables of its code. options also take axial, the controller of the thrust
    axis (None: that of ``controller``), and axes, "radial" or "thrust", the one group that is
    written; both groups are one unit in C and FMU, else two. Raises InvalidInput, and
    UnstableSystem where the sampled loop does not hold the machine.
    """
    from ambrose.code.pipeline import export as exported

    place = None if machine is None else machine_of(machine)
    axial = options.pop("axial", None)
    laws = {"fallback": fallback, "replaces": replaces}
    options |= {
        name: law if law is None else controller_of(law, place) for name, law in laws.items()
    }
    return exported(
        controller_of(controller, place),
        Path(directory),
        to=to,
        machine=place,
        axial=None if axial is None else controller_of(axial),
        **options,
    )


def study(
    machine: Machine | str,
    directory: str | os.PathLike[str] = "study",
    *,
    axes: str | None = None,
    progress: Progress = _quiet,
) -> Study:
    """The whole chain: every controller that the machine file allows, verified, tried, compared in
    report.html. axes: "radial" or "thrust", the one group of axes (None: all).
    """
    from ambrose.chain.study import study as studied

    return studied(machine_of(machine), Path(directory), progress, axes)


def plot(item: Any) -> Any:
    """A plotly figure: of a machine, plant, controller, verification, trace, record,
    identification, response or study.

    Raises InvalidInput for anything else.
    """
    from ambrose.report.plot import plot as plotted

    return plotted(item)


def machine_of(machine: Any) -> Machine:
    """A Machine as it is; a name or path loaded. Raises InvalidInput."""
    from ambrose.machine.file.toml import load_machine

    return load_machine(machine)


def _known_laws(
    place: Machine | Plant, controller: Any, axial: Any, axes: str | None
) -> tuple[Law, Law | None]:
    """The law of the machine's own axes, and the one beside it of its thrust axis: those given,
    else the PIDs of the machine file (None: it has none, or the first law holds it). Raises
    InvalidInput.
    """
    from ambrose.judge.result import machine_pid
    from ambrose.law.loop import check_side
    from ambrose.machine.machine import THRUST
    from ambrose.model.plant import Plant as PlantType

    machine = place.machine if isinstance(place, PlantType) else place
    own = machine if axes is None else machine.only(axes)
    law = machine_pid(own) if controller is None else controller_of(controller, own)
    if axial is not None:
        return law, controller_of(axial)
    others = {} if axes is not None or place is not machine else machine.groups
    along = others.get(THRUST)
    if along is None or along is own or law.thrust or law.all_axes or along.reference is None:
        return law, None
    check_side(law.inputs, machine)
    return law, machine_pid(along)


def controller_of(controller: Any, machine: Machine | Plant | None = None) -> Law:
    """What controls, as a law: of a file what it says, between the axes of the machine; a system of
    python-control becomes one here, and nowhere below. Raises InvalidInput.
    """
    from ambrose.judge.controller_file import read_controller
    from ambrose.law.law import law_of

    if isinstance(controller, str | os.PathLike):
        plant: Any = machine
        return read_controller(controller, getattr(plant, "machine", plant))
    return law_of(controller, functions=False)
