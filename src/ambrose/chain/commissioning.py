"""Stage: commissioning as on site, with the nonlinear virtual rig in place of the machine.

Record under the reference controller -> identified machine -> controller tuned to its requirements
as its loop runs, sampled -> C code -> the law read back out of the running code, verified -> the
code on the rig at every operating point.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ambrose.chain.stages import Stage, resume_or_design, walk
from ambrose.code.block.block import build_block
from ambrose.code.c.code import write_code
from ambrose.code.c.compiled import CompiledBlock, compiler_problem, has_compiler, read_law
from ambrose.code.pipeline import machine_limits, provenance_lines
from ambrose.code.sampled import Deployment, deploy, unmet_limits
from ambrose.core.checks import InvalidInput, NumericalFailure
from ambrose.core.statespace import StateSpace
from ambrose.identification.pipeline import identify
from ambrose.identification.result import LoopIdentification, Provenance
from ambrose.judge.controller_file import read_controller
from ambrose.judge.plants import Progress, Stability, full_plants, judge_stability
from ambrose.judge.result import Synthesis
from ambrose.law.design_problem import design_tolerances
from ambrose.law.law import LawLike
from ambrose.law.loop import DEFAULT, Timing, machine_timing
from ambrose.machine.file.update import machine_text
from ambrose.machine.machine import Machine
from ambrose.machine.ordinary_file import make_folder, write_text
from ambrose.model.plant import Plant
from ambrose.rig import virtual_rig
from ambrose.rig.scenario import load_scenario
from ambrose.rig.trace import Trace
from ambrose.rig.trial import Candidate, Deployed, evaluate, simulate_scenario
from ambrose.synthesis.methods import methods

# Under which controller the machine on site is recorded: one that the judge says holds it there.
#
# The PID of the machine file where it holds, as on site; else the tuned controller, else the best
# of the others. What is asked is the loop that is recorded: at the machine's operating point,
# sampled and late as the rig runs it, whatever loop the controller was designed for.


FIRST = ("pid", "tuned")  # the methods that are asked before the others, in this order


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """candidate: the one that is recorded (None: none holds the machine); words: its name and why
    it is not the PID ("": it is the PID), or in a sentence why there is none.
    """

    candidate: Candidate | None
    words: str = ""


def as_recorded(plant: Plant, synthesis: Synthesis) -> Stability:
    """What the judge says of the loop while the rig records it.

    plant: full, at the point of the record. Raises InvalidInput where the controller is not one for
    the plant, or runs at another rate than the machine.
    """
    return judge_stability(plant, synthesis.controller, machine_timing(plant.machine) or DEFAULT)


def reference(
    plant: Plant, candidates: Sequence[Candidate], waiting: Collection[str] = ()
) -> Reference | None:
    """Under which of the candidates the machine is recorded, as soon as that is certain (None: not
    before one of those in ``waiting`` is there).

    plant: as for ``as_recorded``; waiting: the methods whose controllers are still to come.
    Schedules are left out: the record is of one speed.
    """
    by_method = {item.synthesis.method: item for item in candidates}
    lost: list[tuple[Candidate, Stability]] = []
    for method in FIRST:
        if method in waiting:
            return None
        if method not in by_method:
            continue
        item = by_method[method]
        held = as_recorded(plant, item.synthesis)
        if held.stable:
            return Reference(item, _instead(item, lost))
        lost.append((item, held))
    if waiting:
        return None

    others = [
        item
        for item in candidates
        if item.synthesis.method not in FIRST and item.synthesis.scheduled is None
    ]
    judged = [(item, as_recorded(plant, item.synthesis)) for item in others]
    holding = [item for item, held in judged if held.stable]
    if not holding:
        return Reference(None, _none(plant, [*lost, *judged]))
    from ambrose.report.comparison_tables import nearest

    best = nearest(holding)
    return Reference(best, _instead(best, lost))


def _instead(chosen: Candidate, lost: Sequence[tuple[Candidate, Stability]]) -> str:
    """Why not one that goes before it; "" where there is none."""
    if not lost:
        return ""
    return (
        f"{chosen.name}, because {_listed(lost)} not stabilise the machine at {_where(lost[0][1])}"
    )


def _none(plant: Plant, lost: Sequence[tuple[Candidate, Stability]]) -> str:
    """Cause and remedy where nothing holds."""
    if not lost:
        return "no controller of the study is fixed, so there is none to record the machine under"
    machine = plant.machine
    if machine_timing(machine) is None:
        remedy = machine.in_file(
            "state [controller] sample_time, for which controllers are then designed"
        )
    else:
        remedy = "design one that holds this loop, or state a shorter [controller] sample_time"
    return (
        f"nothing to record: {_listed(lost)} not stabilise the machine at {_where(lost[0][1])}; "
        f"{remedy}"
    )


def _listed(lost: Sequence[tuple[Candidate, Stability]]) -> str:
    """The controllers with the rates at which they lose the machine, and "does" or "do"."""
    words = [f"{item.name} ({held.abscissa:+.3g} 1/s)" for item, held in lost]
    verb = "does" if len(words) == 1 else "do"
    return f"{', '.join(words[:-1])} and {words[-1]} {verb}" if words[1:] else f"{words[0]} {verb}"


def _where(held: Stability) -> str:
    return f"{held.label}, {held.timing}"


NAME = "commissioned"
METHOD = "tuned"
EXCITATION = "prbs"
CYCLE = "operating-cycle"
_RECORDED = 2.0  # s


@dataclass(frozen=True, slots=True, eq=False)
class Commissioning:
    """identification: its ``machine`` is the one designed for; reference: the controller that held
    the machine meanwhile; candidate: the new one, verified on that machine as it runs (sampled,
    late, its law read out of the code), its rig traces from the code; cycle: from rest through
    run-up, top pressure and trip back to rest, run by the code; deployment: the sampled loop as
    designed; files: the code; apart: largest difference between the law of the running code and the
    design's, relative to the largest entry (None: the law in Python ran, for want of a C compiler,
    or because it is not one sample late); chosen: which reference, and why not the PID, in words.
    """

    identification: LoopIdentification
    reference: Synthesis
    candidate: Candidate
    cycle: Trace
    deployment: Deployment
    files: tuple[Path, ...]
    apart: float | None
    chosen: str = ""

    @property
    def machine(self) -> Machine:
        """As identified."""
        return self.identification.machine

    @property
    def from_code(self) -> bool:
        """Whether compiled C code ran on the rig."""
        return self.apart is not None

    @property
    def in_words(self) -> tuple[tuple[str, str], ...]:
        """(what, words) about the sampled controller and its code."""
        deployed = self.deployment
        under = self.chosen or f"the {methods()[self.reference.method].title}"
        rate = 1 / deployed.controller.dt if deployed.controller.dt else float("nan")
        rows = [
            (
                "Controller",
                f"{deployed.controller.n_states} states, {rate:g} Hz, {deployed.delay} sample of "
                "computing delay",
            ),
            (
                "Runs on the rig as",
                "the compiled C code"
                if self.from_code
                else "its law in Python: no code runs here, or not one sample late",
            ),
            ("Files", ", ".join(path.name for path in self.files)),
        ]
        if self.apart is not None:
            rows.insert(
                2,
                (
                    "Law read back out of the running code",
                    f"matrices within {self.apart:.1g} of the design's",
                ),
            )
        for box in deployed.box:
            worst, unstable = box["sampled.sensitivity.box"], box["sampled.stability.box"]
            rows.insert(1, ("Sampled loop", f"{unstable.value:.0f} unstable of {unstable.detail}"))
            rows.insert(2, ("Worst sampled sensitivity", f"{worst.value:.3g} at {worst.detail}"))
            rows.insert(
                3,
                (
                    "Limits that the sampled loop misses",
                    "; ".join(unmet_limits(deployed)) or "none",
                ),
            )
        rows.append(
            ("From rest through run-up, top pressure and trip back to rest", self.cycle.text)
        )
        return (("Record taken under", under), *rows)

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready data: the identification, the sampled loop, what ran on the rig."""
        return {
            "reference": {"method": self.reference.method, "chosen": self.chosen},
            "identification": self.identification.to_dict(),
            "sampled": [
                checks.to_dict() for checks in (*self.deployment.checks, *self.deployment.box)
            ],
            "files": [f"code/{path.name}" for path in self.files],
            "compiled": self.from_code,
            "rig": {
                label: trace.outcome
                for label, trace in self.candidate.traces
                if "rig" in trace.scenario
            },
            "cycle": {"outcome": self.cycle.outcome, "text": self.cycle.text},
        }


