"""From a controller file to code: the command, its refusals, its header, and the guide's
example.
"""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import control
import numpy as np
import pytest
from click.testing import CliRunner

import code_driver as driver
from ambrose import StateSpace, load_machine
from ambrose.cli import main
from ambrose.code.pipeline import bundled_machine, export, machine_limits
from ambrose.code.targets import C, St
from ambrose.core.checks import InvalidInput, UnstableSystem
from ambrose.judge.controller_file import read_controller, write_controller
from ambrose.model.assemble import assemble
from ambrose.options import Options
from ambrose.synthesis.design import design
from coarse import coarse
from example_blocks import small_controller
from needs import needs

GUIDE = Path(__file__).parents[2] / "docs" / "reference" / "c-code.md"


@pytest.fixture(scope="module")
def controllers(tmp_path_factory):
    folder, machine = tmp_path_factory.mktemp("controllers"), load_machine("seal-rig")
    plant = assemble(machine)
    return {
        m: write_controller(folder / f"{m}.json", design(plant, m), machine)
        for m in ("pid", "hinf")
    }


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """A controller file of no bundled machine."""
    return write_controller(tmp_path_factory.mktemp("small") / "small.json", small_controller())


def call(*arguments):
    return CliRunner().invoke(main, ["export", *(str(argument) for argument in arguments)])


@pytest.fixture(scope="module")
def written(controllers, tmp_path_factory):
    """The folder of a verified controller's code, and what the command said."""
    folder = tmp_path_factory.mktemp("written") / "code"
    return folder, call(
        controllers["hinf"], "--to", "c", "-o", folder, "--name", "seal_rig", "--json"
    )


def test_a_verified_controller_is_written(written):
    folder, done = written
    # written and verified, but the loop as it runs misses limits
    assert done.exit_code == 1, done.stderr
    found = json.loads(done.stdout)
    assert found["verified"] and any(
        "zero pressure" in text and "17" in text for text in found["unmet_limits"]
    )
    assert sorted(Path(f).name for f in found["files"]) == sorted(p.name for p in folder.iterdir())
    header = (folder / "seal_rig.h").read_text()
    for text in (
        "Controller hinf",
        "Machine    seal-rig, hash ",
        "Verified   zero pressure: stable, sensitivity peak 17",
        "over all tolerances around nominal pressure: 0 unstable",
        "SEAL_RIG_ERR_B_ETA = 3 /* within +-0.0005 m */",
        "SEAL_RIG_U_A_ZETA = 0, /* within +-4 A */",
        "set 1 sample after the errors were measured",
    ):
        assert text in header
    assert "Forced" not in header


@needs("gcc or clang")
def test_the_guides_example_compiles(written, tmp_path):
    shutil.copytree(written[0], tmp_path / "code")
    example = re.search(r"```c\n(.*?)```", GUIDE.read_text(), re.DOTALL)
    (tmp_path / "code" / "example.c").write_text(example.group(1))
    driver.build(
        "gcc", ["-c", str(tmp_path / "code" / "example.c"), "-o", str(tmp_path / "example.o")]
    )


def test_an_unverified_controller_needs_force(controllers, tmp_path):
    done = call(controllers["pid"], "--to", "c", "-o", tmp_path / "code")
    assert done.exit_code == 2
    assert (
        "this controller is not deployed: the sampled loop is unstable at twice nominal pressure"
        in done.stderr
    )
    assert not (tmp_path / "code").exists()
    done = call(
        controllers["pid"],
        "--to",
        "c",
        "-o",
        tmp_path / "code",
        "--force",
        "--arithmetic",
        "fixed32",
    )
    assert done.exit_code == 1
    assert (
        "Forced     although the sampled loop is unstable"
        in (tmp_path / "code" / "controller.h").read_text()
    )


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--rate-hz", 3000], "the sample rate is 3000 Hz, but must be at least 36"),
        (["--rate-hz", -1], "--rate-hz is -1.0, but must be positive"),
        (["--delay-samples", -1], "(--delay-samples) is -1"),
        (["--name", "a b"], "the name of the block is 'a b', but must be a C identifier"),
        (["--error-limit", 0, "--force"], "error_limit is 0.0, but must be positive"),
        # the first that is missed depends on the design's last digits
        (["--arithmetic", "fixed16", "--force"], "use words of 32 bits"),
        (["--machine", "absent.toml"], "absent.toml"),
    ],
)
def test_bad_input(controllers, tmp_path, options, message):
    done = call(controllers["hinf"], "--to", "c", "-o", tmp_path / "code", *options)
    assert done.exit_code == 2
    assert message in done.stderr
    assert not (tmp_path / "code").exists()


