"""Tables of stations as spreadsheets have them: layouts and units, CSV and workbooks, there and
back, and every refusal in one sentence.
"""

import json
import math
import re
import sys
import zipfile

import numpy as np
import pytest
from click.testing import CliRunner

from ambrose.cli import main
from ambrose.core.checks import InvalidInput
from ambrose.machine.attachment import stations
from ambrose.machine.description import MachineDescription
from ambrose.machine.file.stations import (
    read_rotor,
    rotor_of_stations,
    station_table,
    write_stations,
)
from ambrose.machine.file.toml import bundled_machines, load_machine
from ambrose.machine.part import MATERIALS, RotorModel
from ambrose.machine.units import DIMENSIONS, read_quantity
from ambrose.model.effects.rotor import (
    finite_element_rotor,
    free_bending_frequencies,
    mass_properties,
)

openpyxl = pytest.importorskip("openpyxl")

POUND, INCH, GRAVITY = 0.45359237, 0.0254, 9.80665  # kg, m, m/s2: exact by definition


def call(*arguments):
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def hertz(model, theory="timoshenko", count=6):
    bare = MachineDescription(
        model.name, model.shaft, (), (), discs=model.discs, beam_theory=theory
    )
    return free_bending_frequencies(finite_element_rotor(bare), count) / (2 * np.pi)


def rotor_alone(machine):
    places = tuple(bearing.position for bearing in machine.bearings)
    return RotorModel(machine.name, machine.shaft, machine.discs, places)


def workbook(path, *sheets, change=None):
    """A workbook of these sheets, each a list of rows; change(sheet) edits the first."""
    book = openpyxl.Workbook()
    book.remove(book.active)
    for rows in sheets:
        sheet = book.create_sheet()
        for row in rows:
            sheet.append(row)
    if change:
        change(book.worksheets[0])
    book.save(path)
    return path


# as drawings offices have it: a title, names in several words, a row of units, a taper, a bore, an
# empty column, and the right end as the last station
INCHES = [
    ["Rotor 12-345", None, None, None, None, None, None, None, None, None, None, None],
    [
        *("Station No.", "Length", None, "Outer Diameter\nLeft", "Outer Diameter\nRight"),
        *("Inner Diameter Left", "Inner Diameter Right", "Added Mass", "Ip", "It", "E", "Density"),
    ],
    [
        *(None, "in", None, "in", "in", "in", "in"),
        *("lbf s^2/in", "lbm-in^2", "lbf-s^2-in", "psi", "lbm/in^3"),
    ],
    [1, 4, None, 2, 2, 0, 0, None, None, None, 30e6, 0.283],
    [2, 3.5, None, 2, 3, 0.5, 0.75, 0.05, 120, 0.2, 30e6, 0.283],
    [3, 6, None, 3, 3, 0.75, 0.75, None, None, None, 30e6, 0.283],
    [4, None, None, None, None, None, None, 0.01, 1.5, 0.002, None, None],
]


def test_a_workbook_in_inches_pounds_and_seconds(tmp_path):
    model = read_rotor(workbook(tmp_path / "rotor.xlsx", INCHES))
    snail = POUND * GRAVITY / INCH  # lbf s2/in
    plain, cone, hollow = model.shaft
    assert [item.length for item in model.shaft] == [0.1016, 0.0889, 0.1524]
    assert (cone.outer_diameter, cone.end_outer_diameter) == (0.0508, 0.0762)
    assert (cone.inner_diameter, cone.end_inner_diameter) == (0.0127, 0.01905)
    assert not plain.conical and not hollow.conical and hollow.inner_diameter == 0.01905
    assert plain.material.density == pytest.approx(0.283 * POUND / INCH**3, rel=1e-12)
    assert plain.material.youngs_modulus == pytest.approx(
        30e6 * POUND * GRAVITY / INCH**2, rel=1e-12
    )
    assert [disc.mass for disc in model.discs] == pytest.approx([0.05 * snail, 0.01 * snail])
    assert model.discs[0].polar_inertia == pytest.approx(120 * POUND * INCH**2, rel=1e-12)
    assert model.discs[0].diametral_inertia == pytest.approx(0.2 * snail * INCH**2, rel=1e-12)
    assert [disc.position for disc in model.discs] == pytest.approx([0.1016, 0.3429])
    assert model.left_out == ("line 1: Rotor 12-345",) and not model.assumed