def commission(
    plants: tuple[Plant, ...],
    reference: Synthesis,
    directory: Path,
    progress: Progress,
    chosen: str = "",
) -> Commissioning:
    """Everything under ``directory``: record.h5, identified.toml, identified.html, controller.json
    and the code.

    plants: of the machine that stands for the real one, the nominal first; reference: the
    controller that holds it; chosen: which one and why, in words. Raises InvalidInput where the
    reference controller does not hold the nominal plant as its loop is recorded or the machine
    lacks what a robust design needs, and what the stages raise.
    """
    held = as_recorded(plants[0], reference)
    if not held.stable:
        raise InvalidInput(
            f"the reference controller does not stabilise the nominal plant, {held.timing} "
            f"({held.abscissa:+.3g} 1/s), so that nothing can be recorded; give one that does"
        )
    if chosen:
        progress(f"the record is taken under {chosen}")
    make_folder(directory)
    if problem := compiler_problem():
        progress(f"the code will be written, but its law runs in Python: {problem}")
    results = walk(
        STAGES,
        {
            "site": plants,
            "machine": plants[0].machine,
            "reference": reference,
            "controller": reference.controller,
            "directory": directory,
            "progress": progress,
        },
    )
    deployment, _, files = results["code"]
    return Commissioning(
        results["identification"],
        reference,
        results["candidate"],
        results["cycle"],
        deployment,
        files,
        results["law"][1],
        chosen,
    )