@pytest.mark.parametrize(
    ("target", "files"),
    [
        ("mat", ["rig.mat", "rig_load.m", "rig_vectors.csv"]),
        ("fmu", ["rig_fmi2.fmu", "rig_fmi3.fmu"]),
        ("st", ["rig.st", "rig_test.st", "rig_vectors.csv"]),
    ],
)
def test_other_targets(small, tmp_path, target, files):
    """Written with what was verified, refused unless forced, all or nothing."""
    limits = [
        "--error-limit",
        1e-3,
        "--current-limit",
        2.0,
        "--name",
        "rig",
        "-o",
        tmp_path / "out",
        *(["--sources-only"] if target == "fmu" else []),
    ]
    done = call(small, "--to", target, *limits)
    assert done.exit_code == 2
    assert "this controller is not deployed: the controller carries no certificate" in done.stderr
    assert not (tmp_path / "out").exists()
    done = call(small, "--to", target, *limits, "--force", "--json")
    assert done.exit_code == 1  # forced
    assert sorted(Path(f).name for f in json.loads(done.stdout)["files"]) == files
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == files


@pytest.mark.parametrize("target", ["c", "mat", "fmu", "st"])
def test_an_unstable_controller_is_refused_by_every_target(tmp_path, target):
    K = StateSpace([[5.0]], [[1.0]], [[1.0]], [[0.0]], ["err_A"], ["u_A"])
    file = write_controller(tmp_path / "k.json", K)
    done = call(
        file, "--to", target, "-o", tmp_path / "out", "--error-limit", 1.0, "--current-limit", 1.0
    )
    assert done.exit_code == 2
    assert "the controller itself is unstable (a pole at +5 rad/s)" in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            ["--to", "st", "--name", "Function_Block"],
            "'Function_Block', but must be no word of structured text",
        ),
        (["--to", "st", "--name", "a__b"], "'a__b', but must be an identifier of IEC 61131-3"),
        (["--to", "mat", "--name", "end"], "'end', but must be no word of MATLAB"),
        (
            ["--to", "st", "--arithmetic", "fixed32"],
            "--arithmetic is 'fixed32', but must be one of double, float",
        ),
        (
            ["--to", "mat", "--arithmetic", "float"],
            "--arithmetic is given, but must be left out with --to mat; it goes with c, fmu",
        ),
        (["--to", "fmu", "--name", "x y"], "'x y', but must be a C identifier"),
        (["--to", "fmu", "--name", "memory"], "'memory', but must be unlike the FMU's own files"),
    ],
)
def test_bad_input_of_other_targets(small, tmp_path, options, message):
    limits = ["--error-limit", 1e-3, "--current-limit", 2.0, "--force", "-o", tmp_path / "out"]
    done = call(small, *options, *limits)
    assert done.exit_code == 2
    assert message in done.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("target", ["mat", "fmu", "st"])
def test_a_full_disk_leaves_nothing(small, tmp_path, monkeypatch, target):
    def full(descriptor):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    options = [
        "--error-limit",
        1e-3,
        "--current-limit",
        2.0,
        "--force",
        *(["--sources-only"] if target == "fmu" else []),
        "-o",
        tmp_path / "out",
    ]
    done = call(small, "--to", target, *options)
    assert done.exit_code == 2
    assert "No space left on device; nothing was changed there" in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_target_that_does_not_exist(small, tmp_path):
    with pytest.raises(
        InvalidInput, match="the target is 'plc', but must be one of c, mat, fmu, st; choose"
    ):
        export(read_controller(small), tmp_path / "out", to="plc")


def test_a_target_that_cannot_be_written(controllers, tmp_path):
    (tmp_path / "file").write_text("x")
    done = call(controllers["hinf"], "--to", "c", "-o", tmp_path / "file" / "code")
    assert done.exit_code == 2
    assert "cannot write to" in done.stderr


def test_limits_must_be_known(tmp_path):
    K = StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]], ["err_A"], ["u_A"])
    file = read_controller(write_controller(tmp_path / "c.json", K))
    assert bundled_machine(file) is None
    with pytest.raises(
        InvalidInput,
        match="the error limit is unknown, but must be given in m; state it, or name the machine file",
    ):
        export(file, tmp_path / "code", to="c")
    done = export(file, tmp_path / "code", to="c", error_limit=1e-3, current_limit=2.0, force=True)
    assert not done.deployment.verified
    assert "Verified   NOT" in (tmp_path / "code" / "controller.h").read_text()


