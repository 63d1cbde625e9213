"""A rotor without a drawing, from the tests' own rig's responses between all axes."""

from dataclasses import replace
from functools import cache
from pathlib import Path as FilePath

import numpy as np
import pytest
from click.testing import CliRunner

import ambrose as amb
from ambrose.cli import main
from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import frequency_response
from ambrose.core.sampling import c2d
from ambrose.core.statespace import select
from ambrose.identification.measured_rotor import Layout, MeasuredLoop, places_of
from ambrose.identification.output_error.problem import deployed_controller
from ambrose.judge.controller_file import write_controller
from ambrose.machine.description import OperatingPoint
from ambrose.machine.part import MeasuredRotor, ShaftSection
from ambrose.model.assemble import assemble
from ambrose.model.effects.rotor import finite_element_rotor, free_modes, mass_properties
from ambrose.record.response_files import write_response
from analyser import Truth, matrices

FOLDER = FilePath(amb.__file__).parent / "machines"
# rate [Hz], free modes of the rig's rotor, the part of its highest speed to which its PID holds it
FLEET = {
    "seal-rig": (1e4, 16, 1.0),
    "flywheel": (1e4, 24, 1.0),
    "turbomolecular-pump": (2e4, 24, 1.0),
    "outboard-sensor-rotor": (1e4, 28, 1.0),
    "turboexpander": (4e4, 24, 0.15),
}


def bare(name, speed=0.0):
    """A bundled machine of whose rotor nothing is known but its mass and length."""
    known = amb.load_machine(name)
    mass = mass_properties(finite_element_rotor(known)).mass
    slim = min(section.outer_diameter for section in known.shaft)
    return replace(
        known,
        shaft=(ShaftSection(0.0, known.length, slim, elements=8),),
        discs=(),
        bending_modes=(),
        measured_rotor=MeasuredRotor(mass, speed=speed),
        operation=replace(
            known.operation,
            points=(OperatingPoint(speed, label="as measured"),),
            ranges=(),
            speed_range=(0.0, 0.0),
            design_point="",
        ),
        tolerances=tuple(one for one in known.tolerances if not one.around),
        requirements=replace(known.requirements, running_speeds=None),
    )


@cache
def found(name, turning=False, seed=3):
    """What responses tell, the truth, its controller and the sweep."""
    rate, modes, part = FLEET[name]
    known = amb.load_machine(name)
    speed = turning * part * max(point.speed for point in known.operation.points)
    law = amb.design(known, "pid").controller
    ran = matrices(law, rate)
    true = Truth.of(FOLDER / f"{name}.toml", rate, (0.05, -0.04), speed=speed, modes=modes)
    assert true.radius(ran) < 1
    top = min(5000.0, 0.16 * rate)
    sweep = true.sweep(name, ran, true.hertz(high=top), "T", seed=seed)
    return amb.identify(bare(name, speed), sweep, law), true, law, sweep


def errors(done, true):
    """Of K_i and K_s in stated deviations, by path."""
    own = dict(zip(true.rig.axes, true.rig.mag[:, 4:6], strict=True))
    errors = {}
    for row in done.parameters:
        if row.path.startswith("bearing."):
            _, bearing, quantity, axis = row.path.split(".")
            value = own[f"{bearing}_{axis}"][int(quantity == "negative_stiffness")]
            errors[row.path] = (row.value - value) / row.standard_deviation
    return errors


def plants(done, true):
    """The identified plant and the true one (w, a, a) at frequencies (w,) [Hz]."""
    hertz = np.geomspace(5, 1500, 200)
    plant = assemble(done.machine)
    inputs, outputs = ([f"{kind}_{axis}" for axis in plant.axes] for kind in "uy")
    held = c2d(select(plant.system, inputs, outputs), 1 / true.rate)
    return hertz, frequency_response(held, 2 * np.pi * hertz).values, true.plant(hertz)


def plant_error(done, true):
    """Of the identified plant beside the true one, relative, (w,) at frequencies (w,) [Hz]."""
    hertz, G, own = plants(done, true)
    return hertz, np.abs(G - own).max(axis=(1, 2)) / np.abs(own).max(axis=(1, 2))


def loop_error(done, true, law):
    """Of the sensitivity that the identified plant predicts, over the largest true one."""
    hertz, G, own = plants(done, true)
    K = true.controller(matrices(law, true.rate), hertz)
    S, true_S = (np.linalg.inv(np.eye(G.shape[1]) + plant @ K) for plant in (G, own))
    return np.abs(S - true_S).max() / np.abs(true_S).max()


def test_a_rotor_is_found_with_its_magnets():
    done, true, _, _ = found("seal-rig")
    assert len(errors(done, true)) == 8 and max(map(abs, errors(done, true).values())) < 3.5
    drawn = finite_element_rotor(amb.load_machine("seal-rig"))
    own, body = mass_properties(drawn), done.machine.measured_rotor
    assert body.centre == pytest.approx(own.centre, abs=2e-3)
    assert body.diametral_inertia == pytest.approx(own.diametral_inertia, rel=5e-3)
    modes = done.machine.bending_modes[:2]
    rates = free_modes(drawn, 2).frequencies[4::2]
    assert [mode.frequency for mode in modes] == pytest.approx(rates, rel=1e-3)
    assert [mode.damping for mode in modes] == pytest.approx([0.005, 0.005], rel=0.02)
    hertz, apart = plant_error(done, true)
    assert np.median(apart) < 5e-3 and apart[hertz < 1000].max() < 0.03
    assert any("holds at no other speed" in note for note in done.remarks)


