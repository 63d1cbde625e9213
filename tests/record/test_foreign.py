"""Files of MATLAB and LabVIEW through a column map: numbers as saved, in SI; nothing doubtful is
let in, nothing is changed.
"""

import errno
import os
import sys
from contextlib import nullcontext

import h5py
import numpy as np
import pytest
import scipy.io

from ambrose.core.checks import InvalidInput
from ambrose.machine.description import OperatingPoint
from ambrose.record import foreign
from ambrose.record.apart import read_variables
from ambrose.record.files import read_record, write_record
from ambrose.record.foreign import Column, ColumnMap, load_columns, read_columns, read_foreign
from ambrose.record.record import Record


@pytest.fixture(autouse=True)
def in_this_process(monkeypatch):
    """The readers' own process takes most of a second."""
    monkeypatch.setattr(
        foreign, "variables_of", lambda path, names: nullcontext(list(read_variables(path, names)))
    )


COUNT, RATE = 200, 5000.0
TIME = 2.0 + np.arange(COUNT) / RATE
PROBE = 8.0 + 0.3 * np.sin(2 * np.pi * 50 * TIME)  # [V], 7.87 V/mm
CURRENT = 2.0 * np.cos(2 * np.pi * 50 * TIME)  # [A]
MAP = """
machine = "seal-rig"

[point]
speed = "3000 rpm"
seal_pressure = "2.04 bar"
label = "nominal"

[time]
source = "TIME"
unit = "ms"

[[signal]]
name = "y_A_zeta"
source = "PROBE"
unit = "mm"
scale = -0.125
offset = 1.0

[[signal]]
name = "i_A_zeta"
source = "CURRENT"
unit = "mA"

[notes]
operator = "J. Doe"
"""
SOURCES = {  # kind of file -> time, probe, current
    "v5": ("t", "probe", "log.i"),
    "v7.3": ("t", "probe", "log.i"),
    "matrix": ("Y(:,1)", "Y(:,2)", "Y(:, 3)"),
    "matrix, v7.3": ("Y(:,1)", "Y(:,2)", "Y(:, 3)"),
    "rows": ("Y(1,:)", "Y(2,:)", "Y(3,:)"),
    "hdf5": ("t ms", "log/Probe (1)", "log/all(:, 3)"),
    "tdms": ("Rig/t", "Rig/cDAQ1Mod1/ai0", "Rig/i"),
}


def write_matlab73(path, variables):
    """A v7.3 file as MATLAB writes it: a 512-byte header, then HDF5 with every matrix
    transposed.
    """
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in variables.items():
            if isinstance(value, dict):
                group = file.create_group(name)
                group.attrs["MATLAB_class"] = np.bytes_("struct")
                for key, row in value.items():
                    group.create_dataset(key, data=np.atleast_2d(row)).attrs["MATLAB_class"] = (
                        np.bytes_("double")
                    )
            else:
                data = file.create_dataset(
                    name, data=np.atleast_2d(value).T if np.ndim(value) == 2 else value[None, :]
                )
                data.attrs["MATLAB_class"] = np.bytes_("double")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


def write_tdms(path, channels, properties=None):
    nptdms = pytest.importorskip("nptdms")
    with nptdms.TdmsWriter(path) as writer:
        for part in (slice(0, 120), slice(120, None)):
            objects = [
                nptdms.ChannelObject(
                    "Rig", name, values[part], properties=(properties or {}).get(name)
                )
                for name, values in channels.items()
            ]
            writer.write_segment(objects)