def test_limits_of_a_machine():
    errors, currents = machine_limits(load_machine("seal-rig"))
    assert np.array_equal(errors, [0.5e-3] * 4)
    assert np.array_equal(currents, [4.0] * 4)


@pytest.fixture(scope="module")
def rig():
    """The seal rig at its nominal point alone, without tolerances: verified in half a second; and a
    controller for it.
    """
    machine = coarse("seal-rig")
    machine = replace(
        machine,
        tolerances=(),
        operation=replace(machine.operation, points=machine.operation.points[:1]),
    )
    return machine, design(assemble(machine), "hinf")


def test_any_system_is_verified_on_the_machine_and_written(rig, tmp_path):
    """python-control's names mean nothing: its signals are the machine's axes in their order."""
    machine, synthesis = rig
    K = synthesis.controller
    own = export(synthesis, tmp_path / "own", to="c", machine=machine)
    foreign = export(control.ss(K.A, K.B, K.C, K.D), tmp_path / "foreign", to="c", machine=machine)
    assert own.deployment.verified
    assert foreign.deployment.verified
    for name in ("controller.c", "controller_test.c", "controller_vectors.csv"):
        assert (tmp_path / "own" / name).read_bytes() == (tmp_path / "foreign" / name).read_bytes()
    header = (tmp_path / "foreign" / "controller.h").read_text()
    assert "Controller given, made by ambrose" in header
    assert "Machine    seal-rig, hash " in header
    assert "Verified   nominal pressure: stable, sensitivity peak" in header
    with pytest.raises(UnstableSystem, match="the sampled loop is unstable at nominal pressure"):
        export(control.ss(K.A, K.B, -K.C, -K.D), tmp_path / "wrong", to="c", machine=machine)


def test_a_delivery_shows_itself(rig, tmp_path):
    machine, synthesis = rig
    delivery = export(
        synthesis,
        tmp_path / "code",
        to=St(name="rig", rate=20000.0),
        machine=machine,
    )
    assert len(repr(delivery)) < 200
    assert repr(delivery).startswith("Delivery(target=st, verified=True, states=")
    assert "rate_hz=2e+04, files=[rig.st, rig_test.st, rig_vectors.csv]" in repr(delivery)
    assert "<td>rate hz</td>" in delivery._repr_html_()
    paths = [str(tmp_path / "code" / name) for name in ("rig.st", "rig_test.st", "rig_vectors.csv")]
    assert json.loads(json.dumps(delivery.to_dict())) == {
        "target": "st",
        "files": paths,
        "verified": True,
        "problems": [],
        "unmet_limits": list(delivery.unmet_limits),
    }
    assert len(repr(delivery.deployment)) < 200
    assert delivery.deployment.to_dict()["checks"][0]["label"] == "nominal pressure"


@pytest.mark.parametrize(
    ("controller", "message"),
    [
        (
            "controller.json",
            "the controller is 'controller.json', but must be a StateSpace or a Synthesis",
        ),
        (
            control.ss([[-1.0]], [[1.0]], [[1.0]], [[0.0]]),
            r"size \(outputs, inputs\) is \(1, 1\), but must be \(4, 4\) for the axes A_",
        ),
    ],
)
def test_what_is_no_controller_of_the_machine(rig, tmp_path, controller, message):
    with pytest.raises(InvalidInput, match=message):
        export(controller, tmp_path / "code", to="c", machine=rig[0])


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"rate": 0.0}, "rate is 0.0, but must be positive"),
        ({"delay_samples": 1.5}, r"delay_samples.* is 1\.5"),
        ({"name": "1"}, "name of"),
    ],
)
def test_options_that_mean_nothing(settings, message):
    with pytest.raises(InvalidInput, match=message):
        C(**settings)


def test_two_ways_of_writing_are_equal_only_where_they_are_one():
    """Every class of options: what says eq=False compares by identity, never by no field at all."""
    every, waiting = [], [Options]
    while waiting:
        kind = waiting.pop()
        every.append(kind)
        waiting += kind.__subclasses__()
    assert C in every and len(every) > 10
    one, other = C(rate=1e3), C(rate=2e3)
    assert one != other and len({one, other}) == 2
    for kind in every:
        compares = next(one for one in kind.__mro__ if "__eq__" in vars(one))
        assert compares in (object, kind), kind  # not by the fields of a class below it
