"""The machine's screen: what it shows, what an edit writes, what a wrong one leaves alone."""

import asyncio
import os
import re
import signal
import tomllib
from xml.etree import ElementTree

import pytest

pytest.importorskip("starlette", reason="no starlette: install the extra workbench")

from ambrose.annexes.workbench.blocks import Refusal
from ambrose.annexes.workbench.desk import Desk
from ambrose.annexes.workbench.project import Project, begin
from ambrose.annexes.workbench.screens import answer
from ambrose.annexes.workbench.screens.machine import _CELLS
from ambrose.annexes.workbench.svg import svg
from ambrose.core.checks import InvalidInput
from ambrose.machine.file.toml import bundled_machines, load_machine, loads_machine
from ambrose.machine.file.update import fields_of, rows_of, with_rows
from ambrose.machine.kinds import Quantity

SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture
def project(tmp_path):
    made = Project(tmp_path)
    begin(made, "two-disc-rotor")
    return made


def shown(project):
    told = answer(project, "machine", "", {"width": 800})
    return told, {block["key"]: block for block in told["blocks"]}


def save(project, stamp, **fields):
    given = {name.replace("__", "."): value for name, value in fields.items()}
    return answer(project, "machine", "save", {"stamp": stamp, "width": 800, **given})


def test_an_edit_writes_its_value_and_leaves_all_else(project):
    before = project.machine.read_text("utf-8")
    told, blocks = shown(project)
    fields = {f["name"]: f for f in blocks["table-bearing"]["fields"]}
    # the words of the file, also where it has a list
    document = tomllib.loads(before)
    assert fields["bearing.0.position"]["value"] == document["bearing"][0]["position"]
    again = save(project, told["stamp"], bearing__0__max_current="7.5 A")
    after = project.machine.read_text("utf-8")
    assert tomllib.loads(after)["bearing"][0]["max_current"] == "7.5 A"
    different = [a for a, b in zip(before.splitlines(), after.splitlines(), strict=True) if a != b]
    assert len(different) == 1
    assert again["stamp"] != told["stamp"]
    assert load_machine(project.machine).bearings[0].max_current == 7.5


def test_a_wrong_field_is_told_beside_it_and_the_last_machine_stays(project):
    before = project.machine.read_bytes()
    told, _ = shown(project)
    wrong = {"bearing__0__gap": "3 kg", "operation__speed_range": '["0 rpm", "x"]'}
    with pytest.raises(Refusal) as refused:
        save(project, told["stamp"], **wrong)
    beside = refused.value.content["fields"]
    assert beside["bearing.0.gap"].startswith('[[bearing]] left: gap is "3 kg", but must be')
    assert set(beside) == {"bearing.0.gap", "operation.speed_range"}
    # physics, found by another part of the reader
    with pytest.raises(Refusal) as refused:
        save(project, told["stamp"], bearing__0__max_current="-1 A")
    assert set(refused.value.content["fields"]) == {"bearing.0.max_current"}
    assert project.machine.read_bytes() == before


def test_of_two_edits_of_one_text_the_second_is_told(project):
    told, _ = shown(project)
    save(project, told["stamp"], bearing__0__max_current="7 A")
    first = project.machine.read_bytes()
    for action in ("save", "write"):
        with pytest.raises(Refusal, match="has changed since") as refused:
            given = {"stamp": told["stamp"], "text": "", "bearing.0.max_current": "8 A"}
            answer(project, "machine", action, given)
        assert refused.value.content["stale"]
    assert project.machine.read_bytes() == first


def grid(project):
    told, blocks = shown(project)
    return told["stamp"], blocks["grid"]["document"]


def keep(project, stamp, rows, action="rows"):
    return answer(project, "machine", action, {"stamp": stamp, "width": 800, "rows": rows})


@pytest.mark.parametrize("name", [*bundled_machines()])
def test_a_grid_gives_back_its_file_and_of_a_changed_cell_that_cell_alone(tmp_path, name):
    begin(Project(tmp_path), name)
    before = Project(tmp_path).machine.read_text("utf-8")
    rows = rows_of(before, _CELLS)
    assert with_rows(before, rows, _CELLS) == (before, {})
    rows["shaft"][0]["outer_diameter"] = f"{1.25 * float(rows['shaft'][0]['outer_diameter']):.6g}"
    after, faults = with_rows(before, rows, _CELLS)
    changed = [pair for pair in zip(before.splitlines(), after.splitlines(), strict=True)]
    assert [pair[0].split()[0] for pair in changed if pair[0] != pair[1]] == ["outer_diameter"]
    old, new = tomllib.loads(before), loads_machine(after, name)
    expected = 1.25 * Quantity("length").read(old["shaft"][0]["outer_diameter"])
    assert new.shaft[0].outer_diameter == pytest.approx(expected, rel=1e-5) and not faults


