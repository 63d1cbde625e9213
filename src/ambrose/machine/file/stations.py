"""A rotor from a spreadsheet: a row per station, saved as CSV.

    length [mm]; od [mm]; id [mm]; E [GPa]; rho [kg/m^3]; disc mass [kg]; disc Ip [kg m^2]; ...
    50;          40;      0;       210;     7850;         ;               ;

Every row is a piece of shaft; what stands in its disc and bearing columns stands at its left end,
and a row of length 0 at the shaft's right end. Columns may be missing but for length and od, in any
order; units stand in brackets behind the name.
"""

from __future__ import annotations

import csv
import math
import os
import re
from dataclasses import replace
from pathlib import Path

from ambrose.core.checks import InvalidInput
from ambrose.machine.file.ross import GIVE, merged, parse_ross, rotor_of_ross
from ambrose.machine.limits import NAME, TOML_BYTES
from ambrose.machine.messages import one_line, suggestion
from ambrose.machine.ordinary_file import read_text
from ambrose.machine.rotor_model import Disc, Material, RotorModel, ShaftSection
from ambrose.machine.units import DIMENSIONS, read_quantity

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
_STEEL = Material()


def rotor_of_stations(text: str, name: str) -> RotorModel:
    """The rotor in the text of a CSV file; ``name`` stands in messages. Raises InvalidInput."""
    lines = [
        line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")
    ]
    if len(lines) < 2:
        raise InvalidInput(
            f"{name}: it has no stations, a row of names (length [mm], od [mm], ...) and a row "
            f"for each; {GIVE}"
        )
    mark = max(";\t,", key=lines[0].count)
    header, *rows = csv.reader(lines, delimiter=mark)
    if not any(_kind_of(cell)[0] for cell in header):
        raise InvalidInput(
            f"{name}: its first row names no column of a table of stations, such as length [mm]; "
            f"{GIVE}"
        )
    columns = [_column(name, cell) for cell in header]
    kinds = [kind for kind, _ in columns]
    for kind in ("length", "od"):
        if kind not in kinds:
            raise InvalidInput(
                f'{name}: the column "{kind}" is missing; its first row names the columns, such '
                f'as "{kind} [mm]"'
            )
    if twice := next((kind for kind in kinds if kinds.count(kind) > 1), None):
        raise InvalidInput(f'{name}: the column "{twice}" stands there twice; leave one out')
    sections = list[ShaftSection]()
    discs = list[Disc]()
    bearings = list[float]()
    at = 0.0
    for number, row in enumerate(rows, 2):
        where = f"{name}, row {number}"
        if len(row) > len(columns):
            raise InvalidInput(
                f"{where}: it has {len(row)} cells, but {len(columns)} columns are named; check "
                "the separator"
            )
        cells = {
            kind: (cell.strip(), unit)
            for (kind, unit), cell in zip(columns, row, strict=False)
            if cell.strip()
        }
        get = {kind: _read(where, kind, *cells[kind], mark) for kind in cells if _COLUMNS[kind][0]}
        if get.get("disc mass"):
            label = f"disc{len(discs) + 1}"
            discs.append(
                Disc(label, at, get["disc mass"], get.get("disc ip", 0.0), get.get("disc id", 0.0))
            )
        if "bearing" in cells and cells["bearing"][0].lower() not in {"0", "no", "-"}:
            bearings.append(at)
        length = get.get("length", 0.0)
        if length == 0:
            continue
        if length < 0 or get.get("od", 0.0) <= 0:
            raise InvalidInput(
                f"{where}: length and od must be positive; correct the row, or leave its length "
                "out for the end"
            )
        material = Material(
            get.get("rho", _STEEL.density),
            get.get("e", _STEEL.youngs_modulus),
            get.get("nu", _STEEL.poisson_ratio),
        )
        label = cells.get("label", ("", ""))[0]
        od, heavy = get["od"], get.get("mass diameter")
        elements = min(max(math.ceil(length / od), 1), 20)
        sections.append(
            ShaftSection(at, length, od, get.get("id", 0.0), heavy, elements, material, label)
        )
        at += length
    if not sections:
        raise InvalidInput(f"{name}: no row has a length; give a row per piece of shaft")
    assumed = (
        {}
        if {"e", "rho"} & set(kinds)
        else {"shaft.material": "steel, as the table names no material"}
    )
    return RotorModel(
        "rotor",
        tuple(merged(sections)),
        tuple(discs),
        tuple(bearings),
        source="table of stations",
        assumed=assumed,
    )


def _kind_of(cell: str) -> tuple[str, str, str]:
    """What a column holds ("": unknown), its unit, and the word that stands there."""
    match = re.fullmatch(r"\s*([^\[(]*?)\s*(?:[\[(](.*)[\])])?\s*", cell)
    word = "" if match is None else match[1].lower()
    kind = next(
        (kind for kind, (_, others) in _COLUMNS.items() if word == kind or word in others), ""
    )
    return kind, (match[2] or "").strip() if match else "", word


def _column(name: str, cell: str) -> tuple[str, str]:
    kind, unit, word = _kind_of(cell)
    if not kind:
        raise InvalidInput(
            f'{name}: the column "{cell.strip()}" is unknown; {suggestion(word, _COLUMNS)}'
        )
    return kind, unit


def _read(where: str, kind: str, cell: str, unit: str, mark: str) -> float:
    dimension = DIMENSIONS[_COLUMNS[kind][0]]
    number = (
        cell.replace(",", ".") if mark != "," and cell.count(",") == 1 and "." not in cell else cell
    )
    try:
        value = float(number)
    except ValueError:
        raise InvalidInput(
            f'{where}: {kind} is "{cell}", but must be a number; units stand in the first row, as '
            f'"{kind} [mm]"'
        ) from None
    if not unit and value and dimension.unit != "-":
        raise InvalidInput(
            f'{where}: {kind} has no unit; name it in the first row, such as "{kind} '
            f'[{dimension.example.split(" ", 1)[1]}]"'
        )
    try:
        return read_quantity(f"{number} {unit}" if unit and value else value, dimension)
    except ValueError as error:
        raise InvalidInput(f"{where}: {kind} {error}") from None


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
