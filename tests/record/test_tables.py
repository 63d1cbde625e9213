"""Text tables and universal files of other programs through a column map: any separator, either
decimal mark, or a refusal.
"""

from contextlib import nullcontext

import numpy as np
import pytest
from click.testing import CliRunner

from ambrose.cli import main
from ambrose.core.checks import InvalidInput
from ambrose.record import foreign
from ambrose.record.apart import read_variables
from ambrose.record.foreign import read_foreign

POINT = {"speed": 0, "seal_pressure": 0}


@pytest.fixture(autouse=True)
def in_this_process(monkeypatch):
    monkeypatch.setattr(
        foreign, "variables_of", lambda path, names: nullcontext(list(read_variables(path, names)))
    )


def columns(displacement, current, time=None, **more):
    signals = [
        {"name": "y_A_zeta", "source": displacement},
        {"name": "i_A_zeta", "source": current},
    ]
    signals[0] |= {key: value for key, value in more.items() if key == "unit"}
    signals[1] |= {"unit": "A"} if "unit" in more else {}
    rate = {"sample_rate_hz": more["rate"]} if "rate" in more else {}
    return {
        "machine": "m",
        "point": POINT,
        "signal": signals,
        **rate,
        **({"time": {"source": time}} if time else {}),
    }


VENDOR = """Messung 17; Pruefstand
Datum: 12.3.2024
Zeit;Weg A;Strom A;
s;µm;A;
0,0000;1,5;0,25;
0,0001;2,5;-0,25;
0,0002;-1,5;0,5;
0,0003;0;1e-1;
"""
TABLES = {
    "semicolons, commas, a line of units": (VENDOR, columns("Weg A", "Strom A", "Zeit")),
    "by place": (VENDOR, columns("column 2", "column 3", "column 1")),
    "tabs, points, units in brackets": (
        "# t [ms]\tx [mm]\ti [A]\n0\t1.5e-3\t.25\n0.1\t2.5e-3\t-.25\n0.2\t-1.5e-3\t.5\n0.3\t0\t.1\n",
        columns("x", "i", "t"),
    ),
    "commas": (
        '"t (s)","x (um)","i (A)"\r\n0,1.5,.25\r\n1e-4,2.5,-.25\r\n2e-4,-1.5,.5\r\n3e-4,0,.1\r\n',
        columns("x", "i", "t"),
    ),
    "spaces, decimal commas, no header": (
        "1,5  0,25\n2,5  -0,25\n-1,5  0,5\n0  0,1\n",
        columns("column 1", "column 2", unit="um", rate=1e4),
    ),
}


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252"])
@pytest.mark.parametrize("kind", TABLES)
def test_tables_of_vendors_are_read(tmp_path, kind, encoding):
    text, wanted = TABLES[kind]
    path = tmp_path / "log.txt"
    path.write_bytes(text.encode(encoding))
    record = read_foreign(path, wanted)
    assert record.sample_rate_hz == pytest.approx(1e4) and record.units == ("m", "A")
    np.testing.assert_allclose(
        record.values, [[1.5e-6, 2.5e-6, -1.5e-6, 0], [0.25, -0.25, 0.5, 0.1]], rtol=1e-12
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("t;x;i\n0;1;2\n1;2\n", "equally many columns"),
        ("t;x;i\n" + "0;1;2\n" * 50 + "0;1\n" + "0;1;2\n" * 50, "line 52 has 2 cells"),
        (
            "t;x;i\n" + "0;1;2\n" * 50 + "0;1;2;3\n" + "0;1;2\n" * 50,
            "line 52 has 4 cells, but there are 3 columns",
        ),
        ("t;x;i\nnothing here\n", "are no numbers"),
        ("", "the file is empty"),
        ("t;x;x\n0;1;2\n1;2;3\n", "'x' stands there 2 times"),
        ("t;y;i\n0;1;2\n1;2;3\n", "there is no column 'x' in the file; it has t, y, i"),
        ("t [s];x;i [A]\n0;1;2\n1;2;3\n", "no unit"),
        ("t [s];x [um];i [A]\n0;1;2\n1;nan;3\n", "must be finite"),
        ("a\0b", "it is not text"),
        ("t;x;i\n0,0;1,5;2\n1,0;1.5;3\n", "decimal commas .'0,0;1,5;2' in line 2. and points"),
        ("t;x;i\n0;990;2\n1;1.000;3\n", '"1.000" in line 3 may be 1000, beside "990" in line 2'),
        ("t\tx\ti\n0\t990\t2\n1\t1,000\t3\n", '"1,000" in line 3 may be 1000'),
        ("t;spare;x;i\n0;1;2\n1;2;3\n", "line 2 has 3 cells, but the header names 4 columns"),
        ("t  spare  x  i\n0  1  2\n1  2  3\n", "line 2 has 3 cells, but the header names 4"),
        ("t,x\n0,000,0,25\n0,001,1,25\n", "line 2 has 4 cells, but the header names 2"),
        ("t\n0,25\n1,25\n", "may have 2 numbers, or 1 with a decimal comma .'0,25'"),
        ("0,000,0,25\n0,001,1,25\n", "may have decimal commas between separating ones"),
        ("t;x;i\n" + "0;1;2\n" * 30 + "0;;2\n" + "0;1;2\n" * 30, "'x' is empty in line 32"),
        ("t,x,i\n" + "0,1,2\n" * 30 + "0,1,?\n" + "0,1,2\n" * 30, "line 32, column 3: '.' is no"),
    ],
)
def test_tables_that_are_none_are_refused(tmp_path, text, words):
    path = tmp_path / "log.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InvalidInput, match=words) as error:
        read_foreign(path, columns("x", "i", "t"))
    assert "\n" not in str(error.value) and "; " in str(error.value)


