"""One picture of any result: ``plot(x)`` gives its main figure, with a title, in the look of the
reports.

What can be drawn is registered here by type, a few lines each; a type of a higher layer, or of
another package, is recognised by what it carries (candidates, or A, B, C, D). plotly is imported
inside the functions.
"""

import textwrap
from collections.abc import Sequence
from functools import singledispatch
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import FrequencyResponse, frequency_response
from ambrose.core.lft import GeneralizedPlant
from ambrose.core.mu.bounds import MuBounds, MuPeak
from ambrose.core.scheduled import AND, ScheduledSystem
from ambrose.core.statespace import StateSpace, as_statespace, poles, select
from ambrose.identification.frf_spectral import Frf
from ambrose.identification.one_axis.identify import GenericIdentification
from ambrose.identification.output_error.closed_loop import ParameterEstimate
from ambrose.identification.result import Identification
from ambrose.identification.seal.by_pressure import SealFit, averaged
from ambrose.identification.static_load import StaticLoad
from ambrose.identification.youla import ResidualIdentification
from ambrose.judge.checks import Checks, Curve, Verification
from ambrose.judge.plants import plant_gain
from ambrose.judge.result import Synthesis
from ambrose.machine.machine import Machine
from ambrose.model.plant import Plant
from ambrose.record.record import Record
from ambrose.report import theme
from ambrose.report.comparison import loop_figures, run_up_figure
from ambrose.report.comparison_tables import decision
from ambrose.report.figures.bode import (
    Line,
    bode_figure,
    entries,
    filter_figure,
    grid_of,
    residual_figure,
    unit_of,
)
from ambrose.report.figures.curves import BEYOND, figure, pole_zero_map
from ambrose.report.figures.rotor_drawing import machine_drawing
from ambrose.report.figures.seals import frequency_figure, response_figure
from ambrose.report.identification import change_figure, line_figure, prediction_figure, seal_figure
from ambrose.report.record import record_figure
from ambrose.rig.trace import Trace
from ambrose.rig.trial import Candidate, RunUp, points_of
from ambrose.synthesis.trade_off import TradeOff

_DRAWN = (
    "a Machine, Plant, controller (StateSpace, Synthesis, schedule, python-control system), "
    "Checks, Verification, Trace, "
    "Record, Identification, FrequencyResponse, Curve, TradeOff, Study, bounds of mu, or several "
    "systems by name"
)
_TITLE = 44  # characters of a line of the title: it fits a telephone
_FAMILY = 5  # members of a schedule that are drawn


@singledispatch
def plot(thing: Any) -> Any:
    """The main figure of a result, in the units of the reports (Hz, µm, ms).

    thing: a Machine (the rotor to scale, its mode shapes), a Plant (largest gain from currents to
    sensors), a controller (Bode diagram by axis), Checks or a Verification (output sensitivity with
    its zone limits), a Trace or Record (signals over time, orbits), an Identification (parameters
    with intervals), a FrequencyResponse, a Curve, a Study (controllers side by side), bounds of mu;
    a dict of systems by name (poles and zeros side by side). Returns a plotly Figure: .show(),
    .write_html(path). Raises InvalidInput for anything else.
    """
    if all(hasattr(thing, letter) for letter in "ABCD"):
        return plot(as_statespace(thing))
    if hasattr(thing, "candidates"):  # a Study: it stands above this layer
        return _study(thing)
    raise InvalidInput(f"plot() cannot draw {type(thing).__name__}; give {_DRAWN}")


