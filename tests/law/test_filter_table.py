"""Tables of filters, CSV or JSON, are the controller that scipy says they are; what is no filter is
refused in a sentence.
"""

from __future__ import annotations

import json

import numpy as np
import pytest
import scipy.signal
from click.testing import CliRunner

import ambrose as amb
from ambrose.cli import main
from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import frequency_response

RATE = 1e4
OMEGA = np.geomspace(1.0, 2e4, 30)
LOW = scipy.signal.iirfilter(4, [200, 900], fs=RATE, ftype="butter", output="sos")
ZEROS = [-5.0, -40 + 300j, -40 - 300j]
POLES = [0.0, -700 + 900j, -700 - 900j, -3000.0]
GAIN = 2e7


def digital(sos):
    return scipy.signal.freqz_sos(sos, worN=OMEGA, fs=2 * np.pi * RATE)[1]


def analog(zeros, poles, gain):
    return scipy.signal.freqs_zpk(zeros, poles, gain, worN=OMEGA)[1]


def direct(controller):
    values = frequency_response(controller, OMEGA).values
    assert not np.any(values[:, ~np.eye(values.shape[1], dtype=bool)])
    return np.diagonal(values, axis1=1, axis2=2).T


def test_digital_sections_in_csv(tmp_path):
    rows = ["channel,b0,b1,b2,a0,a1,a2,rate_hz"]
    rows += [
        f"{axis},{','.join(map(repr, map(float, row)))},10000"
        for axis in ("A_zeta", "A_eta")
        for row in LOW
    ]
    rows += ["A_eta,2,0,0,1,0,0,10000"]
    (tmp_path / "vendor.csv").write_text("\n".join(rows) + "\n")
    read = amb.read_controller(tmp_path / "vendor.csv")
    assert read.controller.dt == 1 / RATE and read.controller.inputs == ("err_A_zeta", "err_A_eta")
    assert read.status == "uncertified"
    np.testing.assert_allclose(
        direct(read.controller), [digital(LOW), 2 * digital(LOW)], rtol=1e-9, atol=1e-12
    )
    done = CliRunner().invoke(
        main, ["convert", str(tmp_path / "vendor.csv"), "-o", str(tmp_path / "k.json")]
    )
    assert done.exit_code == 0 and "sampled at 10000 Hz" in done.output
    assert amb.read_controller(tmp_path / "k.json") == read


def test_analog_zeros_and_poles_in_csv_and_json(tmp_path):
    text = "channel, zeros, poles, gain\n"
    text += "A_zeta, -5 -40+300j -40-300j, 0 -700+900i -700-900i -3000, 2e7\n"
    (tmp_path / "vendor.csv").write_text(text)
    pairs = [[value.real, value.imag] if isinstance(value, complex) else value for value in POLES]
    item = {"zeros": [str(value) for value in ZEROS], "poles": pairs, "gain": GAIN}
    (tmp_path / "vendor.json").write_text(
        json.dumps({"channels": {"A_zeta": item, "B_eta": {"sos": [[0, 0, 3, 0, 2, 8]]}}})
    )
    from_csv, from_json = (
        amb.read_controller(tmp_path / f"vendor.{kind}").controller for kind in ("csv", "json")
    )
    assert from_csv.dt is None and from_csv.n_states == 4
    np.testing.assert_allclose(direct(from_csv)[0], analog(ZEROS, POLES, GAIN), rtol=1e-9)
    np.testing.assert_allclose(
        direct(from_json), [analog(ZEROS, POLES, GAIN), 3 / (2j * OMEGA + 8)], rtol=1e-9
    )