@pytest.mark.parametrize(
    ("unit", "kind", "value"),
    [
        ("lbm", "mass", POUND),
        ("lbf s^2/in", "mass", POUND * GRAVITY / INCH),
        ("lb-s²/in", "mass", POUND * GRAVITY / INCH),
        ("lbm in2", "moment of inertia", POUND * INCH**2),
        ("lbm-in^2", "moment of inertia", POUND * INCH**2),
        ("lbf in s^2", "moment of inertia", POUND * GRAVITY * INCH),
        ("lb-in-s^2", "moment of inertia", POUND * GRAVITY * INCH),
        ("kg-m2", "moment of inertia", 1.0),
        ("lbm/in^3", "density", POUND / INCH**3),
        ("lb s^2/in^4", "density", POUND * GRAVITY / INCH**4),
        ("Mpsi", "elastic modulus", 1e6 * POUND * GRAVITY / INCH**2),
        ("in.", "length", INCH),
    ],
)
def test_units_of_station_tables(unit, kind, value):
    assert read_quantity(f"1 {unit}", DIMENSIONS[kind]) == pytest.approx(value, rel=1e-12)


@pytest.mark.literature
def test_a_uniform_beam_from_a_table_in_inches_bends_as_the_closed_form():
    """Free-free Euler-Bernoulli beam: w = (beta L)^2 sqrt(E I/(rho A L^4)), cosh cos = 1; n cubic
    elements raise it by (beta L/n)^4/1440, to the next order.
    """
    rows = "\n".join(f"{i},1,1,1,30000000,0.283" for i in range(1, 41))
    text = f"station,length,od left,od right,E,density\n,in,in,in,psi,lbm/in^3\n{rows}\n"
    model = rotor_of_stations(text, "beam.csv")
    young, density = 30e6 * POUND * GRAVITY / INCH**2, 0.283 * POUND / INCH**3
    roots = np.array([4.730040744862704, 7.853204624095838, 10.995607838001671])
    gyration = 1 * INCH / 4
    exact = roots**2 * gyration * math.sqrt(young / density) / (40 * INCH) ** 2 / (2 * np.pi)
    exact *= 1 + (roots / 40) ** 4 / 1440
    np.testing.assert_allclose(hertz(model, "bernoulli-euler", 3), exact, rtol=5e-8)


@pytest.mark.parametrize("name", bundled_machines())
def test_the_rotor_of_a_table_bends_as_that_it_was_written_from(tmp_path, name):
    machine = load_machine(name)
    for path in (tmp_path / "rotor.csv", tmp_path / "rotor.xlsx"):
        write_stations(path, rotor_alone(machine), stations(machine))
    one, other = read_rotor(tmp_path / "rotor.csv"), read_rotor(tmp_path / "rotor.xlsx")
    assert (one.shaft, one.discs, one.bearings) == (other.shaft, other.discs, other.bearings)
    rotor = finite_element_rotor(machine)
    ours = free_bending_frequencies(rotor, 6) / (2 * np.pi)
    np.testing.assert_allclose(hertz(one, machine.beam_theory), ours, rtol=1e-9)
    assert one.bearings == pytest.approx([bearing.position for bearing in machine.bearings])
    bare = MachineDescription("there", one.shaft, (), (), discs=one.discs)
    assert mass_properties(finite_element_rotor(bare)).mass == pytest.approx(
        mass_properties(rotor).mass, rel=1e-12
    )
    # once more: the same digits
    table = station_table(one, ())
    write_stations(tmp_path / "again.csv", one)
    assert station_table(read_rotor(tmp_path / "again.csv"), ()) == table