def _titled(picture: Any, title: str) -> Any:
    """The figure with a title above it and its legend beneath, where it finds room at any width."""
    lines = [theme.plain(line) for line in textwrap.wrap(title, _TITLE)]
    # no room for it when narrow
    for note in [item for item in picture.layout.annotations if item.text.startswith(BEYOND)]:
        lines.append(f'<span style="font-size: 12px; color: {theme.MUTED}">{note.text}</span>')
        picture.layout.annotations = [
            item for item in picture.layout.annotations if item is not note
        ]
    top = 24 * len(lines) + 50  # the unit stands between title and axis
    legend = bool(picture.layout.showlegend)
    before = picture.layout.margin
    inside = picture.layout.height - before.t - before.b
    bottom = before.b + (34 if legend else 0)
    picture.update_layout(
        title={
            "text": "<br>".join(lines),
            "x": 0,
            "xref": "paper",
            "xanchor": "left",
            "y": 1,
            "yref": "container",
            "yanchor": "top",
            "pad": {"t": 10 + 20 * (len(lines) - 1)},
            "font": {"size": 16, "color": theme.INK},
        },
        margin={"t": top, "b": bottom},
        height=inside + top + bottom,
        modebar={"remove": ["select2d", "lasso2d", "zoomIn2d", "zoomOut2d", "autoScale2d"]},
    )
    if legend:
        picture.update_layout(
            legend={"yref": "paper", "y": -(before.b - 8) / inside, "yanchor": "top"}
        )
    return picture


@plot.register
def _machine(machine: Machine) -> Any:
    return _titled(machine_drawing(machine), f"{machine.name}: rotor and free-free modes")


@plot.register
def _plant(plant: Plant) -> Any:
    curve = plant_gain(plant)
    label = plant.point.label or "plant"
    size = "full model" if plant.bending_modes is None else f"{plant.bending_modes} bending modes"
    unstable = int((poles(plant.system).real > 0).sum())
    words = f"{plant.machine.name}, {label}: largest gain from currents to displacements"
    # seven decades: the bending modes stay in view
    picture = figure([(label, curve)], overlay=True)
    picture.layout.annotations = [
        item for item in picture.layout.annotations if not item.text.startswith(BEYOND)
    ]
    picture.update_traces(line={"width": 2, "color": theme.styles([label])[label].colour})
    return _titled(
        picture, f"{words}; {size}, {plant.system.n_states} states, {unstable} unstable poles"
    )


@plot.register
def _system(system: StateSpace, name: str = "") -> Any:
    response = frequency_response(system, grid_of(system))
    picture = bode_figure(entries(response), unit_of(response), sample_time=system.dt)
    rate = (
        "continuous" if system.dt is None else f"sampled at {theme.quantity(1 / system.dt, 'Hz')}"
    )
    kind = name or (
        "Controller" if system.inputs and system.inputs[0].startswith("err_") else "System"
    )
    return _titled(picture, f"{kind}: {system.n_states} states, {rate}")


@plot.register
def _systems(systems: dict) -> Any:
    """Title -> continuous system: their poles and zeros side by side."""
    if not systems or not all(hasattr(system, "A") for system in systems.values()):
        raise InvalidInput(f"plot() cannot draw this dict; give {_DRAWN}")
    return pole_zero_map(systems)


@plot.register
def _schedule(schedule: ScheduledSystem, name: str = "Schedule") -> Any:
    chosen = np.unique(np.linspace(0, len(schedule.systems) - 1, _FAMILY).astype(int))
    members = [(_place(schedule, i), schedule.systems[i]) for i in chosen]
    omega = np.unique(np.concatenate([grid_of(system) for _, system in members]))
    lines = [
        Line(label, omega, frequency_response(system, omega).values[:, 0, 0])
        for label, system in members
    ]
    unit = unit_of(frequency_response(members[0][1], omega[:1]))
    picture = bode_figure(
        lines,
        unit,
        sample_time=members[0][1].dt,
        style=theme.family_styles([line.name for line in lines]),
    )
    axis = theme.axis_name(schedule.outputs[0])
    return _titled(
        picture,
        f"{name}: {axis} from {theme.axis_name(schedule.inputs[0])} over {schedule.parameter}",
    )


def _place(schedule: ScheduledSystem, i: int) -> str:
    at = zip(np.atleast_1d(schedule.values[i]).tolist(), schedule.unit.split(AND), strict=True)
    return ", ".join(theme.quantity(value, unit) for value, unit in at)


