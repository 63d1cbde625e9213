"""Magnets that carry a rotor are nonlinear: on the rig, standing and turning, the values are found
as without.
"""

from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from benchmarks import waveforms

from ambrose import identify, load_machine
from ambrose.core.response import simulate
from ambrose.core.sampling import c2d
from ambrose.core.statespace import select
from ambrose.identification.output_error import closed_loop
from ambrose.identification.output_error.magnetic_force import (
    _LOAD,
    _ODD,
    _further_terms,
    _joined,
    _least_squares_step,
    _odd_terms,
    _side_nonlinear_force,
    _terms,
    _turning_motion,
    magnets_with,
    nonlinear_responses,
)
from ambrose.identification.output_error.problem import FitOptions, build_experiment
from ambrose.identification.output_error.statistics import TurningWave
from ambrose.law.loop import closed_loop as looped, match_controller
from ambrose.law.pid import pid_controller
from ambrose.machine.description import OperatingPoint
from ambrose.model.assemble import assemble
from ambrose.model.axial import core_lags, loaded, sides
from ambrose.model.effects import magnet
from ambrose.model.effects.magnet import slopes
from ambrose.model.static_load import operating_magnets
from ambrose.model.uncertainty import free_mode_reduction
from ambrose.record.record import Record
from ambrose.rig import virtual_rig
from ambrose.rig.scenario import Unbalance, load_scenario
from coarse import coarse

UNKNOWN = ("bearing.*.force_per_current.*", "bearing.*.negative_stiffness.*")
RIG = coarse("seal-rig")
LAW = pid_controller(RIG.controller, RIG)
EXPANDER = Path(__file__).parents[3] / "examples" / "expander-five-axes.toml"


@cache
def record(speed, weight=True):
    machine = RIG if weight else replace(RIG, gravity_direction=None)
    unbalance = (Unbalance("center", grade=6.3e-3, grade_speed=3141.0),) if speed else ()
    scenario = replace(load_scenario("prbs"), speed=speed, duration=1.2, unbalances=unbalance)
    whole = virtual_rig.run(machine, LAW, scenario).record
    seen = whole.select([name for name in whole.signals if name[:2] in {"y_", "e_"}])
    noise = 5e-8 * np.random.default_rng(1).standard_normal(seen.values.shape)
    noise[[name[0] == "e" for name in seen.signals]] = 0.0
    return replace(seen, values=seen.values + noise), {
        axis: float(whole[f"u_{axis}"].mean()) for axis in machine.axes
    }


def errors(result, loads):
    """Relative, against the coefficients of the nonlinear magnets at their loads."""
    magnets = operating_magnets(RIG)
    at = [
        slopes(own.parameters, (loads[f"{b.name}_zeta"], loads[f"{b.name}_eta"]))
        for b, own in zip(RIG.bearings, magnets, strict=True)
    ]
    truth = [
        value
        for name in ("force_per_current", "negative_stiffness")
        for item in at
        for value in getattr(item, name)
    ]
    return result.values / np.array(truth) - 1


@pytest.mark.usefixtures("values_alone")
@pytest.mark.parametrize("speed", [pytest.param(0.0, marks=pytest.mark.study), 314.0])
def test_values_are_those_of_small_motion_and_loads_are_found(speed):
    """No current is recorded: the quadratic terms alone tell the loads, within a tenth."""
    data, loads = record(speed)
    linear = closed_loop.fit(build_experiment(RIG, data, LAW, UNKNOWN, FitOptions()))
    found = identify(RIG, data, LAW, unknown=UNKNOWN)
    assert (
        np.abs(errors(linear, loads)).max() > 0.01
        and np.abs(errors(found.result, loads)).max() < 0.004
    )
    assert (
        found.passed
        and found.magnets.explains > 0.5
        and found.magnets.cubic == pytest.approx(1, abs=0.3)
    )
    assert list(found.magnets.loads.values()) == pytest.approx(list(loads.values()), rel=0.12)
    assert (
        np.abs(errors(found.result, loads))
        < 3 * found.result.standard_deviations / found.result.values
    ).all()
    assert found.remarks[0] == found.magnets.words and "static loads of about" in found.remarks[0]
    (unchecked,) = found.remarks[1:]  # the load is the machine file's
    assert unchecked.startswith("no u_<axis> is recorded")


