"""A lateral analysis beside another's results: here the closed forms of one mass on two films,

m x'' + c x' + k x = U W^2 e^{j W t},    damped natural frequency and log decrement of m, c, k.
"""

import json
import math
import re
import time
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.optimize import minimize_scalar
from tests.annexes.rotordynamics.test_lateral import RPM, C, K, films, mass_of

import ambrose as amb
from ambrose.annexes.rotordynamics.command import foremost
from ambrose.annexes.rotordynamics.comparison import (
    Comparison,
    Pair,
    TheirRow,
    Theirs,
    _assign,
    beside_responses,
    read_table,
)
from ambrose.annexes.rotordynamics.page import lateral_page
from ambrose.annexes.rotordynamics.standard import rpm
from ambrose.cli import main
from ambrose.core.checks import InvalidInput
from ambrose.law.loop import timing_of
from ambrose.record.response_files import write_response
from analyser import Truth, matrices


@pytest.fixture(scope="module")
def analysis():
    return amb.lateral(films(), trip=6300 * RPM)


def closed_form(result):
    """Peak speed and amplitude 0-p, speed and log decrement of the mode, amplitude 0-p at 5000."""
    m, k, c = mass_of(result.machine), 2 * K, 2 * C
    amount = 2 * 6350 * m / 6000 * 1e-6

    def amplitude(w):
        return amount * w**2 / np.hypot(k - m * w**2, c * w)

    peak = minimize_scalar(
        lambda w: -amplitude(w), bounds=(100, 600), method="bounded", options={"xatol": 1e-9}
    ).x
    sigma = c / (2 * m)
    damped = math.sqrt(k / m - sigma**2)
    return peak, amplitude(peak), damped, 2 * math.pi * sigma / damped, amplitude(5000 * RPM)


def table_of(result):
    peak, amplitude, damped, decrement, at = closed_form(result)
    rows = [
        "kind;speed [Hz];amplitude [mil 0-p];damping ratio [%];whirl;case",
        f"critical;{peak / (2 * math.pi):.10g};{amplitude / 25.4e-6:.10g};;;".replace(".", ","),
        f"mode;{damped / (2 * math.pi)};;"
        f"{100 * decrement / math.hypot(2 * math.pi, decrement)};forward;".replace(".", ","),
        f"response;{5000 / 60};{at / 25.4e-6};;;".replace(".", ",") + result.response.cases[0].name,
        "mode;2;;;backward;",
    ]
    return "# by hand\n" + "\n".join(rows) + "\n"


def test_closed_forms_lie_beside_ours(analysis, tmp_path):
    path = tmp_path / "theirs.csv"
    path.write_text(table_of(analysis))
    found = amb.compare(analysis, path, within=0.1)
    assert [(p.quantity, p.unit) for p in found.pairs if p.ours is not None] == [
        ("speed", "rpm"),
        ("amplitude", "um p-p"),
        ("frequency", "rpm"),
        ("log decrement", "-"),
        ("amplitude", "um p-p"),
    ]
    # an infinitely stiff rotor against one that hardly bends: 0.1 %
    assert 0 < found.largest_percent < 0.1
    (alone,) = found.unpaired
    assert "within 25 %" in alone.note
    assert found.passed is False  # a row without a partner
    assert amb.compare(analysis, path).passed is None
    assert len(found.to_frame()) == 6


def test_a_row_without_a_partner_says_what_is_nearest_and_how_far_ours_goes(analysis, tmp_path):
    """A stranger's own bending mode had no partner, and nothing said how far ours are listed."""
    found = [(row.mode.frequency / RPM, row.mode.whirl > 0) for row in analysis.modes]
    first, last = min(found)[0], max(speed for speed, forward in found if forward)
    peak = max(item.critical.speed / RPM for item, _, _ in analysis.critical_speeds)
    far = 2 * analysis.modes_to / RPM
    table = tmp_path / "theirs.csv"
    table.write_text(
        "kind,speed [rpm],whirl,label\n"
        f"mode,{far},forward,far\n"
        f"mode,{0.5 * first},,below\n"
        + 5 * f"mode,{first},forward,many\n"
        + "critical,9000,,beyond\n"
    )
    notes = {p.where: p.note for p in amb.compare(analysis, table).pairs if p.ours is None}
    assert notes["far"] == (
        f"no mode of ours within 25 %, the nearest at {rpm(last * RPM)} rpm (forward); ours are listed up "
        f"to {rpm(analysis.modes_to)} rpm"
    )
    assert notes["below"] == f"no mode of ours within 25 %, the nearest at {first:.5g} rpm"
    assert (
        notes["many"] == f"the nearest mode of ours, at {first:.5g} rpm (forward), is another row's"
    )
    assert notes["beyond"].endswith(
        f"the nearest at {peak:.5g} rpm; ours are listed up to 6300 rpm"
    )


