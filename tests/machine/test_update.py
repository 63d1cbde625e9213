"""A machine file brought up to date: what did not change stays to the letter, what did is in the
user's place and unit.
"""

import difflib
import math
from dataclasses import replace
from pathlib import Path

import pytest

from ambrose.core.checks import InvalidInput
from ambrose.machine.description import BiasPoint, Tolerance
from ambrose.machine.file import update
from ambrose.machine.file.toml import (
    bundled_machines,
    dumps_machine,
    load_machine,
    loads_machine,
    read_machine_text,
)
from ambrose.machine.file.update import machine_text, save_machine, update_machine_file
from ambrose.machine.part import Channel, Material, PidSettings, SealTable, Section

SMALL = str(Path(__file__).with_name("small.toml"))
ODD = """# a rig on one page
amplifier = {order="first", bandwidth="1500Hz"} # measured in May
shaft = [
  {length = "0.4 m", outer_diameter = '50 mm'},   # the left half
  {length = "400mm", outer_diameter = "2 in", material = "titanium"}
]
material.titanium = {density = "4.43 g/cm^3", youngs_modulus = "114 GPa"} # as delivered
tolerance = [{parameter = "seal.mid.k", relative = "30 %"}, # the range of operation
  {parameter = "bearing.B.force_per_current", absolute = 12}]

[machine] # the whole
schema = 1
  name = "odd"
assumed.bearing.angle = "as drawn"
assumed.seal = 'a guess'
assumed."seal.mid.scales_with_pressure" = "k is a guess"

# the left one
[[bearing]]
position = "1 dm"
name = "A"
negative_stiffness = [ "1.2 N/um",   # zeta
                       1.3e6 ]       # eta
force_per_current = "200 N/A"
bias_current = 3
[[bearing.measured]]
bias_current = "2000 mA"   # cold
force_per_current = [150, 150]
negative_stiffness = 5e5

# the right one
[[bearing]]
name = "B"
position = "7 dm"
bias_current = 3
force_per_current = 200
negative_stiffness = 1_200_000
measured = [{bias_current = 2, force_per_current = 150, negative_stiffness = "0.5 N/um"}]

[[sensor]]
bearing = "B" # mounted first
position = 0.72
[[sensor]]
bearing = "A"
position = 0.08

# in the middle
[[seal]]
name = "mid"
position = "40 cm"
k = "0.1 N/um"   # from the data sheet
[seal.table]     # over pressure
pressure = [ "0 bar", "1 bar" ]
C = [ 100,  # shut
      200 ] # open

[operation]
point = [{label = "low", speed = "1000 rpm", seal_pressure = 0}]
# end of the file
"""


def changed_lines(before, after):
    """(taken out, put in) as lists of lines."""
    diff = list(difflib.ndiff(before.splitlines(), after.splitlines()))
    return [line[2:] for line in diff if line.startswith("- ")], [
        line[2:] for line in diff if line.startswith("+ ")
    ]


@pytest.fixture(autouse=True)
def never_anew(monkeypatch):
    """Fails a test in which the file is written anew because it could not be edited."""

    def fail(machine):
        raise AssertionError("written anew")

    monkeypatch.setattr(update, "dumps_machine", fail)


@pytest.mark.parametrize("file", [*bundled_machines(), SMALL])
def test_nothing_changes_where_nothing_changed(file):
    assert update_machine_file(file, load_machine(file)) == read_machine_text(file)
    assert machine_text(load_machine(file)) == read_machine_text(file)


def test_nothing_changes_in_an_odd_file():
    assert update_machine_file(ODD, loads_machine(ODD)) == ODD
    assert update_machine_file(ODD.replace("\n", "\r\n"), loads_machine(ODD)) == ODD


