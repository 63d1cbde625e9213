"""Units as C99: synchronous blocks beside any controller, and all axes; one function a sample,
without heap, recursion or library.

The twin is ``ambrose.law.synchronous_block``: the code takes the same steps in the same order.
The text is in templates/synchronous.c.j2 and .h.j2.
"""

import math
from collections.abc import Sequence
from functools import singledispatch
from typing import Any, cast

import numpy as np

from ambrose.code.block.block import Block, ControlBlock, as_comment, render
from ambrose.code.block.fixed_point import in_words
from ambrose.code.block.synchronous_twin import (
    ONE,
    PER_REST,
    PLACE,
    SIGNAL,
    SIXTH,
    BlockWords,
    SynchronousTwin,
    SynchronousWords,
)
from ambrose.code.c.code import (
    LARGEST,
    WORDS,
    Arithmetic,
    check_precision,
    code_types,
    generate,
    identity_facts,
    integer_table,
    literal,
    real_table,
    with_identity,
)
from ambrose.code.interface import TYPES, Law, interface_of
from ambrose.code.synchronous import (
    EVERY,
    SHARE,
    AllAxes,
    RunUnit,
    contact_counts,
    run_unit,
    run_up_of,
    words_of,
)
from ambrose.core.checks import invalid
from ambrose.law.synchronous_block import (
    DECAY,
    JUMP,
    LOST_TURNS,
    SECTORS,
    BlockLaw,
    SynchronousLaw,
    circle,
)

NEWTON = 12  # steps of the square root: enough for any amplitude up to 1e3 limits
FAR = 1e9  # turns beyond which the angle stands still: years without a pulse


def generate_synchronous(
    law: SynchronousLaw,
    name: str = "sync",
    arithmetic: str = "double",
    provenance: Sequence[str] = (),
) -> dict[str, str]:
    """The files of the blocks by name: <name>.h and .c.

    name: of files and functions; arithmetic: "double" or "float"; provenance: lines for the header.
    Raises InvalidInput.
    """
    if not (name.isidentifier() and name.isascii()):
        raise invalid(
            "the name of the synchronous code", repr(name), "a name in C", "letters, digits and _"
        )
    check_precision(arithmetic)
    table = real_table(arithmetic)
    n = law.channels
    dt = law.sample_time
    blocks = [_block(block, table, arithmetic, dt) for block in law.blocks]

    def number(value: float) -> str:
        return literal(value, arithmetic)

    columns = sum(block.drive.shape[2] for block in law.blocks)
    size = {"double": 8, "float": 4}[arithmetic]
    numbers = 2 * SECTORS + sum(
        2 * block.drive.size + len(block.speeds) + n for block in law.blocks
    )
    turning = sum(n * 8 * block.drive.shape[2] for block in law.blocks if block.per_turn)
    cost = {
        # at the end of a turn the table serves twice, for the mean's real and imaginary part
        "multiplications": 40 + n * (4 * columns + (14 + 2 * NEWTON) * len(law.blocks)) + turning,
        "additions": 40 + n * (6 * columns + (10 + NEWTON) * len(law.blocks)) + turning,
        "table_bytes": size * numbers,
    }
    facts: dict[str, Any] = {
        "name": name,
        "prefix": name.upper(),
        "n": n,
        "arithmetic": {"double": "double precision", "float": "single precision"}[arithmetic],
        "type": arithmetic,
        "sample_time": f"{dt:.9g}",
        "provenance": [as_comment(line) for line in provenance] or ["provenance: not given"],
        "blocks": blocks,
        "cost": cost,
        "sectors": SECTORS,
        "circle": table(circle()),
        "newton": NEWTON,
        "dt": number(dt),
        "fastest": number(law.fastest),
        "jump": number(JUMP),
        "lost_turns": number(LOST_TURNS),
        "two_pi": number(2 * math.pi),
        "per_radian": number(SECTORS / (2 * math.pi)),
        "sector_angle": number(2 * math.pi / SECTORS),
        "half": number(0.5),
        "sixth": number(1 / 6),
        "zero": number(0.0),
        "one": number(1.0),
        "fixed": False,
        "largest": LARGEST[arithmetic],
        "far": number(FAR),
        "per_turn": any(block.per_turn for block in law.blocks),
    }
    source = render("synchronous.c.j2", facts)
    known = identity_facts(name, source, code_types(arithmetic))
    header = render("synchronous.h.j2", {**facts, **known})
    return {f"{name}.h": header, f"{name}.c": with_identity(source, known)}


