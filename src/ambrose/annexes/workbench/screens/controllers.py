"""The controller bench: the filters of a PID as sliders, what they do at every operating point, up
to four controllers side by side, the designs as jobs.

While a slider moves, the loop is judged on plants that are reduced to the modes that matter, so
that the curves follow the hand; what is kept is judged on the full plant first, and says how.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ambrose.annexes.workbench import blocks
from ambrose.annexes.workbench.blocks import (
    Block,
    Refusal,
    fields_of,
    lines_of,
    values_of,
    width,
    with_numbers,
    word,
)
from ambrose.annexes.workbench.jobs import CHOICES
from ambrose.annexes.workbench.project import MACHINE, Project, slug
from ambrose.annexes.workbench.screens import Screen
from ambrose.annexes.workbench.svg import nyquist_figure, svg
from ambrose.core.checks import InvalidInput, named_failure
from ambrose.core.frequency import largest_gain
from ambrose.judge.campbell import modes
from ambrose.judge.checks import Check, Curve, judge
from ambrose.judge.controller_file import read_controller, write_controller
from ambrose.judge.loop_response import ALL_AXES, frequency_grid, loop_evaluator, sensitivity_curve
from ambrose.judge.margins import opened_loops
from ambrose.judge.nominal import pulse_checks, pulse_response
from ambrose.judge.plants import Stability, campbell_map, full_plants, judge_stability
from ambrose.law.law import Law, LawLike, law_of
from ambrose.law.loop import Timing, closed_loop, machine_timing, running_law, timing_of
from ambrose.law.pid import first_settings, pid_controller
from ambrose.machine.criteria import (
    SENSITIVITY,
    SENSITIVITY_RANGE,
    SPEED_RANGE_FACTOR,
    TWO_PI,
    demand,
)
from ambrose.machine.file.toml import loads_machine, read_machine_text
from ambrose.machine.machine import Machine, require_magnets
from ambrose.machine.part import PidSettings
from ambrose.model.plant import Plant, top_speed
from ambrose.model.uncertainty import default_bending_modes, reduce
from ambrose.report import tables, theme
from ambrose.report.figures.curves import figure
from ambrose.report.page import Cell

# One loop at a glance: whether it holds, its sensitivity, its loci and a pulse, in milliseconds.
#
# For who turns a slider and looks: a part of ``nominal.check``, made of the same functions, without
# its refined peaks and without what takes the machine apart along its speed. On a reduced plant it
# says of how many bending modes; the verdict on the full plant is verify's.


_LOWEST = 0.5 * TWO_PI  # [rad/s]
_PER_DECADE = 60  # points of the grid, beside those around the poles
LARGEST, MOST = "largest of the axes", "axis that moves most"


@dataclass(frozen=True, slots=True, eq=False)
class Glance:
    """What one sees of a loop; of an unstable one only that.

    sensitivity: the largest |S_ii| of any axis over frequency, which ISO 14839-3 judges; omega (w,)
    [rad/s] and loci (w, a): the loop of every axis, opened at its sensor with the others closed;
    pulse: the displacement that answers a short current, of the axis that
    moves most, over the first quarter of a second. checks: the peaks on the grid of the largest
    axis, which has a zone, and of all axes together, against the limits that ``check`` has.
    """

    stability: Stability
    sensitivity: Curve | None = None
    omega: np.ndarray | None = None
    loci: np.ndarray | None = None
    pulse: Curve | None = None
    checks: tuple[Check, ...] = ()

    @property
    def peak(self) -> float:
        """The largest sensitivity on the grid; inf where the loop is unstable."""
        return np.inf if self.sensitivity is None else float(self.sensitivity.y.max())

    @property
    def passed(self) -> bool:
        """Whether the loop is stable and meets the limits of its sensitivity, on the grid."""
        return self.stability.stable and all(check.passed is not False for check in self.checks)


@named_failure("the loop")
def glance(plant: Plant, given: LawLike, timing: Timing | None) -> Glance:
    """A loop at a glance. Raises InvalidInput where the law is not one for the plant."""
    stability = judge_stability(plant, given, timing)
    if not stability.stable:
        return Glance(stability)
    law = running_law(given, plant, timing)
    requirements = plant.machine.requirements
    speed = max(top_speed(plant.machine), plant.point.speed)
    highest = max(SENSITIVITY_RANGE.limits[0].value, SPEED_RANGE_FACTOR * speed)
    if law.dt is not None:
        highest = min(highest, np.pi / law.dt)
    closed = closed_loop(plant, law)
    poles = modes(closed, plant.ports, plant.system).poles
    response = loop_evaluator(plant, law)(frequency_grid(poles, _LOWEST, highest, _PER_DECADE))
    curve = sensitivity_curve(response, requirements)
    largest = replace(curve, y=curve.y.max(axis=0)[None], labels=(LARGEST,))
    answer = pulse_response(closed, plant, longest=0.0)
    _, (moved, _) = pulse_checks(answer, plant, requirements)
    most = int(np.abs(moved.y).max(axis=1).argmax())
    # one name at every point, whichever axis it is, so that all stand in one picture
    one = replace(moved, y=moved.y[most][None], labels=(MOST,))
    together = float(largest_gain(response.output_sensitivity()).max())
    checks = tuple(
        judge(name, title, value, "-", demand(rule, requirements))
        for name, title, value, rule in (
            ("axis", LARGEST, float(largest.y.max()), "sensitivity of an axis"),
            ("max", ALL_AXES, together, "maximum singular value of a sensitivity"),
        )
    )
    loops = opened_loops(response, "output")
    return Glance(stability, largest, response.omega, loops, one, checks)


_MOST = 4  # controllers that are compared
_SLIDERS = "the sliders"
_VERDICTS = tuple(f"verdict-{i}" for i in range(9))  # keys of their tables
_kept: dict[str, tuple[Machine, tuple[Plant, ...]]] = {}  # of the last text, with reduced plants


def _bench(project: Project) -> tuple[Machine, tuple[Plant, ...]]:
    """The machine and its reduced plants, made once for a text of the file."""
    text = read_machine_text(project.machine)
    if text not in _kept:
        machine = loads_machine(text, MACHINE)
        require_magnets(machine)
        plants = tuple(reduce(p, default_bending_modes(p)) for p in full_plants(machine))
        _kept.clear()
        _kept[text] = machine, plants
    return _kept[text]


def _settings(machine: Machine) -> PidSettings:
    """Those of the machine file, or a PID to start from."""
    return machine.reference or first_settings(machine)


def _turned(machine: Machine, given: Mapping[str, Any]) -> PidSettings:
    """Those of the sliders."""
    settings = _settings(machine)
    return with_numbers(settings, values_of(settings, given))


def show_controllers(project: Project, given: Mapping[str, Any]) -> dict[str, Any]:
    """Sliders, curves, what to compare, what to design."""
    machine, plants = _bench(project)
    settings = _settings(machine)
    names = project.names("controllers")
    compared = [blocks.field(f"with.{name}", name, False, "check") for name in names]
    points = ["every point", *(plant.point.label for plant in plants)]
    at = blocks.choice("at", "Loci and curves at", points)
    hint = (
        "Values of [controller] in the machine file; each slider covers a decade to both sides. "
        f"Compare with up to {_MOST - 1} controllers of the folder."
    )
    if machine.reference is None:
        hint = f"The file has no [controller]: a PID to start from. {hint}"
    named = blocks.field("name", "Name", "bench", action="")  # asks for no curves
    low, high = machine.operation.speed_range
    turning = [blocks.button("Campbell", "campbell")] if high > low else []
    form = blocks.form(
        "sliders",
        [*fields_of(settings, machine.axes), at, *compared, named],
        [
            blocks.button("Check on the full plant", "judge"),
            *turning,
            blocks.button("Save as controller", "save", main=True),
        ],
        f"PID of {machine.name}",
        live="look",
        hint=hint,
        side=True,
    )
    methods = blocks.choice("method", "Method", CHOICES["method"], "tuned")
    design = blocks.form("design", [methods], [blocks.job("Design", "design")], "Design one")
    looked = _look(project, given)
    verdict, *curves = looked["blocks"]
    return blocks.content([verdict, form, *curves, design], jobs=["synthesize"])


def _look(project: Project, given: Mapping[str, Any]) -> dict[str, Any]:
    """What the sliders do, beside the controllers that are compared."""
    machine, plants = _bench(project)
    settings = _turned(machine, given)
    laws: dict[str, Law] = {_SLIDERS: law_of(pid_controller(settings, machine))}
    for name in _chosen(project, given):
        laws[name] = law_of(read_controller(project.path("controllers", name), machine))
    seen = {
        name: [
            _glance(law, plant, machine, settings if name == _SLIDERS else None)
            for plant in plants
            if law.covers(plant)
        ]
        for name, law in laws.items()
    }
    at = word(given, "at")
    wanted = [plant.point.label for plant in plants]
    if at in wanted:
        wanted = [at]
    elif len(laws) > 1:  # a colour for each controller: one point at a time
        wanted = wanted[:1]
    shown = [
        (label if len(laws) == 1 else name, look)
        for name, looks in seen.items()
        for look in looks
        if (label := look.stability.label) in wanted and look.sensitivity is not None
    ]
    place = "" if len(wanted) > 1 or len(plants) == 1 else f" at {wanted[0]}"
    first = plants[0].bending_modes or 0
    modes = "mode" if first == 1 else "modes"
    note = f"On the plant with {first} bending {modes} per plane, without tolerances."
    pictures = _pictures(shown, machine, width(given), place) if shown else []
    same = _same(machine, given, settings)
    # a check of other values is no verdict on these
    return blocks.content(
        [_verdict(seen[_SLIDERS]), _table(seen, plants, note), *pictures, same],
        whole=False,
        gone=[*_VERDICTS, "campbell"],
    )


def _verdict(looks: Sequence[Glance]) -> Block:
    """Of the sliders, at all operating points."""
    lost = [look.stability.label for look in looks if not look.stability.stable]
    worst = max(looks, key=lambda look: look.peak)
    passed = all(look.passed for look in looks)
    text = f"the sliders' loop is unstable at {', '.join(lost)} (reduced plant)."
    if not lost:
        text = (
            f"the sliders' loop is stable at all {len(looks)} operating points (reduced plant); "
            f"largest sensitivity of an axis {worst.peak:.3g} at {worst.stability.label}."
        )
    word = "PASSED" if passed else "FAILED"
    return blocks.words("verdict", f"{word}: {text}", tone="good" if passed else "bad")


def _chosen(project: Project, given: Mapping[str, Any]) -> list[str]:
    names = [name for name in project.names("controllers") if given.get(f"with.{name}") is True]
    if len(names) >= _MOST:
        raise InvalidInput(f"{_MOST} controllers at most are compared, the sliders among them")
    return names


def _glance(law: Law, plant: Plant, machine: Machine, settings: PidSettings | None) -> Glance:
    """As it runs: of the sliders with the file's timing, of a file with its own."""
    if settings is not None:
        return glance(plant, law, machine_timing(replace(machine, controller=settings)))
    return glance(plant, law, timing_of(machine, law))