def recorded(
    plants: tuple[Plant, ...], controller: LawLike, directory: Path, progress: Progress
) -> Any:
    """Two seconds of the rig at an operating point, a binary sequence added to every current."""
    plant = plants[0]
    progress(f"recording {_RECORDED:g} s on the virtual rig at {plant.point.label}")
    scenario = replace(load_scenario(EXCITATION), duration=_RECORDED)
    trace = virtual_rig.run(
        plant.machine, controller, scenario, point=plant.point, path=directory / "record.h5"
    )
    if trace.outcome != "completed":
        raise InvalidInput(f"no record to identify from: {trace.text}")
    return trace.record


def identified(
    machine: Machine, record: Any, controller: LawLike, directory: Path, progress: Progress
) -> LoopIdentification:
    """The identification of the recorded machine; leaves identified.toml and identified.html.

    Raises NumericalFailure where the fit did not converge.
    """
    from ambrose.report.page import page_of, write

    names = Provenance(("record.h5",), "the reference controller")
    done = identify(machine, record, controller, provenance=names, progress=progress)
    assert isinstance(done, LoopIdentification)  # its method is the closed loop
    write_text(
        directory / "identified.toml", done.comment + machine_text(done.machine), "machine file"
    )
    write(page_of(done), directory / "identified.html")
    if not done.result.converged:
        raise NumericalFailure(
            f"{done.verdict}; no controller is designed for them, see identified.html"
        )
    return done


def designed(known: tuple[Plant, ...], directory: Path, progress: Progress) -> Synthesis:
    """The controller for the identified machine, as its loop runs sampled; or as an earlier run
    left it.
    """
    timing = machine_timing(known[0].machine) or DEFAULT
    method = methods()[METHOD](rate=timing.rate, delay_samples=timing.delay_samples)
    return resume_or_design(known[0], method, directory / "controller.json", progress)


