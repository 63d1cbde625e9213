"""The whole chain, one call per stage: machine file -> plants -> controller -> verification -> simulation -> report.

Read this first. Each stage is a plain function of the results before it (package ``stages``); ``run`` calls them in order and
leaves what they made in one directory. A second run for the same machine takes the controllers up from there. The last stage
commissions: it identifies the machine from a record of the virtual rig and runs a controller for it there as C code.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ambrose.core.checks import AmbroseError, InvalidInput
from ambrose.core.presentation import to_plain
from ambrose.evaluation import Candidate, points_of
from ambrose.machine.atomic_write import write_json
from ambrose.machine.machine import Machine
from ambrose.physics.rotor import finite_element_rotor, free_modes
from ambrose.plant.model import Plant
from ambrose.plant.reduce import reduce
from ambrose.stages.commissioning import NAME, Commissioning, commission
from ambrose.stages.control import resume_or_design
from ambrose.stages.plants import covers, full_plants, model_comparison, schedulable
from ambrose.stages.proof import campbell_map, over_tolerances, verification
from ambrose.stages.run_up import RunUp, run_ups
from ambrose.stages.trials import simulations
from ambrose.synthesis.design import methods_for
from ambrose.synthesis.result import Synthesis
from ambrose.verification.checks import Curve

Progress = Callable[[str], None]
TITLES = {"pid": "PID", "hinf": "H-infinity", "mu": "mu", "polish": "mu, polished", "lpv": "LPV"}


@dataclass(frozen=True, slots=True, eq=False)
class Study:
    """Everything that one run found; plants, checks and traces go by operating point, the nominal one first.

    candidates: the controllers that the machine file allows (PID, H-infinity, mu), each with its checks and traces.
    speed_curves: the Campbell map with the first of them, for machines that turn. failed: (controller, why) for those that
    could not be designed. commissioned: what commissioning on the rig gave, its controller among the candidates (None: not
    possible, see failed). run_ups: scheduled and robust controllers while the machine runs up.
    """

    machine: Machine
    plants: tuple[Plant, ...]
    reduced: Plant
    candidates: tuple[Candidate, ...]
    speed_curves: tuple[Curve, ...] = ()
    failed: tuple[tuple[str, str], ...] = ()
    commissioned: Commissioning | None = None
    run_ups: tuple[RunUp, ...] = ()

    @property
    def best(self) -> Candidate:
        """The candidate that meets most checks, robust ones included; unstable points count against it."""
        return max(self.candidates, key=lambda candidate: -_failures(candidate, len(self.plants)))

    @property
    def passed(self) -> bool:
        """Whether one controller meets every check at every operating point and over the tolerances."""
        return _failures(self.best, len(self.plants)) == 0


def _failures(candidate: Candidate, points: int) -> int:
    """Checks that are not met; an unstable point, and one that a schedule leaves out, count for a hundred."""
    verifications = [*candidate.checks, *([candidate.robust] if candidate.robust else [])]
    left_out = 100 * (points - len(candidate.checks))
    return left_out + sum(100 if not v.stable else sum(check.passed is False for check in v.checks) for v in verifications)


def run(machine: Machine, directory: Path, progress: Progress = lambda stage: None) -> Study:
    """All stages in order; leaves controller-<method>.json, commissioned/, checks.json and report.html in ``directory``.

    Raises InvalidInput for a machine with neither controller settings nor weights, and where ``directory`` cannot be written.
    """
    directory.mkdir(parents=True, exist_ok=True)
    progress("assembling the finite-element plant at every operating point")
    plants = full_plants(machine)
    progress("reducing it")
    reduced = reduce(plants[0])
    candidates, failed = [], []
    for method in [*methods_for(plants[0]), *(["lpv"] if schedulable(plants[0]) else [])]:
        progress(f"{TITLES[method]}: controller")
        try:
            synthesis = resume_or_design(plants[0], method, directory / f"controller-{method}.json", progress)
        except AmbroseError as error:  # one infeasible design leaves the others their verdict
            progress(f"{TITLES[method]}: no controller; {error}")
            failed.append((TITLES[method], str(error)))
        else:
            candidates.append(examined(plants, method, synthesis, progress))
    if not candidates:
        why = "; ".join(f"{name}: {text}" for name, text in failed) or "it has no [controller] and no [weights]; add one"
        raise InvalidInput(f"no controller for machine {machine.name!r}: {why}")
    commissioned = None
    if {"pid", "polish"} <= {candidate.synthesis.method for candidate in candidates}:
        try:
            commissioned = commission(plants, candidates[0].synthesis, directory / "commissioned", progress)
            candidates.append(commissioned.candidate)
        except AmbroseError as error:
            progress(f"not commissioned; {error}")
            failed.append(("commissioning", str(error)))
    speed_curves = campbell_map(plants[0], candidates[0].synthesis.controller, progress)
    rising = run_ups(plants[0], tuple(candidates), progress)
    study = Study(machine, plants, reduced, tuple(candidates), speed_curves, tuple(failed), commissioned, rising)
    progress("writing the report")
    write_json(directory / "checks.json", results(study))
    write_report(study, directory / "report.html")
    return study


def examined(plants: tuple[Plant, ...], method: str, synthesis: Synthesis, progress: Progress) -> Candidate:
    """A controller with all that verification and simulation say about it."""
    name, law = TITLES[method], synthesis.law
    within = tuple(plant for plant in plants if covers(law, plant))  # a schedule says nothing about other speeds
    checks = verification(within, law, lambda stage: progress(f"{name}: {stage}"))
    over_box = over_tolerances(plants[0], synthesis.controller, checks[0].stable, lambda stage: progress(f"{name}: {stage}"))
    traces = simulations(within, law, lambda stage: progress(f"{name}: {stage}"))
    return Candidate(name, synthesis, checks, over_box, traces)


def results(study: Study) -> dict[str, Any]:
    """The study as plain data: certificates and checks of every candidate."""
    return {
        "machine": study.machine.name,
        "passed": study.passed,
        "best": study.best.name,
        "failed": dict(study.failed),
        "run_up": {
            run.name: {
                where: [
                    {"start_s": s.start, "speed_rad_s": s.speed, "peak_m": s.peak, "settling_s": to_plain(s.settling)}
                    for s in found
                ]
                for where, found in (("linear", run.linear_steps), ("rig", run.rig_steps))
            }
            for run in study.run_ups
        },
        "commissioned": commissioned_results(study.commissioned) if study.commissioned else None,
        "controllers": {
            c.name: {
                "status": str(c.synthesis.status),
                "stopped_early": c.synthesis.stopped_early,
                "certificate": c.synthesis.certificate.to_dict(),
                "points": [checks.to_dict() for checks in c.checks],
                "robust": c.robust.to_dict() if c.robust else None,
            }
            for c in study.candidates
        },
    }


def commissioned_results(commissioned: Commissioning) -> dict[str, Any]:
    """The commissioning as plain data: the identification, the sampled loop, what ran on the rig."""
    deployment = commissioned.deployment
    return {
        "identification": commissioned.identification.to_dict(),
        "sampled": [checks.to_dict() for checks in (*deployment.checks, *deployment.box)],
        "files": [str(path) for path in commissioned.files],
        "compiled": commissioned.from_code,
        "rig": {label: trace.outcome for label, trace in commissioned.candidate.traces if "rig" in trace.scenario},
    }


def write_report(study: Study, path: Path) -> None:
    """report.html: one self-contained page that compares the candidates."""
    from ambrose.report.commissioning import commissioning_section
    from ambrose.report.comparison.page import comparison_report
    from ambrose.report.page import write
    from ambrose.report.run_up import run_up_section

    rotor = finite_element_rotor(study.machine)
    modes = free_modes(rotor, 2)
    plane = slice(0, None, 2)  # the modes come in x/y pairs; the drawing shows x
    more = [run_up_section(study.run_ups, study.machine.requirements.settling_time)] if study.run_ups else []
    if (done := study.commissioned) is not None:
        points = points_of(study.machine, study.candidates)
        reference, words = study.candidates[0], done.in_words
        more.append(
            commissioning_section(done.identification, reference, done.candidate, points, words, from_code=done.from_code)
        )
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
        more=more,
        facts=(
            ("Verified on", f"the full model at {len(study.plants)} operating points, and over all tolerances"),
            *((f"{NAME} verified on", "the identified machine, as it runs: sampled, late") for _ in [done] if done),
            *((f"No {name}", why) for name, why in study.failed),
        ),
    )
    write(report, path)
