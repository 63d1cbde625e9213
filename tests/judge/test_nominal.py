"""The whole verification: verdicts on stable, unstable and sampled loops, completeness of the
tables, refusals.
"""

from __future__ import annotations

import importlib
import inspect
import re
from dataclasses import replace

import numpy as np
import pytest

from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import frequency_response
from ambrose.core.norms import hinf_norm
from ambrose.core.sampling import c2d
from ambrose.core.statespace import poles, select, static_gain
from ambrose.judge import nominal, robust
from ambrose.judge.loop_response import ALL_AXES
from ambrose.law.loop import closed_loop
from ambrose.machine.description import OperatingPoint, Operation, Requirements, Tolerance
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import reduce

TABLES = ("campbell", "loop_response", "margins", "unbalance", "nominal")


@pytest.fixture(scope="module")
def verdicts(rig_plants, rig_controller):
    return {label: nominal.check(plant, rig_controller) for label, plant in rig_plants.items()}


@pytest.mark.literature
def test_pid_on_the_rig_as_the_thesis_says(verdicts):
    """Lauridsen P5: stable at zero and nominal pressure, about 40 Hz resonance at nominal, unstable
    at +100 %.
    """
    assert verdicts["zero"].stable and verdicts["nominal"].stable and not verdicts["twice"].stable
    resonance = float(re.search(r"at ([\d.]+) Hz", verdicts["nominal"]["compliance.max"].detail)[1])
    assert resonance == pytest.approx(40, abs=3)
    assert "forward" in verdicts["twice"]["stability.abscissa"].detail


def test_an_unstable_loop_is_a_verdict(verdicts, rig_plants, rig_controller):
    found = verdicts["twice"]
    rightmost = max(
        poles(closed_loop(rig_plants["twice"], rig_controller)), key=lambda p: (p.real, p.imag)
    )
    assert (found.stable, found.passed, found.label) == (False, False, "twice")
    assert [check.name for check in found.checks] == ["stability.abscissa"]
    assert [curve.name for curve in found.curves] == ["poles"]
    check = found.checks[0]
    assert check.value == pytest.approx(rightmost.real, rel=1e-6)
    assert f"{rightmost.imag / (2 * np.pi):.4g} Hz" in check.detail


def test_without_control_every_unstable_pole_is_named(rig_plants):
    plant = rig_plants["zero"]
    found = nominal.check(plant, static_gain(np.zeros((4, 4))))
    own = poles(plant.system)
    assert not found.stable
    assert (
        found["stability.abscissa"].detail.count("pole at")
        == (own[own.imag >= 0].real >= 0).sum()
        == 2
    )


def test_reported_peaks_are_the_true_maxima(verdicts, rig_plants, rig_controller):
    """A brute-force grid of 4,000 points about each reported peak finds nothing above it, and comes
    within 1e-5 of it.
    """
    closed = closed_loop(rig_plants["nominal"], rig_controller)
    axes = rig_plants["nominal"].axes
    for name, inputs, outputs in (
        ("sensitivity.output", "d", "y"),
        ("control", "r", "u"),
        ("compliance", "f", "q"),
    ):
        check = verdicts["nominal"][f"{name}.max"]
        at = 2 * np.pi * float(re.search(r"at ([\d.e+]+) Hz", check.detail)[1])
        omega = np.concatenate(
            [np.linspace(0.97, 1.03, 3001) * at, np.geomspace(3.2, 1.25e4, 1000)]
        )
        part = select(closed, [f"{inputs}_{a}" for a in axes], [f"{outputs}_{a}" for a in axes])
        largest = frequency_response(part, omega).max_singular_value().max()
        assert check.value == pytest.approx(largest, rel=1e-5)
        assert largest <= check.value * (1 + 1e-6)


def test_peaks_equal_the_exact_norms(rig_plants, rig_controller):
    """H-infinity norms of the closed loop in state space, by a Hamiltonian method without a grid,
    on 3 bending modes.
    """
    plant = reduce(rig_plants["nominal"], 3)
    found, closed = nominal.check(plant, rig_controller), closed_loop(plant, rig_controller)
    for name, inputs, outputs in (
        ("sensitivity.output", "d", "y"),
        ("complementary", "r", "y"),
        ("compliance", "f", "q"),
    ):
        part = select(
            closed, [f"{inputs}_{a}" for a in plant.axes], [f"{outputs}_{a}" for a in plant.axes]
        )
        assert found[f"{name}.max"].value == pytest.approx(hinf_norm(part, 1e-9).value, rel=1e-8), (
            name
        )


