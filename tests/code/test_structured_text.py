"""Structured text parsed by blark and run, compiled by MATIEC and by STruC++ where installed;
against the block in Python.
"""

import csv
import re

import numpy as np
import pytest

import code_driver as driver
import st_compiled
from ambrose import StateSpace
from ambrose.code.block.run import FAULT, HELD, LIMITED, run_of
from ambrose.code.structured_text import generate_structured_text, literal
from ambrose.core.checks import InvalidInput
from example_blocks import CURRENT, gain_block, rig_block, small_block, small_controller
from needs import needs
from st_machine import FunctionBlock, parsed

matiec = needs("iec2c", "gcc")


def direct_block():
    """Small, with a direct term: every branch of the template but those of a gain."""
    K = small_controller()
    return small_block(system=StateSpace(K.A, K.B, K.C, [[100.0, -300.0]], K.inputs, K.outputs))


@pytest.fixture(scope="module")
def parsed_block():
    return parsed(
        generate_structured_text(direct_block(), provenance=["from (* here *) *) $N"])["small.st"]
    )


def play(fb, block, e, valid):
    currents, status = np.empty((len(e), len(block.outputs))), np.empty(len(e), int)
    for k, (row, good) in enumerate(zip(e.tolist(), valid.tolist(), strict=True)):
        inputs = dict(zip(block.inputs, row, strict=True)) | {
            f"valid_{n}": g for n, g in zip(block.inputs, good, strict=True)
        }
        v = fb(**inputs)
        currents[k] = [v[name] for name in block.outputs]
        status[k] = v["held"] + 2 * v["fault"] + 4 * v["limited"]
    return currents, status


def test_agrees_with_the_block_in_python(parsed_block):
    block = direct_block()
    e, valid = driver.adversarial(block, 4000, seed=7)
    expected = run_of(block, e, valid=valid)
    found, status = play(FunctionBlock(parsed_block), block, e, valid)
    assert np.abs(found - expected.currents).max() <= 1e-12 * block.current_limit.max()
    assert (status == expected.status).all()
    for bit in (HELD, FAULT, LIMITED):
        assert 0.01 < ((status & bit) > 0).mean() < 0.9


def test_track_and_reset(parsed_block):
    fb, block = FunctionBlock(parsed_block), direct_block()
    play(fb, block, *driver.adversarial(block, 200))
    errors = {"err_x": 1e-5, "err_y": -2e-5, "valid_err_x": True, "valid_err_y": True}
    for given, limited in ((0.7, 0.7), (5.0, 2.0), (-5.0, -2.0), (np.nan, 0.0)):
        assert fb(track=True, given_u_x=given, **errors)["u_x"] == limited
        assert fb(track=False, **errors)["u_x"] == pytest.approx(limited, abs=1e-11)
    fb(reset=True, **errors)
    fresh = FunctionBlock(parsed_block)
    assert fb(reset=True, **errors)["u_x"] == fresh(**errors)["u_x"]
    assert fb.v["state"] == fresh.v["state"]


def test_a_gain_without_states():
    block = gain_block()
    fb = FunctionBlock(parsed(generate_structured_text(block)["gain.st"]))
    e = np.array([[1e-4, -2e-4], [2e-4, 9e-4], [5e-4, 3.0]])
    found, status = play(fb, block, e, np.ones((3, 2), bool))
    expected = run_of(block, e)
    assert np.array_equal(found, expected.currents)
    assert status.tolist() == expected.status.tolist() == [0, LIMITED, HELD | LIMITED]


@matiec
@pytest.mark.parametrize("make", [rig_block, direct_block, gain_block])
def test_compiled_by_matiec(make, tmp_path):
    block = make()
    st_compiled.translated(
        generate_structured_text(block, provenance=["from (* here *) *)"]), block.name, tmp_path
    )
    e, valid = driver.adversarial(block, 100_000)
    expected = run_of(block, e, valid=valid)
    found, status = st_compiled.replay(block, tmp_path, e, valid)
    assert np.abs(found - expected.currents).max() <= 1e-12 * block.current_limit.max()
    assert (status == expected.status).all()
    assert st_compiled.selftest(block.name, tmp_path) == (96, 0, True)


