"""A control block as IEC 61131-3 structured text: a function block, a program that tests it, its
vectors.

The language is the common part of the standard's second and third editions: arrays, FOR, IF; no
pointers, no methods, no library. Signs, order of the sums and limits are those of the generated C,
so results agree to the last digits.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import singledispatch
from typing import Any

import numpy as np

from ambrose.code.block.block import Block, ControlBlock, as_comment, render
from ambrose.code.block.fixed_point import MANTISSA, floating_error
from ambrose.code.block.run import (
    FLOOR,
    Vectors,
    as_csv,
    vectors_of,
)
from ambrose.code.block.scheduled import ScheduledBlock
from ambrose.code.c.code import (
    Precision,
    block_facts,
    diagonals,
    digits,
    lines_of,
    scheduled_tolerance,
)
from ambrose.code.interface import Law
from ambrose.core.checks import InvalidInput, invalid

_TYPES = {"double": "LREAL", "float": "REAL"}
_WORDS = """
abs abstract acos action add and any any_bit any_date any_derived any_elementary any_int
any_magnitude any_num any_real any_string array asin at atan bool by byte case char class concat
configuration constant continue cos ctd ctu ctud date date_and_time delete dint div do dt dword
else elsif en end_action end_case end_class end_configuration end_for end_function
end_function_block end_if end_interface end_method end_namespace end_program end_repeat
end_resource end_step end_struct end_transition end_type end_var end_while eno eq exit exp expt
extends f_edge f_trig false final find for from function function_block ge global gt if implements
initial_step insert int interface internal interval ldate ldt le left len limit lint ln log lreal
lt ltime ltod lword max method mid min mod move mul mux namespace ne non_retain not null of on or
override overlap pointer pou priority private program property protected public r_edge r_trig
read_only read_write real ref ref_to reference repeat replace resource retain return right rol ror
rs rtc sel sema shl shr sin single sint sqrt sr step string string# struct sub super tan task then
this time time_of_day to tod tof ton tp transition true trunc type udint uint ulint until usint
using var var_access var_config var_external var_global var_in_out var_input var_output var_temp
wchar when while with word wstring xor
"""  # keywords, types, functions and blocks of IEC 61131-3, and extensions of the largest tools
KEYWORDS = frozenset(_WORDS.split())
_IDENTIFIER = re.compile(r"[A-Za-z](_?[A-Za-z0-9])*")
_OWN = """
reset track held fault limited e u d state carry last missing error_limit current_limit ni no nx nw
first i j o good asked given sum change check block sample samples wrong done errors valid currents
status expected largest tolerance direct to_current from_error unwind transfer_error
transfer_current
"""  # what the function block and the test declare besides signals
_OWN_SCHEDULED = """
clamped behind grid told told_missing place moving target near far low pass q r w of_error of_state
on_state on_current core steady pick speeds pressures
"""


_SPELLED = {"B": "from_error", "C": "to_current", "D": "direct"}
_TRANSFER = ("transfer_error", "transfer_current", "steady", "pick")


@dataclass(frozen=True, slots=True)
class Table:
    """A constant array: its name, bounds as text, element type and initial values as text."""

    name: str
    bounds: str
    type: str
    values: str


def generate_structured_text(
    block: ControlBlock | ScheduledBlock,
    precision: Precision = "double",
    provenance: Sequence[str] = (),
) -> dict[str, str]:
    """<name>.st (the function block), <name>_test.st (a program that replays the vectors),
    <name>_vectors.csv.

    precision: "double" (LREAL) or "float" (REAL). Raises InvalidInput for names that structured
    text reserves.
    """
    if precision not in _TYPES:
        remedy = "structured text is written in floating point; take the C code for fixed point"
        raise invalid("arithmetic", repr(precision), "double or float", remedy)
    if precision == "float":
        block = block.single()
    check_names(block)
    run = vectors_of(block, precision == "float")
    facts = text_facts(block, precision, provenance)
    return {
        f"{block.name}.st": render("block.st.j2", {**facts, "tables": _tables(block, precision)}),
        f"{block.name}_test.st": render("test.st.j2", {**facts, **_test(block, run, precision)}),
        f"{block.name}_vectors.csv": as_csv(block, run),
    }


def check_names(block: ControlBlock | ScheduledBlock, more: frozenset[str] = frozenset()) -> None:
    """Names that structured text allows: case does not count, no two underscores in a row, no
    keyword, none of ours, none of ``more``. Raises InvalidInput.
    """
    own = more | frozenset(_OWN.split()) | {d["name"] for d in _diagonals(block)}
    if block.told:
        own |= frozenset(_OWN_SCHEDULED.split()) | {block.told[0], f"{block.told[0]}_held"}
    checked = [("the name of the block", block.name, "give another --name")]
    checked += [
        ("a signal's name", s, "give the controller's signals other names")
        for s in (*block.inputs, *block.outputs)
    ]
    for what, name, remedy in checked:
        if not _IDENTIFIER.fullmatch(name):
            wanted = (
                "an identifier of IEC 61131-3 (letters, digits, single underscores between them)"
            )
            raise invalid(what, repr(name), wanted, remedy)
        if name.lower() in KEYWORDS | own:
            raise invalid(
                what, repr(name), "no word of structured text or of the function block", remedy
            )
    every = [block.name, *block.inputs, *block.outputs, f"{block.name}_test", f"{block.name}_check"]
    every += [
        f"{part}_{name}"
        for part, names in (("valid", block.inputs), ("given", block.outputs))
        for name in names
    ]
    lower = [name.lower() for name in every]
    for name in every:
        if lower.count(name.lower()) > 1:
            raise invalid(
                "a signal's name",
                repr(name),
                "unique, capitals or not",
                "give the controller's signals other names",
            )


def _diagonals(block: ControlBlock | ScheduledBlock) -> list[dict[str, Any]]:
    return diagonals(block.fixed_increment, block.fixed_increment)


def text_facts(
    block: ControlBlock | ScheduledBlock, precision: Precision, provenance: Sequence[str]
) -> dict[str, Any]:
    """What every template of a block reads."""
    facts = {
        **block_facts(block),
        **block.said(),
        "type": _TYPES[precision],
        "diagonals": _diagonals(block),
        "provenance": [_comment(line) for line in provenance] or ["provenance: not given"],
        "floor": literal(FLOOR["float"], "float"),
        "scheduled": bool(block.told),
        "winding": block.winding,
        "cost": block.cost(precision),
    }
    for one, axis, limit, rate in block.alone:
        step = literal(rate * block.sample_time, precision) if np.isfinite(rate) else ""
        facts |= {
            "direct": True,
            "parameter": one.name,
            "unit": one.unit,
            "told_step": step,
            "low": literal(float(axis[0]), precision),
            "high": literal(float(axis[-1]), precision),
            "told_limit": literal(limit, precision),
        }
    return facts


def _tables(block: ControlBlock | ScheduledBlock, precision: Precision) -> list[Table]:
    arrays = block.tables()
    limits = {name: arrays.pop(name) for name in ("error_limit", "current_limit")}
    limits |= {d["name"]: d["entries"] for d in _diagonals(block)}
    if not block.transfers:
        arrays = {name: x for name, x in arrays.items() if name not in _TRANSFER}
    if not (block.told or block.D.any()):
        del arrays["D"]
    arrays = {_SPELLED.get(name, name): x for name, x in arrays.items() if x.size}
    return [table(name, x, precision) for name, x in (limits | arrays).items()]


def _test(
    block: ControlBlock | ScheduledBlock, run: Vectors, precision: Precision
) -> dict[str, Any]:
    told = {}
    if run.told is not None:
        tolerance = scheduled_tolerance(block, run, precision)
        # what is no number has no literal, and is treated as what is implausible
        none = 2.0 * block.over[0][2]
        told = {"told": values(np.nan_to_num(run.told, nan=none), precision)}
    else:
        # a cascade too is written as matrices here: their bound, not that of its sections
        bound = floating_error.dispatch(ControlBlock)
        tolerance = (
            1e-12 * block.raw_limit if precision == "double" else bound(block, MANTISSA["float"])
        )
    return {
        **told,
        "samples": len(run.errors),
        "errors": values(run.errors, precision),
        "currents": values(run.currents, precision),
        "tolerance": values(tolerance, precision),
        "status": whole_numbers(run.status),
        "valid": _lines(["TRUE" if v else "FALSE" for v in run.valid.ravel()]),
    }


def values(x: np.ndarray, precision: Precision) -> str:
    """The initial values of an array, the last index fastest, in lines."""
    return _lines([literal(float(v), precision) for v in x.ravel()])


def whole_numbers(x: np.ndarray) -> str:
    """The initial values of an array of whole numbers, in lines."""
    return _lines([str(int(v)) for v in x])


def _lines(items: Sequence[str]) -> str:
    return "\n        ".join(lines_of(items))


def literal(value: float, precision: Precision) -> str:
    """A number with the point that the standard demands: 1.0E-05, not 1e-05."""
    mantissa, _, exponent = digits(value, precision).partition("e")
    if "." not in mantissa:
        mantissa += ".0"
    return f"{mantissa}E{int(exponent)}" if exponent else mantissa


def _comment(text: str) -> str:
    """``text`` made safe inside (* *)."""
    return as_comment(text).replace("(*", "( *").replace("*)", "* )").replace("$", "_")


def table(name: str, x: np.ndarray, precision: Precision) -> Table:
    bounds = ", ".join(f"0..{size - 1}" for size in x.shape)
    return Table(name, bounds, _TYPES[precision], values(x, precision))


@singledispatch
def unit_structured_text(
    law: Law, precision: Precision = "double", provenance: Sequence[str] = ()
) -> dict[str, str]:
    """The files of a block, or of another unit that is registered. Raises InvalidInput, also for a
    unit of all axes.
    """
    raise InvalidInput("structured text has no unit of all axes; write C or an FMU")


unit_structured_text.register(Block, generate_structured_text)
