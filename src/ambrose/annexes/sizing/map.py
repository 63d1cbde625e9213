"""Magnets over pole area and bias current: which sizes guarantee what is asked, what binds, which
is the one to take.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ambrose.annexes.sizing.guarantee import RESERVE, Trial, attempt
from ambrose.annexes.sizing.magnets import SIZES, Size
from ambrose.core.arguments import names_wrong_types
from ambrose.core.checks import InvalidInput, check_positive, invalid
from ambrose.core.presentation import Presented, data_frame
from ambrose.machine.axial import across_the_shaft
from ambrose.machine.machine import Machine, require_magnets
from ambrose.synthesis.methods.tuned import Tuned

# over the machine file's, each step about sqrt(2): pole areas down to an eighth, bias currents
AREAS, BIASES = (0.12, 0.18, 0.25, 0.35, 0.5, 0.7, 1.0), (0.5, 0.7, 1.0)
_MOST = 400  # cells


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Sizing(Presented):
    """Every size that was tried, by area and bias; reserve: of force over static load, that was
    asked.
    """

    machine: Machine
    trials: tuple[Trial, ...]
    reserve: float

    @property
    def front(self) -> tuple[Trial, ...]:
        """Those that meet all and of which no other has both less volume and less copper loss, the
        smallest magnet first.
        """
        met = sorted(
            (t for t in self.trials if t.met), key=lambda t: (t.costs.volume, t.costs.copper_loss)
        )

        # by rising volume: a size is on the front where its loss is below all before it
        kept: list[Trial] = []
        for trial in met:
            if not kept or trial.costs.copper_loss < kept[-1].costs.copper_loss - 1e-12:
                kept.append(trial)
        return tuple(kept)

    @property
    def knee(self) -> Trial | None:
        """Of the front the one with the least product of volume and copper loss."""
        return min(self.front, key=lambda t: t.costs.volume * t.costs.copper_loss, default=None)

    @property
    def smaller(self) -> tuple[Trial, ...]:
        """What stands one step below the knee: the next smaller magnet, and the next lower bias."""
        knee = self.knee
        if knee is None:
            return ()
        areas = [
            t for t in self.trials if t.size.bias == knee.size.bias and t.size.area < knee.size.area
        ]
        biases = [
            t for t in self.trials if t.size.area == knee.size.area and t.size.bias < knee.size.bias
        ]
        return tuple(
            max(some, key=lambda t: (t.size.area, t.size.bias)) for some in (areas, biases) if some
        )

    @property
    def at_edge(self) -> bool:
        """Whether nothing smaller than the knee was tried, in area or in bias."""
        sizes, knee = [t.size for t in self.trials], self.knee
        return knee is not None and (
            knee.size.area == min(s.area for s in sizes)
            or knee.size.bias == min(s.bias for s in sizes) < max(s.bias for s in sizes)
        )

    def facts(self) -> Mapping[str, Any]:
        """How many sizes meet all, and the knee."""
        knee = self.knee
        told = f"{sum(t.met for t in self.trials)} of {len(self.trials)}"
        if knee is None:
            return {"sizes_that_meet_all": told, "knee": "none"}
        return {
            "sizes_that_meet_all": told,
            "knee": f"{knee.size.area:.3g} of the area at {knee.size.bias:.3g} of the bias",
            "copper_loss": knee.costs.copper_loss,
            "volt_amperes": knee.costs.volt_amperes,
        }

    def to_frame(self) -> Any:
        """A pandas.DataFrame with a row for each size."""
        rows = [
            (
                t.size.area,
                t.size.bias,
                t.met,
                t.ratio,
                t.sensitivity,
                t.gain,
                t.costs.copper_loss,
                t.costs.volt_amperes,
                t.costs.reserve,
                t.binding,
            )
            for t in self.trials
        ]
        names = (
            "area",
            "bias",
            "met",
            "ratio",
            "sensitivity",
            "gain [A/m]",
            "copper loss",
            "volt-amperes",
            "reserve",
            "binding",
        )
        return data_frame(dict(zip(names, zip(*rows, strict=True), strict=True)))


@names_wrong_types
def size(
    machine: Machine,
    areas: Sequence[float] = AREAS,
    biases: Sequence[float] = BIASES,
    method: Tuned | None = None,
    *,
    reserve: float = RESERVE,
    time_limit: float = 30.0,
    progress: Callable[[str], None] = lambda text: None,
) -> Sizing:
    """Try every pole area with every bias current, both over the machine file's.

    A size counts as sufficient where a controller of fixed order meets every requirement of the
    machine file at every operating point on the full plants, as the loop runs, and at the worst
    corners found of the tolerances around each; that none was found is no proof that there is none.
    reserve [-]: force at the largest control current over static load, at least. time_limit [s] of
    computing for each. Ctrl-C keeps the sizes that are done. Raises InvalidInput.
    """
    across_the_shaft(machine, SIZES)
    require_magnets(machine)
    method = (method or Tuned()).without_bank().on(machine)
    check_positive(
        reserve,
        "reserve",
        "2 is usual: as much force again as the static load takes",
        zero_allowed=True,
    )
    sizes = [
        Size(area, bias) for area in _sorted(areas, "areas") for bias in _sorted(biases, "biases")
    ]
    if len(sizes) > _MOST:
        raise invalid(
            "the number of sizes", len(sizes), f"at most {_MOST}", "take fewer areas or biases"
        )
    done: list[Trial] = []
    try:
        # from the machine file's size outwards, each begun with the nearest one's controller
        for item in sorted(sizes, key=_distance):
            near = min(
                (t for t in done if t.controller is not None),
                key=lambda t: _distance(t.size, item),
                default=None,
            )
            done.append(
                attempt(
                    machine,
                    item,
                    method,
                    reserve=reserve,
                    near=near,
                    time_limit=time_limit,
                    progress=progress,
                )
            )
    except KeyboardInterrupt:
        if not done:
            raise
    return Sizing(machine, tuple(sorted(done, key=lambda trial: trial.size)), reserve)


def _sorted(values: Sequence[float], what: str) -> list[float]:
    if not len(values):
        raise InvalidInput(
            f"no {what} were given; give shares of the machine file's, such as 0.5 and 1"
        )
    return sorted(
        {
            check_positive(value, f"one of the {what}", "give a share of the machine file's")
            for value in values
        }
    )


def _distance(one: Size, other: Size | None = None) -> float:
    # in the logarithms: a half is as far as the double
    other = other or Size()
    return float(np.hypot(np.log(one.area / other.area), np.log(one.bias / other.bias)))
