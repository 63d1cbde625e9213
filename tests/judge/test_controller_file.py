"""The controller file: exact round trips, atomic writing, and a reader that refuses what it does
not know.
"""

from __future__ import annotations

import json
import math
import stat
import sys
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from ambrose import __version__
from ambrose.core.checks import InvalidInput
from ambrose.core.scheduled import ScheduledSystem
from ambrose.core.statespace import StateSpace, static_gain
from ambrose.judge.controller_file import controller_schema, read_controller, write_controller
from ambrose.judge.result import Certificate, Provenance, Status, Synthesis
from ambrose.law.design_problem import Weights, control_weight, performance_weight, scale_control
from ambrose.law.loop import match_controller
from ambrose.machine.description import MagneticBearing, OperatingPoint
from ambrose.machine.file.toml import machine_hash
from ambrose.machine.machine import Machine
from ambrose.machine.part import Sensor, ShaftSection
from ambrose.model.assemble import assemble

AXES = ("A_zeta", "A_eta", "B_zeta", "B_eta")
INPUTS, OUTPUTS = [f"err_{a}" for a in AXES], [f"u_{a}" for a in AXES]
DATE = datetime(2026, 1, 31, 12, 0, 0, tzinfo=UTC)
MACHINE = Machine(
    name="small",
    shaft=(ShaftSection(start=0.0, length=0.8, outer_diameter=0.1),),
    bearings=tuple(
        MagneticBearing(
            name, z, 6.0, force_per_current=(150.0, 150.0), negative_stiffness=(1e6, 1e6)
        )
        for name, z in (("A", 0.2), ("B", 0.6))
    ),
    sensors=(Sensor("A", 0.2), Sensor("B", 0.6)),
)

WEIGHTS = scale_control(
    Weights(performance_weight(2.5, 7.0, 0.01), control_weight(0.2, 3e3, 2), 15e-6, 0.7, 0.3, 1.9),
    1 / 3,
)


def random_controller(n: int, seed: int = 0, dt: float | None = None) -> StateSpace:
    rng = np.random.default_rng(seed)
    scale = 10.0 ** rng.integers(-12, 12, (n + 4, n + 4))
    M = rng.standard_normal((n + 4, n + 4)) * scale
    return StateSpace(M[:n, :n], M[:n, n:], M[n:, :n], M[n:, n:], INPUTS, OUTPUTS, dt)


def synthesis(controller: StateSpace, **changes) -> Synthesis:
    margins = {
        "sensitivity_peak": 2.9 + 1e-15,
        "gain_margin": math.inf,
        "phase_margin_rad": 0.1 + 0.2,
    }
    certificate = Certificate(
        True, -5.1 / 3, 2.9 + 1e-15, 2857.1428571428573, margins, "small, standstill, 24 states"
    )
    return replace(
        Synthesis(controller, "pid", math.nan, Status.VERIFIED, certificate, weights=WEIGHTS),
        **changes,
    )


class TestRoundTrip:
    @pytest.mark.parametrize("dt", [None, 1e-4, 0.1 + 0.2])
    @pytest.mark.parametrize("n", [0, 1, 7, 24])
    def test_every_double_comes_back(self, tmp_path, n, dt):
        controller = random_controller(n, n, dt)
        read = read_controller(write_controller(tmp_path / "k.json", controller)).controller
        for letter in "ABCD":
            assert getattr(read, letter).tobytes() == getattr(controller, letter).tobytes()
        assert (read.inputs, read.outputs, read.dt) == (
            controller.inputs,
            controller.outputs,
            controller.dt,
        )

    def test_extreme_doubles_come_back(self, tmp_path):
        values = [np.nextafter(1, 2), 5e-324, 1.7976931348623157e308, -0.0]
        controller = static_gain(np.diag(values), INPUTS, OUTPUTS)
        read = read_controller(write_controller(tmp_path / "k.json", controller)).controller
        assert read.D.tobytes() == controller.D.tobytes()

    def test_certificate_and_provenance_come_back(self, tmp_path):
        result = synthesis(random_controller(3))
        file = read_controller(write_controller(tmp_path / "k.json", result, MACHINE, DATE))
        assert (file.method, file.status) == ("pid", "verified")
        assert math.isnan(file.gamma)
        for name in (
            "stable",
            "spectral_abscissa",
            "closed_loop_norm",
            "fastest_pole",
            "plant",
            "margins",
        ):
            assert getattr(file.certificate, name) == getattr(result.certificate, name)
        assert file.provenance.package_version == __version__
        assert (file.provenance.machine, file.provenance.machine_hash) == (
            "small",
            machine_hash(MACHINE),
        )
        assert datetime.fromisoformat(file.provenance.date) == DATE

    def test_an_unstable_verdict_comes_back(self, tmp_path):
        verdict = Certificate(False, 47.7, math.inf, 2857.0, {}, "small")
        result = synthesis(
            random_controller(2), status="unstable", certificate=verdict, gamma=math.inf
        )
        file = read_controller(write_controller(tmp_path / "k.json", result))
        assert not file.certificate.stable
        assert file.certificate.closed_loop_norm == math.inf == file.gamma

    def test_a_controller_alone_is_uncertified(self, tmp_path):
        file = read_controller(write_controller(tmp_path / "k.json", random_controller(2)))
        assert (file.status, file.certificate.stable, file.provenance.machine) == (
            "uncertified",
            False,
            None,
        )

    def test_a_python_control_system_is_welcome(self, tmp_path):
        controller = random_controller(3)
        file = read_controller(write_controller(tmp_path / "k.json", controller.to_control()))
        np.testing.assert_array_equal(file.controller.A, controller.A)