GAPS = {
    "an empty column": ("t\tspare\tx\ti\n", "{t}\t\t{x}\t{i}\n", ("column 3", "column 4")),
    "LabVIEW, no X column": (
        "LabVIEW Measurement\nSeparator\tTab\n***End_of_Header***\nX_Value\tx\ti\tComment\n",
        "\t{x}\t{i}\n",
        ("column 2", "column 3"),
    ),
    "separators at the end": ("t;x;i\n", "{t};{x};{i};\n", ("column 2", "column 3")),
    "a title": ("run 17 of 3 February\n", "{t};{x};{i}\n", ("column 2", "column 3")),
    "names of two words": ("time s  gap x  coil i\n", "{t}  {x}  {i}\n", ("gap x", "coil i")),
    "units between spaces": ("t [s] x [um] i [A]\n", "{t} {x} {i}\n", ("x", "i")),
}


@pytest.mark.parametrize("mark", ".,")
@pytest.mark.parametrize("kind", GAPS)
def test_cells_keep_their_places(tmp_path, kind, mark):
    head, row, names = GAPS[kind]
    path = tmp_path / "log.txt"
    rows = [row.format(t=n / 8, x=10 + n / 8, i=200 + n / 8) for n in range(60)]
    path.write_text(head + "".join(rows).replace(".", mark), encoding="utf-8")
    record = read_foreign(path, columns(*names, unit="um", rate=8))
    np.testing.assert_allclose(record.values[:, 1], [10.125e-6, 200.125], rtol=1e-12)


def test_text_in_utf_16_is_sent_to_utf_8(tmp_path):
    (tmp_path / "log.txt").write_text(VENDOR, encoding="utf-16")
    with pytest.raises(InvalidInput, match=r"UTF-16 .* save it as CSV in UTF-8"):
        read_foreign(tmp_path / "log.txt", columns("Weg A", "Strom A", "Zeit"))


# Written by pyuff 2.5.8: time signals in double and in single precision, the second of another node
# and direction.
UNIVERSAL = """    -1
    58
y_A_zeta
NONE
NONE
NONE
NONE
    1         0    0         0                    1   1                    1   1
         4         5         1  0.00000e+00  1.00000e-04  0.00000e+00
        17    0    0    0 NONE                 NONE
         8    0    0    0 NONE                 um
         0    0    0    0 NONE                 NONE
         0    0    0    0 NONE                 NONE
   1.50000000000e+00  -2.25000000000e+00   3.00000000000e-03   0.00000000000e+00
   7.00000000000e+00
    -1
    -1
    58
current
NONE
NONE
NONE
NONE
    1         0    0         0                    2  -3                    1   1
         2         5         1  0.00000e+00  1.00000e-04  0.00000e+00
        17    0    0    0 NONE                 NONE
         8    0    0    0 NONE                 A
         0    0    0    0 NONE                 NONE
         0    0    0    0 NONE                 NONE
  3.00000e+00 -4.50000e+00  6.00000e-03  0.00000e+00 -1.40000e+01
    -1
"""
NUMBERS = [[1.5e-6, -2.25e-6, 3e-9, 0, 7e-6], [3, -4.5, 6e-3, 0, -14]]


