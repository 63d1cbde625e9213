"""FMUs read, validated and run by FMPy, compared with the block in Python."""

import io
import re
import shutil
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.build import build_platform_binary
from fmpy.validation import validate_fmu

import code_driver as driver
from ambrose import StateSpace
from ambrose.code.block.fixed_point import in_words
from ambrose.code.block.run import FAULT, HELD, LIMITED, run_of
from ambrose.code.fmu import generate_fmu, generate_fmus, generate_sources, variables
from ambrose.core.checks import InvalidInput
from ambrose.machine.ordinary_file import write_files
from example_blocks import CURRENT, ERROR, gain_block, rig_block, small_block
from fmu_player import Player
from needs import needs

VERSIONS = ("2.0", "3.0")
HEADERS = Path(fmpy.__file__).parent / "c-code"  # the standard's own, as FMPy carries them
_MODEL_EXCHANGE = """EnterEventMode CompletedIntegratorStep EnterContinuousTimeMode SetTime SetContinuousStates GetDerivatives
GetEventIndicators GetContinuousStates GetNominalsOfContinuousStates NewDiscreteStates"""  # of 2.0; 3.0 wants every function
compiler = needs("gcc or clang")


@pytest.fixture(scope="module")
def rig():
    return rig_block()


def opened(block, version, folder, arithmetic="double"):
    path = folder / f"{block.name}{version}.fmu"
    path.write_bytes(generate_fmu(block, version, arithmetic))
    player = Player(path, folder / "opened")
    player.begin()
    return player


def files_of(content):
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


@compiler
@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize(
    "make", [small_block, lambda: small_block(0), lambda: small_block(3), gain_block, rig_block]
)
def test_validation_finds_nothing(version, make, tmp_path):
    content = generate_fmu(
        make(), version, provenance=['<&"> Controller'], sources_only=make is not gain_block
    )
    (tmp_path / "x.fmu").write_bytes(content)
    assert validate_fmu(str(tmp_path / "x.fmu")) == []


@compiler
@pytest.mark.parametrize("version", VERSIONS)
def test_agrees_with_the_block_in_python(rig, version, tmp_path):
    e, valid = driver.adversarial(rig, 10_000)
    expected = run_of(rig, e, valid=valid)
    found, status = opened(rig, version, tmp_path).play(rig, e, valid)
    assert np.abs(found - expected.currents).max() <= 1e-12 * CURRENT
    assert (status == expected.status).all()
    for bit in (HELD, FAULT, LIMITED):
        assert 0.01 < ((status & bit) > 0).mean() < 0.9


@compiler
@pytest.mark.parametrize(
    ("version", "delay"),
    [
        *zip((*VERSIONS, VERSIONS[0]), (0, 2, 3), strict=True),
        *(
            pytest.param(*other, marks=pytest.mark.study)
            for other in zip((*VERSIONS[::-1], VERSIONS[1]), (0, 2, 3), strict=True)
        ),
    ],
)
def test_the_computing_delay_is_inside(version, delay, tmp_path):
    """u[k] leaves at the communication point k + delay; without delay already before the step, from
    the errors just set.
    """
    block = small_block(delay)
    e, valid = driver.adversarial(block, 600)
    expected = run_of(block, e, valid=valid).currents
    found, _ = opened(block, version, tmp_path).play(block, e, valid, direct=delay == 0)
    late = max(delay - 1, 0)
    assert (found[:late] == 0).all()
    assert (
        np.abs(found[late:] - expected[: len(e) - late]).max() <= 1e-12 * block.current_limit.max()
    )


@compiler
@pytest.mark.parametrize("version", VERSIONS)
def test_simulated_with_tables_of_input(version, tmp_path):
    """FMPy's own master, its inputs from a table, 10^4 samples: smooth errors, nothing
    implausible.
    """
    block = small_block()
    (tmp_path / "x.fmu").write_bytes(generate_fmu(block, version))
    count = 10_000
    t = np.arange(count + 1) * block.sample_time
    e = 2e-5 * np.column_stack([np.sin(300 * t), np.cos(40 * t)])
    signals = np.array(
        [(*row,) for row in np.column_stack([t, e])],
        dtype=[("time", float), ("err_x", float), ("err_y", float)],
    )
    found = fmpy.simulate_fmu(
        str(tmp_path / "x.fmu"),
        stop_time=t[-1],
        step_size=block.sample_time,
        output_interval=block.sample_time,
        input=signals,
        output=["u_x", "limited"],
    )
    expected = run_of(block, e).currents[:, 0]
    assert len(found) == count + 1
    # FMPy interpolates its table
    assert np.abs(found["u_x"][1:] - expected[:-1]).max() <= 1e-9 * np.abs(expected).max()
    assert np.abs(expected).max() > 0.1
    assert found["u_x"][0] == 0