def make(kind, folder, time=TIME * 1e3, probe=PROBE, current=CURRENT * 1e3):
    path = folder / {"tdms": "run.tdms", "hdf5": "run.h5"}.get(kind, "run.mat")
    table = (
        np.column_stack([time, probe, current])
        if "matrix" in kind
        else np.vstack([time, probe, current])
    )
    if kind == "v5":
        scipy.io.savemat(
            path,
            {
                "t": time,
                "probe": probe[:, None],
                "log": {"i": current, "note": "text"},
                "text": "hello",
            },
        )
    elif kind == "v7.3":
        write_matlab73(path, {"t": time, "probe": probe[:, None], "log": {"i": current}})
    elif kind == "matrix, v7.3":
        write_matlab73(path, {"Y": table})
    elif kind == "hdf5":
        with h5py.File(path, "w") as file:
            parts = {
                "t ms": time,
                "log/Probe (1)": probe,
                "log/all": np.column_stack([time, probe, current]),
            }
            for name, value in parts.items():
                file[name] = value
    elif kind == "tdms":
        write_tdms(path, {"t": time, "cDAQ1Mod1/ai0": probe, "i": current})
    else:
        scipy.io.savemat(path, {"Y": table}, do_compression=True)
    return path


def map_for(kind, folder, change=lambda text: text):
    text = MAP
    for word, source in zip(("TIME", "PROBE", "CURRENT"), SOURCES[kind], strict=True):
        text = text.replace(f'"{word}"', f'"{source}"')
    path = folder / "map.toml"
    path.write_text(change(text))
    return path


@pytest.mark.parametrize("kind", SOURCES)
def test_every_kind_of_file_gives_the_same_record(tmp_path, kind):
    record = read_foreign(make(kind, tmp_path), map_for(kind, tmp_path))
    assert (record.machine, record.signals, record.units) == (
        "seal-rig",
        ("y_A_zeta", "i_A_zeta"),
        ("m", "A"),
    )
    assert record.point == OperatingPoint(3000 * np.pi / 30, 2.04e5, label="nominal")
    assert record.sample_rate_hz == pytest.approx(
        RATE, rel=1e-9
    ) and record.start_time == pytest.approx(2.0, rel=1e-12)
    assert record["y_A_zeta"] == pytest.approx((1.0 - 0.125 * PROBE) * 1e-3, rel=1e-12, abs=1e-18)
    assert record["i_A_zeta"] == pytest.approx(CURRENT, rel=1e-12, abs=1e-15)
    assert record.notes == (("operator", "J. Doe"),)


def test_a_map_made_in_code_or_from_a_dict(tmp_path):
    path = make("v5", tmp_path)
    point = OperatingPoint(speed=10.0, seal_pressure=0.0)
    columns = ColumnMap("rig", (Column("u_A_zeta", "log.i", "mA"),), point, sample_rate_hz=RATE)
    document = {
        "machine": "rig",
        "sample_rate_hz": RATE,
        "point": {"speed": 10.0, "seal_pressure": 0},
        "signal": [{"name": "u_A_zeta", "source": "log.i", "unit": "mA"}],
    }
    assert read_columns(document) == columns
    for given in (columns, document):
        record = read_foreign(path, given)
        assert record.start_time == 0.0 and record.sample_rate_hz == RATE and record.point == point
        assert record["u_A_zeta"] == pytest.approx(CURRENT, rel=1e-12, abs=1e-15)


def test_tdms_knows_units_rates_and_time_stamps(tmp_path):
    stamps = np.datetime64("2026-01-02T03:04:05.000000", "us") + (np.arange(COUNT) * 200).astype(
        "timedelta64[us]"
    )
    properties = {
        name: {"wf_increment": 1 / RATE, "unit_string": unit}
        for name, unit in (("i", "mA"), ("y", "um"))
    }
    path = tmp_path / "run.tdms"
    write_tdms(
        path, {"i": CURRENT * 1e3, "y": PROBE.astype(np.float32), "stamp": stamps}, properties
    )
    columns = (Column("i_A_zeta", "Rig/i"), Column("y_A_zeta", "Rig/y", scale=-1.0))
    for time in (None, Column("time", "Rig/stamp")):
        record = read_foreign(path, ColumnMap("rig", columns, OperatingPoint(), time))
        assert record.sample_rate_hz == pytest.approx(RATE, rel=1e-6) and record.start_time == 0.0
        assert record["i_A_zeta"] == pytest.approx(CURRENT, rel=1e-12, abs=1e-15)
        assert np.array_equal(record["y_A_zeta"], -PROBE.astype(np.float32).astype(float) * 1e-6)


