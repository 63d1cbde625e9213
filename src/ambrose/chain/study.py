"""The whole chain, one call per stage: machine file -> plants -> controller -> verification ->
simulation -> report.

Read this first, ``STAGES`` above all: each stage is a plain function of the results before it;
``study`` walks them in order and leaves what they made in one directory. A second run for the same
machine takes the controllers up from there. The last stage commissions: it identifies the machine
from a record of the virtual rig and runs a controller for it there as C code.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ambrose.chain.commissioning import FIRST, NAME, Commissioning, Reference, commission, reference
from ambrose.chain.stages import FAILURES, Stage, beside, resume_or_design, walk
from ambrose.core.checks import AmbroseError, InvalidInput
from ambrose.core.presentation import Presented, data_frame, to_plain
from ambrose.core.processes import can_start_processes, processors, remembering
from ambrose.judge.checks import Curve, check_columns
from ambrose.judge.controller_file import write_controller
from ambrose.judge.plants import Progress, campbell_map, full_plants, plant_gain
from ambrose.machine.machine import THRUST, Machine, require_magnets
from ambrose.machine.ordinary_file import claimed, make_folder, set_aside, write_json
from ambrose.model.plant import Plant
from ambrose.model.uncertainty import not_varied, reduce
from ambrose.registry import registered, resolve
from ambrose.rig.trial import Candidate, RunUp, check_trials, evaluate, points_of, run_ups
from ambrose.synthesis.design import methods_for
from ambrose.synthesis.methods import methods


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Study(Presented):
    """All results of one run; plants, checks and traces go by operating point, the nominal one
    first.

    candidates: the tuned controller, then those that the machine file allows (PID, H-infinity, mu),
    with checks and traces. speed_curves: the Campbell map with the first of them, for machines that
    turn. failed: (controller, why) for those that could not be designed. commissioned: what
    commissioning on the rig gave, its controller among the candidates (None: not possible, see
    failed). run_ups: scheduled and robust controllers while the machine runs up. unwritten: why a
    result could not be written. axial: the study of the axis along the shaft, in the folder axial/
    beside these (None: a machine without a thrust bearing).
    """

    machine: Machine
    plants: tuple[Plant, ...]
    reduced: Plant
    candidates: tuple[Candidate, ...]
    speed_curves: tuple[Curve, ...] = ()
    failed: tuple[tuple[str, str], ...] = ()
    commissioned: Commissioning | None = None
    run_ups: tuple[RunUp, ...] = ()
    unwritten: tuple[str, ...] = ()
    axial: Study | None = None

    @property
    def best(self) -> Candidate:
        """The candidate that meets every requirement with most to spare, or comes nearest to it."""
        from ambrose.report.comparison_tables import nearest

        return nearest(self.candidates)

    @property
    def passed(self) -> bool:
        """Whether one controller meets every check at every operating point and over the
        tolerances.
        """
        along = self.axial is None or self.axial.passed
        return along and any(candidate.passed for candidate in self.candidates)

    def facts(self) -> dict[str, Any]:
        """Machine, controllers, the best of them and whether it meets every check."""
        facts = {"machine": self.machine.name, "passed": self.passed, "best": self.best.name}
        failed = {"failed": [name for name, _ in self.failed]} if self.failed else {}
        unwritten = {"unwritten": list(self.unwritten)} if self.unwritten else {}
        return {
            **facts,
            "controllers": [candidate.name for candidate in self.candidates],
            **failed,
            **unwritten,
        }

    def to_dict(self) -> dict[str, Any]:
        """The study as JSON-ready data: certificates and checks of every candidate."""
        along = {} if self.axial is None else {"axial": self.axial.to_dict()}
        return {
            **along,
            "machine": self.machine.name,
            "passed": self.passed,
            "best": self.best.name,
            "failed": dict(self.failed),
            "run_up": {
                run.name: {
                    where: [
                        {
                            "start_s": s.start,
                            "speed_rad_s": s.speed,
                            "peak_m_0p": s.peak,
                            "settling_s": to_plain(s.settling),
                        }
                        for s in steps
                    ]
                    for where, steps in (("linear", run.linear_steps), ("rig", run.rig_steps))
                }
                for run in self.run_ups
            },
            "commissioned": self.commissioned.to_dict() if self.commissioned else None,
            "controllers": {
                c.name: {
                    "status": str(c.synthesis.status),
                    "stopped_early": c.synthesis.stopped_early,
                    "certificate": c.synthesis.certificate.to_dict(),
                    "points": [checks.to_dict() for checks in c.checks],
                    "left_out": list(c.left_out),
                    "boxes": [box.to_dict() for box in c.boxes],
                    "ranges": [checks.to_dict() for checks in c.ranges],
                    "timing": c.timing,
                }
                for c in self.candidates
            },
        }

    def to_frame(self) -> Any:
        """Every check of every controller as a pandas DataFrame: controller, point, then the check.
        Raises InvalidInput without pandas.
        """
        rows = [
            (c.name, checks.label, check)
            for c in self.candidates
            for checks in c.verifications
            for check in checks.checks
        ]
        names = {
            "controller": [name for name, _, _ in rows],
            "point": [label for _, label, _ in rows],
        }
        return data_frame({**names, **check_columns([check for *_, check in rows])})


def study(
    machine: Machine,
    directory: str | Path,
    progress: Progress = lambda stage: None,
    axes: str | None = None,
) -> Study:
    """All stages in order; leaves controller-<method>.json, commissioned/, checks.json and
    report.html in ``directory``, and what annexes add: lateral.json and lateral.html; of a machine
    with a thrust bearing the same of the thrust axis in ``axial`` there, and the best of both in
    controller.json. axes: the one group of axes (None: all).

    A report of an earlier run, its checks and its code are called ``earlier-...`` before anything
    is made anew. What cannot be written in the end is told in ``unwritten``, with all results kept.
    Raises InvalidInput for a machine with neither controller settings nor weights, and where
    ``directory`` cannot be written or another run writes it.
    """
    own, *others = (machine if axes is None else machine.only(axes)).groups.values()
    with claimed(make_folder(directory), "study"):
        result = _study(own, Path(directory), progress)
        for along in others if axes is None else ():
            progress("the thrust axis")
            found = _study(along, make_folder(Path(directory) / "axial"), progress)
            both = replace(result.best.synthesis, thrust=found.best.synthesis)
            write_controller(Path(directory) / "controller.json", both, machine)
            result = replace(result, axial=found)
        return result


def _study(machine: Machine, directory: Path, progress: Progress) -> Study:
    require_magnets(machine)
    check_trials(machine)
    results = walk(STAGES, {"machine": machine, "directory": directory, "progress": progress})
    commissioned = results["commissioning"]
    result = Study(
        machine,
        results["plants"],
        results["reduced"],
        results["candidates"],
        results["speed_curves"],
        (*results["designs"].failed, *results["failures"]),
        commissioned,
        results["run_ups"],
    )
    progress("writing the report")
    unwritten = []
    for write in (
        lambda: write_json(directory / "checks.json", result.to_dict()),
        lambda: write_report(result, directory / "report.html"),
    ):
        try:
            write()
        except InvalidInput as error:
            unwritten.append(str(error))
    failed = list(result.failed)
    beside = {} if machine.group == THRUST else registered("study file")
    for name, place in beside.items():
        try:
            resolve(place)(machine, result.best.synthesis, directory, progress)
        except AmbroseError as error:
            failed.append((name, str(error)))
    return replace(result, failed=tuple(failed), unwritten=tuple(unwritten))


def _plants(machine: Machine) -> tuple[Plant, ...]:
    return full_plants(machine)


def _set_earlier_aside(directory: Path) -> None:
    made = ("checks.json", "report.html", "lateral.json", "lateral.html", "commissioned/code")
    for name in made:
        set_aside(directory / name)


@dataclass(frozen=True, slots=True)
class Designs:
    """candidates: every controller that the machine allows, evaluated; failed: (controller, why) of
    those that could not be designed; commissioning: what was commissioned meanwhile, or the error
    that it ended with (None: it was not begun).
    """

    candidates: tuple[Candidate, ...]
    failed: tuple[tuple[str, str], ...]
    commissioning: Commissioning | Exception | None = None


def _commissioning(
    plants: tuple[Plant, ...], designs: Designs, directory: Path, progress: Progress
) -> Commissioning:
    """What commissioning gave on the rig, under a controller that holds the machine there."""
    under, done = reference(plants[0], designs.candidates), designs.commissioning
    if isinstance(done, Exception):
        raise done
    assert under is not None  # nothing is waited for
    if under.candidate is None:
        raise InvalidInput(under.words)
    law = under.candidate.synthesis
    if done is not None:
        return replace(done, reference=law)
    folder = directory / "commissioned"
    return commission(plants, law, folder, _prefixed(NAME, progress), under.words)


def _all_candidates(designs: Designs, done: Commissioning | None) -> tuple[Candidate, ...]:
    return (*designs.candidates, *([done.candidate] if done is not None else []))


def study_methods(plant: Plant) -> tuple[str, ...]:
    """What a study designs by: what the machine file allows, then the annexes' that suit it."""
    return (*methods_for(plant), *(n for n in registered("method") if methods()[n].suits(plant)))