def test_without_a_load_the_cubic_terms_alone_are_taken_out():
    """A rotor that stands upright: what they make beyond changed parameters tells their size."""
    data, _ = record(0.0, weight=False)
    upright = replace(RIG, gravity_direction=None)
    linear = closed_loop.fit(build_experiment(upright, data, LAW, UNKNOWN, FitOptions()))
    found = identify(upright, data, LAW, unknown=UNKNOWN)
    truth = np.array(
        [
            value
            for name in ("force_per_current", "negative_stiffness")
            for magnets in operating_magnets(upright)
            for value in getattr(magnets.coefficients, name)
        ]
    )
    assert np.abs(linear.values / truth - 1).max() > 0.0015
    assert np.abs(found.result.values / truth - 1).max() < 0.001
    assert (np.abs(found.result.values - truth) < 3 * found.result.standard_deviations).all()
    assert found.magnets.cubic == pytest.approx(1, abs=0.2) and found.magnets.loads == {}
    assert "no static load" in found.remarks[0]


def test_nothing_is_taken_out_of_linear_magnets():
    """Their records say that the cubic terms are none, and the values stay those of the fit."""
    plant = free_mode_reduction(assemble(RIG, OperatingPoint()), 3)
    loop = looped(plant, c2d(match_controller(LAW, plant), 1e-4, "tustin", delay=1e-4))
    names = [f"{kind}_{axis}" for kind in "ey" for axis in plant.axes]
    e = np.stack([0.2 * waveforms.prbs(9, 10, 8000, shift=127 * i) for i in range(4)])
    y = simulate(select(loop, names[:4], names[4:]), e)
    y = y + 5e-8 * np.random.default_rng(1).standard_normal(y.shape)
    units = ("A",) * 4 + ("m",) * 4
    whole = Record("seal-rig", 1e4, tuple(names), units, np.vstack([e, y]), plant.point)
    found = identify(RIG, whole, LAW, unknown=UNKNOWN)
    linear = closed_loop.fit(build_experiment(RIG, whole, LAW, UNKNOWN, FitOptions()))
    assert found.magnets is None
    assert np.abs(found.result.values / linear.values - 1).max() < 1e-12
    assert (found.result.standard_deviations >= linear.standard_deviations).all()


def test_5_amplitudes_are_joined_as_in_closed_form():
    """Two independent amplitudes: means weighted by the inverse variances; one without a signal
    stays zero and adds nothing.
    """
    found, variances = np.array([0.8, 0.0, 0.4]), np.array([0.09, np.inf, 0.01])
    a, P, believed = _joined(found, np.diag(variances), np.array([0.5, 0.0]))
    assert believed
    for j, (mean, sigma) in ((0, (0.5, 0.4)), (2, (1.0, 0.5))):
        weight = 1 / sigma**2 + 1 / variances[j]
        assert a[j] == pytest.approx((mean / sigma**2 + found[j] / variances[j]) / weight)
        assert P[j, j] == pytest.approx(1 / weight)
    assert a[1] == 0.0 and not P[1].any() and not P[:, 1].any()

    # cubic terms of minus eight times the file's are no magnet's: what is known beforehand stays
    none = np.zeros(2)
    a, P, believed = _joined(np.array([0.0, 0.0, -8.0]), np.diag([0.01, 0.01, 1.0]), none)
    assert not believed and a.tolist() == [0, 0, 1] and P[2, 2] == 0.25

    # a load that the file does not state, but the record for certain
    a, P, believed = _joined(np.array([2.0, 0.0, 1.1]), np.diag([1e-4, 1e-4, 0.01]), none)
    assert believed and a[0] == pytest.approx(2.0, rel=1e-3)
    # and one that may as well be noise
    a, P, believed = _joined(np.array([3.0, 0.0, 1.1]), np.diag([0.6, 1e-4, 0.01]), none)
    assert not believed


def test_1_terms_are_the_derivatives_of_the_force():
    """Without iron: f = c ((i_0 + i)^2/(s_0 - x)^2 - (i_0 - i)^2/(s_0 + x)^2), its Taylor terms
    about a load.
    """
    p = magnet.parameters(replace(RIG.bearings[0], iron=None))
    i_0, _, _, _, c, s_0, *_ = p
    load = 0.3 * i_0
    found = _terms(p, "A_zeta", load, 1e-2 * i_0, 1e-2 * s_0)
    assert found[4] == pytest.approx(8 * c * load / s_0**3, rel=2e-3)  # i x
    assert found[5] == pytest.approx(12 * c * i_0 * load / s_0**4, rel=2e-3)  # x^2
    assert _terms(p, "A_eta", 0.0, 1e-2 * i_0, 1e-2 * s_0)[3:6] == pytest.approx(
        0.0, abs=1e-6 * found[4] / i_0
    )


