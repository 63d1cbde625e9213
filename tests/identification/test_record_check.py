"""Whether a record can be used, and for what."""

import json
import re
from dataclasses import replace

import h5py
import numpy as np
import pytest
from benchmarks.rig_cases import CASES, CONVERTERS, Rig, as_record, excited, fresh, told, unbalanced
from click.testing import CliRunner
from docs_build import DOCS

import ambrose as amb
from ambrose.cli import main
from ambrose.core.checks import InvalidInput
from ambrose.core.response import simulate
from ambrose.core.sampling import c2d
from ambrose.core.statespace import select
from ambrose.identification.findings import Code
from ambrose.judge.result import pid_synthesis
from ambrose.law.loop import closed_loop, match_controller
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import free_mode_reduction
from ambrose.record.files import write_record
from ambrose.record.record import POINT_KEYS
from ambrose.record.response import Path, Response
from ambrose.record.response_files import write_response
from coarse import coarse
from one_axis_loop import levitate

AXES = ("A_zeta", "A_eta", "B_zeta", "B_eta")


def record(kinds="yue", axes=AXES, speed=0.0, change=None, count=20_000):
    """Noise under the names of a machine with two bearings."""
    rng = np.random.default_rng(0)
    names = [f"{kind}_{axis}" for kind in kinds for axis in axes]
    units = ["m" if name[0] == "y" else "A" for name in names]
    values = 1e-5 * rng.standard_normal((len(names), count))
    for name, row in (change or {}).items():
        values[names.index(name)] = row
    point = amb.OperatingPoint(speed=speed, seal_pressure=0.0)
    return amb.Record("seal-rig", 10e3, tuple(names), tuple(units), values, point)


@pytest.fixture(scope="module")
def loop():
    """A record of the seal rig under its PID: the linear loop, excited and with noise."""
    machine = coarse("seal-rig")
    plant = free_mode_reduction(assemble(machine), 2)
    K = match_controller(pid_synthesis(plant).controller, plant)
    K = c2d(K, 1e-4, method="tustin")
    names = [f"{kind}_{axis}" for kind in "yui" for axis in AXES]
    system = select(closed_loop(plant, K), [f"e_{axis}" for axis in AXES], names)
    rng = np.random.default_rng(5)
    e = 0.05 * np.repeat(rng.choice([-1.0, 1.0], (4, 5000)), 4, axis=1)
    values = np.vstack([simulate(system, e), e])
    values[:4] += 2e-8 * rng.standard_normal(values[:4].shape)
    names += [f"e_{axis}" for axis in AXES]
    units = ["m" if name[0] == "y" else "A" for name in names]
    point = replace(machine.operation.envelope[0], label="")
    return machine, amb.Record("seal-rig", 1e4, tuple(names), tuple(units), values, point)


def with_rows(record, change):
    values = record.values.copy()
    change(values)
    return replace(record, values=values)


def at(record, **point):
    return replace(record, point=replace(record.point, **point))


def stuck(values):
    values[2, 7000:17000] = values[2, 7000]


def hung(values):
    values[0, -1500:] = 0.0


def shuffled(values):
    values[:4] = values[:4, np.random.default_rng(0).permutation(values.shape[1])]


def swapped(values):
    values[[0, 2]] = values[[2, 0]]


def turned(values):
    values[1] *= -1


def of_u(values):
    values[[4, 5]] = values[[5, 4]]


def biased(values):
    values[8:12] += 100.0


MUTATIONS = {
    "another machine": lambda r: replace(r, machine="turbomolecular-pump"),
    "ten times the rate": lambda r: replace(r, sample_rate_hz=1e5),
    "half the rate": lambda r: replace(r, sample_rate_hz=5e3),
    "negative pressure": lambda r: at(r, seal_pressure=-2e5),
    "pressure in another unit": lambda r: at(r, seal_pressure=2e9),
    "100 A of bias": lambda r: at(r, bias_current=100.0),
    "a bias in mA": lambda r: at(r, bias_current=2.5e-3),
    "another speed": lambda r: at(r, speed=9e4),
    "bias in the currents": lambda r: with_rows(r, biased),
    "a sensor stuck for half of it": lambda r: with_rows(r, stuck),
    "a sensor that hangs at the end": lambda r: with_rows(r, hung),
    "shuffled displacements": lambda r: with_rows(r, shuffled),
    "swapped displacements": lambda r: with_rows(r, swapped),
    "a turned displacement": lambda r: with_rows(r, turned),
    "swapped commands": lambda r: with_rows(r, of_u),
}