WRITTEN = """station,length [mm],od [mm],od right [mm],id [mm],id right [mm],mass diameter [mm],elements,material,E [GPa],rho [kg/m^3],nu,disc,disc mass [kg],disc Ip [kg m^2],disc It [kg m^2],bearing,label
1,75.3,40.1,,0,,,2,,210,7850,0.3,,,,,,journal
2,61.7,40.1,52.9,0,7.7,,3,Ti-6Al-4V,114,4430,0.34,wheel,8.1234567,0.07,0.031,x,"=cone, A"
3,225,52.9,,7.7,,60.1,4,shop steel,205.5,7830,0.29,,,,,,
4,0,,,,,,,,,,,nut,0.3,0.0001,0,,
"""


@pytest.mark.parametrize("suffix", [".csv", ".xlsx"])
def test_every_digit_of_a_table_comes_back(tmp_path, suffix):
    model = rotor_of_stations(WRITTEN, "table")
    path = tmp_path / f"rotor{suffix}"
    write_stations(path, model)
    if suffix == ".csv":
        assert path.read_text(encoding="utf-8") == WRITTEN
    back = read_rotor(path)
    assert (back.shaft, back.discs, back.bearings) == (model.shaft, model.discs, model.bearings)
    # the numbers of the digits, as a machine file reads them
    assert [item.length for item in back.shaft] == [0.0753, 0.0617, 0.225]
    assert back.shaft[2].material.youngs_modulus == 205.5e9
    assert back.shaft[1].material == MATERIALS["Ti-6Al-4V"] and back.shaft[1].label == "=cone, A"
    assert [disc.name for disc in back.discs] == ["wheel", "nut"]


def test_a_material_by_its_name_and_one_that_is_assumed():
    names = "length [mm];od [mm];material\n"
    model = rotor_of_stations(f"{names}100;40;Ti-6Al-4V\n100;40;\n", "table")
    assert [item.material.density for item in model.shaft] == [4430.0, 7850.0]
    assert model.assumed == {"shaft.material": "steel, where the table names none"}
    assert not rotor_of_stations(f"{names}100;40;steel\n", "table").assumed
    half = rotor_of_stations("length [mm],od [mm],E [GPa]\n100,40,200\n", "table")
    assert half.assumed == model.assumed  # the density was taken without a word


def test_inertia_without_mass_and_empty_rows_are_no_silent_loss():
    names = "length [mm];od [mm];Ip [kg m2]\n"
    model = rotor_of_stations(f"{names}100;40;0,5\n;;\n200;50;\n;;\n", "table")
    assert [item.length for item in model.shaft] == [0.1, 0.2]
    assert [disc.polar_inertia for disc in model.discs] == [0.5]


def test_a_zero_in_the_bearing_column_of_a_workbook_is_none(tmp_path):
    rows = [["length [mm]", "od [mm]", "bearing"], [100, 40, 0], [100, 50, 1], [100, 40, 0.0]]
    assert read_rotor(workbook(tmp_path / "rotor.xlsx", rows)).bearings == (0.1,)


def test_discs_at_one_place_are_one():
    machine = load_machine("overhung-blower")
    wheel = machine.discs[0]
    model = RotorModel("x", machine.shaft, (wheel, wheel), machine.bearings and (0.2,))
    names, *rows = station_table(model, ())
    (row,) = (row for row in rows if row[names.index("disc mass [kg]")])
    assert float(row[names.index("disc mass [kg]")]) == pytest.approx(2 * wheel.mass)


def test_a_machine_goes_to_a_spreadsheet_and_back(tmp_path):
    book, table = tmp_path / "rotor.xlsx", tmp_path / "rotor.csv"
    result = call("convert", "turboexpander", "-o", book, "--json")
    assert result.exit_code == 0, result.output
    left = json.loads(result.output)["left_out"]
    assert "piston" in left and any("bernoulli-euler" in item for item in left)
    copied = call("convert", book, "-o", table)
    assert copied.exit_code == 0 and "25 stations; left out: nothing" in copied.output
    again = call("convert", "turboexpander", "-o", book)
    assert again.exit_code == 2 and "exists already" in again.output
    made = call("convert", book, "-o", tmp_path / "rotor.toml", "--speed", "20000 rpm")
    assert made.exit_code in (0, 1), made.output
    machine, source = load_machine(tmp_path / "rotor.toml"), load_machine("turboexpander")
    assert [disc.mass for disc in machine.discs] == [disc.mass for disc in source.discs]
    assert [b.position for b in machine.bearings] == pytest.approx(
        [b.position for b in source.bearings]
    )


