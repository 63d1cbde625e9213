"""Controllers of other programs in every form are the ones that scipy says they are, whatever file,
unit and sign.
"""

from __future__ import annotations

import json
import re
from pathlib import Path

import jsonschema
import numpy as np
import pytest
import scipy.io
import scipy.signal

import ambrose as amb
from ambrose.code.pipeline import export
from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import frequency_response
from ambrose.law.loop import timing_of

RATE = 1e4
OMEGA = np.geomspace(1.0, 2e4, 25)
AXES = ("A_zeta", "A_eta")
B, A = [5200.0, -9800.0, 4650.0, 12.0], [1.0, -1.61, 0.65, 0.0]
SCHEMA = json.loads(
    (Path(__file__).parents[2] / "docs" / "controller-table.schema.json").read_text()
)


def digital(b, a):
    """y[k] = b0 e[k] + b1 e[k-1] + ... - a1 y[k-1] - ..."""
    return scipy.signal.freqz(b, a, worN=OMEGA, fs=2 * np.pi * RATE)[1]


def response(controller):
    return frequency_response(controller, OMEGA).values


def read(tmp_path, content, **stated):
    (tmp_path / "k.json").write_text(json.dumps(content))
    jsonschema.validate(content, SCHEMA)
    return amb.read_controller(tmp_path / "k.json", **stated)


def test_difference_equations_of_unequal_length_in_csv_and_json(tmp_path):
    text = (
        "channel, b, a, rate_hz, delay_samples\nA_zeta, 5200 -9800 4650 12, 1 -1.61 0.65, 10000, "
        "2\nA_zeta, 2, 1, 10000, 2\n"
    )
    (tmp_path / "k.csv").write_text(text)
    item = {"b": B, "a": A[:3], "gain": 2}
    for found in (
        amb.read_controller(tmp_path / "k.csv"),
        read(tmp_path, {"rate_hz": RATE, "channels": {"A_zeta": item}}),
    ):
        np.testing.assert_allclose(
            response(found.controller)[:, 0, 0], 2 * digital(B, A), rtol=1e-9
        )
        assert found.controller.dt == 1 / RATE
    assert timing_of(None, amb.read_controller(tmp_path / "k.csv")).delay_samples == 2


@pytest.mark.parametrize("mark", [";", "\t"])
def test_other_separators_and_a_decimal_comma(mark, tmp_path):
    text = (
        f"channel{mark}b{mark}a{mark}rate_hz\nA_zeta{mark}5200 -9800 4650 12{mark}1 -1.61 "
        f"0.65{mark}10000\n"
    )
    (tmp_path / "k.csv").write_text(
        "\ufeff" + (text.replace(".", ",") if mark == ";" else text), encoding="utf-8"
    )
    np.testing.assert_allclose(
        response(amb.read_controller(tmp_path / "k.csv").controller)[:, 0, 0],
        digital(B, A),
        rtol=1e-9,
    )


def test_num_and_den_are_powers_of_z_and_of_s(tmp_path):
    sampled = read(
        tmp_path, {"Ts": 1 / RATE, "axes": ["A"], "num": [3.0], "den": [1.0, -0.5]}
    ).controller
    np.testing.assert_allclose(
        response(sampled)[:, 0, 0], 3 / (np.exp(1j * OMEGA / RATE) - 0.5), rtol=1e-9
    )
    for keys in (("num", "den"), ("b", "a")):
        content = {"channels": {"A": dict(zip(keys, ([3.0, 1.0], [2.0, 8.0, 5.0]), strict=True))}}
        analog = scipy.signal.freqs([3.0, 1.0], [2.0, 8.0, 5.0], worN=OMEGA)[1]
        np.testing.assert_allclose(
            response(read(tmp_path, content).controller)[:, 0, 0], analog, rtol=1e-9
        )


def test_a_channel_from_one_axis_to_another(tmp_path):
    channels = {
        "A_zeta": {"b": [1.0], "a": [1.0]},
        "A_eta -> A_zeta": {"b": B, "a": A},
        "A_zeta -> A_eta": {"b": [2.0], "a": [1.0]},
    }
    found = response(read(tmp_path, {"rate_hz": RATE, "channels": channels}).controller)
    np.testing.assert_allclose(found[:, 0, 1], digital(B, A), rtol=1e-9)
    np.testing.assert_allclose(found[0], [[1, found[0, 0, 1]], [2, 0]], rtol=1e-12)