def _table(seen: Mapping[str, Sequence[Glance]], plants: Sequence[Plant], note: str) -> Block:
    """Peaks of every controller at every point; the zone is of axes."""
    labels = [plant.point.label for plant in plants]
    rows = []
    for name, looks in seen.items():
        cells = {look.stability.label: _cell(look) for look in looks}
        rows.append((name, *(cells.get(label, Cell("not covered", "muted")) for label in labels)))
    title = "Largest sensitivity of an axis, with its zone of ISO 14839-3; of all axes together"
    known = blocks.rows_table(title, ("controller", *labels), rows)
    return blocks.table("peaks", replace(known, note=note))


def _cell(look: Glance) -> Cell:
    if look.sensitivity is None:
        rate = look.stability.abscissa
        return Cell(f"unstable, {rate:+.3g} 1/s", "fail")
    axis, together = look.checks
    text = f"{axis.value:.3g}, zone {axis.zone}; all {together.value:.3g}"
    return Cell(text, "pass" if look.passed else "fail")


def _pictures(
    shown: Sequence[tuple[str, Glance]], machine: Machine, wide: int, place: str
) -> list[Block]:
    """Sensitivity, loci and pulse, side by side where there is room."""
    beside = min(max((wide + 46) // 446, 1), 3)  # panels of 430 px and more, 16 px between them
    each = (wide + 46) // beside - 46
    with theme.bare():
        sensitivities = [(label, look.sensitivity) for label, look in shown if look.sensitivity]
        pulses = [(label, look.pulse) for label, look in shown if look.pulse]
        loci = [(label, look.loci) for label, look in shown if look.loci is not None]
        limit = machine.requirements.sensitivity_peak or SENSITIVITY.limits[0].value
        drawn = {
            "sensitivity": (figure(sensitivities), f"Sensitivity, largest of the axes{place}"),
            "loci": (nyquist_figure(loci, limit), f"Loci of all axes{place}"),
            "pulse": (figure(pulses), f"Displacement after a short current{place}"),
        }
        return [
            blocks.picture(key, svg(drawing, each, title, key), title, half=True)
            for key, (drawing, title) in drawn.items()
        ]


def _same(machine: Machine, given: Mapping[str, Any], settings: PidSettings) -> Block:
    lines = [
        "from dataclasses import replace",
        f'machine = amb.load_machine("{MACHINE}")',
    ]
    if machine.reference is None:
        lines.append("from ambrose.law.pid import first_settings")
        lines.append("settings = first_settings(machine)")
    else:
        lines.append("settings = machine.controller")
    before = _settings(machine)
    lines += lines_of(before, values_of(before, given))
    lines.append("machine = replace(machine, controller=settings)")
    lines.append('controller = amb.design(machine, "pid")')
    lines.append("amb.verify(machine, controller, tolerances=False)")
    return blocks.same(f"ambrose synthesize {MACHINE} --method pid -o controllers/pid.json", *lines)


def _synthesis(project: Project, given: Mapping[str, Any]) -> tuple[Machine, Any]:
    """The controller of the sliders, certified on the full plant at every operating point, with
    all that a designed one is told.
    """
    from ambrose.judge.result import Provenance
    from ambrose.model.assemble import assemble
    from ambrose.synthesis.design import design

    machine, _ = _bench(project)
    with_sliders = replace(machine, controller=_turned(machine, given))
    result = design(assemble(with_sliders), "pid")
    # the project's file holds other settings
    return machine, replace(result, provenance=Provenance())


def _judge(project: Project, given: Mapping[str, Any]) -> dict[str, Any]:
    """The verdict on the full plant at every operating point, tolerances left out."""
    from ambrose.judge.verdict import verify_controller

    machine, result = _synthesis(project, given)
    verified = verify_controller(machine, result, axes=machine.group, tolerances=False)
    overview = tables.overview_tables([checks for _, checks in verified.labelled])
    found = [
        blocks.table(key, replace(item, title=f"Full plant: {item.title}"))
        for key, item in zip(_VERDICTS, overview, strict=False)
    ]
    told = "All requirements are met" if verified.passed else "Not all requirements are met"
    told += f" on the full plant, without tolerances. Loop: {verified.timing}."
    return blocks.content(found, whole=False, told=told)


def _campbell(project: Project, given: Mapping[str, Any]) -> dict[str, Any]:
    """The modes of the loop over speed, of the full plant."""
    machine, plants = _bench(project)
    settings = _turned(machine, given)
    timing = machine_timing(replace(machine, controller=settings))
    law = running_law(pid_controller(settings, machine), plants[0], timing)
    frequencies, _ = campbell_map(plants[0], law, lambda stage: None)
    with theme.bare():
        drawing = svg(figure([(_SLIDERS, frequencies)]), width(given), "Campbell", "campbell")
    title = "Campbell diagram of the loop, full plant"
    return blocks.content([blocks.picture("campbell", drawing, title)], whole=False)


def _save(project: Project, given: Mapping[str, Any]) -> dict[str, Any]:
    """The controller of the sliders as a file, with its certificate."""
    name = word(given, "name")
    with_field = {"name": "letters, digits, _ and -, such as bench-2"}
    try:
        path = project.path("controllers", f"{slug(name, 'controller')}.json")
    except InvalidInput as error:
        raise Refusal(str(error), with_field) from None
    if path.exists():
        taken = f"{path.name} exists already; choose another name"
        raise Refusal(taken, {"name": taken})
    machine, result = _synthesis(project, given)
    write_controller(path, result, machine)
    told = f"controllers/{path.name} is written: {result.verdict}."
    return {**show_controllers(project, given), "told": told}


SCREEN_CONTROLLERS = Screen(
    show_controllers, {"look": _look, "judge": _judge, "campbell": _campbell, "save": _save}
)