class TestWriting:
    def test_the_file_is_plain_json_with_units(self, tmp_path):
        content = json.loads(
            write_controller(tmp_path / "k.json", synthesis(random_controller(2))).read_text()
        )
        assert content["format"] == "ambrose-controller"
        assert content["version"] == 3
        assert content["inputs"][0] == {"name": "err_A_zeta", "unit": "m"}
        assert content["outputs"][3] == {"name": "u_B_eta", "unit": "A"}

    def test_a_failed_write_leaves_the_old_file_and_nothing_else(self, tmp_path, monkeypatch):
        path = write_controller(tmp_path / "k.json", random_controller(2))
        before = path.read_bytes()

        def full(descriptor):
            raise OSError(28, "No space left on device")

        monkeypatch.setattr("os.fsync", full)
        with pytest.raises(InvalidInput, match="No space left"):
            write_controller(path, random_controller(5))
        assert path.read_bytes() == before
        assert [p.name for p in tmp_path.iterdir()] == ["k.json"]

    def test_overwriting_replaces(self, tmp_path):
        path = write_controller(tmp_path / "k.json", random_controller(2))
        write_controller(path, random_controller(5))
        assert read_controller(path).controller.n_states == 5
        assert stat.S_IMODE(path.stat().st_mode) & stat.S_IRUSR

    @pytest.mark.parametrize("place", ["missing/k.json", "", "."])
    def test_a_path_that_cannot_be_written(self, tmp_path, place):
        with pytest.raises(InvalidInput):
            write_controller(tmp_path / place, random_controller(2))

    def test_signals_of_something_else_are_refused(self, tmp_path):
        with pytest.raises(InvalidInput, match="'u1', but must be err_<axis>"):
            write_controller(tmp_path / "k.json", static_gain(np.eye(4)))
        assert not list(tmp_path.iterdir())


def delete(key):
    return lambda content: content.pop(key)


def put(value, *keys):
    def change(content):
        for key in keys[:-1]:
            content = content[key]
        content[keys[-1]] = value

    return change


