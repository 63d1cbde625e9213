"""One table of what the numbers of a machine file may be (machine/validation/ranges.toml): complete against
the models of the tables, and every number outside of it is doubted or refused.
"""

import re
from pathlib import Path

import pytest

from ambrose.chain.check import entry_doubts
from ambrose.core.checks import InvalidInput
from ambrose.machine.file.tables import machine_file, table_below
from ambrose.machine.file.toml import bundled_machines, load_machine, loads_machine
from ambrose.machine.units import DIMENSIONS, read_quantity
from ambrose.machine.validation.ranges import implausible, impossible, numbers_of, ranges

SMALL = Path(__file__).with_name("small.toml").read_text()


def keys(model, above=""):
    """(path, dimension, "" where a tolerance's parameter says it) of every numeric key, from the
    pydantic models that files are read with.
    """
    for name, field in model.model_fields.items():
        path = f"{above}{field.alias or name}"
        if below := table_below(model, name):
            yield from keys(below, f"{path}.")
            continue
        kind = field.metadata[0] if field.metadata else field.annotation
        if kind is float:
            yield path, ""
        elif type(kind).__name__ == "Count":
            yield path, "plain number"
        elif hasattr(kind, "dimension"):
            yield path, kind.dimension


def stated(model, table, above=""):
    """{path: numbers} of the plain data of a machine: an independent walk beside ``numbers_of``."""
    names = {field.alias or name: name for name, field in model.model_fields.items()}
    found = {}
    for key, value in table.items():
        below, path = table_below(model, names[key]), f"{above}{key}"
        if below is None:
            flat = numbers(value)
            if flat and key != "schema":
                found.setdefault(path, []).extend(flat)
            continue
        entries = value.values() if path == "material" else value
        for entry in [value] if isinstance(value, dict) and path != "material" else entries:
            for inner, more in stated(below, entry, f"{path}.").items():
                found.setdefault(inner, []).extend(more)
    return found


def numbers(value):
    if isinstance(value, (list, tuple)):
        return [number for entry in value for number in numbers(entry)]
    return [value] if isinstance(value, (int, float)) else []


def test_every_numeric_key_has_its_range():
    wanted = dict(keys(machine_file()))
    usual, physics = ranges()
    assert set(usual) == set(wanted) and len(usual) > 300
    assert set(physics) <= set(wanted)
    for path, dimension in wanted.items():
        if not dimension:
            assert usual[path] == "parameter"
            continue
        low, high = (read_quantity(bound, DIMENSIONS[dimension]) for bound in usual[path])
        limit = physics.get(path, [1e60])[0]
        assert low < high
        assert isinstance(limit, float) or high <= read_quantity(limit, DIMENSIONS[dimension]), path


@pytest.mark.parametrize("name", [*bundled_machines(), "small.toml"])
def test_no_number_is_passed_over_and_no_sound_machine_is_doubted(name):
    machine = loads_machine(SMALL) if name == "small.toml" else load_machine(name)
    asked = {}
    for entry in numbers_of(machine):
        asked.setdefault(entry.path, set()).update(entry.values)
    for path, values in stated(machine_file(), machine.to_dict()).items():
        assert set(values) <= asked.get(path, set()), path
    assert [*impossible(machine), *implausible(machine)] == []