def test_an_unstable_speed_inside_the_range_is_found(rig, rig_controller):
    """The seal is switched on beyond 60 Hz only: the nominal point is fine, the range is not."""
    points = rig.operation.points
    machine = replace(rig, operation=Operation((points[1],), (0.0, 2 * np.pi * 100)))

    def plant_at(speed):
        return assemble(machine, replace(points[2 if speed > 2 * np.pi * 60 else 1], speed=speed))

    found = nominal.check(assemble(machine), rig_controller, plant_at=plant_at)
    check = found["stability.speeds"]
    assert found.stable and not found.passed and check.passed is False
    assert check.detail.endswith("unstable from 60 to 100 Hz")
    assert "unbalance.assembled_0p" not in {item.name for item in found.checks}


def test_the_grid_does_not_change_the_verdict(verdicts, rig_plants, rig_controller):
    other = nominal.check(
        rig_plants["nominal"], rig_controller, omega=np.geomspace(np.pi, 2 * np.pi * 1e4, 150)
    )
    for check in verdicts["nominal"].checks:
        if not check.name.startswith("impulse"):
            assert other[check.name].value == pytest.approx(check.value, rel=2e-5), check.name


def pattern(name):
    name = re.sub(r"\.[AB]_(zeta|eta)$", ".<axis>", name)
    return re.sub(r"^(margin\.\w+)\.(output|input)", r"\1.<where>", name)


def documented():
    found = set()
    for module in TABLES:
        text = inspect.getsource(importlib.import_module(f"ambrose.judge.{module}"))
        for row in re.findall(r"^(?:# )?\| ([a-z][^|]*)\|", text, re.MULTILINE):
            names = [part.strip() for part in row.split(",")]
            found.add(names[0])
            found |= {names[0].replace(".<axis>", suffix) for suffix in names[1:]}
    # the rows of the axis along the shaft: tests/thrust
    return {name for name in found if name != "check" and not name.startswith("axial.")}


def test_every_check_stands_in_a_table_and_every_table_row_exists(rig, rig_controller):
    wanted = Requirements(control_gain=1e5, roll_off=2e4, running_speeds=(200.0, 600.0))
    wanted = replace(wanted, damping_above=1e-4)
    coil = replace(rig.amplifier, max_voltage=100.0, inductance=0.02)
    operation = Operation((OperatingPoint(speed=300.0),), (0.0, 600.0))
    machine = replace(rig, operation=operation, requirements=wanted, amplifier=coil)
    machine = replace(machine, rotating_share=1.0, modal_damping=0.02)
    plant = assemble(machine)
    found = nominal.check(
        plant, rig_controller, plant_at=lambda speed: assemble(machine, OperatingPoint(speed=speed))
    )
    assert {pattern(check.name) for check in found.checks} == documented()
    names = [check.name for check in found.checks]
    assert len(set(names)) == len(names)
    assert found.curve("unbalance.assembled_0p").x[-1] == 600.0


def test_curves_are_well_formed(verdicts):
    for verdict in verdicts.values():
        for curve in verdict.curves:
            assert curve.y.shape == (len(curve.labels), len(curve.x)), curve.name
            assert np.isfinite(curve.y).all() and np.isfinite(curve.x).all()
            assert curve.kind in {"frequency", "speed", "time", "poles"}
            if curve.kind != "poles":
                assert (np.diff(curve.x) > 0).all()
    limits = dict(verdicts["nominal"].curve("sensitivity.output").limits)
    assert limits == {f"zone {pair} of an axis": v for pair, v in _BORDERS.items()}


_BORDERS = {"A/B": 3.0, "B/C": 4.0, "C/D": 5.0}


def test_zones_of_the_sensitivity_are_of_axes_alone(rig, verdicts):
    """ISO 14839-3 judges axes: what is of all axes together has no letter and no border."""
    for verdict in verdicts.values():
        zoned = {check.name for check in verdict.checks if check.zone is not None}
        axes = {f"sensitivity.{side}.{axis}" for side in ("output", "input") for axis in rig.axes}
        assert zoned <= axes | {"unbalance.clearance"}
        if verdict.stable:
            assert axes <= zoned
        together = [curve for curve in verdict.curves if set(curve.labels) == {ALL_AXES}]
        assert not [line for curve in together for line in curve.limits if "zone" in line[0]]


