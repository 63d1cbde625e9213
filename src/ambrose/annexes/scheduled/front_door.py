"""What ``import ambrose as amb`` offers of this annex."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ambrose.api import controller_of, machine_of

if TYPE_CHECKING:
    from ambrose.annexes.scheduled.seal_monitor.history import SealHistory
    from ambrose.machine.machine import Machine


def monitor(machine: Machine | str, controller: Any, record: Any, **options: Any) -> SealHistory:
    """A seal's coefficients against time from one record of the running loop, with intervals and
    what they say.

    controller: the one that ran. record: a Record or a path, with y_<axis> [m], u_<axis> [A] and a
    small excitation e_<axis> [A]. options, see ``annexes.scheduled.seal_monitor.watch.monitor``:
    seal (None: the only one); unknown, such as ("pressure",) or ("k",); window [s]; rate [share of
    the file's value per s]; doubts; bending_modes; harmonics; computing_delay; progress. Raises
    InvalidInput.
    """
    from ambrose.annexes.scheduled.seal_monitor.watch import monitor as watch
    from ambrose.record.files import read_record

    loaded = controller_of(controller)
    measured = read_record(Path(record)) if isinstance(record, str | os.PathLike) else record
    law = loaded if loaded.nominal is None else loaded.nominal
    return watch(machine_of(machine), law, measured, **options)