def test_a_transfer_matrix_shares_states_where_the_denominator_is_one(tmp_path):
    b, a = [[B, [1.0]], [[0.0, 3.0], [0.0]]], [[A, A], [A, A]]
    found = read(tmp_path, {"rate_hz": RATE, "b": b, "a": a, "axes": list(AXES)}).controller
    expected = np.moveaxis([[digital(b[i][j], A) for j in range(2)] for i in range(2)], 2, 0)
    np.testing.assert_allclose(response(found), expected, rtol=1e-9, atol=1e-9)
    assert found.n_states == 6 and found.inputs == ("err_A_zeta", "err_A_eta")


def test_units_sign_and_names(tmp_path):
    plain = read(tmp_path, {"rate_hz": RATE, "channels": {"A_zeta": {"b": B, "a": A}}}).controller
    content = {"rate_hz": RATE, "input_unit": "um", "channels": {"x": {"b": B, "a": A}}}
    turned = read(
        tmp_path, content, output_unit="mA", input="displacement", axes="A_zeta"
    ).controller
    np.testing.assert_allclose(response(turned), -1e3 * response(plain), rtol=1e-12)
    assert turned.inputs == plain.inputs
    with pytest.raises(
        InvalidInput,
        match="input_unit is um in the file, and mm was stated; leave out the wrong one",
    ):
        read(tmp_path, content, input_unit="mm")


MATRICES = {
    "A": [[0.5, 0.1], [0.0, 0.9]],
    "B": [[1.0, 0.0], [0.0, 2.0]],
    "C": [[3.0, 0.0], [1.0, 1.0]],
}
EXPECTED = scipy.signal.dlti(*[np.array(MATRICES[k]) for k in "ABC"], np.zeros((2, 2)), dt=1 / RATE)


def matlab(name):
    b, a = np.array(B), np.array(A)
    cells = np.empty((2, 2), object)
    for place in np.ndindex(2, 2):
        cells[place] = b if place == (0, 0) else np.zeros(1)
    below = np.empty((2, 2), object)
    below[:] = [[a, a], [a, a]]
    return {
        "matrices": {
            **{key: np.array(value) for key, value in MATRICES.items()},
            "D": np.zeros((2, 2)),
            "Ts": 1e-4,
            "note": "x",
        },
        "struct": {
            "K": {**{key: np.array(value) for key, value in MATRICES.items()}, "Ts": 1e-4},
            "other": np.eye(3),
        },
        "one filter": {"b": b, "a": a, "Ts": 1e-4},
        "sections": {"sos": np.array([[*B[:3], *A[:3]]]), "g": 2.0, "Ts": 1e-4},
        "zeros and poles": {
            "z": np.array([0.5, -0.2]),
            "p": np.array([0.9 + 0.1j, 0.9 - 0.1j]),
            "k": 3.0,
            "Ts": 1e-4,
        },
        "structs": {
            "A_zeta": {"b": b, "a": a},
            "A_eta": {"sos": np.array([[*B[:3], *A[:3]]])},
            "Ts": 1e-4,
        },
        "cells": {"num": cells, "den": below, "Ts": 1e-4},
    }[name]


@pytest.mark.parametrize(
    "name", ["matrices", "struct", "one filter", "sections", "zeros and poles", "structs", "cells"]
)
def test_mat_files(name, tmp_path):
    scipy.io.savemat(tmp_path / "k.mat", matlab(name))
    found = amb.read_controller(tmp_path / "k.mat", default_axes=AXES).controller
    assert found.inputs == ("err_A_zeta", "err_A_eta") and found.dt == 1e-4
    values, z = response(found), np.exp(1j * OMEGA / RATE)
    one = {
        "one filter": digital(B, A),
        "structs": digital(B, A),
        "cells": digital(B, A),
        "sections": 2 * digital(B[:3], A[:3]),
        "zeros and poles": 3 * (z - 0.5) * (z + 0.2) / ((z - 0.9) ** 2 + 0.01),
    }.get(name)
    if one is not None:
        np.testing.assert_allclose(values[:, 0, 0], one, rtol=1e-9)
        last = {"cells": 0 * one, "structs": digital(B[:3], A[:3])}.get(name, one)
        np.testing.assert_allclose(values[:, 1, 1], last, rtol=1e-9)
    else:
        A_, B_, C_ = (np.array(MATRICES[key]) for key in "ABC")
        expected = [C_ @ np.linalg.solve(point * np.eye(2) - A_, B_) for point in z]
        np.testing.assert_allclose(values, expected, rtol=1e-9, atol=1e-15)


