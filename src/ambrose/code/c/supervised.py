"""What the templates of a scheduled controller say of the fixed one beside it, and of what a
reading has to keep to.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from ambrose.code.block.cost import padding_of
from ambrose.code.block.supervised import SupervisedBlock
from ambrose.code.c.literals import diagonals, literal
from ambrose.law.supervision import Fault, State


def supervision_facts(
    block: SupervisedBlock, arithmetic: str, table: Callable[[np.ndarray], str]
) -> dict[str, Any]:
    """The fixed law's tables, and the limits as numbers of the code; table: writes an array."""
    fixed = block.fallback
    watch = block.watch
    dt = block.sample_time
    low, high = padding_of(fixed)
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
        "B": table(fixed.B.T),
        "C": table(fixed.C.T),
        "D": table(fixed.D.T),
        "unwind": table(fixed.unwind[: fixed.winding].T),
        "diagonals": [
            {**d, "table": table(d["entries"])} for d in diagonals(fixed.increment, fixed.increment)
        ],
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
        "transfer_error": table(fixed.from_error.T),
        "transfer_current": table(fixed.from_output.T),
        "states": [item.name for item in State],
        "reasons": ["NO_DOUBT", *(item.name for item in Fault if item)],
        "doubts": doubts,
        "band_people": f"{watch.band:.6g}",
        "dwell_people": f"{watch.dwell:g}",
        "fade_people": f"{watch.fade:g}",
        **{name: literal(value, arithmetic) for name, value in numbers.items()},
    }