def test_a_list_of_probes_tells_where_a_name_ends(analysis, tmp_path):
    """ "plane of DE eta, major axis" had read as two names."""
    table = tmp_path / "theirs.csv"
    table.write_text("kind;speed [rpm];probe\ncritical;5000;VE1\n")
    with pytest.raises(InvalidInput) as error:
        amb.compare(analysis, table)
    names = {name for name, _ in analysis.response.curves(0)}
    said = str(error.value).partition("it has ")[2]
    assert not any("," in name for name in names)
    assert set(said.split(", ")) == {f'"{name}"' for name in names}


def test_where_no_row_has_a_partner_nothing_was_compared(analysis, tmp_path):
    """ "Largest difference 0 %", status 0, had been said of it."""
    mine, theirs = tmp_path / "mine.json", tmp_path / "theirs.csv"
    mine.write_text(json.dumps(dict(analysis.to_dict())))
    theirs.write_text("kind,speed [rpm]\ncritical,1\ncritical,2\n")
    found = amb.compare(analysis, theirs)
    assert found.largest_percent is None
    assert not found.compared and found.passed is False
    done = CliRunner().invoke(main, ["compare", str(mine), str(theirs)])
    assert done.exit_code == 1
    assert "no row was compared: none of the 2 rows has a partner" in done.output
    assert "largest difference" not in done.output


def test_a_tenth_more_is_a_tenth_more(analysis, tmp_path):
    peak, amplitude, *_ = closed_form(analysis)
    path = tmp_path / "t.csv"
    path.write_text(f"kind,speed [rad/s],amplitude [m p-p]\ncritical,{peak},{1.8 * amplitude}\n")
    speed, height = amb.compare(analysis, path).pairs
    assert speed.percent == pytest.approx(0, abs=0.1)
    assert height.percent == pytest.approx(100 / 0.9 - 100, abs=0.2)
    assert height.difference == pytest.approx(0.2e6 * amplitude, rel=0.02)


def test_pairs_are_the_nearest_together():
    rows = [TheirRow("mode", 105.0), TheirRow("mode", 112.0), TheirRow("mode", 112.0)]
    # greedy would give 105 to 110 and leave 112 with 100
    assert _assign(rows[:2], [(100.0, ""), (110.0, "")]) == [0, 1]
    assert sorted(map(str, _assign(rows, [(110.0, ""), (111.0, "")]))) == ["0", "1", "None"]
    whirling = [TheirRow("mode", 100.0, whirl="backward")]
    assert _assign(whirling, [(100.0, "forward"), (120.0, "backward")]) == [1]
    assert _assign(whirling, [(100.0, "planar")]) == [0]


def test_before_and_after_on_one_page(analysis, tmp_path):
    before = amb.lateral(films(first=0.1, second=0.9), trip=6300 * RPM)
    found = amb.compare(analysis, before)
    named = {(p.quantity, p.where) for p in found.pairs}
    assert ("value", "Scale factor for the clearance check") in named
    page = lateral_page(analysis, comparison=found)
    (section,) = [s for s in page.sections if s.title == "Side by side"]
    assert len(section.tables[0].rows) == len(found.pairs)
    assert amb.compare(analysis, analysis).largest_percent == 0

    files = tmp_path / "lateral.json", tmp_path / "before.json"
    for path, result in zip(files, (analysis, before), strict=True):
        path.write_text(json.dumps(dict(result.to_dict())))
    done = CliRunner().invoke(main, ["compare", *map(str, files), "--json", "--within", "0.01"])
    assert done.exit_code == 1
    assert json.loads(done.stdout)["rows"] == json.loads(json.dumps(found.to_dict()["rows"]))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("kind;speed [rpm]\n", "a row for each entry"),
        ("kind;spead [rpm]\nmode;1\n", 'did you mean "speed"'),
        ("speed [rpm]\n5\n", '"kind" is missing'),
        ("kind;speed\nmode;5\n", "no unit"),
        ("kind;speed [mm]\nmode;5\n", "rpm"),
        ("kind;speed [rpm];amplitude [um]\ncritical;5;1\n", "peak to peak or zero to peak"),
        ("kind;speed [rpm];speed [Hz]\nmode;5;5\n", "twice"),
        ("kind;speed [rpm]\nmodes;5\n", "critical, mode, response"),
        ("kind;speed [rpm]\nmode;fast\n", "must be a number"),
        ("kind;speed [rpm]\nmode;-5\n", "above 0"),
        ("kind;speed [rpm]\nresponse;5\n", "needs an amplitude"),
        ("kind;speed [rpm];zeta [-]\nmode;5;5\n", "below 1"),
        ("kind;speed [rpm]\nmode;5;6\n", "line 2 has 3 cells, but the header names 2 columns"),
        ("kind;speed [rpm];whirl\nmode;5;left\n", "planar"),
        ("kind;speed [rpm];log_decrement [s]\nmode;5;1\n", "must be"),
        (
            "kind;speed [rpm];zeta\nmode;5.230;0,05\n",
            "decimal commas .'0,05' in line 2. and points",
        ),
        ("kind;speed [rpm]\nmode;980\nmode;5.230\n", '"5.230" in line 3 may be 5230'),
        ("kind;speed [rpm];zeta\nmode;5\n", "line 2 has 2 cells, but the header names 3"),
        ("kind;speed [1/s]\nmode;5\n", "speed is .1/s., but"),
    ],
)
def test_a_wrong_table_is_refused_in_one_sentence(text, words):
    with pytest.raises(InvalidInput, match=words) as error:
        read_table(text, "theirs.csv")
    assert "theirs.csv" in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("unit", "radians"),
    [
        ("rpm", RPM),
        ("cpm", RPM),
        ("1/min", RPM),
        ("min^-1", RPM),
        ("cps", 60 * RPM),
        ("Hz", 60 * RPM),
    ],
)
def test_speeds_of_theirs_in_any_unit_of_turns(unit, radians):
    (row,) = read_table(f"kind;speed [{unit}];amplitude [mils pk-pk]\ncritical;30;2\n", "t")
    assert row.speed == pytest.approx(30 * radians) and row.amplitude == pytest.approx(50.8e-6)