def test_a_turning_rotor_whose_first_bending_mode_lies_beyond_the_lines():
    """A flywheel: nutation within the lines, which is no bending mode, and what all modes yield."""
    done, true, _, _ = found("flywheel", True)
    assert max(map(abs, errors(done, true).values())) < 3.5
    assert done.bending_modes == 0
    hertz, apart = plant_error(done, true)
    assert np.median(apart) < 5e-3 and apart[hertz < 1200].max() < 0.1
    body, own = done.machine.measured_rotor, amb.load_machine("flywheel")
    drawn = mass_properties(finite_element_rotor(own))
    assert body.polar_inertia == pytest.approx(drawn.polar_inertia, rel=5e-3)


def test_design_verify_and_export_work_with_it(tmp_path):
    done, true, _, _ = found("seal-rig")
    own = done.machine
    machine = replace(own, controller=replace(own.controller, sample_time=1 / true.rate))
    result = amb.design(machine, "tuned")
    verdict = amb.verify(machine, result, tolerances=False)
    assert verdict.stable and "as measured at 0 rpm" in verdict.rotor
    # on the tests' own rig, of which the design knows nothing but the sweep
    assert true.radius(matrices(result.controller, true.rate)) < 1
    file = amb.save_machine(machine, tmp_path / "found.toml")
    write_controller(tmp_path / "new.json", result)
    words = [str(tmp_path / "new.json"), "--to", "c", "--machine", str(file)]
    made = CliRunner().invoke(main, ["export", *words, "-o", str(tmp_path / "code")])
    assert made.exit_code == 0, made.stderr
    header = (tmp_path / "code" / "controller.h").read_text()
    assert "Valid      the rotor is as measured at 0 rpm and holds there alone." in header


def test_what_was_found_is_found_again():
    """From the machine with its modes, as an engineer repeats it after the next sweep."""
    done, _, law, sweep = found("seal-rig")
    again = amb.identify(done.machine, sweep, law)
    assert again.bending_modes == done.bending_modes == 2
    first, second = (np.array([row.value for row in one.parameters]) for one in (done, again))
    deviations = np.array([row.standard_deviation for row in done.parameters])
    assert (np.abs(first - second) < deviations).all()


def test_responses_of_each_axis_alone_are_refused(tmp_path):
    _, _, law, sweep = found("seal-rig")
    diagonal = replace(sweep, paths=tuple(p for p in sweep.paths if p.read == p.injected))
    with pytest.raises(InvalidInput, match="between its bearings"):
        amb.identify(bare("seal-rig"), diagonal, law)
    file = amb.save_machine(bare("seal-rig"), tmp_path / "machine.toml")
    write_response(diagonal, tmp_path / "sweep.csv")
    write_controller(tmp_path / "ran.json", law)
    words = [str(file), str(tmp_path / "sweep.csv"), "--controller", str(tmp_path / "ran.json")]
    done = CliRunner().invoke(main, ["identify", *words, "-o", str(tmp_path / "found.toml")])
    assert done.exit_code == 2 and "record all displacements" in done.stderr


def test_derivatives_are_those_of_the_loop():
    """Beside central differences of the sampled loop itself, a tied mode and a compliance within."""
    machine = bare("seal-rig")
    law = amb.design(amb.load_machine("seal-rig"), "pid").controller
    point = machine.operation.nominal
    paths = ("bearing.A.force_per_current.zeta", "bearing.B.negative_stiffness.eta")
    plant = assemble(machine, point)
    layout = Layout(machine, point, paths, places_of(machine))
    theta = layout.begin(np.array([150.0, 1.1e6]))
    for frequency, damping, phi in (
        (3456.0, 0.01, (0.1, 0.08, -0.07, 0.12)),
        (3e4, 0.7, (0.2, -0.1, 0.1, 0.2)),
    ):
        layout, theta = layout.with_mode(theta, np.array([frequency, damping, *phi]))
    assert layout.true_modes == 1 and layout.ties[0] is not None
    assert layout.shape(0, theta) == pytest.approx((0.1, 0.08, -0.07, 0.12))
    signals = (tuple(f"{kind}_{axis}" for axis in plant.axes) for kind in "ey")
    loop = MeasuredLoop(layout, deployed_controller(plant, law, 1e-4, 1), *signals)
    _, slopes = loop.loop(theta)
    values = replace(loop, slopes=False)
    step = 1e-5 * layout.scale(theta)
    for k, slope in enumerate(slopes):
        ends = [
            values.loop(theta + sign * step * (np.arange(len(theta)) == k))[0] for sign in (1, -1)
        ]
        for name in "ABC":
            ahead, behind = (getattr(end, name) for end in ends)
            expected = (ahead - behind) / (2 * step[k])
            size = np.abs(expected).max() + 1e-9 * np.abs(ahead).max() / step[k]
            assert np.abs(getattr(slope, name) - expected).max() < 1e-3 * size, (k, name)


@pytest.mark.study
@pytest.mark.parametrize("name", list(FLEET))
@pytest.mark.parametrize("turning", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_rotors_without_drawings(name, turning, seed):
    """None to four bending modes within the lines; K_i and K_s of eight axes and the plant."""
    done, true, law, _ = found(name, turning, seed)
    off, loop = errors(done, true), loop_error(done, true, law)
    hertz, apart = plant_error(done, true)
    modes = [f"{mode.frequency / (2 * np.pi):.4g}" for mode in done.machine.bending_modes]
    print(name, turning, seed, "largest error", max(map(abs, off.values())), "modes", modes)
    print("plant off: median", np.median(apart), "most", apart.max(), "at", hertz[apart.argmax()])
    print("sensitivity off", loop)
    # the loop hides where a turning rotor's undamped pole lies: beside it the plant is far off
    assert max(map(abs, off.values())) < 4 and loop < 0.05
    assert turning or np.median(apart) < 0.01