def test_a_grid_is_kept_by_the_screen_as_it_stands(project):
    before = project.machine.read_text("utf-8")
    stamp, rows = grid(project)
    assert rows == rows_of(before, _CELLS)
    keep(project, stamp, rows)
    assert project.machine.read_text("utf-8") == before
    rows["shaft"][0]["outer_diameter"] = "31.5"
    keep(project, stamp, rows)
    after = project.machine.read_text("utf-8")
    assert after == with_rows(before, rows, _CELLS)[0] != before


SHAFT = """
# from drawing 4711
[[shaft]]
length = "1 in"  # of the drawing
outer_diameter = 0.03
# the hub
[[shaft]]
start = "25.4 mm"
length = "1400 mm"
outer_diameter = "50 mm"
[[shaft]]
length = "100 mm"
outer_diameter = "30 mm"
"""


def test_rows_move_with_their_comments_and_units(project):
    text = project.machine.read_text("utf-8")
    head, _, rest = text.partition("[[shaft]]")
    tail = rest[rest.index("[[disc]]") :]
    project.machine.write_text(head + SHAFT.lstrip() + tail)
    stamp, rows = grid(project)
    one, hub, end = rows["shaft"]
    assert one == {"was": 0, "length": "25.4", "outer_diameter": "30"}
    one["length"] = "50.8"
    rows["shaft"] = [end, hub, {"was": None, "length": "10", "outer_diameter": "40"}, one]
    keep(project, stamp, rows)
    after = project.machine.read_text("utf-8")
    assert after.startswith(head) and after.endswith(tail)
    assert after[len(head) : -len(tail)] == (
        '# from drawing 4711\n[[shaft]]\nlength = "100 mm"\nouter_diameter = "30 mm"\n'
        '# the hub\n[[shaft]]\nstart = "100 mm"\nlength = "1400 mm"\nouter_diameter = "50 mm"\n'
        '[[shaft]]\nlength = "10 mm"\nouter_diameter = "40 mm"\n'
        '[[shaft]]\nlength = "2 in"  # of the drawing\nouter_diameter = 0.03\n'
    )


def test_what_is_wrong_in_a_cell_is_told_at_it_and_nothing_is_written(project):
    before = project.machine.read_bytes()
    stamp, rows = grid(project)
    wrong = {
        "length": ("8,5", "decimal mark is a comma"),
        "outer_diameter": ("-8", "must be positive"),
        "inner_diameter": ("500", "outer"),
        "mass_diameter": ("thick", "must be a length"),
        "elements": ("2.5", "whole number"),
        "material": ("cheese", "cheese"),
    }
    rows["shaft"].insert(0, {"was": None})  # an empty one is none, and moves no other
    for key, (cell, told) in wrong.items():
        for action in ("look", "rows"):
            edited = {**rows, "shaft": [dict(row) for row in rows["shaft"]]}
            edited["shaft"][2][key] = cell
            with pytest.raises(Refusal) as refused:
                keep(project, stamp, edited, action)
            assert told in refused.value.content["fields"][f"shaft.2.{key}"], key
    rows["disc"].append({"was": None, "position": "100", "mass": "1"})
    with pytest.raises(Refusal) as refused:
        keep(project, stamp, rows)
    assert [*refused.value.content["fields"]] == [f"disc.{len(rows['disc']) - 1}.name"]
    assert project.machine.read_bytes() == before
    for junk in (None, [], {"shaft": 3}, {"shaft": [[]], "disc": []}, {"shaft": [], "disc": []}):
        with pytest.raises((Refusal, InvalidInput)):
            keep(project, stamp, junk)
    assert project.machine.read_bytes() == before