def test_tdms_channels_of_different_rates_are_refused(tmp_path):
    path = tmp_path / "run.tdms"
    write_tdms(
        path,
        {"a": CURRENT, "b": CURRENT},
        {"a": {"wf_increment": 1e-4}, "b": {"wf_increment": 2e-4}},
    )
    columns = (Column("i_A_zeta", "Rig/a", "A"), Column("i_A_eta", "Rig/b", "A"))
    with pytest.raises(
        InvalidInput,
        match=r"run\.tdms: the sample rate of the channel Rig/b is 5000 Hz.*Rig/a, 10000 Hz",
    ):
        read_foreign(path, ColumnMap("rig", columns, OperatingPoint()))


# what a channel says of its beginning, later by so many samples of 0.2 ms, or not at all
STARTS = {
    "offset": lambda late: {"wf_start_offset": late / RATE},
    "time": lambda late: {"wf_start_time": STARTED + np.timedelta64(round(200 * late), "us")},
    "both": lambda late: STARTS["time"](late - 10) | STARTS["offset"](10),
    "LabVIEW's zero": lambda late: {
        "wf_start_time": np.datetime64("1904-01-01T00:00:00", "us"),
        **STARTS["offset"](late),
    },
}
STARTED = np.datetime64("2026-01-02T03:04:05.000000", "us")


def tdms_of_starts(path, kind, first, second, **more):
    said = {
        name: {"wf_increment": 1 / RATE, "unit_string": "A", **STARTS[kind](late)}
        for name, late in (("a", first), ("b", second))
    }
    said["b"] |= more
    write_tdms(path, {"a": CURRENT, "b": CURRENT}, said)
    columns = (Column("i_A_zeta", "Rig/a"), Column("i_A_eta", "Rig/b"))
    return ColumnMap("rig", columns, OperatingPoint())


@pytest.mark.parametrize("kind", STARTS)
@pytest.mark.parametrize(("first", "second"), [(0, 25), (25, 0), (3, 3), (0, 0.005)])
def test_tdms_channels_that_begin_apart_come_onto_one_time(tmp_path, kind, first, second):
    """The second began 5 ms later and was laid beside the first, start 0, without a word."""
    path = tmp_path / "run.tdms"
    record = read_foreign(path, tdms_of_starts(path, kind, first, second))
    late = round(second - first)
    cut = COUNT - abs(late)
    shown = [CURRENT[max(late, 0) :][:cut], CURRENT[max(-late, 0) :][:cut]]
    np.testing.assert_allclose(record.values, shown, rtol=1e-12)
    assert ("begins 25 samples before" in dict(record.notes).get("shifted", "")) == bool(late)
    if kind == "offset":
        assert record.start_time == pytest.approx(max(first, second) / RATE)


@pytest.mark.parametrize("kind", STARTS)
@pytest.mark.parametrize("late", [2.5, 0.05, COUNT, 10**6])
def test_tdms_channels_that_share_no_samples_are_refused(tmp_path, kind, late):
    path = tmp_path / "run.tdms"
    columns = tdms_of_starts(path, kind, 0, late)
    with pytest.raises(InvalidInput, match=r"s \(Rig/a\) and .* s \(Rig/b\), but must be the same"):
        read_foreign(path, columns)


@pytest.mark.parametrize("said", [float("nan"), "soon", float("inf")])
def test_a_start_of_tdms_that_is_no_number_is_refused(tmp_path, said):
    path = tmp_path / "run.tdms"
    columns = tdms_of_starts(path, "offset", 0, 0, wf_start_offset=said)
    with pytest.raises(InvalidInput, match=r"run\.tdms: .*Rig/b"):
        read_foreign(path, columns)


