"""`ambrose review`: everything that is known of a machine and its controller, on one page.

What is judged is judged elsewhere (`verify`, `lateral`, `landing`, `check`); here it is collected:
what holds, what does not, what was assumed, what was not judged.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ambrose.terminal import (
    AS_JSON,
    claim,
    load,
    load_controller,
    print_table,
    progress_shown,
    say,
    say_json,
    say_verdict,
)

if TYPE_CHECKING:
    from ambrose.judge.checks import Verification
    from ambrose.law.law import Law
    from ambrose.machine.machine import Machine
    from ambrose.report.page import Brand, Page

_FIGURES = ("Output sensitivity", "Unbalance placed", "Slow motion")  # of the pages behind
Progress = Callable[[str], None]
_LANDING = {  # rows of the lateral analysis that another analysis is for
    "not_covered.touchdown_bearings",
    "not_covered.auxiliary_bearing_landing_analysis",
}
DEFAULTS = "review.toml"  # of the user's folder: project, revision, author, logo


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Review:
    """A machine and a controller as they were judged.

    verification: of the loop. lateral, landing: None where they were not done, with the reason in
    not_judged. doubts: the entries of the machine file that are implausible; remarks: what else
    `check` says of it. not_judged: a sentence each. sources: file and SHA-256.
    """

    machine: Machine
    verification: Verification
    lateral: Any
    landing: Any
    doubts: tuple[str, ...]
    remarks: tuple[str, ...]
    not_judged: tuple[str, ...]
    refused: tuple[str, ...] = ()
    sources: tuple[tuple[str, str], ...] = ()

    @property
    def failed(self) -> tuple[tuple[str, str, str, str, str], ...]:
        """What is not met: by which analysis, requirement, value, limit, where."""
        from ambrose.report.tables import failing_table

        def shown(number: float | None, unit: str) -> str:
            return "-" if number is None else f"{number:.3g} {unit}".removesuffix(" -")

        rows = [("check", "entry of the machine file is plausible", "", "", d) for d in self.doubts]
        for where, *rest, detail in failing_table(self.verification).cells:
            words = (cell.text for cell in rest)
            place = ", ".join(filter(None, (where.text, detail.text)))
            rows.append(("verify", *words, place))  # type: ignore[arg-type]
        for name, result, items in (
            ("lateral", self.lateral, "items"),
            ("landing", self.landing, "rows"),
        ):
            for item in getattr(result, items, ()):
                if item.passed is False:
                    limit = f"{item.relation} {shown(item.limit, item.unit)}"
                    limit = "-" if item.limit is None else limit
                    value = shown(item.value, item.unit)
                    rows.append((name, item.title, value, limit, item.note))
        return tuple(rows)

    @property
    def judged(self) -> int:
        """How many requirements have a verdict, met or not."""
        groups = [checks.checks for _, checks in self.verification.labelled]
        groups += [getattr(self.lateral, "items", ()), getattr(self.landing, "rows", ())]
        return sum(item.passed is not None for group in groups for item in group)

    @property
    def passed(self) -> bool:
        """Whether every analysis passes, and none that was to be made was refused."""
        sides = [getattr(item, "passed", None) for item in (self.lateral, self.landing)]
        met = self.verification.passed and False not in sides
        return met and not self.doubts and not self.refused

    @property
    def verdict(self) -> str:
        """In a sentence."""
        lines, left = self.failed, len(self.not_judged)
        beside = f" {left} {'point was' if left == 1 else 'points were'} not judged." * (left > 0)
        if self.passed:
            return f"All {self.judged} requirements that were judged are met.{beside}"
        what = dict.fromkeys(f"{row[1]} ({row[0]})" for row in lines)
        what |= dict.fromkeys(f"no {name} analysis" for name in self.refused)
        what = what or {"not everything is covered": None}
        some = "; ".join([*what][:3]) + f" and {len(what) - 3} more" * (len(what) > 3)
        return f"Not to be released: {some}.{beside}"

    def __repr__(self) -> str:
        return f"<Review of {self.machine.name}: {self.verdict}>"

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        keys = ("analysis", "requirement", "value", "limit", "where")
        return {
            "machine": self.machine.name,
            "controller": self.verification.controller,
            "passed": self.passed,
            "verdict": self.verdict,
            "failed": [dict(zip(keys, row, strict=True)) for row in self.failed],
            "remarks": list(self.remarks),
            "not_judged": list(self.not_judged),
            "assumed": dict(self.machine.assumed),
            "sources": [dict(zip(("file", "sha256"), row, strict=True)) for row in self.sources],
        }


def review(
    machine: Machine | str,
    controller: Law | str | Path,
    *,
    axial: Law | str | Path | None = None,
    progress: Progress = lambda stage: None,
) -> Review:
    """The machine and its controller: check, verification, lateral analysis, and landing where the
    machine file states its limits.

    machine: a Machine, a path or a name; controller: a law or a file, also a table of coefficients;
    axial: the controller of the axis along the shaft. Raises InvalidInput.
    """
    from ambrose import api, registry
    from ambrose.chain.check import facts, sensors_across
    from ambrose.core.checks import AmbroseError
    from ambrose.judge.checks import moving_proofs
    from ambrose.judge.controller_file import made_for, read_controller
    from ambrose.law.law import law_of
    from ambrose.options import Verifying
    from ambrose.report.tables import unchecked

    described = api.machine_of(machine)
    other, law = "", controller
    if isinstance(controller, str | Path):
        read = read_controller(controller, described)
        other, law = made_for(read.provenance, described), law_of(read)
    law = api.controller_of(law, described)
    known = facts(described)
    result = api.verify(described, law, axial=axial, progress=progress)
    still = (p.unproved(described, Verifying()) for p in moving_proofs() if not result.moving)
    left, refused = [*unchecked(result), *filter(None, still)], list[str]()
    if other:
        left.append(f"The controller was made for {other}; it was judged on this one.")
    if described.groups.keys() > {described.group}:
        left.append("Lateral analysis and landing are of the radial axes.")

    def beside(name: str, *words: Any, **options: Any) -> Any:
        """A public function of another annex; None, and why, where it is not there or refuses."""
        place = registry.registered("public").get(name)
        why = "this installation has none"
        try:
            if place:
                return registry.resolve(f"{place}:{name}")(*words, progress=progress, **options)
        except AmbroseError as error:
            why = str(error)
        left.append(f"No {name} analysis: {why}.")
        refused.append(name)
        return None

    lateral = beside("lateral", described, law)
    left += [f"{item.title}: {item.note}" for item in getattr(lateral, "items", ()) if _open(item)]
    stated = [b for b in described.bearings if b.touchdown is not None and b.touchdown.limits]
    landing = beside("landing", described, law=law) if stated else None
    if not stated:
        left.append("Landing: the machine file has no [bearing.touchdown.limits].")
    doubts, remarks = (tuple(known[key]) for key in ("doubts", "remarks"))
    if result.passed:  # which is what these ask for
        answered = {*sensors_across(described)} if described.bearings else set()
        remarks += tuple(
            f"{doubt} (verify passes this controller)" for doubt in doubts if doubt in answered
        )
        doubts = tuple(doubt for doubt in doubts if doubt not in answered)
    not_judged = tuple(dict.fromkeys(left))
    return Review(described, result, lateral, landing, doubts, remarks, not_judged, tuple(refused))


def _open(item: Any) -> bool:
    """Whether a row of the lateral analysis has no verdict; landing is an analysis of its own."""
    return bool(item.left_out or item.unjudged) and item.name not in _LANDING


def review_page(result: Review, *, brand: Brand | None = None, date: str = "") -> Page:
    """The page of a Review. date: ISO, today if empty."""
    from ambrose.report.figures.rotor_drawing import machine_drawing
    from ambrose.report.page import Cell, Figure, Page, Row, Section, Table, Verdict
    from ambrose.report.tables import assumed_table, capitalised, loop_in_words

    failed: tuple[Row, ...] = tuple(
        (name, Cell(what, "fail"), value, limit, where)
        for name, what, value, limit, where in result.failed
    )
    sections = []
    if failed:
        columns = ("Analysis", "Requirement", "Value", "Limit", "Where")
        table = Table("", columns, failed, "", (9, 31, 10, 12, 38))
        sections.append(Section("What does not hold", "", (), (table,)))
    held = list[Table]()
    figures = [Figure("Rotor and its parts", machine_drawing(result.machine))]
    for name, page in pages_of(result, date=date):
        opening = page.opening.tables if page.opening else ()
        held += [replace(table, title=page.title, folded=False) for table in opening]
        drawn = [f for s in page.sections for f in s.figures if f.title.startswith(_FIGURES)]
        figures += [replace(figure, title=f"{name}: {figure.title}") for figure in drawn[:1]]
    sections.append(Section("What was judged", "", (), tuple(held)))
    chosen = assumed_table(result.machine)
    none = () if chosen else ("the machine file marks no number as assumed",)
    notes = capitalised((*none, *result.remarks), "\n\n")
    sections.append(Section("What was assumed", notes, (), chosen))
    rows: tuple[Row, ...] = tuple((text,) for text in result.not_judged)
    open_ends = Table("", ("Not judged, or to be known",), rows)
    sections.append(Section("What was not judged", "", (), (open_ends,) if rows else ()))
    sections.append(Section("Figures", "", tuple(figures)))
    verdicts = [
        replace(page.result, label=name)
        for name, page in pages_of(result, date=date)
        if page.result is not None
    ]
    sources = "; ".join(f"{name}, SHA-256 {digest}" for name, digest in result.sources)
    facts = (
        ("Controller", result.verification.controller),
        ("Loop", loop_in_words(result.verification.timing)),
        ("Files as they are", sources),
    )
    return Page(
        "Review",
        result.machine,
        tuple(sections),
        tuple(verdicts),
        facts,
        date,
        result=Verdict("Result", result.passed, result.verdict),
        brand=brand,
    )


def pages_of(result: Review, **options: Any) -> Iterator[tuple[str, Page]]:
    """The pages behind the review, by the command that gives each."""
    from ambrose.report.page import page_of

    yield "verify", page_of(result.verification, result.machine, **options)
    for name, item in (("lateral", result.lateral), ("landing", result.landing)):
        if item is not None:
            yield name, page_of(item, **options)


@click.command("review")
@click.argument("rotor")
@click.argument("controller", type=click.Path(path_type=Path))
@click.option("--axial", type=click.Path(path_type=Path), help="The controller of the thrust axis.")
@click.option("--speed", help='Of a rotor model: the highest, such as "9000 rpm".')
@click.option("--bearings", help='Of a rotor model: places of its magnets, "75 mm, 525 mm".')
@click.option(
    "--project",
    help="On every page, as the next three; defaults: review.toml in the user's folder.",
)
@click.option("--revision", help="Of the document.")
@click.option("--author", help="Who answers for it.")
@click.option("--logo", help="A picture (*.svg, *.png, *.jpg).")
@click.option("--docx", is_flag=True, help="The page to edit, too: review.docx, without figures.")
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), default=Path("review"), show_default=True
)
@AS_JSON
def review_command(
    rotor: str,
    controller: Path,
    axial: Path | None,
    speed: str | None,
    bearings: str | None,
    output: Path,
    docx: bool,
    as_json: bool,
    **words: str | None,
) -> None:
    """A rotor and a controller reviewed for a customer: one page to sign, and the pages behind it.

    ROTOR is a machine file, a rotor model of ROSS or a table of stations; CONTROLLER a controller
    file or a table of coefficients. Check, verification, lateral analysis, and landing where the
    file states limits go into the folder. Exit status 1: a requirement is not met.
    """
    from ambrose.chain.new_machine import is_machine, machine_file_of
    from ambrose.judge.controller_file import controller_text
    from ambrose.machine.ordinary_file import make_folder, set_aside, write_files
    from ambrose.report.page import brand_of, document, documents, render

    if docx:
        documents()
    brand = brand_of(Path(click.get_app_dir("ambrose")) / DEFAULTS, words)
    if not is_machine(rotor):
        make_folder(output)
    machine, left = machine_file_of(rotor, output / "machine.toml", speed, bearings)
    if machine != rotor:
        say(f"note: {rotor}: its machine file is {machine}; left out: {left}", err=True)
    description = load(machine, part=False)
    law = load_controller(controller, description)
    along = None if axial is None else load_controller(axial, description.axial)
    make_folder(output)
    claim(page=output / "review.html")
    with progress_shown(as_json) as progress:
        result = review(description, controller, axial=along, progress=progress)
        read = [*dict.fromkeys((Path(rotor), Path(machine))), controller]
        read += [] if axial is None else [axial]
        sources = [(p.name, sha256(p.read_bytes()).hexdigest()) for p in read if p.is_file()]
        result = replace(result, sources=tuple(sources))
        progress("writing the pages")
        if along is not None:
            law = replace(law, thrust=along)
        pages = {"review": review_page(result), **dict(pages_of(result))}
        files: dict[str, str | bytes] = {"controller.json": controller_text(law, description)}
        files |= {
            f"{name}.html": render(replace(page, brand=brand)) for name, page in pages.items()
        }
        if docx:
            page = replace(pages["review"], brand=brand)
            files["review.docx"] = document(page, "review.html")
        for name in sorted({"lateral.html", "landing.html"} - {*files}):  # of another review
            set_aside(output / name)
        write_files(output, files)
    if as_json:
        say_json(result.to_dict())
    else:
        say_verdict(f"{'PASSED' if result.passed else 'FAILED'}: {result.verdict}")
        if rows := result.failed:
            columns = ("analysis", "requirement", "value", "limit", "where")
            print_table("not met", columns, rows, ["red"] * len(rows))
        for sentence in result.not_judged:
            say(f"Not judged: {sentence}")
        behind = ", ".join(f"{name}.html" for name, _ in pages_of(result))
        say(f"Page to sign: {output / 'review.html'}; the pages behind it: {behind}.")
    sys.exit(0 if result.passed else 1)
