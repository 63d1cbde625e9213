"""The whole chain, one call per stage: machine file -> plants -> controller -> verification -> simulation -> report.

Read this first. Each stage is a plain function of the results before it; ``run`` calls them in order and leaves what they
made in one directory. A second run for the same machine takes the controller up from there instead of designing it again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ambrose.core.checks import AmbroseError, InvalidInput
from ambrose.core.frequency import frequency_response
from ambrose.core.statespace import poles, select
from ambrose.export.files import match_controller, read_controller, write_controller
from ambrose.export.results import certificate_to_dict, checks_to_dict, write_json
from ambrose.machine.config import machine_hash
from ambrose.machine.description import Machine
from ambrose.machine.parameters import operating_point
from ambrose.physics.rotor import finite_element_rotor, free_bending_frequencies, free_modes, mass_properties
from ambrose.plant.assemble import assemble
from ambrose.plant.loop import closed_loop
from ambrose.plant.model import Plant
from ambrose.plant.reduce import reduce
from ambrose.report.candidate import Candidate
from ambrose.simulate import linear, virtual_rig
from ambrose.simulate.scenario import load_scenario
from ambrose.simulate.trace import Trace
from ambrose.synthesis.design import design, methods_for, on_full_plant
from ambrose.synthesis.result import Synthesis
from ambrose.synthesis.weights import machine_weights
from ambrose.verify import campbell, nominal, robust
from ambrose.verify.checks import Checks, Curve

Progress = Callable[[str], None]
_CAMPBELL_SPEEDS, _CAMPBELL_MODES = 15, 10
TITLES = {"pid": "PID", "hinf": "H-infinity", "mu": "mu", "polish": "mu, polished"}
SCENARIOS = ("impulse-orthogonal", "impulse-parallel")  # the two disturbance patterns of P5


@dataclass(frozen=True, slots=True, eq=False)
class Study:
    """Everything that one run found; plants, checks and traces go by operating point, the nominal one first.

    candidates: the controllers that the machine file allows (PID, H-infinity, mu), each with its checks and traces.
    speed_curves: the Campbell map with the first of them, for machines that turn. failed: (controller, why) for those that
    could not be designed.
    """

    machine: Machine
    plants: tuple[Plant, ...]
    reduced: Plant
    candidates: tuple[Candidate, ...]
    speed_curves: tuple[Curve, ...] = ()
    failed: tuple[tuple[str, str], ...] = ()

    @property
    def best(self) -> Candidate:
        """The candidate that meets most checks, robust ones included; unstable points count against it."""
        return max(self.candidates, key=lambda candidate: -_failures(candidate))

    @property
    def passed(self) -> bool:
        """Whether one controller meets every check at every operating point and over the tolerances."""
        return _failures(self.best) == 0


def _failures(candidate: Candidate) -> int:
    verifications = [*candidate.checks, *([candidate.robust] if candidate.robust else [])]
    return sum(100 if not v.stable else sum(check.passed is False for check in v.checks) for v in verifications)


def run(machine: Machine, directory: Path, progress: Progress = lambda stage: None) -> Study:
    """All stages in order; leaves controller-<method>.json, checks.json and report.html in ``directory``.

    Raises InvalidInput for a machine with neither controller settings nor weights, and where ``directory`` cannot be written.
    """
    directory.mkdir(parents=True, exist_ok=True)
    progress("assembling the finite-element plant at every operating point")
    plants = full_plants(machine)
    progress("reducing it")
    reduced = reduce(plants[0])
    candidates, failed = [], []
    for method in methods_for(plants[0]):
        progress(f"{TITLES[method]}: controller")
        try:
            synthesis = kept_or_designed(plants[0], method, directory / f"controller-{method}.json", progress)
        except AmbroseError as error:  # one infeasible design leaves the others their verdict
            progress(f"{TITLES[method]}: no controller; {error}")
            failed.append((TITLES[method], str(error)))
        else:
            candidates.append(examined(plants, method, synthesis, progress))
    if not candidates:
        why = "; ".join(f"{name}: {text}" for name, text in failed) or "it has no [controller] and no [weights]; add one"
        raise InvalidInput(f"no controller for machine {machine.name!r}: {why}")
    speed_curves = campbell_map(plants[0], candidates[0].synthesis.controller, progress)
    study = Study(machine, plants, reduced, tuple(candidates), speed_curves, tuple(failed))
    progress("writing the report")
    write_json(directory / "checks.json", results(study))
    write_report(study, directory / "report.html")
    return study


def examined(plants: tuple[Plant, ...], method: str, synthesis: Synthesis, progress: Progress) -> Candidate:
    """A controller with all that verification and simulation say about it."""
    name = TITLES[method]
    checks = verification(plants, synthesis.controller, lambda stage: progress(f"{name}: {stage}"))
    over_box = over_tolerances(plants[0], synthesis.controller, checks[0].stable, lambda stage: progress(f"{name}: {stage}"))
    traces = simulations(plants, synthesis.controller, lambda stage: progress(f"{name}: {stage}"))
    return Candidate(name, synthesis, checks, over_box, traces)


def results(study: Study) -> dict[str, Any]:
    """The study as plain data: certificates and checks of every candidate."""
    return {
        "machine": study.machine.name,
        "passed": study.passed,
        "best": study.best.name,
        "failed": dict(study.failed),
        "controllers": {
            c.name: {
                "status": c.synthesis.status,
                "certificate": certificate_to_dict(c.synthesis.certificate),
                "points": [checks_to_dict(checks) for checks in c.checks],
                "robust": checks_to_dict(c.robust) if c.robust else None,
            }
            for c in study.candidates
        },
    }


def full_plants(machine: Machine) -> tuple[Plant, ...]:
    """The full finite-element plant at every operating point of the machine; the first is the nominal one."""
    return tuple(assemble(machine, point) for point in machine.operation.points)


def plant_at(machine: Machine, label: str | None) -> Plant:
    """The full plant at the operating point of that label, or of which it is the beginning (None: the nominal one).

    Raises InvalidInput.
    """
    return assemble(machine, machine.operation.nominal if label is None else operating_point(machine, label))


def kept_or_designed(plant: Plant, method: str, path: Path, progress: Progress) -> Synthesis:
    """The controller at ``path`` if it was made for exactly this machine (certified again), else a new one, written there."""
    try:
        kept = read_controller(path)
        if kept.certificate and (kept.provenance.machine_hash, kept.method) == (machine_hash(plant.machine), method):
            old = Synthesis(kept.controller, kept.method, kept.gamma, kept.status, kept.certificate)
            return on_full_plant(plant, old, {})
    except AmbroseError:
        pass  # absent, or not readable any more: designed anew
    synthesis = design(plant, method, progress=progress)
    write_controller(path, synthesis, plant.machine)
    return synthesis


def verification(plants: tuple[Plant, ...], controller: Any, progress: Progress) -> tuple[Checks, ...]:
    """The checks on every full plant. Raises InvalidInput where the controller is not one for this machine."""
    results = []
    for plant in plants:
        progress(f"verifying at {plant.point.label}")
        turning = plant.machine.operation.speed_range[1] > 0 and plant is plants[0]
        along = _plants_along_speed(plant) if turning else None
        results.append(nominal.check(plant, match_controller(controller, plant), plant_at=along))
    return tuple(results)


def over_tolerances(plant: Plant, controller: Any, stable: bool, progress: Progress) -> Checks | None:
    """The checks over the machine's tolerances; None without tolerances, for an unstable loop or a sampled controller.

    Worst cases are searched on the full model; stability is proved on the reduced one, with one bending mode per plane.
    """
    if not plant.machine.tolerances or not stable or controller.dt is not None:
        return None
    progress("verifying over all tolerances")
    weights = machine_weights(plant.machine) if plant.machine.weights is not None else None
    found = robust.check(plant, controller, weights=weights)
    proof = [
        replace(check, detail=f"{check.detail}; on the reduced model with one bending mode per plane")
        for check in robust.check(reduce(plant, 1), controller).checks
        if check.name == "robust.stability.proved"
    ]
    return replace(found, checks=(*found.checks, *proof))


def _plants_along_speed(plant: Plant) -> Callable[[float], Plant]:
    return lambda speed: assemble(plant.machine, replace(plant.point, speed=speed))


def simulations(plants: tuple[Plant, ...], controller: Any, progress: Progress) -> tuple[tuple[str, Trace], ...]:
    """Impulse responses at every operating point: both patterns of P5 on the linear loop, one also on the nonlinear rig."""
    traces = []
    for plant in plants:
        label = plant.point.label
        progress(f"simulating at {label}")
        traces += [(label, simulation(plant, controller, name)) for name in SCENARIOS]
        progress(f"virtual rig at {label}")
        traces.append((label, experiment(plant, controller, SCENARIOS[-1])))
    return tuple(traces)


def experiment(plant: Plant, controller: Any, scenario: str) -> Trace:
    """One scenario on the nonlinear virtual rig with the controller as it would be deployed; touchdown is an outcome.

    Only the measured displacements are kept: the currents carry the rotor's weight and hide the response beside it.
    """
    trace = virtual_rig.run(plant.machine, controller, load_scenario(scenario), point=plant.point)
    measured = trace.record.select(plant.named("y"))
    return replace(trace, record=measured, scenario=f"{scenario} on the virtual rig")


def simulation(plant: Plant, controller: Any, scenario: str) -> Trace:
    """One scenario on the linear closed loop; stops where the rotor would touch down."""
    gaps = [b.touchdown_gap for b in plant.machine.bearings if b.touchdown_gap is not None]
    return linear.run(
        closed_loop(plant, match_controller(controller, plant)),
        load_scenario(scenario),
        machine=plant.machine.name,
        point=plant.point,
        mass=mass_properties(finite_element_rotor(plant.machine)).mass,
        displacement_limit=min(gaps, default=None),
    )


def campbell_map(plant: Plant, controller: Any, progress: Progress) -> tuple[Curve, ...]:
    """Closed-loop natural frequencies and damping over the machine's speed range; empty for one that does not turn."""
    low, high = plant.machine.operation.speed_range
    if high <= low:
        return ()
    progress("following the modes over speed")
    along = campbell.campbell(_plants_along_speed(plant), np.linspace(low, high, _CAMPBELL_SPEEDS), _CAMPBELL_MODES, controller)
    return tuple(campbell.campbell_curves(along))