@pytest.mark.parametrize("kind", SOURCES)
def test_a_scale_that_overflows_is_named_with_its_sample(tmp_path, kind):
    """It ended convert in a traceback."""
    path = make(kind, tmp_path)
    columns = map_for(kind, tmp_path, lambda text: text.replace("-0.125", "1e308"))
    with (
        np.errstate(all="raise"),
        pytest.raises(InvalidInput, match=r"y_A_zeta at sample 0 .* inf"),
    ):
        read_foreign(path, columns)


def without(word):
    return lambda text: "\n".join(line for line in text.splitlines() if not line.startswith(word))


def at(values, place, value):
    changed = np.array(values)
    changed[place] = value
    return changed


DATA = {
    "NaN": (
        {"current": at(CURRENT, 30, np.nan)},
        r"{i} at sample 30 \(t = 2.006 s\) is nan.*measure again",
    ),
    "infinity": ({"probe": at(PROBE, 0, np.inf)}, r"{probe} at sample 0 .* is inf"),
    "gap": (
        {"time": np.append(TIME[:-9], TIME[-9:] + 4 / RATE) * 1e3},
        r"time column {t}: .*4 samples are missing there",
    ),
    "NaN in time": ({"time": at(TIME, 3, np.nan)}, r"{t} at sample 3 is nan"),
    "backwards": ({"time": -TIME}, r"time column {t}: a time step .*positive and uniform"),
    "jitter": (
        {"time": at(TIME * 1e3, 50, TIME[50] * 1e3 + 0.04)},
        r"resample the signals uniformly",
    ),
}
MAPS = {
    "unit missing": (without('unit = "mm"'), "the signal y_A_zeta has no unit.*add unit"),
    "unit wrong": (
        lambda text: text.replace('"mA"', '"mm"'),
        "the unit of i_A_zeta is 'mm'.*current",
    ),
    "unit unknown": (lambda text: text.replace('"mm"', '"furlongs per"'), "the unit of y_A_zeta"),
    "unknown variable": (
        lambda text: text.replace(
            'name = "y_A_zeta"\nsource = "', 'name = "y_A_zeta"\nsource = "x'
        ),
        r"there is no (variable|channel) '?x.* in the file; it has",
    ),
    "rate against time": (
        lambda text: "sample_rate_hz = 4000\n" + text,
        r"5000 Hz, .* that of the column map, 4000 Hz",
    ),
    "no rate": (
        lambda text: text.replace("[time]", "[[signal]]\nname = 'y_t'"),
        r"rate is not known; add sample_rate_hz",
    ),
}


@pytest.mark.parametrize("kind", SOURCES)
@pytest.mark.parametrize("case", DATA)
def test_doubtful_data_are_refused(tmp_path, kind, case):
    changes, message = DATA[case]
    path = make(kind, tmp_path, **changes)
    words = {"t": SOURCES[kind][0], "probe": SOURCES[kind][1], "i": SOURCES[kind][2]}
    for word, source in words.items():
        escaped = source.replace("(", r"\(").replace(")", r"\)").replace(".", r"\.")
        message = message.replace("{" + word + "}", escaped)
    refused(path, map_for(kind, tmp_path), message)


@pytest.mark.parametrize("kind", ["v5", "v7.3", "tdms"])
@pytest.mark.parametrize("case", MAPS)
def test_a_map_that_does_not_fit_is_refused(tmp_path, kind, case):
    change, message = MAPS[case]
    path = make(kind, tmp_path)
    if case == "no rate":
        path = make(kind, tmp_path, time=TIME * 1e3)
        message = rf"{message}|the unit of y_t"
    refused(path, map_for(kind, tmp_path, change), message)


@pytest.mark.parametrize("kind", SOURCES)
@pytest.mark.parametrize("kept", [0.98, 0.55, 0.3, 0.1, 0.01, 0.0])
def test_a_truncated_file_is_refused(tmp_path, kind, kept):
    path = make(kind, tmp_path)
    data = path.read_bytes()
    path.write_bytes(data[: int(kept * len(data))])
    refused(path, map_for(kind, tmp_path), r"truncated|incomplete|there is no (variable|channel)")


