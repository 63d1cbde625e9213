"""Machines and their parts show themselves in a line, in a table, and as plain data."""

import json
import math
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import pytest

from ambrose.core.presentation import Presented
from ambrose.machine import description as d
from ambrose.machine.file.toml import bundled_machines, dumps_machine, load_machine, loads_machine
from ambrose.machine.part import Disc, Part

SMALL = str(Path(__file__).with_name("small.toml"))


def parts(thing):
    """The machine and everything in it."""
    if is_dataclass(thing):
        yield thing
        for field in fields(thing):
            yield from parts(getattr(thing, field.name))
    elif isinstance(thing, tuple):
        for element in thing:
            yield from parts(element)


@pytest.mark.parametrize("file", [*bundled_machines(), SMALL])
def test_every_part_shows_itself_in_a_line(file):
    for part in parts(load_machine(file)):
        assert repr(part).startswith(type(part).__name__) and len(repr(part)) < 200
        json.dumps(part.to_dict())


def test_a_part_shows_what_is_not_its_default():
    assert repr(Disc("wheel", 0.1, 3.0)) == "Disc(name=wheel, position=0.1, mass=3)"
    assert d.OperatingPoint(seal_pressure=2e5).to_dict() == {"seal_pressure": 2e5}
    assert d.OperatingPoint().to_dict(defaults=True) == {
        "speed": 0.0,
        "seal_pressure": 0.0,
        "label": "",
    }


def test_the_table_of_a_machine_names_its_parts():
    page = load_machine("turboexpander")._repr_html_()
    for words in (
        "A at 0.108 m",
        "of B at 0.3877 m",
        "expander at 0.5157 m, 3.2 kg",
        "piston at 0.2688 m",
        "seal.piston.K_xx ± 40 %",
    ):
        assert words in page
    assert "140 Hz (P3) (879.6 rad/s, 3.85e+06 Pa)" in page and "couplings" not in page


def test_the_plain_data_are_those_of_the_file():
    import tomllib

    machine = load_machine(SMALL)
    assert tomllib.loads(dumps_machine(machine)) == machine.to_dict()
    whole = machine.to_dict(defaults=True)
    assert whole["bearing"][1]["angle"] == 0.0 and "angle" not in machine.to_dict()["bearing"][1]
    assert loads_machine(dumps_machine(machine)) == machine


def test_what_a_result_names_is_what_it_tells():
    @dataclass(frozen=True, repr=False)
    class Outcome(Presented):
        _FACTS: ClassVar = ("largest=peak", "half")
        _DATA: ClassVar = ("peak", "parts=items")
        peak: float
        items: tuple = ()

        @property
        def half(self):
            return self.peak / 2

    inner = Outcome(math.inf)
    assert repr(Outcome(3.0)) == "Outcome(largest=3, half=1.5)"
    assert Outcome(3.0, (inner,)).to_dict() == {
        "peak": 3.0,
        "parts": [{"peak": "inf", "parts": []}],
    }


def test_a_whole_number_is_written_as_one_however_its_annotation_is_kept():
    """As text, or as the type itself in a file without the import from __future__."""

    @dataclass(frozen=True, repr=False)
    class Teeth(Part):
        count: Annotated[int, "of them"]
        rows: Annotated[int | None, "of teeth"] = None
        pitch: Annotated[float, "between them"] = 1

    @dataclass(frozen=True, repr=False)
    class Text(Part):
        count: "Annotated[int, 'of them']"
        pitch: "Annotated[float, 'between them']"

    for part in (Teeth(6, 2, 3), Text(6, 3)):
        written = part.to_dict()
        assert [type(written[key]) for key in ("count", "pitch")] == [int, float]
    assert type(Teeth(6, 2).to_dict()["rows"]) is int