@needs("STruC++", "g++", "node")
@pytest.mark.parametrize("make", [rig_block, direct_block])
def test_compiled_by_strucpp(make, tmp_path):
    block = make()
    e, valid = driver.adversarial(block, 100_000)
    expected = run_of(block, e, valid=valid)
    found, status, selftest = st_compiled.replay_strucpp(
        generate_structured_text(block), block, tmp_path, e, valid
    )
    assert np.abs(found - expected.currents).max() <= 1e-12 * block.current_limit.max()
    assert (status == expected.status).all()
    assert selftest == (96, 0, True)


@matiec
def test_single_precision_compiled_by_matiec(tmp_path):
    block = rig_block().single()
    st_compiled.translated(generate_structured_text(block, "float"), block.name, tmp_path)
    e = (
        np.random.default_rng(0)
        .normal(0, 0.2 * block.error_limit, (20_000, 4))
        .astype(np.float32)
        .astype(float)
    )
    expected = run_of(block, e)
    found, status = st_compiled.replay(block, tmp_path, e, np.ones(e.shape, bool), "float")
    assert np.abs(found - expected.currents).max() <= 1e-4 * CURRENT
    assert (status == expected.status).all()
    assert st_compiled.selftest(block.name, tmp_path)[1:] == (0, True)


@matiec
def test_tracking_compiled_by_matiec(tmp_path):
    block = rig_block()
    st_compiled.translated(generate_structured_text(block), block.name, tmp_path)
    given = [1.0, -0.5, 2.0, 0.25]
    e = np.tile([1e-6, -2e-6, 3e-6, 0.0], (4, 1))
    found, _ = st_compiled.replay(
        block,
        tmp_path,
        e,
        np.ones(e.shape, bool),
        track=np.array([1, 1, 1, 0]),
        given=np.tile(given, (4, 1)),
    )
    assert np.abs(found - given).max() <= 1e-11


@pytest.mark.parametrize("precision", ["double", "float"])
def test_every_number_is_a_literal_of_the_standard(precision):
    """Digits around a point, an exponent of whole digits, no suffix; and it gives the same number
    back.
    """
    for text in generate_structured_text(rig_block(), precision).values():
        code = re.sub(r"\(\*.*?\*\)", "", text, flags=re.DOTALL)
        for row in (
            csv.reader(code.splitlines())
            if "FUNCTION" not in code and "PROGRAM" not in code
            else []
        ):
            assert len(row) == 13
        if "END_" in code:
            numbers = re.findall(r"(?<![\w.])\d[\w.+-]*", code)
            bad = [n for n in numbers if not re.fullmatch(r"\d+|\d+\.\d+(E-?\d+)?|\d+\.\.\d+", n)]
            assert bad == []
            assert len(numbers) > 300
    for value in (1e-5, 1.0, 0.1, 5e-324, 1.7976931348623157e308, -(2.0**-40), 123456789.0):
        assert float(literal(value, "double")) == value


@pytest.mark.parametrize(
    "name",
    ["Step", "sin", "RETURN", "state", "a__b", "a_", "ton", "of", "Held", "x" * 25, "1a", "ä"],
)
def test_names_that_structured_text_reserves(name):
    K = StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]], ["err_A"], ["u_A"])
    with pytest.raises(InvalidInput, match=r"the name of the block is '.*', but must be"):
        generate_structured_text(small_block(name=name, system=K))


@pytest.mark.parametrize(
    ("inputs", "outputs", "message"),
    [
        (["err_"], ["u"], "'err_', but must be an identifier of IEC 61131-3"),
        (["err_a"], ["real"], "'real', but must be no word of structured text"),
        (["reset"], ["u_a"], "'reset', but must be no word"),
        (["a"], ["valid_a"], "'valid_a', but must be unique"),
        (["rig"], ["u_a"], "'rig', but must be unique"),
    ],
)
def test_signals_that_structured_text_reserves(inputs, outputs, message):
    K = StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]], inputs, outputs)
    with pytest.raises(InvalidInput, match=message):
        generate_structured_text(small_block(name="rig", system=K))


def test_fixed_point_is_refused():
    with pytest.raises(InvalidInput, match=r"'fixed32', but must be double or float; .* C code"):
        generate_structured_text(small_block(), "fixed32")
