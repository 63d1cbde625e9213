"""Seal coefficients from exact phasors, noisy phasors and linear records of known seals; the
machine that results.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from ambrose import load_machine
from ambrose.core.checks import InvalidInput, NumericalFailure
from ambrose.core.frequency import frequency_response
from ambrose.core.response import simulate
from ambrose.core.sampling import c2d
from ambrose.core.statespace import select
from ambrose.identification.frf import find_steps, phasors, steps_of
from ambrose.identification.seal import by_frequency as stepped_sine, pipeline as time_domain
from ambrose.identification.seal.by_pressure import (
    ENTRIES as ORDER,
    SealFit,
    averaged,
    line,
    update_seal,
)
from ambrose.law.loop import closed_loop
from ambrose.law.pid import pid_controller
from ambrose.machine.description import OperatingPoint, Tolerance
from ambrose.machine.file.toml import dumps_machine, loads_machine
from ambrose.model.assemble import assemble
from ambrose.model.effects import seal
from ambrose.model.uncertainty import free_mode_reduction, perturbed, uncertain
from ambrose.record.record import Record
from ambrose.rig import virtual_rig
from ambrose.rig.scenario import Scenario, SteppedSine
from coarse import coarse

HZ = 2 * np.pi
DT = 1e-4
NOMINAL = 2.04e5
ENTRIES = {
    "K_xx": 0.5e6,
    "k_xy": 1.2e6,
    "k_yx": 1.7e6,
    "K_yy": 0.3e6,
    "C_xx": 1500.0,
    "c_xy": -900.0,
    "c_yx": -1300.0,
    "C_yy": 2100.0,
}


@cache
def rig():
    """The rig with less direct stiffness in its seal, which does nothing without pressure."""
    machine = coarse("seal-rig")
    return replace(machine, seals=(replace(machine.seals[0], K=0.1e6),))


def true(pressure):
    c = seal.coefficients(rig().seals[0], pressure)
    return np.array([c.K, c.k, c.C, c.c])


@cache
def law(machine):
    return c2d(pid_controller(machine.controller, machine), DT, "tustin", delay=DT)


@cache
def steady(pressure, frequency, axis, entries=False, speed=0.0):
    """Phasors of y, i, u, e of the sampled loop around the full plant for 0.1 A on both bearings
    along ``axis``.
    """
    plant = assemble(rig(), OperatingPoint(seal_pressure=pressure, speed=speed))
    if entries:
        own = dict(zip(("K", "k", "C", "c"), true(pressure), strict=True))
        moves = {f"seal.center.{name}": value - own[name[0]] for name, value in ENTRIES.items()}
        tolerances = [Tolerance(path, absolute=abs(move)) for path, move in moves.items()]
        plant = perturbed(
            plant, {path: float(np.sign(move)) for path, move in moves.items()}, tolerances
        )
    loop = closed_loop(plant, law(rig()))
    e = [f"e_{a}" for a in plant.axes]
    names = [f"{kind}_{a}" for kind in "yiu" for a in plant.axes]
    drive = np.array([0.1 * a.endswith(axis) for a in plant.axes])
    values = frequency_response(select(loop, e, names), [frequency]).values[0] @ drive
    return (*names, *e), np.concatenate([values, drive])


def sines(
    pressure,
    axis,
    frequencies=(20.0, 60.0),
    dwell=0.8,
    noise=0.0,
    seed=0,
    entries=False,
    keep="yiue",
    speed=0.0,
):
    """A record of steady sines, no transients; noise [m] on the displacements."""
    parts = []
    t = np.arange(round(dwell / DT)) * DT
    for f in frequencies:
        names, values = steady(pressure, f * HZ, axis, entries, speed)
        parts.append(np.real(values[:, None] * np.exp(1j * f * HZ * t)))
    x = np.hstack(parts)
    rng = np.random.default_rng(seed)
    x[:4] += noise * rng.standard_normal((4, x.shape[1]))
    kept = [i for i, name in enumerate(names) if name[0] in keep]
    units = ["m" if name[0] == "y" else "A" for name in names]
    point = OperatingPoint(seal_pressure=pressure, speed=speed)
    return Record(
        "seal-rig",
        1 / DT,
        tuple(names[i] for i in kept),
        tuple(units[i] for i in kept),
        x[kept],
        point,
    )


STEPS = steps_of([20 * HZ, 60 * HZ], 0.8)


@pytest.mark.parametrize("keep", ["yiue", "yue", "yi"])
def test_the_coefficients_come_out_of_exact_phasors(keep):
    """Measured currents, or commanded ones through amplifier and hold: both give the truth to 1e-4
    of k.
    """
    records = [sines(NOMINAL / 2, axis, keep=keep) for axis in ("zeta", "eta")]
    fit = stepped_sine.identify(rig(), records, steps=STEPS, reference=False)
    np.testing.assert_allclose(fit.frequency, [20 * HZ, 60 * HZ])
    scale = np.array([1.6e6, 1.6e6, 1.6e6 / 380, 1.6e6 / 380])
    assert np.abs((fit.values - true(NOMINAL / 2)) / scale).max() < 2e-4
    assert fit.deviations.shape == (2, 4)


def test_a_turning_rotor_keeps_its_gyroscopic_moments_to_itself():
    """At 300 Hz of speed: with the record's speed in the model the truth comes out, without it the
    cross terms are wrong.
    """
    records = [sines(NOMINAL / 2, axis, speed=300 * HZ) for axis in ("zeta", "eta")]
    standing = [replace(r, point=replace(r.point, speed=0.0)) for r in records]
    right, wrong = (
        stepped_sine.identify(rig(), group, steps=STEPS, reference=False)
        for group in (records, standing)
    )
    scale = np.array([1.6e6, 1.6e6, 4e3, 4e3])
    assert np.abs((right.values - true(NOMINAL / 2)) / scale).max() < 2e-4
    assert np.abs((wrong.values - true(NOMINAL / 2)) / scale).max() > 2e-3


def test_eight_independent_entries_need_both_axes():
    records = [sines(NOMINAL, axis, entries=True) for axis in ("zeta", "eta")]
    fit = stepped_sine.identify(rig(), records, steps=STEPS, reference=False)
    want = np.array([ENTRIES[name] for name in ORDER])
    assert np.abs((fit.entries - want) / np.repeat([1.7e6, 1.7e6 / 380], 4)).max() < 1e-3
    one = stepped_sine.identify(rig(), records[:1], steps=STEPS, reference=False)
    assert np.isnan(one.entries).all()
    assert np.isfinite(one.values).all()
    with pytest.raises(InvalidInput, match="excite along both axes"):
        line(one, "k_xy")


def test_the_reference_without_pressure_takes_off_what_the_model_lacks():
    """Bearings 3 % off in K_s and 1 % in K_i: the coefficients are wrong without, right with the
    reference.
    """
    wrong = replace(
        rig(),
        bearings=tuple(
            replace(
                item,
                negative_stiffness=tuple(1.03 * k for k in item.negative_stiffness),
                force_per_current=tuple(1.01 * k for k in item.force_per_current),
            )
            for item in rig().bearings
        ),
    )
    records = [sines(p, axis) for p in (0.0, NOMINAL / 2) for axis in ("zeta", "eta")]
    raw = stepped_sine.identify(wrong, records[2:], steps=STEPS, reference=False)
    fit = stepped_sine.identify(wrong, records, steps=STEPS)
    error = [np.abs(item.values - true(NOMINAL / 2)) for item in (raw, fit)]
    assert error[0][:, 0].min() > 20e3
    assert error[1][:, 0].max() < 5e3
    assert np.abs(fit.systematic[:, 0]).min() > 20e3
    assert error[1][:, 1].max() < 0.015 * true(NOMINAL / 2)[1]
    assert "reference" in fit.method
    np.testing.assert_allclose(fit.pressures, [NOMINAL / 2])
    with pytest.raises(InvalidInput, match="without pressure"):
        stepped_sine.identify(wrong, records[2:], steps=STEPS)
    with pytest.raises(InvalidInput, match="add records under pressure"):
        stepped_sine.identify(wrong, records[:2], steps=STEPS)


@pytest.mark.study
def test_predicted_deviations_against_monte_carlo():
    """0.3 um of noise, 40 runs of three frequencies, with a reference: errors over predictions are
    1 within 20 %.
    """
    frequencies = (20.0, 50.0, 60.0)
    errors = []
    predicted = []
    for seed in range(40):
        records = [
            sines(p, axis, frequencies, 0.6, 3e-7, 4 * seed + 2 * i + j)
            for i, p in enumerate((0.0, NOMINAL / 2))
            for j, axis in enumerate(("zeta", "eta"))
        ]
        fit = stepped_sine.identify(
            rig(), records, steps=steps_of([f * HZ for f in frequencies], 0.6), settle=0.1
        )
        wide = true(NOMINAL / 2)[[0, 1, 1, 0, 2, 3, 3, 2]]
        errors.append(np.hstack([fit.values - true(NOMINAL / 2), fit.entries - wide]))
        predicted.append(np.hstack([fit.deviations, fit.entry_deviations]))
    # per frequency and coefficient
    ratio = np.mean(np.square(errors), axis=0) / np.mean(np.square(predicted), axis=0)
    np.testing.assert_allclose(np.sqrt(ratio.mean(axis=0)), 1, atol=0.2)


def test_steps_are_found_in_a_record_with_a_transient_and_noise():
    machine = rig()
    item = SteppedSine("e_A_zeta", 0.1, (10 * HZ, 35.5 * HZ, 90 * HZ), 0.8, 0.2)
    trace = virtual_rig.run(
        machine,
        pid_controller(machine.controller, machine),
        Scenario("steps", 2.7, stepped_sines=(item,)),
        point=OperatingPoint(seal_pressure=0.5e5),
    )
    found = find_steps(trace.record)
    np.testing.assert_allclose([s.frequency / HZ for s in found], [10, 35.5, 90], rtol=1e-4)
    np.testing.assert_allclose([s.start for s in found], [0.2, 1.0, 1.8], atol=0.12)
    one = phasors(trace.record, found[1], ["e_A_zeta", "y_A_zeta"])
    assert np.abs(one.mean[0]) == pytest.approx(0.1, rel=1e-4)
    assert len(one.blocks) > 10
    assert np.abs(one.blocks[:, 1] / one.mean[1] - 1).max() < 1e-3  # steady
    slow, early = (
        phasors(trace.record, found[0], ["y_A_zeta"], settle=settle) for settle in (0.4, 0.0)
    )
    assert np.abs(slow.blocks[:, 0] / slow.mean - 1).max() < 1e-3
    assert np.abs(early.blocks[0, 0] / slow.mean - 1) > 1e-2  # the transient is worth discarding


def test_rows_that_unbalance_or_noise_spoils_are_named():
    turning = [
        replace(r, point=replace(r.point, speed=20.3 * HZ))
        for r in (sines(NOMINAL / 2, a) for a in ("zeta", "eta"))
    ]
    fit = stepped_sine.identify(rig(), turning, steps=STEPS, reference=False)
    assert len(fit.warnings) == 1
    assert "20 Hz lies at the speed of 20.3 Hz" in fit.warnings[0].what
    loud = [
        sines(NOMINAL / 20, axis, (180.0,), 0.5, 3e-6, seed)
        for seed, axis in enumerate(("zeta", "eta"))
    ]
    noisy = stepped_sine.identify(
        rig(), loud, steps=steps_of([180 * HZ], 0.5), settle=0.1, reference=False
    )
    assert "drowns in noise" in noisy.warnings[0].evidence
    quiet = stepped_sine.identify(
        rig(), [sines(NOMINAL / 2, "zeta", noise=1e-7)], steps=STEPS, reference=False
    )
    assert quiet.warnings == ()


def test_both_directions_one_after_the_other_in_one_record():
    """The bundled scenario's form: zeta, then eta, on both bearings; all four excitations are seen,
    each step once.
    """
    parts = [sines(NOMINAL / 2, axis) for axis in ("zeta", "eta")]
    joined = replace(parts[0], values=np.hstack([part.values for part in parts]))
    found = find_steps(joined)
    np.testing.assert_allclose([s.frequency / HZ for s in found], [20, 60, 20, 60], rtol=1e-4)
    np.testing.assert_allclose([s.start for s in found], [0, 0.8, 1.6, 2.4], atol=0.06)
    fit = stepped_sine.identify(rig(), [joined], reference=False)
    assert len(fit) == 2
    assert np.isfinite(fit.entries).all()
    assert np.abs((fit.values - true(NOMINAL / 2)) / [1.6e6, 1.6e6, 4e3, 4e3]).max() < 1e-3


def test_whirling_in_a_circle_tells_nothing():
    """Circular forward motion at the seal: K and c, k and C have one and the same effect. A seal
    that is not there yet.
    """
    machine = replace(
        rig(),
        couplings=(),
        bearings=tuple(
            replace(b, negative_stiffness=(1e6, 1e6), force_per_current=(150.0, 150.0))
            for b in rig().bearings
        ),
    )
    plant = assemble(machine, OperatingPoint(seal_pressure=0.0))
    loop = closed_loop(plant, law(machine))
    e, shown = [f"e_{a}" for a in plant.axes], [f"{kind}_{a}" for kind in "yi" for a in plant.axes]
    response = frequency_response(select(loop, e, shown), [50 * HZ]).values[0]
    t = np.arange(8000) * DT

    def made(drive):
        values = np.real((response @ drive)[:, None] * np.exp(1j * 50 * HZ * t))
        return Record(
            "seal-rig", 1 / DT, tuple(shown), ("m",) * 4 + ("A",) * 4, values, OperatingPoint()
        )

    options = {"steps": steps_of([50 * HZ], 0.8), "reference": False}
    with pytest.raises(NumericalFailure, match="whirls in a circle"):
        stepped_sine.identify(machine, [made(np.array([0.1, -0.1j, 0.1, -0.1j]))], **options)
    along = stepped_sine.identify(machine, [made(np.array([0.1, 0.0, 0.1, 0.0]))], **options)
    assert np.abs(along.cosine[0] - np.eye(4)).max() < 1e-6  # motion along a line: uncorrelated
    nearly = stepped_sine.identify(machine, [made(np.array([0.1, -0.09j, 0.1, -0.09j]))], **options)
    # 2 a b/(a^2 + b^2) of the ellipse
    assert nearly.cosine[0][0, 3] == pytest.approx(2 * 0.9 / 1.81, abs=1e-6)


def test_what_cannot_be_measured_is_refused():
    good = sines(NOMINAL / 2, "zeta")
    machine = rig()
    with pytest.raises(InvalidInput, match="no record"):
        stepped_sine.identify(machine, [])
    with pytest.raises(InvalidInput, match="machine of record 1"):
        stepped_sine.identify(machine, [replace(good, machine="other")])
    with pytest.raises(InvalidInput, match="one of the machine's seals: center"):
        stepped_sine.identify(machine, [good], seal="left")
    with pytest.raises(InvalidInput, match="dwell longer"):
        stepped_sine.identify(machine, [good], steps=STEPS, settle=0.7, reference=False)
    with pytest.raises(InvalidInput, match="steps of this record"):
        stepped_sine.identify(
            machine, [good], steps=steps_of([20 * HZ], 0.8, start=1.5), reference=False
        )
    with pytest.raises(InvalidInput, match="measured or commanded"):
        stepped_sine.identify(machine, [good], steps=STEPS, currents="guessed", reference=False)
    with pytest.raises(InvalidInput, match="no excitation"):
        find_steps(good.select("y_A_zeta"))
    with pytest.raises(InvalidInput, match="steady sine"):
        find_steps(replace(good, values=np.zeros_like(good.values)))


@cache
def impulses(pressure, seed, noise=2e-7):
    """Ten impulses of P5 on both bearings along zeta, and ten along eta, on the linear loop."""
    plant = free_mode_reduction(assemble(rig(), OperatingPoint(seal_pressure=pressure)), 1)
    loop = closed_loop(plant, law(rig()))
    e, y = ([f"{kind}_{a}" for a in plant.axes] for kind in "ey")
    drive = np.zeros((4, 20000))
    for i in range(10):
        for row in ((0, 2), (1, 3))[i % 2]:
            begin = 500 + 1900 * i
            drive[row, begin : begin + 100] += 0.05
    values = simulate(select(loop, e, y), drive) + noise * np.random.default_rng(
        seed
    ).standard_normal((4, 20000))
    return Record(
        "seal-rig",
        1 / DT,
        (*y, *e),
        ("m",) * 4 + ("A",) * 4,
        np.vstack([values, drive]),
        plant.point,
    )


PRESSURES = (0.5e5, 0.95e5, 1.4e5, 1.9e5)


def test_impulses_pressure_by_pressure_and_their_line():
    records = [impulses(p, i) for i, p in enumerate(PRESSURES)]
    controller = pid_controller(rig().controller, rig())
    fit = time_domain.identify(rig(), records, controller, start={"seal.center.k": 1e6})
    error = np.abs(fit.values - [true(p) for p in PRESSURES]) / fit.deviations
    assert error.max() < 4
    assert np.sqrt(np.mean(error**2)) < 1.6
    assert np.all(fit.deviations[:, 1] < 0.02 * true(1e5)[1])
    k_line = line(fit, "k")
    assert k_line.slope * NOMINAL == pytest.approx(true(NOMINAL)[1], rel=0.02)
    assert abs(k_line.at(NOMINAL) - true(NOMINAL)[1]) < k_line.confidence(NOMINAL, 0.99)
    assert k_line.slope_probability < 1e-4


def test_all_entries_a_row_per_record_and_fewer_coefficients():
    controller = pid_controller(rig().controller, rig())
    repeats = [impulses(0.95e5, seed) for seed in (11, 12)]
    fit = time_domain.identify(rig(), repeats, controller, together=False)
    assert len(fit) == 2
    assert np.all(fit.pressure == 0.95e5)
    both = time_domain.identify(rig(), repeats, controller)
    assert len(both) == 1
    assert np.all(both.deviations[0] < 0.85 * fit.deviations.min(axis=0))
    eight = time_domain.identify(rig(), repeats, controller, entries=True)
    want = np.array([true(0.95e5)["KkCc".index(name[0])] for name in ORDER])
    assert np.all(np.abs(eight.entries[0] - want) < 4 * eight.entry_deviations[0])
    few = time_domain.identify(rig(), repeats[:1], controller, coefficients=("k",))
    assert few.deviations[0, 0] == 0
    assert few.values[0, 0] == true(0.95e5)[0]
    assert abs(few.values[0, 1] - true(0.95e5)[1]) < 4 * few.deviations[0, 1]
    with pytest.raises(InvalidInput, match="coefficients"):
        time_domain.identify(rig(), repeats, controller, coefficients=("M",))
    with pytest.raises(InvalidInput, match="no record"):
        time_domain.identify(rig(), [], controller)


def measured(pressures=(0.7e5, 1.0e5, 1.2e5, 4.2e5), frequencies=(20 * HZ, 60 * HZ)):
    """A fit as stepped sines leave it, with the truth as its values and one percent deviation."""
    rows = [(p, w) for p in pressures for w in frequencies]
    values = np.array([true(p) for p, _ in rows])
    deviations = np.abs(values) * 0.01 + 1.0
    wide = np.array([0, 1, 1, 0, 2, 3, 3, 2])
    eye = np.tile(np.eye(4), (len(rows), 1, 1))
    p, w = (np.array(part) for part in zip(*rows, strict=True))
    return SealFit(
        "seal-rig",
        "center",
        p,
        w,
        values,
        deviations,
        values[:, wide],
        deviations[:, wide],
        eye,
        eye,
        np.zeros_like(values),
        "made up",
    )


@pytest.mark.parametrize("form", ["line", "table", "frequency"])
def test_the_machine_that_results_has_the_coefficients_and_survives_its_file(form):
    fit = measured((0.0, 0.7e5, 1.2e5, 4.2e5))
    made = update_seal(rig(), fit, form)
    again = loads_machine(dumps_machine(made))
    assert again.seals == made.seals
    assert again.tolerances == made.tolerances
    for pressure in (0.0, 0.7e5, 2.0e5):
        found = seal.coefficients(made.seals[0], pressure, 0.0, 40 * HZ)
        np.testing.assert_allclose(
            [found.K, found.k, found.C, found.c], true(pressure), rtol=1e-6, atol=1e-3
        )
    widths = {item.parameter: item for item in made.tolerances}
    if form == "line":  # moves with the pressure as one; beside it what the fit leaves open
        assert widths["seal.center.pressure"].relative == 1.0
        assert 0 < widths["seal.center.k"].absolute < 0.1 * true(NOMINAL)[1]
    else:  # bends in general: each coefficient takes its change over the range of operation, zero to twice the nominal pressure
        assert "seal.center.pressure" not in widths
        assert widths["seal.center.k"].absolute == pytest.approx(true(NOMINAL)[1], rel=0.1)
    assert widths["seal.center.C"].absolute > 0
    assemble(made, replace(made.operation.nominal, whirl_frequency=40 * HZ))


def test_what_was_measured_replaces_what_was_computed_from_geometry():
    machine = load_machine("turboexpander")
    fit = replace(measured((0.0, 2.0e6, 4.0e6)), machine=machine.name, seal=machine.seals[0].name)
    made = update_seal(machine, fit)
    assert made.seals[0].geometry is None
    assert seal.coefficients(made.seals[0], 2.0e6).k == pytest.approx(true(2.0e6)[1], rel=1e-6)
    assert loads_machine(dumps_machine(made)).seals == made.seals
    before, after = ([item.parameter for item in one.tolerances] for one in (machine, made))
    assert before == after  # the eight entries keep their tolerances of their own
    assert len(uncertain(assemble(made)).blocks) == len(before)


def test_a_table_must_reach_the_operating_points():
    with pytest.raises(InvalidInput, match='take the form "line"'):
        update_seal(rig(), measured((0.7e5, 1.0e5, 1.2e5)), "table")
    with pytest.raises(InvalidInput, match="form"):
        update_seal(rig(), measured(), "curve")
    with pytest.raises(InvalidInput, match="machine of the fit"):
        update_seal(replace(rig(), name="other"), measured())
    with pytest.raises(InvalidInput, match="full grid"):
        update_seal(rig(), measured().rows(np.arange(7)), "frequency")


def test_means_over_frequency_and_rows():
    fit = measured()
    scattered = replace(fit, values=fit.values * (1 + 0.1 * np.resize([1, -1], len(fit)))[:, None])
    mean = averaged(scattered)
    assert len(mean) == 4
    np.testing.assert_allclose(mean.values, [true(p) for p in fit.pressures], rtol=0.05)
    assert np.all(mean.deviations > 5 * averaged(fit).deviations)  # scatter counts
    assert len(averaged(fit, up_to=30 * HZ)) == 4
    with pytest.raises(InvalidInput, match="up_to"):
        averaged(fit, up_to=1.0)
    with pytest.raises(InvalidInput, match="pressure"):
        fit.at(9e5)
    with pytest.raises(InvalidInput, match="coefficient"):
        fit.column("q")
    assert np.all(fit.column("k_yx")[0] == fit.column("k")[0])