def facts(machine: Machine) -> dict[str, Any]:
    """What `ambrose check` tells about a machine, SI units: mass properties, bending frequencies, open-loop poles, sizes."""
    rotor = finite_element_rotor(machine)
    properties = mass_properties(rotor)
    plant = assemble(machine)
    reduced = reduce(plant)
    values = poles(plant.rotor)
    return {
        "machine": machine.name,
        "description": machine.description,
        "mass_kg": properties.mass,
        "centre_m": properties.centre,
        "diametral_inertia_kg_m2": properties.diametral_inertia,
        "polar_inertia_kg_m2": properties.polar_inertia,
        "bending_rad_s": free_bending_frequencies(rotor, 3).tolist(),
        "unstable_poles_rad_s": [[float(p.real), float(p.imag)] for p in values if p.real > 0],
        "rotor_states": plant.rotor.n_states,
        "plant_states": plant.system.n_states,
        "reduced_rotor_states": reduced.rotor.n_states,
        "reduced_plant_states": reduced.system.n_states,
        "operating_points": [point.label for point in machine.operation.points],
        "tolerances": [tolerance.parameter for tolerance in machine.tolerances],
        "assumed": len(machine.assumed),
    }


def model_comparison(plant: Plant, reduced: Plant) -> list[tuple[str, Curve]]:
    """Largest singular value of currents -> sensors, full and reduced model, 1 Hz to 5 kHz."""
    omega = np.geomspace(2 * np.pi, 2 * np.pi * 5000, 600)
    pairs = []
    for label, model in (
        (f"full, {plant.rotor.n_states} states", plant),
        (f"reduced, {reduced.rotor.n_states} states", reduced),
    ):
        response = frequency_response(select(model.system, model.named("u"), model.named("y")), omega)
        gain = response.max_singular_value()[None]
        name = "plant gain, currents to sensors"
        pairs.append((label, Curve("plant.gain", name, "frequency", omega, gain, ("max singular value",), "rad/s", "m/A")))
    return pairs


def write_report(study: Study, path: Path) -> None:
    """report.html: one self-contained page that compares the candidates."""
    from ambrose.report.comparison import comparison_report
    from ambrose.report.document import write

    rotor = finite_element_rotor(study.machine)
    modes = free_modes(rotor, 2)
    plane = slice(0, None, 2)  # the modes come in x/y pairs; the drawing shows x
    full, reduced = study.plants[0], study.reduced
    report = comparison_report(
        study.machine,
        study.candidates,
        node_positions=rotor.positions,
        shapes=modes.shapes[0::4, plane],
        frequencies=modes.frequencies[plane],
        models=(
            ("full model", f"{full.rotor.n_states} rotor states, {full.system.n_states} with amplifiers and sensors"),
            ("reduced model", f"{reduced.rotor.n_states} rotor states, {reduced.system.n_states} with amplifiers and sensors"),
        ),
        comparison=model_comparison(full, reduced),
        over_speed=[(full.point.label, curve) for curve in study.speed_curves],
        facts=(
            ("Verified on", f"the full model at {len(study.plants)} operating points, and over all tolerances"),
            *((f"No {name}", why) for name, why in study.failed),
        ),
    )
    write(report, path)