@pytest.mark.parametrize("seed", range(4))
def test_any_zeros_and_poles(seed, tmp_path):
    """Fewer zeros than poles, as a sampled controller with delays has them: no zero at z = 0 may be
    made up.
    """
    rng = np.random.default_rng(seed)

    def roots(pairs, single):
        half = rng.uniform(0.1, 0.9, pairs) * np.exp(1j * rng.uniform(0.1, 3, pairs))
        return [*half, *half.conj(), *rng.uniform(-0.9, 0.9, single)]

    zeros, poles = roots(seed % 2, 1), roots(1 + seed % 2, seed)
    item = {"zeros": list(map(str, zeros)), "poles": list(map(str, poles)), "gain": -0.3}
    (tmp_path / "k.json").write_text(json.dumps({"rate_hz": RATE, "channels": {"A": item}}))
    z = np.exp(1j * OMEGA / RATE)[:, None]
    expected = -0.3 * np.prod(z - np.array(zeros), axis=1) / np.prod(z - np.array(poles), axis=1)
    np.testing.assert_allclose(
        direct(amb.read_controller(tmp_path / "k.json").controller)[0], expected, rtol=1e-8
    )


WRONG = {
    "columns": ("k.csv", "axis,b0\nA,1\n", "first line must name the columns"),
    "empty": ("k.csv", "", "first line must name the columns"),
    "no number": (
        "k.csv",
        "channel,b0,b1,b2,a0,a1,a2\nA,1,0,x,1,0,0\n",
        "line 2: 'x' is not a finite number",
    ),
    "short row": ("k.csv", "channel,b0,b1,b2,a0,a1,a2\nA,1,0\n", "line 2"),
    "improper": (
        "k.csv",
        "channel,b0,b1,b2,a0,a1,a2\nA,1,0,0,0,1,0\n",
        "degree is above the denominator's",
    ),
    "two rates": (
        "k.csv",
        "channel,zeros,poles,gain,rate_hz\nA,,0.5,1,10\nA,,0.5,1,20\n",
        "give all sections one rate",
    ),
    "no text": (
        "k.csv",
        'channel,zeros,poles,gain\n"' + "A" * 200_000 + '",,-5,1\n',
        "is not a CSV table",
    ),
    "400 digits": (
        "k.json",
        '{"channels": {"A": {"sos": [[1' + "0" * 400 + ", 0, 0, 1, 0, 0]]}}}",
        "must be finite",
    ),
    "overflow": ("k.csv", "channel,zeros,poles,gain\nA,,1e300 1e300,1e300\n", "finite"),
    "no name": ("k.csv", "channel,zeros,poles,gain\n,,-5,1\n", "a channel has no name"),
    "conjugate": ("k.csv", "channel,zeros,poles,gain\nA,,-5+3j,1\n", "lacks its conjugate"),
    "more zeros": (
        "k.json",
        '{"channels": {"A": {"zeros": [1, 2], "poles": [-1], "gain": 1}}}',
        "2 zeros and 1 poles",
    ),
    "rate": (
        "k.json",
        '{"rate_hz": -1, "channels": {"A": {"zeros": [], "poles": [-1], "gain": 1}}}',
        "rate_hz is -1",
    ),
    "both": ("k.json", '{"channels": {"A": {"sos": [], "poles": [-1]}}}', "write one of the two"),
    "unknown key": ("k.json", '{"chanels": 1, "channels": {}}', "unknown key 'chanels'"),
    "no channel": ("k.json", '{"channels": {}}', "a channel has no name"),
    "no table": ("k.json", '{"channels": [1]}', "channels is not a table"),
    "five": (
        "k.json",
        '{"channels": {"A": {"sos": [[1, 2, 3, 4, 5]]}}}',
        "has 5 numbers, but must have six",
    ),
    "no list": ("k.json", '{"channels": {"A": {"sos": 3}}}', "3 is not a list"),
    "boolean": (
        "k.json",
        '{"channels": {"A": {"sos": [[true, 0, 0, 1, 0, 0]]}}}',
        "True is not a finite number",
    ),
    "infinite": (
        "k.json",
        '{"channels": {"A": {"sos": [[1e999, 0, 0, 1, 0, 0]]}}}',
        "a number is '1e999', but must be finite",
    ),
    "too many": (
        "k.json",
        json.dumps({"channels": {"A": {"sos": [[1, 0, 0, 1, 0, 0]] * 251}}}),
        "502 states",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_no_filter_is_refused_in_a_sentence(name, tmp_path):
    file, text, message = WRONG[name]
    (tmp_path / file).write_text(text)
    with pytest.raises(InvalidInput, match=message) as caught:
        amb.read_controller(tmp_path / file)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "lacking"),
    [
        (
            "channel, b0, b1, b2, a0, a1\nA_zeta,1,2,3,1,2\n",
            "it lacks a2; its first line must name",
        ),
        (
            "b0, b1, b2, a0, a1, a2, gain\n1,2,3,1,2,1,1\n",
            "it lacks channel; its first line must name",
        ),
        ("channel, zeros, gain\nA_zeta,1,2\n", "it lacks poles; its first line must name"),
        ("x, y\n1, 2\n", "'x' is unknown; known: a, .*; its first line must name"),
        ("channel, zeros, poles, gain, Q\nA,,-1,1,7\n", "'Q' is unknown"),
        ("channel, zeros, poles, gain\nA,,-1,1,7\n", "line 2 has 5 cells, but the header names 4"),
        ("channel; b; a; rate_hz\nx; 5.200 -9800,5; 1; 5\n", "commas .'-9800,5' .* points .'5.2"),
        (
            "channel; zeros; poles; gain\nx; ; 10.000; 900\nx; ; 5; 1.000\n",
            '"10.000" in line 2 may be 10000',
        ),
    ],
)
def test_a_table_names_the_columns_that_it_lacks(text, lacking, tmp_path):
    (tmp_path / "vendor.csv").write_text(text)
    with pytest.raises(InvalidInput, match=lacking):
        amb.read_controller(tmp_path / "vendor.csv")


