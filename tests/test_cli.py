"""The command line: exit status, one JSON object, one clear message and no traceback for bad
input.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from ambrose.cli import main
from ambrose.code.c.compiled import has_compiler
from ambrose.core.checks import InvalidInput, NumericalFailure
from ambrose.machine.file.toml import bundled_machines
from ambrose.synthesis.design import design
from coarse import coarse_text

RIG = "seal-rig"


def call(*arguments):
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def controller(tmp_path_factory):
    path = tmp_path_factory.mktemp("controller") / "controller.json"
    done = call("synthesize", RIG, "--method", "pid", "-o", path, "--json")
    assert done.exit_code == 1, done.stderr  # it does not hold twice nominal pressure
    summary = json.loads(done.stdout)
    assert summary["status"] == "verified" and summary["states"] == 8
    return path


@pytest.fixture(
    scope="module",
    params=[
        ("tuned", "pid", "hinf"),
        pytest.param(("tuned", "pid", "hinf", "mu", "polish"), marks=pytest.mark.study),
    ],
    ids=len,
)
def study(request, tmp_path_factory):
    """The methods, the folder of a study by them, and what came of the command."""
    directory = tmp_path_factory.mktemp("study")
    machine = tmp_path_factory.mktemp("machine") / "rig.toml"
    machine.write_text(coarse_text(RIG), encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "ambrose.chain.commissioning.METHOD", "hinf"
        )  # for the identified machine: half a minute less than "polish"
        patch.setattr("ambrose.chain.study.methods_for", lambda plant: request.param)
        # what the model may lack is looked for in tests of its own
        patch.setattr("ambrose.identification.loop.suspects", lambda *given, **how: ())
        return request.param, directory, call("study", machine, "-o", directory, "--json")


def test_machines():
    assert list(json.loads(call("machines", "--json").stdout)) == list(bundled_machines())
    assert all(name in call("machines").stdout for name in bundled_machines())


def test_a_bundled_scenario_is_printed_to_copy(controller, tmp_path):
    """And what was printed runs as it does by name."""
    path = tmp_path / "own.toml"
    path.write_text(call("scenarios", "impulse-parallel").stdout, encoding="utf-8")
    assert (
        json.loads(call("scenarios", "impulse-parallel", "--json").stdout)["text"].strip()
        == path.read_text().strip()
    )
    arguments = ("simulate", RIG, "--controller", controller, "--linear", "--json", "--scenario")
    outcomes = [
        json.loads(call(*arguments, name, "-o", tmp_path / "x.h5").stdout)
        for name in (path, "impulse-parallel")
    ]
    assert outcomes[0]["outcome"] == outcomes[1]["outcome"]
    done = call("scenarios", "impulse-paralel")
    assert done.exit_code == 2 and "impulse-parallel" in done.stderr


@pytest.mark.parametrize(
    "option", [("--seed", 1), ("--bending-modes", 2), ("--second", "{controller}")]
)
def test_options_of_the_rig_are_refused_with_linear(controller, option, tmp_path):
    given = [str(value).format(controller=controller) for value in option]
    arguments = ("--scenario", "impulse-parallel", "--linear", "-o", tmp_path / "x.h5")
    done = call("simulate", RIG, "--controller", controller, *arguments, *given)
    assert done.exit_code == 2 and option[0] in done.stderr and "--linear" in done.stderr


def test_check_tells_the_printed_figures():
    facts = json.loads(call("check", RIG, "--json").stdout)
    assert facts["mass_kg"] == pytest.approx(69.0, rel=1e-3)
    assert facts["bending_rad_s"][0] / 6.283185307179586 == pytest.approx(550.0, rel=1e-3)
    assert (facts["rotor_states"], facts["reduced_rotor_states"]) == (144, 8)
    assert "69 kg" in call("check", RIG).stdout


@pytest.mark.parametrize("method", ["hinf", pytest.param("mu", marks=pytest.mark.study)])
def test_robust_methods_are_certified_on_the_full_plant(method, tmp_path):
    done = call("synthesize", RIG, "--method", method, "-o", tmp_path / "c.json", "--json")
    assert done.exit_code == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["certificate"]["margins"]["full_spectral_abscissa"] < 0
    assert abs(found["certificate"]["margins"]["direct_gain_mismatch"]) < 0.02
    assert json.loads((tmp_path / "c.json").read_text())["method"] == method


@pytest.mark.parametrize(
    ("words", "informed"),
    [
        ((), False),
        (("--details",), False),
        (("--all",), True),
        (("--json",), True),
        (("--report", "page.html"), True),
    ],
)
def test_verify_computes_what_has_no_limit_where_it_is_shown(
    words, informed, controller, tmp_path, monkeypatch
):
    asked = []

    def around(*given, **options):
        asked.append(options["informed"])
        return ()

    monkeypatch.setattr("ambrose.judge.verdict.verify_tolerances", around)
    monkeypatch.chdir(tmp_path)
    call("verify", RIG, "--controller", controller, *words)
    assert asked == [informed]


def test_verify_fails_a_check_with_status_1(controller):
    done = call("verify", RIG, "--controller", controller, "--json")
    assert done.exit_code == 1
    points = {point["label"]: point for point in json.loads(done.stdout)["points"]}
    assert points["zero pressure"]["passed"]
    assert not points["twice nominal pressure"]["stable"]
    printed = call("verify", RIG, "--controller", controller).stdout
    assert printed.startswith("FAILED: ") and "Unstable: twice nominal pressure" in printed


def test_simulate_writes_a_record(controller, tmp_path):
    from ambrose.record.files import read_record

    path = tmp_path / "record.h5"
    other = f"note: {controller} was made for another machine, seal-rig;"
    for machine, note in ((RIG, ""), ("seal-rig-k-only", other)):
        rest = (
            "--controller",
            controller,
            "--scenario",
            "impulse-parallel",
            "--linear",
            "-o",
            path,
            "--json",
        )
        done = call("simulate", machine, *rest)
        assert done.exit_code == 0, done.stderr
        assert json.loads(done.stdout)["outcome"] == "completed"
        assert note in done.stderr and ("note: " in done.stderr) == bool(note)
        assert "y_A_zeta" in read_record(path).signals


def test_simulate_reports_divergence_with_status_1(controller, tmp_path):
    arguments = [
        "--scenario",
        "impulse-parallel",
        "--linear",
        "--point",
        "twice nominal pressure",
        "-o",
        tmp_path / "r.h5",
    ]
    done = call("simulate", RIG, "--controller", controller, *arguments, "--json")
    assert done.exit_code == 1
    assert json.loads(done.stdout)["outcome"] == "diverged"


def test_simulate_runs_the_virtual_rig(controller, tmp_path):
    from ambrose.record.files import read_record

    path = tmp_path / "record.h5"
    done = call(
        "simulate",
        RIG,
        "--controller",
        controller,
        "--scenario",
        "impulse-parallel",
        "-o",
        path,
        "--json",
    )
    assert done.exit_code == 0, done.stderr
    assert json.loads(done.stdout)["outcome"] == "completed"
    assert {"y_A_zeta", "f_magnet_A_zeta"} <= set(read_record(path).signals)
    arguments = ["--scenario", "impulse-parallel", "--point", "twice nominal pressure", "-o", path]
    done = call("simulate", RIG, "--controller", controller, *arguments, "--json")
    assert done.exit_code == 1
    assert "touchdown at" in json.loads(done.stdout)["text"]


def test_study_compares_the_controllers(study):
    methods, directory, done = study
    assert done.exit_code == 0, done.stderr  # the tuned controller meets every check
    made = {f"controller-{method}.json" for method in methods} | {"checks.json", "report.html"}
    assert {path.name for path in directory.iterdir()} == made | {"commissioned"}
    found = json.loads(done.stdout)
    assert found["best"] == "tuned"
    assert found["commissioned"]["compiled"] is has_compiler()
    # the code holds the rig at every pressure
    assert set(found["commissioned"]["rig"].values()) == {"completed"}
    # and from rest to pressure and back
    assert found["commissioned"]["cycle"]["outcome"] == "completed"
    stable = {
        name: [point["stable"] for point in c["points"]] for name, c in found["controllers"].items()
    }
    assert stable.pop("PID") == [True, True, False]
    assert set(map(tuple, stable.values())) == {(True, True, True)}
    worst = {
        name: next(
            check["value"]
            for check in c["boxes"][0]["checks"]
            if check["name"] == "robust.sensitivity.worst"
        )
        for name, c in found["controllers"].items()
    }
    assert worst["PID"] == "inf"
    order = [name for name in ("H-infinity", "mu", "mu, polished", "tuned") if name in worst]
    assert len(order) == len(methods) - 1
    peaks = [worst[name] for name in order]
    assert peaks == sorted(set(peaks), reverse=True)
    page = (directory / "report.html").read_text()
    for words in ("seal-rig", "nominal pressure", "unstable", "H-infinity", "Chosen, not measured"):
        assert words in page


def at_one_point(text):
    """A machine file with the first of its operating points, the nominal one."""
    second = text.index("[[operation.point]]", text.index("[[operation.point]]") + 1)
    return text[:second] + text[text.index("[[tolerance]]") :]


def test_study_resumes_with_a_kept_controller_and_redesigns_a_damaged_one(tmp_path, monkeypatch):
    def elsewhere(*arguments):
        raise InvalidInput("commissioning has tests of its own")

    monkeypatch.setattr("ambrose.chain.study.methods_for", lambda plant: ("pid",))
    monkeypatch.setattr("ambrose.chain.study.commission", elsewhere)
    text = at_one_point(coarse_text(RIG))
    machine = tmp_path / "pid-only.toml"
    # requirements, weights and tolerances stand last
    machine.write_text(text[: text.index("[[tolerance]]")])
    assert call("study", machine, "-o", tmp_path / "out", "--json").exit_code == 1
    assert {p.name for p in (tmp_path / "out").iterdir()} == {
        "controller-pid.json",
        "checks.json",
        "report.html",
    }
    path = tmp_path / "out" / "controller-pid.json"
    before = path.read_bytes()
    assert call("study", machine, "-o", tmp_path / "out", "--json").exit_code == 1
    assert path.read_bytes() == before
    page = (tmp_path / "out" / "report.html").read_text()
    # the certificate's plant is named once, however often it is taken up
    assert "88 states; seal-rig" not in page
    path.write_bytes(before[:100])
    done = call("study", machine, "-o", tmp_path / "out")
    assert done.exit_code == 1
    assert json.loads(path.read_text())["A"] == json.loads(before)["A"]
    # the page's verdict comes first on the screen, once
    screen = done.stdout.splitlines()
    assert screen[0] and screen[0][:40] in (tmp_path / "out" / "report.html").read_text()
    assert not [line for line in screen[1:] if line.startswith(screen[0][:40])]
    assert any(line.startswith("Report: ") for line in screen)


def test_an_infeasible_design_leaves_the_other_controllers_their_verdict(tmp_path, monkeypatch):
    def only_pid(plant, method, **options):
        if method.name != "pid":
            raise NumericalFailure("no gamma below 1e6; relax the weights")
        return design(plant, method, **options)

    monkeypatch.setattr("ambrose.chain.stages.design", only_pid)
    # in this process, where the method is exchanged
    monkeypatch.setattr("ambrose.chain.study.processors", lambda: 1)
    (tmp_path / "rig.toml").write_text(at_one_point(coarse_text(RIG)))
    done = call("study", tmp_path / "rig.toml", "-o", tmp_path, "--json")
    assert done.exit_code == 1, done.stderr
    found = json.loads(done.stdout)
    assert set(found["controllers"]) == {"PID"}
    assert set(found["failed"]) == {"tuned", "H-infinity", "mu", "mu, polished", "commissioning"}
    assert "relax the weights" in (tmp_path / "report.html").read_text()


BAD = {
    "unknown machine": (["check", "no-such-machine"], "seal-rig"),
    "speeds exchanged": (
        ["synthesize", "turboexpander", "--method", "lpv", "--speeds-hz", "300", "20"],
        "--speeds-hz is 300",
    ),
    "pressures exchanged": (
        ["synthesize", RIG, "--method", "lpv", "--pressures-bar", "4", "0"],
        "--pressures-bar is 4 and 0, but must be the lower",
    ),
    "pressures without lpv": (
        ["synthesize", RIG, "--method", "mu", "--pressures-bar", "0", "4"],
        "--pressures-bar is given, but must be left out",
    ),
    "a schedule over two": (
        ["synthesize", RIG, "--method", "lpv", "--pressures-bar", "0", "4", "--speed-rate", "9"],
        "must be given for a schedule over speed and pressure; give the speeds",
    ),
    "a schedule's rate in kg": (
        ["synthesize", RIG, "--method", "lpv", "--pressure-rate", "2 kg"],
        "20 bar/s",
    ),
    "speeds without lpv": (
        ["synthesize", "turboexpander", "--speeds-hz", "20", "300"],
        "--speeds-hz is given, but must be left out with --method tuned; it goes with lpv",
    ),
    "an envelope without a method for it": (
        ["synthesize", RIG, "--envelope", "--method", "pid"],
        "--envelope is given, but must be",
    ),
    "a back-off without a method for it": (
        ["synthesize", RIG, "--backoff", "1.1", "--method", "mu"],
        "it goes with lpv",
    ),
    "pressures in another unit": (
        ["synthesize", RIG, "--method", "lpv", "--pressures-bar", "0", "408000"],
        "the machine's highest operating point has 408000 Pa; check the unit of the schedule",
    ),
    "one pressure twice": (
        ["synthesize", RIG, "--method", "lpv", "--pressures-bar", "2", "2"],
        "give two numbers that differ",
    ),
    "a speed that is none": (
        ["synthesize", RIG, "--method", "lpv", "--speeds-hz", "2", "nan"],
        "give two numbers that differ",
    ),
    "a back-off below one": (
        ["synthesize", RIG, "--backoff", "0.9", "--method", "lpv"],
        "above 1 and at most 2; 1.03 to 1.2",
    ),
    "an order without a method for it": (
        ["synthesize", RIG, "--order", "4", "--method", "mu"],
        "it goes with tuned or polish",
    ),
    "another ending of a machine file": (["new", "{tmp}/x.json"], 'x.toml"'),
    "a machine file as controller": (
        ["verify", RIG, "--controller", "{tmp}/negative.toml"],
        "it is a machine file",
    ),
    "a controller as rotor": (
        ["convert", "{controller}", "-o", "{tmp}/m.toml"],
        "or of a table of stations (*.csv, *.xlsx)",
    ),
    "a record as rotor": (
        ["convert", "{tmp}/record.csv", "-o", "{tmp}/m.toml"],
        "the column 'time' is unknown",
    ),
    "a record's ending": (
        ["convert", "{tmp}/x.xls", "-o", "{tmp}/x.h5"],
        "must be one of .h5, .hdf5, .csv; export",
    ),
    "a directory": (["check", "."], "director"),
    "machine file truncated": (["check", "{tmp}/cut.toml"], "cut.toml"),
    "negative mass": (["check", "{tmp}/negative.toml"], "mass"),
    "wrong unit": (["check", "{tmp}/unit.toml"], "kg"),
    "controller missing": (["verify", RIG, "--controller", "{tmp}/none.json"], "none.json"),
    "controller truncated": (["verify", RIG, "--controller", "{tmp}/cut.json"], "cut.json"),
    "controller of the wrong size": (["verify", RIG, "--controller", "{tmp}/small.json"], "A_zeta"),
    "unknown scenario": (
        [
            "simulate",
            RIG,
            "--controller",
            "{controller}",
            "--scenario",
            "storm",
            "--linear",
            "-o",
            "{tmp}/x.h5",
        ],
        "impulse-parallel",
    ),
    "unknown operating point": (
        [
            "simulate",
            RIG,
            "--controller",
            "{controller}",
            "--scenario",
            "run-up",
            "--linear",
            "--point",
            "mars",
        ],
        "nominal pressure",
    ),
    "a scenario for the rig alone": (
        [
            "simulate",
            RIG,
            "--controller",
            "{controller}",
            "--scenario",
            "power-loss",
            "--linear",
            "-o",
            "{tmp}/x.h5",
        ],
        "virtual rig",
    ),
    "too many bending modes for the rig": (
        [
            "simulate",
            RIG,
            "--controller",
            "{controller}",
            "--scenario",
            "run-up",
            "--bending-modes",
            "999",
        ],
        "bending_modes",
    ),
    "unwritable target": (["synthesize", RIG, "-o", "{tmp}/no/such/folder/c.json"], "folder"),
    "unknown method": (["synthesize", RIG, "--method", "magic"], "magic"),
    "a loss without a sample rate": (
        ["synthesize", RIG, "--method", "mu", "--loss", "5"],
        "--rate-hz",
    ),
    "a negative sample rate": (["synthesize", RIG, "--rate-hz", "-1"], "--rate-hz"),
    "a sample rate of zero": (["synthesize", RIG, "--rate-hz", "0"], "--rate-hz"),
    "a negative loss": (
        ["synthesize", RIG, "--rate-hz", "10000", "--loss", "-5", "-o", "{tmp}/c.json"],
        "--loss",
    ),
    "a negative computing delay": (
        ["synthesize", RIG, "--rate-hz", "10000", "--delay-samples", "-1"],
        "computing delay",
    ),
    "a design at an unknown operating point": (
        ["synthesize", RIG, "--point", "mars"],
        "nominal pressure",
    ),
    "pressure rate in kg": (
        ["verify", RIG, "--controller", "{controller}", "--pressure-rate", "2 kg"],
        "20 bar/s",
    ),
    "pressure rate without unit": (
        ["verify", RIG, "--controller", "{controller}", "--pressure-rate", "80"],
        "is 80, without a unit",
    ),
    "pressure error without a rate": (
        ["verify", "two-disc-rotor", "--controller", "{controller}", "--pressure-error", "1 bar"],
        "given with --pressure-rate",
    ),
    "pressure error of a fixed law": (
        [
            "verify",
            RIG,
            "--controller",
            "{controller}",
            "--pressure-rate",
            "2 bar/s",
            "--pressure-error",
            "1 bar",
        ],
        "only a controller scheduled over pressure",
    ),
    "pressure rate negative": (
        ["verify", RIG, "--controller", "{controller}", "--pressure-rate=-2 bar/s"],
        "must be positive",
    ),
}


@pytest.fixture
def bad_files(tmp_path, controller):
    text = Path(str(bundled_machines()["seal-rig"])).read_text()
    (tmp_path / "cut.toml").write_text(text[: text.index("[[bearing]]") + 20])
    (tmp_path / "negative.toml").write_text(
        text + '\n[[disc]]\nname = "d"\nposition = 0.4\nmass = -1\n'
    )
    (tmp_path / "record.csv").write_text("time,y_A\n0,1\n")
    (tmp_path / "x.xls").write_text("")
    (tmp_path / "unit.toml").write_text(text.replace('"50 mm"', '"50 kg"', 1))
    content = json.loads(controller.read_text())
    (tmp_path / "cut.json").write_text(controller.read_text()[:300])
    for key, keep in (("B", 3), ("D", 3)):
        content[key] = [row[:keep] for row in content[key]]
    content["inputs"] = content["inputs"][:3]
    (tmp_path / "small.json").write_text(json.dumps(content))
    return tmp_path


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_message_and_status_2(case, bad_files, controller):
    arguments, words = BAD[case]
    filled = [a.format(tmp=bad_files, controller=controller) for a in arguments]
    before = sorted(path.name for path in bad_files.iterdir())
    done = call(*filled)
    assert done.exit_code == 2, (done.stdout, done.stderr)
    assert words in done.stderr
    assert "Traceback" not in done.stderr
    assert not done.stdout
    assert sorted(path.name for path in bad_files.iterdir()) == before


def test_import_is_light_and_fast():
    """No plotting, solver or compiler package at import; the time itself is measured in
    benchmarks/.
    """
    code = (
        "import sys, ambrose; "
        "heavy = {'plotly', 'matplotlib', 'numba', 'control', 'pint', 'h5py', 'jinja2', 'rich', "
        "'scipy.optimize', 'clarabel'}; "
        "sys.exit(', '.join(sorted(heavy & set(sys.modules))) or 0)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=False,
        env=dict(os.environ),
        timeout=60,
    )
    assert done.returncode == 0, done.stderr


def test_continuous_figures_beside_those_of_the_loop_that_runs_are_explained():
    """A PID's certificate had said a sensitivity peak of 356.7 beside one of 2.54, and no more."""
    from ambrose.cli.controller_commands import _beside

    far = {"sampled_sensitivity_peak": 2.54, "continuous sensitivity_peak": 356.7}
    (line,) = _beside(far)
    assert "without sampling, hold and delay" in line and "140 times off" in line
    (line,) = _beside({**far, "continuous sensitivity_peak": 2.6})
    assert "times off" not in line
    assert _beside({"sensitivity_peak": 2.6}) == []


