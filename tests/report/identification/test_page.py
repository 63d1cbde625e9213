"""The page of an identification: what stands on it, that its figures carry the numbers, and what it
does without u or seals.
"""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks import waveforms

from ambrose import load_machine
from ambrose.core.response import simulate
from ambrose.core.sampling import c2d
from ambrose.core.statespace import select
from ambrose.identification import youla
from ambrose.identification.findings import Code, Finding
from ambrose.identification.pipeline import Provenance, identify
from ambrose.identification.seal.by_pressure import SealByPressure, SealFit, line
from ambrose.identification.validation.plausibility import compare
from ambrose.judge.result import pid_synthesis
from ambrose.law.loop import closed_loop, match_controller
from ambrose.machine.parameters import TIMING, quantities
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import free_mode_reduction
from ambrose.record.record import Record
from ambrose.report.identification import (
    change_figure,
    correlation_figure,
    frf_figure,
    identification_page,
    parameters_table,
    residual_tests_figure,
    short,
    telling_records,
)
from ambrose.report.page import render, write
from ambrose.report.theme import fixed
from first_screen import WIDTHS, measure
from needs import needs

DT = 1e-4
AXES = ("A_zeta", "A_eta", "B_zeta", "B_eta")
FIVE = ("bearing.*.force_per_current.*", "seal.center.k")


def names(kinds):
    return [f"{kind}_{axis}" for kind in kinds for axis in AXES]


@pytest.fixture(scope="module")
def done():
    machine = load_machine("seal-rig")
    plant = free_mode_reduction(assemble(machine), 1)
    controller = pid_synthesis(plant).controller
    loop = select(
        closed_loop(plant, c2d(match_controller(controller, plant), DT, "tustin", delay=DT)),
        names("ed"),
        names("yu"),
    )
    e = np.stack([0.1 * waveforms.prbs(9, 10, 8000, shift=127 * i) for i in range(4)])
    noise = 2e-8 * np.random.default_rng(0).standard_normal((4, 8000))
    values = np.vstack([simulate(loop, np.vstack([e, noise])), e])
    record = Record(
        machine.name, 1 / DT, tuple(names("yue")), ("m",) * 4 + ("A",) * 8, values, plant.point
    )
    start = {
        f"bearing.{b}.force_per_current.{a}": 1.05 * v
        for b, pair in (
            ("A", machine.bearings[0].force_per_current),
            ("B", machine.bearings[1].force_per_current),
        )
        for a, v in zip(("zeta", "eta"), pair, strict=True)
    }
    source = Provenance(("run.h5",), "pid.json")
    return machine, identify(
        machine, [record], controller, unknown=FIVE, start=start, provenance=source, bending_modes=1
    )


def test_the_page_carries_verdict_parameters_and_pictures(done):
    _, checked = done
    report = identification_page(checked, date="2026-11-21")
    assert [section.title for section in report.sections] == [
        "Parameters",
        "Measured over model",
        "Can it be believed?",
    ]
    assert (
        report.result.passed
        and "parameters identified, standard deviation at most" in report.result.text
    )
    titles = [figure.title for section in report.sections for figure in section.figures]
    assert titles == [
        "Change from the start",
        "Time",
        "Residual over the record",
        "Frequency response of the plant",
        "Residual tests",
        "Correlation and column cosine",
    ]
    page = render(report)
    assert (
        "run.h5 (0.8 s at 10" in page
        and "bearing.A.force_per_current.zeta" in page
        and "pid.json" in page
    )
    assert "src=" not in page.replace("src=\\", "")[:20000] and "computing delay 1 sample<" in page


@needs("browser")
@pytest.mark.parametrize("width", WIDTHS)
def test_the_first_screen_of_an_identification(done, width, browser, tmp_path):
    seen = measure(
        browser, write(identification_page(done[1]), tmp_path / "identification.html"), width
    )
    assert seen.verdict < seen.decides <= WIDTHS[width] and seen.words <= 1500 and not seen.wider


def test_doubts_come_first(done):
    _, checked = done
    finding = Finding(Code.CLIPPED, "warning", "u_A_zeta is clipped", "12 samples", "measure again")
    bad = replace(
        checked.result,
        warnings=(
            Finding(
                Code.HARDLY_VISIBLE, "warning", "x = 1 is hardly visible", remedy="excite more"
            ),
        ),
    )
    report = identification_page(replace(checked, checks=(finding,), result=bad))
    assert report.sections[0].title == "What makes this doubtful"
    rows = report.sections[0].tables[0].cells
    assert (
        rows[0][1].text == "12 samples"
        and rows[1][0].text == "x = 1 is hardly visible"
        and "excite" in rows[1][2].text
    )
    assert not report.result.passed and report.result.text.startswith(
        "Doubtful: u_A\u00a0ζ is clipped: 12 samples; measure again (1 more"
    )