BAD_CONTENT = {
    "another format": (put("ambrose-record", "format"), "format is 'ambrose-record'"),
    "no format": (delete("format"), "format is None"),
    "later version": (put(4, "version"), "version is 4, but must be 3; it needs another version"),
    "earlier version": (
        put(2, "version"),
        "version is 2, but must be 3; design it again with `ambrose synthesize`",
    ),
    "version as text": (put("1", "version"), "version is '1'"),
    "version true": (put(True, "version"), "version is True"),
    "unknown key": (put(1, "colour"), "unknown key 'colour'"),
    "missing key": (delete("sample_time"), "lacks the key 'sample_time'"),
    "scheduling": (put({"parameter": "speed"}, "scheduling"), "scheduling"),
    "A not square": (lambda c: c["A"][1].append(0.0), "length of row 2 of A is 4, but must be 3"),
    "A a number": (put(1.0, "A"), "A is 1.0, but must be a list"),
    "B of other height": (lambda c: c["B"].pop(), "rows of B is 2, but must be 3"),
    "C of other width": (lambda c: c["C"][0].pop(), "row 1 of C is 2, but must be 3"),
    "D of other size": (lambda c: c["D"].pop(), "rows of D is 3, but must be 4"),
    "row a number": (put(0.0, "B", 0), r"B\[1\] is 0.0, but must be a list"),
    "text for a number": (put("1.0", "A", 0, 0), r"A\[1\]\[1\] is '1.0', but must be a number"),
    "null for a number": (put(None, "D", 3, 3), r"D\[4\]\[4\] is None"),
    "true for a number": (put(True, "A", 0, 0), r"A\[1\]\[1\] is True"),
    "a huge whole number": (put(10**400, "A", 0, 0), r"must be finite, at most 1\.79769e\+308"),
    "no inputs": (put([], "inputs"), "inputs"),
    "a signal without unit": (put({"name": "err_A_zeta"}, "inputs", 0), "lacks the key 'unit'"),
    "another unit": (put("um", "inputs", 2, "unit"), r"inputs\[3\].unit is 'um', but must be 'm'"),
    "another quantity": (put("y_A_zeta", "inputs", 0, "name"), "must be err_<axis>"),
    "a repeated signal": (put("u_A_zeta", "outputs", 1, "name"), "repeating u_A_zeta"),
    "negative sample time": (put(-1e-4, "sample_time"), "dt is -0.0001"),
    "sample time as text": (put("0.1 ms", "sample_time"), "sample_time is '0.1 ms'"),
    "unknown status": (put("probably", "status"), "status is 'probably'"),
    "gamma as a list": (put([1.0], "gamma"), "gamma"),
    "stopped early, yes": (put(True, "stopped_early"), "stopped_early is True, but must be text"),
    "a history of text": (
        put([{"gamma": "low"}], "history"),
        r"history\[1\].gamma is 'low', but must be a number",
    ),
    "a note as a number": (put([1.0], "notes"), r"notes\[1\] is 1.0, but must be text"),
    "weights of other size": (
        lambda c: c["weights"]["control"]["D"].append([1.0]),
        "rows of weights.control.D is 2",
    ),
    "weights without scale": (
        lambda c: c["weights"].pop("error_scale"),
        "weights lacks the key 'error_scale'",
    ),
    "a weight that is negative": (
        put(-1.0, "weights", "error_scale"),
        "error_scale is -1.0, but must be positive",
    ),
    "settings as text": (
        put("mu", "provenance", "settings"),
        "provenance.settings is 'mu', but must be a table",
    ),
    "lpv without schedule": (put("lpv", "method"), "method is 'lpv', but scheduling is null"),
    "certificate a list": (put([], "certificate"), "certificate is list"),
    "certificate without norm": (
        lambda c: c["certificate"].pop("closed_loop_norm"),
        "lacks the key 'closed_loop_norm'",
    ),
    "stable as a number": (put(1, "certificate", "stable"), "true or false"),
    "margin as text": (
        put("good", "certificate", "margins", "gain_margin"),
        "margins.gain_margin is 'good'",
    ),
    "verified without certificate": (put(None, "certificate"), "there is no certificate"),
    "verified but unstable": (put(False, "certificate", "stable"), "does not say stable"),
    "stable with a pole on the right": (
        put(3.0, "certificate", "spectral_abscissa"),
        "stable with spectral abscissa 3 rad/s",
    ),
    "another package": (put("pickle", "provenance", "package"), "provenance.package"),
    "no date": (put("yesterday", "provenance", "date"), "provenance.date is 'yesterday'"),
}


@pytest.mark.parametrize("name", BAD_CONTENT)
def test_bad_content_is_named(tmp_path, name):
    change, message = BAD_CONTENT[name]
    path = write_controller(tmp_path / "k.json", synthesis(random_controller(3)), MACHINE)
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))
    with pytest.raises(InvalidInput, match=message) as caught:
        read_controller(path)
    assert str(path) in str(caught.value)


