"""docs/research/reproduction.md: every published statement has one row, a kind and a verdict, and the page
counts its own rows.
"""

import re
from collections import Counter
from pathlib import Path

import pytest

pytestmark = pytest.mark.literature
ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "research" / "reproduction.md").read_text(encoding="utf-8")
KINDS = ("independent", "inputs recovered", "assumed", "none")
VERDICTS = ("reproduced", "in part", "not reproduced", "refuted", "open")
LAST = {"P1": 3, "P2": 6, "P3": 8, "P4": 7, "P5": 13}
IDS = {f"{paper}.{k}" for paper, last in LAST.items() for k in range(1, last + 1)} | {
    "7.2.2",
    "7.3",
    "7.4",
}


def cells_of(line):
    return [cell.strip() for cell in line.strip().strip("|").split("|")]


def table(head):
    """The rows under a heading row of the page, as lists of cells."""
    lines = PAGE.splitlines()
    start = next(k for k, line in enumerate(lines) if line.startswith(head)) + 2
    end = next(k for k in range(start, len(lines)) if not lines[k].startswith("|"))
    return [cells_of(line) for line in lines[start:end]]


ROWS = table("| id | kind | verdict |")


def test_one_row_for_every_statement():
    assert sorted(row[0] for row in ROWS) == sorted(IDS)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[0])
def test_a_row_says_what_kind_it_is_and_what_comes_out(row):
    """In part, not reproduced and assumed say why; everything judged gives a figure and a
    command.
    """
    name, kind, verdict, remark, figure, command = row
    assert kind in KINDS
    assert verdict in VERDICTS
    assert figure
    assert (kind == "none") == (verdict == "open")
    assert remark or verdict == "reproduced" or name == "7.3"
    known = set(re.findall(r"`(\w+)`(?: stands)? for\s+`(?:pytest|python)", PAGE))
    assert verdict == "open" or (command and set(re.findall(r"`(\w+)`", command)) <= known)


def test_the_page_counts_its_rows():
    counted = Counter((row[1], row[2]) for row in ROWS)
    for label, *numbers in table("| rows | reproduced |"):
        kinds = KINDS if label == "all" else (label,)
        wanted = [sum(counted[kind, verdict] for kind in kinds) for verdict in VERDICTS]
        assert [int(x) for x in numbers] == [*wanted, sum(wanted)], label
    assert [row[0] for row in table("| rows | reproduced |")] == [*KINDS, "all"]


def test_every_command_leads_somewhere():
    for kind, target in re.findall(r"`(pytest|python -m) ([\w./]+)", PAGE):
        path = ROOT / target if kind == "pytest" else ROOT / (target.replace(".", "/") + ".py")
        assert path.exists(), target


def test_what_is_put_in_is_called_so():
    """Rows whose printed figure is a parameter of the bundled machines are no independent
    confirmation.
    """
    kinds = {row[0]: row[1] for row in ROWS}
    for name in ("P2.2", "P4.3", "P4.4", "P5.2"):
        assert kinds[name] == "inputs recovered"
    assert kinds["P5.5"] == "assumed"