def test_without_its_package_a_workbook_is_refused(tmp_path, monkeypatch):
    path = workbook(tmp_path / "rotor.xlsx", INCHES)
    monkeypatch.setitem(sys.modules, "openpyxl", None)
    for arguments in (
        ("convert", path, "-o", tmp_path / "rotor.toml"),
        ("convert", "seal-rig", "-o", tmp_path / "other.xlsx"),
    ):
        result = call(*arguments)
        assert result.exit_code == 2
        assert "pip install 'ambrose[xlsx]', or save the sheet as CSV" in " ".join(
            result.output.split()
        )


PLAIN = [["station", "length [mm]", "od [mm]", "id [mm]"], [1, 100, 40, 0], [2, 200, 50, 0]]


def edited(row, column, value):
    rows = [[*cells] for cells in PLAIN]
    rows[row][column] = value
    return rows


def commented(sheet):
    sheet["B2"].comment = openpyxl.comments.Comment("check with the shop", "me")


@pytest.mark.parametrize(
    ("sheets", "change", "words"),
    [
        ([PLAIN], lambda sheet: sheet.merge_cells("C2:C3"), "C2:C3 is one merged cell; split"),
        ([edited(1, 1, "=50+50")], None, "B2 is a formula without a value; open the workbook"),
        ([PLAIN], commented, "B2 has the comment 'check with the shop', which .*; move it"),
        ([edited(2, 0, 1)], None, "line 3: station 1 behind 1 is there twice; give"),
        ([edited(2, 0, 0)], None, "line 3: station 0 behind 1 is out of order; give"),
        ([edited(2, 0, 4)], None, "line 3: station 4 behind 1 leaves a gap; give"),
        ([edited(2, 0, None)], None, "line 3: the station has no whole number; number every"),
        ([edited(0, 2, "od")], None, 'od has no unit; name it in the first row, such as "od \\[mm'),
        ([edited(1, 3, 60)], None, "line 2: id is 60 mm, but must be .* below od, 40 mm; correct"),
        ([edited(1, 1, 0)], None, "line 2: length is 0 mm .* must be positive; correct"),
        ([edited(1, 2, "NaN")], None, "line 2: od is the text 'NaN', but must be a number; write"),
        ([edited(1, 2, "40,5")], None, "od is the text '40,5', but must be a number; write it as"),
        ([[["a drawing"], [1, 2]]], None, "no sheet has a row that names length and od; name the"),
        ([[]], None, "no sheet has a row that names length and od; name the"),
        ([PLAIN, PLAIN], None, "the sheets 'Sheet' and 'Sheet1' hold a table each; keep one"),
        ([[*PLAIN, [], *PLAIN]], None, "line 5 begins a second table; keep one rotor"),
        ([[[*row, None, *row] for row in PLAIN]], None, 'the column "station" is given twice; le'),
        ([[PLAIN[0], [None, "in", "in"], *PLAIN[1:]]], None, 'two units, "mm" in line 1 and "in" '),
    ],
)
def test_workbooks_that_are_none_are_refused(tmp_path, sheets, change, words):
    path = workbook(tmp_path / "rotor.xlsx", *sheets, change=change)
    with pytest.raises(InvalidInput, match=words) as error:
        read_rotor(path)
    assert "\n" not in str(error.value) and str(error.value).startswith(str(path))
    result = call("convert", path, "-o", tmp_path / "rotor.toml")
    assert result.exit_code == 2 and not (tmp_path / "rotor.toml").exists()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "station,length [mm],od [mm]\n1,5,4\n1,5,4\n",
            "line 3: station 1 behind 1 is there twice",
        ),
        ("station,length [mm],od [mm]\n2,5,4\n1,5,4\n", "station 1 behind 2 is out of order; give"),
        ("station,length [mm],od [mm]\n1,5,4\n3,5,4\n", "station 3 behind 1 leaves a gap; give"),
        ("station,length [mm],od [mm]\n1.5,5,4\n", "no whole number; number every row, or drop"),
        # inches for the lengths say nothing about the unit of a mass
        (
            "station,length,od,disc mass\n-,in,in,\n1,5,4,2\n",
            'line 3: disc mass has no unit; name it .* "disc mass \\[kg\\]"',
        ),
        ("length,od\nmm,kg\n5,4\n", 'the unit of od is "kg", but must be a unit of length; write'),
        ("length [mm],od [mm],id [mm]\n5,4,6\n", "id is 6 mm, but must be from 0 to below od, 4"),
        ("length [mm],od [mm],id [mm]\n5,4,-1\n", "id is -1 mm, but must be from 0 to below"),
        ("length [mm],od [mm],od right [mm]\n5,4,0\n", "both must be positive; correct the row"),
        ("length [mm],od [mm]\n0,4\n5,4\n", "line 2: length is 0 mm and od 4 mm, but both must"),
        ("length [mm],od [mm]\n5,4\nlength [mm],od [mm]\n5,4\n", "line 3 begins a second table"),
        ("length [mm],od [mm],material\n5,4,stele\n", "'stele' is unknown; did you mean .steel.?"),
        (
            "length [mm],od [mm],elements\n5,4,1e6\n",
            "1000000 elements in all, .* 800 .*; join rows",
        ),
        ("length [mm],od [mm],mass [kg]\n5,4,-1\n", "line 2: mass, Ip and It .* negative; correct"),
        ("length [mm],od [mm],elements\n5,4,1.5\n", "elements is 1.5, but must be 1, 2, ...; corr"),
        (
            "length;od\nmm;mm\n75,5;40\n1.225;40\n",
            "'75,5' in line 3. and points .'1.225' in line 4",
        ),
        ("length [mm],od [mm]\nnan,40\n", "length is 'nan', but must be a number; units are in"),
    ],
)
def test_tables_that_are_none_are_refused(tmp_path, text, words):
    path = tmp_path / "rotor.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InvalidInput, match=words) as error:
        read_rotor(path)
    assert "\n" not in str(error.value) and "; " in str(error.value)
    assert call("convert", path, "-o", tmp_path / "rotor.toml").exit_code == 2