BAD_BYTES = {
    "truncated": (lambda text: text[: len(text) // 2], "not complete JSON"),
    "empty": (lambda text: "", "not complete JSON"),
    "NaN": (lambda text: text.replace('"sample_time": null', '"sample_time": NaN'), "NaN"),
    "Infinity": (
        lambda text: text.replace('"sample_time": null', '"sample_time": -Infinity'),
        "-Infinity",
    ),
    "overflowing number": (
        lambda text: text.replace('"sample_time": null', '"sample_time": 1e999'),
        "finite",
    ),
    "a key twice": (
        lambda text: text.replace('"method"', '"version": 1, "method"'),
        "'version' is given twice",
    ),
    "a list": (lambda text: f"[{text}]", "format is list"),
    "deep nesting": (lambda text: "[" * 200_000, "JSON"),
    "endless digits": (
        lambda text: text.replace('"sample_time": null', f'"sample_time": {"9" * 5000}'),
        "JSON|finite",
    ),
}


@pytest.mark.parametrize("name", BAD_BYTES)
def test_bad_text_is_refused(tmp_path, name):
    change, message = BAD_BYTES[name]
    path = write_controller(tmp_path / "k.json", synthesis(random_controller(3)))
    text = path.read_text()
    assert change(text) != text
    path.write_text(change(text))
    with pytest.raises(InvalidInput, match=message):
        read_controller(path)


@pytest.mark.parametrize("scheduled", [False, True])
def test_what_is_read_is_what_was_written(tmp_path, scheduled):
    """History, notes, an early end and the weights were lost: a file told less than the synthesis
    it came from.
    """
    given = scheduled_synthesis() if scheduled else synthesis(random_controller(4))
    result = replace(
        given,
        gamma=0.1 + 0.2,
        history=({"iteration": 0.0, "rho": math.nan}, {"iteration": 1.0, "rho": 1 / 3}),
        notes=("the back-off is wider",),
        stopped_early="after iteration 1, interrupted",
    )
    read = read_controller(write_controller(tmp_path / "k.json", result, MACHINE))
    assert read == result
    assert (read.stopped_early, read.notes) == (result.stopped_early, result.notes)
    # which is all that is said of a PID
    status = "verified" if scheduled else "certified as stable"
    assert read.verdict == f"{status}, but stopped early: after iteration 1, interrupted"
    assert read.weights.control.C.tobytes() == result.weights.control.C.tobytes()
    assert (
        read_controller(write_controller(tmp_path / "again.json", read)).provenance
        == read.provenance
    )
    for other in (
        replace(read, stopped_early=None),
        replace(read, weights=None),
        replace(read, history=read.history[:1]),
    ):
        assert other != result


def test_settings_come_back_and_decide_the_key(tmp_path):
    settings = {"method": "mu", "rate": 1e4 / 3, "speeds": [1.0, 2.0], "order": None}
    result = replace(
        synthesis(random_controller(2)),
        provenance=Provenance(machine_hash="f" * 64, settings=settings),
    )
    read = read_controller(write_controller(tmp_path / "k.json", result))
    assert read.provenance.key == result.provenance.key
    assert read.provenance.key != replace(result.provenance, settings={**settings, "order": 12}).key
    assert read.provenance.key != replace(result.provenance, package_version="0.0.9").key


class TestSchema:
    SCHEMA = Path(__file__).parents[2] / "docs" / "controller.schema.json"

    def test_the_committed_schema_is_current(self):
        assert json.loads(self.SCHEMA.read_text(encoding="utf-8")) == controller_schema()

    def test_it_takes_what_is_written_and_refuses_what_is_not_read(self, tmp_path):
        jsonschema = pytest.importorskip("jsonschema")
        jsonschema.Draft202012Validator.check_schema(controller_schema())
        validator = jsonschema.Draft202012Validator(controller_schema())
        for result in (
            random_controller(0),
            synthesis(random_controller(3)),
            scheduled_synthesis(),
        ):
            content = json.loads(write_controller(tmp_path / "k.json", result, MACHINE).read_text())
            validator.validate(content)
        for name in (
            "unknown key",
            "missing key",
            "another unit",
            "text for a number",
            "unknown status",
            "stable as a number",
        ):
            wrong = json.loads(json.dumps(content))
            BAD_CONTENT[name][0](wrong)
            assert not validator.is_valid(wrong), name


class TestShownAtAPrompt:
    def test_repr_is_one_short_line(self):
        result = replace(
            scheduled_synthesis(), stopped_early="after iteration 1, interrupted", gamma=0.83215
        )
        assert repr(result).startswith(
            "Synthesis(method=lpv, status=verified, but stopped early: after iteration 1, "
            "interrupted, states=3, gamma=0.8321"
        )
        for item in (result, result.certificate, result.weights):
            assert len(repr(item)) < 200 and "\n" not in repr(item)
        assert "<td>lpv</td>" in result._repr_html_() and "uncertified" in repr(
            Synthesis(random_controller(3))
        )

    def test_history_as_a_frame(self):
        rows = ({"iteration": 0.0, "gamma": 2.0}, {"iteration": 1.0, "gamma": 1.5})
        result = replace(synthesis(random_controller(1)), history=rows)
        pandas = pytest.importorskip("pandas")
        pandas.testing.assert_frame_equal(result.to_frame(), pandas.DataFrame(list(rows)))

    def test_without_pandas_the_remedy_is_said(self, monkeypatch):
        monkeypatch.setitem(sys.modules, "pandas", None)
        with pytest.raises(InvalidInput, match="needs pandas"):
            synthesis(random_controller(1)).to_frame()

    def test_an_unknown_status_is_refused(self):
        with pytest.raises(
            InvalidInput, match="status is 'good', but must be verified, unstable, uncertified"
        ):
            Synthesis(random_controller(1), status="good")


def test_every_truncation_is_refused(tmp_path):
    path = write_controller(tmp_path / "k.json", synthesis(random_controller(1)))
    data = path.read_bytes()
    for length in range(0, len(data.rstrip()), 7):
        path.write_bytes(data[:length])
        with pytest.raises(InvalidInput):
            read_controller(path)


def test_a_pickle_is_not_opened(tmp_path):
    path = tmp_path / "k.json"
    path.write_bytes(
        b"\x80\x04\x95\x1e\x00\x00\x00\x00\x00\x00\x00\x8c\x05posix\x94\x8c\x06system\x94\x93\x94."
    )
    with pytest.raises(InvalidInput, match="not UTF-8 text"):
        read_controller(path)


@pytest.mark.parametrize("name", ["absent.json", "."])
def test_a_missing_file_or_a_folder(tmp_path, name):
    with pytest.raises(InvalidInput, match=r"is not a file|is a directory"):
        read_controller(tmp_path / name)


def test_the_hash_follows_the_description():
    assert machine_hash(MACHINE) == machine_hash(replace(MACHINE))
    assert machine_hash(MACHINE) != machine_hash(replace(MACHINE, modal_damping=0.0051))
    whole = replace(
        MACHINE, bearings=(replace(MACHINE.bearings[0], bias_current=6), MACHINE.bearings[1])
    )
    assert machine_hash(whole) == machine_hash(MACHINE)  # 6 and 6.0 are one number


def scheduled_synthesis() -> Synthesis:
    scheduled = ScheduledSystem(
        [100.0, 200.0 + 1e-13, 500.0], [random_controller(3, seed) for seed in range(3)]
    )
    return synthesis(scheduled.at(150.0), method="lpv", scheduled=scheduled)


class TestScheduling:
    def test_schedule_comes_back_bit_by_bit(self, tmp_path):
        result = scheduled_synthesis()
        file = read_controller(write_controller(tmp_path / "k.json", result, MACHINE))
        assert file.law is file.scheduled
        np.testing.assert_array_equal(file.scheduled.grid, result.scheduled.grid)
        for found, given in zip(file.scheduled.systems, result.scheduled.systems, strict=True):
            for letter in "ABCD":
                assert getattr(found, letter).tobytes() == getattr(given, letter).tobytes()
            assert (found.inputs, found.outputs) == (given.inputs, given.outputs)
        assert (file.scheduled.parameter, file.scheduled.unit, file.scheduled.outside) == (
            "speed",
            "rad/s",
            "refuse",
        )
        np.testing.assert_array_equal(file.controller.A, result.controller.A)

    def test_fixed_controllers_have_no_schedule(self, tmp_path):
        content = json.loads(
            write_controller(tmp_path / "k.json", synthesis(random_controller(3))).read_text()
        )
        assert content["scheduling"] is None
        file = read_controller(tmp_path / "k.json")
        assert file.scheduled is None
        assert file.law is file.controller

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            (lambda c: c.update(scheduling=None), r"method is 'lpv', but scheduling is null"),
            (
                lambda c: c["scheduling"].update(grid=[100.0, 50.0, 500.0]),
                r"grid of the speed .* ascending",
            ),
            (lambda c: c["scheduling"].update(grid=[100.0, 500.0]), r"number of systems is 3"),
            (
                lambda c: c["scheduling"].update(grid=[100.0, "fast", 500.0]),
                r"scheduling.grid\[2\]",
            ),
            (
                lambda c: c["scheduling"].update(interpolation="cubic"),
                r"scheduling.interpolation is 'cubic'",
            ),
            (lambda c: c["scheduling"].update(outside="extrapolate"), r"scheduling.outside"),
            (
                lambda c: c["scheduling"].update(parameter="k"),
                r"scheduling.parameter is 'k', but must be 'speed' or 'pressure'",
            ),
            (
                lambda c: c["scheduling"].update(unit="bar"),
                r"scheduling.unit is 'bar', but must be 'rad/s' or 'Pa'",
            ),
            (
                lambda c: c["scheduling"].update(unit="Pa"),
                r"parameter is speed \[Pa\], but must be speed \[rad/s\] or",
            ),
            (lambda c: c["scheduling"].update(colour="red"), r"unknown key 'colour'"),
            (
                lambda c: c["scheduling"]["points"][1].pop("D"),
                r"scheduling.points\[2\] lacks the key 'D'",
            ),
            (
                lambda c: c["scheduling"]["points"][2]["A"].pop(),
                r"rows of scheduling.points\[3\].A",
            ),
        ],
    )
    def test_bad_schedules_are_named(self, tmp_path, change, message):
        path = write_controller(tmp_path / "k.json", scheduled_synthesis())
        content = json.loads(path.read_text())
        change(content)
        path.write_text(json.dumps(content))
        with pytest.raises(InvalidInput, match=message):
            read_controller(path)

    def test_a_schedule_over_pressure_comes_back(self, tmp_path):
        made = scheduled_synthesis()
        over = ScheduledSystem([0.0, 2e5, 4e5], made.scheduled.systems, "pressure", "Pa")
        file = read_controller(write_controller(tmp_path / "k.json", replace(made, scheduled=over)))
        assert (file.scheduled.parameter, file.scheduled.unit, file.scheduled.range) == (
            "pressure",
            "Pa",
            (0.0, 4e5),
        )
        assert file.facts()["scheduled_over"] == "pressure 0 to 4e+05 Pa"

    def rectangle(self) -> Synthesis:
        systems = [random_controller(3, seed) for seed in range(6)]
        over = ScheduledSystem(
            ([100.0, 200.0, 500.0], [0.0, 4e5]), systems, "speed and pressure", "rad/s and Pa"
        )
        return replace(scheduled_synthesis(), scheduled=over)

    def test_a_schedule_over_speed_and_pressure_comes_back(self, tmp_path):
        result = self.rectangle()
        path = write_controller(tmp_path / "k.json", result)
        file = read_controller(path)
        assert file == result
        np.testing.assert_array_equal(
            file.scheduled.at((150.0, 3e5)).A, result.scheduled.at((150.0, 3e5)).A
        )
        assert file.facts()["scheduled_over"] == "speed 100 to 500 rad/s and pressure 0 to 4e+05 Pa"
        # a reader of another language counts as the schema says
        plain = json.loads(path.read_text())["scheduling"]
        assert plain["points"][1]["A"] == result.scheduled.at((100.0, 4e5)).A.tolist()
        assert plain["second"] == {"parameter": "pressure", "unit": "Pa", "grid": [0.0, 4e5]}

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            (
                lambda c: c["scheduling"]["second"].update(parameter="speed"),
                r"parameter is speed and speed .*but must be",
            ),
            (
                lambda c: c["scheduling"]["second"].update(grid=[0.0]),
                r"grid points of the pressure is 1",
            ),
            (lambda c: c["scheduling"]["points"].pop(), r"number of systems is 5, but must be 6"),
            (
                lambda c: c["scheduling"].update(second=3.0),
                r"scheduling.second is float, but must be a table",
            ),
        ],
    )
    def test_bad_rectangles_are_named(self, tmp_path, change, message):
        path = write_controller(tmp_path / "k.json", self.rectangle())
        content = json.loads(path.read_text())
        change(content)
        path.write_text(json.dumps(content))
        with pytest.raises(InvalidInput, match=message):
            read_controller(path)

    def test_controller_at_the_speed_of_the_plant(self, tmp_path):
        scheduled = scheduled_synthesis().scheduled
        plant = assemble(MACHINE, OperatingPoint(speed=300.0))
        np.testing.assert_array_equal(match_controller(scheduled, plant).A, scheduled.at(300.0).A)
        with pytest.raises(InvalidInput, match="between 100 and 500 rad/s"):
            match_controller(scheduled, assemble(MACHINE))