@plot.register
def _synthesis(synthesis: Synthesis) -> Any:
    if synthesis.filters is not None and synthesis.scheduled is None:
        system = synthesis.controller
        axes = tuple(name.removeprefix("err_") for name in system.inputs)
        picture, room = filter_figure(synthesis.filters, axes, system.dt), 0
        # of the chains, which stand where _titled would put the axes
        room = picture.layout.meta["room"] - 24
        picture.update_layout(
            margin={"t": picture.layout.margin.t - room}, height=picture.layout.height - room
        )
        picture = _titled(
            picture,
            f"Controller ({synthesis.method}): {system.n_states} states, each channel in series",
        )
        return picture.update_layout(
            margin={"t": picture.layout.margin.t + room}, height=picture.layout.height + room
        )
    draw = _schedule if synthesis.scheduled is not None else _system
    return draw(synthesis.law, f"Controller ({synthesis.method})")  # type: ignore[arg-type]


@plot.register
def _generalized(plant: GeneralizedPlant) -> Any:
    return _system(select(plant.system, plant.u, plant.y), "Generalized plant, u to y")


@plot.register
def _response(response: FrequencyResponse) -> Any:
    return _titled(bode_figure(entries(response), unit_of(response)), "Frequency response")


@plot.register
def _measured(measured: Frf) -> Any:
    pairs = list(zip(measured.inputs, measured.outputs, strict=False))[:4]
    panels = {theme.axis_name(output): measured.select(input, output) for input, output in pairs}
    return _titled(response_figure(panels, {}), "Measured frequency response")


@plot.register
def _curve(curve: Curve) -> Any:
    return _titled(figure([(curve.name, curve)]), theme.prose(curve.title))


@plot.register
def _checks(checks: Checks) -> Any:
    return _sensitivity([(checks.label, checks)], "passed" if checks.passed else "not passed")


@plot.register
def _verification(verification: Verification) -> Any:
    points = [(checks.label, checks) for checks in verification.points]
    words = ["passed" if verification.passed else "not passed"]
    words += [f"left out: {', '.join(verification.left_out)}"] if verification.left_out else []
    return _sensitivity(points, "; ".join(words))


@plot.register
def _candidate(candidate: Candidate) -> Any:
    return _verification(
        Verification(
            candidate.checks,
            candidate.boxes,
            candidate.left_out,
            candidate.timing,
            ranges=candidate.ranges,
        )
    )


def _sensitivity(points: Sequence[tuple[str, Checks]], verdict: str) -> Any:
    """The output sensitivity of the stable loops, all points overlaid; the poles where none is
    stable.
    """
    for name in ("sensitivity.output", "robust.sensitivity", "poles"):
        curves = [
            (label, curve)
            for label, checks in points
            for curve in checks.curves
            if curve.name == name
        ]
        if curves:
            unstable = [label for label, checks in points if not checks.stable]
            words = f"; unstable at {', '.join(unstable)}" if unstable else ""
            order = [label for label, _ in points]
            return _titled(
                figure(curves, order=order), f"{theme.prose(curves[0][1].title)}: {verdict}{words}"
            )
    raise InvalidInput(
        "the verification has no curves to draw; verify again with nominal.check or robust.check"
    )


@plot.register
def _trace(trace: Trace) -> Any:
    where = trace.record.point.label
    return _titled(
        record_figure(trace.record),
        f"{trace.scenario}{f', {where}' if where else ''}: {trace.outcome}",
    )


@plot.register
def _record(record: Record) -> Any:
    where = record.point.label
    return _titled(
        record_figure(record), f"Record of {record.machine}{f', {where}' if where else ''}"
    )


@plot.register
def _estimate(result: ParameterEstimate) -> Any:
    return _titled(
        change_figure(result), f"{len(result.paths)} parameters of {result.machine}, 95 % intervals"
    )


@plot.register
def _identification(identification: Identification) -> Any:
    return plot(identification.result)


@plot.register
def _static(result: StaticLoad) -> Any:
    return _titled(line_figure(result), "Static loads: magnet force beyond the straight line")


