"""Trace: what a simulation returns, a Record and how it ended."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ambrose.core.checks import check_types
from ambrose.core.presentation import Presented, data_frame, to_plain
from ambrose.core.response import settling_time
from ambrose.record.record import Record


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Trace(Presented):
    """A simulated record and its outcome; an unstable loop is an outcome, not an error.

    stable: whether all poles of the linear loop lie to the left (at every speed looked at; for the
    rig, at the start and at the end). outcome: "completed", "limit exceeded" (a stable loop driven
    beyond the displacement limit) or "diverged"; on the rig also "touchdown" and "not levitated".
    text: the outcome in words. pole [rad/s]: the rightmost one, None without states. stopped_at
    [s]: where the record ends early, because the displacement limit was passed or the motion
    left all bounds. scenario: its name. speed_error: estimated error of holding the speed over
    short intervals during a run-up, as a fraction of the peak. touchdown_at [s]: first contact with
    a touchdown bearing after levitation. levitated_at [s]: since when it is levitated (0: from the
    start; None: not, or no rig). run_time, compile_time [s]: of the computer; the second
    includes all that precedes the first sample. laws: what controlled, by its part in the run, each
    with its digest.
    """

    record: Record
    scenario: str
    stable: bool
    outcome: str
    text: str
    pole: complex | None = None
    stopped_at: float | None = None
    speed_error: float = 0.0
    touchdown_at: float | None = None
    levitated_at: float | None = None
    run_time: float = 0.0
    compile_time: float = 0.0
    laws: tuple[tuple[str, str], ...] = ()

    def __post_init__(self) -> None:
        check_types(type(self).__post_init__, (self,), {})

    @property
    def passed(self) -> bool:
        """Whether the run came to its end, on a loop that is stable: what every verdict on a run
        says.
        """
        return self.outcome == "completed" and self.stable

    def facts(self) -> Mapping[str, Any]:
        """How it ended, what was simulated, for how long, and the largest displacement."""
        displacement = {name: value for name, value in peaks(self).items() if name.startswith("y_")}
        return {
            "scenario": self.scenario,
            "outcome": self.outcome,
            "stable": self.stable,
            "duration": f"{self.record.time[-1] if self.record.values.size else 0.0:.4g} s",
            **(
                {"largest_displacement_0p": f"{max(displacement.values()):.4g} m"}
                if displacement
                else {}
            ),
            "text": self.text,
        }

    def to_dict(self) -> dict[str, Any]:
        """The outcome and the largest magnitude of every signal, ready for JSON; the signals are in
        ``record``.
        """
        names = (
            "scenario",
            "stable",
            "outcome",
            "text",
            "stopped_at",
            "touchdown_at",
            "levitated_at",
            "speed_error",
        )
        pole = None if self.pole is None else [self.pole.real, self.pole.imag]
        return to_plain(
            {**{name: getattr(self, name) for name in names}, "pole": pole, "peaks_0p": peaks(self)}
        )

    def to_frame(self) -> Any:
        """A pandas.DataFrame over time [s] with one column "name [unit]" per signal. Raises
        InvalidInput without pandas.
        """
        record = self.record
        columns = {
            f"{n} [{u}]": row
            for n, u, row in zip(record.signals, record.units, record.values, strict=True)
        }
        return data_frame({"time [s]": record.time, **columns}, "time [s]")


def peaks(trace: Trace) -> dict[str, float]:
    """Largest magnitude of every signal, in its SI unit."""
    return dict(
        zip(trace.record.signals, np.abs(trace.record.values).max(axis=1).tolist(), strict=True)
    )


def settling(
    trace: Trace, signals: Sequence[str] | None = None, band: float = 0.05, start: float = 0.0
) -> float:
    """Time [s] after ``start`` from which the signals (default: all y_) stay within ``band`` of
    their common peak; else inf.

    A trace that stopped at the displacement limit never settles. Raises InvalidInput.
    """
    names = (
        [name for name in trace.record.signals if name.startswith("y_")]
        if signals is None
        else list(signals)
    )
    time = settling_time(trace.record.time, trace.record.select(names).values, band, start=start)
    return time if trace.stopped_at is None else np.inf
