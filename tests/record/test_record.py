"""Records: what is written comes back, in SI, and nothing doubtful is let in."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import h5py
import jsonschema
import numpy as np
import pytest

from ambrose.core.checks import InvalidInput
from ambrose.machine.description import OperatingPoint
from ambrose.record import apart
from ambrose.record.files import names_of_files, read_record, write_record
from ambrose.record.hdf5_file import RecordAttributes, read_attributes, record_schema
from ambrose.record.record import RESERVED, Record, si_values, signal_dimension

ROOT = Path(__file__).parents[2]
POINT = OperatingPoint(
    speed=3298.6722862692827, seal_pressure=2.04e5, bias_current=6.0, label="nominal, 2.04 bar"
)


@pytest.fixture
def record():
    values = np.random.default_rng(3).standard_normal((3, 40)) * [[1e-5], [0.1], [100.0]]
    notes = (("operator", "J. Doe: zweite Schicht, 20 °C"), ("empty", ""))
    return Record(
        "seal-rig",
        9999.7,
        ("y_A_zeta", "e_B_eta", "f_center_x"),
        ("m", "A", "N"),
        values,
        POINT,
        0.25,
        notes,
    )


@pytest.fixture
def csv(record, tmp_path):
    """The lines of a good CSV file, and a function that writes them changed and reads the
    result.
    """
    path = write_record(record, tmp_path / "good.csv")

    def read(change):
        lines = path.read_text().splitlines(keepends=True)
        text = change(lines)
        bad = tmp_path / "changed.csv"
        bad.write_text("".join(lines) if text is None else text)
        before = bad.read_bytes()
        try:
            return read_record(bad)
        finally:
            assert bad.read_bytes() == before

    return read


def first_row(lines):
    return next(i for i, line in enumerate(lines) if line.startswith("time")) + 1


def set_line(start, new):
    def change(lines):
        i = next(i for i, line in enumerate(lines) if line.startswith(start))
        lines[i] = new

    return change


@pytest.fixture(autouse=True)
def read_here(monkeypatch):
    """No trial in a process apart, which reads the same way in half a second;
    tests/machine/test_limits.py looks at it.
    """
    monkeypatch.setattr(apart, "try_record", lambda path: None)


@pytest.mark.parametrize("suffix", [".h5", ".hdf5", ".csv"])
def test_round_trip_is_bit_exact(record, tmp_path, suffix):
    path = write_record(record, tmp_path / f"record{suffix}")
    again = read_record(path)
    assert np.array_equal(again.values, record.values)
    for name in ("machine", "sample_rate_hz", "signals", "units", "point", "start_time", "notes"):
        assert getattr(again, name) == getattr(record, name), name
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_what_is_read_already_is_as_it_is(record, tmp_path):
    path = write_record(record, tmp_path / "run.h5")
    assert read_record(record) is record
    assert names_of_files([path, record, "other.csv"]) == ("run.h5", "other.csv")


def test_hdf5_layout_is_the_published_one(record, tmp_path):
    with h5py.File(write_record(record, tmp_path / "r.h5")) as file:
        assert (file.attrs["format"], file.attrs["version"], file.attrs["machine"]) == (
            b"ambrose-record",
            1,
            b"seal-rig",
        )
        assert file.attrs["sample_rate_hz"] == 9999.7
        assert file.attrs["speed_rad_s"] == POINT.speed and file.attrs["seal_pressure_pa"] == 2.04e5
        assert (
            file["signals/y_A_zeta"].dtype == np.float64
            and file["signals/y_A_zeta"].attrs["unit"] == b"m"
        )


def test_csv_header_is_the_published_one(record, tmp_path):
    lines = write_record(record, tmp_path / "r.csv").read_text().splitlines()
    assert "time [s],y_A_zeta [m],e_B_eta [A],f_center_x [N]" in lines
    assert "# speed_rad_s: 3298.6722862692827" in lines


def test_access_by_name_and_time(record):
    assert np.array_equal(record["e_B_eta"], record.values[1])
    assert record.select(["f_center_x", "y_A_zeta"]).units == ("N", "m")
    assert record.time[0] == 0.25 and record.time[1] - record.time[0] == pytest.approx(
        1 / 9999.7, rel=1e-9
    )
    part = record.between(record.time[10], record.time[20])
    assert part.start_time == record.time[10] and np.array_equal(
        part.values, record.values[:, 10:20]
    )
    with pytest.raises(ValueError, match="read-only"):
        record.values[0, 0] = 1.0
    with pytest.raises(InvalidInput, match=r"y_A_eta.*it has y_A_zeta, e_B_eta"):
        record["y_A_eta"]
    with pytest.raises(InvalidInput, match=r"within 0\.25"):
        record.between(0.0, 0.1)


def test_units_are_converted_on_reading(csv, record):
    def change(lines):
        row = first_row(lines)
        lines[row - 1] = "time [ms],y_A_zeta [um],e_B_eta [mA],f_center_x [kN]\n"
        for i in range(row, len(lines)):
            t, y, e, f = map(float, lines[i].split(","))
            lines[i] = f"{t * 1e3:.17g},{y * 1e6:.17g},{e * 1e3:.17g},{f / 1e3:.17g}\n"

    again = csv(change)
    assert again.units == ("m", "A", "N")
    assert again.values == pytest.approx(record.values, rel=1e-14)
    assert again.start_time == pytest.approx(0.25, rel=1e-14)


def test_units_are_converted_on_reading_hdf5(record, tmp_path):
    path = write_record(record, tmp_path / "r.h5")
    with h5py.File(path, "a") as file:
        # a thousandth of an inch, known to pint only
        file["signals/y_A_zeta"].attrs["unit"] = "thou"
    assert read_record(path)["y_A_zeta"] == pytest.approx(record["y_A_zeta"] * 25.4e-6, rel=1e-12)


def test_unit_of_a_signal():
    assert [signal_dimension(f"{prefix}_A_zeta").unit for prefix in ("y", "u", "f", "qdot")] == [
        "m",
        "A",
        "N",
        "m/s",
    ]
    assert si_values("p_inlet", "bar", np.array([2.0]))[0] == [2e5]
    assert si_values("speed_rotor", "rpm", np.array([30.0]))[0] == pytest.approx([np.pi])
    assert si_values("valve", "%", np.array([40.0]))[0] == pytest.approx([0.4])
    with pytest.raises(InvalidInput, match="prefix"):
        signal_dimension("valve")


def test_rate_without_statement_comes_from_the_times(csv):
    again = csv(set_line("# sample_rate_hz", ""))
    assert again.sample_rate_hz == pytest.approx(9999.7, rel=1e-10)


def test_csv_from_a_spreadsheet_is_read(csv, record, tmp_path):
    path = write_record(record, tmp_path / "s.csv")
    text = "".join(
        line for line in path.read_text().splitlines(keepends=True) if "samples" not in line
    )
    path.write_bytes(b"\xef\xbb\xbf" + text.rstrip("\n").replace("\n", "\r\n").encode())
    assert np.array_equal(read_record(path).values, record.values)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"values": np.zeros((2, 40))}, "one row per signal"),
        ({"values": np.zeros((3, 0))}, "k > 0"),
        (
            {"values": np.vstack([np.zeros((2, 4)), [[0, 0, np.nan, 0]]])},
            r"f_center_x at sample 2 \(t = 0.2502 s\) is nan",
        ),
        (
            {"values": np.vstack([np.full((1, 4), np.inf), np.zeros((2, 4))])},
            "y_A_zeta at sample 0",
        ),
        ({"sample_rate_hz": 0.0}, "sample_rate_hz"),
        ({"sample_rate_hz": float("nan")}, "sample_rate_hz"),
        ({"start_time": float("inf")}, "start_time"),
        ({"signals": ("y_A_zeta", "y_A_zeta", "f_center_x"), "units": ("m", "m", "N")}, "unique"),
        ({"signals": ("y A", "e_B_eta", "f_center_x")}, "letters, digits"),
        (
            {"signals": ("time", "e_B_eta", "f_center_x"), "units": ("s", "A", "N")},
            "other than time",
        ),
        ({"units": ("m", "A")}, "one per signal"),
        ({"units": ("m", "A", "kN")}, "the SI unit 'N'"),
        ({"units": ("N", "A", "N")}, "a unit of length such as m"),
        ({"units": ("", "A", "N")}, "y_A_zeta has no unit"),
        ({"signals": (), "units": (), "values": np.zeros((0, 4))}, "at least 1"),
        ({"machine": "two\nlines"}, "one line"),
        ({"notes": (("speed_rad_s", "3"),)}, "leaves free"),
        ({"notes": (("who", "a\nb"),)}, "one line"),
    ],
)
def test_record_refuses(record, changes, message):
    with pytest.raises(InvalidInput, match=message):
        replace(record, **changes)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (set_line("# format", "# format: other\n"), "format is 'other'"),
        (set_line("# format", ""), "names its format and version 1"),
        (set_line("# version", "# version: 2\n"), "version is '2'.*update ambrose"),
        (set_line("# machine", ""), "attribute machine is missing"),
        (set_line("# speed_rad_s", ""), "speed_rad_s is missing"),
        (set_line("# speed_rad_s", "# speed_rad_s: fast\n"), "speed is 'fast'"),
        (set_line("# sample_rate_hz", "# sample_rate_hz: 5000\n"), "time column, 9999.7 Hz"),
        (
            set_line("time", "time [s],y_A_zeta,e_B_eta [A],f_center_x [N]\n"),
            "y_A_zeta.*add the unit",
        ),
        (
            set_line("time", "time [s],y_A_zeta [],e_B_eta [A],f_center_x [N]\n"),
            "y_A_zeta has no unit",
        ),
        (
            set_line("time", "time [s],y_A_zeta [furlongs],e_B_eta [N],f_center_x [N]\n"),
            "the unit of e_B_eta is 'N'",
        ),
        (
            set_line("time", "time [m],y_A_zeta [m],e_B_eta [A],f_center_x [N]\n"),
            "the unit of time is 'm'",
        ),
        (set_line("time", "y_A_zeta [m],e_B_eta [A],f_center_x [N]\n"), "first column"),
        (
            set_line("time", "time [s],y_A_zeta [m],e_B_eta [A]\n"),
            "data row 1 has 4 cells, but there are 3 columns",
        ),
        (
            set_line("time", "time [s];y_A_zeta [m];e_B_eta [A];f_center_x [N]\n"),
            "separated by a semicolon",
        ),
        (set_line("time", "time [s],y_A_zeta [m],y_A_zeta [m],f_center_x [N]\n"), "unique"),
        (set_line("0.25,", "0.25,nan,0,0\n"), "y_A_zeta at sample 0.*is nan"),
        (set_line("0.25,", "0.25,,0,0\n"), "number in every cell"),
        (set_line("0.25,", "nan,0,0,0\n"), "a time is not finite"),
        (lambda lines: lines.pop(first_row(lines) + 7) and None, "rows is 39.*truncated"),
        (lambda lines: lines.pop() and None, "rows is 39.*truncated"),
        (lambda lines: "".join(lines)[:-4], "truncated"),
        (lambda lines: "".join(lines[: first_row(lines)]), "no data|number in every cell"),
        (lambda lines: "", "format is None"),
    ],
)
def test_csv_refuses(csv, change, message):
    with pytest.raises(InvalidInput, match=rf"changed\.csv: .*({message})"):
        csv(change)


def test_csv_names_missing_samples(csv):
    def drop(lines):
        del lines[first_row(lines) + 7 : first_row(lines) + 9]
        set_line("# samples", "")(lines)

    with pytest.raises(InvalidInput, match=r"after t = 0\.25060.* 2 samples are missing"):
        csv(drop)


@pytest.mark.parametrize("shift", [0.3, -1.5])
def test_csv_refuses_mistimed_samples(csv, shift):
    def move(lines):
        row = first_row(lines) + 5
        t, rest = lines[row].split(",", 1)
        lines[row] = f"{float(t) + shift / 9999.7},{rest}"

    with pytest.raises(InvalidInput, match=r"a time step is .*positive and uniform"):
        csv(move)


@pytest.mark.parametrize("kept", [0.99, 0.5, 0.01, 0.0])
def test_truncated_hdf5_is_refused(record, tmp_path, kept):
    path = write_record(record, tmp_path / "r.h5")
    data = path.read_bytes()
    path.write_bytes(data[: int(kept * len(data))])
    before = path.read_bytes()
    with pytest.raises(InvalidInput, match=r"r\.h5: it cannot be read as HDF5"):
        read_record(path)
    assert path.read_bytes() == before


def test_damaged_numbers_do_not_pass(record, tmp_path):
    path = write_record(record, tmp_path / "r.h5")
    data = path.read_bytes()
    for place in (data.index(record["e_B_eta"].tobytes()) + 7, data.index(b"seal-rig")):
        damaged = bytearray(data)
        damaged[place] ^= 0x01
        path.write_bytes(damaged)
        with pytest.raises(InvalidInput, match=r"r\.h5: it cannot be read as HDF5"):
            read_record(path)


def set_attribute(name, value):
    return lambda file: file.attrs.__setitem__(name, value)


def replace_signal(**arguments):
    def change(file):
        del file["signals/y_A_zeta"]
        file["signals"].create_dataset("y_A_zeta", **arguments).attrs["unit"] = "m"

    return change


def link_outside(file):
    del file["signals/y_A_zeta"]
    file["signals/y_A_zeta"] = h5py.ExternalLink("other.h5", "/secret")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (set_attribute("format", "ambrose-controller"), "format is 'ambrose-controller'"),
        (set_attribute("version", 7), "version is .*7"),
        (set_attribute("sample_rate_hz", np.nan), "sample_rate_hz"),
        (set_attribute("sample_rate_hz", [1.0, 2.0]), "an array"),
        (set_attribute("machine", "x\ny"), "one line"),
        (lambda file: file.attrs.pop("sample_rate_hz"), "sample_rate_hz is missing"),
        (lambda file: file.attrs.pop("seal_pressure_pa"), "seal_pressure_pa is missing"),
        (lambda file: file["signals/e_B_eta"].attrs.pop("unit"), "e_B_eta has no unit"),
        (
            lambda file: file["signals/e_B_eta"].attrs.__setitem__("unit", "N"),
            "the unit of e_B_eta",
        ),
        (lambda file: file.pop("signals"), "/signals is missing"),
        (replace_signal(data=np.zeros(39)), "the same for all signals"),
        (replace_signal(data=np.full(40, np.nan)), "y_A_zeta at sample 0"),
        (replace_signal(data=np.zeros((40, 1))), "one axis"),
        (replace_signal(data=["a"] * 40), "real numbers"),
        (replace_signal(shape=(10**12,), chunks=(1000,), dtype="f8"), "split the record"),
        (link_outside, "/signals/y_A_zeta is a link, or kept in another file"),
    ],
)
def test_hdf5_refuses(record, tmp_path, change, message):
    path = write_record(record, tmp_path / "r.h5")
    with h5py.File(path, "a") as file:
        change(file)
    with pytest.raises(InvalidInput, match=rf"r\.h5: .*{message}"):
        read_record(path)


def test_wrong_names_are_refused(record, tmp_path):
    for action in (lambda p: write_record(record, p), read_record):
        with pytest.raises(InvalidInput, match=r"suffix.*\.csv"):
            action(tmp_path / "r.xls")
    with pytest.raises(InvalidInput, match="not a file"):
        read_record(tmp_path / "none.h5")
    with pytest.raises(InvalidInput, match="not a directory"):
        write_record(record, tmp_path / "none" / "r.h5")
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InvalidInput, match=r"binary\.csv"):
        read_record(tmp_path / "binary.csv")


@pytest.mark.parametrize("suffix", [".h5", ".csv"])
def test_a_failed_write_leaves_the_old_file(record, tmp_path, monkeypatch, suffix):
    path = write_record(record, tmp_path / f"r{suffix}")
    before = path.read_bytes()

    def fail(*_arguments):
        raise OSError("disk full")

    monkeypatch.setattr("os.replace", fail)
    with pytest.raises(
        InvalidInput, match=r"record .*disk full; give a file in an existing, writable folder"
    ):
        write_record(replace(record, machine="other"), path)
    assert path.read_bytes() == before and [p.name for p in tmp_path.iterdir()] == [path.name]


class TestSchema:
    def test_committed_schema_is_current(self):
        committed = json.loads((ROOT / "docs" / "record.schema.json").read_text(encoding="utf-8"))
        assert committed == record_schema(), (
            "write it anew: python -m ambrose.record.hdf5_file docs/record.schema.json"
        )

    def test_it_knows_the_keys_that_the_format_reserves(self):
        schema = record_schema()
        jsonschema.Draft202012Validator.check_schema(schema)
        assert set(RecordAttributes.model_fields) == set(schema["properties"]) == RESERVED
        assert all(entry["description"] for entry in schema["properties"].values())

    def test_it_accepts_what_is_written(self, record):
        jsonschema.validate(record.attributes, record_schema())

    @pytest.mark.parametrize(
        "change",
        [
            {"format": "other"},
            {"version": 2},
            {"speed_rad_s": "fast"},
            {"machine": None},
            {"who": 3},
        ],
    )
    def test_it_refuses_what_is_no_record(self, record, change):
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate({**record.attributes, **change}, record_schema())
        if "who" not in change and "machine" not in change:
            with pytest.raises(InvalidInput):
                read_attributes({**record.attributes, **change})


def test_a_record_shows_itself_in_a_line(record):
    long = replace(
        record,
        signals=tuple(f"y_{i}" for i in range(60)),
        units=("m",) * 60,
        values=np.zeros((60, 4)),
    )
    assert len(repr(long)) < 200 and "machine=seal-rig" in repr(record)
    page = record._repr_html_()
    assert all(
        f"<td>{name}</td><td>{unit}</td>" in page
        for name, unit in zip(record.signals, record.units, strict=True)
    )
    plain = json.loads(json.dumps(record.to_dict()))
    assert plain["signals"]["y_A_zeta"] == {"unit": "m", "values": record["y_A_zeta"].tolist()}
    assert plain["speed_rad_s"] == record.point.speed


def test_a_frame_has_a_column_for_each_signal_over_time(record):
    pandas = pytest.importorskip("pandas")
    frame = record.to_frame()
    assert isinstance(frame, pandas.DataFrame) and frame.index.name == "time [s]"
    assert list(frame.columns) == ["y_A_zeta [m]", "e_B_eta [A]", "f_center_x [N]"]
    assert np.array_equal(frame["e_B_eta [A]"], record["e_B_eta"]) and np.array_equal(
        frame.index, record.time
    )


def test_a_frame_needs_pandas(record, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(
        InvalidInput, match="needs pandas, which is not installed; pip install pandas"
    ):
        record.to_frame()


@pytest.mark.parametrize(
    ("key", "words"),
    [
        ("sample_rate_hz", "0.0001 to 1e.07 Hz"),
        ("speed_rad_s", "speed of an operating point"),
        ("seal_pressure_pa", "seal_pressure of an operating point"),
        ("bias_current_a", "bias_current of an operating point"),
        ("whirl_frequency_rad_s", "whirl_frequency of an operating point"),
        ("start_time_s", "start_time"),
    ],
)
@pytest.mark.parametrize("value", [1e300, -1e300, 1e13])
def test_a_file_with_a_number_beyond_all_machines_is_refused(tmp_path, key, words, value):
    """A rate or a speed of 1e300 ended in a traceback in eight commands, each at another place."""
    import h5py

    path = tmp_path / "record.h5"
    signals, units = ("y_A_zeta",), ("m",)
    write_record(
        Record("m", 1e4, signals, units, np.zeros((1, 10)), OperatingPoint(100.0, 1e5, 2.0, 100.0)),
        path,
    )
    with h5py.File(path, "r+") as file:
        file.attrs[key] = value
    with pytest.raises(
        InvalidInput,
        match=words if value > 0 else "sample_rate_hz|of an operating point|start_time",
    ):
        read_record(path)


@pytest.mark.parametrize("ending", ["csv", "h5"])
@pytest.mark.parametrize("value", [1e308, -1e20])
def test_a_sample_that_no_signal_can_be_is_refused(tmp_path, ending, value):
    """1e308 A overflowed in the products of the first estimate, whatever the command was."""
    import h5py

    values = np.zeros((1, 10))
    values[0, 3] = 0.5
    path = write_record(Record("m", 1e4, ("e_A_zeta",), ("A",), values), tmp_path / f"r.{ending}")
    if ending == "csv":
        path.write_text(path.read_text().replace("0.5", repr(value)))
    else:
        with h5py.File(path, "r+") as file:
            where = []
            file.visititems(
                lambda name, item: where.append(name) if hasattr(item, "shape") else None
            )
            for name in where:
                data = file[name][...]
                file[name][...] = np.where(data == 0.5, value, data)
    with pytest.raises(
        InvalidInput, match=r"e_A_zeta at sample 3 .* at most 1e\+15 in its SI unit"
    ):
        read_record(path)