@plot.register
def _residual(result: ResidualIdentification) -> Any:
    return _titled(residual_figure(result), "Residual system S: measured and identified")


@plot.register
def _generic(done: GenericIdentification) -> Any:
    return _titled(prediction_figure(done), f"{done.record.name}: what was not fitted")


@plot.register
def _seal(fit: SealFit) -> Any:
    if np.isnan(fit.frequency).all():
        section = seal_figure(fit)
        return _titled(section.picture, section.title)
    return _titled(
        frequency_figure(fit, averaged(fit)),
        f"Seal {theme.axis_name(fit.seal)}: coefficients over frequency",
    )


@plot.register
def _run_up(run: RunUp) -> Any:
    section = run_up_figure([run])
    return _titled(section.picture, f"{run.name}: {section.title.lower()}")


@plot.register
def _mu_peak(peak: MuPeak) -> Any:
    curve = Curve(
        "mu", "mu", "frequency", peak.omega, peak.values[None], ("upper bound",), "rad/s", "-"
    )
    words = (
        f"Structured singular value: upper bound {theme.number(peak.upper)}, lower bound "
        f"{theme.number(peak.lower)}"
    )
    return _titled(figure([("upper bound", curve)]), words)


@plot.register
def _mu_bounds(bounds: MuBounds) -> Any:
    import plotly.graph_objects as go

    if np.ndim(bounds.upper) != 1:
        shape = np.shape(bounds.upper)
        raise InvalidInput(
            f"the bounds of mu have the shape {shape}, but must be (n,) to be drawn; give one "
            "matrix per frequency"
        )
    looks = theme.styles(["upper bound", "lower bound"])
    picture = go.Figure()
    for (name, look), values in zip(looks.items(), (bounds.upper, bounds.lower), strict=True):
        theme.scatter(picture, {}, None, values, name, shown=True, line=look.line)
    theme.dress(picture, 300, legend=True)
    picture.update_xaxes(title_text="Number of the matrix")
    picture.update_yaxes(title_text="µ", rangemode="tozero")
    return _titled(
        picture, f"Structured singular value: at most {theme.number(float(np.max(bounds.upper)))}"
    )


@plot.register
def _trade_off(result: TradeOff) -> Any:
    """The lowest sensitivity over the requirement; hollow where all else was not met."""
    import plotly.graph_objects as go

    factor, unit = theme.scale(result.unit, max(result.values))
    x, y = (
        np.array(result.values) * factor,
        np.where(np.isfinite(result.sensitivity), result.sensitivity, np.nan),
    )
    picture, look = go.Figure(), theme.styles(["lowest sensitivity"])["lowest sensitivity"]
    marks = {
        "size": 9,
        "symbol": ["circle" if met else "circle-open" for met in result.met],
        "color": look.line["color"],
    }
    theme.scatter(
        picture,
        {},
        x,
        y,
        "lowest sensitivity",
        mode="lines+markers",
        line=look.line,
        marker=marks,
        customdata=result.binding,
        hovertemplate="%{x:.4g}: %{y:.3g}, %{customdata} binds<extra/>",
    )
    theme.dress(picture, 300, legend=False)
    name = result.over.replace("_", " ").capitalize()
    picture.update_xaxes(title_text=f"{name} [{unit}]" if unit != "-" else name)
    picture.update_yaxes(title_text="Largest singular value of S_o [-]")
    hollow = "" if all(result.met) else "; hollow: not all other requirements are met"
    return _titled(
        picture, f"What {name.lower()} costs: the lowest sensitivity of a tuned controller{hollow}"
    )


def _study(study: Any) -> Any:
    candidates = study.candidates
    figures = loop_figures(candidates, points_of(study.machine, candidates))
    if not figures:
        raise InvalidInput(
            "no controller of the study stabilises the machine at any point, so there is no "
            "curve to compare; see its checks"
        )
    words = decision(candidates).text.partition(";")[0].rstrip(".")
    return _titled(
        figures[0].picture,
        f"{study.machine.name}: {figures[0].title.lower()}; {words[:1].lower()}{words[1:]}",
    )