def changed(change):
    """A change of the rows: y, u, i, e of A_zeta, A_eta, B_zeta, B_eta."""
    return lambda record: with_rows(record, change)


def one_by_one(values, factors):
    values *= np.asarray(factors)[:, None]


def times(**factors):
    """Kinds of signal, or y0 and the like, times a number."""
    rows = np.ones(16)
    for name, factor in factors.items():
        start = 4 * "yuie".index(name[0])
        rows[slice(start, start + 4) if len(name) == 1 else start + int(name[1])] = factor
    return changed(lambda values: one_by_one(values, rows))


def rolled(rows, count):
    return changed(lambda v: v.__setitem__(rows, np.roll(v[rows], count, axis=-1)))


def put(rows, made):
    return changed(lambda v: v.__setitem__(rows, made(v)))


def wrapped(v):
    half = 1.5 * v[0].std()
    return (v[0] + half) % (2 * half) - half


def held_row(row):
    return changed(lambda v: v.__setitem__((row, slice(5000, 15000)), v[row, 5000]))


NOISE = np.random.default_rng(1).standard_normal(20_000)
# none of these was doubted
SILENT = {
    "samples missing": lambda r: replace(r, values=np.delete(r.values, np.s_[9000:9100], axis=1)),
    "filled up with zeros": put(np.s_[:, -6000:], lambda v: 0.0),
    "noise in place of a probe": put(1, lambda v: 1e-6 * NOISE),
    "a converter that wraps": put(0, wrapped),
    "a probe's gain three times": times(y0=3.0),
    "excitations ten samples late": rolled(np.s_[12:16], 10),
    "a stuck current": held_row(8),
    "a stuck excitation": held_row(12),
    "a quarter more rate": lambda r: replace(r, sample_rate_hz=1.25e4),
    "a rate in kHz": lambda r: replace(r, sample_rate_hz=10.0),
}
SEEN = {
    "swapped excitations": put([12, 13], lambda v: v[[13, 12]]),
    "a turned excitation": times(e0=-1.0),
    "a probe in mm": times(y0=1e3),
    "all probes in km": times(y=1e-3),
    "half of all displacements": times(y=0.5),
    "all probes turned": times(y=-1.0),
    "currents in mA": times(i=1e3),
    "commands in mA": times(u=1e3),
    "turned currents": times(i=-1.0),
    "turned commands": times(u=-1.0),
    "backwards": put(np.s_[:], lambda v: v[:, ::-1].copy()),
    "a clipped probe": put(0, lambda v: np.clip(v[0], -v[0].std(), v[0].std())),
    "every sample twice": put(np.s_[:], lambda v: np.repeat(v[:, ::2], 2, axis=1)),
    "a dead probe": times(y2=0.0),
    "a dead current": times(i1=0.0),
    "one probe for four": put(np.s_[:4], lambda v: v[0].copy()),
    "a command for a probe": put(0, lambda v: 1e-6 * v[4]),
    "a probe's zero 1 mm off": put(0, lambda v: v[0] + 1e-3),
    "a coarse converter": put(0, lambda v: np.round(v[0] / v[0].std()) * v[0].std()),
    "velocities": put(np.s_[:4], lambda v: 10 * np.gradient(v[:4], axis=1)),
    "a speed in rpm": lambda r: at(r, speed=9e3),
    "a tenth of the rate": lambda r: replace(r, sample_rate_hz=1e3),
    "bearings in the wrong place": put(
        np.s_[:], lambda v: v.reshape(4, 4, -1)[:, [2, 3, 0, 1]].reshape(v.shape)
    ),
    "a tenth of the excitation": times(e=0.1),
    "the excitation of another run": rolled(np.s_[12:16], 7001),
    "a stuck command": held_row(4),
}


@pytest.mark.parametrize(
    "name", [*SILENT, *(pytest.param(name, marks=pytest.mark.study) for name in SEEN)]
)
def test_a_record_that_something_is_wrong_with_is_refused_or_doubted(loop, name):
    machine, whole = loop
    check = amb.check_record({**SILENT, **SEEN}[name](whole), machine)
    assert check.findings, name
    assert all("; " in str(finding) for finding in check.findings)