@pytest.mark.parametrize("n", [0, 1, 2, 3])
@pytest.mark.parametrize(("p", "m"), [(1, 1), (1, 3), (3, 1), (2, 2)])
def test_matrices_as_matlab_encodes_them_in_json(n, p, m, tmp_path):
    """jsonencode drops the brackets of scalars, and does not tell a row from a column."""
    rng = np.random.default_rng(n)
    shapes = {"A": (n, n), "B": (n, m), "C": (p, n), "D": (p, m)}
    full = {key: rng.standard_normal(shape) for key, shape in shapes.items()}

    def encoded(matrix):
        return matrix.ravel().tolist() if 1 in matrix.shape else matrix.tolist()

    short = {key: encoded(matrix) for key, matrix in full.items()}
    short = {key: value[0] if len(value) == 1 else value for key, value in short.items()}
    if n == 0:  # of no state, D alone says how many there are
        short |= {"A": [], "B": [], "C": [], "D": full["D"].tolist()}
    names = {"axes": list("abc"[:m]), "outputs": list("abc"[:p]), "Ts": 0}
    (tmp_path / "k.json").write_text(json.dumps(short | names))
    read = amb.read_controller(tmp_path / "k.json").controller
    for key, matrix in full.items():
        np.testing.assert_array_equal(getattr(read, key), matrix)


def test_one_section_as_matlab_encodes_it_in_json(tmp_path):
    item = {"sos": [1, 2, 3, 1, 0.5, 0.25]}
    (tmp_path / "k.json").write_text(json.dumps({"rate_hz": RATE, "channels": {"A": item}}))
    expected = digital(np.array([item["sos"]]))
    found = direct(amb.read_controller(tmp_path / "k.json").controller)
    np.testing.assert_allclose(found[0], expected, rtol=1e-9)