def compile_controller(
    plants: tuple[Plant, ...], directory: Path, progress: Progress
) -> tuple[Deployment, CompiledBlock | StateSpace, tuple[Path, ...]]:
    """Sampled, verified as it will run, written as C and, where there is a compiler, running; else
    its law in Python.
    """
    machine = plants[0].machine
    file, timing = (
        read_controller(directory / "controller.json"),
        machine_timing(machine) or DEFAULT,
    )
    narrow = tuple(
        replace(plant, machine=replace(machine, tolerances=design_tolerances(machine)))
        for plant in plants
    )
    delay = timing.delay_samples * timing.sample_time
    deployment = deploy(file, timing.sample_time, delay, plants=narrow, progress=progress)
    errors, currents = machine_limits(machine)
    if errors is None or currents is None:
        raise InvalidInput(
            f"machine {machine.name!r} states no gap or max_current of a bearing; the code needs "
            "both as limits"
        )
    block = build_block(deployment, "controller", errors, currents)
    progress("writing the C code")
    files = tuple(
        write_code(directory / "code", block, "double", provenance_lines(file, deployment, machine))
    )
    # the rig runs code that is one sample late, no other
    if deployment.delay == 1 and has_compiler():
        try:
            return deployment, CompiledBlock(block), files
        except InvalidInput as error:
            progress(f"its law runs in Python: {error}")
    return deployment, block.system, files


def read_running_law(
    program: CompiledBlock | StateSpace, deployment: Deployment
) -> tuple[StateSpace, float | None]:
    """The law that runs, without the computing delay, read out of code if it is code; and how far
    it is from the design's.
    """
    if not isinstance(program, CompiledBlock):
        return program, None
    law = read_law(program)
    pairs = [(getattr(law, letter), getattr(program.system, letter)) for letter in "ABCD"]
    return law, max(
        float(np.abs(found - meant).max() / np.abs(meant).max())
        for found, meant in pairs
        if meant.any()
    )


Code = tuple[Deployment, CompiledBlock | StateSpace, tuple[Path, ...]]


def evaluated(
    site: tuple[Plant, ...],
    known: tuple[Plant, ...],
    synthesis: Synthesis,
    code: Code,
    law: tuple[StateSpace, float | None],
    progress: Progress,
) -> Candidate:
    """The law that runs on the identified machine, and the running code on the rig of the site."""
    deployment, program, _ = code
    timing = machine_timing(known[0].machine) or DEFAULT
    runs = Timing(timing.sample_time, deployment.delay, "its code")
    tolerances = design_tolerances(known[0].machine)
    deployed = Deployed(law[0], program, site, runs)
    return evaluate(NAME, synthesis, known, progress, deployed=deployed, tolerances=tolerances)


def operating_cycle(site: tuple[Plant, ...], known: tuple[Plant, ...], code: Code) -> Trace:
    """From rest through run-up, top pressure and trip back to rest, run by the code."""
    deployment, program, _ = code
    rate = (machine_timing(known[0].machine) or DEFAULT).rate
    machine, delay = site[0].machine, deployment.delay
    return simulate_scenario(
        machine, program, CYCLE, axes=machine.group, rate=rate, delay_samples=delay
    )


STAGES = (
    Stage("record", ("site", "controller", "directory", "progress"), recorded),
    Stage(
        "identification", ("machine", "record", "controller", "directory", "progress"), identified
    ),
    Stage("known", ("identification",), lambda done: full_plants(done.machine)),
    Stage(
        "synthesis",
        ("known", "directory", "progress"),
        designed,
        "controller for the identified machine and its sampled loop",
    ),
    Stage("code", ("known", "directory", "progress"), compile_controller),
    Stage("law", ("code",), lambda code: read_running_law(code[1], code[0])),
    Stage("candidate", ("site", "known", "synthesis", "code", "law", "progress"), evaluated),
    Stage(
        "cycle",
        ("site", "known", "code"),
        operating_cycle,
        "the code takes the rig through its operating cycle",
    ),
)
