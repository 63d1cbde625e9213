"""The front door: one drop and many of a machine, what they cost, the page, the command."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.integrate import solve_ivp

import ambrose as amb
from ambrose.annexes.touchdown import analysis
from ambrose.annexes.touchdown.analysis import run_down, usual_duration
from ambrose.annexes.touchdown.campaign import (
    axial_drop,
    axial_drops,
    draw,
    drops,
    judge_landing,
    landing_force,
    thrust_rows,
)
from ambrose.annexes.touchdown.drop import build, fallen_rotor
from ambrose.annexes.touchdown.whip import beyond_stop
from ambrose.cli import main
from ambrose.core.checks import InvalidInput
from ambrose.machine.attachment import attached
from ambrose.machine.file.toml import dumps_machine
from ambrose.machine.part import (
    CoastDown,
    Touchdown,
    TouchdownLimits,
    TouchdownMount,
    TouchdownRace,
)
from ambrose.machine.thrust import ThrustBearing
from ambrose.model.axial import rotor_mass
from ambrose.report.page import page_of, render

G = 9.80665
EXAMPLE = Path(__file__).parents[3] / "examples" / "expander-five-axes.toml"


def blower(**limits):
    """The overhung blower with race, mount and limits."""
    machine = amb.load_machine("overhung-blower")
    race = TouchdownRace(0.3, 4e-4, 1.5e8, 2e3, static_capacity=3e4)
    table = Touchdown(
        race=race, mount=TouchdownMount(0.5, 2e7, 5e3, 2e-4), limits=TouchdownLimits(**limits)
    )
    bearings = tuple(replace(item, touchdown=table) for item in machine.bearings)
    return replace(machine, bearings=bearings, coast_down=CoastDown(brake_torque=1.0))


@pytest.fixture(scope="module")
def landed():
    return amb.landing(
        blower(landings=2, max_force=1e5, energy=2e4, static_factor=0.1, temperature=500.0),
        drops=12,
        duration=0.04,
        seed=3,
        workers=2,
    )


def test_one_drop(landed):
    """Both ends fall through the clearance; the largest of many figures agree with the log."""
    figures, log = landed.fall.figures, landed.fall.log
    assert figures[:, 0] == pytest.approx(np.sqrt(2 * 2e-4 / G), rel=0.1)  # unbalance turns it
    for k in range(2):
        assert log[:, 4 + 8 * k].max() == pytest.approx(figures[k, 2], rel=0.02)
        assert np.hypot(log[:, 2 + 8 * k], log[:, 3 + 8 * k]).max() <= figures[k, 5] * (1 + 1e-9)
    assert log[-1, 0] == pytest.approx(0.04, rel=1e-2)
    assert 0 < log[-1, 5] < landed.point.speed  # a race spins up
    assert landed.fall.log[-1, 1] < landed.point.speed


def test_campaign_is_the_same_on_any_number_of_processors(landed):
    shares = landed.drop.unbalance
    again = drops(landed.machine, landed.fallen, shares, 12, duration=0.04, seed=3, workers=1)
    assert np.array_equal(again.figures, landed.campaign.figures)
    assert np.array_equal(again.slip, landed.campaign.slip)
    assert not np.array_equal(draw(landed.fallen, 12, 3)[0], draw(landed.fallen, 12, 4)[0])


def test_rows_against_limits(landed):
    rows = {(row.name, row.place): row for row in landed.rows}
    place = "impeller-side"
    k = landed.fallen.names.index(place)
    assert rows["force", place].value == landed.campaign.force[:, k].max()
    factor = 3e4 / landed.campaign.load[:, k].max()
    assert rows["static_factor", place].value == pytest.approx(factor)
    # adiabatic: m c dT = slip
    hottest = 293.15 + landed.campaign.slip[:, k].max() / (0.3 * 460)
    assert rows["temperature", place].value == pytest.approx(hottest)
    allowed = int(2e4 / landed.campaign.slip[:, k].mean())
    assert rows["landings", place].value == allowed
    assert landed.passed
    plain = json.loads(json.dumps(landed.to_dict(), allow_nan=False))
    assert len(plain["iso_14839_5"]) == 9
    assert plain["campaign"]["drops"] == 12


def test_run_down_of_a_brake_alone():
    """J W = M t; nothing slips on a race."""
    fallen = fallen_rotor(blower(), amb.load_machine("overhung-blower").operation.nominal)
    free = [item._replace(drag=0.0, drag_arm=0.0) for item in fallen.bearings]
    down = run_down(replace(fallen, bearings=tuple(free)), 800.0, 2.0, 0.0)
    assert down.time == pytest.approx(fallen.polar_inertia * 800 / 2, rel=1e-9)
    assert down.slip == 0
    assert down.taken == pytest.approx(fallen.polar_inertia * 800**2 / 2, rel=1e-6)


def test_stop_of_the_mount_is_told():
    """A travel of a micrometre is met by any whip; one of a metre by none."""
    machine = amb.load_machine("overhung-blower")
    for travel, met in ((1e-6, True), (1.0, False)):
        table = Touchdown(mount=TouchdownMount(0.5, 2e7, 5e3, travel))
        bearings = tuple(replace(item, touchdown=table) for item in machine.bearings)
        fallen = fallen_rotor(replace(machine, bearings=bearings), machine.operation.nominal)
        assert beyond_stop(fallen.bearings[0], 400.0, 1e3, 0.2) is met
    # a static force: travel over stiffness
    bearing = fallen.bearings[0]._replace(ring_mass=1e-9, mount_damping=0.0, travel=1e-4)
    assert beyond_stop(bearing, 1.0, 1.01 * 2e7 * 1e-4, 0.0)
    assert not beyond_stop(bearing, 1.0, 0.99 * 2e7 * 1e-4, 0.0)


def test_run_down_of_brake_and_windage():
    """J W' = -b - c W^2: t = J / sqrt(b c) atan(W sqrt(c / b)); a bush slips its share."""
    fallen = fallen_rotor(blower(), amb.load_machine("overhung-blower").operation.nominal)
    free = replace(
        fallen,
        bearings=tuple(item._replace(drag=0.0, drag_arm=0.0) for item in fallen.bearings),
    )
    b, c, W = 2.0, 3e-6, 1200.0
    exact = fallen.polar_inertia / np.sqrt(b * c) * np.arctan(W * np.sqrt(c / b))
    assert run_down(free, W, b, c).time == pytest.approx(exact, rel=1e-6)
    bush = replace(fallen, bearings=tuple(item._replace(race_mass=0.0) for item in fallen.bearings))
    rub = sum(0.2 * fallen.mass * G / 2 * item.radius for item in fallen.bearings)
    down = run_down(bush, W, b, 0.0)
    energy = fallen.polar_inertia * W**2 / 2
    assert down.slip == pytest.approx(energy * rub / (rub + b), rel=1e-4)