def _block(block: BlockLaw, table: Any, arithmetic: str, dt: float) -> dict[str, Any]:
    def number(value: float) -> str:
        return literal(value, arithmetic)

    count, n, m = block.drive.shape
    drive = block.drive.reshape(count, n * m)
    return {
        "count": count,
        "m": m,
        "speeds": table(block.speeds),
        "re": table(drive.real),
        "im": table(drive.imag),
        "limit": table(block.limit),
        "low": number(block.band[0]),
        "high": number(block.band[1]),
        "hysteresis": number(block.hysteresis),
        "gain": number(block.gain),
        "leak": number(block.leak),
        "ramp": number(dt / block.ramp),
        "fade": number(1 - dt / block.release),
        "hold": round(block.hold / dt),
        "release": round(DECAY * block.release / dt),
        "harmonic": block.harmonic,
        "subtracts": int(block.subtracts),
        "currents": int(block.reads_currents),
        "per_turn": int(block.per_turn),
    }


# Synchronous blocks as C99 in whole numbers, and the report of their formats.
#
# The twin is ``ambrose.code.block.synchronous_twin``: equal to the last bit. The text is in
# templates/synchronous_fixed.c.j2.


_ANGLES = 10_000  # at which the table is measured
_SETTINGS = 21


def generate_words(
    words: SynchronousWords, word: int, name: str = "sync", provenance: Sequence[str] = ()
) -> dict[str, str]:
    """The files of the blocks by name: <name>.h, .c and _report.md.

    word: 32 or 16, of the signals in and out; name: of files and functions; provenance: lines for
    the header.
    """
    law, n = words.law, words.law.channels
    blocks = [_fixed_block(block) for block in words.blocks]
    columns = sum(block.drive.shape[2] for block in law.blocks)
    sizes = [block.re.size * 2 + 3 * len(block.speeds) + n + _SETTINGS for block in words.blocks]
    facts: dict[str, Any] = {
        "name": name,
        "prefix": name.upper(),
        "n": n,
        "fixed": True,
        "word": word,
        "arithmetic": f"fixed point, {word} bits",
        "type": f"int{word}_t",
        "one": 1 << (word - 2),
        "up": 1 << (SIGNAL + 2 - word),
        "down": SIGNAL + 2 - word,
        "largest_word": 2 ** (word - 1) - 1,
        "sample_time": f"{law.sample_time:.9g}",
        "provenance": [as_comment(line) for line in provenance] or ["provenance: not given"],
        "blocks": blocks,
        "sectors": SECTORS,
        "circle": integer_table(words.table),
        "time_bits": words.time_bits,
        "slope_bits": words.slope_bits,
        "fastest": words.fastest,
        "per_rest": PER_REST,
        "third": SIXTH,
        "per_turn": any(block.per_turn for block in law.blocks),
        "cost": {
            # interpolated entries, their products, turning and moving, per block and channel
            "multiplications": 20 + n * (4 * columns + 20 * len(blocks)),
            "additions": 40 + n * (8 * columns + 30 * len(blocks)),
            "table_bytes": 4 * (2 * SECTORS + sum(sizes)),
        },
    }
    source = render("synchronous_fixed.c.j2", facts)
    known = identity_facts(name, source, {"int32_t": "i4"})
    return {
        f"{name}.h": render("synchronous.h.j2", {**facts, **known}),
        f"{name}.c": with_identity(source, known),
        f"{name}_report.md": render("sync_report.md.j2", {**facts, **_report(words, word)}),
    }


def _fixed_block(block: BlockWords) -> dict[str, Any]:
    """The tables of one block."""
    law = block.law
    count, n, m = block.re.shape
    gaps = max(count - 1, 1)  # of one speed: never read
    settings = [
        *(block.low, block.high, block.hysteresis, block.gain, block.gain_bits, block.leak),
        *(block.leak_bits, block.fade, block.fade_bits, block.ramp, block.drive_bits),
        *(block.headroom, block.amplitude_bits, block.hold, block.release, block.most, count),
        *(law.harmonic, law.subtracts, law.reads_currents, law.per_turn),
    ]
    return {
        "count": count,
        "m": m,
        "gaps": gaps,
        "settings": len(settings),
        "amplitude": block.amplitude_bits,
        "speeds": integer_table(block.speeds),
        "reciprocals": integer_table(np.resize(block.reciprocals, gaps)),
        "distances": integer_table(np.resize(block.reciprocal_bits, gaps)),
        "re": integer_table(block.re.reshape(count, n * m)),
        "im": integer_table(block.im.reshape(count, n * m)),
        "limit": integer_table(block.limit),
        "set": integer_table(np.array(settings, np.int64)),
    }


