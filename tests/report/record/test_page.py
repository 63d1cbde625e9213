"""A record's page: geometry and spectra against closed forms, verdicts, thinning without losing
peaks, one page.
"""

import re
from dataclasses import replace

import numpy as np
import pytest

from ambrose.core.checks import InvalidInput
from ambrose.machine.description import OperatingPoint
from ambrose.machine.file.toml import load_machine
from ambrose.record.record import Record
from ambrose.report.figures.motion import (
    Station,
    orbit_figure,
    rotor_animation,
    rotor_speed,
    spectrum,
    stations,
    waterfall_figure,
    window,
)
from ambrose.report.page import render, write
from ambrose.report.record import (
    radius_curve,
    record_page,
    record_verdicts,
    run_result,
    signal_curves,
    thinned,
)
from ambrose.rig.scenario import Scenario
from ambrose.rig.trace import Trace
from first_screen import WIDTHS, measure
from needs import needs

RATE = 10e3
RADIUS = 20e-6
WHIRL = 2 * np.pi * 80.0
MACHINE = load_machine("seal-rig")
POINT = OperatingPoint(speed=2 * np.pi * 100, seal_pressure=2.04e5, label="nominal <pressure>")
UNITS = {"y": "m", "q": "m", "u": "A", "i": "A", "f": "N", "speed": "rad/s", "e": "A"}


def record_of(signals, **changes):
    names = tuple(signals)
    units = tuple(UNITS[name.partition("_")[0]] for name in names)
    base = Record(
        "seal-rig", RATE, names, units, np.array(list(signals.values()), dtype=float), POINT
    )
    return replace(base, **changes)


def whirling(count=4000, radius=RADIUS, kind="q", **more):
    """A forward circular whirl in both bearings and the seal, phases in the machine's own axes."""
    t = np.arange(count) / RATE
    z = radius * np.exp(1j * WHIRL * t)
    own = z * np.exp(-0.25j * np.pi)  # the bearings stand at 45 degrees
    signals = {
        f"{kind}_{b}_{a}": part for b in "AB" for a, part in (("zeta", own.real), ("eta", own.imag))
    }
    if kind == "q":
        signals |= {"q_center_x": z.real, "q_center_y": z.imag}
    signals |= {f"u_{axis}": 0.5 * np.cos(WHIRL * t) for axis in MACHINE.axes}
    signals |= {f"i_{axis}": 0.4 * np.sin(WHIRL * t) for axis in MACHINE.axes}
    signals |= {f"f_magnet_{axis}": 90 * np.sin(WHIRL * t) for axis in MACHINE.axes}
    return record_of({**signals, **more})


def labels(report):
    return {verdict.label: verdict for verdict in report.verdicts}


def test_own_axes_become_global_ones():
    record = whirling()
    found = stations(record, MACHINE)
    assert [(s.name, s.position, s.gap) for s in found] == [
        ("A", 0.162, 250e-6),
        ("B", 0.698, 250e-6),
        ("center", 0.430, None),
    ]
    for station in found:
        assert station.x == pytest.approx(RADIUS * np.cos(WHIRL * record.time), abs=1e-18)
        assert station.y == pytest.approx(RADIUS * np.sin(WHIRL * record.time), abs=1e-18)


def test_a_measured_record_shows_its_sensors():
    found = stations(whirling(kind="y"), MACHINE)
    assert [(s.name, s.position, s.at_sensor, s.gap) for s in found] == [
        ("A", 0.0813, True, 250e-6),
        ("B", 0.7787, True, 250e-6),
    ]
    with pytest.raises(
        InvalidInput, match="no displacements in two directions; it needs y_A_zeta and y_A_eta"
    ):
        stations(record_of({"y_A_zeta": np.zeros(9), "q_center_x": np.zeros(9)}), MACHINE)


def test_speed_comes_from_the_signal_the_scenario_or_the_point():
    record = whirling(100)
    assert np.array_equal(rotor_speed(record), np.full(100, POINT.speed))
    ramp = Scenario("up", 0.01, speed=10.0, to_speed=20.0)
    assert rotor_speed(record, ramp)[[0, 50]] == pytest.approx([10.0, 15.0])
    assert np.array_equal(
        rotor_speed(whirling(100, speed=np.arange(100.0)), ramp), np.arange(100.0)
    )


def test_windows_are_three_revolutions_or_periods():
    record = whirling()
    found = stations(record, MACHINE)
    part = window(record, found, np.full(4000, 2 * np.pi * 50), 2000)
    assert (part.start, part.stop) == (1700, 2300)
    part = window(record, found, np.zeros(4000), 3999)  # whirl of 80 Hz
    assert part.stop == 4000 and part.stop - part.start == pytest.approx(375, abs=8)


