"""How results show themselves: one line at a prompt, a table in a notebook, plain data for a
file.
"""

import ast
import json
import math
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import ambrose
from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import frequency_response
from ambrose.core.lft import ComplexBlock, FullBlock, GeneralizedPlant, RealBlock
from ambrose.core.mu.bounds import mu_bounds, mu_peak
from ambrose.core.norms import hinf_norm
from ambrose.core.presentation import (
    Presented,
    data_frame,
    html_table,
    json_text,
    to_plain,
    with_unit,
)
from ambrose.core.scheduled import ScheduledSystem
from ambrose.core.statespace import StateSpace


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Plain(Presented):
    name: str
    values: np.ndarray
    size: float = 1.5
    parts: tuple[RealBlock, ...] = ()
    more: tuple[float, ...] = ()


NAMES = [f"a signal with a long name, number {k}" for k in range(30)]
WIDE = StateSpace(
    -np.eye(3),
    np.ones((3, 30)),
    np.ones((30, 3)),
    np.zeros((30, 30)),
    NAMES,
    [f"{n} out" for n in NAMES],
)
LOOP = StateSpace([[-1.0]], [[1.0]], [[0.5]], [[0.0]], ["w"], ["z"])
BLOCKS = [FullBlock("an uncertainty of many channels", 1, 1)]
OMEGA = np.geomspace(0.1, 10, 5)
RESULTS = [
    WIDE,
    ScheduledSystem([100.0, 200.0], [WIDE, WIDE]),
    GeneralizedPlant(
        WIDE,
        NAMES[:20],
        NAMES[20:],
        [f"{n} out" for n in NAMES[:20]],
        [f"{n} out" for n in NAMES[20:]],
    ),
    frequency_response(WIDE, OMEGA),
    mu_bounds(frequency_response(LOOP, OMEGA).values, BLOCKS),
    mu_peak(LOOP, BLOCKS, OMEGA),
    hinf_norm(LOOP),
    Plain("a", np.zeros((2, 3)), 1.5, (RealBlock("k"),)),
]


@pytest.mark.parametrize("result", RESULTS, ids=lambda r: type(r).__name__)
def test_one_line_and_a_table(result):
    assert isinstance(result, Presented)
    assert len(repr(result)) < 200
    assert "\n" not in repr(result)
    assert repr(result).startswith(type(result).__name__)
    html = result._repr_html_()
    assert html.startswith("<table>") and type(result).__name__ in html
    if hasattr(result, "to_dict"):
        json.dumps(result.to_dict(), allow_nan=False)


@pytest.mark.parametrize(
    "block", [RealBlock("seal.k", 2), ComplexBlock("dynamics"), FullBlock("performance", 4, 4)]
)
def test_blocks_are_one_line_as_they_are(block):
    assert len(repr(block)) < 100
    assert eval(repr(block)) == block


def test_without_facts_of_its_own_it_shows_what_is_not_default():
    item = Plain("a", np.zeros((2, 3)), parts=(RealBlock("k"),))
    assert repr(item) == "Plain(name=a, values=array (2, 3), parts=1)"
    assert item.to_dict()["parts"] == [{"name": "k", "repeat": 1}]


def test_plain_data():
    assert to_plain({"a": (np.float64(1.0), np.inf, None), 2: np.array([[True]])}) == {
        "a": [1.0, "inf", None],
        "2": [[True]],
    }
    with pytest.raises(TypeError, match="object is not plain data"):
        to_plain(object())


def test_html_is_escaped():
    assert html_table([("<b>", "&")], "<i>", ("<u>",)).count("&lt;") == 3


def test_a_plain_number_has_no_unit():
    assert (with_unit(9.2331, "-"), with_unit(3.5, "mm")) == ("9.233", "3.5 mm")


def test_frame():
    pytest.importorskip("pandas")
    assert data_frame({"t": [0.0, 1.0], "y": [2.0, 3.0]}, "t").loc[1.0, "y"] == 3.0


def test_frame_without_pandas(monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InvalidInput, match="pip install pandas"):
        data_frame({"y": [1.0]})


# JSON that only this package reads again, or that hashes; schemas hold no result
_INWARD = {
    "annexes/campaigns/plan.py",
    "annexes/campaigns/run.py",
    "annexes/rotordynamics/comparison.py",
    "judge/controller_file.py",
    "judge/result.py",
    "machine/file/tables.py",
    "record/apart.py",
    "record/stream.py",
}


def test_json_of_the_package_has_no_infinity_and_no_nan():
    """RFC 8259, section 6: "Numeric values that cannot be represented in the grammar below (such as
    Infinity and NaN) are not permitted".
    """
    text = json_text({"gain": math.inf, "rows": [math.nan, 1.0], "array": np.array([-np.inf])})
    assert json.loads(text) == {"gain": "inf", "rows": ["nan", 1.0], "array": ["-inf"]}
    package = Path(ambrose.__file__).parent
    writers = {
        path.relative_to(package).as_posix()
        for path in package.rglob("*.py")
        if "json.dump" in (source := path.read_text(encoding="utf-8"))
        for call in ast.walk(ast.parse(source))
        if isinstance(call, ast.Call)
        and isinstance(call.func, ast.Attribute)
        and call.func.attr in {"dump", "dumps"}
        and isinstance(call.func.value, ast.Name)
        and call.func.value.id == "json"
        and not any(word.arg == "allow_nan" for word in call.keywords)
    }
    assert writers <= _INWARD, "take core.presentation.json_text"