def test_files_that_are_no_workbooks_are_refused(tmp_path):
    path = tmp_path / "rotor.xlsx"
    path.write_text("length [mm],od [mm]\n5,4\n", encoding="utf-8")
    with pytest.raises(InvalidInput, match=r"is not a workbook that can be read .*; save it again"):
        read_rotor(path)
    with pytest.raises(InvalidInput, match="is not a file; check the name"):
        read_rotor(tmp_path / "none.xlsx")
    long = [*PLAIN, *([i, 1, 40, 0] for i in range(3, 2100))]
    with pytest.raises(InvalidInput, match="over 2000 rows; keep those of the rotor alone"):
        read_rotor(workbook(path, long))


def test_what_a_spreadsheet_adds_above_a_table_is_no_fault(tmp_path):
    """A merged title with a comment, and a formula that a spreadsheet program computed."""

    def title(sheet):
        sheet.insert_rows(1, 2)
        sheet["A1"] = "Rotor 7"
        sheet["A1"].comment = openpyxl.comments.Comment("rev. B", "me")
        sheet.merge_cells("A1:D1")

    path = workbook(tmp_path / "rotor.xlsx", edited(1, 1, "=50+50"), change=title)
    with zipfile.ZipFile(path) as parts:
        content = {name: parts.read(name) for name in parts.namelist()}
    sheet, empty = "xl/worksheets/sheet1.xml", re.compile(rb"<f>50\+50</f><v ?(/>|></v>)")
    content[sheet], count = empty.subn(b"<f>50+50</f><v>100</v>", content[sheet])
    assert count == 1
    with zipfile.ZipFile(path, "w") as parts:
        for name, data in content.items():
            parts.writestr(name, data)
    model = read_rotor(path)
    assert [item.length for item in model.shaft] == [0.1, 0.2]
    assert model.left_out == ("line 1: Rotor 7",)
