"""`ambrose convert controller`: what comes out runs everywhere; wrong signs and units are
noticed.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
import scipy.io
import scipy.signal
from click.testing import CliRunner

import ambrose as amb
from ambrose.cli import main
from ambrose.core.frequency import frequency_response
from ambrose.core.sampling import c2d
from ambrose.law.pid import axes_controller
from ambrose.synthesis.design import not_held
from coarse import coarse_file

RIG = coarse_file("turbomolecular-pump", tolerances=False)
DT = 5e-5


def call(*words):
    return CliRunner().invoke(main, [str(word) for word in words])


SHORT = "name = 'short'\nduration = '0.3 s'\n" + "".join(
    f"[[prbs]]\nsignal = 'e_every_{way}'\namplitude = '20 mA'\nbit_time = '0.5 ms'\nseed = {seed}\n"
    for seed, way in enumerate(("zeta", "eta"))
)


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A MAT-file of the rig's own controller as a DSP runs it, from displacements in um to mA,
    without names.
    """
    folder = tmp_path_factory.mktemp("import")
    law = amb.design(RIG, "pid")
    amb.write_controller(folder / "pid.json", law)
    K = c2d(law.controller, DT, "tustin")
    scipy.io.savemat(
        folder / "dsp.mat", {"A": K.A, "B": -1e-3 * K.B, "C": K.C, "D": -1e-3 * K.D, "Ts": DT}
    )
    return folder


RIGHT = ("--input", "displacement", "--input-unit", "um", "--output-unit", "mA")


def test_a_controller_with_units_and_sign_is_the_one_that_it_came_from(place):
    path = place / "dsp.json"
    done = call(
        "convert",
        "controller",
        place / "dsp.mat",
        "--machine",
        RIG,
        *RIGHT,
        "--delay-samples",
        1,
        "-o",
        path,
        "--details",
    )
    assert done.exit_code == 0, done.output
    assert (
        "sampled at 20000 Hz" in done.output
        and "it holds turbomolecular-pump at every operating point" in done.output
    )
    omega = np.geomspace(1, 2e4, 20)
    back, own = amb.read_controller(path), amb.read_controller(place / "pid.json")
    expected = frequency_response(c2d(own.controller, DT, "tustin"), omega).values
    np.testing.assert_allclose(
        frequency_response(back.controller, omega).values, expected, rtol=1e-9, atol=1e-9
    )
    assert back.provenance.machine == "turbomolecular-pump"


@pytest.mark.parametrize(
    ("left_out", "words"),
    [
        (
            ("--input", "displacement"),
            "of the other sign (exchange input error and displacement: --input, or in its file), it would be stable everywhere",
        ),
        (("--input-unit", "um"), "in um (--input-unit um), it would be stable everywhere"),
        (
            ("--input", "displacement", "--input-unit", "um"),
            "of the other sign (exchange input error and displacement: --input, or in its file) and in um",
        ),
    ],
)
def test_a_wrong_sign_and_a_wrong_unit_are_noticed(place, tmp_path, left_out, words):
    kept = [word for word in RIGHT if word not in left_out]
    done = call(
        "convert",
        "controller",
        place / "dsp.mat",
        "--machine",
        RIG,
        *kept,
        "-o",
        tmp_path / "k.json",
        "--json",
    )
    told = json.loads(done.stdout)
    assert done.exit_code == 1 and told["held"] is False and (tmp_path / "k.json").exists()
    assert any(
        "the loop is unstable at" in problem and words in problem for problem in told["problems"]
    )