def test_1_odd_terms_are_all_that_the_force_has_beyond_its_tangent():
    """A fifth of the gap off: what cubic terms alone leave is a tenth of them, and k_s beside."""
    p = magnet.parameters(replace(RIG.bearings[0], iron=None))
    i_0, _, _, _, c, s_0, *_ = p
    small = dict(
        zip(map(tuple, _ODD), _odd_terms(p, "A_zeta", 1e-2 * i_0, 1e-2 * s_0), strict=True)
    )
    assert small[0, 3] == pytest.approx(8 * c * i_0**2 / s_0**5, rel=1e-3)
    assert small[2, 1] == pytest.approx(4 * c / s_0**3, rel=1e-3)
    for axis, way in (("A_zeta", 0), ("A_eta", 1)):
        i, x, at = 0.3 * i_0, 0.2 * s_0, np.zeros((2, 2))
        terms = _odd_terms(p, axis, i, x)
        at[:, way] = i, x
        tangent = slopes(p, (0.0, 0.0))
        exact = magnet.force(*at[0], *at[1], p)[way] - (
            tangent.force_per_current[way] * i + tangent.negative_stiffness[way] * x
        )
        found = sum(term * i**m * x**n for term, (m, n) in zip(terms, _ODD.tolist(), strict=True))
        assert found == pytest.approx(exact, rel=1e-2)


@cache
def loop():
    """A loop at 10 kHz: plant, law and the record of an excitation of all axes."""
    plant = free_mode_reduction(assemble(replace(RIG, gravity_direction=None)), 1)
    law = c2d(match_controller(LAW, plant), 1e-4, "tustin", delay=1e-4)
    names = tuple(f"e_{axis}" for axis in plant.axes)
    e = np.stack([0.1 * waveforms.prbs(9, 10, 3000, shift=127 * i) for i in range(4)])
    return plant, law, Record("seal-rig", 1e4, names, ("A",) * 4, e, plant.point)


