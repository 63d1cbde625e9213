"""Files of frequency responses, each written here by hand."""

import io
import json
import struct

import numpy as np
import pytest

from ambrose.core.checks import InvalidInput
from ambrose.record.foreign import read_foreign
from ambrose.record.response import Response
from ambrose.record.response_files import holds_responses, read_response, write_response

HERTZ = np.array([5.0, 10.0, 20.0, 50.0, 120.0, 400.0])
s = 2j * np.pi * HERTZ
L = 4e4 * (1 + s / 200) / (s**2 - 1e4) * np.exp(-s * 1.5e-4)
S, T = 1 / (1 + L), L / (1 + L)
HEAD = "# machine: toy\n# sample_rate_hz: 8000\n# speed_rad_s: 0\n# seal_pressure_pa: 0\n"
POINT = {"speed": "3000 rpm", "seal_pressure": "1 bar"}


def table(names, *columns, head="", separator=","):
    text = io.StringIO()
    text.write(head + separator.join(names) + "\n")
    np.savetxt(text, np.column_stack(columns), fmt="%.15g", delimiter=separator)
    return text.getvalue()


def written(tmp_path, text, name="sweep.csv"):
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def dB(x):
    return 20 * np.log10(np.abs(x))


def deg(x, unwrapped=False):
    angle = np.angle(x)
    return np.degrees(np.unwrap(angle) if unwrapped else angle)


FORMS = {
    "dB and degrees": (("gain [dB]", "phase [deg]"), lambda v: (dB(v), deg(v))),
    "abs and degrees, unwrapped": (
        ("gain [abs]", "phase [deg]"),
        lambda v: (abs(v), deg(v, True) - 720),
    ),
    "abs and radians": (("gain [abs]", "phase [rad]"), lambda v: (abs(v), np.angle(v))),
    "real and imaginary": (("real", "imag"), lambda v: (v.real, v.imag)),
}


@pytest.mark.parametrize("form", FORMS)
def test_a_csv_that_names_its_columns(tmp_path, form):
    parts, made = FORMS[form]
    names = ["frequency [Hz]", *(f"S A_zeta {p}" for p in parts), *(f"T A_zeta {p}" for p in parts)]
    path = written(tmp_path, table(names, HERTZ, *made(S), *made(T), head=HEAD))
    assert holds_responses(path)
    found = read_response(path)
    np.testing.assert_allclose(found.omega, 2 * np.pi * HERTZ)
    np.testing.assert_allclose([p.values for p in found.paths], [S, T], rtol=1e-10)
    assert [p.name for p in found.paths] == ["S A_zeta", "T A_zeta"]
    assert found.machine == "toy" and found.point.speed == 0


def test_coherence_and_averages_say_how_certain(tmp_path):
    head = HEAD + "# averages: 8\n"
    names = ["frequency [Hz]", "S A_zeta real", "S A_zeta imag", "S A_zeta coherence"]
    text = table(names, HERTZ, S.real, S.imag, np.full(6, 0.8), head=head)
    path = read_response(written(tmp_path, text)).paths[0]
    np.testing.assert_allclose(path.variance, abs(S) ** 2 * 0.2 / (8 * 0.8))
    with pytest.raises(InvalidInput, match="averages"):
        read_response(written(tmp_path, text.replace("# averages: 8\n", "")))


def test_a_map_reads_what_an_analyser_wrote(tmp_path):
    G = 1e-3 / (s**2 - 1e4) * 1e4
    text = table(["Freq", "Mag", "Deg"], HERTZ, dB(G * 1e6), deg(-G), separator=";")
    paths = [{"quantity": "G", "read": "A_zeta", "gain": "Mag", "gain_unit": "dB", "phase": "Deg",
              "unit": "um/A", "sign": -1.0}]  # fmt: skip
    frequency = {"source": "Freq", "unit": "Hz"}
    known = {"machine": "toy", "point": POINT, "frequency": frequency, "path": paths}
    found = read_response(written(tmp_path, text, "sweep.txt"), known)
    np.testing.assert_allclose(found.paths[0].values, G, rtol=1e-9)
    assert found.point.seal_pressure == pytest.approx(1e5)


