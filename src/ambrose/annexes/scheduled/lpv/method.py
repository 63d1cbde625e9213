"""Method "lpv": one controller over a range of speeds, of seal pressures, or of both."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

from ambrose.options import Options, bar, count, ends, hertz, option, positive
from ambrose.synthesis.methods import Method, Progress

if TYPE_CHECKING:
    from ambrose.judge.result import Synthesis
    from ambrose.law.law import Scheduling
    from ambrose.model.plant import Plant

Ends = tuple[float, float]
_BACKOFF = "1.03 to 1.2 suits most uses"


def _backoff(value: Any, name: str) -> None:
    from ambrose.core.checks import check_positive, invalid

    if not 1 < check_positive(value, name, _BACKOFF) <= 2:
        raise invalid(name, value, "above 1 and at most 2", _BACKOFF)


@dataclass(frozen=True, slots=True, kw_only=True)
class Lpv(Method):
    """A controller scheduled over speed, pressure or both.

    bending_modes: how many the design model keeps per plane (None: none). speeds [rad/s], pressures
    [Pa], or both: lowest and highest that it is scheduled over (neither: the speeds of the
    operating points with the plant's seal pressure; where there is one speed alone, their
    pressures). speed_rate [rad/s^2], pressure_rate [Pa/s]: the fastest change (None: any), for
    which gamma may be lower. tolerances: designed over them as well. backoff [-]: how far above the
    smallest gamma it stays (None: 1.1; 1.2 over tolerances): nearer to 1 it is better, and faster.
    """

    name: ClassVar[str] = "lpv"
    title: ClassVar[str] = "LPV"

    bending_modes: int | None = option(
        None,
        "Bending modes per plane in the design model; default: none.",
        check=count("0 designs for the rigid rotor"),
    )
    speeds: tuple[float, float] | None = option(
        None,
        "Lowest and highest speed; default: those of the operating points at the same seal "
        "pressure; where those have one speed alone, their pressures.",
        flag="--speeds-hz",
        convert=hertz,
        check=ends,
    )
    speed_rate: float | None = option(
        None,
        "Fastest run-up that the proof covers, rad/s^2; default: any.",
        check=positive("give it in rad/s^2, or leave it out for any"),
    )
    pressures: tuple[float, float] | None = option(
        None,
        "Lowest and highest seal pressure, to schedule over it instead of the speed, or over both.",
        flag="--pressures-bar",
        convert=bar,
        check=ends,
    )
    pressure_rate: float | None = option(
        None,
        'Fastest change of the pressure that the proof covers, such as "20 bar/s"; default: any.',
        dimension="pressure per time",
        metavar="RATE",
        check=positive("give it in Pa/s, or leave it out for any"),
    )
    tolerances: bool = option(
        False, "Design over the machine's tolerances, too (mu, polish and tuned always do)."
    )
    backoff: float | None = option(
        None,
        "How far above the smallest gamma to stay; default 1.1, with --tolerances 1.2. Nearer to 1 "
        "it is better, with faster poles.",
        check=_backoff,
    )

    def __post_init__(self) -> None:
        from ambrose.core.checks import invalid

        Options.__post_init__(self)
        asked = self.schedules
        for along, limits, _ in asked if len(asked) > 1 else ():
            if limits is None:
                remedy = f"give the {along.name}s, or leave {along.name}_rate out"
                raise invalid(
                    f"{along.name}s", None, "given for a schedule over speed and pressure", remedy
                )

    @property
    def schedules(self) -> tuple[tuple[Scheduling, Ends | None, float | None], ...]:
        """What is asked to be scheduled over: parameter, its ends and its largest rate."""
        from ambrose.law.law import PRESSURE, SPEED

        ranges = (
            (SPEED, self.speeds, self.speed_rate),
            (PRESSURE, self.pressures, self.pressure_rate),
        )
        return tuple(item for item in ranges if item[1:] != (None, None))

    @classmethod
    def suits(cls, plant: Plant) -> bool:
        """Whether the operating points around the plant's give a range of speeds to schedule
        over.
        """
        radial = bool(plant.machine.bearings)
        return radial and _range_of_speeds(plant) and plant.machine.weights is not None

    def design(self, plant: Plant, progress: Progress) -> Synthesis:
        import numpy as np

        from ambrose.annexes.scheduled.lpv.machine import POINTS, POINTS_OF_TWO, design_schedule
        from ambrose.law.law import BOTH

        plant.machine.across_the_shaft("no law along it follows speed or pressure", "take mu")
        asked = self.schedules or ((_varied(plant), None, None),)
        along, points = (asked[0][0], POINTS) if len(asked) == 1 else (BOTH, POINTS_OF_TWO)
        grid = tuple(np.linspace(*limits, points) for _, limits, _ in asked if limits is not None)
        timing = self.timing()
        return design_schedule(
            plant,
            grid or None,
            along,
            bending_modes=self.bending_modes or 0,
            rate=tuple(rate for _, _, rate in asked),
            lag=0.0 if timing is None else timing.lag,
            tolerances=self.tolerances,
            backoff=self.backoff,
            progress=progress,
        )


def _range_of_speeds(plant: Plant) -> bool:
    from ambrose.annexes.scheduled.lpv.machine import schedule_grid
    from ambrose.core.checks import InvalidInput

    try:
        schedule_grid(plant.machine, plant.point)
    except InvalidInput:
        return False
    return True


def _varied(plant: Plant) -> Scheduling:
    """The pressure where the operating points around the plant's have several and one speed, else
    the speed.
    """
    from ambrose.law.law import PRESSURE, SPEED

    pressures = {
        p.seal_pressure for p in plant.machine.operation.envelope if p.speed == plant.point.speed
    }
    return PRESSURE if len(pressures) > 1 and not _range_of_speeds(plant) else SPEED
