"""docs/reference/machine-file.md has a section for every table, whose keys the program writes into it; its
example is a machine.
"""

import re
from pathlib import Path

import pytest
from docs_build.machine_file import headings, render

from ambrose.machine.file.toml import dumps_machine, loads_machine
from ambrose.machine.parameters import quantities
from ambrose.machine.units import DIMENSIONS

WRITTEN = (Path(__file__).parents[2] / "docs" / "reference" / "machine-file.md").read_text(
    encoding="utf-8"
)
PAGE = render(WRITTEN)


@pytest.mark.parametrize("heading", headings())
def test_every_key_has_its_row(heading):
    section = re.search(
        rf"^###? `{re.escape(heading)}`\n(.*?)(?=^##|\Z)", PAGE, re.DOTALL | re.MULTILINE
    )
    assert section, f"docs/reference/machine-file.md lacks a section for {heading}"
    for name, field in headings()[heading].model_fields.items():
        inner = heading.strip("[]").replace("NAME", "titanium")
        if not any(each.strip("[]").startswith(f"{inner}.{name}") for each in headings()):
            assert f"| `{field.alias or name}` | " in section[1], f"put <!-- keys --> in {heading}"


def test_no_place_is_left_and_no_section_is_out_of_date():
    assert "<!-- keys" not in PAGE and "<!-- units" not in PAGE and "<!-- limits" not in PAGE
    assert set(re.findall(r"^###? `(\[.*\])`$", WRITTEN, re.MULTILINE)) == set(headings())
    with pytest.raises(KeyError, match="no_such"):
        render("### `[no_such]`\n\n<!-- keys -->\n")


def test_the_example_is_a_machine_and_has_every_table():
    (example,) = re.findall(r"```toml title=\"example.toml\"\n(.*?)```", PAGE, re.DOTALL)
    machine = loads_machine(example)
    assert loads_machine(dumps_machine(machine)) == machine
    for heading in headings():
        assert heading.replace("NAME", "titanium") in example, heading


def test_every_unit_and_parameter_is_listed():
    for dimension in DIMENSIONS.values():
        if dimension.units:
            units = ", ".join(f"`{unit}`" for unit in dimension.units)
            assert f"| {dimension.name} | `{dimension.unit}` | {units} |" in PAGE
    for table, of in quantities().items():
        for quantity, (_, components) in of.items():
            path = f"`{table}.{quantity}`" if table == "amplifier" else f"`{table}.NAME.{quantity}`"
            assert path in PAGE
            mark = "_" if table == "seal" else "."
            assert all(f"`{mark}{component}`" in PAGE for component in components)