def test_what_was_not_met_costs_nothing():
    machine = blower(energy=100.0)
    fallen = fallen_rotor(machine, machine.operation.nominal)
    force, zero = np.array([[1e3, 0.0]]), np.zeros((1, 2))
    rows = judge_landing(machine, fallen, force, force, zero, zero, np.zeros((1, 0)), 10.0)
    cost = {row.place: row.value for row in rows if row.name == "slip_energy"}
    assert list(cost.values()) == [10.0, 0.0]
    allowed = {row.place: row.value for row in rows if row.name == "landings"}
    assert list(allowed.values()) == [10.0, np.inf]


def test_page_and_command(landed, tmp_path):
    html = render(page_of(landed))
    for words in ("Slow motion", "Many drops", "ISO 14839-5", "not a statement on stability"):
        assert words in html
    path = tmp_path / "weak.toml"
    machine = amb.load_machine("overhung-blower")  # in fixed bushes
    weak = Touchdown(limits=TouchdownLimits(max_force=1.0))
    bearings = tuple(replace(item, touchdown=weak) for item in machine.bearings)
    path.write_text(dumps_machine(replace(machine, bearings=bearings)))
    done = CliRunner().invoke(main, ["landing", str(path), "--duration", "0.02", "--json"])
    assert done.exit_code == 1
    assert json.loads(done.stdout)["passed"] is False


