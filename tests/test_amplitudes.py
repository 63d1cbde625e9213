"""Every displacement, force, current or voltage that a program reads says whether it is zero to
peak (0p) or peak to peak (pp): keys of all JSON, names of all checks, the lateral schema, columns.

The outputs' keys are read from the sources: what functions that make data for JSON write down.
"""

import ast
import json
import re
from functools import cache
from pathlib import Path

import pytest

import ambrose

SOURCE = Path(ambrose.__file__).parent
DOCS = SOURCE.parents[1] / "docs"
SAYS = re.compile(r"(^|_)(0p|pp)(_|$)")
AMPLITUDE = re.compile(
    r"(^|_)(amplitude|orbit|motion|displacement|penetration|force|current|voltage|peak_m|peaks)"
    r"(s|_[mANV]|_um|_kN)?(_|$)"
)
# what oscillates with nothing: coefficients, limits of a machine, what lasts, names
NO_AMPLITUDE = {
    "force_per_current": "k_i",
    "force_per_current_left": "a share of k_i",
    "bias_current": "of both coils, lasting",
    "static_current": "of the weight",
    "static_current_A": "of the weight",
    "max_force": "a limit of the magnet",
    "force_when_a_coil_opens": "a limit of the magnet",
    "sensitivity_peak": "no displacement",
    "share_by_displacement": "of a stiffness",
    "currents": "how far two runs of a unit agree",
    "peaks": "of lateral.json: critical speeds, each with its amplitude_m_pp",
}
LASTING = {"axial.current": "holds the thrust", "axial.capacity": "a share"}


def makes_data(function):
    """Whether a function makes data for JSON, by its name or what it calls."""
    called = {
        getattr(node.func, "id", "") for node in ast.walk(function) if isinstance(node, ast.Call)
    }
    named = function.name in {"to_dict", "facts", "fall_data", "_plain", "_peak", "_curves"}
    return named or function.name == "_capacity" or {"say_json", "write_json"} & called


def keys_of(tree):
    """(line, key) of every dictionary that such functions write down."""
    for function in ast.walk(tree):
        if isinstance(function, ast.FunctionDef) and makes_data(function):
            for node in ast.walk(function):
                keys = node.keys if isinstance(node, ast.Dict) else []
                if isinstance(node, ast.Assign):
                    keys = [t.slice for t in node.targets if isinstance(t, ast.Subscript)]
                for key in keys:
                    if isinstance(key, ast.Constant) and isinstance(key.value, str):
                        yield key.lineno, key.value


def silent(key):
    return bool(AMPLITUDE.search(key)) and not SAYS.search(key) and key not in NO_AMPLITUDE


SOURCES = sorted(SOURCE.rglob("*.py"))


@cache
def trees():
    """Every source, by its path in the package."""
    return {
        path.relative_to(SOURCE): ast.parse(path.read_text(encoding="utf-8")) for path in SOURCES
    }


def test_a_key_that_does_not_say_is_found():
    assert silent("largest_displacement") and silent("force") and silent("amplitude_m")
    assert not silent("largest_displacement_0p") and not silent("motion_m_pp")
    tree = ast.parse('def to_dict(self):\n  a = {"orbit": 1}\n  a["voltage"] = 2\n  return a')
    assert {key for _, key in keys_of(tree)} == {"orbit", "voltage"}


def test_every_key_of_json_says_which():
    found, count = [], 0
    for path, tree in trees().items():
        for line, key in keys_of(tree):
            count += 1
            if silent(key):
                found.append(f"{path}:{line} {key}")
    assert count > 500
    assert not found


def test_every_check_of_an_amplitude_says_which():
    """judge(name, title, value, unit, ...), information and Check alike."""
    found, count = [], 0
    for path, tree in trees().items():
        for node in ast.walk(tree):
            if not (isinstance(node, ast.Call) and len(node.args) > 3):
                continue
            name, unit = node.args[0], node.args[3]
            if getattr(node.func, "id", "") not in {"judge", "information", "Check"}:
                continue
            texts = [getattr(part, "value", None) for part in (name, unit)]
            if all(isinstance(text, str) for text in texts) and texts[1] in {"m", "A", "N", "V"}:
                count += 1
                if not SAYS.search(texts[0]) and texts[0] not in LASTING:
                    found.append(f"{path}:{node.lineno} {texts[0]}")
    assert count >= 10
    assert not found


def keys_below(schema):
    if isinstance(schema, dict):
        yield from schema.get("properties", {})
        for value in schema.values():
            yield from keys_below(value)
    elif isinstance(schema, list):
        for value in schema:
            yield from keys_below(value)


def test_every_key_of_the_lateral_schema_says_which():
    keys = list(keys_below(json.loads((DOCS / "lateral.schema.json").read_text())))
    assert len(keys) > 60
    assert not [key for key in keys if silent(key)]


HEADS = re.compile(r"\[(um|µm|mm|m|N|A|V|kN)( (0|p)[-\u2011]p)?\]")


@pytest.mark.parametrize("page", ["capacity_table", "demand_table", "clearance_table"])
def test_column_heads_of_the_lateral_page_say_which(page):
    text = (SOURCE / "annexes" / "rotordynamics" / "page.py").read_text(encoding="utf-8")
    body = text[text.index(f"def {page}") :].split("\ndef ")[0]
    words = ("Motion", "Scaled motion", "Force", "Current", "Voltage", "Available")
    heads = [head for head in re.findall(r'"([^"]*\[[^"]*\])"', body) if head.startswith(words)]
    assert heads and all(HEADS.search(head)[2] for head in heads)