@compiler
@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("arithmetic", ["float", "fixed32"])
def test_the_code_inside_may_be_float_or_fixed(rig, version, arithmetic, tmp_path):
    block = rig.single() if arithmetic == "float" else rig
    e = np.random.default_rng(2).normal(0, 0.1 * ERROR, (2000, 4))
    e[100:104, 1] = np.nan
    player = opened(block, version, tmp_path, arithmetic)
    found, status = player.play(block, e)
    if arithmetic == "fixed32":
        fixed = in_words(block)
        words = np.floor(np.nan_to_num(e, nan=0) / ERROR * 2**30 + 0.5).astype(np.int64)
        run = run_of(fixed, words, valid=~np.isnan(e))
        assert np.abs(found - run.currents * (CURRENT / 2**30)).max() <= 1e-15 * CURRENT
    else:
        run = run_of(block, e.astype(np.float32).astype(float))
        assert np.abs(found - run.currents).max() <= 1e-4 * CURRENT
    assert (status == run.status).all()
    assert set(status) >= {0, HELD, LIMITED}


@compiler
@pytest.mark.parametrize("version", VERSIONS)
def test_steps_of_several_samples_and_no_others(version, tmp_path):
    block = small_block()
    player = opened(block, version, tmp_path)
    player.set(["err_x", "err_y"], [1e-4, -2e-4])
    player.step(5 * block.sample_time)
    expected = run_of(block, np.tile([1e-4, -2e-4], (5, 1))).currents[-1]
    assert np.abs(np.array(player.get(["u_x"])) - expected).max() <= 1e-12
    assert player.get(["time"]) == [pytest.approx(5 * block.sample_time)]
    for step in (0.5 * block.sample_time, 1.5 * block.sample_time, 0.0, -block.sample_time, np.nan):
        with pytest.raises(Exception, match=r"(?i)dostep"):
            player.step(step)
    assert np.abs(np.array(player.get(["u_x"])) - expected).max() <= 1e-12  # nothing happened


@compiler
@pytest.mark.parametrize("version", VERSIONS)
def test_state_saved_restored_serialized_and_reset(version, tmp_path):
    block = small_block()
    player = opened(block, version, tmp_path)
    e, _ = driver.adversarial(block, 300)
    first, _ = player.play(block, e)
    state = player.saved()
    after, _ = player.play(block, e)
    assert not np.array_equal(after, first)
    player.restore(state)
    assert np.array_equal(player.play(block, e)[0], after)
    again = player.from_bytes(player.as_bytes(state))
    player.restore(again)
    assert np.array_equal(player.play(block, e)[0], after)
    for s in (state, again):
        player.free(s)
    with pytest.raises(Exception, match=r"(?i)deserialize"):
        player.from_bytes(b"\0" * 7)
    player.fmu.reset()
    player.begin()
    assert np.array_equal(player.play(block, e)[0], first)


@compiler
@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("arithmetic", ["double", "fixed32"])
def test_tracking_then_control_without_a_bump(rig, version, arithmetic, tmp_path):
    player, given = opened(rig, version, tmp_path, arithmetic), [1.0, -0.5, 2.0, 0.25]
    player.set(list(rig.inputs), [1e-6, -2e-6, 3e-6, 0.0])
    player.set([f"given_{name}" for name in rig.outputs], given)
    player.set_flags(["tracking"], [True])
    for _ in range(3):
        player.step(rig.sample_time)
        assert np.abs(np.array(player.get(list(rig.outputs))) - given).max() <= (
            0 if arithmetic == "double" else 1e-8
        )
    player.set_flags(["tracking"], [False])
    player.step(rig.sample_time)
    tolerance = 1e-11 if arithmetic == "double" else 2e-3
    assert np.abs(np.array(player.get(list(rig.outputs))) - given).max() <= tolerance


