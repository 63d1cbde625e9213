"""The radial and the axial controller as one C function: equal to both twins, what is lost on one
part never reaches the other, and what cannot be one unit is refused.
"""

import ctypes
import subprocess
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import ambrose as amb
from ambrose.cli import main
from ambrose.code.block.run import run_of
from ambrose.code.c.compiled import find_compiler
from ambrose.core.checks import InvalidInput
from ambrose.judge.controller_file import write_controller
from needs import needs

EXAMPLE = Path(__file__).parents[2] / "examples" / "expander-five-axes.toml"
compiled = needs("C compiler")
STRICT = ("-std=c99", "-O2", "-Wall", "-Wextra", "-pedantic", "-Werror", "-ffp-contract=off")


@cache
def machine():
    return amb.load_machine(EXAMPLE)


@cache
def laws():
    return amb.design(machine(), "pid", axes="radial"), amb.design(machine().axial, "pid")


@cache
def delivered(folder, arithmetic="double"):
    radial, axial = laws()
    return amb.export(
        radial, folder, to="c", machine=machine(), axial=axial, arithmetic=arithmetic, force=True
    )


def built(folder, output, *more):
    sources = [
        str(path) for path in sorted(folder.glob("*.c")) if not path.name.endswith("_test.c")
    ]
    command = [find_compiler(), *STRICT, f"-I{folder}", *sources, *more, "-lm", "-o", str(output)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return output


@compiled
@pytest.mark.parametrize("arithmetic", ["double", "fixed32"])
def test_the_self_test_passes_and_can_fail(arithmetic, tmp_path):
    delivered(tmp_path, arithmetic)
    test = tmp_path / "controller_axes_test.c"
    passes = subprocess.run([built(tmp_path, tmp_path / "test", str(test))], check=False)
    assert passes.returncode == 0
    unit = tmp_path / "controller_axes.c"
    unit.write_text(unit.read_text().replace("error + CONTROLLER_INPUTS", "error"))
    fails = subprocess.run([built(tmp_path, tmp_path / "worse", str(test))], check=False)
    assert fails.returncode == 1


@compiled
def test_one_step_is_both_twins(tmp_path):
    done = delivered(tmp_path)
    radial, axial = done.block, done.axial.block
    assert done.paths[-1].exists() and "controller_axes.h" in [path.name for path in done.paths]
    library = ctypes.CDLL(str(built(tmp_path, tmp_path / "unit.so", "-shared", "-fPIC")))
    rng = np.random.default_rng(4)
    limits = np.concatenate([radial.error_limit, axial.error_limit])
    count, n = 400, len(limits)
    errors = 0.3 * limits * rng.standard_normal((count, n))
    valid = np.ones((count, n), np.uint8)
    valid[100:140, -1], valid[200:230, 0] = 0, 0
    axes, currents = ctypes.create_string_buffer(1 << 16), np.zeros((count, n))
    library.controller_axes_init(axes)
    step = library.controller_axes_step
    step.restype = ctypes.c_uint
    for k in range(count):
        step(
            axes, *(ctypes.c_void_p(row.ctypes.data) for row in (errors[k], valid[k], currents[k]))
        )
    for block, part in ((radial, slice(0, n - 1)), (axial, slice(n - 1, n))):
        twin = run_of(block, errors[:, part], valid=valid[:, part].astype(bool)).currents
        assert np.abs(currents[:, part] - twin).max() <= 1e-12 * np.abs(twin).max()


@pytest.mark.parametrize(("to", "words"), [("mat", "one law"), ("st", "one group of axes")])
def test_what_holds_one_group_is_written_as_two_units(to, words, tmp_path):
    """A file of both groups gives what the controllers give one by one, and says why two."""
    radial, axial = laws()
    how = {"to": to, "force": True}
    both = amb.export(replace(radial, thrust=axial), tmp_path / "both", machine=machine(), **how)
    assert both.apart.endswith(words) and both.to_dict()["two_units"] == both.apart
    amb.export(radial, tmp_path / "one", machine=machine(), axes="radial", **how)
    amb.export(axial, tmp_path / "other", machine=machine().axial, name="controller_axial", **how)
    written = {path.name for path in both.paths}
    alone = [path for part in ("one", "other") for path in (tmp_path / part).iterdir()]
    assert written == {path.name for path in alone}
    for path in alone:
        if to == "st":
            assert (tmp_path / "both" / path.name).read_text() == path.read_text()


@compiled
def test_a_file_of_both_groups_is_one_unit(tmp_path):
    """Byte by byte that of two files; --axes narrows it to one of them."""
    radial, axial = laws()
    both = replace(radial, thrust=axial)
    one = delivered(tmp_path / "two")
    amb.export(both, tmp_path / "one", to="c", machine=machine(), force=True)
    for path in one.paths:
        other = (tmp_path / "one" / path.name).read_text()
        assert other.replace(both.digest, radial.digest) == path.read_text(), path.name
    narrow = amb.export(both, tmp_path / "z", to="c", machine=machine(), axes="thrust", force=True)
    assert narrow.axial is None and narrow.deployment.controller.outputs == ("u_T_z",)
    assert not (tmp_path / "z" / "controller_axes.c").exists()


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ({"to": "c", "bare_metal": True}, "export each controller by itself"),
        ({"to": "c", "machine": "axial"}, "name the radial controller first"),
        ({"to": "c", "machine": "seal-rig"}, "no thrust bearing"),
        ({"to": "c", "axial": "radial"}, "one axis along the shaft"),
    ],
)
def test_what_cannot_be_one_unit_is_refused(how, words, tmp_path):
    radial, axial = laws()
    known = {"axial": machine().axial, "seal-rig": amb.load_machine("seal-rig"), None: machine()}
    given = known[how.get("machine")]
    other = radial if how.get("axial") == "radial" else axial
    rest = {name: value for name, value in how.items() if name not in {"machine", "axial"}}
    with pytest.raises(InvalidInput, match=words):
        amb.export(radial, tmp_path / "code", machine=given, axial=other, **rest)
    assert not (tmp_path / "code").exists()


def test_the_axial_controller_runs_at_the_radial_one_s_rate(tmp_path):
    radial, _ = laws()
    slow = machine().axial
    slow = replace(slow, controller=replace(slow.controller, sample_time=2e-4, delay=2e-4))
    late = amb.design(slow, "pid")
    with pytest.raises(InvalidInput, match="one processor runs both"):
        amb.export(radial, tmp_path / "code", to="c", machine=machine(), axial=late)


def test_from_the_command_line(tmp_path):
    radial, axial = laws()
    write_controller(tmp_path / "radial.json", radial)
    write_controller(tmp_path / "axial.json", axial)
    files = ["--axial", str(tmp_path / "axial.json"), "--machine", str(EXAMPLE)]
    given = ["export", str(tmp_path / "radial.json"), "--to", "c", "-o", str(tmp_path / "code")]
    done = CliRunner().invoke(main, [*given, *files])
    assert done.exit_code in {0, 1}, done.output
    assert (tmp_path / "code" / "controller_axes.c").exists()
