"""The rotor's drawing where many stations stand close together: a compressor with six stages."""

import itertools

import numpy as np

from ambrose.machine.file.toml import load_machine
from ambrose.report.figures.rotor_drawing import machine_drawing
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
