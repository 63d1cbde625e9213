"""A block as C99: a source and a header, a self-test with its vectors, and a report of formats and
cost.

The text of the code is in templates/; here are its numbers. The block's arithmetic, signs and
timing: block/block.py, block/fixed_point.py, block/scheduled.py and docs/reference/c-code.md. The
code needs no library, no heap and no recursion.
"""

import hashlib
import math
import re
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import singledispatch
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from ambrose.code.block.block import (
    TOLD,
    TOLD_SECOND,
    Block,
    ControlBlock,
    as_comment,
    diagonals_of,
    render,
)
from ambrose.code.block.fixed_point import (
    HORIZON,
    LARGEST_ERROR,
    MANTISSA,
    Words,
    floating_error,
    gain_error,
    in_words,
    word_lengths,
)
from ambrose.code.block.run import FLOOR, Vectors, as_csv, vectors_of
from ambrose.code.block.scheduled import ScheduledBlock, SupervisedBlock
from ambrose.code.interface import KINDS, TYPES, AllAxes, Law, interface_of
from ambrose.core.checks import InvalidInput, invalid
from ambrose.core.scheduled import grid_points
from ambrose.law.supervision import Fault, State
from ambrose.machine.ordinary_file import write_files
from ambrose.version import __version__

# Numbers and tables as C writes them; text broken into lines.


_WIDTH = 118


def digits(value: float, arithmetic: str) -> str:
    """A number with all the digits of double or single precision. Raises InvalidInput where it is
    larger than that precision holds.
    """
    if arithmetic == "double":
        return f"{value:.17g}"
    largest = float(np.finfo(np.float32).max)
    if abs(value) > largest:
        raise invalid(
            "a number of the controller",
            f"{value:.3g}",
            f"at most {largest:.3g} in single precision",
            "export it in double precision, or correct the exponent in its file",
        )
    return f"{float(np.float32(value)):.9g}"


def literal(value: float, arithmetic: str) -> str:
    """A floating-point number as C writes it."""
    text = digits(value, arithmetic)
    if not any(c in text for c in ".en"):
        text += ".0"
    return text if arithmetic == "double" else f"{text}f"


def real_table(arithmetic: str) -> Callable[[np.ndarray], str]:
    """The function that writes an array as a C initialiser: floating-point numbers, whole ones as
    they are.
    """
    real = lambda v: literal(float(v), arithmetic)  # noqa: E731
    return lambda x: _initialiser(x, real) if x.dtype.kind == "f" else integer_table(x)


def integer_table(x: np.ndarray) -> str:
    """An array as a C initialiser of whole numbers."""
    return _initialiser(x, lambda v: str(int(v)))


def _initialiser(x: np.ndarray, form: Callable[[float], str], indent: str = "    ") -> str:
    """An array of any shape in nested braces, each number as ``form`` writes it."""
    if x.ndim > 1:
        rows = ",\n".join(f"{indent}{_initialiser(row, form, indent + '    ')}" for row in x)
        return "{\n" + rows + "\n" + indent[4:] + "}"
    return (
        "{"
        + f"\n{indent}    ".join(lines_of([form(value) for value in x], _WIDTH - len(indent)))
        + "}"
    )


def lines_of(items: Sequence[str], width: int = _WIDTH) -> list[str]:
    """Items with commas between them in lines of at most ``width`` characters."""
    lines, line = [], ""
    for i, text in enumerate(items):
        item = text + (", " if i + 1 < len(items) else "")
        if line and len(line) + len(item) > width:
            lines.append(line.rstrip())
            line = ""
        line += item
    return [*lines, line]


def diagonals(x: np.ndarray, pattern: np.ndarray) -> list[dict[str, Any]]:
    """The diagonals of x (n, n) that are not zero in ``pattern`` (n, n): offset k, name, how they
    index the states (i + k), and the entries x[i, i + k] row by row, zero outside the rows
    first..last that they reach.
    """
    n = len(x)
    listed = []
    for k in diagonals_of(pattern):
        entries = np.zeros(n, x.dtype)
        rows = np.arange(max(0, -k), min(n, n - k))
        entries[rows] = x[rows, rows + k]
        listed.append(
            {
                "offset": k,
                "name": f"{'below' if k < 0 else 'above'}_{abs(k)}" if k else "own",
                "shift": f" {'-' if k < 0 else '+'} {abs(k)}" if k else "",
                "entries": entries,
                "first": int(rows[0]),
                "last": int(rows[-1]),
            }
        )
    return listed