def _candidates(plants: tuple[Plant, ...], directory: Path, progress: Progress) -> Designs:
    """Every controller that the machine allows, evaluated; side by side where there are processors
    for it.
    """
    names = study_methods(plants[0])
    groups = _groups(names)
    workers = min(processors(), len(groups)) if can_start_processes() else 1
    made: dict[str, Candidate | str] = {}
    meanwhile: Commissioning | Exception | None = None
    if workers > 1:
        try:
            made, meanwhile = _side_by_side(groups, workers, plants, directory, progress)
        except BrokenProcessPool:
            progress("a worker process died (short of memory?): going on in this one")
    if not made:
        for group in groups:
            made |= _group_made(group, plants, directory, progress)

    titles = {name: methods()[name].title for name in names}
    failed = tuple((titles[name], why) for name in names if isinstance(why := made[name], str))
    candidates = tuple(item for name in names if isinstance(item := made[name], Candidate))
    if not candidates:
        machine = plants[0].machine
        none = machine.in_file("it has no [controller] and no [weights]; add one")
        why = "; ".join(f"{name}: {text}" for name, text in failed) or none
        raise InvalidInput(f"no controller for machine {machine.name!r}: {why}")
    return Designs(candidates, failed, meanwhile)


def _groups(names: Sequence[str]) -> list[tuple[str, ...]]:
    """The methods, those together of which one goes on from the other's controller; what takes
    longest first.
    """
    first = {
        name: begins if (begins := methods()[name].begins_as) in names else name for name in names
    }
    groups = [
        tuple(name for name in names if first[name] == start)
        for start in dict.fromkeys(first.values())
    ]
    return sorted(groups, key=len, reverse=True)


