"""The rotor's drawing where many stations stand close together: a compressor with six stages."""

import itertools
from dataclasses import replace

import numpy as np

from ambrose.machine.attachment import attached, attachments
from ambrose.machine.file.toml import load_machine
from ambrose.model.effects.stations import Probe
from ambrose.report.figures.rotor_drawing import equivalent_cylinder, machine_drawing
from ambrose.report.page import least_width

LETTER, LINE = 6.2, 13.0  # [px] of a name, at least


def test_names_do_not_overprint_at_the_least_width_that_the_page_gives_the_figure():
    figure = machine_drawing(load_machine("process-compressor"))
    margin, low, high = figure.layout.margin, *figure.layout.xaxis.range
    pixel = (high - low) / (least_width(figure) - margin.l - margin.r)  # [mm], both directions
    names = [note for note in figure.layout.annotations if note.yref in {None, "y"}]
    assert len(names) > 20
    for a, b in itertools.combinations(names, 2):
        beside = abs(a.x - b.x) >= LETTER / 2 * (len(a.text) + len(b.text)) * pixel
        # heights are those of a page wider than this one, where lines are further apart
        assert beside or abs(a.y - b.y) >= LINE * (high - low) / 800, (a.text, b.text)
    assert all(note.bgcolor == "white" for note in names)


def test_neighbouring_seals_stay_apart():
    machine = load_machine("process-compressor")
    combs = sorted(
        (float(np.min(trace.x)), float(np.max(trace.x)))
        for trace in machine_drawing(machine).data
        if len(trace.x) == 17 and np.min(trace.y) > 0
    )
    assert len(combs) == len(machine.seals)
    assert all(left < right for (_, left), (right, _) in itertools.pairwise(combs))


def test_only_what_carries_the_shaft_is_drawn_as_a_spring_to_the_ground():
    """Clearances, stages, probes and loads were springs to ground: a reviewer read supports."""
    machine = load_machine("process-compressor")
    effects = dict(attachments())
    assert {name for name, item in effects.items() if item.symbol != "spring"} >= {
        "clearance",
        "stage",
        "probe",
        "load",
        "thrust_bearing",
    }
    assert effects["journal_bearing"].symbol == "spring"

    def springs(drawn):
        """Zigzags of nine points, below the rotor."""
        lines = (t for t in machine_drawing(drawn).data if t.fill is None and len(t.x) == 9)
        return [line for line in lines if np.max(line.y) < 0]

    assert {item.table for item, _ in attached(machine)} & {"clearance", "stage", "load"}
    carried = sum(item.symbol == "spring" for item, _ in attached(machine))
    assert len(springs(machine)) == carried
    # a probe is the outline of a sensor, on the surface of the disc that it looks at
    disc = next(item for item in machine.discs if equivalent_cylinder(item))
    probe = Probe("P1", disc.position)
    seen = replace(machine, effects=(*machine.effects, probe))
    (outline,) = [
        t
        for t in machine_drawing(seen).data
        if len(t.x) == 6 and t.fill is None and np.max(t.y) < 0 and t.x[0] == 1e3 * disc.position
    ]
    assert -np.max(outline.y) > 1e3 * equivalent_cylinder(disc)[0]