# what a check does without: solvers and compilers, the other commands, methods, identification
_UNUSED = (
    "scipy.optimize",
    "scipy.interpolate",
    "scipy.sparse.csgraph",
    "numba",
    "plotly",
    "pint",
    "h5py",
    "ambrose.cli.controller_commands",
    "ambrose.annexes.site.commands",
    "ambrose.synthesis",
    "ambrose.identification",
    "ambrose.rig",
    "ambrose.code",
    "ambrose.judge.robust",
    "ambrose.core.mu",
)


@pytest.mark.parametrize(
    "machine", ["seal-rig", "turboexpander", "examples/expander-five-axes.toml"]
)
def test_a_check_loads_what_it_needs_and_no_more(machine):
    """Half of the processor time of ``ambrose check`` was what it did not use. Of the package it
    needs some 135 modules, of 208 that were loaded once.
    """
    code = (
        "import sys; from ambrose.cli import main; from click.testing import CliRunner; "
        f"done = CliRunner().invoke(main, ['check', {machine!r}]); "
        "assert not done.exit_code, done; "
        "print(*[name for name in sys.modules if name.startswith(('ambrose', 'scipy', 'numba', "
        "'plotly', 'pint', 'h5py'))])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    loaded = set(done.stdout.split())
    # five axes: the rational model of a solid core is fitted
    fitted = {"scipy.optimize"} if "five-axes" in machine else set()
    assert not loaded & set(_UNUSED) - fitted
    assert len([name for name in loaded if name.startswith("ambrose")]) < 145
