"""MAT-files read by mat4py, scipy and Octave (where installed); the controller as python-control
and from plain JSON.
"""

import re
import shutil
import subprocess
from datetime import UTC, datetime
from pathlib import Path

import control
import mat4py
import numpy as np
import pytest
import scipy.io
import scipy.signal

from ambrose import StateSpace
from ambrose.code.block.block import build_block
from ambrose.code.mat import FORMAT, generate_mat
from ambrose.code.sampled import deploy
from ambrose.core.checks import InvalidInput
from ambrose.core.sampling import c2d
from ambrose.judge.controller_file import read_controller, write_controller
from ambrose.judge.result import Certificate, Synthesis
from example_blocks import CURRENT, DT, ERROR, rig_controller, small_controller
from needs import needs

GUIDE = Path(__file__).parents[2] / "docs" / "reference" / "targets.md"
octave = needs("octave-cli")


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """The folder, the block, the deployment and the controller file of a controller with a
    certificate.
    """
    folder = tmp_path_factory.mktemp("mat")
    certificate = Certificate(
        stable=True,
        spectral_abscissa=-4.25,
        closed_loop_norm=np.inf,
        fastest_pole=11000.0,
        margins={"gain at A-zeta": 2.5},
        plant="µ-plant",
    )
    result = Synthesis(
        method="hinf",
        controller=rig_controller(),
        gamma=1.25,
        status="verified",
        certificate=certificate,
        history=(),
    )
    file = read_controller(
        write_controller(folder / "controller.json", result, date=datetime(2026, 1, 2, tzinfo=UTC))
    )
    deployment = deploy(file, DT, DT, force=True)
    block = build_block(deployment, "rig", ERROR, CURRENT)
    for name, content in generate_mat(
        block, deployment, file, ["Controller %d 'quoted'", "Unmet µ"]
    ).items():
        (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    return folder, block, deployment, file


def test_mat4py_reads_the_controller(written):
    folder, block, deployment, _ = written
    found = mat4py.loadmat(str(folder / "rig.mat"))["rig"]
    for letter in "ABCD":
        assert np.array_equal(found[letter], getattr(deployment.controller, letter))
        assert np.array_equal(found["continuous"][letter], getattr(deployment.source, letter))
    assert found["format"] == FORMAT
    assert found["dt"] == DT
    assert (found["method"], found["status"]) == ("hinf", "verified")
    assert [name for (name,) in found["inputs"]] == list(block.inputs)
    assert [name for (name,) in found["outputs"]] == list(block.outputs)
    assert (found["input_unit"], found["output_unit"], found["delay_samples"]) == ("m", "A", 1)
    assert np.array_equal(np.ravel(found["limits"]["error"]), block.error_limit)
    assert np.array_equal(np.ravel(found["limits"]["current"]), block.current_limit)
    assert found["gamma"] == 1.25
    assert not found["verified"]  # forced: no plant
    certificate = found["certificate"]
    assert certificate["stable"] == 1
    assert certificate["spectral_abscissa"] == -4.25
    assert certificate["closed_loop_norm"] == np.inf
    assert certificate["margins"] == {"gain_at_A_zeta": 2.5}
    assert found["provenance"]["date"].startswith("2026-01-02")


def test_scipy_simulates_what_it_reads(written):
    """The matrices that come back, stepped by scipy, give what the continuous controller sampled by
    Tustin gives.
    """
    folder, _, _, file = written
    found = scipy.io.loadmat(folder / "rig.mat", simplify_cells=True)["rig"]
    e = np.random.default_rng(0).normal(0, 1e-6, (3000, 4))
    K = c2d(file.controller, DT, "tustin")
    _, got, _ = scipy.signal.dlsim((found["A"], found["B"], found["C"], found["D"], found["dt"]), e)
    _, expected, _ = scipy.signal.dlsim((K.A, K.B, K.C, K.D, DT), e)
    assert np.abs(got - expected).max() <= 1e-9 * np.abs(expected).max()
    assert list(found["provenance"]["lines"]) == ["Controller %d 'quoted'", "Unmet µ"]


@octave
def test_octave_reads_it_and_the_script_replays_the_vectors(written):
    folder, block, deployment, _ = written
    script = (
        "rig_load; "
        "assert(iscellstr(rig.inputs) && strcmp(rig.inputs{4}, 'err_B_eta')); "
        "assert(isstruct(rig.certificate) && rig.certificate.margins.gain_at_A_zeta == 2.5); "
        "printf('%.17g\\n', rig.A, rig.B, rig.C, rig.D, rig.dt);"
    )
    done = subprocess.run(
        ["octave-cli", "--no-gui", "--quiet", "--norc", "--eval", script],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    first, *numbers = done.stdout.splitlines()
    deviation = re.fullmatch(
        r"rig: 96 samples, largest deviation (\S+) of the current limit", first
    )
    assert float(deviation.group(1)) <= 1e-12
    K = deployment.controller
    # Octave counts columns first
    expected = np.concatenate([x.T.ravel() for x in (K.A, K.B, K.C, K.D)])
    assert np.array_equal(np.array(numbers[:-1], float), expected)
    assert float(numbers[-1]) == block.sample_time


@octave
def test_the_script_notices_another_coefficient(written, tmp_path):
    folder, *_ = written
    found = scipy.io.loadmat(folder / "rig.mat")
    found["rig"]["block"][0, 0]["C"][0, 0][0, 0] *= 1.0001
    scipy.io.savemat(tmp_path / "rig.mat", {"rig": found["rig"]})
    shutil.copy(folder / "rig_load.m", tmp_path)
    done = subprocess.run(
        ["octave-cli", "--no-gui", "--quiet", "--norc", "--eval", "rig_load"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 1
    assert "the block does not answer as its vectors say" in done.stderr


def test_a_controller_written_alone_and_sampled(tmp_path):
    """No certificate, no continuous controller: empty, not absent."""
    K = c2d(small_controller(), DT, "zoh")
    file = read_controller(write_controller(tmp_path / "k.json", K))
    deployment = deploy(file, DT, 0.0, force=True)
    (tmp_path / "k.mat").write_bytes(
        generate_mat(build_block(deployment, "k", 1e-3, 2.0), deployment, file)["k.mat"]
    )
    found = scipy.io.loadmat(tmp_path / "k.mat", simplify_cells=True)["k"]
    assert np.isnan(found["gamma"])
    assert found["certificate"].size == found["continuous"].size == found["verification"].size == 0
    assert np.abs(np.linalg.eigvals(found["A"])).max() <= 1 + 1e-12


@pytest.mark.parametrize("name", ["end", "classdef", "pi", "endfunction", "until"])
def test_names_that_matlab_reserves(written, name):
    _, _, deployment, file = written
    with pytest.raises(InvalidInput, match="must be no word of MATLAB or Octave"):
        generate_mat(build_block(deployment, name, ERROR, CURRENT), deployment, file)


def test_python_control_and_back(written, tmp_path):
    """A controller file as python-control's object, by the reader; and what python-control holds,
    written and read again.
    """
    folder, *_ = written
    controller = read_controller(folder / "controller.json").controller
    system = controller.to_control()
    assert isinstance(system, control.StateSpace)
    assert system.input_labels == list(controller.inputs)
    assert system.output_labels == list(controller.outputs)
    again = read_controller(write_controller(tmp_path / "again.json", system)).controller
    for letter in "ABCD":
        assert np.array_equal(getattr(again, letter), getattr(controller, letter))
    assert again.inputs == controller.inputs
    w = np.array([1.0, 300.0, 9000.0])
    peak = np.abs(system(1j * w)).max()
    assert (
        np.abs(np.moveaxis(system(1j * w), -1, 0) - _response(controller, w)).max() <= 1e-9 * peak
    )


def _response(K: StateSpace, w: np.ndarray) -> np.ndarray:
    eye = np.eye(K.n_states)
    return np.array([K.C @ np.linalg.solve(1j * x * eye - K.A, K.B) + K.D for x in w])


def test_the_guides_recipe_for_plain_json(written, monkeypatch):
    """The recipe in docs/reference/targets.md needs json and python-control only."""
    folder, _, _, file = written
    recipe = re.search(
        r"```python\n(import json\n.*?)```", GUIDE.read_text(encoding="utf-8"), re.DOTALL
    ).group(1)
    assert "ambrose" not in recipe.replace("ambrose-controller", "")
    monkeypatch.chdir(folder)
    scope = {}
    exec(compile(recipe, "recipe", "exec"), scope)
    K = scope["K"]
    for letter in "ABCD":
        assert np.array_equal(getattr(K, letter), getattr(file.controller, letter))
    assert K.input_labels == list(file.controller.inputs)