def _side_by_side(
    groups: Sequence[tuple[str, ...]],
    workers: int,
    plants: tuple[Plant, ...],
    directory: Path,
    progress: Progress,
) -> tuple[dict[str, Candidate | str], Commissioning | Exception | None]:
    """``_group_made`` of all groups in so many processes, and commissioning among them as soon as
    the controller is there that it takes in any case: mostly the PID.

    Raises what a group raises, and BrokenProcessPool where a process dies.
    """
    made: dict[str, Candidate | str] = {}
    meanwhile: Commissioning | Exception | None = None
    # the PID soon: commissioning waits for it
    waiting = sorted(groups, key=lambda group: (len(group) < 2, group != FIRST[:1]))
    names = study_methods(plants[0])
    with beside(workers, progress) as work:
        under_way: set[Future[Any]] = set()
        commissioned: Future[Any] | None = None
        while waiting or under_way:
            while waiting and len(under_way) < workers:
                under_way.add(work.start(_group_made, waiting.pop(0), plants, directory))
            for future in work.wait(under_way):
                under_way.remove(future)
                if future is commissioned:
                    meanwhile = future.result()
                    continue
                made |= future.result()
                if commissioned is not None:
                    continue
                done = [made[name] for name in names if name in made]
                candidates = [item for item in done if isinstance(item, Candidate)]
                missing = [name for name in names if name not in made]
                under = reference(plants[0], candidates, missing)
                if under is not None and under.candidate is not None:
                    folder = directory / "commissioned"
                    commissioned = work.start(_commissioned, plants, under, folder)
                    under_way.add(commissioned)
    return made, meanwhile


