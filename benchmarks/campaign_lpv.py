"""P3.7 and P3.8: LPV against the mu controller of 140 Hz in the turboexpander's spin-up: ``python
-m benchmarks.campaign_lpv``.

Prints gamma and poles of the LPV syntheses (any rate, and bounded rate), the settling of every step
of the bundled scenario "spin-up-steps" on the linear loop and on the virtual rig, and peaks and
crossovers over speed. ``-o DIR`` writes the figure.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ambrose import load_machine
from ambrose.annexes.scheduled.lpv.machine import design_schedule
from ambrose.judge.loop_response import loop_evaluator
from ambrose.law.loop import match_controller
from ambrose.machine.parameters import operating_point
from ambrose.model.assemble import assemble
from ambrose.model.plant import Plant
from ambrose.rig import virtual_rig
from ambrose.rig.scenario import Scenario, load_scenario
from ambrose.rig.trace import Trace
from ambrose.rig.trial import spin_up, steps
from ambrose.synthesis.design import design

HZ = 2 * np.pi
SPEEDS_HZ = (20, 25, 30, 35, 60, 100, 140, 180, 220, 260, 300)
COLOURS = {"LPV": "#1f6fb4", "mu of 140 Hz": "#d1521f"}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=None, help="folder for the figure")
    output = parser.parse_args().output
    machine = load_machine("turboexpander")
    plant = assemble(machine, operating_point(machine, "140 Hz"))
    grid = HZ * np.linspace(20, 300, 8)
    lpv = design_schedule(plant, grid)
    _tell("LPV, any rate", lpv)
    _tell("LPV, 1760 rad/s^2", design_schedule(plant, grid, rate=1760.0))
    mu = design(plant, "mu")
    _tell("mu of 140 Hz", mu)
    controllers = {"LPV": lpv.scheduled, "mu of 140 Hz": mu.controller}
    scenario = load_scenario("spin-up-steps")
    alone = each_alone(scenario)
    linear, apart = (
        {name: spin_up(plant, K, s) for name, K in controllers.items()} for s in (scenario, alone)
    )
    rig = {
        name: virtual_rig.run(machine, K, scenario, point=plant.point)
        for name, K in controllers.items()
    }
    for where, traces, what in (
        ("linear", linear, scenario),
        ("rig", rig, scenario),
        ("each step alone, linear", apart, alone),
    ):
        for name, trace in traces.items():
            print(f"{where}, {name}: {trace.outcome}")
            for s in steps(trace, what, [f"y_{a}" for a in plant.axes]):
                print(
                    f"  {s.start:.2f} s {s.speed / HZ:5.0f} Hz  peak {1e6 * s.peak:5.2f} um  "
                    f"settles in {1e3 * s.settling:4.1f} ms  {s.crossings} crossings"
                )
    print(
        "speed [Hz], then per controller: peak of sigma_max(S_o), of one axis, frequency [Hz] "
        "where sigma_max(S_o) passes 1"
    )
    for hz in SPEEDS_HZ:
        print(
            f"  {hz:4d}",
            *(
                f"{name}: " + " ".join(f"{x:.2f}" for x in _peaks(plant, K, hz))
                for name, K in controllers.items()
            ),
        )
    if output is not None:
        output.mkdir(parents=True, exist_ok=True)
        print(_draw(linear, rig, output / "lpv-spin-up.html"))


def each_alone(scenario: Scenario) -> Scenario:
    """The other reading of P3's "alternating": every pulse twice as long and twice as rare, so that
    force up, output up, force down, output down follow each other and no two steps fall together.
    In the bundled scenario the force drops as the output rises.
    """
    pulses = [
        replace(p, duration=2 * p.duration, every=2 * p.every)
        for p in scenario.pulses
        if p.every is not None
    ]
    return replace(scenario, pulses=tuple(pulses))


def _tell(name: str, result: Any) -> None:
    margins = {key: round(value, 4) for key, value in result.certificate.margins.items()}
    print(
        f"{name}: {result.status}, gamma {result.gamma:.4f}, {result.controller.n_states} states, "
        "fastest pole "
        f"{result.certificate.fastest_pole:.3g} rad/s, {margins}"
    )


def _peaks(plant: Plant, controller: Any, hz: float) -> tuple[float, float, float]:
    """Peak of the largest singular value of S_o, of its largest diagonal entry, and its crossing of
    1 [Hz].
    """
    here = assemble(plant.machine, replace(plant.point, speed=HZ * hz))
    omega = HZ * np.geomspace(1, 2000, 1500)
    S = loop_evaluator(here, match_controller(controller, here))(omega).output_sensitivity()
    largest = np.linalg.norm(S, 2, axis=(1, 2))
    return (
        float(largest.max()),
        float(np.abs(np.einsum("kii->ki", S)).max()),
        float(omega[np.argmax(largest > 1)] / HZ),
    )


def _draw(linear: Mapping[str, Trace], rig: Mapping[str, Trace], path: Path) -> Path:
    import plotly.graph_objects as go
    from plotly.subplots import make_subplots

    titles = ["Spin-up from 20 to 300 Hz, linear loop"]
    titles += [
        f"{part} 100 ms, {where}"
        for where in ("linear loop", "virtual rig")
        for part in ("first", "last")
    ]
    figure = make_subplots(
        rows=3,
        cols=2,
        specs=[[{"colspan": 2}, None], [{}, {}], [{}, {}]],
        subplot_titles=titles,
        vertical_spacing=0.1,
    )
    places = [
        (1, 1, linear, (0, 1000)),
        *(
            (row, 1 + k, traces, span)
            for row, traces in ((2, linear), (3, rig))
            for k, span in enumerate(((0, 100), (900, 1000)))
        ),
    ]
    for row, column, traces, (first, last) in places:
        for name, trace in traces.items():
            time, y = 1e3 * trace.record.time, 1e6 * trace.record.select(["y_A_zeta"]).values[0]
            inside = (time >= first) & (time < last)
            line = {"color": COLOURS[name], "width": 1.5}
            figure.add_trace(
                go.Scatter(x=time[inside], y=y[inside], name=name, line=line, showlegend=row == 1),
                row,
                column,
            )
        if row > 1:
            figure.add_vline(
                x=first + 20,
                line={"color": "grey", "dash": "dot", "width": 1},
                annotation_text="20 ms",
                row=row,
                col=column,
            )
    figure.update_xaxes(title_text="time [ms]")
    figure.update_yaxes(title_text="y_A_zeta [um]")
    legend = {"orientation": "h", "y": 1.05, "x": 0.75}
    figure.update_layout(template="plotly_white", width=1100, height=1050, legend=legend)
    figure.write_html(path, include_plotlyjs=True, config={"displayModeBar": False})
    return path


if __name__ == "__main__":
    main()
