"""`ambrose review`: one page of everything that was judged, with its author on every sheet."""

import json
import re
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from click.testing import CliRunner

import ambrose as amb
from ambrose.annexes.dossier.review import review_page
from ambrose.cli import main
from ambrose.machine.file.update import save_machine
from ambrose.report.page import Brand, brand_of, render
from coarse import coarse_text

RIG = "turbomolecular-pump"


def call(*words):
    return CliRunner().invoke(main, [str(word) for word in words])


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A machine of few elements without seals' tolerances, its PID, and what `review` leaves."""
    folder = tmp_path_factory.mktemp("review")
    (folder / "rotor.toml").write_text(coarse_text(RIG), encoding="utf-8")
    machine = replace(amb.load_machine(folder / "rotor.toml"), tolerances=())
    save_machine(machine, folder / "rotor.toml")
    amb.write_controller(folder / "pid.json", amb.design(machine, "pid"))
    (folder / "logo.svg").write_text('<svg xmlns="http://www.w3.org/2000/svg"/>')
    words = ("--project", "Compressor <7>", "--revision", "B", "--author", "J. Doe")
    words += ("--logo", folder / "logo.svg", "-o", folder / "out", "--docx", "--json")
    done = call("review", folder / "rotor.toml", folder / "pid.json", *words)
    assert done.exit_code in (0, 1), done.output
    return folder, done


def test_it_says_what_the_commands_behind_it_say(place):
    folder, done = place
    told = json.loads(done.stdout)
    verified = json.loads(
        call("verify", folder / "rotor.toml", "--controller", folder / "pid.json", "--json").stdout
    )
    lateral = call("lateral", folder / "rotor.toml", "--controller", folder / "pid.json", "--json")
    failed = [item for item in json.loads(lateral.stdout)["items"] if item["passed"] is False]
    checked = json.loads(call("check", folder / "rotor.toml", "--json").stdout)
    by = [row["analysis"] for row in told["failed"]]
    assert by.count("lateral") == len(failed) and by.count("check") == len(checked["doubts"])
    assert ("verify" in by) == (not verified["passed"])
    assert told["passed"] == (done.exit_code == 0) == (not by)
    assert any("no [bearing.touchdown.limits]" in text for text in told["not_judged"])
    names = [source["file"] for source in told["sources"]]
    assert names == ["rotor.toml", "pid.json"]


def test_every_page_carries_project_revision_author_and_logo(place):
    folder, _ = place
    for name in ("review", "verify", "lateral"):
        text = (folder / "out" / f"{name}.html").read_text(encoding="utf-8")
        assert "Compressor &lt;7&gt;, revision B, J. Doe" in text  # the head, escaped
        assert "@top-left" in text and "data:image/svg+xml;base64," in text
        assert "Compressor <7>" not in text
    again = amb.read_controller(folder / "out" / "controller.json")
    assert again.controller.inputs == amb.read_controller(folder / "pid.json").controller.inputs


def test_what_fails_and_what_was_not_judged_stand_on_the_page(place):
    folder, _ = place
    machine = amb.load_machine(folder / "rotor.toml")
    strict = replace(
        machine, requirements=replace(machine.requirements, sensitivity_peak=1.05), assumed=()
    )
    result = amb.review(strict, folder / "pid.json")
    assert not result.passed and "Not to be released: " in result.verdict
    page = review_page(result, brand=Brand("P"))
    titles = [section.title for section in page.sections]
    assert titles[0] == "What does not hold" and "What was not judged" in titles
    (rows,) = (section.tables[0].rows for section in page.sections if section.title == titles[0])
    assert len(rows) == len(result.failed) > 0
    text = re.sub(r"\s+", " ", render(page))
    assert result.verdict.split(";")[0] in text


def test_the_page_is_a_document_to_edit(place, monkeypatch):
    """Read back by python-docx: verdict, every table with every cell, figures by name, who signs."""
    docx = pytest.importorskip("docx")
    folder, done = place
    told = json.loads(done.stdout)
    paper = docx.Document(str(folder / "out" / "review.docx"))
    grids = [
        [[cell.text.replace("\N{NO-BREAK SPACE}", " ") for cell in row.cells] for row in table.rows]
        for table in paper.tables
    ]
    assert grids[0][1] == ["Result", f"{'✓' if told['passed'] else '✗'} {told['verdict']}"]
    assert [row[0] for row in grids[-1][1:]] == ["Prepared", "Checked", "Released"]
    rows = [row for grid in grids for row in grid]
    for item in told["failed"]:
        assert any(item["where"] in row and f"✗ {item['requirement']}" in row for row in rows)
    for sentence in told["not_judged"]:
        assert [sentence] in rows
    words = [paragraph.text for paragraph in paper.paragraphs]
    assert any(text.startswith("Figure 1. Rotor and its parts: see review.html") for text in words)
    assert "Compressor <7>, revision B, J. Doe" in paper.sections[0].header.paragraphs[0].text
    monkeypatch.setitem(sys.modules, "docx", None)
    refused = call("review", folder / "rotor.toml", folder / "pid.json", "--docx")
    assert refused.exit_code == 2 and "pip install python-docx" in refused.output