@compiler
@pytest.mark.parametrize("version", VERSIONS)
def test_a_wrong_token_or_variable_is_refused(version, tmp_path):
    player = opened(small_block(), version, tmp_path)
    with pytest.raises(Exception, match=r"(?i)instantiate"):
        player.loaded(token="{00000000-0000-0000-0000-000000000000}")
    for name in ("u_x", "time"):  # outputs
        with pytest.raises(Exception, match=r"Set(Real|Float64)"):
            player.set([name], [1.0])
    player.refs["absent"] = 99
    with pytest.raises(Exception, match=r"Get(Real|Float64)"):
        player.get(["absent"])
    with pytest.raises(Exception, match="GetBoolean"):
        player.get_flags(["u_x"])


@compiler
@pytest.mark.parametrize("name", driver.compilers())
@pytest.mark.parametrize("arithmetic", ["double", "fixed16"])
def test_sources_fit_the_headers_of_the_standard(version_headers, name, arithmetic, tmp_path):
    """Compiled with the standard's declarations before ours: every signature agrees, and every
    function is there.
    """
    version, header = version_headers
    block = small_block(0 if arithmetic == "double" else 2)
    if arithmetic == "fixed16":
        block = small_block(
            2,
            system=StateSpace(
                [[-300.0]], [[300.0, 100.0]], [[1e3]], [[500.0, 0.0]], ["err_x", "err_y"], ["u_x"]
            ),
        )
    for file, text in generate_sources(block, version, arithmetic).items():
        (tmp_path / file).write_text(text)
    wrapper = tmp_path / f"fmi{version[0]}.c"
    for flags in ([], ["-I", str(HEADERS), "-include", header]):
        out = tmp_path / "wrapper.o"
        # the standard's 3.0 header declares two callbacks without a prototype
        extra = (
            [
                "-Wno-unknown-warning-option",
                "-Wno-strict-prototypes",
                "-Wno-deprecated-non-prototype",
            ]
            if flags and name == "clang"
            else []
        )
        driver.build(name, ["-O2", "-fPIC", *flags, *extra, "-c", str(wrapper), "-o", str(out)])
    listed = subprocess.run(
        ["nm", "-g", "--defined-only", str(out)], capture_output=True, text=True, check=True
    ).stdout
    defined = {line.split()[-1] for line in listed.splitlines()}
    text = (HEADERS / header).read_text()
    declared = set(re.findall(r"\b(fmi[23][A-Z]\w+)TYPE\b", text))
    absent = set(_MODEL_EXCHANGE.split()) if version == "2.0" else set()
    assert len(declared) > 40
    assert defined == {f for f in declared if f[4:] not in absent}


_CHECK_2 = """
#include "fmi2.c"
int main(void)
{
    const fmi2CallbackFunctions none = {0, 0, 0, 0, 0};
    unsigned refs[] = {VR_ERROR, VR_CURRENT, 99};
    double values[] = {1e-4, 0, 0};
    char bytes[sizeof(memory)];
    fmi2FMUstate state = 0, copy = 0;
    size_t size;
    int k;
    fmi2Component c = fmi2Instantiate("x", fmi2CoSimulation, "TOKEN", "", &none, 0, 0);
    if (!c || fmi2Instantiate("x", fmi2CoSimulation, "other", "", &none, 0, 0) || fmi2DoStep(0, 0, 1, 1) != fmi2Error)
        return 1;
    for (k = 0; k < 1000; k++)
        if (fmi2SetReal(c, refs, 1, values) != fmi2OK || fmi2DoStep(c, 0, SAMPLE, 1) != fmi2OK)
            return 2;
    if (fmi2GetReal(c, refs, 2, values) != fmi2OK || fmi2GetReal(c, refs, 3, values) != fmi2Error)
        return 3;
    if (fmi2GetFMUstate(c, &state) || fmi2SerializedFMUstateSize(c, state, &size) || size != sizeof bytes)
        return 4;
    if (fmi2SerializeFMUstate(c, state, bytes, size) || fmi2DeSerializeFMUstate(c, bytes, size, &copy))
        return 5;
    if (fmi2SetFMUstate(c, copy) || fmi2FreeFMUstate(c, &state) || fmi2FreeFMUstate(c, &copy) || state || copy)
        return 6;
    fmi2FreeInstance(c);
    return 0;
}
"""