def test_landing_on_a_thrust_face():
    """The stop's force against the motion itself, integrated without damping."""
    mass, thrust, way, k = 10.0, 300.0, 2e-4, 1e8

    def motion(_t, z):
        return [z[1], (thrust - k * max(z[0] - way, 0.0)) / mass]

    path = solve_ivp(motion, (0, 0.01), [0.0, 0.0], max_step=5e-6, rtol=1e-9).y[0]
    assert landing_force(thrust, way, k) == pytest.approx(k * (path.max() - way), rel=1e-4)
    machine = amb.load_machine(EXAMPLE)
    (drop,) = axial_drops(machine, mass, rated(machine), 0.5)
    force, gap = thrust_rows((drop,))
    assert force.place.endswith("left")  # the expander wheel pulls there
    assert 0 < force.value < drop.bound and gap.passed


def rated(machine):
    return next(point for point in machine.operation.points if point.label == "rated")


def thrust_part():
    (part,) = (p for _, p in attached(amb.load_machine(EXAMPLE)) if isinstance(p, ThrustBearing))
    return part


def test_the_first_blow_on_a_thrust_face_is_that_of_a_damped_oscillator():
    """m x'' + d x' + k x = F_0 from x = 0 at the speed v of the free way, its first turning point
    in closed form; first contact sqrt(2 m c / F_0); at the end F_0 / k beyond the stop.
    """
    part, mass, thrust = thrust_part(), 12.0, 120.0
    k, d, way = part.stop_stiffness, part.stop_damping, part.touchdown_gap[0]
    drop = axial_drop(part, mass, -thrust, 0.5)
    assert drop.first_contact == pytest.approx(np.sqrt(2 * mass * way / thrust), rel=1e-6)
    speed = np.sqrt(2 * thrust * way / mass)
    decay, turning = d / (2 * mass), np.sqrt(k / mass - (d / (2 * mass)) ** 2)
    # x = F_0/k + e^(-a t) (A cos w t + B sin w t)
    A, B = -thrust / k, (speed - decay * thrust / k) / turning
    t = np.arctan2(B * turning - A * decay, A * turning + B * decay) / turning
    deep = thrust / k + np.exp(-decay * t) * (A * np.cos(turning * t) + B * np.sin(turning * t))
    assert drop.reach == pytest.approx(way + deep, rel=1e-6)
    assert drop.settled is not None
    assert abs(drop.place[-1]) == pytest.approx(way + thrust / k, rel=1e-6)
    assert axial_drop(part, mass, thrust, 0.5).place.max() == pytest.approx(drop.reach, rel=1e-9)


def test_a_stop_without_damping_reaches_its_bound_and_a_coupling_may_hold_the_rotor():
    part, mass = thrust_part(), 12.0
    bare = axial_drop(replace(part, stop_damping=0.0), mass, -120.0, 0.02)
    assert bare.largest_force == pytest.approx(bare.bound, rel=1e-5)
    assert bare.settled is None
    held = axial_drop(replace(part, coupling_stiffness=1e6), mass, -120.0, 0.1)
    assert held.first_contact is None and held.largest_force == 0.0
    assert held.reach == pytest.approx(2 * 120.0 / 1e6, rel=1e-4)  # twice the static deflection


def test_the_rig_lands_on_its_thrust_face_as_the_drop_says():
    """The rig's flux decays first, which holds the rotor back a little; as far within 0.5 %."""
    axial = amb.load_machine(f"{EXAMPLE}#axial")
    run = amb.simulate(axial, amb.design(axial, "pid"), "power-loss", point="rated")
    machine = amb.load_machine(EXAMPLE)
    (drop,) = axial_drops(machine, rotor_mass(axial), rated(machine), 0.5)
    place = run.record.values[run.record.signals.index("q_T_z")]
    later = run.touchdown_at - 0.1 - drop.first_contact
    assert 0 < later < 0.15 * drop.first_contact
    assert np.abs(place).max() == pytest.approx(drop.reach, rel=5e-3)