@pytest.mark.parametrize("suffix", [".h5", ".csv"])
def test_what_is_written_is_read_again(tmp_path, suffix):
    names = ["frequency [Hz]", "T A_eta/A_zeta current real", "T A_eta/A_zeta current imag",
             "K A_zeta gain [A/mm]", "K A_zeta phase [deg]", "S A_zeta real", "S A_zeta imag",
             "S A_zeta deviation"]  # fmt: skip
    columns = (HERTZ, T.real, T.imag, abs(L), deg(L), S.real, S.imag, 0.01 * abs(S))
    with pytest.raises(InvalidInput, match=r"state deg|phase_unit|deg.* or \[rad"):
        read_response(written(tmp_path, table(names, *columns, head=HEAD).replace("[deg]", "[x]")))
    first = read_response(written(tmp_path, table(names, *columns, head=HEAD)))
    assert isinstance(first, Response)
    np.testing.assert_allclose(first.paths[1].values, 1e3 * L, rtol=1e-9)
    again = read_response(write_response(first, tmp_path / f"again{suffix}"))
    assert holds_responses(tmp_path / f"again{suffix}")
    assert again.attributes == first.attributes
    np.testing.assert_allclose(again.omega, first.omega, rtol=1e-14)
    for one, other in zip(first.paths, again.paths, strict=True):
        assert one.name == other.name
        np.testing.assert_allclose(one.values, other.values, rtol=1e-14)
    np.testing.assert_allclose(again.paths[2].variance, (0.01 * abs(S)) ** 2, rtol=1e-12)


def heading(title, kind, code, count, even, nodes, step=5.0):
    node, direction, ref, ref_direction = nodes
    return [
        title, "NONE", "NONE", "NONE", "NONE",
        f"{kind:5d}{1:10d}{1:5d}{0:10d} {'NONE':10s}{node:10d}{direction:4d} {'NONE':10s}{ref:10d}{ref_direction:4d}",
        f"{code:10d}{count:10d}{even:10d}{5.0:13.5e}{step:13.5e}{0.0:13.5e}",
        f"{18:10d}{0:5d}{0:5d}{0:5d} {'Frequency':20s} {'Hz':20s}",
        f"{8:10d}{0:5d}{0:5d}{0:5d} {'y':20s} {'um':20s}",
        f"{0:10d}{0:5d}{0:5d}{0:5d} {'u':20s} {'A':20s}",
        f"{0:10d}{0:5d}{0:5d}{0:5d} {'NONE':20s} {'NONE':20s}",
    ]  # fmt: skip


def universal(values, double, even, binary, nodes=(2, 1, 1, -1), hertz=HERTZ):
    head = heading("G A_zeta", 4, 6 if double else 5, len(values), int(even), nodes)
    rows = [([] if even else [f]) + [v.real, v.imag] for f, v in zip(hertz, values, strict=True)]
    if binary:
        kind = "d" if double else "f"
        raw = b"".join(struct.pack(f"<{'' if even else 'f'}2{kind}", *row) for row in rows)
        first = f"    58b{1:6d}{2:6d}{11:12d}{len(raw):12d}{0:6d}{0:6d}{0:12d}{0:12d}"
        return ("\n".join(["    -1", first, *head]) + "\n").encode() + raw + b"\n    -1\n"
    if double and not even:
        body = [f"{f:13.5e}{a:20.12e}{b:20.12e}" for f, a, b in rows]
    else:
        size, per = (20, 4) if double else (13, 6)
        cells = [f"{x:{size}.{size - 8}e}" for row in rows for x in row]
        body = ["".join(cells[i : i + per]) for i in range(0, len(cells), per)]
    return "\n".join(["    -1", "    58", *head, *body, "    -1", ""]).encode()


@pytest.mark.parametrize("binary", [False, True])
@pytest.mark.parametrize("even", [False, True])
@pytest.mark.parametrize("double", [False, True])
@pytest.mark.parametrize("source", ["G A_zeta", "2:+X/1:-X", "set 1"])
def test_universal_files_of_responses(tmp_path, double, even, binary, source):
    hertz = 5.0 + 5.0 * np.arange(6) if even else HERTZ
    path = written(tmp_path, universal(1e6 * L, double, even, binary, hertz=hertz), "sweep.uff")
    paths = [{"quantity": "G", "read": "A_zeta", "source": source}]
    found = read_response(path, {"machine": "toy", "point": POINT, "path": paths})
    np.testing.assert_allclose(found.paths[0].values, L, rtol=1e-5)  # um/A of the heading
    np.testing.assert_allclose(found.omega, 2 * np.pi * hertz, rtol=1e-5)