def table_found(words: SynchronousWords) -> float:
    """The largest error of cosine and sine over many angles."""
    twin, worst = SynchronousTwin(words), 0.0
    for theta in np.linspace(0, 2**32 - 1, _ANGLES).astype(np.int64).tolist():
        twin.angle.theta = theta
        cosine, sine = twin.turn(1)
        angle = 2 * math.pi * theta / 2**32
        worst = max(worst, abs(cosine / ONE - math.cos(angle)), abs(sine / ONE - math.sin(angle)))
    return worst


def _report(words: SynchronousWords, word: int) -> dict[str, Any]:
    dt = words.law.sample_time
    angle = words.angle_error
    return {
        "speed_lsb": f"{2 * math.pi / dt * 2.0**-PLACE:.2g}",
        "table_error": f"{words.table_error:.2g}",
        "table_found": f"{table_found(words):.2g}",
        "angle_error": f"{angle:.2g}",
        "c_error": f"{2.0 ** (1 - word):.2g}",
        "blocks": [
            {
                "drive_bits": block.drive_bits,
                "x_bits": SIGNAL - block.headroom,
                "amplitude": block.amplitude_bits,
                "relative": f"{block.relative:.2g}",
                "phase": f"{math.degrees(math.asin(min(block.relative, 1.0))):.2g}",
                "reading": f"{words.reading_error(block):.2g}",
                "gain": f"{block.gain * 2.0**-block.gain_bits / dt:.9g}",
                "leak": f"{block.leak * 2.0**-block.leak_bits / dt:.9g}",
                "fade": f"{dt / (block.fade * 2.0**-block.fade_bits):.9g}",
                "ramp": f"{dt * ONE / block.ramp:.9g}",
            }
            for block in words.blocks
        ],
    }


# A controller with synchronous blocks beside it as C99: the controller's files, the blocks' files,
# and one unit that runs both, with its own self-test.
#
# The twin is ``ambrose.code.synchronous``; the texts are templates/run.h.j2, run.c.j2 and
# run_test.c.j2.


_FLOAT = 2e-2  # of the largest current: how far single precision may be


def generate_run(
    unit: RunUnit,
    arithmetic: Arithmetic = "double",
    provenance: Sequence[str] = (),
    along: Sequence[str] = (),
) -> dict[str, str]:
    """The files of a unit by name: the controller's (``code.c.code.generate``), <name>_sync.h and
    .c, <name>_run.h, .c and _run_test.c, of fixed point also <name>_sync_report.md. Raises
    InvalidInput, also for fixed point beside a schedule.
    """
    base, sync = unit.base, f"{unit.base.name}_sync"
    files = generate(base, arithmetic, provenance)
    if word := WORDS.get(arithmetic, 0):
        files |= generate_words(words_of(unit), word, sync, provenance)
    else:
        files |= generate_synchronous(unit.law, sync, arithmetic, provenance)
    if arithmetic == "float":
        unit = unit.single()
    facts = _facts(unit, arithmetic, provenance) | _self_test(unit, arithmetic)
    for end in ("_run.h", "_run.c", "_run_test.c"):
        files[f"{base.name}{end}"] = render(f"{end[1:]}.j2", facts)
    return files


def _facts(unit: RunUnit, arithmetic: str, provenance: Sequence[str]) -> dict[str, Any]:
    base, word = unit.base, WORDS.get(arithmetic, 0)
    table = integer_table if word else real_table(arithmetic)
    touches = bool(np.isfinite(unit.contact).all())
    contact = contact_counts(unit, 1 << (word - 2)) if word else unit.contact
    floating = {"double": "double precision", "float": "single precision"}
    n, real = len(base.inputs), TYPES[arithmetic][0]
    return {
        "name": base.name,
        "prefix": base.name.upper(),
        "sync": f"{base.name.upper()}_SYNC",
        "n": n,
        "fixed": bool(word),
        "type": real,
        "arithmetic": floating.get(arithmetic, f"fixed point, {word} bits"),
        "sample_time": f"{base.sample_time:.9g}",
        "provenance": [as_comment(line) for line in provenance] or ["provenance: not given"],
        "supervised": base.watch is not None,
        "transfers": base.transfers,
        "touches": touches,
        "contact": table(contact) if touches else "",
        "error_limit": "" if word else table(base.error_limit),
        "zero": "0" if word else literal(0.0, arithmetic),
        "declared": interface_of(unit, arithmetic).declared(real, n, n, "valid"),
        "told": base.told,
        "told_parameters": "".join(f"{real} {one}, " for one in base.told),
    }


