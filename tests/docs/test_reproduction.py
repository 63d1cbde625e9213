"""docs/research/reproduction.md: the second table, of the thesis' conclusions, has the kinds, verdicts and commands of the first."""

import re

import pytest
from docs_build import DOCS

PAGE = (DOCS / "research" / "reproduction.md").read_text(encoding="utf-8")
KINDS = ("independent", "inputs recovered", "assumed", "none")
VERDICTS = ("reproduced", "in part", "not reproduced", "refuted", "open")
ITEMS = {
    *(f"7.1.{k}" for k in range(1, 6)),
    *(f"7.2.{k}" for k in range(1, 5)),
    *("P3.3 with K S_i", "P5, figure 7", "2.15 bar", "P1, figures 6 and 7"),
}
SECTION = PAGE.partition("### Conclusions, and what else is printed")[2].partition("\n## ")[0]
ROWS = [
    [cell.strip() for cell in line.strip("|").split("|")]
    for line in SECTION.splitlines()
    if line.startswith("| ") and not line.startswith("| item")
]


def test_every_item_has_its_row():
    for item in ITEMS:
        assert [row for row in ROWS if item in row[0]], item


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[0][:12])
def test_a_row_says_what_kind_it_is_and_what_comes_out(row):
    _, kind, verdict, remark, figure, command = row
    known = set(re.findall(r"`(\w+)`(?: stands)? for\s+`(?:pytest|python)", PAGE))
    assert kind in KINDS and verdict in VERDICTS
    assert remark and figure
    assert (kind == "none") == (verdict == "open")
    assert verdict == "open" or (command and set(re.findall(r"`(\w+)`", command)) <= known)