def test_channels_of_tilting_and_translating_are_taken(place, tmp_path):
    """A PID of the rotor's coordinates, channel by channel as its program has it, in A per mm."""
    machine = amb.load_machine(RIG)
    settings = replace(machine.reference, coordinates="tilt-translate", gain=(4e4,), tilt_gain=0.8)
    law = amb.design(replace(machine, controller=settings, tolerances=()), "pid")
    names = ("translate_x", "translate_y", "tilt_x", "tilt_y")
    alone = replace(settings, coordinates="axes", gain=(4e4, 4e4, 3.2e4, 3.2e4), tilt_gain=1.0)
    own = axes_controller(alone, names)
    K = c2d(own, DT, "tustin")
    told = {"inputs": list(names), "outputs": list(names), "sample_time": DT}
    told |= {key: getattr(K, key).tolist() for key in "AB"}
    told |= {key: (getattr(K, key) / 1e3).tolist() for key in "CD"}
    (tmp_path / "modal.json").write_text(json.dumps(told), encoding="utf-8")
    call_it = ["convert", "controller", tmp_path / "modal.json", "--machine", RIG]
    call_it += ["-o", tmp_path / "k.json"]
    wrong = call(*call_it)
    assert wrong.exit_code == 1 and "in mm (--input-unit mm), it would be stable" in wrong.output
    done = call(*call_it, "--input-unit", "mm", "--delay-samples", 1)
    assert done.exit_code == 0, done.output
    omega = np.geomspace(1, 2e4, 20)
    np.testing.assert_allclose(
        frequency_response(amb.read_controller(tmp_path / "k.json").controller, omega).values,
        frequency_response(c2d(law.controller, DT, "tustin"), omega).values,
        rtol=1e-9,
        atol=5e-5,  # 1e-10 of the gain, 4.6e5 A/m: channels that do not act on each other
    )


@pytest.mark.parametrize("kind", ["csv", "json"])
def test_sections_whose_feedback_has_the_other_sign_are_noticed(tmp_path, kind):
    """y = b0 x + b1 x' + b2 x'' + a1 y' + a2 y'', as CMSIS-DSP has it."""
    machine = amb.load_machine(RIG)
    settings = replace(machine.reference, coordinates="axes", tilt_gain=1.0)
    K = c2d(axes_controller(settings, machine.axes), DT, "tustin")
    sections = {}
    for n, axis in enumerate(machine.axes):
        k = np.flatnonzero(K.B[:, n])  # its own states
        one = scipy.signal.ss2zpk(
            K.A[np.ix_(k, k)], K.B[k][:, [n]], K.C[[n]][:, k], K.D[[n]][:, [n]]
        )
        sections[axis] = scipy.signal.zpk2sos(*one)

    def turned(rows, sign):
        return [[*row[:4], *(sign * row[4:])] for row in rows]

    for sign, status in ((1, 0), (-1, 1)):
        path = tmp_path / f"dsp.{kind}"
        if kind == "csv":
            rows = [
                f"{axis},{','.join(f'{value!r}' for value in map(float, row))},{1 / DT}"
                for axis, own in sections.items()
                for row in turned(own, sign)
            ]
            path.write_text("channel,b0,b1,b2,a0,a1,a2,rate_hz\n" + "\n".join(rows))
        else:
            channels = {axis: {"sos": turned(own, sign)} for axis, own in sections.items()}
            path.write_text(json.dumps({"rate_hz": 1 / DT, "channels": channels}))
        done = call("convert", "controller", path, "--machine", RIG, "-o", tmp_path / "k.json")
        assert done.exit_code == status, done.output
        assert ("--feedback added, or turn their signs" in done.output) == (sign < 0)
    words = ("--feedback", "added", "-o", tmp_path / "k.json")
    assert call("convert", "controller", path, "--machine", RIG, *words).exit_code == 0


def test_a_unit_that_nearly_holds_is_named(place):
    """With a filter that is too slow A per mm does not hold the rotor either, but it hardly
    leaves.
    """
    law = amb.read_controller(place / "pid.json")
    machine = amb.load_machine(RIG)
    slow = replace(law, controller=replace_gain(law.controller, 0.15e-3))
    (told,) = not_held(machine, slow)
    assert "in mm (--input-unit mm), still, but with" in told


def test_a_controller_that_no_sign_and_unit_holds(place):
    law = amb.read_controller(place / "pid.json")
    nothing = replace(law, controller=replace_gain(law.controller, 1e-12))
    machine = amb.load_machine(RIG)
    assert (
        "check the order of the axes" in not_held(machine, nothing)[0]
        and not_held(machine, law) == []
    )