def test_what_export_writes_for_matlab_comes_back(tmp_path):
    pid = amb.design("seal-rig", "pid")
    delivery = export(
        pid,
        tmp_path,
        to="mat",
        machine=amb.load_machine("seal-rig"),
        force=True,
    )
    back = amb.read_controller(tmp_path / "controller.mat")
    assert (
        back.controller.inputs == pid.controller.inputs and timing_of(None, back).delay_samples == 1
    )
    np.testing.assert_allclose(
        response(back.controller), response(delivery.deployment.controller), rtol=1e-9, atol=1e-9
    )


PAGE = (Path(__file__).parents[2] / "docs" / "reference" / "controller-file.md").read_text()


@pytest.mark.parametrize("text", re.findall(r"```json\n(.*?)```", PAGE, re.DOTALL))
def test_json_of_the_page(text, tmp_path):
    assert read(tmp_path, json.loads(text)).controller.dt == 1e-4


@pytest.mark.parametrize("text", re.findall(r"```csv\n(.*?)```", PAGE, re.DOTALL))
def test_csv_of_the_page(text, tmp_path):
    (tmp_path / "k.csv").write_text(text)
    assert amb.read_controller(tmp_path / "k.csv").controller.n_states > 1


WRONG = {
    "no names": (
        {"b": B, "a": A, "rate_hz": 1e4},
        "one filter for every axis, and their names are not known",
    ),
    "no names of matrices": (
        {"A": [], "B": [], "C": [], "D": [[1.0]]},
        "its 1 channels have no names; name their axes",
    ),
    "another count": (
        {"A": [], "B": [], "C": [], "D": [[1.0]], "axes": ["a", "b"]},
        r"the number of axes is 2 \(a, b\), but",
    ),
    "size": (
        {"A": [[1.0]], "B": [[1.0]], "C": [[1.0, 2.0]], "D": [[0.0]], "axes": ["a"]},
        r"the size of C is \(1, 2\)",
    ),
    "unit": (
        {"input_unit": "kg", "channels": {"a": {"b": [1], "a": [1]}}},
        'input_unit is "kg", but must be a unit of length',
    ),
    "input": (
        {"input": "force", "channels": {"a": {"b": [1], "a": [1]}}},
        r"must be error \(r - y\) or displacement",
    ),
    "delay": (
        {"delay_samples": 1.5, "channels": {"a": {"b": [1], "a": [1]}}},
        "delay_samples is 1.5, but must be a whole",
    ),
    "sample time": ({"Ts": -1, "channels": {"a": {"b": [1], "a": [1]}}}, "the sample time is -1 s"),
    "leading zero": (
        {"rate_hz": 1, "channels": {"a": {"b": [1], "a": [0, 1]}}},
        "begins with 0 .*divide by a factor",
    ),
    "list": (
        {"input": ["error"], "channels": {"a": {"b": [1], "a": [1]}}},
        r"must be error \(r - y\) or displacement",
    ),
    "complex": (
        {"channels": {"a": {"b": ["1+2j"], "a": [1]}}},
        "'1\\+2j' is complex, but a coefficient is real",
    ),
    "overflow": ({"channels": {"a": {"b": [1e300], "a": [1e-300]}}}, "finite"),
    "empty": ({"b": [[[1.0]]], "a": [], "axes": ["a"]}, "the rows of a have different lengths"),
    "improper": (
        {"channels": {"a": {"b": [1, 0, 0], "a": [1, 1]}}},
        "degree is not below the numerator's",
    ),
    "half a name": (
        {"channels": {"a ->": {"b": [1], "a": [1]}}},
        "name the axes, such as A_zeta, or A_zeta -> B_zeta",
    ),
    "not square": (
        {"b": [[[1.0], [1.0]]], "a": [[[1.0], [1.0]]], "axes": ["a"]},
        "must be square and the same",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_cannot_be_meant_is_refused_in_a_sentence(name, tmp_path):
    content, message = WRONG[name]
    (tmp_path / "k.json").write_text(json.dumps(content))
    with pytest.raises(InvalidInput, match=message) as caught:
        amb.read_controller(tmp_path / "k.json")
    assert "\n" not in str(caught.value) and "; " in str(caught.value)


def test_mat_files_that_hold_no_controller_are_refused(tmp_path):
    scipy.io.savemat(tmp_path / "k.mat", {"x": 1.0})
    with pytest.raises(InvalidInput, match=r"it has no controller \(x\); save b and a"):
        amb.read_controller(tmp_path / "k.mat")
    (tmp_path / "k.mat").write_bytes(b"no MAT-file")
    with pytest.raises(InvalidInput, match=r"k\.mat: it cannot be read"):
        amb.read_controller(tmp_path / "k.mat")
    with pytest.raises(
        InvalidInput, match="what is stated of a controller is 'rate', but must be one of rate_hz"
    ):
        amb.read_controller(tmp_path / "k.mat", rate=1.0)