@pytest.mark.parametrize(("forward", "backward"), [(1.0, 0.0), (0.0, 1.0), (0.5, 0.5), (0.7, 0.3)])
def test_full_spectrum_tells_forward_from_backward(forward, backward):
    t = np.arange(4000) / RATE
    z = RADIUS * (forward * np.exp(1j * WHIRL * t) + backward * np.exp(-1j * WHIRL * t))
    z = z + (5e-6 - 3e-6j) * (1 + t / 0.4)  # static load and drift
    frequency, middle, size = spectrum(Station("A", 0.0, z.real, z.imag), RATE, 1000)
    bins = np.abs(frequency - 80.0).min() * 1000 / RATE
    expected = np.sinc(bins) / (1 - bins**2)  # of a Hann window between two frequencies of the grid
    assert 0.99 < expected <= 1.0
    for sign, share in ((1, forward), (-1, backward)):
        near = np.abs(frequency - sign * 80.0) < 3.0
        assert size[near].max(axis=0) == pytest.approx(
            np.full(240, share * expected * RADIUS), rel=2e-3, abs=1e-3 * RADIUS
        )
    elsewhere = np.abs(np.abs(frequency) - 80.0) > 60.0
    # side lobes six windows' widths away; of 0.3 static load and drift nothing
    assert size[elsewhere].max() < 2.5e-3 * RADIUS
    assert (middle[0], middle[-1]) == (500, 3500)


def test_waterfall_of_a_run_up_has_the_speed_beneath_the_time():
    t = np.arange(10_001) / RATE
    speed = 2 * np.pi * (20 + 280 * t)
    phase = 2 * np.pi * (20 * t + 140 * t**2)
    record = record_of(
        {"q_A_zeta": RADIUS * np.cos(phase), "q_A_eta": RADIUS * np.sin(phase), "speed": speed}
    )
    picture = waterfall_figure(record, stations(record, MACHINE), speed)
    heat = picture.data[0]
    ridge = heat.y[np.argmax(heat.z, axis=0)]
    assert ridge == pytest.approx(20 + 280 * heat.x, abs=12)
    # a little lower: the frequency moves within a window
    assert 10 ** heat.z.max() == pytest.approx(20.0, rel=0.25)
    lines = [trace for trace in picture.data if trace.type == "scatter"]
    assert [float(line.y[-1]) for line in lines] == pytest.approx([300, 600, -300], rel=1e-4)
    assert (
        "18\u202f000" in picture.layout.xaxis.ticktext[-1]
        and "speed" in picture.layout.xaxis.title.text
    )
    assert waterfall_figure(whirling(40), stations(whirling(40), MACHINE), np.zeros(40)) is None


def test_thinning_keeps_every_peak_at_its_time():
    values = np.random.default_rng(1).standard_normal((3, 100_000))
    values[1, 77_777] = 50.0
    time = np.arange(100_000) / RATE
    at, few = thinned(time, values)
    assert few.shape == (3, 2000) and np.all(np.diff(at) > 0)
    assert np.array_equal(few.max(axis=1), values.max(axis=1)) and np.array_equal(
        few.min(axis=1), values.min(axis=1)
    )
    assert at[few[1].argmax()] == pytest.approx(7.7777, abs=0.01)
    steps = np.sign(np.diff(few.reshape(3, -1, 2), axis=2)[:, :, 0])
    bins = values.reshape(3, 1000, 100)
    # as they occur
    assert np.array_equal(steps, np.where(bins.argmin(axis=2) < bins.argmax(axis=2), 1, -1))
    assert (
        thinned(time[:2000], values[:, :2000])[1] is not None
        and thinned(time[:2000], values[:, :2000])[1].shape[1] == 2000
    )


def test_curves_carry_the_limits_of_the_machine():
    record = whirling(e_A_zeta=np.ones(4000), e_B_eta=np.zeros(4000))
    radius = radius_curve(record, stations(record, MACHINE), MACHINE)
    assert radius.labels == ("A", "B") and radius.limits == (("touchdown gap", 250e-6),)
    assert radius.y == pytest.approx(np.full_like(radius.y, RADIUS), rel=1e-9)
    curves = {curve.name: curve for curve in signal_curves(record, MACHINE)}
    assert list(curves) == ["record.u", "record.i", "record.f_magnet", "record.e"]
    assert curves["record.u"].limits == (
        ("largest control current", 4.0),
        ("largest control current", -4.0),
    )
    assert curves["record.f_magnet"].limits[0] == ("largest force", 7500.0)
    assert curves["record.e"].labels == ("e_A_zeta",)