@pytest.mark.study
@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.machine)
def test_a_correct_record_of_another_rig_raises_no_doubt(case, seed):
    """Magnets, seal and amplifier 3 % off the file's, on a rig that shares nothing with the model."""
    rng = np.random.default_rng(seed)
    machine, point, _, K = told(case, bool(seed % 2))
    numbers = fresh(case, rng)
    more = {"unbalance": unbalanced(numbers, point.speed, rng)} if point.speed else {}
    rig = Rig(
        numbers, case.rate, point.speed, saturation=2.0 * (seed % 3 > 0), **more, **CONVERTERS
    )
    found = rig.run(K, excited(case, rig, 2.0, 0.02, 4e-4, seed), seed=seed)
    check = amb.check_record(as_record(case, rig, found, "yuie"), machine)
    assert check.passed and not check.findings, [str(finding) for finding in check.findings]


@pytest.mark.parametrize("name", [None, *MUTATIONS])
@pytest.mark.parametrize("kinds", ["yuie", "yie"])
def test_a_record_that_identify_would_refuse_is_refused_without_its_controller(loop, name, kinds):
    machine, whole = loop
    record = whole if name is None else MUTATIONS[name](whole)
    if name == "swapped commands" and kinds == "yie":
        return  # there are none
    record = record.select([signal for signal in record.signals if signal[0] in kinds])
    check = amb.check_record(record, machine)
    errors = [str(finding) for finding in check.findings if finding.severity == "error"]
    assert check.passed == (name is None) and bool(errors) == (name is not None), errors
    assert name or not check.findings
    assert "not checked" not in dict(check.contents)


@pytest.mark.parametrize("name", ["another machine", "shuffled displacements", "100 A of bias"])
def test_without_commands_and_currents_it_says_what_was_not_checked(loop, name):
    machine, whole = loop
    few = [signal for signal in whole.signals if signal[0] in "ye"]
    check = amb.check_record(whole.select(few), machine)
    assert check.passed and "against the plant" in dict(check.contents)["not checked"]
    assert not amb.check_record(MUTATIONS[name](whole).select(few), machine).passed


def usable(check):
    return {use.command for use in check.uses if use.usable}


@pytest.mark.parametrize(
    ("kinds", "speed", "commands"),
    [
        ("yue", 0.0, {"identify", "identify --method youla", "frf", "accept", "retune"}),
        ("ye", 0.0, {"identify", "frf", "accept", "retune"}),
        ("yu", 500.0, {"balance"}),
        ("u", 0.0, set()),
    ],
)
def test_what_a_record_is_good_for(kinds, speed, commands, loop):
    _, whole = loop
    driven = [name for name in whole.signals if name[0] in kinds]
    given = whole.select(driven) if "e" in kinds else record(kinds, speed=speed)
    check = amb.check_record(given, "seal-rig")
    assert usable(check) == commands and check.passed == bool(commands)


def test_a_record_written_by_hand_as_the_protocol_says_serves(tmp_path):
    """The page's own head, columns in another order, rows by numpy: nothing of the package."""
    page = (DOCS / "research" / "protocol.md").read_text(encoding="utf-8")
    *head, names, row = re.search(r"```csv\n(# format.*?)\n```", page, re.S)[1].splitlines()
    columns = np.array(names.split(","))
    assert len(row.split(",")) == len(columns)
    order = [0, *(1 + np.random.default_rng(1).permutation(len(columns) - 1))]
    time = np.arange(20_000) / 10_000
    waves = np.random.default_rng(0).standard_normal((len(columns) - 1, len(time)))
    path = tmp_path / "by-hand.csv"
    top = "\n".join([*head, ",".join(columns[order])])
    rows = np.column_stack([time, waves.T])[:, order]
    np.savetxt(path, rows, header=top, comments="", delimiter=",", fmt="%.7g")
    check = amb.check_record(path)
    assert check.passed and {"identify", "identify --method youla", "frf"} <= usable(check)
    assert "314.2 rad/s" in dict(check.contents)["point"]


def test_where_it_ran_is_said_in_words():
    contents = dict(amb.check_record(record("ye", speed=500.0)).contents)
    assert contents["point"] == "without label (500 rad/s, 0 Pa)"