# What running code can be asked for: which code it is, and whether its tables are still those that
# were written.
#
# The checksum is CRC-32 (IEEE 802.3: polynomial 0xEDB88320 reflected, start and end inverted) over
# the numbers of the tables in the order of the text, least significant octet first whatever the
# processor's byte order. The tables are read back out of the text, so that none can be forgotten.


_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
_TABLE = re.compile(
    r"^static const (\w+) (\w+)((?:\[\w+\])+) =\s*(\{.*?\});[ \t]*$", re.DOTALL | re.M
)
_PLACES = ("law",)  # structures that point to tables
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_WORD = re.compile(r"[a-z_]\w*", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Table:
    """A constant table of a source text: the type of its numbers there, its name, and the numbers
    as they lie in memory, little-endian.
    """

    kind: str
    name: str
    numbers: np.ndarray


def tables_of(source: str, types: Mapping[str, str]) -> list[Table]:
    """The constant tables of a source in their order.

    types: {type in the text: numpy's}, such as {"real": "f8"}. Raises InvalidInput for a table
    whose numbers cannot be read: a defect of the text, not of the controller.
    """
    tables = []
    plain = _COMMENT.sub("", source).replace("unsigned char", "uchar")
    for kind, name, _, body in _TABLE.findall(plain):
        digits = re.sub(r"(?<=[\d.])f\b", "", body)  # 1.5f: of single precision
        left = _WORD.findall(_NUMBER.sub("", digits))
        if kind in _PLACES:
            continue
        if left or kind not in types:
            raise InvalidInput(f"the table {name} of type {kind} cannot be read back: {left[:3]}")
        numbers = np.array([float(n) for n in _NUMBER.findall(digits)])
        whole = types[kind][0] in "iu"
        if whole:  # 64-bit words do not fit a double
            numbers = np.array([int(n) for n in _NUMBER.findall(digits)])
        dtype = np.dtype(f"<{types[kind]}")
        tables.append(Table(kind.replace("uchar", "unsigned char"), name, numbers.astype(dtype)))
    return tables


def checksum(tables: list[Table]) -> int:
    """CRC-32 of the tables, one after the other."""
    value = 0
    for table in tables:
        value = zlib.crc32(table.numbers.tobytes(), value)
    return value


def identity_facts(name: str, source: str, types: Mapping[str, str]) -> dict[str, Any]:
    """What identity.c.j2 and identity.h.j2 say of a source text: its tables, their checksum, and
    the words that name this code: name, hash of the text, version of what wrote it.
    """
    tables = tables_of(source, types)
    text = hashlib.sha256(source.encode()).hexdigest()[:16]
    listed = [
        {"name": t.name, "kind": t.kind, "count": t.numbers.size, "octets": t.numbers.itemsize}
        for t in tables
    ]
    return {
        "name": name,
        "prefix": name.upper(),
        "identified": listed,
        "checksum": f"0x{checksum(tables):08X}u",
        "identity": f"{name} {text} ambrose {__version__}",
    }


def with_identity(source: str, facts: Mapping[str, Any]) -> str:
    """The source text with the functions that tell checksum and identity at its end."""
    return source + render("identity.c.j2", facts)


# What the templates of a scheduled controller say of the fixed one beside it, and of what a reading
# has to keep to.


def supervision_facts(
    block: SupervisedBlock, arithmetic: str, table: Callable[[np.ndarray], str]
) -> dict[str, Any]:
    """The fixed law's tables, and the limits as numbers of the code; table: writes an array."""
    fixed = block.fallback
    watch = block.watch
    dt = block.sample_time
    low, high = fixed.padding
    tables = _tables(fixed, table)
    fade, dwell, stuck = (block.samples(time) for time in (watch.fade, watch.dwell, watch.stuck))
    watched = math.isfinite(watch.rate)
    law = {
        "suffix": "_fixed",
        "varies": False,
        "nr": 0,
        "nx": fixed.n_states,
        "low": low,
        "padded": fixed.n_states + low + high,
        "winding": fixed.winding,
        **tables,
    }
    numbers = {
        "rate": watch.rate * dt if watched else 0.0,
        "noise": watch.noise,
        "band": watch.band,
        "lowest": watch.low - watch.margin,
        "highest": watch.high + watch.margin,
        "fade_step": dt / watch.fade if watch.fade else 0.0,
    }
    doubts = [
        "lost (not a number, infinite)",
        f"beyond {watch.low - watch.margin:.6g} to {watch.high + watch.margin:.6g} Pa",
    ]
    doubts += (
        [f"a step of more than {watch.noise:.6g} Pa and {watch.rate:.6g} Pa/s"] if watched else []
    )
    doubts += [f"the very same value for {watch.stuck:g} s"] if stuck is not None else []
    doubts += [f"further than {watch.band:.6g} Pa and its half width from the estimate"]
    return {
        "law": law,
        "watches_rate": watched,
        "fade": fade,
        "dwell": dwell,
        "stuck": stuck or 0,
        "transfer_error": tables["transfer_error"],
        "transfer_current": tables["transfer_current"],
        "states": [item.name for item in State],
        "reasons": ["NO_DOUBT", *(item.name for item in Fault if item)],
        "doubts": doubts,
        "band_people": f"{watch.band:.6g}",
        "dwell_people": f"{watch.dwell:g}",
        "fade_people": f"{watch.fade:g}",
        **{name: literal(value, arithmetic) for name, value in numbers.items()},
    }


Arithmetic = Literal["double", "float", "fixed32", "fixed16"]
Precision = Literal["double", "float"]
WORDS = {"fixed32": 32, "fixed16": 16}
_SINGLE_TOLERANCE = 1e-4  # of the current limit, of a scheduled block
LARGEST = {"double": "DBL_MAX", "float": "FLT_MAX"}
_DOUBLE_TOLERANCE = 1e-12  # of the current asked for


def generate(
    block: Block,
    arithmetic: Arithmetic = "double",
    provenance: Sequence[str] = (),
    largest_error: float = LARGEST_ERROR,
) -> dict[str, str]:
    """The files of a block by name: <name>.h, .c, _test.c, _vectors.csv and _report.md.

    arithmetic: "double", "float", "fixed32" or "fixed16" (see ``to_fixed_point`` for what that
    refuses, and for largest_error [-]); of a scheduled block "double" or "float". provenance: lines
    for the header: where the controller comes from and what it was verified on. Raises
    InvalidInput.
    """
    if arithmetic not in get_args(Arithmetic):
        raise invalid(
            "arithmetic", repr(arithmetic), " or ".join(get_args(Arithmetic)), "choose one of them"
        )
    if arithmetic == "float":
        block = block.single()
    parts = parts_in(block, arithmetic, largest_error)
    facts, kind = _facts(block, arithmetic, provenance) | parts.facts, parts.kind
    source = render(f"{parts.source}.c.j2", facts | parts.tables)
    facts |= identity_facts(block.name, source, code_types(arithmetic))
    texts = {
        ".h": (f"{kind}.h.j2", {}),
        "_test.c": ("selftest.c.j2", _replay(parts.run, parts.tolerance, arithmetic)),
        "_report.md": (f"{kind}_report.md.j2", parts.report),
    }
    written = {
        f"{block.name}{end}": render(template, facts | values)
        for end, (template, values) in texts.items()
    }
    sources = {f"{block.name}.c": with_identity(source, facts)}
    return sources | written | {f"{block.name}_vectors.csv": as_csv(block, parts.run)}


@dataclass(frozen=True, slots=True, eq=False)
class Parts:
    """What the files of a block say beside what all share: the templates' names, of header and
    report (kind) and of the source; facts; tables of the source; the report; the vectors, and how
    far code may be from them (p,) [A].
    """

    kind: str
    source: str
    facts: dict[str, Any]
    tables: dict[str, Any]
    report: dict[str, Any]
    run: Vectors
    tolerance: np.ndarray


@singledispatch
def parts_in(block: Block, arithmetic: str, largest_error: float = LARGEST_ERROR) -> Parts:
    """The parts of a block in an arithmetic. Raises InvalidInput."""
    raise NotImplementedError


@parts_in.register
def _(block: ControlBlock, arithmetic: str, largest_error: float = LARGEST_ERROR) -> Parts:
    word = WORDS.get(arithmetic, 0)
    fixed = in_words(block, word, largest_error) if word else None
    law, table = fixed or block, integer_table if word else real_table(arithmetic)
    run, facts = vectors_of(law, arithmetic == "float"), _word_facts(block, fixed, table)
    error = fixed.error if fixed else floating_error(block, MANTISSA[arithmetic])
    form = "cascade" if facts["cascade"] else "controller"
    tolerance = 0 * error
    if not word:
        # of a cascade over the samples of the test alone
        steps = len(run.errors) if facts["cascade"] else HORIZON
        tolerance = tolerance_in(arithmetic, block, floating_error(block, MANTISSA["float"], steps))
    report = {
        "sizes": ", ".join(str(k) for k in block.sizes) or "none",
        "outputs": _output_rows(block, error),
        "horizon": HORIZON,
        "rows": _formats(fixed) if fixed else [],
        "word_lengths": word_lengths(block),
    }
    tables = _tables(law, table) | {"floor": "" if word else literal(FLOOR[arithmetic], arithmetic)}
    source = f"{form}_fixed" if word else form
    return Parts("controller", source, facts, tables, report, run, tolerance)


@parts_in.register
def _(block: ScheduledBlock, arithmetic: str, largest_error: float = LARGEST_ERROR) -> Parts:
    check_precision(arithmetic)
    run = vectors_of(block, arithmetic == "float")
    tables, facts = _scheduled_tables(block, arithmetic), _schedule_facts(block, arithmetic)
    report, tolerance = _scheduled_report(block, run), scheduled_tolerance(block, run, arithmetic)
    return Parts("scheduled", "scheduled", facts, tables, report, run, tolerance)


@parts_in.register
def _(block: SupervisedBlock, arithmetic: str, largest_error: float = LARGEST_ERROR) -> Parts:
    parts = parts_in.dispatch(ScheduledBlock)(block, arithmetic)
    parts.facts["supervised"] = supervision_facts(block, arithmetic, real_table(arithmetic))
    return parts


def tolerance_in(arithmetic: str, block: Block, single: np.ndarray) -> np.ndarray:
    """How far code in floating point may be from the vectors (p,) [A]; single: in single
    precision.
    """
    return single if arithmetic == "float" else _DOUBLE_TOLERANCE * block.raw_limit


def code_types(arithmetic: str) -> dict[str, str]:
    """{type in the text: numpy's} of tables."""
    word = KINDS[TYPES[arithmetic][0]]
    return {"real": word, "word": word, "uchar": "u1", "int32_t": "i4"}


def scheduled_tolerance(block: Block, run: Vectors, arithmetic: str) -> np.ndarray:
    """How far code may be from the vectors (p,) [A]."""
    single = np.maximum(_SINGLE_TOLERANCE * block.current_limit, 4 * run.rounding)
    return tolerance_in(arithmetic, block, single)


def write_code(
    directory: str | Path,
    block: Block,
    arithmetic: Arithmetic = "double",
    provenance: Sequence[str] = (),
    largest_error: float = LARGEST_ERROR,
) -> list[Path]:
    """Generate the code and write it to ``directory`` (made if absent): all files, or none. Returns
    their paths.

    Raises InvalidInput, also where the directory cannot be written.
    """
    return write_files(directory, generate(block, arithmetic, provenance, largest_error))


def check_precision(arithmetic: str) -> None:
    """Refuse fixed point for a schedule. Raises InvalidInput."""
    if arithmetic not in get_args(Precision):
        remedy = (
            "words need bounds on every state while the schedule moves, and tight ones are proved "
            "where it rests alone; use double or float, or a fixed controller"
        )
        raise invalid(
            "arithmetic of a scheduled controller", repr(arithmetic), "double or float", remedy
        )


def block_facts(block: Block) -> dict[str, Any]:
    """What every target's text says of a block: its name, sizes, timing, signals and limits."""

    def signals(names: Sequence[str], limits: np.ndarray, unit: str) -> list[dict[str, str]]:
        return [
            {"name": name, "limit": f"{v:.9g}", "unit": unit}
            for name, v in zip(names, limits, strict=True)
        ]

    return {
        "name": block.name,
        "prefix": block.name.upper(),
        "ni": len(block.inputs),
        "no": len(block.outputs),
        "nx": block.n_states,
        "sample_time": f"{block.sample_time:.9g}",
        "rate": f"{1 / block.sample_time:.9g}",
        "delay": block.delay,
        "hold": block.hold_samples,
        "windup": f"{block.windup_time:g} s",
        "direct": bool(block.D.any()),
        "inputs": signals(block.inputs, block.error_limit, "m"),
        "outputs": signals(block.outputs, block.current_limit, "A"),
        "transfers": block.transfers,
    }


def _facts(block: Block, arithmetic: str, provenance: Sequence[str]) -> dict[str, Any]:
    """What header, source, self-test and report share."""
    word, (real, stored) = WORDS.get(arithmetic, 0), TYPES[arithmetic]
    floating = {"double": "double precision", "float": "single precision"}
    sizes = (f"{block.name.upper()}_INPUTS", f"{block.name.upper()}_OUTPUTS")
    return {
        **block_facts(block),
        "scheduled": bool(block.told),
        "fixed": bool(word),
        "word": word,
        "arithmetic": floating.get(arithmetic, f"fixed point, {word} bits"),
        "type": real,
        "state_type": stored,
        "declared": interface_of(block, arithmetic).declared(real, *sizes),
        "zero": "0" if word else literal(0.0, arithmetic),
        "largest": LARGEST.get(arithmetic, ""),
        "delay_text": _delay_text(block.delay),
        "cost": block.cost(arithmetic),
        "provenance": [as_comment(line) for line in provenance] or ["provenance: not given"],
    }


def _word_facts(
    block: ControlBlock, fixed: Words | None, table: Callable[[np.ndarray], str]
) -> dict[str, Any]:
    """What is added of a fixed controller: its paddings, and what a count is of its words."""
    low, high = block.padding
    facts: dict[str, Any] = {
        "winding": block.winding,
        "low": low,
        "padded": block.n_states + low + high,
        "error_unit": "m",
        "current_unit": "A",
        **(fixed or block).said(),
        "stages": [
            {
                "row": " ".join(table(np.asarray(row)).split()),
                "label": as_comment(stage.label),
                "largest": f"{largest:.4g}",
                "numbers": [f"{value:.9g}" for value in stage.coefficients],
            }
            for stage, row, largest in (fixed or block).listing()
        ],
    }
    if fixed is None:
        return facts
    one = 1 << fixed.signal_bits
    counts = np.concatenate([block.error_limit, block.current_limit]) / one
    return facts | {
        "error_unit": "counts of the limit",
        "current_unit": "counts of the limit",
        "one": one,
        "lsb": [f"{v:.17g}" for v in counts],
        "signal_bits": fixed.signal_bits,
        "state_bits": fixed.state_bits,
    }


def _schedule_facts(block: ScheduledBlock, arithmetic: str) -> dict[str, Any]:
    """What is added of a scheduled controller."""
    along, padding = block.along, block.padding
    motion_text = f"While the {along.name} moves no bound is proved."
    if block.motion.proved:
        farthest = block.motion.states.max(initial=0.0)
        motion_text = (
            f"For any motion of the {along.name}: within +-{farthest:.3g} (proved, conservative)."
        )
    return {
        **block.said(),
        "one": literal(1.0, arithmetic),
        "axes": _axes(block, arithmetic),
        "over": along.name,
        "corners": list(range(2 ** len(block.axes))),
        "low_padding": padding[0],
        "padded": block.n_states + sum(padding),
        "motion_text": motion_text,
        "supervised": False,
    }


def _axes(block: ScheduledBlock, arithmetic: str) -> list[dict[str, Any]]:
    """What the templates say of every parameter; ``suffix``: of its own fields in the block, where
    there are two.
    """
    rows, table = [], real_table(arithmetic)
    for i, (one, axis, limit, rate) in enumerate(block.over):
        low = float(axis[0])
        high = float(axis[-1])
        limited = bool(np.isfinite(rate))
        rows.append(
            {
                "name": one.name,
                "unit": one.unit,
                "rate_unit": one.rate_unit,
                "people": one.people,
                "count": len(axis),
                "suffix": f"_{one.name}" if block.along.parts else "",
                "bit": f"{(TOLD, TOLD_SECOND)[i]}u",
                "grid": table(axis),
                "low": f"{low:.6g}",
                "high": f"{high:.6g}",
                "low_people": f"{low / one.size:.4g}",
                "high_people": f"{high / one.size:.4g}",
                "lowest": literal(low, arithmetic),
                "highest": literal(high, arithmetic),
                "told_limit": literal(limit, arithmetic),
                "plausible": f"{limit:.6g}",
                "rate_limit": f"{rate:.9g}" if limited else "",
                "told_step": literal(rate * block.sample_time, arithmetic) if limited else "",
                "rate_text": f" The schedule follows at {rate:.6g} {one.rate_unit} at most."
                if limited
                else "",
            }
        )
    return rows


def _delay_text(delay: int) -> str:
    """What the design assumes of the time from errors to currents, delay [samples]."""
    if delay == 0:
        return (
            "The design assumes that the currents are set at once: within a small part of the "
            "sample."
        )
    count = "1 sample" if delay == 1 else f"{delay} samples"
    return (
        f"The design assumes that the currents are set {count} after the errors were measured, and "
        "held."
    )


def _tables(
    law: ControlBlock | ScheduledBlock | Words, table: Callable[[np.ndarray], str]
) -> dict[str, Any]:
    """The tables of a law as C, and the diagonals of its A - I."""
    rows = diagonals(law.fixed_increment, law.base.fixed_increment)
    return {
        **{name: table(x) for name, x in (law.tables() | law.section_tables()).items()},
        "diagonals": [{**row, "table": table(row["entries"])} for row in rows],
    }


def _scheduled_tables(block: ScheduledBlock, arithmetic: str) -> dict[str, Any]:
    """The tables of a schedule over its grid."""
    tables, nr = _tables(block, real_table(arithmetic)), block.changes.ranks[0]
    law = {name: tables[name] for name in ("B", "C", "D", "diagonals")}
    return {
        **tables,
        "law": {**law, "suffix": "", "varies": True, "nx": block.n_states, "nr": nr},
        "floor": literal(FLOOR[arithmetic], arithmetic),
    }


def _replay(run: Vectors, tolerance: np.ndarray, arithmetic: str) -> dict[str, Any]:
    """What the self-test holds: the vectors as C, and the tolerance."""
    table = integer_table if arithmetic in WORDS else real_table(arithmetic)
    number = (
        {"number_format": "%ld", "number_cast": "long"}
        if arithmetic in WORDS
        else {
            "number_format": "%.17g",
            "number_cast": "double",
        }
    )
    told_vectors = {}
    if run.told is not None:
        known, names = ~np.isnan(run.told), run.parameters
        given = zip(
            names,
            np.where(known, run.told, 0.0).reshape(len(known), -1).T,
            known.reshape(len(known), -1).T,
            strict=True,
        )
        told_vectors = {
            "told": [
                {"name": name, "numbers": table(v), "known": integer_table(k)}
                for name, v, k in given
            ]
        }
    return {
        "samples": len(run.errors),
        "errors": table(run.errors),
        "valid": integer_table(run.valid),
        "currents": table(run.currents),
        "status": integer_table(run.status),
        "tolerance": table(tolerance),
        **told_vectors,
        **number,
        "times": run.times is not None and integer_table(run.times),
        "moves": run.moves is not None and table(run.moves),
    }


def _output_rows(block: Block, error: np.ndarray) -> list[dict[str, str]]:
    """The report's table of outputs; error (p,) [A]."""
    return [
        {"name": name, "limit": f"{limit:.6g}", "raw": f"{raw:.4g}", "error": f"{off:.2g}"}
        for name, limit, raw, off in zip(
            block.outputs, block.current_limit, block.raw_limit, error, strict=True
        )
    ]


def _formats(fixed: Words) -> list[dict[str, str]]:
    """The report's table of rows: fraction bits, and the sum of the coefficients' sizes."""
    return [
        {"name": name, "bits": str(f), "total": f"{np.abs(row * np.exp2(-f)).sum():.3g}"}
        for names, matrix, bits in fixed.formats()
        for name, row, f in zip(names, matrix, bits, strict=False)  # unwind: the first states
    ]


def _scheduled_report(block: ScheduledBlock, run: Vectors) -> dict[str, Any]:
    """The report's tables of a schedule: outputs, and at every grid point the poles."""
    points = []
    for value, E, B, C, D, L in zip(
        grid_points(block.axes),
        block.increment,
        block.B,
        block.C,
        block.D,
        block.unwind,
        strict=True,
    ):
        # poles of the law, and while every current is limited: A - L C with the unwinding L
        z, led = (1 + np.linalg.eigvals(X) if len(X) else np.zeros(1) for X in (E, E - L @ C))
        distance, at = 1 - np.abs(z), list(zip(np.atleast_1d(value), block.along.each, strict=True))
        points.append(
            {
                "value": ", ".join(f"{v:.6g}" for v, _ in at),
                "people": ", ".join(f"{v / one.size:.4g}" for v, one in at),
                "radius": f"{np.abs(led).max():.6f}",
                "slow": f"{distance.min():.3g}",
                "fast": f"{distance.max():.3g}",
                "single": f"{gain_error(E, B, C, D, MANTISSA['float']):.2g}",
            }
        )
    return {"outputs": _output_rows(block, run.rounding), "points": points}


# The radial controller and the axial one as one C function of all axes.


_ROWS = 500  # samples of the self-test
_SIDES = ("INPUTS", "OUTPUTS")


@singledispatch
def law_files(
    law: Law, arithmetic: Arithmetic, provenance: Sequence[str] = (), along: Sequence[str] = ()
) -> dict[str, str]:
    """The files of a unit by name, whatever it runs. along: the provenance of the part along the
    shaft. Raises InvalidInput.
    """
    raise NotImplementedError


@law_files.register
def _(
    law: Block, arithmetic: Arithmetic, provenance: Sequence[str] = (), along: Sequence[str] = ()
) -> dict[str, str]:
    return generate(law, arithmetic, provenance)


@law_files.register
def _(
    law: AllAxes, arithmetic: Arithmetic, provenance: Sequence[str] = (), along: Sequence[str] = ()
) -> dict[str, str]:
    # <name>_axes.h, .c and _axes_test.c stand on the files of both parts
    radial, axial = law.radial, law.axial
    own, face = interface_of(radial, arithmetic), interface_of(law, arithmetic)
    base = radial.base
    fixed = arithmetic.startswith("fixed")
    zero, sizes = "0" if fixed else literal(0.0, arithmetic), f"{base.name.upper()}_AXES"
    # where nothing was told, no pulse came
    still = {"pulse": f"{zero} - 1", "flags": "0u"} | dict.fromkeys(base.told, zero)
    limits = [*base.error_limit.tolist(), *axial.error_limit.tolist()]
    scales = ["0.125" if fixed else literal(limit / 8, "double") for limit in limits]
    facts = {
        "name": base.name,
        "prefix": base.name.upper(),
        "header": f"{own.name}.h",
        "unit": own.memory,
        "init": f"{own.name}_init",
        "axial": axial.name,
        "axial_prefix": axial.name.upper(),
        "sample_time": f"{base.sample_time:.9g}",
        "inputs": [*base.inputs, *axial.inputs],
        "outputs": [*base.outputs, *axial.outputs],
        "declared": face.declared(f"{base.name}_real", *(f"{sizes}_{n}" for n in _SIDES)),
        "names": ", ".join(one.name for one in face.arguments),
        "called": ", ".join(still.get(one.name, one.name) for one in face.arguments[:-1]),
        "step_name": f"{own.name}_step",
        "sources": " ".join(face.sources),
        "rows": _ROWS,
        "fixed": fixed,
        # an eighth of every error's limit, the self-test's amplitude: in counts, or in metres
        "scales": f"{{{', '.join(scales)}}}",
    }
    ends = ("axes.h", "axes.c", "axes_test.c")
    return {
        **law_files(radial, arithmetic, provenance),
        **generate(axial, arithmetic, along),
        **{f"{base.name}_{end}": render(f"{end}.j2", facts) for end in ends},
    }