def binary(text):
    """The same with the numbers as bytes, as dataset 58b."""
    first, second = text.encode().split(b"    -1\n    -1\n")
    parts = []
    for part, numbers, kind in (
        (first, [1.5, -2.25, 3e-3, 0, 7], "<f8"),
        (second, NUMBERS[1], "<f4"),
    ):
        lines = part.split(b"\n")
        start = 2 if lines[0].strip() == b"-1" else 1
        raw = np.array(numbers, kind).tobytes()
        head = b"    58b     1     2          11%12d     0     0           0           0" % len(raw)
        parts.append(
            b"\n".join([b"    -1", head, *lines[start : start + 11]]) + b"\n" + raw + b"    -1\n"
        )
    return b"".join(parts)


@pytest.mark.parametrize(
    "made", [lambda text: text.encode(), lambda text: text.replace("\n", "\r\n").encode(), binary]
)
@pytest.mark.parametrize("names", [("y_A_zeta", "current"), ("1:+X", "2:-Z"), ("set 1", "set 2")])
def test_universal_files_are_read(tmp_path, made, names):
    path = tmp_path / "run.uff"
    path.write_bytes(made(UNIVERSAL))
    record = read_foreign(path, columns(*names))
    assert record.sample_rate_hz == pytest.approx(1e4) and record.units == ("m", "A")
    np.testing.assert_allclose(record.values, NUMBERS, rtol=1e-6)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            "    1         0    0         0                    1",
            "    4         0    0         0                    1",
            "time response",
        ),
        ("         4         5", "         6         5", "complex numbers"),
        ("         4         5         1", "         4         5         0", "not evenly spaced"),
        ("         4         5", "         4         6", "states 6 numbers and holds 5"),
        ("         4         5", "         4        -5", "states -5 numbers"),
        ("         4         5", "         4         x", "cannot be read"),
        ("7.00000000000e+00\n    -1", "7.00000000000e+00", "no dataset 'current'"),
        ("   1.5000", "   1.x000", "cannot be read"),
        ("y_A_zeta", "current", "2 datasets are called 'current'"),
        ("    58\n", "    55\n", "no dataset 58"),
        ("        17    0    0    0 NONE", "        18    0    0    0 NONE", "is of type 18"),
        (
            "        17    0    0    0 NONE                 NONE",
            "        17    0    0    0 Angle                deg ",
            "is .deg., but must be",
        ),
    ],
)
def test_universal_files_that_are_none_are_refused(tmp_path, old, new, words):
    path = tmp_path / "run.unv"
    assert old in UNIVERSAL
    path.write_text(UNIVERSAL.replace(old, new), encoding="utf-8")
    with pytest.raises(InvalidInput, match=words) as error:
        read_foreign(
            path,
            columns("current", "current") if "called" in words else columns("y_A_zeta", "current"),
        )
    assert "\n" not in str(error.value) and "; " in str(error.value)


@pytest.mark.parametrize(("unit", "rate"), [("ms", 1e4), ("us", 1e7), ("sec", 1e4), ("S", 1e4)])
def test_the_time_of_a_universal_file_has_the_unit_of_its_heading(tmp_path, unit, rate):
    path = tmp_path / "run.unv"
    old = "        17    0    0    0 NONE                 NONE"
    new = f"        17    0    0    0 Time                 {unit:<4}"
    path.write_text(
        UNIVERSAL.replace(old, new).replace("1.00000e-04", "1.00000e-01")
    )  # of its unit
    if unit in ("sec", "S"):
        path.write_text(UNIVERSAL.replace(old, new))
    found = read_foreign(path, columns("y_A_zeta", "current")).sample_rate_hz
    assert found == pytest.approx(rate)