def test_changes_in_an_odd_file_keep_comments_order_and_units():
    machine = loads_machine(ODD)
    a, b = machine.bearings
    bearings = (
        replace(
            a,
            force_per_current=(210.5, 210.5),
            negative_stiffness=(1.25e6, 1.35e6),
            measured=(*a.measured, BiasPoint(4.0, (250.0, 250.0), (2e6, 2e6))),
        ),
        replace(
            b,
            force_per_current=(205.0, 207.0),
            negative_stiffness=(1.25e6, 1.25e6),
            measured=(replace(b.measured[0], negative_stiffness=(0.6e6, 0.6e6)),),
        ),
    )
    table = SealTable((("pressure", (0.0, 1.5e5)),), (("C", (110.0, 200.0)),))
    sections = (machine.shaft[0], replace(machine.shaft[1], outer_diameter=0.0635))
    tolerances = (
        replace(machine.tolerances[0], relative=0.25),
        Tolerance("bearing.A.force_per_current", relative=0.02),
    )
    point = replace(machine.operation.points[0], seal_pressure=1e5)
    updated = replace(
        machine,
        shaft=sections,
        bearings=bearings,
        seals=(replace(machine.seals[0], k=0.123e6, table=table),),
        amplifier=replace(machine.amplifier, bandwidth=9000.0),
        tolerances=tolerances,
        assumed=machine.assumed[1:],
        operation=replace(machine.operation, points=(point,)),
        source="identified",
    )
    text = update_machine_file(ODD, updated)
    assert loads_machine(text) == updated
    out, put = changed_lines(ODD, text)
    rate = next(line for line in put if line.startswith("amplifier"))
    assert rate.startswith('amplifier = {order="first", bandwidth="1432.3944878') and rate.endswith(
        'Hz"} # measured in May'
    )
    put.remove(rate)
    assert put == [
        '  {length = "400mm", outer_diameter = "2.5 in", material = "titanium"}',
        'tolerance = [{parameter = "seal.mid.k", relative = "25 %"}, # the range of operation',
        '  {parameter = "bearing.A.force_per_current",relative = 0.02}]',
        'source = "identified"',
        'negative_stiffness = [ "1.25 N/um",   # zeta',
        "                       1350000.0 ]       # eta",
        'force_per_current = "210.5 N/A"',
        "[[bearing.measured]]",
        'bias_current = "4 A"',
        'force_per_current = ["250 N/A", "250 N/A"]',
        'negative_stiffness = ["2 N/um", "2 N/um"]',
        "force_per_current = [205, 207]",
        "negative_stiffness = 1250000",
        'measured = [{bias_current = 2, force_per_current = 150, negative_stiffness = "0.6 N/um"}]',
        'k = "0.123 N/um"   # from the data sheet',
        'pressure = [ "0 bar", "1.5 bar" ]',
        "C = [ 110,  # shut",
        'point = [{label = "low", speed = "1000 rpm", seal_pressure = 100000}]',
    ]
    assert 'assumed.bearing.angle = "as drawn"' in out and len(out) == len(put) - 3


def test_what_stands_above_a_table_goes_with_it():
    machine = loads_machine(ODD)
    text = update_machine_file(
        ODD, replace(machine, bearings=machine.bearings[::-1], sensors=machine.sensors[::-1])
    )
    assert text.index('# the right one\n[[bearing]]\nname = "B"') < text.index(
        "# the left one\n[[bearing]]\nposition"
    )
    assert (
        text.index("# in the middle\n[[seal]]")
        > text.index('bearing = "B" # mounted first')
        > text.index('bearing = "A"')
    )
    text = update_machine_file(ODD, replace(machine, seals=(), tolerances=machine.tolerances[1:]))
    assert (
        "[[seal]]" not in text
        and "in the middle" not in text
        and text.endswith("# end of the file\n")
    )
    assert loads_machine(text) == replace(machine, seals=(), tolerances=machine.tolerances[1:])


def test_materials_keep_their_names():
    machine = loads_machine(ODD)
    first, second = machine.shaft
    softer = replace(
        machine,
        shaft=(first, replace(second, material=replace(second.material, youngs_modulus=110e9))),
    )
    text = update_machine_file(ODD, softer)
    assert loads_machine(text) == softer
    out, put = changed_lines(ODD, text)
    assert (
        put
        == [
            'material.titanium = {density = "4.43 g/cm^3", youngs_modulus = "110 GPa"} # as '
            "delivered"
        ]
        and len(out) == 1
    )
    named = ODD.replace(
        "outer_diameter = '50 mm'", "outer_diameter = '50 mm', material = 'steel'"
    ).replace("material.titanium =", "material.steel = {density = 7850}\nmaterial.titanium =")
    # steel is the default, and named all the same
    assert update_machine_file(named, loads_machine(named)) == named
    bronze = replace(
        machine, shaft=(replace(first, material=Material(8800.0, 110e9, 0.34, "bronze")), second)
    )
    assert loads_machine(update_machine_file(ODD, bronze)) == bronze


@pytest.mark.parametrize("file", ["seal-rig", "turboexpander"])
def test_a_bundled_machine_after_an_identification(file):
    machine, before = load_machine(file), read_machine_text(file)
    a, b = machine.bearings
    own = {
        key: getattr(machine.amplifier, key) * 1.0123456789
        for key in ("bandwidth", "natural_frequency")
        if getattr(machine.amplifier, key)
    }
    seal = replace(
        machine.seals[0],
        K=0.0,
        k=0.0,
        C=0.0,
        c=0.0,
        geometry=None,
        scales_with_pressure=(),
        table=SealTable(
            (("pressure", (0.0, 16e6 / 3)),), (("K", (1 / 3, 3.0)), ("k", (0.0, 16e6 / 7)))
        ),
    )
    updated = replace(
        machine,
        bearings=(
            replace(a, force_per_current=(400 / 3, 140.0), negative_stiffness=(1e7 / 9, 1.3e6)),
            b,
        ),
        amplifier=replace(machine.amplifier, **own),
        seals=(seal,),
        tolerances=(
            *machine.tolerances[1:],
            replace(machine.tolerances[0], relative=1 / 7),
            Tolerance("bearing.A.force_per_current.zeta", relative=0.01),
        ),
        source=f"{machine.source}; identified",
        assumed=machine.assumed[:2] + machine.assumed[3:],
    )
    text = update_machine_file(file, updated)
    assert loads_machine(text) == updated
    out, put = changed_lines(before, text)
    assert not [line for line in out if line.startswith("#")] and not [
        line for line in put if "#" in line and "N/" not in line
    ]
    assert any('"13.333' in line or "= [133.333" in line or '["133.333' in line for line in put)
    assert (
        len(text.splitlines()) - len(before.splitlines())
        == {"seal-rig": 3, "turboexpander": -6}[file]
    )
    assert loads_machine(update_machine_file(text, machine)) == machine  # and back