def test_a_response_is_no_time_signal(tmp_path):
    path = written(tmp_path, universal(L, True, True, False), "sweep.uff")
    known = {"machine": "toy", "point": POINT, "sample_rate_hz": 1e4,
             "signal": [{"name": "y_A_zeta", "source": "set 1", "unit": "m"}]}  # fmt: skip
    with pytest.raises(InvalidInput, match="frequency response, not a time signal"):
        read_foreign(path, known)


GOOD = ("frequency [Hz]", "S A_zeta gain [dB]", "S A_zeta phase [deg]")


@pytest.mark.parametrize(
    ("names", "columns", "head", "words"),
    [
        (GOOD, (HERTZ[::-1], dB(S), deg(S)), HEAD, "sort the lines"),
        (GOOD, (HERTZ.round(-2), dB(S), deg(S)), HEAD, "zero or no number|does not lie above"),
        (GOOD, (HERTZ, dB(S), deg(S)), "", "machine"),
        (GOOD, (HERTZ, dB(S), deg(S)), HEAD.replace("speed_rad_s: 0", "speed_rad_s: x"), "number"),
        (GOOD, (HERTZ, dB(S), np.full(6, np.nan)), HEAD, "not finite"),
        (GOOD, (HERTZ, 0 * dB(S), 0 * deg(S)), HEAD, "dead channel"),
        (("frequency [Hz]", "S A_zeta gain [abs]", GOOD[2]), (HERTZ, dB(S), deg(S)), HEAD, "in dB, not"),
        ((*GOOD[:2], "S A_zeta phase [rad]"), (HERTZ, dB(S), deg(S)), HEAD, "in degrees"),
        (("frequency [Hz]", "foo", "bar"), (HERTZ, dB(S), deg(S)), HEAD, "does not state its quantity"),
        (("frequency [mm]", *GOOD[1:]), (HERTZ, dB(S), deg(S)), HEAD, "must be a unit of angular"),
        (("frequency [Hz]", "G A_zeta gain [um/V]", "G A_zeta phase [deg]"),
         (HERTZ, abs(S), deg(S)), HEAD, "G .* is \"V\""),
        (GOOD[:2], (HERTZ, dB(S)), HEAD, "exactly one of the three"),
        (("frequency [Hz]", "G A_zeta real [um/A]", "G A_zeta imag [m/A]"),
         (HERTZ, S.real, S.imag), HEAD, "two units, um/A and m/A"),
        (("frequency [Hz]", "G A_zeta gain [um/A]", "G A_zeta phase [deg]",
          "G A_zeta deviation [m/A]"), (HERTZ, abs(S), deg(S), abs(S)), HEAD, "two units"),
        ((*GOOD, GOOD[1]), (HERTZ, dB(S), deg(S), dB(T)), HEAD, "S A_zeta gain' is there twice"),
    ],
)  # fmt: skip
def test_what_cannot_be_meant_is_refused_in_one_sentence(tmp_path, names, columns, head, words):
    with pytest.raises(InvalidInput, match=words) as error:
        read_response(written(tmp_path, table(names, *columns, head=head)))
    assert "\n" not in str(error.value) and "; " in str(error.value)


def mapped(tmp_path, headings, columns, **keys):
    text = table(["Freq", *headings], HERTZ, *columns, separator=";")
    paths = [{"quantity": "G", "read": "A_zeta", **keys}]
    said = {"machine": "toy", "point": POINT, "path": paths,
            "frequency": {"source": "Freq", "unit": "Hz"}}  # fmt: skip
    return read_response(written(tmp_path, text), said).paths[0].values


def test_two_units_of_one_path_are_refused(tmp_path):
    with pytest.raises(InvalidInput, match="two units, um/A and mm/A"):
        mapped(tmp_path, ("Re [um/A]", "Im [mm/A]"), (S.real, S.imag), real="Re", imag="Im")