def vendor_table(path, machine, channels=("translate_x", "translate_y", "tilt_x", "tilt_y")):
    """The rig's PID as a vendor writes it, translating and tilting in biquads at 20 kHz: sections
    of each channel.
    """
    settings = replace(machine.reference, coordinates="axes", tilt_gain=1.0)
    gains = (4e4, 4e4, 3.2e4, 3.2e4)
    K = c2d(axes_controller(replace(settings, gain=gains), channels), DT, "tustin")
    lines, sections = ["channel,b0,b1,b2,a0,a1,a2,rate_hz"], []
    for n, name in enumerate(channels):
        k = np.flatnonzero(K.B[:, n])  # its own states
        one = K.A[np.ix_(k, k)], K.B[k][:, [n]], K.C[[n]][:, k], K.D[[n]][:, [n]]
        sections.append(scipy.signal.zpk2sos(*scipy.signal.ss2zpk(*one)))
        lines += [f"{name},{','.join(repr(float(v)) for v in row)},20000" for row in sections[-1]]
    path.write_text("\n".join(lines) + "\n")
    return sections


def test_a_vendors_table_goes_in_wherever_a_controller_is_asked_for(tmp_path):
    machine = amb.load_machine(RIG)
    sections = vendor_table(tmp_path / "vendor.csv", machine)
    read = amb.read_controller(tmp_path / "vendor.csv", machine)

    # u = V k S^-1 y by hand: translation and tilt of the line through both sensors, in x and y
    places, at = (
        [item.position for item in group] for group in (machine.bearings, machine.sensors)
    )
    middle, half = np.mean(places), np.ptp(places) / 2
    S = np.array([[1.0, (z - middle) / half] for z in at])
    V = np.array([[1.0, (z - middle) / half] for z in places])
    V, S = (np.kron(M, np.eye(2)) for M in (V, S))  # isotropic: turning x, y into axes cancels
    omega = np.geomspace(1, 2e4, 20)
    k = [scipy.signal.freqz_sos(sos, worN=omega, fs=2 * np.pi / DT)[1] for sos in sections]
    expected = np.einsum("ic,cw,cj->wij", V, k, np.linalg.inv(S))
    np.testing.assert_allclose(
        frequency_response(read.controller, omega).values, expected, rtol=1e-9, atol=1e-4
    )

    # each command takes the table itself, and says the same of it as of the controller file
    amb.write_controller(tmp_path / "k.json", read)
    short, table = tmp_path / "short.toml", tmp_path / "vendor.csv"
    short.write_text(SHORT)
    for words in (
        ("verify", RIG, "--json", "--controller"),
        ("lateral", RIG, "--nominal", "--json", "--controller"),
        ("simulate", RIG, "--linear", "--scenario", short, "-o", tmp_path / "r.h5", "--controller"),
        ("export", "--to", "mat", "-o", tmp_path / "mat", "--machine", RIG, "--force", "--json"),
        ("identify", RIG, tmp_path / "r.h5", "-o", tmp_path / "m.toml", "--json", "--controller"),
    ):
        told = [call(*words, path) for path in (tmp_path / "k.json", table)]
        assert told[0].exit_code == told[1].exit_code < 2, told[1].output
        if words[0] in ("verify", "lateral"):
            first, second = (json.loads(one.stdout) for one in told)
            assert {**first, "controller": ""} == {**second, "controller": ""}
            assert "translate_x, translate_y, tilt_x, tilt_y act between the axes" in told[1].stderr
    assert amb.verify(RIG, table, points="full speed", tolerances=False).points[0].stable


def test_channels_that_no_machine_has_are_named_and_no_speed_is_blamed(tmp_path):
    machine = amb.load_machine(RIG)
    vendor_table(tmp_path / "v.csv", machine, ("V13", "W13", "V24", "W24"))
    for words in (("verify", RIG, "--controller"), ("lateral", RIG, "--controller")):
        done = call(*words, tmp_path / "v.csv")
        assert done.exit_code == 2 and "trip" not in done.stderr
        assert "the axes of the controller is V13, W13, V24, W24" in done.stderr
        assert "--axes of ambrose convert controller" in done.stderr
    axes = ",".join(("translate_x", "translate_y", "tilt_x", "tilt_y"))
    done = call("convert", "controller", tmp_path / "v.csv", "-o", tmp_path / "k.json")
    assert done.exit_code == 2 and not (tmp_path / "k.json").exists()
    words = ("--axes", axes, "-o", tmp_path / "k.json")
    assert call("convert", "controller", tmp_path / "v.csv", *words).exit_code == 0
    assert amb.read_controller(tmp_path / "k.json", machine).controller.inputs == tuple(
        f"err_{axis}" for axis in machine.axes
    )


