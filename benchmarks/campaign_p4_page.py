"""The campaigns of P4 and P5 in pictures, on one page (campaign_p4.py)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ambrose.identification.frf_spectral import Frf
from ambrose.judge.checks import Curve
from ambrose.machine.machine import Machine
from ambrose.report import theme, theme as units
from ambrose.report.figures import seals as seal_figures
from ambrose.report.figures.bode import Panel, panel_figure
from ambrose.report.page import Figure, Page, Section
from benchmarks.campaign_p4_results import BAR, HZ, NOMINAL, Impulses, Stepped, Swept, truth

GREEK = {"zeta": "ζ", "eta": "η"}


def page(machine: Machine, swept: Sequence[Swept], sines: Stepped, pulses: Impulses) -> Page:
    """The whole page."""
    sections = (_bearings(swept), _frequency(sines), _resonance(sines), _pressure(machine, pulses))
    return Page(
        "Identification of bearings and seal on the virtual rig (papers P4 and P5)",
        machine,
        sections,
    )


def _bearings(swept: Sequence[Swept]) -> Section:
    measured = {}
    models = {}
    limits = {}
    for item in swept:
        title = f"along {GREEK[item.axis]}"
        measured[title] = item.measured.select(outputs=item.measured.outputs[0])
        models[title] = item.models
        limits[title] = float(item.validity["identified, 8 rigid states"].valid_to[0, 0])
        measured[f"across {GREEK[item.axis]}"] = item.measured.select(
            outputs=item.measured.outputs[1]
        )
    figure = seal_figures.response_figure(measured, models, valid_to=limits)
    caption = (
        "Motion of the rotor's middle per ampere on both bearings, along the excited direction "
        "and across it, under a chirp "
        "of 20 s to 150 Hz, without coupling and pressure (P4, Fig. 9 and 10). Read in the third "
        "row how far each model stays "
        "good: with bending modes to the end, with the eight rigid states of the thesis below 2 % "
        "to the dashed line, the "
        "machine file without identification 6 % off. The pale band is the measurement's own "
        "error. The response "
        "across is a tenth of the direct one, its coherence lower, and no model has it."
    )
    return Section(
        "Bearings: measured response and models", "", (Figure("Chirp", figure, caption),)
    )


def _frequency(sines: Stepped) -> Section:
    figure = seal_figures.frequency_figure(
        sines.fit, sines.constants, truth=truth, valid_to=100 * HZ
    )
    caption = (
        "Seal coefficients from stepped sines at each frequency, with 95 % bars; lines: means to "
        "100 Hz; dotted: truth. "
        "k grows with pressure and does not depend on frequency; K is zero. Beyond 100 Hz the "
        "motion is too small against the "
        "sensors' noise (P4, Fig. 12, has the same limit)."
    )
    return Section(
        "Seal over frequency", "", (Figure("Coefficients over frequency", figure, caption),)
    )


def _resonance(sines: Stepped) -> Section:
    figures = []
    for number, name in enumerate(("along the excitation", "across it")):
        measured: dict[str, Frf] = {}
        models = {}
        for pressure, item in sines.measured.items():
            if number and not pressure:
                continue  # nothing moves across the excitation without pressure
            title = f"{pressure / BAR:.1f} bar"
            output = item.outputs[number]
            measured[title] = item.select(item.inputs[0], output)
            if pressure in sines.model:
                models[title] = {
                    "constant coefficients": sines.model[pressure].select(item.inputs[0], output)
                }
        caption = (
            f"Motion of the middle {name} per ampere on both bearings; one constant model per "
            "pressure (P4, Fig. 13 to 15)."
        )
        figures.append(
            Figure(
                f"Motion {name}",
                seal_figures.response_figure(measured, models, points=True),
                caption,
            )
        )
    text = "The peak grows with pressure: the forward whirl loses its damping to k."
    return Section("One constant model for all frequencies", text, tuple(figures))


def _beside(
    i: int, axis: str, time: np.ndarray, *responses: np.ndarray
) -> tuple[tuple[str, Curve], ...]:
    """The measured and the modelled displacement of one axis; time (k,) [s], responses (p, k)
    [m].
    """
    return tuple(
        (label, Curve("impulse", "", "time", time, values[i : i + 1], (axis,), "s", "m"))
        for label, values in zip(("measured", "identified model"), responses, strict=True)
    )


def _pressure(machine: Machine, pulses: Impulses) -> Section:
    shown = {
        f"{p / BAR:.2f} bar": r
        for p, r in pulses.responses.items()
        if round(p / BAR, 2) in (0.95, 1.9)
    }
    rows = [
        [
            Panel(units.axis_name(axis), _beside(i, axis, *responses), side=title)
            for i, axis in enumerate(machine.axes)
        ]
        for title, responses in shown.items()
    ]
    overlay, _ = panel_figure(
        rows, theme.overlay_styles(("measured", "identified model")), height=190
    )
    lines = seal_figures.pressure_figure(pulses.fit, pulses.lines, nominal=NOMINAL, truth=truth)
    return Section(
        "Seal over pressure, from impulses",
        "",
        (
            Figure(
                "Impulse responses",
                overlay,
                "0.05 A for 10 ms on both bearings along zeta, means (P5, Fig. 5, 6).",
            ),
            Figure(
                "Coefficients over pressure",
                lines,
                "Dashed: nominal pressure. The prediction band at the nominal pressure is the "
                "tolerance that goes into the "
                "machine (P5, Fig. 7).",
            ),
        ),
    )