@pytest.mark.parametrize(("floats", "words"), [(1, "VAX"), (3, "IBM"), (4, "unknown")])
def test_floats_of_other_computers_are_named(tmp_path, floats, words):
    path = tmp_path / "run.unv"
    path.write_bytes(binary(UNIVERSAL).replace(b"58b     1     2", b"58b     1%6d" % floats))
    with pytest.raises(InvalidInput, match=f"{words} floats"):
        read_foreign(path, columns("y_A_zeta", "current"))


def test_universal_files_in_utf_8_and_filled_to_a_whole_line(tmp_path):
    path = tmp_path / "run.unv"
    filled = "7.00000000000e+00   0.00000000000e+00\n"
    text = UNIVERSAL.replace("y_A_zeta", "Fühler ä").replace("7.00000000000e+00\n", filled)
    path.write_text(text, encoding="utf-8")
    record = read_foreign(path, columns("Fühler ä", "current"))
    np.testing.assert_allclose(record.values, NUMBERS, rtol=1e-6)
    path.write_text(UNIVERSAL.replace("7.00000000000e+00\n", filled.replace("0.0", "0.5")))
    with pytest.raises(InvalidInput, match="states 5 numbers and holds 6"):
        read_foreign(path, columns("y_A_zeta", "current"))


@pytest.mark.parametrize(("later", "start"), [("3.00000e-04", 3e-4), ("-2.0000e-04", 0.0)])
def test_channels_that_begin_apart_come_onto_one_time(tmp_path, later, start):
    head, _, tail = UNIVERSAL.rpartition("0.00000e+00  1.00000e-04")
    path = tmp_path / "run.unv"
    path.write_text(f"{head}{later:>11}  1.00000e-04{tail}")
    record = read_foreign(path, columns("y_A_zeta", "current"))
    cut = round(float(later) * 1e4)
    first, second = NUMBERS
    expected = [first[cut:], second[: 5 - cut]] if cut > 0 else [first[:3], second[2:]]
    np.testing.assert_allclose(record.values, expected, rtol=1e-6)
    assert record.start_time == pytest.approx(start) and "begins" in dict(record.notes)["shifted"]


@pytest.mark.parametrize("later", ["nan", "inf"])
def test_a_start_that_is_no_number_is_refused(tmp_path, later):
    """It ended convert in a traceback."""
    head, _, tail = UNIVERSAL.rpartition("0.00000e+00  1.00000e-04")
    path = tmp_path / "run.unv"
    path.write_text(f"{head}{later:>11}  1.00000e-04{tail}")
    with pytest.raises(InvalidInput, match=r"run\.unv: .*(start of the channel current|'nan')"):
        read_foreign(path, columns("y_A_zeta", "current"))


@pytest.mark.parametrize("later", ["1.50000e-04", "2.00000e+00"])
def test_channels_that_share_no_samples_are_refused_with_both_starts(tmp_path, later):
    head, _, tail = UNIVERSAL.rpartition("0.00000e+00  1.00000e-04")
    path = tmp_path / "run.unv"
    path.write_text(f"{head}{later}  1.00000e-04{tail}")
    with pytest.raises(InvalidInput, match=r"0 s \(y_A_zeta\) and .* s \(current\)"):
        read_foreign(path, columns("y_A_zeta", "current"))


def test_a_cut_file_is_refused_wherever_it_is_cut(tmp_path):
    path = tmp_path / "run.uff"
    for whole in (UNIVERSAL.encode(), binary(UNIVERSAL)):
        for length in range(20, len(whole) - 8, 37):
            path.write_bytes(whole[:length])
            with pytest.raises(InvalidInput):
                read_foreign(path, columns("y_A_zeta", "current"))


def test_a_file_of_unknown_kind_leads_to_the_page(tmp_path):
    (tmp_path / "run.xyz").write_text("1 2", encoding="utf-8")
    (tmp_path / "run.csv").write_text(VENDOR, encoding="utf-8")
    for name in ("run.xyz", "run.csv"):
        result = CliRunner().invoke(
            main, ["convert", str(tmp_path / name), "-o", str(tmp_path / "a.h5")]
        )
        assert result.exit_code == 2 and "docs/reference/records.md" in result.output, result.output