def replace_gain(K, factor):
    return amb.StateSpace(K.A, K.B * factor, K.C, K.D * factor, K.inputs, K.outputs, K.dt)


@pytest.mark.usefixtures("values_alone")
def test_it_runs_in_verify_simulate_identify_and_export(place):
    path, record = place / "run.json", place / "run.h5"
    call(
        "convert",
        "controller",
        place / "dsp.mat",
        "--machine",
        RIG,
        *RIGHT,
        "--delay-samples",
        1,
        "-o",
        path,
    )
    short = place / "short.toml"
    short.write_text(SHORT)
    assert (
        "sampled at 20 kHz, one sample of delay (from the controller file)"
        in call("verify", RIG, "--controller", path).stdout
    )
    assert (
        call(
            "simulate", RIG, "--controller", path, "--scenario", short, "--linear", "-o", record
        ).exit_code
        == 0
    )
    unknown = ("--unknown", "bearing.*.negative_stiffness.*")
    done = call("identify", RIG, record, "--controller", path, *unknown, "-o", place / "m.toml")
    assert done.exit_code in (0, 1), done.stderr
    assert call(
        "export", path, "--to", "mat", "-o", place / "mat", "--machine", RIG, "--force"
    ).exit_code in (0, 1)
    again = call(
        "convert",
        "controller",
        place / "mat" / "controller.mat",
        "--machine",
        RIG,
        "-o",
        place / "again.json",
    )
    assert again.exit_code == 0, again.output


@pytest.mark.parametrize("method", ["tustin", "zoh", "backward-euler", "matched"])
def test_a_continuous_controller_is_sampled(place, tmp_path, method):
    words = ("--sampling", method, "--rate-hz", 40000, "-o", tmp_path / "k.json")
    if method == "matched":  # the rig's own controller mixes its axes
        rows = "A_zeta,3 600,1 900\nA_eta,3 600,1 900\n"
        (tmp_path / "pid.csv").write_text(f"channel,b,a\n{rows}")
        source = tmp_path / "pid.csv"
    else:
        source = place / "pid.json"
    done = call("convert", "controller", source, *words)
    assert done.exit_code == 0, done.output
    expected = c2d(amb.read_controller(source).controller, 1 / 40000, method)
    omega = np.geomspace(1, 2e4, 20)
    found = amb.read_controller(tmp_path / "k.json").controller
    np.testing.assert_allclose(
        *(frequency_response(one, omega).values for one in (found, expected)), rtol=1e-12
    )


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ("dsp.mat",),
            "its 4 channels have no names; name their axes in this order (--axes, or --machine)",
        ),
        (("dsp.mat", "--axes", "a,b"), "the number of axes is 2 (a, b), but must be 4"),
        (
            ("dsp.mat", "--axes", "a,b,c,d", "--machine", RIG),
            "the axes of the controller is a, b, c, d, but must be those of",
        ),
        (("pid.json", "--sampling", "tustin"), "--sampling needs the rate"),
        (
            ("pid.json", "--input-unit", "um"),
            "input_unit was stated, but a file of this package states it already",
        ),
        (
            ("dsp.mat", "--axes", "A_x,A_y,B_x,B_y"),
            "the list of its channels is A_x, A_y, B_x, B_y, but must be pairs as A_zeta, A_eta",
        ),
        (
            ("dsp.mat", "--machine", RIG, "--sampling", "zoh", "--rate-hz", "20000"),
            "it is sampled already, at 20000 Hz",
        ),
        (("pid.json", "--prewarp-hz", "100"), "--prewarp-hz goes with --sampling"),
        (("none.csv",), "none.csv"),
    ],
)
def test_what_is_refused(place, tmp_path, words, message):
    done = call("convert", "controller", place / words[0], *words[1:], "-o", tmp_path / "k.json")
    assert done.exit_code == 2 and message in done.stderr and not (tmp_path / "k.json").exists()