# of issue 49: absurd, and passed without a word
ABSURD = {
    "film that drives": ('C_xx = ["200 kN s/m", 160e3]', "C_xx = [-2e5, -1.6e5]"),
    "stage of 40 GW": ('power = "40 kW"', 'power = "40 GW"'),
    "stage within the shaft": ('diameter = "220 mm"\nwidth', 'diameter = "20 mm"\nwidth'),
    "static friction": ("static_friction = 0.25", "static_friction = 50"),
    "race of 300 kg": ('mass = "300 g"', 'mass = "300 kg"'),
    "race of 1e300 kg": ('mass = "300 g"', "mass = 1e300"),
    "glowing race": ('temperature = "40 degC"', 'temperature = "5000 K"'),
    "support of 1 mg": ('mass = "300 kg"', 'mass = "1 mg"'),
    "brake": ('brake_torque = "2 N m"', 'brake_torque = "2e9 N m"'),
    "thrust gain": ('gain = "22 A/mm"\nintegral', 'gain = "22e6 A/mm"\nintegral'),
    "flux": ('flux_density = "1.6 T"\nmax_current', 'flux_density = "100 T"\nmax_current'),
    "tolerance along the shaft": (
        'force_per_current"\nrelative = "10 %"\naround',
        'force_per_current"\nrelative = "1000 %"\naround',
    ),
    "width of a tolerance": ('absolute = "50 N/mm"', 'absolute = "5e9 N/mm"'),
    "element load": ('element_load = "2 kN"', "element_load = 1e-300"),
    "element stiffness": ('element_stiffness = "150 N/um"', "element_stiffness = 1e300"),
    "runout": ('amplitude = "2 um"', 'amplitude = "2 m"'),
    "time constant": ('time_constant = "0.5 s"', "time_constant = 1e9"),
    "deaf sensor": ('gain = [1.0, "98 %"]', 'gain = [1e-6, "98 %"]'),
    "sensor without noise": ('noise = "0.2 um"', 'noise = "2e-7 um"'),
    "smooth track": ('amplitude = "2 um"', 'amplitude = "2e-6 um"'),
    "coupling like a damper": ('damping = "10 N s/m"', 'damping = "1e7 N s/m"'),
    "brake of a watch": ('brake_torque = "2 N m"', 'brake_torque = "2e-6 N m"'),
    "friction of nothing": ('friction_torque = "50 mN m"', 'friction_torque = "50e-6 mN m"'),
    "stiffer than steel": ('compliance_peak = "1 um/N"', 'compliance_peak = "1e-6 um/N"'),
    "pressure of a glacier": ('pressure_rate = "20 bar/s"', 'pressure_rate = "20e-6 bar/s"'),
    "no disturbance": ("output_disturbance = 2", "output_disturbance = 2e-6"),
    "uneven T": ("real = [[[1, 0, 0, 0]", "real = [[[1e6, 0, 0, 0]"),
    "filter of hours": ("denominator = [1, 8000]", "denominator = [1e6, 8000]"),
    "no error at all": ("low_frequency_error = 0.002", "low_frequency_error = 2e-9"),
    "load of a planet": ('force = "0.2 kN"', 'force = "0.2e12 kN"'),
    "clearance of a room": ('diametral = "0.4 mm"', 'diametral = "4 m"'),
    "steel like gas": ('density = "4.43 g/cm^3"', 'density = "4.43 kg/m^3"'),
    "growth": ('growth = ["-20 um", "40 um"]', 'growth = ["-20 m", "-19 m"]'),
}


@pytest.mark.parametrize("case", ABSURD)
def test_what_is_absurd_is_doubted_or_refused_with_its_remedy(case):
    old, new = ABSURD[case]
    assert SMALL.count(old) == 1, old
    sound = set(entry_doubts(loads_machine(SMALL)))
    try:
        found = set(entry_doubts(loads_machine(SMALL.replace(old, new)))) - sound
    except InvalidInput as error:
        found = {str(error)}
    key = new.partition(" ")[0].split('"')[0]
    assert any(re.search(r"[;:] (correct|write|check|move)", line) for line in found), (key, found)


def test_many_numbers_of_one_key_are_one_doubt():
    text = SMALL.replace("elements = 4", "elements = 4\n").replace('"0.2 um"', '"0.2 m"')
    text = text.replace('position = "530 mm"', 'position = "530 mm"\nnoise = 0.3')
    (line,) = implausible(loads_machine(text))
    assert line.startswith("[[sensor]] A: noise is 0.2 m, where") and line.endswith("(and 1 more)")


def test_a_range_names_the_unit_that_was_meant():
    text = SMALL.replace('element_stiffness = "150 N/um"', "element_stiffness = 150")
    (line,) = implausible(loads_machine(text))
    assert line == (
        "[[bearing]] A, [bearing.touchdown.race]: element_stiffness is 150 N/m, where 0.1 N/um to "
        '1e4 N/um is usual; write "150 N/um" if that is meant'
    )


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('corner = "12 kHz"', "corner = 0"),
        ('power = "40 kW"', "power = 1e15"),
        ("turns = 36", "turns = 1e300"),
        ("gap_scale = 0.98", "gap_scale = 1e-300"),
        ('zero_frequency = "550 Hz"', "zero_frequency = 1e-300"),
        ('temperature = "20 degC"', "temperature = 1e300"),
    ],
)
def test_numbers_that_ended_check_in_a_traceback_are_refused(old, new):
    with pytest.raises(InvalidInput, match=r"; (correct|give|leave)"):
        loads_machine(SMALL.replace(old, new))