def test_what_is_no_analysis_is_refused(analysis, tmp_path):
    path = tmp_path / "mine.json"
    for content, words in (
        ("{", "not complete JSON"),
        ("[]", "no lateral analysis"),
        (json.dumps(dict(analysis.to_dict()) | {"schema": 99}), "schema 99"),
    ):
        path.write_text(content)
        with pytest.raises(InvalidInput, match=words):
            amb.compare(path, analysis)
    with pytest.raises(InvalidInput, match="unstable"):
        amb.compare({"schema": 1, "machine": "", "items": [], "modes": []}, analysis)
    with pytest.raises(InvalidInput, match="above 0 %"):
        amb.compare(analysis, analysis, within=0.0)
    table = tmp_path / "t.csv"
    table.write_text("kind;speed [rpm];probe\ncritical;4000;VE9\n")
    with pytest.raises(InvalidInput, match='"VE9"'):
        amb.compare(analysis, table)


SPOILED = {
    "NaN": (("modes", 0, "log_decrement"), math.nan, "must be finite"),
    "infinite": (("response", "curves", 0, "amplitude_m_pp", 0), math.inf, "must be finite"),
    "overflow": (("critical_speeds", 0, "speed_rad_per_s"), 1e300, "must be finite"),
    "negative amplitude": (
        ("critical_speeds", 0, "amplitude_m_pp"),
        -1e-6,
        r"critical_speeds\[0\].amplitude_m_pp is -1e-06, but must be at least 0",
    ),
    "no speed": (("response", "speeds_rad_per_s", 0), 0, "must be above 0"),
    "descending": (("response", "speeds_rad_per_s", 0), 1e4, "must ascend"),
    "word": (("modes", 0, "frequency_rad_per_s"), "x", "'x', but must be number"),
    "none": (("speeds_rad_per_s", "trip"), None, "None, but must be number"),
    "truth": (("modes", 0, "whirl"), True, "True, but must be number"),
    "list": (("items", 0), [], "a list, but must be object"),
    "curve": (("response", "curves", 0, "phase_lag_deg"), [1.0], "has 1 values for"),
    "key": (("items", 0, "colour"), "red", "items.0..colour is unknown"),
}


@pytest.mark.parametrize("case", SPOILED)
@pytest.mark.parametrize("from_file", [True, False])
def test_an_analysis_with_a_spoiled_value_is_refused(analysis, tmp_path, case, from_file):
    """Of issue 49: --within was green with NaN, 98 of 1005 such files ended in a traceback."""
    place, value, words = SPOILED[case]
    data = json.loads(json.dumps(dict(analysis.to_dict())))
    entry = data
    for key in place[:-1]:
        entry = entry[key]
    entry[place[-1]] = value
    path = tmp_path / "theirs.json"
    path.write_text(json.dumps(data))
    with pytest.raises(InvalidInput, match=words):
        amb.compare(analysis, path if from_file else data, within=5.0)


def test_a_negative_amplitude_of_a_table_is_refused():
    with pytest.raises(InvalidInput, match="line 2: amplitude is negative"):
        read_table("kind;speed [rpm];amplitude [um p-p]\ncritical;4000;-1\n", "t.csv")


def test_ours_beside_their_zero_is_no_agreement():
    pair = Pair("mode", "log decrement", 0.0, 5.0, "-")
    assert Comparison("rotor", "theirs", (pair,), within=5.0).passed is False
    assert Comparison("rotor", "theirs", (replace(pair, ours=0.0),), within=5.0).passed is True


