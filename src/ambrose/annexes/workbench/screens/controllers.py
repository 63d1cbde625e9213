"""The controller bench: the filters of every channel as rows and as handles on the loop's Bode
figures, what they do at every operating point, up to five controllers side by side, the designs as
jobs.

While a handle moves, the loop is judged on plants that are reduced to the modes that matter, so
that the curves follow the hand; what is kept is judged on the full plant first, and says how.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from math import atan, sqrt
from typing import Any

import numpy as np

from ambrose.annexes.workbench import blocks
from ambrose.annexes.workbench.blocks import Block, Refusal, width, word
from ambrose.annexes.workbench.jobs import CHOICES
from ambrose.annexes.workbench.project import MACHINE, Project, slug
from ambrose.annexes.workbench.screens import Screen
from ambrose.annexes.workbench.svg import Drawing, bode_figure, drawing, nyquist_figure, svg
from ambrose.core.aliasing import logarithm
from ambrose.core.checks import InvalidInput, named_failure
from ambrose.core.frequency import frequency_response, largest_gain
from ambrose.core.presentation import to_plain
from ambrose.core.realisation import invariant_zeros
from ambrose.core.response import pulses
from ambrose.core.sampling import between, c2d
from ambrose.core.statespace import StateSpace, select
from ambrose.judge.checks import Check, Curve, judge
from ambrose.judge.controller_file import read_controller, write_controller
from ambrose.judge.loop_response import (
    ALL_AXES,
    LoopResponse,
    frequency_grid,
    loop_evaluator,
    sensitivity_curve,
)
from ambrose.judge.plants import Stability, campbell_map, full_plants, judge_stability
from ambrose.judge.result import Provenance, Synthesis, continuous_equivalent
from ambrose.law.law import Law, LawLike, law_of
from ambrose.law.loop import (
    Timing,
    closed_loop,
    machine_timing,
    match_axes,
    running_law,
    timing_of,
)
from ambrose.law.pid import (
    SECTION_UNITS,
    channel_chains,
    channel_names,
    first_settings,
    mixings,
    modes as coordinates_of,
    pid_controller,
)
from ambrose.machine.criteria import (
    CURRENT_PULSE,
    SENSITIVITY,
    SENSITIVITY_RANGE,
    SPEED_RANGE_FACTOR,
    TWO_PI,
    demand,
)
from ambrose.machine.file.tables import table_of
from ambrose.machine.file.toml import loads_machine, read_machine_text, read_table
from ambrose.machine.machine import Machine, require_magnets
from ambrose.machine.part import SECTIONS, Channel, PidSettings, Section, modal_channels
from ambrose.model.effects.rotor import free_modes
from ambrose.model.plant import Plant, sensor_turn, top_speed
from ambrose.model.uncertainty import default_bending_modes, reduce
from ambrose.report import tables, theme
from ambrose.report.figures.curves import figure, line_figure
from ambrose.report.page import Cell

# One loop at a glance: whether it holds, its sensitivity, its loci and a pulse, in milliseconds.
#
# For who turns a slider and looks: a part of ``nominal.check``, made of the same functions, without
# its refined peaks and without what takes the machine apart along its speed. On a reduced plant it
# says of how many bending modes; the verdict on the full plant is verify's.


_LOWEST = 0.5 * TWO_PI  # [rad/s]
_PER_DECADE = 60  # points of the grid, beside those around the poles
_PULSE, _STEP = 0.25, 1e-4  # [s] that answer a pulse, and between them where the loop is continuous
LARGEST, WORST = "largest of the axes", "axis of the largest sensitivity"


@dataclass(frozen=True, slots=True, eq=False)
class Glance:
    """What one sees of a loop; of an unstable one what is seen with the loop open.

    response: plant and controller as it runs, and loci (w, a): the loop of every axis, opened at
    its sensor with the others closed; sensitivity: the largest |S_ii| of any axis over frequency,
    which ISO 14839-3 judges; pulse: the displacement of that axis after a short current in it,
    over the first quarter of a second. checks: the peaks on the grid of the largest
    axis, which has a zone, and of all axes together, against the limits that ``check`` has.
    """

    stability: Stability
    response: LoopResponse
    loci: np.ndarray
    sensitivity: Curve | None = None
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
    law = running_law(given, plant, timing)
    requirements = plant.machine.requirements
    speed = max(top_speed(plant.machine), plant.point.speed)
    highest = max(SENSITIVITY_RANGE.limits[0].value, SPEED_RANGE_FACTOR * speed)
    if law.dt is not None:
        highest = min(highest, np.pi / law.dt)
    closed = closed_loop(plant, law)
    # [rad/s], for the grid: within half the sample rate, as it is
    poles = np.linalg.eigvals(closed.A).astype(complex)
    poles = poles if closed.dt is None else logarithm(poles, closed.dt)
    response = loop_evaluator(plant, law)(frequency_grid(poles, _LOWEST, highest, _PER_DECADE))
    S = response.output_sensitivity()
    own = np.einsum("wii->wi", S)
    loops = 1 / own - 1
    if not stability.stable:
        return Glance(stability, response, loops)
    curve = sensitivity_curve(response, requirements)
    largest = replace(curve, y=np.abs(own).max(axis=1)[None], labels=(LARGEST,))
    worst = plant.axes[int(np.abs(own).max(axis=0).argmax())]
    part = select(closed, [f"e_{worst}"], [f"y_{worst}"])
    part = part if part.dt else c2d(part, _STEP)
    step = part.dt or _STEP
    time = np.arange(round(_PULSE / step)) * step
    length = max(1, round(CURRENT_PULSE.duration / step))
    moved = pulses(part, CURRENT_PULSE.amplitude, length, len(time))[0]
    # one name at every point, whichever axis it is, so that all stand in one picture
    one = Curve("pulse", "Displacement", "time", time, moved, (WORST,), "s", "m")
    together = float(largest_gain(S).max())
    checks = tuple(
        judge(name, title, value, "-", demand(rule, requirements))
        for name, title, value, rule in (
            ("axis", LARGEST, float(largest.y.max()), "sensitivity of an axis"),
            ("max", ALL_AXES, together, "maximum singular value of a sensitivity"),
        )
    )
    return Glance(stability, response, loops, largest, one, checks)


# What is edited: a [controller] table in which every channel has a chain of its own. It is the form
# that machine files and controller files have, read and refused as these are.


_TINY, _SAME = 1e-12, 1e-9  # relative: no link between states, one chain
_EXACT = 1e-6  # relative: one controller
_FAR = 1e5  # times the fastest pole: a zero that Tustin's map has at infinity


def opened(project: Project, machine: Machine, name: str = "") -> PidSettings:
    """The filters of a controller of the folder; of none, those of the machine file, or a PID to
    start from. Raises Refusal for a controller that filters of single channels cannot state.
    """
    if name not in project.names("controllers"):
        made = own_filters(machine) or in_chains(first_settings(machine), None, machine)
    else:
        law = read_controller(project.path("controllers", name), machine)
        known = law.filters or PidSettings()
        if (timing := timing_of(machine, law)) is not None:
            late = timing.delay_samples * timing.sample_time
            known = replace(known, sample_time=timing.sample_time, sample_rate=None, delay=late)
        made = in_chains(replace(known, synchronous=law.synchronous), law, machine)
    if made is None:
        raise Refusal(
            f"{name} is no chain of filters for each channel (it mixes or leaves out channels, or "
            "follows the speed): tick it to compare, and edit a PID or a table of filters",
            {"open": "no filters of single channels"},
        )
    return made


def own_filters(machine: Machine) -> PidSettings | None:
    """Those of the machine file; None where it has none, or mixes its channels."""
    return machine.reference and in_chains(machine.reference, None, machine)


def in_chains(known: PidSettings, law: Law | None, machine: Machine) -> PidSettings | None:
    """The settings with a chain for every channel, channels that are the same together; law: what
    they say of, where they have no filters. None: no such chains state it.
    """
    modal, gains = known.coordinates != "axes", {*known.gain}
    if law is not None and law.fixed is None:
        return None
    if not gains and not known.channels and law is not None:
        stated = filters_of(law, machine)
    elif modal and len(gains) > 1:  # of the axes, behind tilt and translate
        stated = filters_of(law_of(pid_controller(known, machine)), machine)
    else:
        one = replace(known, gain=known.gain[:1]) if modal else known
        groups: dict[Any, list[str]] = {}
        names = channel_names(one, machine.axes)
        for name, found in zip(names, channel_chains(one, machine.axes), strict=True):
            groups.setdefault(found, []).append(name)
        channels = tuple(Channel(tuple(own), *found) for found, own in groups.items())
        stated = PidSettings(channels=channels, coordinates=known.coordinates)
    kept = ("sample_time", "sample_rate", "delay", "synchronous")
    return stated and replace(stated, **{key: getattr(known, key) for key in kept})


def filters_of(law: Law, machine: Machine) -> PidSettings | None:
    """The chains of filters that a fixed law is, between the axes or the rotor's coordinates; None:
    its channels mix. A sampled one is carried back by Tustin's map, with which the loop samples.
    """
    system = match_axes(law.at(machine.operation.design), machine.axes, machine.name)
    if system.dt is not None:
        # z = (1 + p)/(1 - p) with p = s T/2:   (p - A)^-1 B = (s - 2 A/T)^-1 2 B/T
        half, rate = continuous_equivalent(system), 2 / system.dt
        system = StateSpace(
            half.A * rate, half.B * rate, half.C, half.D, system.inputs, system.outputs
        )
    speeds = np.abs(np.linalg.eigvals(system.A))
    high = float(speeds.max(initial=0.0)) or 1.0
    low = float(speeds[speeds > _TINY * high].min(initial=high))
    omega = np.geomspace(low / 100, 100 * high, 400)
    whole = frequency_response(system, omega).values
    ways = [("axes", machine.axes, sensor_turn(machine), np.eye(len(machine.axes)))]
    if len(machine.bearings) > 1:
        with suppress(InvalidInput):  # bearings or sensors at one place
            names = modal_channels(len(machine.bearings))
            ways.append(("tilt-translate", names, *coordinates_of(machine)))
    for coordinates, names, into, out in ways:
        # K = out K_c into
        back, front = np.linalg.pinv(into), np.linalg.pinv(out)
        B, C = _without_rounding(system.B @ back), _without_rounding((front @ system.C).T).T
        inner = StateSpace(system.A, B, C, front @ system.D @ back)
        gains = front @ whole @ back
        single = np.einsum("wii->wi", gains)
        mixed = np.abs(gains * (1 - np.eye(len(names)))).max(axis=(1, 2))
        if (mixed > _EXACT * np.abs(single).max(axis=1)).any():
            continue
        channels = tuple(_channels(inner, names, omega, single))
        made = PidSettings(channels=channels, coordinates=coordinates)
        with suppress(InvalidInput):  # a channel that it leaves out
            again = frequency_response(pid_controller(made, machine), omega).values
            error = np.abs(again - whole).max(axis=(1, 2))
            if (error <= _EXACT * np.abs(whole).max(axis=(1, 2))).all():
                return made
    return None


def _without_rounding(matrix: np.ndarray) -> np.ndarray:
    """Without what is nothing but rounding beside the rest of its row."""
    size = np.abs(matrix).max(axis=1, keepdims=True, initial=0.0)
    return np.where(np.abs(matrix) > _TINY * size, matrix, 0.0)


def _channels(
    system: StateSpace, names: Sequence[str], omega: np.ndarray, single: np.ndarray
) -> Iterator[Channel]:
    """The chains of a system whose channels do not mix, of one and the same gain (w,) once."""
    from scipy.signal import zpk2sos

    left = [i for i in range(len(names)) if np.abs(single[:, i]).max()]
    while left:
        i, gain = left[0], single[:, left[0]]
        alike = [j for j in left if (np.abs(single[:, j] - gain) <= _SAME * np.abs(gain)).all()]
        left = [j for j in left if j not in alike]
        inside = between(system, i)
        A, d = system.A[np.ix_(inside, inside)], system.D[i : i + 1, i : i + 1]
        own = StateSpace(A, system.B[inside, i : i + 1], system.C[i : i + 1, inside], d)
        below, above = np.linalg.eigvals(A).astype(complex), invariant_zeros(own)
        size = float(np.abs(below).max(initial=0.0)) or 1.0
        above = above[np.abs(above) < _FAR * size]
        # G = k prod(s - zeros)/prod(s - poles), the same k at every s but for rounding
        s = 1j * omega[:, None]
        ratio = gain * np.prod((s - below) / size, axis=1) / np.prod((s - above) / size, axis=1)
        k = float(np.median(ratio.real)) * size ** (len(below) - len(above))
        rows = zpk2sos(above, below, k, analog=True) if below.size else [[0, 0, k, 0, 0, 1]]
        parts = [named_section(*row) for row in rows]
        whole = float(np.prod([factor for factor, _ in parts]))
        sections = [section for _, section in parts if section is not None]
        if whole < 0:  # a chain's gain is positive
            sections.append(Section("sos", numerator=(-1.0,), denominator=(1.0,)))
        yield Channel(tuple(names[j] for j in alike), abs(whole), tuple(sections))


def named_section(
    b2: float, b1: float, b0: float, a2: float, a1: float, a0: float
) -> tuple[float, Section | None]:
    """Gain and filter of (b2 s^2 + b1 s + b0)/(a2 s^2 + a1 s + a0), by the name that it has; no
    filter: a gain alone.
    """
    if not (b2 or b1 or a2 or a1):
        return b0 / a0, None
    if a2 > 0 and a1 > 0 and a0 > 0 and b0:
        # s^2/w^2 + 2 d s/w + 1
        w, d = sqrt(a0 / a2), a1 / 2 / sqrt(a0 * a2)
        if not b2 and not b1:
            return b0 / a0, Section("low-pass", frequency=w, damping=d)
        if b2 / b0 > 0 and b1 / b0 >= 0:
            zeros = {"zero_frequency": sqrt(b0 / b2), "zero_damping": b1 / b0 / 2 / sqrt(b2 / b0)}
            known: dict[str, Any] = {**zeros, "pole_frequency": w, "pole_damping": d}
            return b0 / a0, Section("notch", **known)
    if not (b2 or a2) and a1 > 0 and a0 > 0 and b0 and b1 / b0 > 0:
        return b0 / a0, Section("lead-lag", zero_frequency=b0 / b1, pole_frequency=a0 / a1)
    if not a0 and a1:
        # K (1 + 1/(T_i s) + T_d s/(t s + 1)):   b0 = K/T_i, b1 = K + t b0, b2 = K (t + T_d)
        t = a2 / a1
        b2, b1 = b2 / a1, b1 / a1
        b0 = b0 / a1
        gain = b1 - t * b0
        rate = b2 / gain - t if gain and t > 0 else 0.0
        times: dict[str, Any] = {}
        if rate > 0:
            times = {"derivative_time": rate, "derivative_filter": t / rate}
        if gain and b0 / gain > 0 and (rate > 0 or not (t or b2)):
            return gain, Section("pid", integral_time=gain / b0, **times)
        return 1.0, Section("sos", numerator=(b2, b1, b0), denominator=(t, 1.0, 0.0))
    return 1.0, Section("sos", numerator=(b2, b1, b0), denominator=(a2, a1, a0))


# What is shown of it: rows, handles, figures.


_MOST = 5  # controllers that are compared, with the edited one and as it was opened
_EDITED, _OPENED = "the filters", "as opened"
_DASHES = ("7px,3px", "2px,2px", "10px,3px,2px,3px", "4px,4px")  # of what is compared
_VERDICTS = tuple(f"verdict-{i}" for i in range(9))  # keys of their tables
_PARTS = {"size": "magnitude", "phase": "phase"}  # of a Bode figure, and their words
# where the handles of a filter stand, and how they turn its numbers (static/editor.js): "x" and "y"
# with the power of a frequency and of a magnitude, "width" and "phase"
Grip = tuple[float, str, str, list[list[Any]]]
_FIRST = 500 * TWO_PI  # [rad/s], of a new filter, unless the rotor bends before
_kept: dict[str, tuple[Machine, tuple[Plant, ...], float]] = {}  # of the last text, reduced plants
_timings: dict[tuple[float | None, float | None], Timing | None] = {}  # of its loops


def _bench(project: Project) -> tuple[Machine, tuple[Plant, ...], float]:
    """The machine, its reduced plants and where a new filter stands [rad/s], made once for a text
    of the file.
    """
    text = read_machine_text(project.machine)
    if text not in _kept:
        machine = loads_machine(text, MACHINE)
        require_magnets(machine)
        full = full_plants(machine)
        plants = tuple(reduce(p, default_bending_modes(p)) for p in full)
        _kept.clear()
        _timings.clear()
        _kept[text] = machine, plants, min(_first_bending(plants[0]) or _FIRST, _FIRST)
    return _kept[text]


def _first_bending(plant: Plant) -> float:
    """[rad/s], of the free rotor; 0 for none."""
    return (
        0.0 if not plant.bending_modes else float(free_modes(plant.rotor_model, 1).frequencies[4])
    )


def grips(section: Section) -> Iterator[Grip]:
    """Frequency [rad/s], words, part of the figure and terms of every handle of a filter."""
    match section.kind:
        case "pid":
            for key in ("integral_time", "derivative_time"):
                if (time := getattr(section, key)) is not None:
                    yield 1 / time, key.replace("_", " "), "size", [[key, "x", -1]]
        case "notch":
            w, d = section.pole_frequency or 0.0, section.pole_damping or 0.0
            both = [["zero_frequency", "x", 1], ["pole_frequency", "x", 1]]
            depth = [["zero_damping", "y", 1]]
            yield section.zero_frequency or 0.0, "centre and depth", "size", both + depth
            # |w/w_p - w_p/w| = 2 d, upper edge
            yield w * (d + sqrt(1 + d**2)), "width", "size", [["pole_damping", "width", 1]]
        case "phase-bump":
            terms = [["frequency", "x", 1], ["phase", "phase", 1]]
            yield section.frequency or 0.0, "centre and phase", "phase", terms
        case "lead-lag":
            for key in SECTIONS["lead-lag"]:
                yield getattr(section, key), key.partition("_")[0], "size", [[key, "x", 1]]
        case "low-pass":
            terms = [["frequency", "x", 1], ["damping", "y", -1]]
            yield section.frequency or 0.0, "corner and damping", "size", terms
        case _:
            a = np.trim_zeros(section.denominator or (), "f")
            if len(a) > 1 and a[-1]:
                w = abs(a[-1] / a[0]) ** (1 / (len(a) - 1))
                both = [["numerator", "scale", 1], ["denominator", "scale", 1]]
                yield float(w), "poles and zeros", "size", both


def _kinds(w: float) -> dict[str, list[list[Any]]]:
    """The keys of every kind of filter: label, unit, factor to it, and its value in a new filter,
    which does nothing yet where it can; w [rad/s]: where that stands.
    """
    first = {
        "integral_time": 1.0,
        "derivative_time": 0.1 / w,
        "derivative_filter": 0.1,
        "phase": 0.0,
        "damping": 0.7,
        "numerator": [1.0],
        "denominator": [1.0],
    }
    found: dict[str, list[list[Any]]] = {}
    for kind, keys in SECTIONS.items():
        for key in keys:
            factor, unit = next((u for part, u in SECTION_UNITS.items() if part in key), (1.0, ""))
            corner = 3 * w if kind == "low-pass" else w
            value = first.get(key, corner if "frequency" in key else 0.2)
            found.setdefault(kind, []).append([key, key.replace("_", " "), unit, factor, value])
    return found


def _edited(project: Project, machine: Machine, given: Mapping[str, Any], key: str) -> PidSettings:
    """The table of the page, read as that of a machine file; none: that of the file itself. Raises
    InvalidInput.
    """
    document = given.get(key)
    if document is None:
        return opened(project, machine)
    if not isinstance(document, dict):
        raise InvalidInput("the filters are no table; reload the page")
    settings: PidSettings = read_table(table_of(PidSettings), document, "the filters").build()
    return settings


def _open(project: Project, given: Mapping[str, Any]) -> dict[str, Any]:
    """The screen with the filters of another controller."""
    document = to_plain(opened(project, _bench(project)[0], word(given, "open")).to_dict())
    return show_controllers(project, {**given, "chains": document, "opened": document}, document)


def show_controllers(
    project: Project, given: Mapping[str, Any], document: Any = None
) -> dict[str, Any]:
    """Rows, curves, what to compare, what to design; document: that is opened, in place of what the
    page has.
    """
    machine, plants, bending = _bench(project)
    names = project.names("controllers")
    own = MACHINE if own_filters(machine) else "a PID to start from"
    compared = [blocks.field(f"with.{name}", name, False, "check") for name in (_OPENED, *names)]
    compared[0]["heading"] = "Compare, dashed"
    points = ["every point", *(plant.point.label for plant in plants)]
    low, high = machine.operation.speed_range
    turning = [blocks.button("Campbell", "campbell")] if high > low else []
    drop = blocks.field(
        "drop", "Or drop a controller or a table of filters here", kind="file", to="controllers"
    )
    form = blocks.form(
        "bench",
        [
            {**blocks.choice("open", "Edit", [own, *names]), "action": "open"},
            blocks.choice("bode", "Bode figure of the", ["open loop", "controller"]),
            blocks.choice("at", "Curves at", points),
            blocks.field("name", "Name to save", "bench", action=""),  # asks for no curves
            *compared,
        ],
        [
            blocks.button("Check on the full plant", "judge"),
            *turning,
            blocks.button("Save as controller", "save", main=True),
        ],
        "Open, compare, keep",
        live="look",
        side=True,
        all=True,
    )
    rows = blocks.chains(
        "chains",
        f"Filters of {machine.name}",
        document or to_plain(opened(project, machine).to_dict()),
        _kinds(bending),
        live="look",
        side=True,
        all=True,
        fresh=document is not None,
        hint="Drag the handles in the Bode figures, or turn them with the arrow keys.",
    )
    methods = blocks.choice("method", "Method", CHOICES["method"], "tuned")
    design = blocks.form("design", [methods, drop], [blocks.job("Design", "design")], "Design one")
    verdict, *curves = _look(project, given)["blocks"]
    return blocks.content([verdict, rows, form, *curves, design], jobs=["synthesize"])


def _look(project: Project, given: Mapping[str, Any]) -> dict[str, Any]:
    """What the filters do, beside the controllers that are compared."""
    machine, plants, _ = _bench(project)
    settings: dict[str, PidSettings] = {}
    try:
        settings[_EDITED] = _edited(project, machine, given, "chains")
        laws = {_EDITED: law_of(pid_controller(settings[_EDITED], machine))}
    except InvalidInput as error:  # what is typed half: nothing is shown of what was before
        known = blocks.words("verdict", f"FAILED: {error}", tone="bad")
        gone = [*_keys(9), "peaks", "same", *_VERDICTS, "campbell"]
        return blocks.content([known], whole=False, gone=gone)
    for name in _chosen(project, given):
        if name == _OPENED:
            settings[name] = _edited(project, machine, given, "opened")
            laws[name] = law_of(pid_controller(settings[name], machine))
        else:
            laws[name] = law_of(read_controller(project.path("controllers", name), machine))
    seen = {}
    for name, law in laws.items():
        # as it runs: filters with their own timing, a file with its own
        own = settings.get(name)
        timing = timing_of(machine, law) if own is None else _timing(machine, own)
        seen[name] = [glance(plant, law, timing) for plant in plants if law.covers(plant)]
    modes = plants[0].bending_modes or 0
    note = (
        f"On the plant with {modes} bending mode{'s' * (modes != 1)} per plane, without tolerances."
    )
    pictures = _pictures(seen, settings[_EDITED], machine, given)
    drawn = [block["key"] for block in pictures]
    name = word(given, "name") or "bench"
    same = blocks.same(
        f"ambrose verify {MACHINE} --controller controllers/{name}.json",
        f'machine = amb.load_machine("{MACHINE}")',
        f'controller = amb.read_controller("controllers/{name}.json", machine)',
        "amb.verify(machine, controller, tolerances=False)",
    )
    # a check of other values is no verdict on these
    return blocks.content(
        [_verdict(seen[_EDITED]), *pictures, _table(seen, plants, note), same],
        whole=False,
        gone=[*(key for key in _keys(9) if key not in drawn), *_VERDICTS, "campbell"],
    )


def _keys(channels: int) -> list[str]:
    """Keys of the figures."""
    bode = [f"{part}-{i}" for part in _PARTS for i in range(channels)]
    return [*bode, "sensitivity", "loci", "pulse"]


def _verdict(looks: Sequence[Glance]) -> Block:
    """Of the filters, at all operating points."""
    lost = [look.stability for look in looks if not look.stability.stable]
    passed = all(look.passed for look in looks)
    text = ", ".join(f"{item.label} ({item.abscissa:+.3g} 1/s)" for item in lost)
    text = f"the loop is unstable at {text} (reduced plant); the open loop is drawn."
    if not lost:
        # the one nearest to its limit, or farthest above it
        found = [(check, look.stability.label) for look in looks for check in look.checks]
        worst, label = max(found, key=lambda item: item[0].ratio or 0.0)
        what = "of an axis" if worst.title == LARGEST else "of all axes together"
        limit = "" if worst.limit is None else f" (limit {worst.limit:g})"
        text = (
            f"the loop is stable at all {len(looks)} operating points (reduced plant); "
            f"largest sensitivity {what} {worst.value:.3g}{limit} at {label}."
        )
    word = "PASSED" if passed else "FAILED"
    return blocks.words("verdict", f"{word}: {text}", tone="good" if passed else "bad")


def _chosen(project: Project, given: Mapping[str, Any]) -> list[str]:
    known = (_OPENED, *project.names("controllers"))
    names = [name for name in known if given.get(f"with.{name}") is True]
    if len(names) >= _MOST:
        raise InvalidInput(f"{_MOST} controllers at most are compared, the edited one among them")
    return names


def _timing(machine: Machine, settings: PidSettings) -> Timing | None:
    """Of filters: what they state, with the machine's chain; once for all that state the same."""
    key = settings.sample_time, settings.delay
    if key not in _timings:
        _timings[key] = machine_timing(replace(machine, controller=settings))
    return _timings[key]


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
    seen: Mapping[str, Sequence[Glance]],
    settings: PidSettings,
    machine: Machine,
    given: Mapping[str, Any],
) -> list[Block]:
    """Bode figures of every channel with their handles; sensitivity, loci and pulse; side by side
    where there is room.
    """
    points = [look.stability.label for look in seen[_EDITED]]
    wanted = [at] if (at := word(given, "at")) in points else points
    shown: dict[str, Glance] = {}
    style, quiet = dict[str, theme.Style](), set[str]()
    looks = theme.styles(points if len(wanted) > 1 else list(seen))
    for dash, (name, glances) in zip(("", *_DASHES), seen.items(), strict=False):
        for look in (item for item in glances if item.stability.label in wanted):
            point = look.stability.label
            label = name if len(wanted) == 1 and len(seen) > 1 else point
            if dash and len(wanted) > 1:
                label = f"{name}, {point}"
                quiet |= {label} if point != wanted[0] else set()
                style[label] = replace(looks[point], dash=dash, width=1.3)
            elif len(wanted) > 1:
                style[label] = (
                    replace(looks[point], dash="solid") if len(seen) > 1 else looks[point]
                )
            else:
                style[label] = looks[name]
            shown[label] = look
    place = "" if len(wanted) > 1 or len(points) == 1 else f" at {wanted[0]}"
    wide = width(given)
    beside = min(max((wide + 46) // 446, 1), 3)  # panels of 430 px and more, 16 px between them
    each, half = (wide + 46) // beside - 46, (wide + 46) // min(beside, 2) - 46
    with theme.bare():
        found = list(
            _bode(shown, style, quiet, settings, machine, half, place, word(given, "bode"))
        )
        limit = machine.requirements.sensitivity_peak or SENSITIVITY.limits[0].value
        loci = nyquist_figure([(label, look.loci) for label, look in shown.items()], limit, style)
        drawn = {"loci": (loci, f"Loci of all axes{place}")}
        for key, title in (
            ("sensitivity", "Sensitivity, largest of the axes"),
            ("pulse", "Displacement after a short current"),
        ):
            curves = [(n, curve) for n, look in shown.items() if (curve := getattr(look, key))]
            if curves:
                drawn[key] = line_figure(curves, style), f"{title}{place}"
        for key, (picture, title) in drawn.items():
            _hush(picture, quiet)
            text = svg(picture, each, title, key)
            found.append(blocks.picture(key, text, title, half=True))
    # what a hand looks at while it turns stands together
    order = ("size", "sensitivity", "loci", "phase", "pulse")
    return sorted(found, key=lambda block: order.index(block["key"].partition("-")[0]))


def _hush(picture: Any, quiet: set[str]) -> None:
    """The legend without these labels."""
    for trace in picture.data:
        if trace.get("legendgroup") in {theme.plain(label) for label in quiet}:
            trace["showlegend"] = False


def _bode(
    shown: Mapping[str, Glance],
    style: Mapping[str, theme.Style],
    quiet: set[str],
    settings: PidSettings,
    machine: Machine,
    wide: int,
    place: str,
    of: str,
) -> Iterator[Block]:
    """Magnitudes of all channels, then their phases; the handles of a chain on the first curve."""
    names = channel_names(settings, machine.axes)
    into, out = mixings(settings, machine)
    front, back = np.linalg.pinv(out), np.linalg.pinv(into)
    lines: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    for label, look in shown.items():
        K = front @ look.response.K @ back
        if of == "controller":
            gain = np.einsum("wii->wi", K)
        else:  # opened in one channel, the others closed: L_i = 1/S_ii - 1
            S = np.linalg.inv(np.eye(len(names)) + into @ look.response.G @ out @ K)
            gain = 1 / np.einsum("wii->wi", S) - 1
        lines[label] = look.response.omega, gain
    timing = _timing(machine, settings)
    T = None if timing is None else timing.sample_time
    for part, words in _PARTS.items():
        for c, channel in enumerate(settings.channels):
            i = names.index(channel.names[0])
            curves = {label: (omega, gain[:, i]) for label, (omega, gain) in lines.items()}
            unit = "A/m" if of == "controller" else ""
            picture = bode_figure(curves, style, part, unit)
            _hush(picture, quiet)
            key = f"{part}-{c}"
            what = "Controller" if of == "controller" else "Open loop"
            title = f"{what} of {', '.join(map(theme.axis_name, channel.names))}: {words}{place}"
            drawn = drawing(picture, wide, key)
            handles = list(_handles(c, channel, part, drawn, T)) if curves else []
            drawn_text = "".join(drawn.text(title))
            step = [float(np.ptp(drawn.at("x", [1.0, 10.0]))), drawn.unit("y")]
            yield blocks.picture(key, drawn_text, title, half=True, handles=handles, step=step)


def _handles(
    c: int, channel: Channel, part: str, drawn: Drawing, T: float | None
) -> Iterator[Block]:
    """Where the handles of a chain stand on a figure's first curve [px]; T [s]: Tustin's map draws
    a frequency w down to 2/T atan(w T/2).
    """
    x, y = (np.asarray(drawn.traces[0][axis], dtype=float) for axis in "xy")
    left, top, wide, tall = drawn.box("x", "y")
    found = [(r, s.kind, grip) for r, s in enumerate(channel.sections) for grip in grips(s)]
    found.insert(0, (-1, "gain", (TWO_PI * 1.5 * x[0], "of all", "size", [["gain", "y", 1]])))
    for r, kind, (w, words, on, terms) in found:
        if on != part:
            continue
        at = (w if T is None else 2 / T * atan(w * T / 2)) / TWO_PI
        height = float(np.interp(np.log(at), np.log(x), y))
        px, py = float(drawn.at("x", [at])[0]), float(drawn.at("y", [height])[0])
        number = f" {r + 1}" if r >= 0 else ""
        label = f"{kind}{number} of {', '.join(channel.names)}: {words}, {w / TWO_PI:.4g} Hz"
        px, py = float(np.clip(px, left, left + wide)), float(np.clip(py, top, top + tall))
        place = {"x": round(px, 1), "y": round(py, 1), "channel": c, "row": r}
        yield {**place, "label": label, "terms": terms}


def _synthesis(project: Project, given: Mapping[str, Any]) -> tuple[Machine, Synthesis]:
    """The controller of the filters, certified on the full plant at every operating point, with all
    that a designed one is told; it says its timing where the machine file has another one.
    """
    from ambrose.model.assemble import assemble
    from ambrose.synthesis.design import design

    machine, _, _ = _bench(project)
    settings = _edited(project, machine, given, "chains")
    own = replace(machine, controller=settings)
    result = design(assemble(own), "pid")
    timing, known = machine_timing(own), machine_timing(machine)
    stated = None
    if timing is not None and (known is None or timing != replace(known, source=timing.source)):
        stated = {"rate": timing.rate, "delay_samples": timing.delay_samples}
    # the project's file holds other settings
    return machine, replace(result, provenance=Provenance(settings=stated))


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
    machine, plants, _ = _bench(project)
    settings = _edited(project, machine, given, "chains")
    timing = _timing(machine, settings)
    law = running_law(pid_controller(settings, machine), plants[0], timing)
    frequencies, _ = campbell_map(plants[0], law, lambda stage: None)
    with theme.bare():
        drawn = svg(figure([(_EDITED, frequencies)]), width(given), "Campbell", "campbell")
    title = "Campbell diagram of the loop, full plant"
    return blocks.content([blocks.picture("campbell", drawn, title)], whole=False)


def _save(project: Project, given: Mapping[str, Any]) -> dict[str, Any]:
    """The controller of the filters as a file, with its certificate."""
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
    show_controllers,
    {"look": _look, "open": _open, "judge": _judge, "campbell": _campbell, "save": _save},
)