def test_the_users_file_has_the_defaults_and_is_refused_where_it_is_wrong(
    place, tmp_path, monkeypatch
):
    folder, _ = place
    monkeypatch.setattr("click.get_app_dir", lambda name: str(tmp_path))
    file, empty = tmp_path / "review.toml", dict.fromkeys(("project", "revision", "author", "logo"))
    assert brand_of(file, empty) == Brand()
    (tmp_path / "logo.svg").write_text("<svg/>")
    file.write_text('author = "A. Noether"\nlogo = "logo.svg"\n')
    stated = brand_of(file, {**empty, "project": "P"})
    assert stated.line == "P, A. Noether" and stated.logo.startswith("data:image/svg+xml;base64,")
    assert brand_of(file, {**empty, "author": "B"}).author == "B"
    (tmp_path / "review.toml").write_text("colour = 3\n")
    words = (folder / "rotor.toml", folder / "pid.json", "-o", tmp_path / "out")
    done = call("review", *words)
    assert done.exit_code == 2 and "holds 'colour'" in done.stderr
    (tmp_path / "review.toml").unlink()
    done = call("review", *words, "--logo", tmp_path / "logo.gif")
    assert done.exit_code == 2 and "the logo is" in done.stderr


def test_a_rotor_model_is_converted_into_the_folder(place, tmp_path):
    folder, _ = place
    table = "length [mm], outer diameter [mm]\n300, 40\n300, 40\n"
    (tmp_path / "rotor.csv").write_text(table)
    words = ("review", tmp_path / "rotor.csv", folder / "pid.json", "-o", tmp_path / "out")
    done = call(*words, "--speed", "9000 rpm")
    assert done.exit_code == 2 and "the list of the controller's inputs" in done.stderr
    assert "its machine file is" in done.stderr
    assert amb.load_machine(tmp_path / "out" / "machine.toml").operation.speed_range[1] > 900


def test_an_analysis_that_is_refused_does_not_pass(place, monkeypatch):
    """A lateral analysis that could not be made left a green page with a sentence below."""
    from ambrose.annexes.dossier import review as module
    from ambrose.core.checks import InvalidInput

    folder, _ = place

    def refuse(*words, **options):
        raise InvalidInput("no lateral analysis of this; take another")

    monkeypatch.setattr("ambrose.registry.resolve", lambda name: refuse)
    result = module.review(amb.load_machine(folder / "rotor.toml"), folder / "pid.json")
    green = replace(result, doubts=(), verification=SimpleNamespace(passed=True))
    assert result.refused == ("lateral",) and not green.passed
    assert "no lateral analysis" in result.verdict
    assert any("take another" in text for text in result.not_judged)
    assert not replace(green, refused=("landing",)).passed and replace(green, refused=()).passed


def test_what_verify_leaves_open_stands_in_the_review(place):
    """A changing seal pressure was told by verify alone, another machine's controller on standard
    error alone.
    """
    folder, _ = place
    machine = amb.load_machine(folder / "rotor.toml")
    other = replace(machine, name="other")
    result = amb.review(other, folder / "pid.json")
    assert any(f"made for another machine, {machine.name}" in text for text in result.not_judged)
    assert "made for" not in "".join(amb.review(machine, folder / "pid.json").not_judged)
    rig = replace(amb.load_machine("seal-rig"), tolerances=())
    result = amb.review(rig, amb.design(rig, "pid"))
    assert any("changing seal pressure" in text for text in result.not_judged)


def test_a_review_is_all_of_one_run(place, tmp_path):
    """A landing of an earlier review stayed beside it; a refused controller left a folder; the
    machine file of a rotor model was written over with what its user had changed.
    """
    folder, _ = place
    out = tmp_path / "out"
    refused = call("review", folder / "rotor.toml", tmp_path / "none.json", "-o", out)
    assert refused.exit_code == 2 and not out.exists()
    out.mkdir()
    (out / "landing.html").write_text("of another machine")
    done = call("review", folder / "rotor.toml", folder / "pid.json", "-o", out)
    assert done.exit_code in {0, 1} and not (out / "landing.html").exists()
    assert (out / "earlier-landing.html").exists() and (out / "review.html").exists()
    (tmp_path / "rotor.csv").write_text("length [mm], outer diameter [mm]\n300, 40\n300, 40\n")
    words = ("review", tmp_path / "rotor.csv", folder / "pid.json", "-o", tmp_path / "new")
    call(*words, "--speed", "9000 rpm")
    file = tmp_path / "new" / "machine.toml"
    text = file.read_text(encoding="utf-8")
    assert "list of the controller's inputs" in call(*words, "--speed", "9000 rpm").stderr
    file.write_text(text.replace("name =", "# mine\nname =", 1), encoding="utf-8")
    again = call(*words, "--speed", "9000 rpm")
    assert again.exit_code == 2 and "take that file in place of" in again.stderr
    assert "# mine" in file.read_text(encoding="utf-8")


def test_the_table_of_the_page_holds_its_machine(tmp_path):
    """It stated neither its sign nor its unit, so that all commands but convert found it
    unstable.
    """
    page = Path(__file__).parents[2] / "docs" / "how-to" / "own-controller.md"
    table = re.search(r"```csv title=\"vendor.csv\"\n(.*?)```", page.read_text("utf-8"), re.DOTALL)
    (tmp_path / "vendor.csv").write_text(table[1])
    verdict = amb.verify(RIG, tmp_path / "vendor.csv", points="rest", tolerances=False)
    assert verdict.stable


def test_a_sensor_across_a_node_is_answered_by_a_verdict_that_passes(place, monkeypatch):
    """What `check` doubts of a place, a controller that passes there answers: it is a remark."""
    folder, _ = place
    monkeypatch.setattr("ambrose.chain.check.seen_modes", lambda m, n: [("A", 1, 900.0, 0.8, -0.5)])
    found = amb.review(folder / "rotor.toml", folder / "pid.json")
    across = [one for one in found.doubts + found.remarks if "across a node" in one]
    assert len(across) == 1 and found.verification.passed == (across[0] in found.remarks)
    assert across[0].endswith("(verify passes this controller)") == found.verification.passed