def test_orbits_share_a_scale_and_show_a_near_touchdown_circle():
    for radius, drawn in ((RADIUS, False), (150e-6, True)):
        record = whirling(30_000, radius)
        picture = orbit_figure(record, stations(record, MACHINE), rotor_speed(record))
        assert {tuple(axis.range) for axis in picture.select_xaxes()} == {
            tuple(picture.layout.yaxis.range)
        }
        circles = [trace for trace in picture.data if trace.name == "touchdown circle"]
        assert len(circles) == (2 if drawn else 0)
        if drawn:
            assert np.hypot(circles[0].x, circles[0].y) == pytest.approx(
                np.full(181, 250.0), rel=1e-6
            )
        texts = " ".join(note.text for note in picture.layout.annotations)
        assert "8.0% of gap" in texts if not drawn else "60% of gap" in texts


def test_a_single_excursion_is_in_the_cloud():
    record = whirling(100_000)
    values = record.values.copy()
    values[0, 54_321] = 90e-6  # zeta of A: up and to the right
    record = replace(record, values=values)
    picture = orbit_figure(record, stations(record, MACHINE), rotor_speed(record))
    assert picture.layout.meta["room"] >= 40  # panels have titles of two lines under the legend
    cloud = next(trace for trace in picture.data if trace.name == "all")
    assert np.hypot(cloud.x, cloud.y).max() > 90 and len(cloud.x) < 3000


def test_animation_follows_the_stations():
    record = whirling()
    found = stations(record, MACHINE)
    picture = rotor_animation(record, found, MACHINE, rotor_speed(record))
    assert len(picture.frames) == 72 and len(picture.to_json()) < 400_000
    moving = picture.data[picture.frames[0].traces[0]]
    assert moving.mode == "lines+markers" and len(moving.x) == 3
    height = np.array([frame.data[0].y for frame in picture.frames])
    # in phase
    assert np.ptp(height, axis=0) == pytest.approx(np.full(3, np.ptp(height[:, 0])), rel=1e-5)
    assert np.ptp(height[:, 0]) == pytest.approx(
        2 * 0.10 * MACHINE.length * np.hypot(1, 0.30), rel=0.01
    )


def test_verdicts_name_the_nearest_to_its_limit():
    t = np.arange(4000) / RATE
    record = whirling(u_B_eta=np.where(t > 0.3, 4.0, 0.0))
    verdicts = {
        v.label: v for v in record_verdicts(record, MACHINE, stations(record, MACHINE), None)
    }
    assert list(verdicts) == ["Touchdown", "Controller output", "Magnet forces"]
    assert (
        verdicts["Touchdown"].passed
        and "8.0% of the gap of 250\u00a0µm" in verdicts["Touchdown"].text
    )
    assert verdicts["Controller output"].passed is False
    assert (
        "at B η at t = 300.1\u00a0ms" in verdicts["Controller output"].text
        and "B η for 99.9\u00a0ms (25 %); still at it at the end"
        in verdicts["Controller output"].text
    )
    assert verdicts["Magnet forces"].text.startswith("90\u00a0N (1.2% of 7\u202f500\u00a0N)")


def test_contact_fails_unless_the_rotor_starts_in_it():
    t = np.arange(4000) / RATE
    fall, lift = np.where(t > 0.2, 255e-6, 0), np.where(t < 0.1, 255e-6, 10e-6)
    for height, passed, words in (
        (fall, False, "beyond the gap for 50.0%"),
        (lift, True, "levitated, .* since t = 100\u00a0ms"),
        (np.full(4000, 251e-6), False, "never levitated"),
    ):
        record = record_of(
            {"q_A_zeta": -height, "q_A_eta": 0 * t, "u_A_zeta": np.where(t < 0.05, 4.0, 1.0)}
        )
        verdicts = {
            v.label: v for v in record_verdicts(record, MACHINE, stations(record, MACHINE), None)
        }
        assert verdicts["Touchdown"].passed is passed
        assert re.search(words, verdicts["Touchdown"].text)
        assert verdicts["Controller output"].passed is (
            True if words.startswith("levitated") else None
        )


def at_limit(output, force=0.0):
    """A run that came to its end with this share of the largest output (k,) and force."""
    most = MACHINE.bearings[0].max_current
    extra = {"u_A_zeta": output * most, "f_magnet_A_zeta": 0 * output + force}
    return Trace(whirling(**extra), "run", True, "completed", "completed without contact")


_TIME = np.arange(4000) / RATE


