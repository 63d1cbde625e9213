"""`ambrose identify`: from a record of the rig to a machine file that the other commands take;
refusals, exit status, JSON.
"""

import json
import signal
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from ambrose import load_machine
from ambrose.cli import main
from ambrose.machine.file.toml import machine_hash, read_machine_text
from ambrose.record.files import read_record, write_record
from coarse import coarse_file

RIG = coarse_file("seal-rig")
NINE = ("--unknown", "bearing.*.force_per_current.*", "--unknown", "bearing.*.negative_stiffness.*")
QUICK = """
name = "short"
duration = "1.2 s"
""" + "".join(
    f'\n[[prbs]]\nsignal = "e_{axis}"\namplitude = "0.1 A"\nbit_time = "1 ms"\norder = 9\nseed = '
    f"{seed}\n"
    for seed, axis in enumerate(("A_zeta", "A_eta", "B_zeta", "B_eta"))
)


def call(*arguments):
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with the bundled PID and two records of the rig that it levitated."""
    folder = tmp_path_factory.mktemp("identify")
    (folder / "short.toml").write_text(QUICK)
    assert (
        call("synthesize", RIG, "--method", "pid", "-o", folder / "pid.json", "--json").exit_code
        == 1  # it loses twice nominal pressure
    )
    done = call(
        "simulate",
        RIG,
        "--controller",
        folder / "pid.json",
        "--scenario",
        folder / "short.toml",
        "-o",
        folder / "one.h5",
        "--json",
    )
    assert done.exit_code == 0, done.stderr
    record = read_record(folder / "one.h5")
    rng = np.random.default_rng(0)
    again = record.values.copy()
    again[:4] += 2e-9 * rng.standard_normal(again[:4].shape)
    write_record(replace(record, values=again), folder / "two.h5")
    return folder


@pytest.fixture(scope="module")
def identified(place):
    out = place / "identified.toml"
    page = place / "page.html"
    done = call(
        "identify",
        RIG,
        place / "one.h5",
        "--controller",
        place / "pid.json",
        "-o",
        out,
        "--report",
        page,
    )
    return done, out, page


@pytest.mark.usefixtures("values_alone")
def test_the_chain_from_a_record_to_a_controller(identified, tmp_path):
    done, out, page = identified
    # 1: the magnets' curvature may show in the residuals; not where what is missing moves the
    # values by no more than their intervals, which are widened by it
    assert done.exit_code in {0, 1}, done.stderr
    missing = "still follows" in done.stdout and "the intervals include" not in done.stdout
    assert (done.exit_code == 0) == ("Warning" not in done.stdout and not missing)
    assert (
        "unknown: bearing.A.force_per_current.zeta" in done.stderr
        and "seal.center.k" in done.stderr
    )
    assert (
        "bearing.A.negative_stiffness.zeta" in done.stdout
        and "95 % interval" in done.stdout
        and "Verdict" in done.stdout
    )
    before, after = load_machine(RIG), load_machine(out)
    assert machine_hash(after) != machine_hash(before)
    assert after.bearings[0].force_per_current == pytest.approx(
        before.bearings[0].force_per_current, rel=0.03
    )
    assert after.bearings[0].negative_stiffness == pytest.approx(
        before.bearings[0].negative_stiffness, rel=0.01
    )
    assert after.bearings[0].coefficients_at == "static-load"
    assert "identified" in after.source and "from one.h5 with pid.json" in after.source
    assert out.read_text().startswith("# Identified ")
    kept = [line for line in read_machine_text(RIG).splitlines() if "#" in line or " mm" in line]
    assert all(
        line in out.read_text()
        for line in kept
        if not line.startswith(("force_per", "negative_stiff"))
    )
    assert "]      # N/A\n" in out.read_text() and "]   # N/m\n" in out.read_text()
    assert len(after.tolerances) == 10
    text = page.read_text()
    assert (
        "<html" in text
        and "Correlation and column cosine" in text
        and "http" not in text.split("<script")[0]
    )
    assert call("check", out).exit_code == 0
    made = call("synthesize", out, "--method", "pid", "-o", tmp_path / "again.json", "--json")
    # as the machine it was identified on, it loses twice nominal pressure
    assert made.exit_code == 1 and json.loads(made.stdout)["status"] == "verified", made.stderr
    assert "twice nominal pressure" in made.stdout + made.stderr


@pytest.mark.usefixtures("values_alone")
def test_json_and_repeats(place, tmp_path):
    done = call(
        "identify",
        RIG,
        place / "one.h5",
        place / "two.h5",
        "--controller",
        place / "pid.json",
        *NINE,
        "--repeats",
        "--json",
        "-o",
        tmp_path / "m.toml",
    )
    found = json.loads(done.stdout)
    assert done.exit_code == (0 if found["good"] else 1)
    assert len(found["parameters"]) == 8 and found["parameters"][0]["unit"] == "N/A"
    assert {item["record"] for item in found["fit_percent"]} == {1, 2}
    assert (
        found["repeats"]["count"] == 2
        and found["machine_file"] == str(tmp_path / "m.toml")
        and found["report"] is None
    )
    assert np.array(found["correlation"]).shape == (8, 8)


def test_the_youla_residual_from_the_command_line(place, identified, tmp_path):
    """The same K_i within a percent, compared with the file of the first method, and the page has
    the residual system.
    """
    page, out = tmp_path / "y.html", tmp_path / "y.toml"
    rest = ("--method", "youla", "--compare", identified[1], "--report", page, "-o", out, "--json")
    done = call("identify", RIG, place / "one.h5", "--controller", place / "pid.json", *NINE, *rest)
    assert done.exit_code in {0, 1}, done.stderr
    found = json.loads(done.stdout)
    assert (
        (done.exit_code == 0) == found["good"]
        and found["method"] == "youla"
        and found["controller_error"] < 1e-6
    )
    assert [row["path"] for row in found["compared"]] == [
        row["path"] for row in found["parameters"]
    ]
    assert all(abs(row["difference_percent"]) < 1 for row in found["compared"][:4])
    assert "by the Youla residual" in load_machine(out).source
    assert found["fit_percent"][0]["signal"] == "eps_y_A_zeta"
    text = page.read_text()
    assert (
        "Residual system" in text
        and "Beside the other file" in text
        and "Identification through the Youla residual" in text
    )


def test_static_loads_from_the_command_line(place, identified, tmp_path):
    """Loads in the middle: K_i within 2 % of what the closed loop gave, in the same file, tables
    and JSON.
    """
    lines, time = [], 1.0
    for angle in np.pi / 4 + np.pi / 2 * np.arange(4):
        for size in (60.0, 120.0):
            for way, share in (("x", np.cos(angle)), ("y", np.sin(angle))):
                lines.append(
                    f'\n[[pulse]]\nsignal = "f_center_{way}"\namplitude = "{size * share:.6f} N"'
                )
                lines.append(f'start = "{time:.1f} s"\nduration = "1 s"')
            time += 1.0
    (tmp_path / "loads.toml").write_text(
        f'name = "loads"\nduration = "{time:.1f} s"\n' + "\n".join(lines) + "\n"
    )
    ran = (
        "--controller",
        place / "pid.json",
        "--scenario",
        tmp_path / "loads.toml",
        "--point",
        "zero",
        "--json",
    )
    assert call("simulate", RIG, *ran, "-o", tmp_path / "loads.h5").exit_code == 0
    page, out = tmp_path / "s.html", tmp_path / "s.toml"
    rest = (
        "--method",
        "static",
        "--average",
        0.2,
        "--compare",
        identified[1],
        "--report",
        page,
        "-o",
        out,
    )
    done = call("identify", RIG, tmp_path / "loads.h5", *rest)
    assert done.exit_code == 0, done.stderr + done.stdout
    assert (
        "Force per current" in done.stdout
        and "Beside the other file" in done.stdout
        and "Verdict" in done.stdout
    )
    after, closed = load_machine(out), load_machine(identified[1])
    for mine, other in zip(after.bearings, closed.bearings, strict=True):
        assert mine.force_per_current == pytest.approx(other.force_per_current, rel=0.02)
    assert "by static loads from loads.h5" in after.source and out.read_text().startswith(
        "# Identified "
    )
    assert "Force beyond the straight line" in page.read_text()
    twice = (
        "identify",
        RIG,
        tmp_path / "loads.h5",
        tmp_path / "loads.h5",
        "--repeats",
        "--json",
        *rest[:4],
        "-o",
        out,
    )
    again = call(*twice)
    found = json.loads(again.stdout)
    assert (
        again.exit_code == 0
        and found["method"] == "static"
        and found["repeats"]["count"] == 2
        and found["compared"] is None
    )
    assert found["parameters"][0]["unit"] == "N/A" and found["parameters"][0]["at_rest"] > 100
    refused = call(
        "identify", RIG, place / "one.h5", "--method", "static", "-o", tmp_path / "no.toml"
    )
    assert (
        refused.exit_code == 2
        and "have no load" in refused.stderr
        and not (tmp_path / "no.toml").exists()
    )


@pytest.mark.study
def test_a_seal_by_pressure_from_the_command_line(tmp_path, place):
    """Records of the rig at three pressures; the machine that results holds the line, and goes
    through the other commands.
    """
    from ambrose.machine.description import OperatingPoint
    from ambrose.machine.file.toml import dumps_machine

    rig = load_machine(RIG)
    points = tuple(OperatingPoint(seal_pressure=p, label=f"p{p:g}") for p in (1.4e5, 0.0, 0.7e5))
    (tmp_path / "rig.toml").write_text(
        dumps_machine(replace(rig, tolerances=(), operation=replace(rig.operation, points=points)))
    )
    files = []
    for point in points:
        files.append(tmp_path / f"{point.label}.h5")
        ran = (
            "--controller",
            place / "pid.json",
            "--scenario",
            place / "short.toml",
            "--point",
            point.label,
        )
        assert (
            call("simulate", tmp_path / "rig.toml", *ran, "-o", files[-1], "--json").exit_code == 0
        )
    page, out = tmp_path / "seal.html", tmp_path / "seal.toml"
    rest = (
        "--controller",
        place / "pid.json",
        "--seal-fit",
        "line",
        "--report",
        page,
        "-o",
        out,
        "--json",
    )
    done = call("identify", tmp_path / "rig.toml", *files, *rest)
    assert done.exit_code in {0, 1}, done.stderr
    found = json.loads(done.stdout)
    assert found["seal"]["note"] == ""
    assert (
        found["seal"]["pressure"] == [0.0, 0.7e5, 1.4e5] and found["point"]["seal_pressure_pa"] == 0
    )
    k = found["seal"]["lines"]["k"]
    assert k["slope"] * 2.04e5 == pytest.approx(rig.seals[0].k, rel=0.01)
    after = load_machine(out)
    assert dict(after.seals[0].table.values)["k"][1] == pytest.approx(
        k["intercept"] + 1.4e5 * k["slope"]
    )
    assert (
        "seal center as a line over 3 pressures" in after.source
        and "pressure by pressure" in out.read_text()
    )
    text = page.read_text()
    assert (
        "Seal center by pressure" in text
        and "lines over pressure" in text
        and "coefficients against pressure" in text
    )
    assert call("check", out).exit_code == 0
    together = call(
        "identify",
        tmp_path / "rig.toml",
        *files,
        *rest[:2],
        *NINE,
        "--unknown",
        "seal.center.k",
        "-o",
        out,
    )
    assert (
        together.exit_code in {0, 1}
        and "3 seal pressures, fitted together: --seal-fit line" in together.stderr
    )
    shown = call("identify", tmp_path / "rig.toml", *files, *rest[:3], "table", "-o", out)
    assert shown.exit_code == done.exit_code and "Seal center by pressure" in shown.stdout


def test_what_did_not_converge_is_doubtful_everywhere(place, tmp_path, monkeypatch):
    from ambrose.identification.output_error import closed_loop

    fit = closed_loop.fit

    def lame(experiment, start=None):
        return fit(
            replace(experiment, options=replace(experiment.options, max_iterations=1)), start
        )

    monkeypatch.setattr(closed_loop, "fit", lame)
    page = tmp_path / "page.html"
    start = ("--start", "bearing.A.negative_stiffness.zeta=0.75e6")
    done = call(
        "identify",
        RIG,
        place / "one.h5",
        "--controller",
        place / "pid.json",
        *NINE,
        *start,
        "-o",
        tmp_path / "m.toml",
        "--report",
        page,
    )
    assert done.exit_code == 1, done.stderr
    assert "Verdict: NOT CONVERGED" in done.stdout and "Warning: not converged after" in done.stdout
    assert (
        "(NOT converged)" in load_machine(tmp_path / "m.toml").source
        and "NOT converged" in page.read_text()
    )


def swapped(record):
    values = record.values.copy()
    values[[0, 1]] = values[[1, 0]]
    return replace(record, values=values)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (swapped, "channels are mixed up: y_A_zeta and y_A_eta are swapped"),
        (
            lambda r: replace(r, sample_rate_hz=5000.0),
            "not sampled at 5000 Hz, as they say, but at about 10000 Hz",
        ),
        (lambda r: r.select([name for name in r.signals if name[0] != "e"]), "holds no excitation"),
        (
            lambda r: replace(
                r, signals=tuple(name.replace("e_A_zeta", "e_DE") for name in r.signals)
            ),
            "the excitation 'e_DE' of record 1 is unknown, but must be one of e_A_zeta, e_A_eta, "
            "e_B_zeta, e_B_eta; rename it",
        ),
        (lambda r: replace(r, machine="other"), "the machine of record 1 is 'other'"),
    ],
)
def test_records_that_are_refused(place, tmp_path, change, words):
    write_record(change(read_record(place / "one.h5")), tmp_path / "bad.h5")
    done = call(
        "identify",
        RIG,
        tmp_path / "bad.h5",
        "--controller",
        place / "pid.json",
        "-o",
        tmp_path / "m.toml",
    )
    assert done.exit_code == 2 and words in done.stderr and "Traceback" not in done.stderr
    assert not (tmp_path / "m.toml").exists()


def test_gaps_and_uneven_times_are_refused_when_reading(place, tmp_path):
    record = read_record(place / "one.h5").between(0, 0.02)
    path = write_record(record, tmp_path / "uneven.csv")
    lines = path.read_text().splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith("time"))
    gap = "\n".join([*lines[: first + 50], *lines[first + 53 :]]).replace(
        "# samples: 200", "# samples: 197"
    )
    path.write_text(gap + "\n")
    done = call(
        "identify", RIG, path, "--controller", place / "pid.json", "-o", tmp_path / "m.toml"
    )
    assert done.exit_code == 2 and "uneven.csv" in done.stderr and "time" in done.stderr
    cells = lines[first + 60].split(",")
    cells[3] = "nan"
    lines[first + 60] = ",".join(cells)
    path.write_text("\n".join(lines) + "\n")
    done = call(
        "identify", RIG, path, "--controller", place / "pid.json", "-o", tmp_path / "m.toml"
    )
    assert done.exit_code == 2 and "y_B_zeta at sample 59" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--unknown", "bearing.C.force_per_current.zeta"), 'unknown bearing "C"'),
        (("--start", "seal.center.k"), "--start is 'seal.center.k', but must be PATH=VALUE"),
        (("--start", "seal.center.k=much"), "PATH=VALUE with a number"),
        (
            ("--start", "bearing.A.negative_stiffness.zeta=9e6"),
            "the loop at the start values is unstable",
        ),
        (("--signals", "y_C"), "a fitted signal is 'y_C'"),
        (("--delay-samples", "-1"), "--delay-samples is -1"),
        (("--bending-modes", "-1"), "bending"),
        (("--repeats",), "at least 2 for repeats"),
        (("-o", "missing/m.toml"), "missing is not a directory"),
        (
            ("--method", "youla", "--signals", "y_A_zeta"),
            "--signals is given, but must be left out with --method youla; it goes with closed-loop",
        ),
        (
            ("--method", "youla", "--unknown", "delay"),
            "controller.delay as an unknown goes with the method closed-loop",
        ),
        (
            ("--method", "youla", "--delay-samples", "1.5"),
            "computing_delay is 1.5, but must be a whole number",
        ),
        (("--method", "youla", "--seal-fit", "line"), "it goes with closed-loop"),
        (("--method", "static"), "it goes with closed-loop or youla: static loads give"),
        (("--average", "0.2"), "it goes with static: the closed loop is fitted"),
        (("--seal-fit", "line", "--repeats"), "--repeats does not go with --seal-fit"),
        (
            ("--seal-fit", "line"),
            "the number of seal pressures for a line is 1, but must be at least 3",
        ),
        (("--seal", "center"), "seal names the seal of seal_form (--seal-fit)"),
        (("--compare", "turboexpander"), "the machine to compare with is 'turboexpander'"),
    ],
)
def test_arguments_that_are_refused(place, arguments, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = call(
        "identify", RIG, place / "one.h5", "--controller", place / "pid.json", *NINE, *arguments
    )
    assert done.exit_code == 2 and words in done.stderr and "Traceback" not in done.stderr, (
        done.stderr
    )


def test_another_machine_to_compare_with_is_refused_before_a_record_is_read(place):
    """It took the whole identification."""
    words = (RIG, "absent.h5", "--controller", place / "pid.json", "--compare", "turboexpander")
    done = call("identify", *words)
    assert done.exit_code == 2 and "the machine to compare with is 'turboexpander'" in done.stderr


def test_a_loop_is_not_modelled_without_its_controller(place, tmp_path):
    done = call("identify", RIG, place / "one.h5", "-o", tmp_path / "m.toml")
    assert done.exit_code == 2 and "--controller is missing" in done.stderr


def test_interruption_leaves_no_file(place, tmp_path):
    out = tmp_path / "m.toml"
    # a shell's background job ignores the signal, and so would what it starts
    command = (
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); from ambrose.cli "
        "import main; main()"
    )
    arguments = ["identify", RIG, place / "one.h5", "--controller", place / "pid.json", "-o", out]
    run = subprocess.Popen(
        [sys.executable, "-c", command, *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    seen = run.stderr.readline()
    while seen and "checking the records" not in seen:
        seen = run.stderr.readline()
    run.send_signal(signal.SIGINT)
    _, rest = run.communicate(timeout=300)
    assert run.returncode == 130 and "interrupted" in rest and "Traceback" not in rest
    assert list(tmp_path.iterdir()) == []
