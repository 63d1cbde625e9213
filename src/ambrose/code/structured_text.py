"""A control block as IEC 61131-3 structured text: a function block, a program that tests it, its
vectors.

The language is the common part of the standard's second and third editions: arrays, FOR, IF; no
pointers, no methods, no library. Signs, order of the sums and limits are those of the generated C,
so results agree to the last digits.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ambrose.code.block.cost import increment_of, scheduled_cost, step_cost
from ambrose.code.block.fixed import ControlBlock
from ambrose.code.block.names import as_comment
from ambrose.code.block.run import FLOOR
from ambrose.code.block.scheduled import ScheduledBlock
from ambrose.code.block.vectors import Vectors, as_csv, make_scheduled_vectors, make_vectors
from ambrose.code.block.word_length import MANTISSA, floating_error
from ambrose.code.c.code import Precision, block_facts, scheduled_tolerance
from ambrose.code.c.literals import diagonals, digits, lines_of
from ambrose.code.rendering import render
from ambrose.core.checks import invalid

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
    single = precision == "float"
    run = (
        make_scheduled_vectors(block, single)
        if isinstance(block, ScheduledBlock)
        else make_vectors(block, single=single)
    )
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
    if isinstance(block, ScheduledBlock):
        own |= frozenset(_OWN_SCHEDULED.split()) | {block.along.name, f"{block.along.name}_held"}
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
    increment = increment_of(block)
    return diagonals(increment, increment)


def text_facts(
    block: ControlBlock | ScheduledBlock, precision: Precision, provenance: Sequence[str]
) -> dict[str, Any]:
    """What every template of a block reads."""
    facts = {
        **block_facts(block),
        "type": _TYPES[precision],
        "diagonals": _diagonals(block),
        "provenance": [_comment(line) for line in provenance] or ["provenance: not given"],
        "floor": literal(FLOOR["float"], "float"),
        "scheduled": isinstance(block, ScheduledBlock),
    }
    if not isinstance(block, ScheduledBlock):
        return {**facts, "winding": block.winding, "cost": step_cost(block, precision)}
    (low, high), along = block.range, block.along
    step = literal(block.told_step, precision) if np.isfinite(block.told_step) else ""
    return {
        **facts,
        "winding": block.n_states,
        "cost": scheduled_cost(block, precision),
        "direct": True,
        "parameter": along.name,
        "unit": along.unit,
        "ng": len(block.grid),
        "passes": block.passes,
        "told_step": step,
        "low": literal(low, precision),
        "high": literal(high, precision),
        "told_limit": literal(block.told_limit, precision),
        "nr": block.changes.ranks[0],
        "nq": block.changes.ranks[1],
    }


def _scheduled_tables(block: ScheduledBlock) -> dict[str, np.ndarray]:
    n, changes = block.n_states, block.changes
    arrays = {"grid": block.grid, "direct": changes.fixed[n:, n:].T}
    if n:
        arrays |= {"from_error": changes.fixed[:n, n:].T, "to_current": changes.fixed[n:, :n].T}
        arrays["unwind"] = block.unwind.transpose(0, 2, 1)
    if changes.ranks[0]:
        arrays |= {
            "of_error": changes.right[:, n:].T,
            "core": changes.core.transpose(0, 2, 1),
            "on_current": changes.left[n:].T,
        }
    if changes.ranks[0] and n:
        arrays |= {"of_state": changes.right[:, :n].T, "on_state": changes.left[:n].T}
    if block.transfers:
        arrays |= {"steady": block.steady.transpose(0, 2, 1), "pick": block.pick.transpose(0, 2, 1)}
    return arrays


def _tables(block: ControlBlock | ScheduledBlock, precision: Precision) -> list[Table]:
    arrays = {"error_limit": block.error_limit, "current_limit": block.current_limit}
    arrays |= {d["name"]: d["entries"] for d in _diagonals(block)}
    arrays |= (
        _scheduled_tables(block) if isinstance(block, ScheduledBlock) else _fixed_tables(block)
    )
    return [
        Table(
            name,
            ", ".join(f"0..{count - 1}" for count in x.shape),
            _TYPES[precision],
            values(x, precision),
        )
        for name, x in arrays.items()
    ]


def _fixed_tables(block: ControlBlock) -> dict[str, np.ndarray]:
    arrays: dict[str, np.ndarray] = {}
    if block.n_states:
        arrays |= {"from_error": block.B.T, "to_current": block.C.T}
    if block.D.any():
        arrays["direct"] = block.D.T
    if block.winding:
        arrays["unwind"] = block.unwind[: block.winding].T
    if block.transfers:
        arrays |= {"transfer_error": block.from_error.T, "transfer_current": block.from_output.T}
    return arrays


def _test(
    block: ControlBlock | ScheduledBlock, run: Vectors, precision: Precision
) -> dict[str, Any]:
    told = {}
    if isinstance(block, ScheduledBlock):
        tolerance = scheduled_tolerance(block, run, precision)
        # what is no number has no literal, and is treated as what is implausible
        none = 2.0 * block.told_limit
        told = {"told": values(np.nan_to_num(np.asarray(run.told), nan=none), precision)}
    else:
        tolerance = (
            1e-12 * block.raw_limit
            if precision == "double"
            else floating_error(block, MANTISSA["float"])
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