def test_2_responses_are_those_of_the_forces_beyond_the_tangent():
    """The magnet's own force about the load L and about none, along the motion of the linear loop:
    its even and its odd part beyond the tangent, put on the rotor.
    """
    plant, law, record = loop()
    signals, whole = [f"y_{axis}" for axis in plant.axes], looped(plant, law)
    D = nonlinear_responses(plant, law, record, record.signals, signals)
    odd = []
    for j, axis in enumerate(plant.axes):
        p, way = magnets_with(plant, {})[j // 2], j % 2
        i, x = simulate(select(whole, record.signals, [f"i_{axis}", f"q_{axis}"]), record.values)
        load, centre = _LOAD * RIG.bearings[j // 2].bias_current, (p[6], p[9])

        def force(i, x, p=p, way=way, centre=centre):
            both, place = np.zeros(2), np.array(centre)
            both[way], place[way] = i, place[way] + x
            return magnet.force(*both, *place, p)[way]

        even = [(force(load + a, b) + force(load - a, -b)) / 2 for a, b in zip(i, x, strict=True)]
        expected = simulate(
            select(whole, [f"f_{axis}"], signals), np.array([even]) - force(load, 0)
        )
        assert D[j] == pytest.approx(expected, abs=0.02 * np.abs(expected).max())
        at = slopes(p, (0.0, 0.0), centre)
        tangent = at.force_per_current[way] * i + at.negative_stiffness[way] * x
        odd.append([force(a, b) for a, b in zip(i, x, strict=True)] - tangent)
    expected = simulate(select(whole, [f"f_{axis}" for axis in plant.axes], signals), np.array(odd))
    assert D[-1] == pytest.approx(expected, abs=0.02 * np.abs(expected).max())


def test_3_and_4_the_step_is_that_of_least_squares_with_all_unknowns():
    """White residuals: amplitudes, covariance and gain beside numpy's; a signal of nothing."""
    rng = np.random.default_rng(0)
    J, D, r = rng.normal(size=(50, 3)), rng.normal(size=(50, 2)), rng.normal(size=50)
    D += J[:, :2]
    columns = np.hstack([J, D])
    H = np.zeros((6, 6))
    H[:5, :5] = columns.T @ columns
    g = np.append(columns.T @ r, 0.0)
    step = _least_squares_step(H, 0.3 * H, g, r @ r, 3)
    best, (rest,), *_ = np.linalg.lstsq(columns, r)
    assert step.amplitudes == pytest.approx([*best[3:], 0.0])
    assert step.covariance[:2, :2] == pytest.approx(0.3 * np.linalg.inv(H[:5, :5])[3:, 3:])
    assert np.isinf(step.covariance[2, 2])
    without, (left,), *_ = np.linalg.lstsq(J, r)
    assert step.gained == pytest.approx((left - rest) / (r @ r))
    assert without + step.moved[:, :2] @ best[3:] == pytest.approx(best[:3])

    # the same signal twice: neither is known alone, their sum is
    H[:5, :5] = 0
    H[3:5, 3:5] = 50.0
    H[:3, :3] = np.eye(3)
    twice = _least_squares_step(H, 0.3 * H, np.array([0, 0, 0, 20.0, 20.0, 0]), 9.0, 3)
    assert twice.amplitudes[:2].sum() == pytest.approx(20 / 50)
    assert twice.covariance[:2, :2].sum() == pytest.approx(0.3 / 50, rel=1e-3)
    assert twice.covariance[0, 0] > 1e3


def test_6_currents_of_what_turns_are_those_of_the_held_output():
    """u = -K y in samples, held, through the plant at twenty times the rate: its line at w."""
    plant, law, record = loop()
    f, fine, count = 500.0, 20, 400
    wave = TurningWave(1, "y_A_zeta", 1, f, 3e-6, 0.0, 0.7)
    ((omega, phasors),) = _turning_motion(plant, law, record.dt, [wave])
    t, axis = record.dt * np.arange(count), plant.axes.index("A_zeta")
    assert omega == pytest.approx(2 * np.pi * f) and phasors[4 + axis] == 3e-6 * np.exp(0.7j)
    y = np.zeros((4, count))
    y[axis] = 3e-6 * np.cos(omega * t + 0.7)
    u = np.repeat(simulate(law, -y), fine, axis=1)
    coils = select(plant.system, plant.named("u"), [f"i_{axis}" for axis in plant.axes])
    i = simulate(c2d(coils, record.dt / fine), u)[:, fine * count // 2 :]
    late = record.dt / fine * (fine * count // 2 + np.arange(i.shape[1]))
    line = 2 * (i * np.exp(-1j * omega * late)).mean(axis=1)
    assert phasors[:4] == pytest.approx(line, abs=0.01 * np.abs(line).max())


@pytest.mark.parametrize("core", [False, True])
def test_7_and_8_the_thrust_magnet_s_force_beyond_its_tangent(core):
    """At rest the circuit's own force, less its value and its slopes by differences; a solid core
    gets there late.
    """
    part = load_machine(EXPANDER).thrust
    side, at = sides(part)[1], loaded(part, 100.0, 1e-5)
    lags = core_lags(part)[1] if core else None
    control, opened = at.current, -1e-5
    i, x = 0.1 * side.bias, 0.05 * side.gap

    def force(i, x):
        return side.force(side.bias + control + i, side.gap + opened - x)

    slopes = (force(1e-4, 0) - force(-1e-4, 0)) / 2e-4, (force(0, 1e-8) - force(0, -1e-8)) / 2e-8
    beyond = force(i, x) - force(0, 0) - slopes[0] * i - slopes[1] * x
    moved = np.outer([i, x], np.ones(4000))
    found = _side_nonlinear_force(side, control, opened, at.right, lags, moved, 1e-3)
    assert found[-1] == pytest.approx(beyond, rel=0.01)
    assert (abs(found[0] / beyond - 1) > 0.1) == core


def test_the_magnets_are_those_of_the_coefficients_found():
    """K_s over K_i 17 % larger is a gap smaller by as much, and a bearing of its own; what is no
    magnet's stays the file's.
    """
    plant = free_mode_reduction(assemble(replace(RIG, gravity_direction=None)), 1)
    by_file = magnets_with(plant, {})
    assert by_file == [item.of_force for item in operating_magnets(plant.machine)]
    own = operating_magnets(plant.machine)[0].coefficients
    quantities = (
        ("force_per_current", own.force_per_current, 0.94),
        ("negative_stiffness", own.negative_stiffness, 1.1),
    )
    values = {
        f"bearing.A.{quantity}.{way}": factor * value
        for quantity, both, factor in quantities
        for way, value in zip(("zeta", "eta"), both, strict=True)
    }
    found = magnets_with(plant, values)
    assert found[1] == by_file[1]
    at = slopes(found[0], (0.0, 0.0), (found[0][6], found[0][9]))
    assert at.force_per_current == pytest.approx([0.94 * k for k in own.force_per_current])
    assert at.negative_stiffness == pytest.approx([1.1 * k for k in own.negative_stiffness])
    assert found[0][5] / by_file[0][5] == pytest.approx(0.94 / 1.1, rel=0.03)
    impossible = {path: -value for path, value in values.items()}
    assert magnets_with(plant, impossible) == by_file


def test_the_part_for_further_terms_is_finite_for_delays_and_values_of_zero():
    """A delay begins at zero: its change has no relative size."""
    paths = (
        "bearing.A.negative_stiffness.zeta",
        "bearing.A.negative_stiffness.eta",
        "excitation.delay",
        "coupling.c.stiffness.zeta",
    )
    before = SimpleNamespace(paths=paths, values=np.array([1e6, 2e6, 0.0, 0.0]))
    found = _further_terms(before, np.array([1.1e6, 2e6, 1e-6, 0.0]))
    np.testing.assert_allclose(found, 0.05 * np.array([1e5, 2e6 / 11, 1e-6, 0.0]))