@compiler
@pytest.mark.parametrize(
    ("version", "delay"),
    [
        *zip((*VERSIONS, VERSIONS[0]), (0, 1, 3), strict=True),
        *(
            pytest.param(*other, marks=pytest.mark.study)
            for other in zip((*VERSIONS[::-1], VERSIONS[1]), (0, 1, 3), strict=True)
        ),
    ],
)
def test_wrappers_under_the_sanitizers(version, delay, tmp_path):
    """A thousand steps, refusals and saved states, without a leak or an access beyond an array."""
    block = rig_block(delay)
    for file, text in generate_sources(block, version, "double").items():
        (tmp_path / file).write_text(text)
    check = _CHECK_2.replace("SAMPLE,", f"{block.sample_time},")
    if version == "3.0":  # the same calls in its words
        check = re.sub(
            r"fmi2Instantiate\(\"x\", fmi2CoSimulation, (\"\w+\"), \"\", &none, 0, 0\)",
            r'fmi3InstantiateCoSimulation("x", \1, "", 0, 0, 0, 0, 0, 0, 0, 0, 0)',
            check,
        )
        check = re.sub(
            r"fmi2DoStep\((.*?), 1\)",
            r"fmi3DoStep(\1, 1, flags, flags + 1, flags + 2, values + 2)",
            check,
        )
        check = re.sub(
            r"fmi2(Get|Set)Real\(c, refs, (\d), values\)",
            r"fmi3\1Float64(c, refs, \2, values, \2)",
            check,
        )
        check = check.replace(
            "fmi2CallbackFunctions none = {0, 0, 0, 0, 0}", "int none = 0"
        ).replace("int k;", "bool flags[3]; int k;")
        check = (
            check.replace("DeSerialize", "Deserialize")
            .replace("FMUstate", "FMUState")
            .replace("fmi2Component", "fmi3Instance")
        )
        check = (
            check.replace("char bytes", "uint8_t bytes")
            .replace("fmi2", "fmi3")
            .replace("int k;", "int k; (void)none;")
        )
    (tmp_path / "check.c").write_text(check)
    sources = [str(tmp_path / "check.c"), str(tmp_path / "rig.c")]
    driver.build("gcc", [*driver.sanitizers("gcc"), *sources, "-o", str(tmp_path / "check"), "-lm"])
    done = subprocess.run([str(tmp_path / "check")], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.fixture(params=[("2.0", "fmi2Functions.h"), ("3.0", "fmi3Functions.h")], ids=VERSIONS)
def version_headers(request):
    return request.param


@compiler
@needs("make")
@pytest.mark.parametrize("version", VERSIONS)
def test_fmpy_builds_the_sources_itself(version, tmp_path, monkeypatch):
    """An FMU of sources only: FMPy finds what to compile in the FMU, builds it with CMake, and runs
    it.
    """
    # CMake comes with FMPy
    monkeypatch.setenv("PATH", str(Path(sys.executable).parent), prepend=":")
    block = small_block()
    (tmp_path / "x.fmu").write_bytes(generate_fmu(block, version, sources_only=True))
    folder = fmpy.extract(str(tmp_path / "x.fmu"), str(tmp_path / "x"))
    (tmp_path / "build").mkdir()
    build_platform_binary(folder, tmp_path / "build", generator="Unix Makefiles")
    shutil.make_archive(str(tmp_path / "built"), "zip", folder)
    player = Player(tmp_path / "built.zip", tmp_path / "opened")
    player.begin()
    e, valid = driver.adversarial(block, 1000)
    assert (
        np.abs(player.play(block, e, valid)[0] - run_of(block, e, valid=valid).currents).max()
        <= 1e-12
    )


@compiler
@pytest.mark.parametrize("version", VERSIONS)
def test_contents_and_repeatable_bytes(version):
    block = small_block()
    content = generate_fmu(block, version, provenance=["from <here> & there"])
    assert content == generate_fmu(block, version, provenance=["from <here> & there"])
    found = files_of(content)
    binaries = [name for name in found if name.startswith("binaries/")]
    assert len(binaries) == 1
    assert {
        "sources/small.c",
        "sources/small.h",
        "sources/small_fmu.h",
        f"sources/fmi{version[0]}.c",
    } < set(found)
    assert b"from &lt;here&gt; &amp; there" in found["documentation/index.html"]
    assert b"TOKEN" not in found[f"sources/fmi{version[0]}.c"]
    other = files_of(generate_fmu(replace(block, hold_samples=3), version, sources_only=True))[
        "modelDescription.xml"
    ]
    assert other != found["modelDescription.xml"]  # another code, another token


@pytest.mark.parametrize("version", VERSIONS)
def test_variables_units_and_limits(version, tmp_path):
    (tmp_path / "x.fmu").write_bytes(generate_fmu(rig_block(0), version, sources_only=True))
    found = {v.name: v for v in fmpy.read_model_description(str(tmp_path / "x.fmu")).modelVariables}
    assert found["err_A_zeta"].unit == "m"
    assert found["u_B_eta"].unit == "A"
    assert float(found["u_B_eta"].max) == CURRENT
    assert found["valid_err_A_zeta"].start == "true"
    assert [
        found[n].causality for n in ("tracking", "given_u_A_zeta", "held", "fault", "limited")
    ] == ["input"] * 2 + ["output"] * 3
    description = fmpy.read_model_description(str(tmp_path / "x.fmu"))
    assert float(description.defaultExperiment.stepSize) == 1e-4
    needs = {o.variable.name: [v.name for v in o.dependencies] for o in description.outputs}
    # without delay the outputs depend on the inputs of the same instant
    assert needs["u_A_zeta"][0] == "err_A_zeta"
    (tmp_path / "x.fmu").write_bytes(generate_fmu(rig_block(1), version, sources_only=True))
    later = fmpy.read_model_description(str(tmp_path / "x.fmu"))
    assert all(o.dependencies == [] for o in later.outputs)


def test_without_a_compiler(monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with pytest.raises(InvalidInput, match=r"no C compiler was found .* sources only"):
        generate_fmus(small_block())
    for content in generate_fmus(small_block(), sources_only=True).values():
        assert not [name for name in files_of(content) if name.startswith("binaries/")]


def test_a_compiler_that_fails(monkeypatch, tmp_path):
    (tmp_path / "cc").write_text("#!/bin/sh\necho 'no licence today' >&2\nexit 3\n")
    (tmp_path / "cc").chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    with pytest.raises(
        InvalidInput, match=r"refused the code: no licence today; write an FMU of sources only"
    ):
        generate_fmus(small_block())


def test_a_platform_without_a_name(monkeypatch):
    monkeypatch.setattr("platform.machine", lambda: "mips")
    with pytest.raises(
        InvalidInput,
        match=r"this computer is Linux mips, but must be a platform that FMI 2.0 names",
    ):
        generate_fmu(small_block(), "2.0")


@pytest.mark.parametrize(
    "names", [(["held", "b"], ["c"]), (["a", "b"], ["time"]), (["a", "valid_a"], ["c"])]
)
def test_signals_called_like_variables_of_the_fmu(names):
    K = StateSpace([[-1.0]], [[1.0, 1.0]], [[1.0]], [[0.0, 0.0]], *names)
    with pytest.raises(InvalidInput, match="must be unlike the FMU's own variables"):
        generate_fmu(small_block(system=K), "2.0", sources_only=True)


def test_nothing_half_written_when_the_disk_is_full(tmp_path, monkeypatch):
    calls = []

    def full(descriptor):
        calls.append(descriptor)
        if len(calls) == 2:
            raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(InvalidInput, match="No space left on device; nothing was changed"):
        write_files(tmp_path / "new", generate_fmus(small_block(), sources_only=True))
    assert list(tmp_path.iterdir()) == []


def test_limits_are_those_of_the_code(tmp_path):
    """In single precision 0.3 A is a little more: the description says so, and no output leaves its
    range.
    """
    block = replace(small_block(), current_limit=np.array([0.3]))
    (tmp_path / "x.fmu").write_bytes(generate_fmu(block, "3.0", "float", sources_only=True))
    found = {v.name: v for v in fmpy.read_model_description(str(tmp_path / "x.fmu")).modelVariables}
    assert float(found["u_x"].max) == float(np.float32(0.3)) > 0.3


def test_gain_has_nothing_to_track():
    names = [v.name for v in variables(gain_block())]
    assert not gain_block().transfers
    assert "tracking" not in names