def test_thousands_of_rows_are_compared_in_a_second(analysis):
    rows = "".join(f"response;{3000 + 0.5 * i:g};1\n" for i in range(4000))
    theirs = read_table("kind;speed [rpm];amplitude [um p-p]\n" + rows, "t.csv")
    begun = time.process_time()
    compared = amb.compare(analysis, Theirs("t.csv", theirs))
    assert len(compared.pairs) == 4000 and time.process_time() - begun < 1.0


def test_of_many_rows_those_are_printed_that_decide(analysis, tmp_path):
    """60,000 rows took 90 s, nearly all of it to draw their table."""
    pairs = [Pair(f"row {i}", "speed", 100.0, 100.0 + i, "rpm") for i in range(5)]
    pairs.append(Pair("lost", "speed", 100.0, None, "rpm"))
    assert [p.where for p in foremost(pairs, 3)] == ["row 3", "row 4", "lost"]
    assert foremost(pairs) == pairs
    rows = "".join(f"response;{3000 + 0.5 * i:g};1\n" for i in range(1000))
    data, theirs = tmp_path / "lateral.json", tmp_path / "t.csv"
    data.write_text(json.dumps(analysis.to_dict()))
    theirs.write_text("kind;speed [rpm];amplitude [um p-p]\n" + rows)
    done = CliRunner().invoke(main, ["compare", str(data), str(theirs), "--details"])
    assert "200 of 1,000 rows: first those without a partner" in done.output
    assert done.output.count("um p-p") == 3 * 200  # theirs, ours and the difference


# ----------------------------------------------------------------- measured responses of the loop


@cache
def swept(magnets):
    """The seal rig's responses on the tests' own rig while its PID runs, and that PID."""
    file = Path(amb.__file__).parent / "machines" / "seal-rig.toml"
    law = amb.design("seal-rig", "pid").controller
    rig = Truth.of(file, 1e4, magnets, modes=16)
    return law, rig, rig.sweep("seal-rig", matrices(law, 1e4), rig.hertz(packed=20))


@pytest.mark.parametrize("magnets", [(0.0, 0.0), (0.1, -0.08)])
def test_measured_resonances_lie_beside_predicted_ones(magnets, analysis):
    law, rig, response = swept(magnets)
    machine = amb.load_machine("seal-rig")
    timing = timing_of(machine, law, 1e4)
    found = beside_responses(machine, law, response, timing)
    frequencies = [pair for pair in found.pairs if pair.quantity == "frequency"]
    heights = [pair for pair in found.pairs if pair.quantity == "height"]
    assert len(frequencies) == len(heights) >= 4 and not found.unpaired
    # every measured resonance is a pole of the rig's own loop
    poles = rig.light_poles(matrices(law, 1e4)).imag / (2 * math.pi)
    for pair in frequencies:
        nearest = np.abs(poles / pair.theirs - 1).min()
        assert nearest < 0.05 or pair.theirs < 200  # below, the rigid modes are damped
    if magnets == (0.0, 0.0):
        # noise of 1 % on a broad maximum, lines 4.7 % apart; a bending mode's are close
        assert all(abs(p.percent) < (0.5 if p.theirs > 200 else 12) for p in frequencies)
        assert max(abs(pair.percent) for pair in heights) < 15
        assert float(re.search(r"up to ([\d.]+) Hz", found.agreement)[1]) > 1000
    else:
        assert max(abs(pair.percent) for pair in heights) > 15
        assert float(re.search(r"up to ([\d.]+) Hz", found.agreement)[1]) < 200
    shown = lateral_page(analysis, comparison=found)
    section = next(s for s in shown.sections if s.title.startswith("Measured responses"))
    assert "API 617" in section.text and section.figures and section.tables
    assert {trace.name for trace in section.figures[0].picture.data} >= {"this analysis"}


def test_responses_of_another_machine_or_without_an_axis_on_itself_are_refused():
    law, _, response = swept((0.0, 0.0))
    machine = amb.load_machine("seal-rig")
    timing = timing_of(machine, law, 1e4)
    with pytest.raises(InvalidInput, match="the machine of responses 1"):
        beside_responses(machine, law, replace(response, machine="other"), timing)
    across = tuple(path for path in response.paths if path.read != path.injected)
    with pytest.raises(InvalidInput, match="no response of an axis on itself"):
        beside_responses(machine, law, replace(response, paths=across), timing)


def test_the_command_takes_responses_and_asks_for_their_controller(tmp_path):
    _, _, response = swept((0.0, 0.0))
    write_response(response, tmp_path / "sweep.csv")
    words = ["lateral", "seal-rig", "--beside", str(tmp_path / "sweep.csv")]
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 2 and "--controller" in done.stderr