@pytest.mark.parametrize(
    ("output", "force", "passed", "words"),
    [
        (
            0.5 + 0 * _TIME,
            0.0,
            True,
            "within all limits.* Closest to its limit: controller output, 2\u00a0A",
        ),
        # one sample of 4000: 0.0 % of the time, and no failure
        (
            np.where(np.arange(4000) == 9, 1.0, 0.1),
            0.0,
            True,
            "controller output, 4\u00a0A .* It reached its limit",
        ),
        (np.where(_TIME < 0.2, -1.0, 0.1), 0.0, True, "came off it.$"),
        # a limit cycle up to the end; a linear run beyond what the amplifier gives
        (np.where(np.arange(4000) % 7 == 0, 1.0, 0.1), 0.0, False, "fails. Controller output, "),
        (np.where(np.arange(4000) == 9, 1.2, 0.1), 0.0, False, "fails. Controller output, "),
        (0.1 + 0 * _TIME, 9000.0, False, "fails. Magnet forces, "),
    ],
)
def test_a_run_has_one_verdict(output, force, passed, words):
    """Its rows, the headline of its page and the status that simulate ends with."""
    trace = at_limit(output, force)
    result = run_result(trace, MACHINE)
    assert result.passed == passed
    assert re.search(words, result.text)
    rows = record_verdicts(trace.record, MACHINE, stations(trace.record, MACHINE), trace)
    assert all(row.passed is not False for row in rows) == passed
    assert "0.0%" not in "".join(row.text for row in rows)
    for stable, outcome in ((False, "completed"), (True, "touchdown"), (False, "diverged")):
        lost = replace(trace, stable=stable, outcome=outcome)
        assert not run_result(lost, MACHINE).passed
        assert record_verdicts(lost.record, MACHINE, (), lost)[0].passed is False


def test_the_headline_of_a_page_is_what_simulate_ends_with():
    trace = at_limit(np.where(np.arange(4000) == 9, 1.0, 0.1))
    page = record_page(trace, MACHINE, date="2026-01-02")
    assert page.result == run_result(trace, MACHINE)
    assert page.passed
    lost = replace(trace, stable=False)
    assert record_page(lost, MACHINE, date="2026-01-02").result == run_result(lost, MACHINE)


@needs("browser")
@pytest.mark.parametrize("width", WIDTHS)
def test_the_first_screen_of_a_run(width, browser, tmp_path):
    page = record_page(at_limit(np.where(np.arange(4000) == 9, 1.0, 0.1)), MACHINE)
    seen = measure(browser, write(page, tmp_path / "run.html"), width)
    assert seen.verdict < seen.decides <= WIDTHS[width] and seen.words <= 1500 and not seen.wider


def test_the_page_of_a_trace():
    trace = Trace(whirling(), "run <b>", False, "touchdown", "touchdown at A_zeta")
    report = record_page(trace, MACHINE, date="2026-01-02")
    assert [section.title for section in report.sections] == [
        "Motion",
        "Currents and forces",
        "Everything else",
    ]
    titles = [figure.title for section in report.sections for figure in section.figures]
    assert titles[:4] == [
        "Distance from the middle of the bearing",
        "Orbits",
        "Waterfall: whirl over time and frequency",
        "The rotor in motion",
    ]
    assert (
        labels(report)["Outcome"].passed is False
        and report.result.text == "The run fails. Outcome, touchdown at A\u00a0ζ."
    )
    page = render(report)
    assert (
        "Record of a run: run &lt;b&gt;" in page
        and "run <b>" not in page
        and "nominal &lt;pressure&gt;" in page
    )
    assert any(figure.picture.frames for section in report.sections for figure in section.figures)
    assert "Plotly.addFrames" in page and "touchdown at A\u00a0ζ" in page
    assert len(page) < 7e6


def test_a_pressure_that_changes_is_told_from_end_to_end():
    still, values = whirling(), np.linspace(2.04e5, 4.08e5, whirling().values.shape[1])
    signals, units = (*still.signals, "p_seal"), (*still.units, "Pa")
    moved = replace(still, signals=signals, units=units, values=np.vstack([still.values, values]))
    told = [dict(record_page(record, MACHINE).facts)["Seal pressure"] for record in (still, moved)]
    assert " to " not in told[0] and told[1].startswith("2.04") and " to 4.08" in told[1]


def test_the_page_of_an_interrupted_measurement():
    record = whirling(kind="y", count=900)
    report = record_page(
        replace(record, notes=(("complete", "false"), ("operator", "J. Doe"))), MACHINE
    )
    assert (
        labels(report)["Record"].passed is None and "interrupted" in labels(report)["Record"].text
    )
    assert ("Operator", "J. Doe") in report.facts and ("Speed", "6\u202f000 rpm") in report.facts
    assert report.result.passed and "sensor A" in labels(report)["Touchdown"].text
    rows = report.sections[-1].tables[0].cells
    assert [cell.text for cell in rows[1]][:2] == ["y A ζ", "µm"]


def test_a_record_too_short_or_still_has_a_page():
    for record in (whirling(20), replace(whirling(), values=np.zeros_like(whirling().values))):
        assert "Orbits" in render(record_page(record, MACHINE))
