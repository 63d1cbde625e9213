"""A rotor from a spreadsheet: a row per station, saved as CSV.

    length [mm]; od [mm]; id [mm]; E [GPa]; rho [kg/m^3]; disc mass [kg]; disc Ip [kg m^2]; ...
    50;          40;      0;       210;     7850;         ;               ;

Every row is a piece of shaft; what stands in its disc and bearing columns stands at its left end,
and a row of length 0 at the shaft's right end. Columns may be missing but for length and od, in any
order; units stand in brackets behind the name (file/text_table.py).
"""

from __future__ import annotations

import math
import os
from dataclasses import replace
from pathlib import Path

from ambrose.core.checks import InvalidInput
from ambrose.machine.file.ross import GIVE, merged, parse_ross, rotor_of_ross
from ambrose.machine.file.text_table import Column, NamedTable, named_table
from ambrose.machine.limits import NAME, TOML_BYTES
from ambrose.machine.messages import one_line
from ambrose.machine.ordinary_file import read_text
from ambrose.machine.rotor_model import Disc, Material, RotorModel, ShaftSection
from ambrose.machine.units import DIMENSIONS

_COLUMNS = {  # name -> (dimension, other names)
    "length": ("length", ("l",)),
    "od": ("length", ("outer diameter", "outer_diameter", "diameter")),
    "id": ("length", ("inner diameter", "inner_diameter", "bore")),
    "mass diameter": ("length", ("mass_diameter", "mass od")),
    "e": ("elastic modulus", ("young", "youngs_modulus", "youngs modulus")),
    "rho": ("density", ("density",)),
    "nu": ("ratio", ("poisson", "poisson_ratio")),
    "disc mass": ("mass", ("disk mass", "mass")),
    "disc ip": ("moment of inertia", ("disk ip", "ip")),
    "disc id": ("moment of inertia", ("disk id",)),
    "bearing": ("", ()),
    "label": ("", ("name", "tag")),
}
_NAMES = {kind: others for kind, (_, others) in _COLUMNS.items()}
_WORDS = {kind for kind, (dimension, _) in _COLUMNS.items() if not dimension}
_STEEL = Material()


def rotor_of_stations(text: str, name: str) -> RotorModel:
    """The rotor in the text of a CSV file; ``name`` stands in messages. Raises InvalidInput."""
    try:
        table = named_table(
            text,
            _NAMES,
            _WORDS,
            required=("length", "od"),
            example="length [mm]; od [mm]; id [mm]; E [GPa]; rho [kg/m^3]; disc mass [kg]",
        )
        return _rotor(table)
    except InvalidInput as error:
        other = "" if "length" in text.lower() else f"; {GIVE}"  # any CSV file comes here
        raise InvalidInput(f"{name}: {error}{other}") from None


def _rotor(table: NamedTable) -> RotorModel:
    sections = list[ShaftSection]()
    discs = list[Disc]()
    bearings = list[float]()
    at = 0.0
    for line, row in table.rows:
        words = {column.kind: cell for column, cell in row.items() if column.kind in _WORDS}
        try:
            get = {
                column.kind: _read(table, column, cell)
                for column, cell in row.items()
                if column.kind not in _WORDS
            }
        except InvalidInput as error:
            raise InvalidInput(f"line {line}: {error}") from None
        if get.get("disc mass"):
            label = f"disc{len(discs) + 1}"
            discs.append(
                Disc(label, at, get["disc mass"], get.get("disc ip", 0.0), get.get("disc id", 0.0))
            )
        if words.get("bearing", "no").lower() not in {"0", "no", "-"}:
            bearings.append(at)
        length = get.get("length", 0.0)
        if length == 0:
            continue
        if length < 0 or get.get("od", 0.0) <= 0:
            raise InvalidInput(
                f"line {line}: length and od must be positive; correct the row, or leave its "
                "length out for the end"
            )
        material = Material(
            get.get("rho", _STEEL.density),
            get.get("e", _STEEL.youngs_modulus),
            get.get("nu", _STEEL.poisson_ratio),
        )
        od, heavy = get["od"], get.get("mass diameter")
        label = words.get("label", "")
        elements = min(max(math.ceil(length / od), 1), 20)
        sections.append(
            ShaftSection(at, length, od, get.get("id", 0.0), heavy, elements, material, label)
        )
        at += length
    if not sections:
        raise InvalidInput("no row has a length; give a row per piece of shaft")
    named = {"e", "rho"} & {column.kind for column in table.columns}
    assumed = {} if named else {"shaft.material": "steel, as the table names no material"}
    return RotorModel(
        "rotor",
        tuple(merged(sections)),
        tuple(discs),
        tuple(bearings),
        source="table of stations",
        assumed=assumed,
    )


def _read(table: NamedTable, column: Column, cell: str) -> float:
    number = table.number(column, cell)
    dimension = _COLUMNS[column.kind][0]
    example = DIMENSIONS[dimension].example.partition(" ")[2]
    return column.si(number, dimension, example) if number else 0.0


def read_rotor(path: str | os.PathLike[str]) -> RotorModel:
    """The rotor in a file of ROSS (*.toml, *.json) or a table of stations (*.csv), called as the
    file. Raises InvalidInput.
    """
    source = Path(path)
    text, suffix = read_text(source, "rotor model", TOML_BYTES), source.suffix.lower()
    if suffix in {".csv", ".txt"}:
        rotor = rotor_of_stations(text, str(source))
    else:
        rotor = rotor_of_ross(parse_ross(text, str(source), suffix), str(source))
    return replace(
        rotor,
        name=one_line(source.stem).strip()[:NAME] or "rotor",
        source=f"{rotor.source}, {one_line(source.name)}",
    )