def test_a_logger_s_table_of_several_axes_is_sent_to_the_column_map(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("Zeit;Kanal 1;Kanal 2\n" + "".join(f"{k};1,5;2,5\n" for k in range(20)))
    with pytest.raises(InvalidInput, match=r"several axes of a machine .*convert --columns"):
        amb.check_record(path)


def test_a_missing_axis_and_a_silent_excitation_are_named():
    check = amb.check_record(record("ye", AXES[:3]), "seal-rig")
    (use,) = (use for use in check.uses if use.command == "identify")
    assert not use.usable and "(B_eta)" in use.reason
    quiet = {f"e_{axis}": 0.0 for axis in AXES}
    check = amb.check_record(record(change=quiet))
    (use,) = (use for use in check.uses if use.command == "identify")
    assert "never change" in use.reason and not usable(check) & {"frf", "accept"}


@pytest.mark.parametrize("machine", [None, "seal-rig"])
def test_what_is_wrong_with_a_signal(machine):
    check = amb.check_record(record(change={"y_A_eta": 3e-6}), machine)
    assert Code.DEAD_CHANNEL in {finding.code for finding in check.findings}
    assert not check.passed
    waves = 1e-4 * np.sin(np.arange(20_000) / 30)
    check = amb.check_record(record(change={"y_A_eta": np.clip(waves, -9e-5, 9e-5)}), machine)
    assert Code.CLIPPED in {finding.code for finding in check.findings}


def test_axes_of_another_machine():
    check = amb.check_record(record("ye", ("C_zeta", "C_eta")), "seal-rig")
    assert "none of the machine's" in str(check.findings[0])


def test_one_axis_is_tried(tmp_path):
    time, y, u, r = levitate(seed=2)
    path = tmp_path / "axis.txt"
    np.savetxt(path, np.column_stack([time, y, u, r]), header="t y u r", fmt="%.9g")
    run = CliRunner().invoke(main, ["record", "check", str(path), "--json"])
    said = json.loads(run.stdout)
    assert run.exit_code == 0 and said["uses"][0]["usable"]
    assert said["uses"][0]["reason"].startswith("identified: pole")
    time, y, u, _ = levitate(kind="none")
    np.savetxt(path, np.column_stack([time, y, u]), header="t y u", fmt="%.9g")
    run = CliRunner().invoke(main, ["record", "check", str(path)])
    assert run.exit_code == 1 and "drives the loop" in run.output


@pytest.mark.parametrize("factor", [1e12, 1e-12])
def test_times_of_no_clock_are_refused(tmp_path, factor):
    """Sampled every four years, or 1e16 times a second, an axis was identified with status 0."""
    time, y, u, r = levitate(seed=2)
    path = tmp_path / "axis.txt"
    np.savetxt(path, np.column_stack([factor * time, y, u, r]), header="t y u r", fmt="%.9g")
    with pytest.raises(InvalidInput, match=r"sample_rate_hz is .*, but must be 0.0001 to 1e.07 Hz"):
        amb.check_record(path)


def test_a_file_that_cannot_be_read(tmp_path):
    with pytest.raises(InvalidInput):
        amb.check_record(tmp_path / "nothing.h5")


# what no record has; a negative speed was identified with, and NaN passed in responses
IMPOSSIBLE = [
    ("speed_rad_s", np.nan),
    ("speed_rad_s", -100.0),
    ("seal_pressure_pa", np.nan),
    ("bias_current_a", -2.0),
    ("bias_current_a", 0.0),
    ("whirl_frequency_rad_s", -5.0),
    ("sample_rate_hz", np.nan),
    ("sample_rate_hz", 1e12),
]
# that it may be read with, and no machine's
UNUSUAL = [
    ("speed_rad_s", 9e5),
    ("seal_pressure_pa", 1e9),
    ("seal_pressure_pa", -1e5),
    ("bias_current_a", 1e3),
    ("bias_current_a", 1e-4),
]
NAMES = {
    "speed_rad_s": "speed",
    "seal_pressure_pa": "seal pressure",
    "bias_current_a": "bias current",
}


def responses():
    omega = 2 * np.pi * np.geomspace(10, 1000, 30)
    paths = tuple(Path("S", axis, axis, 1 / (1 + 300 / (1j * omega))) for axis in AXES)
    return Response("seal-rig", omega, paths, amb.OperatingPoint(), sample_rate_hz=1e4)


def write_with(path, key, value):
    """A file of a record or of responses whose attribute ``key`` is ``value``."""
    if path.stem == "record":
        write_record(record("yue", count=5000), path)
    else:
        write_response(responses(), path)
    if path.suffix == ".h5":
        with h5py.File(path, "r+") as file:
            file.attrs[key] = value
        return
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    kept = [line for line in lines if not line.startswith(f"# {key}:")]
    path.write_text(f"# {key}: {value}\n" + "".join(kept), encoding="utf-8")


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    plant = free_mode_reduction(assemble(amb.load_machine("seal-rig")), 2)
    K = match_controller(pid_synthesis(plant).controller, plant)
    return amb.write_controller(tmp_path_factory.mktemp("ran") / "K.json", K)


@pytest.mark.parametrize("file", ["record.h5", "record.csv", "responses.h5", "responses.csv"])
@pytest.mark.parametrize(("key", "value"), IMPOSSIBLE)
def test_a_number_that_no_record_has_is_refused_on_reading(tmp_path, file, key, value):
    path = tmp_path / file
    write_with(path, key, value)
    for machine in (None, "seal-rig"):
        with pytest.raises(InvalidInput, match=key.partition("_")[0]):
            amb.check_record(path, machine)


@pytest.mark.parametrize(("key", "value"), IMPOSSIBLE[:6])
def test_a_number_that_no_record_has_is_refused_in_one_made_here(key, value):
    at_it = {POINT_KEYS[key]: value}
    for made in (record("yue", count=100), responses()):
        with pytest.raises(InvalidInput, match=key):
            at(made, **at_it)


@pytest.mark.parametrize("file", ["record.h5", "responses.csv"])
@pytest.mark.parametrize(("key", "value"), UNUSUAL)
def test_a_number_of_no_machine_fails_the_check_and_the_identification(
    tmp_path, ran, file, key, value
):
    path = tmp_path / file
    write_with(path, key, value)
    said = f"the {NAMES[key]} of the record's operating point is {value:.4g}"
    for machine in (None, "seal-rig"):
        check = amb.check_record(path, machine)
        (found,) = (item for item in check.findings if item.code == Code.OPERATING_POINT)
        assert not check.passed and str(found).startswith(said)
    run = CliRunner().invoke(
        main,
        [
            "identify",
            "seal-rig",
            str(path),
            "--controller",
            str(ran),
            "-o",
            str(tmp_path / "o.toml"),
        ],
    )
    assert run.exit_code == 2 and said in run.output


def test_an_idle_gauge_a_little_below_zero_is_no_mistake():
    assert amb.check_record(at(record("yue"), seal_pressure=-150.0)).passed


SEMICOLON = r"separated by a semicolon, but must be by commas; export it with commas and decimal"
WIDE = r'text in UTF-16 \("Unicode text"\); save it as CSV in UTF-8'
SAVED = {
    "semicolons and decimal commas": (
        lambda text: text.replace(".", "@").replace(",", ";").replace("@", ",").encode(),
        SEMICOLON,
    ),
    "semicolons": (lambda text: text.replace(",", ";").encode(), SEMICOLON),
    "tabs": (lambda text: text.replace(",", "\t").encode(), SEMICOLON.replace("semicolon", "tab")),
    "UTF-16": (lambda text: text.encode("utf-16"), WIDE),
    "UTF-16, big end first": (lambda text: b"\xfe\xff" + text.encode("utf-16-be"), WIDE),
    "UTF-16 without a mark": (lambda text: text.encode("utf-16-le"), WIDE),
}


@pytest.mark.parametrize("file", ["record.csv", "responses.csv"])
@pytest.mark.parametrize("how", SAVED)
def test_a_table_saved_by_a_spreadsheet_is_refused_in_a_sentence(tmp_path, ran, file, how):
    """Semicolons in responses were "a column from ''"; UTF-16 was sent to a column map."""
    path, (change, words) = tmp_path / file, SAVED[how]
    if file == "record.csv":
        write_record(record("yue", count=500), path)
    else:
        write_response(responses(), path)
    path.write_bytes(change(path.read_text(encoding="utf-8")))
    for command in (["record", "check", str(path)], ["identify", "seal-rig", str(path)]):
        more = ["--controller", str(ran)] if command[0] == "identify" else []
        run = CliRunner().invoke(main, [*command, *more])
        (said,) = (line for line in run.output.splitlines() if line.startswith("ambrose: "))
        assert run.exit_code == 2 and re.search(words, said), said
        assert said.count("; ") == 1