def test_a_foreign_table_of_stations_is_pasted_with_its_names(project):
    """Inches and pounds, with its discs; what it does not have stays."""
    before = load_machine(project.machine)
    table = "station\tlength\tod left\tbore\tadded mass\tIp\tIt\n\tin\tin\tin\tlbm\tlbm in^2\t"
    table += "lbm in^2\n1\t20\t1\t0\t\t\t\n2\t20\t2\t0.5\t4\t10\t6\n3\t20\t1\t0\t\t\t\n"
    told = answer(project, "machine", "stations", {"table": table, "width": 800})
    rows = told["blocks"][0]["document"]
    assert [row["length"] for row in rows["shaft"]] == ["508", "508", "508"]
    keep(project, shown(project)[0]["stamp"], rows)
    after = load_machine(project.machine)
    assert [s.inner_diameter for s in after.shaft] == [0, 0.0127, 0]
    (disc,) = after.discs
    assert (disc.position, disc.mass) == pytest.approx((0.508, 1.81436948))
    assert disc.polar_inertia == pytest.approx(10 * 0.45359237 * 0.0254**2)
    assert after.bearings == before.bearings and after.sensors == before.sensors
    with pytest.raises(InvalidInput, match="must be a number"):
        answer(project, "machine", "stations", {"table": table.replace("0.5", "none")})


def test_a_measured_rotor_has_no_grid_and_says_what_to_do(project):
    text = re.sub(r"(?m)^speed = .*", "speed = 0", project.machine.read_text("utf-8"))
    text = re.sub(r"(?m)^speed_range = .*", "speed_range = [0, 0]", text)
    machine = load_machine(project.machine)
    places = f"[0.0, {machine.length / 2}, {machine.length}]"
    measured = f"\n[measured_rotor]\nmass = 10.0\nplaces = {places}\n"
    mode = "\n[[bending_mode]]\nnumber = 1\nfrequency = 500.0\nshape = [1.0, -1.0, 1.0]\n"
    project.machine.write_text(text + measured + mode)
    _, blocks = shown(project)
    assert "take it out of the file" in blocks["grid"]["text"]
    assert "table-shaft" in blocks


def test_the_whole_text_is_written_only_as_a_machine(project):
    told, blocks = shown(project)
    text = blocks["text"]["fields"][0]["value"]
    assert text == project.machine.read_text("utf-8")
    with pytest.raises(Refusal, match="not valid TOML"):
        given = {"stamp": told["stamp"], "text": text + "\n[broken"}
        answer(project, "machine", "write", given)
    new = text.replace("[machine]", "# looked at\n[machine]", 1)
    answer(project, "machine", "write", {"stamp": told["stamp"], "text": new})
    assert project.machine.read_text("utf-8") == new


def test_a_broken_file_is_shown_with_its_reason(project):
    project.machine.write_text("[machine]\nschema = 1\n")
    _, blocks = shown(project)
    assert "missing" in blocks["problem"]["text"]
    assert blocks["text"]["fields"][0]["value"] == "[machine]\nschema = 1\n"


@pytest.mark.parametrize("name", [*bundled_machines()])
def test_every_value_of_a_file_has_a_field(name):
    text = bundled_machines()[name].read_text("utf-8")

    def leaves(value, place=""):
        if isinstance(value, dict):
            for key, below in value.items():
                if key != "assumed":
                    yield from leaves(below, f"{place}.{key}" if place else key)
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            for i, below in enumerate(value):
                yield from leaves(below, f"{place}.{i}")
        else:
            yield place

    assert set(fields_of(text)) == set(leaves(tomllib.loads(text)))


def test_a_picture_stands_where_its_numbers_say():
    go = pytest.importorskip("plotly.graph_objects")
    figure = go.Figure()
    figure.add_scatter(x=[0, 5, 10], y=[1, 10, 100], mode="lines", name="<b>a</b> &lt;i&gt;")
    margin = {"l": 50, "r": 50, "t": 20, "b": 30}
    figure.update_layout(height=250, margin=margin, meta={"room": 8}, showlegend=False)
    figure.update_xaxes(range=[0, 10])
    figure.update_yaxes(type="log", range=[0, 2])
    figure.add_annotation(x=5, y=1, text="<script>alert(1)</script>&lt;b&gt;", showarrow=False)
    text = svg(figure, 600, "a < b", "k")
    root = ElementTree.fromstring(text)
    paths = [path.get("d") for path in root.iter(f"{SVG}g") for path in path]
    # 500 px wide from 50, 200 px high from 10: the decades lie at its lower end, middle and top
    assert paths == ["M50.0 210.0L300.0 110.0L550.0 10.0"]
    assert root.get("aria-label") == "a < b"
    words = [item.text for item in root.iter(f"{SVG}text")]
    assert "alert(1)<b>" in words
    assert not list(root.iter(f"{SVG}script"))