def test_saving_a_machine_keeps_the_file_that_it_came_from(tmp_path):
    file = tmp_path / "rig.toml"
    file.write_text(ODD, encoding="utf-8")
    machine = load_machine(file)
    save_machine(replace(machine, source="me"), file)
    assert changed_lines(ODD, file.read_text(encoding="utf-8")) == ([], ['source = "me"'])
    assert machine.file_text == ODD and machine == replace(machine, file_text="") and hash(machine)


def test_a_machine_without_a_file_is_written_anew(monkeypatch):
    monkeypatch.setattr(update, "dumps_machine", dumps_machine)
    machine = replace(loads_machine(ODD), file_text="")
    assert machine_text(machine) == dumps_machine(machine)


@pytest.mark.parametrize("wrong", [None, 3, "seal-rig"])
def test_only_a_machine_is_saved(wrong, tmp_path):
    with pytest.raises(InvalidInput, match=r"the machine to save is .*must be a Machine"):
        save_machine(wrong, tmp_path / "rig.toml")


def test_a_text_that_is_no_machine_is_refused():
    with pytest.raises(InvalidInput, match="not valid TOML"):
        update_machine_file("[machine\n", load_machine("seal-rig"))


@pytest.mark.parametrize("more", [("speed",), ("frequency", "speed")])
def test_a_seal_table_that_gains_axes_of_one_entry_is_brought_up_to_date(more, monkeypatch):
    machine = loads_machine(ODD)
    (_, pressures), *_ = machine.seals[0].table.axes
    values = dict(machine.seals[0].table.values)["C"]
    for _ in more:
        values = tuple((value,) for value in values)
    table = SealTable(
        (("pressure", pressures), *((axis, (1.0,)) for axis in more)), (("C", values),)
    )
    changed = replace(machine, seals=(replace(machine.seals[0], table=table),))
    monkeypatch.setattr(update, "dumps_machine", lambda machine: pytest.fail("written anew"))
    assert loads_machine(update_machine_file(ODD, changed)) == changed


def test_channels_take_the_place_of_one_gain_for_all_axes(monkeypatch):
    text = ODD.replace(
        "[operation]",
        '[controller]\ngain = "16 A/mm" # all\nderivative_time = "3 ms"\n\n[operation]',
    )
    machine = loads_machine(text)
    section = Section("pid", derivative_time=2e-3)
    channels = tuple(Channel((axis,), 2e4, (section,)) for axis in machine.axes)
    changed = replace(
        machine,
        controller=replace(machine.controller, gain=(), derivative_time=None, channels=channels),
    )
    monkeypatch.setattr(update, "dumps_machine", lambda machine: pytest.fail("written anew"))
    updated = update_machine_file(text, changed)
    assert (
        loads_machine(updated) == changed
        and "16 A/mm" not in updated
        and "# the left one" in updated
    )


def test_a_list_of_gains_that_gives_way_to_chains_leaves_the_rest_of_the_file_alone():
    """seal-rig states its gain as a list of one; an empty list was no gain, and the whole file was
    written anew in SI.
    """
    machine = load_machine("seal-rig")
    chains = tuple(
        Channel((axis,), 18e3, (Section("pid", 0.2, 0.0035, 0.1),)) for axis in machine.axes
    )
    text = machine_text(replace(machine, controller=PidSettings(channels=chains, sample_time=1e-4)))
    assert (
        'unbalance_orbit = "8 um"' in text and "# Seal test rig" in text and "gain = []" not in text
    )
    assert (
        loads_machine(text).controller.channels == chains
        and not loads_machine(text).controller.gain
    )


def test_chains_leave_nothing_of_an_earlier_controller_and_have_units():
    """derivative_filter = 0.1 # assumed stayed, and the filters' numbers were bare."""
    machine = load_machine("seal-rig")
    chain = Channel(machine.axes, 2e4, (Section("low-pass", frequency=240 * math.pi, damping=0.7),))
    machine = replace(machine, controller=PidSettings(channels=(chain,), sample_time=1e-4))
    text = machine_text(machine)
    table = text.partition("[controller]")[2].partition("[operation")[0]
    assert loads_machine(text) == machine and "derivative_" not in table
    assert all(
        words in table
        for words in (
            'sample_time = "100 us"',
            'gain = "20 A/mm"',
            'frequency = "120 Hz"',
            "damping = 0.7",
        )
    )