def test_over_tolerances_no_singular_value_has_a_zone(rig, rig_controller):
    wanted = Requirements(sensitivity_peak=2.5)
    tolerance = Tolerance("bearing.A.negative_stiffness", relative=0.01)
    machine = replace(rig, tolerances=(tolerance,), requirements=wanted)
    plant = reduce(assemble(machine, OperatingPoint()), 0)
    found = robust.check(plant, rig_controller, omega=np.geomspace(1, 1e4, 20))
    assert found.curves
    assert not [check.zone for check in found.checks if check.zone is not None]
    assert {line for curve in found.curves for line in curve.limits} == {("required", 2.5)}


def test_values_are_plain_numbers_and_verdicts_plain_booleans(verdicts):
    for check in verdicts["nominal"].checks:
        assert type(check.value) is float and not np.isnan(check.value), check.name
        assert check.passed in {True, False, None} and not isinstance(check.passed, np.bool_), (
            check.name
        )
        assert (check.limit is None) == (check.passed is None), check.name
        assert check.unit and check.title


def test_requirements_override_the_machines(rig_plants, rig_controller):
    strict = Requirements(
        sensitivity_peak=2.0, gain_margin=3.0, settling_time=0.01, balance_speed=3000.0
    )
    found = nominal.check(rig_plants["zero"], rig_controller, strict)
    failed = {check.name for check in found.checks if check.passed is False}
    assert {"sensitivity.output.max", "margin.gain.output.A_zeta", "impulse.settling"} <= failed
    assert not found.passed
    assert found["unbalance.orbit_0p"].limit is None
    assert dict(found.curve("sensitivity.output").limits)["required"] == 2.0


def test_a_fast_sampled_controller_comes_close_to_the_continuous_one(
    verdicts, rig_plants, rig_controller
):
    found = nominal.check(rig_plants["zero"], c2d(rig_controller, 2e-5, "tustin"))
    assert found.stable and "Sampled controller" in found.notes[0]
    for name in (
        "sensitivity.output.max",
        "compliance.max",
        "margin.phase.output.A_zeta",
        "unbalance.orbit_0p",
    ):
        assert found[name].value == pytest.approx(verdicts["zero"][name].value, rel=2e-2), name


def test_a_slow_sampled_controller_is_unstable_and_said_so(rig_plants, rig_controller):
    found = nominal.check(rig_plants["zero"], c2d(rig_controller, 4e-3, "tustin"))
    assert not found.stable


def test_a_sampled_grid_ends_at_nyquist(rig_plants, rig_controller):
    found = nominal.check(rig_plants["zero"], c2d(rig_controller, 2e-4, "tustin"))
    assert found.curve("sensitivity.output").x[-1] == pytest.approx(np.pi / 2e-4)


def test_spillover_is_seen_on_the_full_plant_only(rig, rig_controller):
    """Without the seal's damping the amplifier's lag makes the derivative action drive a lightly
    damped bending mode.
    """
    plant = assemble(replace(rig, seals=(), modal_damping=1e-3), rig.operation.points[1])
    rigid = nominal.check(reduce(plant, 0), rig_controller)
    assert rigid.stable and "0 bending modes" in rigid.notes[0]
    full = nominal.check(plant, rig_controller)
    assert not full.stable
    hertz = float(re.search(r"at ([\d.]+) Hz", full["stability.abscissa"].detail)[1])
    assert hertz == pytest.approx(550, rel=0.1)


def test_without_a_balancing_speed_a_note_says_what_is_missing(single_masses, pd_controller):
    found = nominal.check(single_masses(), pd_controller(5000.0, 8.0, 2e-4))
    assert any("No unbalance response" in note for note in found.notes)
    assert "unbalance.orbit_0p" not in {check.name for check in found.checks}


def test_progress_rises_to_one(rig_plants, rig_controller):
    told = []
    nominal.check(
        rig_plants["zero"],
        rig_controller,
        progress=lambda stage, fraction: told.append((stage, fraction)),
    )
    fractions = [fraction for _, fraction in told]
    assert fractions == sorted(fractions) and fractions[-1] == 1.0
    assert all(stage for stage, _ in told)


def test_refusals(rig_plants, rig_controller):
    plant = rig_plants["zero"]
    with pytest.raises(InvalidInput, match="controller's size"):
        nominal.check(plant, static_gain(np.eye(3)))
    for grid in ([1.0], [2.0, 1.0], [0.0, 1.0], [-1.0, 1.0]):
        with pytest.raises(InvalidInput, match="ascending"):
            nominal.check(plant, rig_controller, omega=grid)
    with pytest.raises(InvalidInput, match="finite"):
        nominal.check(plant, rig_controller, omega=[1.0, np.nan])