def refused(path, columns, message):
    before = path.read_bytes()
    with pytest.raises(InvalidInput, match=rf"run\.(mat|tdms|h5): .*({message})"):
        read_foreign(path, columns)
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("Y", r"Y is 200 x 3, but one signal is needed; name a column, such as Y\(:,1\)"),
        ("Y(:,4)", r"Y\(:,4\) does not exist, the variable has 3 columns; count from 1"),
        ("Y(0,:)", "count from 1"),
        ("Z", "there is no variable 'Z' in the file; it has Y, text, z, cube, log"),
        ("text", "text has no numbers|text is not an array"),
        ("z", "z has complex numbers"),
        ("cube", "cube has a block of numbers"),
        ("log", "log has no numbers|log is not an array"),
        ("log.b", "there is no variable 'log.b' in the file; it has log.a"),
        ("Y.b", "there is no variable 'Y.b'"),
    ],
)
def test_matlab_variables_that_are_no_signal(tmp_path, source, message):
    path = tmp_path / "run.mat"
    table = np.column_stack([TIME, PROBE, CURRENT])
    odd = {"text": "abc", "z": PROBE + 1j, "cube": np.zeros((2, 3, 4)), "log": {"a": PROBE}}
    scipy.io.savemat(path, {"Y": table, **odd})
    columns = ColumnMap(
        "rig", (Column("y_A_zeta", source, "m"),), OperatingPoint(), sample_rate_hz=RATE
    )
    refused(path, columns, message)


def test_signals_of_different_length_are_refused(tmp_path):
    path = tmp_path / "run.mat"
    scipy.io.savemat(path, {"a": PROBE, "b": PROBE[:-1]})
    columns = (Column("y_A_zeta", "a", "m"), Column("y_A_eta", "b", "m"))
    refused(
        path,
        ColumnMap("rig", columns, OperatingPoint(), sample_rate_hz=RATE),
        r"numbers of samples is .*'b': 199",
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.replace("machine =", "maschine ="), 'unknown key "maschine"; did you mean'),
        (without("machine"), "machine is missing"),
        (without("speed"), r"\[point\]: speed is missing"),
        (lambda t: t.replace("3000 rpm", "3000 kg"), r"\[point\]: speed is \"3000 kg\""),
        (
            lambda t: t.replace('source = "probe"', ""),
            r"\[\[signal\]\] y_A_zeta: source is missing",
        ),
        (
            lambda t: t.replace("scale = -0.125", "scale = 0"),
            "scale and offset of y_A_zeta is 0 and 1",
        ),
        (
            lambda t: t.replace("scale = -0.125", "scale = nan"),
            r"\[\[signal\]\] y_A_zeta: scale is nan, but must be finite",
        ),
        (
            lambda t: t.replace("scale = -0.125", "scale = '2 V'"),
            'scale is "2 V", but must be a plain number',
        ),
        (lambda t: t.replace("scale =", "gain ="), 'unknown key "gain"'),
        (lambda t: t.replace('unit = "mm"', "unit = 3"), "unit is 3, but must be a string"),
        (lambda t: t.replace("i_A_zeta", "y_A_zeta"), "y_A_zeta is named 2 times"),
        (lambda t: "sample_rate_hz = -1\n" + t, "sample_rate_hz is -1"),
        (lambda t: t.replace("[[signal]]", "[signal]", 1), "map.toml: "),
        (lambda t: t + "]", "map.toml: "),
        (
            lambda t: t[: t.index("[[signal]]")],
            r"\[\[signal\]\] is missing; add it with name, source",
        ),
        (lambda t: t.replace('"J. Doe"', "3"), r"\[notes\]: operator is 3"),
    ],
)
def test_a_wrong_map_is_refused(tmp_path, change, message):
    with pytest.raises(InvalidInput, match=message):
        load_columns(map_for("v5", tmp_path, change))