def test_a_drop_lasts_until_the_races_turn():
    """I W / (mu N R), and never below 0.4 nor above 1 s; a bush is followed for a second."""
    fallen = fallen_rotor(blower(), amb.load_machine("overhung-blower").operation.nominal)
    first = fallen.bearings[0]
    lasts = 4e-4 * fallen.speed / (0.2 * fallen.mass * G / 2 * first.radius)
    light = [first._replace(race_inertia=4e-4 * part) for part in (0.7 / lasts, 1e-3)]
    assert usual_duration(replace(fallen, bearings=tuple(light))) == pytest.approx(0.7)
    assert usual_duration(replace(fallen, bearings=(light[1], light[1]))) == 0.4
    bush = first._replace(race_mass=0.0)
    assert usual_duration(replace(fallen, bearings=(bush, light[1]))) == 1.0


ABSURD = {  # what is written beside a sound race and mount
    "a race of 300 kg": ("race", {"mass": 300.0}, "race.*mass is 300 kg.*50 kg is usual"),
    "a flywheel for a race": ("race", {"inertia": 1.0}, "race.*inertia is 1 kg m.*whole rotor"),
    "hard elements": ("race", {"element_stiffness": 1e15}, "element_stiffness is 1e.15 N/m"),
    "a load of nothing": ("race", {"element_load": 1e-29}, "element_load is 1e-29 N"),
    "a mount of air": ("mount", {"stiffness": 1e-3}, "mount.*stiffness is 0.001 N/m"),
    "limits of a planet": ("limits", {"max_force": 1e11}, "limits.*max_force is 1e.11 N"),
}


@pytest.mark.parametrize("case", ABSURD)
def test_no_verdict_rests_on_an_absurd_number(case, monkeypatch):
    """Each of these passed: no limit is exceeded where the race is as heavy as a car."""

    def begun(*arguments, **options):
        raise AssertionError("begun")

    monkeypatch.setattr("ambrose.annexes.touchdown.analysis.build", begun)
    part, change, words = ABSURD[case]
    machine = blower(max_force=1e6)
    table = machine.bearings[0].touchdown
    odd = replace(table, **{part: replace(getattr(table, part), **change)})
    first = replace(machine.bearings[0], touchdown=odd)
    with pytest.raises(InvalidInput, match=words):
        amb.landing(replace(machine, bearings=(first, *machine.bearings[1:])))


def test_no_race_is_heavier_than_its_rotor():
    """Of a rotor of 1 kg the same race is refused; of its own it is not."""
    fallen = fallen_rotor(blower(), amb.load_machine("overhung-blower").operation.nominal)
    analysis._check_races(fallen)
    with pytest.raises(InvalidInput, match=r"race\]: mass is 0\.3 kg, .*whole rotor, 0\.2 kg"):
        analysis._check_races(replace(fallen, mass=0.2))


def test_refusals():
    with pytest.raises(InvalidInput, match="a drop would need steps of"):
        machine = blower()
        fallen = fallen_rotor(machine, machine.operation.nominal)
        tiny = tuple(item._replace(race_mass=1e-9, race_inertia=1e-12) for item in fallen.bearings)
        build(machine, replace(fallen, bearings=tiny))
    with pytest.raises(InvalidInput, match="duration of a drop is 0 s"):
        amb.landing(blower(), duration=0.0)
    with pytest.raises(InvalidInput, match=r"friction is -0\.1"):
        machine = blower()
        part = replace(machine.bearings[0], touchdown=Touchdown(friction=-0.1))
        replace(machine, bearings=(part, machine.bearings[1]))
    with pytest.raises(InvalidInput, match="static_factor needs the load rating"):
        machine = blower()
        bare = Touchdown(limits=TouchdownLimits(static_factor=2.0))
        part = replace(machine.bearings[0], touchdown=bare)
        replace(machine, bearings=(part, machine.bearings[1]))
    with pytest.raises(InvalidInput, match=r"static_friction is 0\.1"):
        machine = blower()
        part = replace(machine.bearings[0], touchdown=Touchdown(static_friction=0.1))
        replace(machine, bearings=(part, machine.bearings[1]))