def test_names_never_become_markup(project):
    text = project.machine.read_text("utf-8")
    hostile = "</svg><script>alert(1)</script>"
    document = tomllib.loads(text)
    given = document["machine"]["description"]
    assert given in text
    project.machine.write_text(text.replace(given, hostile))
    _, blocks = shown(project)
    drawing = ElementTree.fromstring(blocks["drawing"]["svg"])
    assert not list(drawing.iter(f"{SVG}script"))
    assert blocks["drawing"]["caption"] == hostile


def test_a_machine_is_made_or_taken_from_a_file(tmp_path):
    empty = Project(tmp_path)
    _, blocks = shown(empty)
    assert {"begin", "template", "import"} <= set(blocks)
    shaft = {"length": "600 mm", "diameter": "4 kg", "speed": "9000 rpm"}
    with pytest.raises(Refusal) as refused:
        answer(empty, "machine", "template", shaft)
    assert set(refused.value.content["fields"]) == {"diameter"}
    answer(empty, "machine", "template", {**shaft, "diameter": "40 mm"})
    machine = load_machine(empty.machine)
    assert machine.length == pytest.approx(0.6)
    first = empty.machine.read_text("utf-8")
    # a table of stations, in the words of the docs
    table = "length [mm],diameter [mm]\n200,30\n300,50\n200,30\n"
    empty.path("machines", "rotor.csv").write_text(table)
    told = answer(empty, "machine", "take", {"source": "rotor.csv", "speed": "6000 rpm"})
    assert "machines/before.toml" in told["told"]
    assert empty.path("machines", "before.toml").read_text("utf-8") == first
    assert load_machine(empty.machine).length == pytest.approx(0.7)
    # and back again; what is no machine changes nothing
    answer(empty, "machine", "take", {"source": "before.toml"})
    assert empty.machine.read_text("utf-8") == first
    empty.path("machines", "wrong.toml").write_text("[machine]\nschema = 1\n")
    for wrong in ("wrong.toml", "absent.toml", "../machine.toml", None):
        with pytest.raises((Refusal, InvalidInput)):
            answer(empty, "machine", "take", {"source": wrong})
    assert empty.machine.read_text("utf-8") == first


@pytest.mark.parametrize("screen, action", [("nothing", ""), ("machine", "rm"), ("live", "")])
def test_what_is_no_screen_is_refused(project, screen, action):
    with pytest.raises(InvalidInput, match="reload the page"):
        answer(project, screen, action, {})


def test_the_desk_answers_refuses_and_begins_anew(project, monkeypatch):
    async def run():
        desk = Desk(project)
        with pytest.raises(Refusal, match="there is no screen"):
            await desk.ask("nothing", "", {})
        first = desk.process.pid
        # it is alive when it is asked, and dies over the question
        os.kill(first, signal.SIGSTOP)
        sent = asyncio.Event()
        loop, send = asyncio.get_running_loop(), desk.process._pipe.send

        def told(question):
            send(question)
            loop.call_soon_threadsafe(sent.set)

        monkeypatch.setattr(desk.process._pipe, "send", told)
        asked = asyncio.create_task(desk.ask("nothing", "", {}))
        await sent.wait()
        os.kill(first, signal.SIGKILL)
        with pytest.raises(Refusal, match="ended suddenly"):
            await asked
        with pytest.raises(Refusal, match="there is no screen"):
            await desk.ask("nothing", "", {})
        assert desk.process.pid != first
        desk.process.longest = 0.0
        with pytest.raises(Refusal, match="longer than 0 s"):
            await desk.ask("machine", "", {})
        assert desk.process.pid is None

    asyncio.run(run())


def test_a_folder_with_a_slip_of_the_pen_is_not_made(tmp_path, monkeypatch):
    from click.testing import CliRunner

    from ambrose.annexes.workbench.command import workbench

    monkeypatch.chdir(tmp_path)
    told = CliRunner().invoke(workbench, ["nosuchdir", "--no-browser"])
    assert isinstance(told.exception, InvalidInput)
    assert "--new" in str(told.exception)
    assert not (tmp_path / "nosuchdir").exists()
    more = ["nosuchdir", "--new", "--no-browser", "--listen", "0.0.0.0"]
    assert "every network" in str(CliRunner().invoke(workbench, more).exception)
    assert (tmp_path / "nosuchdir").is_dir()