def test_wrong_files_are_refused(tmp_path):
    columns = map_for("v5", tmp_path)
    with pytest.raises(InvalidInput, match=r"none\.mat is not a file"):
        read_foreign(tmp_path / "none.mat", columns)
    (tmp_path / "run.xlsx").write_bytes(b"PK")
    with pytest.raises(
        InvalidInput,
        match=r"run\.xlsx: it is not of a kind known here \(\.mat, \.tdms, \.h5, \.hdf5, \.csv",
    ):
        read_foreign(tmp_path / "run.xlsx", columns)
    with pytest.raises(InvalidInput, match=r"none\.toml is not a file"):
        read_foreign(make("v5", tmp_path), tmp_path / "none.toml")


def test_without_the_package_for_tdms_the_remedy_is_named(tmp_path, monkeypatch):
    path = make("tdms", tmp_path)
    monkeypatch.setitem(sys.modules, "nptdms", None)
    refused(
        path, map_for("tdms", tmp_path), r"npTDMS; install it with: pip install 'ambrose\[tdms\]'"
    )


def of_hdf5(path, **attributes):
    with h5py.File(path, "w") as file:
        data = file.create_dataset("y", data=np.arange(-1, 40, dtype="i2"))
        data.attrs.update(attributes)
    return read_foreign(
        path,
        {
            "machine": "m",
            "sample_rate_hz": 1e3,
            "point": {"speed": 0, "seal_pressure": 0},
            "signal": [{"name": "y_A_zeta", "source": "y"}],
        },
    )


def test_packed_numbers_of_hdf5_are_unpacked(tmp_path):
    """The conventions of CF and netCDF: 0, 100, 200 um had been 5, 6, 7."""
    path = tmp_path / "log.h5"
    raw = np.arange(-1, 40)
    found = of_hdf5(path, units="um", scale_factor=0.01, add_offset=5.0)
    np.testing.assert_allclose(found.values[0], (5 + 0.01 * raw) * 1e-6, rtol=1e-12)
    found = of_hdf5(path, units=b"mm", scale_factor=np.array([2.0]))
    np.testing.assert_allclose(found.values[0], 2e-3 * raw, rtol=1e-12)
    for more, words in (
        ({"scale_factor": 1e308}, "y at sample 3 .* is inf, but must be finite"),
        ({"_FillValue": np.int16(-1)}, "y at sample 0"),
        ({"missing_value": 7}, "y at sample 8"),
        ({"scale_factor": np.arange(3.0)}, "must be finite|must be single numbers"),
        ({"scale_factor": "ten"}, "must be single numbers"),
        ({"MATLAB_empty": 1}, "y is empty"),
        ({"MATLAB_class": b"string"}, "not an array of real numbers"),
        ({"MATLAB_object_decode": 3}, "not an array of real numbers"),
    ):
        with pytest.raises(InvalidInput, match=words):
            of_hdf5(path, units="um", **more)


@pytest.mark.parametrize("kind", ["record", "foreign", "mat"])
def test_a_lock_is_called_a_lock(tmp_path, kind, monkeypatch):
    """Another program writes; or the file system has none, and the file is read all the same."""
    path = tmp_path / ("log.mat" if kind == "mat" else "log.h5")
    of_hdf5(tmp_path / "log.h5", units="um")
    if kind == "mat":
        (tmp_path / "log.h5").rename(path)
    if kind == "record":
        point = OperatingPoint()
        write_record(Record("m", 1e3, ("y_A_zeta",), ("m",), np.ones((1, 41)), point), path)
    read = read_record if kind == "record" else lambda path: list(read_variables(path, ["y"]))
    real = h5py.File

    def refused(number):
        def opened(name, mode, locking=None, **more):
            if locking is False:
                return real(name, mode, locking=False, **more)
            raise OSError(number, "unable to lock file, " + os.strerror(number))

        return opened

    monkeypatch.setattr(h5py, "File", refused(errno.EAGAIN))
    with pytest.raises(InvalidInput, match="another program has it open for writing"):
        read(path)
    monkeypatch.setattr(h5py, "File", refused(errno.ENOLCK))
    found = read(path)
    assert (found.values.shape[1] if kind == "record" else len(found[0].values)) == 41