def test_an_unstable_table_is_converted_with_a_warning(tmp_path):
    head = "channel,b0,b1,b2,a0,a1,a2,rate_hz\n"
    rows = "".join(f"A_{way},1,2,3,1,-2.1,1.2,10000\n" for way in ("zeta", "eta"))
    (tmp_path / "v.csv").write_text(head + rows)
    words = ["convert", str(tmp_path / "v.csv"), "-o", str(tmp_path / "k.json")]
    done = CliRunner().invoke(main, words)
    assert (
        done.exit_code == 0
        and "careful: the controller itself is unstable (a pole at +911.6 rad/s)" in done.stderr
    )
    problems = json.loads(CliRunner().invoke(main, [*words, "--json"]).stdout)["problems"]
    assert len(problems) == 1 and "unstable" in problems[0]
    (tmp_path / "v.csv").write_text(head + rows.replace("-2.1,1.2", "-1.9,0.95"))
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 0 and "careful" not in done.stderr


# as a processor has it, y = b0 x + b1 x' + b2 x'' + a1 y' + a2 y'', a0 left out
_PROCESSOR = "channel,b0,b1,b2,a1,a2,rate_hz\n" + "".join(
    f"{axis},{','.join(repr(float(v)) for v in (*row[:3], -row[4], -row[5]))},10000\n"
    for axis in ("A_zeta", "A_eta")
    for row in LOW
)


def test_sections_of_a_signal_processor_are_refused_until_their_sign_is_stated(tmp_path):
    (tmp_path / "v.csv").write_text(_PROCESSOR)
    with pytest.raises(InvalidInput, match="stable with a1 and a2 of the other sign, as CMSIS"):
        amb.read_controller(tmp_path / "v.csv")
    stated = amb.read_controller(tmp_path / "v.csv", feedback="added").controller
    np.testing.assert_allclose(direct(stated), [digital(LOW)] * 2, rtol=1e-9, atol=1e-12)
    lines = _PROCESSOR.splitlines()
    (tmp_path / "f.csv").write_text(
        "\n".join([f"{lines[0]},feedback", *(f"{row},added" for row in lines[1:])])
    )
    found = direct(amb.read_controller(tmp_path / "f.csv").controller)
    np.testing.assert_array_equal(found, direct(stated))
    with pytest.raises(InvalidInput, match="feedback is added in the file, and subtracted was"):
        amb.read_controller(tmp_path / "f.csv", feedback="subtracted")


@pytest.mark.parametrize("form", ["as subtracted", "as added", "b and a", "matrices"])
def test_coefficients_of_z_without_a_rate_are_asked_for_it(tmp_path, form):
    """Read as polynomials of s [rad/s] they would be another controller, without a word."""
    b, a = scipy.signal.sos2tf(LOW[:1])
    system = scipy.signal.tf2ss(b, a)
    rows = {
        "as subtracted": "channel,b0,b1,b2,a0,a1,a2\n"
        + "".join(f"A_{w},{','.join(map(repr, map(float, LOW[0])))}\n" for w in ("zeta", "eta")),
        "as added": "\n".join(line.rpartition(",")[0] for line in _PROCESSOR.splitlines()),
        "b and a": json.dumps({"axes": ["A_zeta"], "b": b.tolist(), "a": a.tolist()}),
        "matrices": json.dumps(
            {"axes": ["A_zeta"]}
            | dict(zip("ABCD", (matrix.tolist() for matrix in system), strict=True))
        ),
    }
    path = tmp_path / ("v.csv" if rows[form].startswith("channel") else "v.json")
    path.write_text(rows[form])
    with pytest.raises(InvalidInput, match="it states no sample rate, and its poles are those of"):
        amb.read_controller(path)


def test_coefficients_of_s_need_no_rate(tmp_path):
    (tmp_path / "v.csv").write_text("channel,b,a\nA_zeta,3 600,1 900\nA_eta,3 600,1 0\n")
    assert amb.read_controller(tmp_path / "v.csv").controller.dt is None