def _self_test(unit: RunUnit, arithmetic: str) -> dict[str, Any]:
    """Signals of whole numbers, as run_test.c.j2 makes them, and what the twin answers."""
    base, run_up = unit.base, run_up_of(unit)
    dt, n = base.sample_time, len(base.inputs)
    count, within = run_up.count, run_up.within()

    # the angle in 2^32 to a turn, and what it moves in a sample
    per_speed = dt / (2 * np.pi) * 2**32
    step, change = round(run_up.start * per_speed), round(run_up.slope * dt * per_speed)
    steps = step + change * np.arange(count)
    turn = np.concatenate([[0], np.cumsum(steps)[:-1]]) % 2**32
    pulses = np.where((turn < steps) & ~within["lost"], dt * (turn / steps), -1.0)

    # a triangle of each channel, |2^32 - at| - 2^30, at = turn + 1000000007 i
    at = (turn[:, None] + np.arange(n) * 1000000007) % 2**32
    wave = np.where(at < 2**31, at, 2**32 - at) - 2**30
    valid = np.ones((count, n), bool)
    valid[within["invalid"], 0] = False
    shown = slice(EVERY - 1, None, EVERY)
    facts: dict[str, Any] = {
        "rows": run_up.rows,
        "every": EVERY,
        "first": step,
        "change": change,
        "windows": {name: f"{a}, {b}" for name, (a, b) in run_up.windows.items()},
    }
    if word := WORDS.get(arithmetic, 0):
        # the same in counts: eight tenths or a tenth of the limit, and a word beyond it
        one = 1 << (word - 2)
        came = (turn < steps) & ~within["lost"]
        ages = np.where(came, turn * one // steps, -1)
        large = np.where(within["large"][:, None], 8 * wave, wave)
        counts = np.sign(large) * (np.abs(large) // (10 * (2**30 // one)))
        counts[within["none"], -1] = one // 2 * 3
        fixed = in_words(cast(ControlBlock, base), word)
        run = run_unit(
            unit, ages, counts, None, valid, within["contact"], ~within["off"], fixed=fixed
        )
        return facts | {
            "told_test": "",
            "currents": integer_table(run.currents[shown]),
            "faults": _whole(run.faults[shown]),
            "status": _whole(run.status[shown]),
            "tolerance": integer_table(np.zeros(n)),
        }
    scale = SHARE * base.error_limit / 2**30
    errors = wave * np.where(within["large"][:, None], 8.0 * scale, scale)
    errors[within["none"], -1] = np.nan

    # the schedule in the middle of its ranges
    middle = base.middle()
    told = np.full((count, len(middle)), middle)
    told = told[:, 0] if len(middle) == 1 else told
    texts = ["none" if math.isnan(value) else literal(value, arithmetic) for value in middle]
    run = run_unit(unit, pulses, errors, told, valid, within["contact"], ~within["off"])
    table, largest = real_table(arithmetic), np.abs(run.currents).max(axis=0)
    share = {"double": 1e-9, "float": _FLOAT}[arithmetic]
    return facts | {
        "sample_time_double": literal(dt, "double"),
        "told_test": "".join(f"{text}, " for text in texts),
        "scale": real_table("double")(scale),
        "currents": table(run.currents[shown]),
        "faults": _whole(run.faults[shown]),
        "status": _whole(run.status[shown]),
        "tolerance": table(np.maximum(share * largest, 1e-12)),
    }


def _whole(values: np.ndarray) -> str:
    lines = [", ".join(map(str, values[i : i + 24].tolist())) for i in range(0, len(values), 24)]
    return "{" + ",\n    ".join(lines) + "}"


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


law_files.register(RunUnit, generate_run)


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