def test_figures_carry_the_numbers(done):
    machine, checked = done
    result = checked.result
    change = change_figure(result)
    np.testing.assert_allclose(change.data[0].x, 100 * (result.values / result.start - 1))
    np.testing.assert_allclose(
        change.data[0].error_x.array, 196 * result.standard_deviations / result.start
    )
    maps = correlation_figure(result).data
    np.testing.assert_allclose(maps[0].z, result.correlation)
    np.testing.assert_allclose(maps[1].z, result.column_cosine)
    ratio = np.array(residual_tests_figure(result).data[0].z)
    assert ratio.shape == (4, 4) and ratio.max() < 1
    figure, words = frf_figure(machine, checked)
    assert "agrees within 10 % and 10°" in words
    model = next(trace for trace in figure.data if trace.name == "identified" and trace.showlegend)
    k_i, k_s = machine.bearings[0].force_per_current[0], machine.bearings[0].negative_stiffness[0]
    # of the order of K_i/K_s at low frequency, in um/A
    assert 0.3 < model.y[0] / (1e6 * k_i / k_s) < 3


def test_without_controller_outputs_there_is_no_plant_response(done):
    machine, checked = done
    piece = checked.outputs[0]
    seen = piece.record.select([name for name in piece.record.signals if name[0] != "u"])
    less = replace(checked, outputs=(replace(piece, record=seen),))
    assert frf_figure(machine, less) is None
    report = identification_page(less)
    assert "Frequency response" not in " ".join(
        figure.title for section in report.sections for figure in section.figures
    )


def test_of_several_records_the_first_and_the_worst_are_shown(done):
    _, checked = done
    piece = checked.outputs[0]
    worse = replace(piece, model=piece.model + 1e-6)
    assert [number for number, _ in telling_records([piece, piece, worse])] == [1, 3]
    assert [number for number, _ in telling_records([piece])] == [1]


def test_names_and_digits(done):
    _, checked = done
    assert short("bearing.A.force_per_current.zeta") == "Kᵢ A ζ"
    assert short("seal.center.k_yx") == "seal center k_yx"
    assert short("coupling.coupling.stiffness.eta") == "coupling k η"
    assert short("amplifier.natural_frequency") == "amplifier ω₀"
    assert short("rotor.bending_1.frequency") == "bending 1 ω"
    assert short("rotor.bending_2.damping") == "bending 2 D"
    assert short("journal_bearing.de.K_xy") == "journal bearing de K_xy"
    assert short("stage.first.cross_coupling") == "stage first cross coupling"
    assert (
        fixed(142.0644, 0.287) == "142.06"
        and fixed(1.5, 0.4) == "1.5"
        and fixed(0.02034, 0.053) == "0.02"
    )
    assert fixed(0.0, 1.0) == "0" and fixed(5.0, float("nan")) == "5"
    table = parameters_table(checked.result)
    assert table.cells[0][1].text.endswith("N/A") and "…" in table.cells[0][3].text


def test_every_kind_of_unknown_has_a_label_of_its_own():
    """Whatever can be named can be drawn, and no two are called the same."""
    paths = [*TIMING]
    for table, known in quantities().items():
        owner = {"amplifier": table, "rotor": "rotor.bending_1"}.get(table, f"{table}.one")
        for quantity, (_, components) in known.items():
            mark = "_" if table == "seal" else "."
            names = (quantity, *(f"{quantity}{mark}{component}" for component in components))
            paths += [f"{owner}.{name}" for name in names]
    assert len({short(path) for path in paths}) == len(paths)


def seal_fit(pressures):
    n = len(pressures)
    values = np.outer(pressures, [2.0, 15.0, 0.01, -0.01]) + np.array([1e4, 0, 500, 0])
    values[1:-1] *= 1.01
    unknown = np.full((n, 8), np.nan)
    alone = np.tile(np.eye(4), (n, 1, 1))
    return SealFit(
        "seal-rig",
        "center",
        np.array(pressures),
        unknown[:, 0],
        values,
        0.01 * np.abs(values) + 1.0,
        unknown,
        unknown,
        alone,
        alone,
        np.zeros((n, 4)),
        "test",
    )


