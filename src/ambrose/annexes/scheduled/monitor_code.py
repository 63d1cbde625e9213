"""The seal monitor as C99: one parameter of one seal, no heap, no library; what it does:
identification/seal_monitor.

The observer's filters run in modal coordinates, and what a parameter changes enters through the few
directions it has.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ambrose.annexes.scheduled.seal_monitor.model import Direction
from ambrose.annexes.scheduled.seal_monitor.watch import OLD, WIDE, SealMonitor
from ambrose.code.block.names import as_comment
from ambrose.code.c.literals import integer_table, real_table
from ambrose.code.rendering import render
from ambrose.core.checks import InvalidInput
from ambrose.core.realisation.modal_form import modal_form
from ambrose.core.statespace import StateSpace
from ambrose.machine.atomic_write import write_files

_RANK = 1e-9  # of the largest: directions that are no more are left out
_TABLE = real_table("double")


def generate_monitor(following: SealMonitor, name: str = "seal_monitor") -> dict[str, str]:
    """The files <name>.h and <name>.c of a monitor of one parameter. Raises InvalidInput."""
    model = following.model
    if len(model.unknown) != 1:
        raise InvalidInput(
            f"the C code watches one parameter, not {len(model.unknown)}; name one unknown"
        )
    n, m = model.B.shape
    p, c = len(model.C), len(model.doubts)
    family = modal_form(_states(model.observer))
    into, back = family.system.B, family.system.C
    law = model.law
    A, B = model.loop
    seen = np.vstack([np.eye(n, len(A)), np.hstack([-law.D @ model.C, law.C])])
    loop = modal_form(StateSpace(A, B, seen, np.zeros((n + m, m)), dt=model.dt)).system
    rows: list[dict[str, Any]] = []
    for label, direction in [
        ("linear", model.unknown[0]),
        ("square", model.squares[0]),
        *((f"doubt{i}", d) for i, d in enumerate(model.doubts)),
    ]:
        U, V = _factors(direction)
        rows.append(
            {
                "label": label,
                "rank": U.shape[1],
                "U": _TABLE(into @ U),
                "Vx": _TABLE(V[:, :n] @ back),
                "Vv": _TABLE(V[:, n:]),
                "size": U.shape[1] * (2 * n + m),
            }
        )
    U, V = _factors(model.unknown[0])
    H = V @ loop.C
    own, ends = _rows(family.system.A)
    looped, loop_ends = _rows(loop.A)
    sections, filters = following.filters.sections, 2 * m + p
    kinds = np.unique(model.kinds, return_inverse=True)[1]
    cost = (
        5 * len(sections) * filters
        + (4 + c) * len(own)
        + len(looped)
        + n * (m + p)
        + 3 * n * p
        + sum(row["size"] for row in rows)
        + 2 * rows[0]["size"]
        + len(loop.A) * (m + len(U.T))
        + (4 + c) * p * p
    )
    values = {
        "name": name,
        "prefix": name.upper(),
        "n": n,
        "m": m,
        "p": p,
        "c": c,
        "nl": len(loop.A),
        "sections": _TABLE(sections),
        "ns": len(sections),
        "filters": filters,
        "rows": rows,
        "doubts": rows[2:],
        "rank": len(H),
        "observer": _TABLE(own),
        "observer_size": len(own),
        "observer_columns": integer_table(ends),
        "loop": _TABLE(looped),
        "loop_size": len(looped),
        "loop_columns": integer_table(loop_ends),
        "into": _TABLE(into @ np.hstack([model.B, model.L])),
        "out": _TABLE(model.C @ back),
        "white": _TABLE(model.W),
        "loop_in": _TABLE(loop.B),
        "H": _TABLE(H),
        "loop_U": _TABLE(into @ U),
        "loop_V": _TABLE(V[:, n:]),
        "kinds": integer_table(kinds),
        "nk": int(kinds.max(initial=-1)) + 1,
        "block": following.block,
        "wait": round(following.settling / model.dt),
        "step": following.block * model.dt,
        "rate": following.rate,
        "windows": _TABLE(np.array(following.windows)),
        "reference": float(model.reference[0]),
        "fade": _TABLE(np.exp(-following.block * model.dt / np.array(following.windows))),
        "dt": model.dt,
        "wide": WIDE,
        "oldest": OLD * following.window,
        "path": as_comment(model.paths[0]),
        "axes": as_comment(", ".join(model.axes)),
        "cost": int(cost),
        "bytes": 8
        * (
            filters * (1 + 2 * len(sections))
            + (4 + c) * n
            + len(loop.A)
            + 4
            + c
            + 2 * (3 + 6 + c + 3)
        ),
    }
    return {f"{name}{end}": render(f"monitor{end}.j2", values) for end in (".h", ".c")}


def write_monitor(
    directory: str | Path, following: SealMonitor, name: str = "seal_monitor"
) -> list[Path]:
    """Generate the code and write it to ``directory`` (made if absent). Returns the files' paths.
    Raises InvalidInput.
    """
    return write_files(directory, generate_monitor(following, name))


def _states(A: np.ndarray) -> StateSpace:
    return StateSpace(A, np.eye(len(A)), np.eye(len(A)), np.zeros(A.shape), dt=1.0)


def _factors(direction: Direction) -> tuple[np.ndarray, np.ndarray]:
    """U (n, r) and V (r, n + m) of [D N], each state and input scaled to the same size first."""
    whole = np.hstack([direction.D, direction.N])
    size = np.maximum(np.abs(whole).max(axis=0), 1e-12 * max(float(np.abs(whole).max()), 1e-300))
    U, s, V = np.linalg.svd(whole / size, full_matrices=False)
    rank = max(1, int((s > _RANK * s[0]).sum()))
    return U[:, :rank] * s[:rank], V[:rank] * size


def _rows(A: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of every row of A (n, n) the entries from its first to its last that is not zero, and where
    they begin and end (n, 2).
    """
    at = [np.flatnonzero(row) for row in A]
    ends = np.array([(int(k[0]), int(k[-1]) + 1) if len(k) else (0, 0) for k in at])
    return np.concatenate(
        [row[first:last] for row, (first, last) in zip(A, ends, strict=True)]
    ), ends