@pytest.mark.parametrize(
    ("headings", "columns", "keys"),
    [
        (("Mag [dB]", "Ph [deg]"), (dB(S), deg(S)), {}),
        (("Mag [um/A]", "Ph [rad]"), (abs(S), np.angle(S)), {}),
        # a heading may be wrong: what the map says counts
        (("Mag [dB]", "Ph [deg]"), (dB(S), np.angle(S)), {"phase_unit": "rad"}),
        (("Mag [dB]", "Ph [deg]"), (abs(S), deg(S)), {"gain_unit": "abs"}),
    ],
)
def test_the_heading_states_what_the_map_does_not(tmp_path, headings, columns, keys):
    found = mapped(tmp_path, headings, columns, gain="Mag", phase="Ph", unit="um/A", **keys)
    np.testing.assert_allclose(found, 1e-6 * S, rtol=1e-6)


def test_noise_that_turns_an_unwrapped_phase_is_no_degrees(tmp_path):
    """Of a path between axes; on its own axis 300 rad are degrees."""
    phase = np.linspace(0, 300, len(HERTZ))
    keys = {"gain": "Mag", "phase": "Ph", "phase_unit": "rad", "unit": "um/A"}
    found = mapped(tmp_path, ("Mag", "Ph"), (abs(S), phase), injected="A_eta", **keys)
    np.testing.assert_allclose(found, 1e-6 * abs(S) * np.exp(1j * phase), rtol=1e-6)
    with pytest.raises(InvalidInput, match="it is in degrees"):
        mapped(tmp_path, ("Mag", "Ph"), (abs(S), phase), **keys)


def test_the_unit_in_a_heading_counts(tmp_path):
    text = table(["Freq [Hz]", "Re [um/A]", "Im [um/A]"], HERTZ, S.real, S.imag, separator=";")
    paths = [{"quantity": "G", "read": "A_zeta", "real": "Re", "imag": "Im"}]
    columns = {"machine": "toy", "point": POINT, "path": paths, "frequency": {"source": "Freq"}}
    found = read_response(written(tmp_path, text), columns).paths[0]
    np.testing.assert_allclose(found.values, 1e-6 * S)


def test_json_goes_both_ways_and_says_what_is_wrong(tmp_path):
    names = ["frequency [Hz]", "S A_zeta real", "S A_zeta imag", "S A_zeta deviation",
             "T A_eta/A_zeta current real", "T A_eta/A_zeta current imag"]  # fmt: skip
    columns = (HERTZ, S.real, S.imag, 0.01 * abs(S), T.real, T.imag)
    first = read_response(written(tmp_path, table(names, *columns, head=HEAD)))
    write_response(first, tmp_path / "own.json")
    assert holds_responses(tmp_path / "own.json")
    again = read_response(tmp_path / "own.json")
    assert again.attributes == first.attributes
    np.testing.assert_array_equal(again.omega, first.omega)
    for one, other in zip(again.paths, first.paths, strict=True):
        assert one.name == other.name
        np.testing.assert_array_equal(one.values, other.values)
        np.testing.assert_array_equal(one.variance, other.variance)
    document = json.loads((tmp_path / "own.json").read_text())
    by_hand = {**document, "paths": [{k: v for k, v in document["paths"][0].items()
                                      if k in {"quantity", "read", "real", "imag"}}]}  # fmt: skip
    found = read_response(written(tmp_path, json.dumps(by_hand), "hand.json"))
    assert [path.name for path in found.paths] == ["S A_zeta"]
    wrong = [({**by_hand, "frequency": "x"}, "frequency and"), ([], "no file of responses"),
             ({**by_hand, "paths": [{"quantity": "S"}]}, "real"),
             ({**by_hand, "speed_rad_s": "fast"}, "speed_rad_s"),
             ({**by_hand, "frequency": document["frequency"][:-1]}, "number of values")]  # fmt: skip
    for content, words in wrong:
        with pytest.raises(InvalidInput, match=words):
            read_response(written(tmp_path, json.dumps(content), "wrong.json"))
    with pytest.raises(InvalidInput):
        read_response(written(tmp_path, '{"format": "ambrose responses", ', "wrong.json"))