def by_pressure(fit):
    return SealByPressure(fit, "line", 0.0)


def test_seal_coefficients_over_pressure(done):
    _, checked = done
    fit = seal_fit([0.5e5, 1e5, 2e5, 3e5])
    report = identification_page(replace(checked, seal=by_pressure(fit)))
    section = next(section for section in report.sections if section.title == "Seal")
    picture = section.figures[0].picture
    points = [trace for trace in picture.data if trace.mode == "markers"]
    assert len(points) == 4
    np.testing.assert_allclose(points[1].x, [0.5, 1, 2, 3])  # bar
    assert sum(trace.fill == "toself" for trace in picture.data) == 8  # two bands each
    # too few for a line
    two = identification_page(replace(checked, seal=by_pressure(seal_fit([1e5, 2e5]))))
    section = next(section for section in two.sections if section.title == "Seal")
    assert not any(trace.fill == "toself" for trace in section.figures[0].picture.data)


def test_seal_tables_beside_their_figure_and_warnings_among_the_doubts(done):
    _, checked = done
    fit = replace(
        seal_fit([0.5e5, 1e5, 2e5, 3e5]),
        warnings=(
            Finding(Code.NOT_CONVERGED, "warning", "at 50000 Pa: not converged after 50 steps"),
        ),
    )
    report = identification_page(replace(checked, seal=by_pressure(fit)))
    tables = next(section for section in report.sections if section.title == "Seal").tables
    assert [table.title for table in tables] == [
        "Seal center by pressure",
        "Seal center: lines over pressure",
    ]
    value, half = fit.values[2, 1] / 1e3, 1.96 * fit.deviations[2, 1] / 1e3
    assert tables[0].cells[2][2].text == f"{fixed(value, half)} ± {half:.2g} kN/m"
    one = line(fit, "k")
    slope = float(tables[1].cells[1][2].text.split(" ± ")[0].replace("\u202f", "").replace(" ", ""))
    assert slope == pytest.approx(one.slope * 1e5 / 1e3, rel=0.01)
    assert report.sections[0].title == "What makes this doubtful"
    assert "50000 Pa" in report.sections[0].tables[0].cells[0][0].text
    verdict = next(one for one in report.verdicts if one.label == "Seal")
    assert (
        verdict.passed is False
        and "4 pressures up to 3\u00a0bar, 1 warning;" in verdict.text
        and not report.result.passed
    )
    two = identification_page(replace(checked, seal=by_pressure(seal_fit([1e5, 2e5]))))
    assert len(next(section for section in two.sections if section.title == "Seal").tables) == 1


def test_another_methods_values_stand_beside(done):
    machine, checked = done
    rows = compare(checked.result, machine)
    table = identification_page(checked, compared=rows).sections[0].tables[-1]
    assert table.title == "Beside the other file" and len(table.cells) == len(checked.result.paths)
    assert table.cells[0][4].text == "the other result has no interval"
    # of the seal's k: the file states the pressure's
    assert table.cells[-1][4].text == "the other result has no interval"


def test_not_converged_is_not_sure(done):
    _, checked = done
    warning = Finding(Code.NOT_CONVERGED, "warning", "not converged after 2 steps")
    lame = replace(
        checked,
        result=replace(checked.result, converged=False, warnings=(warning,)),
    )
    report = identification_page(lame)
    verdict = next(one for one in report.verdicts if one.label == "Parameters")
    assert verdict.passed is False and "NOT converged" in verdict.text and not report.result.passed


def test_a_residual_that_cannot_be_drawn_says_why(done):
    """The four excitations of this record are independent, so S is drawn; alike ones leave
    words.
    """
    machine, checked = done
    residual = youla.identify(
        machine, [checked.outputs[0].record], checked.controller, ["seal.center.k"]
    )
    report = identification_page(replace(checked, residual=residual))
    section = next(
        section
        for section in report.sections
        if section.title.startswith("How the machine differs")
    )
    assert section.figures[0].title == "Residual system" and "Youla" in report.title
    record = residual.signals[0]
    alike = replace(
        record, values=np.vstack([np.tile(record.values[:1], (4, 1)), record.values[4:]])
    )
    same = replace(checked, residual=replace(residual, signals=(alike,)))
    section = next(
        s
        for s in identification_page(same).sections
        if s.title.startswith("How the machine differs")
    )
    assert not section.figures and "is not drawn" in section.text