def _group_made(
    names: Sequence[str], plants: tuple[Plant, ...], directory: Path, progress: Progress
) -> dict[str, Candidate | str]:
    """The controllers of these methods, evaluated, or why there is none."""
    made: dict[str, Candidate | str] = {}
    with remembering():
        for name in names:
            title = methods()[name].title
            progress(f"{title}: controller")
            try:
                synthesis = resume_or_design(
                    plants[0], methods()[name](), directory / f"controller-{name}.json", progress
                )
                made[name] = evaluate(title, synthesis, plants, _prefixed(title, progress))
            # one infeasible design, or one that cannot be judged, leaves the others their verdict
            except AmbroseError as error:
                progress(f"{title}: no controller; {error}")
                made[name] = str(error)
    return made


def _commissioned(
    plants: tuple[Plant, ...], under: Reference, directory: Path, progress: Progress
) -> Commissioning | Exception:
    assert under.candidate is not None
    law, words = under.candidate.synthesis, under.words
    try:
        return commission(plants, law, directory, _prefixed(NAME, progress), words)
    except FAILURES as error:
        return error


def _prefixed(name: str, progress: Progress) -> Progress:
    return lambda stage: progress(f"{name}: {stage}")


STAGES = (
    Stage(
        "plants",
        ("machine",),
        _plants,
        "assembling the finite-element plant at every operating point",
    ),
    Stage("reduced", ("plants",), lambda plants: reduce(plants[0]), "reducing it"),
    Stage("earlier", ("directory",), _set_earlier_aside),
    Stage("designs", ("plants", "directory", "progress"), _candidates),
    # the late stages: one that fails leaves the others their report
    Stage(
        "commissioning",
        ("plants", "designs", "directory", "progress"),
        _commissioning,
        otherwise=None,
    ),
    Stage("candidates", ("designs", "commissioning"), _all_candidates),
    Stage(
        "speed_curves",
        ("plants", "candidates", "progress"),
        lambda plants, candidates, progress: campbell_map(
            plants[0], candidates[0].synthesis.controller, progress
        ),
        otherwise=(),
    ),
    Stage(
        "run_ups",
        ("plants", "candidates", "progress"),
        lambda plants, candidates, progress: run_ups(plants[0], candidates, progress),
        otherwise=(),
    ),
)


def write_report(result: Study, path: Path) -> None:
    """report.html: one self-contained page that compares the candidates."""
    from ambrose.report.comparison import commissioning_section, comparison_page, run_up_section
    from ambrose.report.page import write
    from ambrose.report.tables import still

    names, limit = (
        [candidate.name for candidate in result.candidates],
        result.machine.requirements.settling_time,
    )
    sections = [run_up_section(result.run_ups, limit, names)] if result.run_ups else []
    if (done := result.commissioned) is not None:
        points = points_of(result.machine, result.candidates)
        reference = next(
            candidate for candidate in result.candidates if candidate.synthesis is done.reference
        )
        words = done.in_words
        sections.append(
            commissioning_section(
                done.identification,
                reference,
                done.candidate,
                points,
                words,
                done.cycle,
                from_code=done.from_code,
            )
        )
    full, reduced = result.plants[0], result.reduced
    report = comparison_page(
        result.machine,
        result.candidates,
        models=(
            (
                "full model",
                f"{full.rotor.n_states} rotor states, {full.system.n_states} with amplifiers and "
                "sensors",
            ),
            (
                "reduced model",
                f"{reduced.rotor.n_states} rotor states, {reduced.system.n_states} with "
                "amplifiers and sensors",
            ),
        ),
        comparison=[
            (f"{name}, {plant.rotor.n_states} states", plant_gain(plant))
            for name, plant in (("full", full), ("reduced", reduced))
        ],
        over_speed=[(full.point.label, curve) for curve in result.speed_curves],
        extra=sections,
        facts=(
            ("Plant", "full model" + f"; as identified for {NAME}" * (done is not None)),
            ("Not checked", " ".join(still([w for p in result.plants for w in not_varied(p)]))),
            *((f"No {name}", why) for name, why in result.failed),
        ),
    )
    write(report, path)
