"""Scenarios: the bundled ones, their files, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest

from ambrose.core.checks import InvalidInput
from ambrose.machine.file.toml import load_machine
from ambrose.rig.linear import waveforms
from ambrose.rig.scenario import (
    Chirp,
    Prbs,
    Pulse,
    Scenario,
    Sine,
    Unbalance,
    bundled_scenarios,
    load_scenario,
    read_scenario,
)

FORCES = ("f_A_zeta", "f_A_eta", "f_center_x", "f_center_y")


def test_every_bundled_scenario_loads_under_its_own_name():
    names = bundled_scenarios()
    assert {
        "impulse-orthogonal",
        "impulse-parallel",
        "force-impulse",
        "unbalance",
        "run-up",
    } <= set(names)
    for name, description in names.items():
        assert load_scenario(name).name == name and description


@pytest.mark.literature
def test_disturbance_patterns_of_the_papers():
    """P5, Figs. 15 and 16: 0.05 A for 10 ms on two axes at once; P3, Fig. 9: 100 N for 2 ms at
    A.
    """
    for name, axes in (
        ("impulse-orthogonal", ["A_zeta", "B_eta"]),
        ("impulse-parallel", ["A_zeta", "B_zeta"]),
    ):
        pulses = load_scenario(name).on(load_machine("seal-rig")).pulses
        assert [(p.signal, p.amplitude, p.start, p.duration) for p in pulses] == [
            (f"e_{a}", 0.05, 0.05, 0.01) for a in axes
        ]
    (pulse,) = load_scenario("force-impulse").on(load_machine("seal-rig")).pulses
    assert (pulse.signal, pulse.amplitude, pulse.duration) == ("f_A_zeta", 100.0, 0.002)


@pytest.mark.literature
def test_balance_grade_gives_the_printed_force():
    """P5 prints 541 N at 500 Hz for G2.5; the rotor weighs 69 kg."""
    amounts = [
        item.mass_times_radius(68.9)
        for item in load_scenario("unbalance").on(load_machine("seal-rig")).unbalances
    ]
    assert sum(amounts) * (2 * np.pi * 500) ** 2 == pytest.approx(541, rel=2e-3)


def test_a_file_with_everything(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(
        'name = "mine"\nduration = "200 ms"\nspeed = "3000 rpm"\nto_speed = 400.0\nramp = '
        '0.1\nsample_time = "50 us"\n'
        '[[pulse]]\nsignal = "d_A_zeta"\namplitude = "2 um"\nduration = "5 ms"\nevery = 0.02\n'
        '[[sine]]\nsignal = "f_A_eta"\namplitude = "1 kN"\nfrequency = "50 Hz"\nphase = "90 deg"\n'
        '[[unbalance]]\nport = "center"\namount = "50 g mm"\nphase = "180 deg"\n'
    )
    scenario = load_scenario(path)
    assert scenario.speed == pytest.approx(100 * np.pi) and scenario.sample_time == pytest.approx(
        50e-6
    )
    assert scenario.pulses == (
        Pulse("d_A_zeta", pytest.approx(2e-6), 0.0, pytest.approx(5e-3), 0.02),
    )
    assert scenario.sines == (
        Sine("f_A_eta", 1000.0, pytest.approx(100 * np.pi), pytest.approx(np.pi / 2)),
    )
    assert scenario.unbalances == (
        Unbalance("center", pytest.approx(50e-6), phase=pytest.approx(np.pi)),
    )
    assert [scenario.speed_at(t) for t in (0.0, 0.05, 0.1, 0.2)] == pytest.approx(
        [100 * np.pi, 357.0796, 400, 400], rel=1e-6
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('name = "x"', "duration is missing"),
        ('name = "x"\nduration = "3 mm"', "duration.*time"),
        ('name = "x"\nduration = -1.0', "positive"),
        ('name = "x"\nduration = 0.0', "positive"),
        ("name = 5\nduration = 1.0", "name is 5"),
        (
            'name = "x"\nduration = 1.0\nspeeed = 1.0',
            "unknown key 'speeed'; did you mean \"speed\"",
        ),
        ('name = "x"\nduration = 1.0\nto_speed = 1.0', "without speed"),
        ('name = "x"\nduration = 1.0\nspeed = 1.0\nto_speed = 2.0\nramp = 3.0', "ramp is 3"),
        ('name = "x"\nduration = 1.0\npulse = 3', r"write \[\[pulse\]\]"),
        (
            'name = "x"\nduration = 1.0\n[[pulse]]\nsignal = "e_A"',
            r"\[\[pulse\]\] number 1: amplitude is missing",
        ),
        (
            'name = "x"\nduration = 1.0\n[[pulse]]\nsignal = "e_A"\namplitude = "5 N"',
            "amplitude.*current",
        ),
        (
            'name = "x"\nduration = 1.0\n[[pulse]]\nsignal = "z_A"\namplitude = 1.0',
            "prefix of signal 'z_A'",
        ),
        ('name = "x"\nduration = 1.0\n[[pulse]]\nsignal = "e_A"\namplitude = nan', "finite"),
        (
            'name = "x"\nduration = 1.0\n[[pulse]]\nsignal = "e_A"\namplitude = 1.0\nstart = 2.0',
            "within 0 to 1 s",
        ),
        (
            'name = "x"\nduration = 1.0\n[[pulse]]\nsignal = "e_A"\namplitude = 1.0\nevery = 0.1',
            "at least its duration",
        ),
        (
            'name = "x"\nduration = 1.0\n[[pulse]]\nsignal = "e_A"\namplitude = 1.0\nduration = 0.0',
            "positive",
        ),
        (
            'name = "x"\nduration = 1.0\n[[sine]]\nsignal = "e_A"\namplitude = 1.0\nfrequency = 0',
            "positive",
        ),
        ('name = "x"\nduration = 1.0\n[[unbalance]]\nport = "A"\namount = 1.0', "without speed"),
        ('name = "x"\nduration = 1.0\nspeed = 1.0\n[[unbalance]]\nport = "A"', "either amount"),
        (
            'name = "x"\nduration = 1.0\nspeed = 1.0\n[[unbalance]]\nport = "A"\ngrade = 1.0',
            "either amount",
        ),
        (
            'name = "x"\nduration = 1.0\nspeed = 1.0\n[[unbalance]]\nport = "A"\namount = "5 kg"',
            "g mm",
        ),
        (
            'name = "x"\nduration = 1.0\nspeed = 1.0\n[[unbalance]]\nport = "A"\namount = true',
            "amount is True",
        ),
        (
            'name = "x"\nduration = 1.0\nspeed = 1.0\n[[unbalance]]\nport = "A"\namount = "1e308 g mm"',
            "amount is '1e308 g mm', but must be at most 1e\\+60",
        ),
        (
            'name = "x"\nduration = 1.0\n[[pulse]]\nsignal = "e_A"\namplitude = "-1e70 A"',
            "amplitude is '-1e70 A', but must be at most",
        ),
        ("name = ", "scenario .*bad.toml"),
    ],
)
def test_bad_files_are_refused(tmp_path, text, message):
    path = tmp_path / "bad.toml"
    path.write_text(text)
    with pytest.raises(InvalidInput, match=message):
        load_scenario(path)


def test_unknown_names_are_refused(tmp_path):
    with pytest.raises(InvalidInput, match='did you mean "run-up"'):
        load_scenario("runup")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(InvalidInput, match=r"binary\.toml"):
        load_scenario(tmp_path / "binary.toml")
    with pytest.raises(InvalidInput, match="scenario x has no speed"):
        read_scenario({"name": "x", "duration": 1.0}).speed_at(0.0)


def test_pulses_land_on_their_samples():
    scenario = Scenario(
        "x", 0.01, pulses=(Pulse("f_A_eta", 3.0, 2e-3, 1e-3, 4e-3), Pulse("f_A_eta", 0.5, 8e-3))
    )
    names, c = waveforms(scenario, FORCES, 1e-3, 11)
    assert names == ["f_A_eta"]
    assert c[0, 0].tolist() == [0, 0, 3, 0, 0, 0, 3, 0, 0.5, 0.5, 3.5]
    assert not c[1:].any()


def test_run_up_force_is_that_of_a_turning_mass():
    """F = -U d2/dt2 (cos phi, sin phi), differentiated numerically from the angle, also after the
    ramp.
    """
    U = 2e-4
    dt = 1e-5
    k = 4001
    scenario = Scenario(
        "x",
        0.04,
        unbalances=(Unbalance("center", U, phase=0.7),),
        speed=300.0,
        to_speed=900.0,
        ramp=0.03,
    )
    names, c = waveforms(scenario, FORCES, dt, k)
    assert names == ["f_center_x", "f_center_y"]
    t = np.arange(k) * dt
    a = 600 / 0.03
    phi = 0.7 + np.where(
        t < 0.03, 300 * t + a * t**2 / 2, 300 * 0.03 + a * 0.03**2 / 2 + 900 * (t - 0.03)
    )
    place = np.exp(1j * phi)
    force = -U * (place[2:] - 2 * place[1:-1] + place[:-2]) / dt**2
    inside = np.abs(t[1:-1] - 0.03) > 2 * dt
    size = np.abs(force).max()
    np.testing.assert_allclose(c[0, 0, 1:-1][inside], force.real[inside], atol=1e-5 * size, rtol=0)
    np.testing.assert_allclose(c[0, 1, 1:-1][inside], force.imag[inside], atol=1e-5 * size, rtol=0)
    # the cubics meet, except where the torque jumps at the end of the ramp
    ends = c.sum(axis=0)[:, :-1] - c[0, :, 1:]
    ends[:, 2999] = 0.0
    assert np.abs(ends).max() < 1e-12 * size
    jump = c.sum(axis=0)[:, 2999] - c[0, :, 3000]
    assert np.hypot(*jump) == pytest.approx(U * a, rel=1e-9)


EVERYTHING = {
    "name": "all",
    "duration": 0.05,
    "speed": 200.0,
    "to_speed": 400.0,
    "ramp": 0.03,
    "pulse": [
        {"signal": "e_A_zeta", "amplitude": 1.0, "start": 0.002, "duration": 0.001, "every": 0.004}
    ],
    "sine": [
        {
            "signal": "e_A_eta",
            "amplitude": 2.0,
            "frequency": 500.0,
            "start": 0.003,
            "duration": 0.02,
        }
    ],
    "stepped_sine": [
        {
            "signal": "r_A_zeta",
            "amplitude": 1e-6,
            "frequencies": ["50 Hz", "100 Hz", 800.0],
            "dwell": "15 ms",
        }
    ],
    "chirp": [
        {
            "signal": "d_A_zeta",
            "amplitude": 1e-6,
            "frequency": "20 Hz",
            "to_frequency": "400 Hz",
            "spacing": "logarithmic",
        }
    ],
    "prbs": [
        {
            "signal": "f_A_eta",
            "amplitude": "10 N",
            "bit_time": "0.5 ms",
            "order": 4,
            "seed": 3,
            "start": 0.001,
        }
    ],
    "unbalance": [{"port": "center", "amount": 1e-5}],
}
INPUTS = (*(f"{kind}_A_{axis}" for kind in "erd" for axis in ("zeta", "eta")), *FORCES)


def test_waveforms_in_stretches_are_those_of_the_whole():
    scenario = read_scenario(EVERYTHING)
    names, whole = waveforms(scenario, INPUTS, 1e-4, 501)
    parts = [
        waveforms(scenario, INPUTS, 1e-4, count, first=first)
        for first, count in ((0, 7), (7, 120), (127, 300), (427, 74))
    ]
    assert all(part[0] == names for part in parts)
    joined = np.concatenate([part[1] for part in parts], axis=2)
    np.testing.assert_allclose(
        joined, whole, rtol=0, atol=1e-12 * np.abs(whole).max(axis=(0, 2)).max()
    )
    assert {
        "e_A_zeta",
        "e_A_eta",
        "r_A_zeta",
        "d_A_zeta",
        "f_A_eta",
        "f_center_x",
        "f_center_y",
    } == set(names)


def test_binary_sequence_is_white_and_its_seeds_nearly_uncorrelated():
    sequences = tuple(
        Prbs(f"f_A_{axis}", 3.0, 1e-3, order=9, seed=seed)
        for seed, axis in enumerate(("zeta", "eta"))
    )
    _, c = waveforms(Scenario("x", 1.022, sequences=sequences), FORCES, 1e-3, 1022)
    first, second = c[0]
    np.testing.assert_array_equal(first[:511], first[511:])
    assert set(first) == {-3.0, 3.0} and abs(first[:511].sum()) == 3.0
    correlation = [np.dot(first[:511], np.roll(first[:511], lag)) / 9 for lag in range(5)]
    np.testing.assert_allclose(correlation, [511, -1, -1, -1, -1], atol=1e-9)
    assert np.dot(first[:511], second[:511]) / 9 == pytest.approx(-1)


@pytest.mark.parametrize("spacing", ["linear", "logarithmic"])
def test_chirp_passes_its_frequencies(spacing):
    chirp = Chirp("f_A_zeta", 1.0, 100.0, 1600.0, spacing=spacing)
    _, c = waveforms(Scenario("x", 2.0, chirps=(chirp,)), FORCES, 1e-4, 20001)
    rises = np.flatnonzero((c[0, 0, :-1] < 0) & (c[0, 0, 1:] >= 0)) * 1e-4
    found, at = 2 * np.pi / np.diff(rises), (rises[1:] + rises[:-1]) / 2
    expected = 100 + 750 * at if spacing == "linear" else 100 * 16 ** (at / 2)
    np.testing.assert_allclose(found, expected, rtol=0.05)


def test_stepped_sine_is_one_sine_after_the_other():
    scenario = read_scenario(
        {"name": "x", "duration": 0.04, "stepped_sine": EVERYTHING["stepped_sine"]}
    )
    _, c = waveforms(scenario, INPUTS, 1e-4, 401)
    t = np.arange(401) * 1e-4
    expected = np.where(
        t < 0.015, np.sin(314.159265 * t), np.where(t < 0.03, np.sin(628.318531 * (t - 0.015)), 0)
    )
    expected = np.where(t >= 0.03, np.sin(800 * (t - 0.03)), expected)
    np.testing.assert_allclose(c[0, 0], 1e-6 * expected, atol=1e-12)
    assert scenario.fastest == 800.0 and not scenario.only_for_the_rig


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (
            {"prbs": [{"signal": "e_A_zeta", "amplitude": 1.0, "bit_time": 1e-3, "order": 30}]},
            "order.*from 2 to 20",
        ),
        (
            {"prbs": [{"signal": "e_A_zeta", "amplitude": 1.0, "bit_time": 1e-3, "seed": -1}]},
            "seed is -1",
        ),
        (
            {
                "chirp": [
                    {"signal": "e_A_zeta", "amplitude": 1.0, "frequency": 1.0, "to_frequency": -1.0}
                ]
            },
            "positive",
        ),
        (
            {
                "chirp": [
                    {
                        "signal": "e_A_zeta",
                        "amplitude": 1.0,
                        "frequency": 1.0,
                        "to_frequency": 2.0,
                        "spacing": "odd",
                    }
                ]
            },
            "spacing.*'odd'",
        ),
        (
            {
                "stepped_sine": [
                    {"signal": "e_A_zeta", "amplitude": 1.0, "frequencies": [], "dwell": 0.1}
                ]
            },
            "no frequencies",
        ),
        (
            {
                "stepped_sine": [
                    {"signal": "e_A_zeta", "amplitude": 1.0, "frequencies": 3.0, "dwell": 0.1}
                ]
            },
            "square brackets",
        ),
        (
            {
                "stepped_sine": [
                    {"signal": "e_A_zeta", "amplitude": 1.0, "frequencies": ["5 mm"], "dwell": 0.1}
                ]
            },
            "frequencies",
        ),
        ({"pressure": [{"time": 0.01, "pressure": "3 mm"}]}, "pressure"),
        (
            {
                "pressure": [
                    {"time": 0.01, "pressure": 1.0, "ramp": 0.01},
                    {"time": 0.015, "pressure": 2.0},
                ]
            },
            "after the one before",
        ),
        ({"pressure": [{"time": 0.5, "pressure": 1.0}]}, "within 0 to 0.05 s"),
        ({"failure": [{"time": 0.5}]}, "within 0 to 0.05 s"),
        ({"initial": "flying"}, "'flying'.*levitated or resting"),
        ({"switch_at": 1.0}, "switch_at"),
    ],
)
def test_bad_tables_are_refused(table, message):
    with pytest.raises(InvalidInput, match=message):
        read_scenario({"name": "x", "duration": 0.05, **table})


CYCLE = """name = "mine"
duration = "3 s"
speed = 0
[[speed_change]]
time = "0.5 s"
speed = "50 % of top speed"
ramp = "1 s"
[[speed_change]]
time = "2 s"
speed = "10 % of the top speed"
ramp = "0.5 s"
[[pressure]]
time = 0
pressure = "20 % of top pressure"
[[pulse]]
signal = "e_last_eta"
amplitude = "5 % of max current"
[[pulse]]
signal = "r_first_zeta"
amplitude = "10 % of touchdown gap"
[[prbs]]
signal = "e_every_zeta"
amplitude = "0.1 A"
bit_time = "1 ms"
seed = 1
[[unbalance]]
port = "every"
grade = "2.5 mm/s"
grade_speed = "100 % of balance speed"
[[failure]]
time = 1
axis = "first_eta"
"""


@pytest.fixture
def cycle(tmp_path):
    path = tmp_path / "cycle.toml"
    path.write_text(CYCLE)
    return load_scenario(path)


def three_bearings(*names):
    machine = load_machine("turboexpander")
    (a, b), (c, d) = machine.bearings, machine.sensors
    bearings = zip((a, b, b), names, (10.0, 11.0, 12.0), strict=True)
    return replace(
        machine,
        bearings=tuple(replace(item, name=name, max_current=most) for item, name, most in bearings),
        sensors=tuple(
            replace(item, bearing=name) for item, name in zip((c, d, d), names, strict=True)
        ),
        tolerances=(),
        assumed=(),
    )


def test_a_scenario_in_terms_of_the_machine(cycle):
    machine = three_bearings("DE", "middle", "NDE")
    on = cycle.on(machine)
    top, pressure = 2 * np.pi * 525, max(point.seal_pressure for point in machine.operation.points)
    assert [change.speed for change in on.speed_changes] == pytest.approx([0.5 * top, 0.1 * top])
    assert on.pressures[0].pressure == pytest.approx(0.2 * pressure)
    assert [pulse.signal for pulse in on.pulses] == ["e_NDE_eta", "r_DE_zeta"]
    assert on.pulses[0].amplitude == pytest.approx(0.5)
    assert on.pulses[1].amplitude == pytest.approx(
        0.1 * min(b.touchdown_gap for b in machine.bearings)
    )
    assert [(item.signal, item.seed) for item in on.sequences] == [
        ("e_DE_zeta", 1),
        ("e_middle_zeta", 3),
        ("e_NDE_zeta", 5),
    ]
    assert [item.port for item in on.unbalances] == ["DE", "middle", "NDE"]
    whole = Unbalance("x", grade=2.5e-3, grade_speed=top).mass_times_radius(70.0)
    assert sum(item.mass_times_radius(70.0) for item in on.unbalances) == pytest.approx(
        whole, rel=1e-12
    )
    assert on.failures[0].axis == "DE_eta"
    assert on.on(machine) == on


@pytest.mark.parametrize("word", ["first", "last", "every"])
def test_no_bearing_is_called_by_what_scenarios_mean_by_its_place(word):
    with pytest.raises(
        InvalidInput,
        match=f'name is "{word}", but must be none of first, last, every; scenarios mean',
    ):
        three_bearings("DE", word, "NDE")


def test_speeds_of_a_cycle_and_their_integral(cycle):
    on = cycle.on(load_machine("turboexpander"))
    top = 2 * np.pi * 525
    times = np.array([0.0, 0.5, 1.0, 1.5, 1.8, 2.0, 2.25, 2.5, 3.0])
    expected = np.array([0, 0, 0.25, 0.5, 0.5, 0.5, 0.3, 0.1, 0.1]) * top
    assert [on.speed_at(t) for t in times] == pytest.approx(expected)
    assert on.runs_up and on.fastest == pytest.approx(0.5 * top)


def test_what_no_machine_or_not_this_one_tells_is_refused(cycle):
    machine = load_machine("seal-rig")
    with pytest.raises(
        InvalidInput, match="scenario mine asks for 5 % of max current; give the machine"
    ):
        cycle.at_bearings(["A", "B"])
    open_rig = replace(
        machine, bearings=tuple(replace(item, max_current=None) for item in machine.bearings)
    )
    with pytest.raises(
        InvalidInput,
        match="needs the max current of machine 'seal-rig', which states none; add max_current",
    ):
        cycle.on(open_rig)
    for text, message in (
        ("50 % of top pressure", "may be a share of top speed or balance speed only"),
        ("50 % of bottom speed", "may be a share of top speed"),
    ):
        table = {"time": 0, "speed": text, "ramp": 1}
        with pytest.raises(InvalidInput, match=message):
            read_scenario({"name": "x", "duration": 2.0, "speed": 0, "speed_change": [table]})
    for more, message in (
        ({"to_speed": 3.0}, "to_speed and changes of speed are both given"),
        ({"speed_change": [{"time": 0, "speed": 1, "ramp": 0}]}, "ramp of the change of speed"),
        (
            {"speed_change": [{"time": 0, "speed": "-10 % of top speed", "ramp": 1}]},
            "the speed of a change of speed is -",
        ),
        (
            {"speed_change": [{"time": 3, "speed": 1, "ramp": 1}]},
            "the time of a change of speed is 3",
        ),
    ):
        whole = {
            "name": "x",
            "duration": 2.0,
            "speed": 0,
            "speed_change": [{"time": 0, "speed": 1, "ramp": 1}],
            **more,
        }
        with pytest.raises(InvalidInput, match=message):
            read_scenario(whole)


def test_a_misspelt_table_is_told_its_name():
    with pytest.raises(InvalidInput, match="unknown key 'unbalanse'; did you mean \"unbalance\""):
        read_scenario({"name": "x", "duration": 1.0, "unbalanse": [{"port": "A", "amount": 1e-6}]})


@pytest.mark.parametrize("key", ["speed", "to_speed"])
def test_a_negative_speed_is_refused(key):
    """It passed, and the rig ran backwards."""
    given = {"speed": 100.0, "to_speed": 200.0, key: -1.0}
    with pytest.raises(InvalidInput, match=f"{key} is -1.*a rotor turns one way"):
        Scenario("back", 1.0, **given)


@pytest.mark.parametrize(
    "name",
    ["impulse-parallel", "impulse-train", "chirp-parallel", "static-loads-both", "seal-sines"],
)
def test_parallel_excitation_reaches_every_bearing_of_any_machine(name):
    """Of three bearings the middle one, too; of one bearing each direction once."""
    train = load_machine("three-bearing-train")
    for machine in (train, load_machine("flywheel"), load_machine("seal-rig")):
        windows = load_scenario(name).on(machine).all_windows
        driven = {item.signal.partition("_")[2].rpartition("_")[0] for item in windows}
        assert driven == {bearing.name for bearing in machine.bearings}
    assert len({(item.signal, item.start, item.amplitude) for item in windows}) == len(windows)
