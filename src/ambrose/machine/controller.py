"""The controller as vendors ship it: settings of a PID for all axes, or for every channel a chain
of filter sections.

A channel is a bearing axis ("A_zeta"), or with coordinates "tilt-translate" a translation, a tilt
or a bending (``modal_channels``). Formulas and state-space forms of the sections are in
``law/filters.py``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import inf
from typing import Annotated, Any

from ambrose.machine.kinds import Angle, Choice, ListOf, PairOf, Quantity, Rate, Ratio, Texts, Time
from ambrose.machine.part import Part
from ambrose.machine.synchronous import Synchronous

Pair = tuple[float, float]

CONTROLLER_COORDINATES = ("axes", "tilt-translate")
MODES = ("translate_x", "translate_y", "tilt_x", "tilt_y")


def modal_channels(bearings: int) -> tuple[str, ...]:
    """The channels of "tilt-translate" for so many bearings: one cannot tilt, three and more bend
    as well.
    """
    bent = tuple(f"bend_{k}_{plane}" for k in range(1, bearings - 1) for plane in "xy")
    return (MODES if bearings > 1 else MODES[:2]) + bent


SECTIONS: Mapping[str, tuple[str, ...]] = {  # the keys of every kind; of a PID's those in use
    "pid": ("integral_time", "derivative_time", "derivative_filter"),
    "notch": ("zero_frequency", "zero_damping", "pole_frequency", "pole_damping"),
    "phase-bump": ("frequency", "phase", "damping"),
    "lead-lag": ("zero_frequency", "pole_frequency"),
    "low-pass": ("frequency", "damping"),
    "sos": ("numerator", "denominator"),
}


@dataclass(frozen=True, slots=True, repr=False)
class Section(Part):
    """One section of a channel's chain, of order two at most; all but "sos" have unit gain at DC (a
    PID: without its integral).

    "pid": 1 + 1/(T_i s) + T_d s/(eps T_d s + 1). "notch": (s^2/w_z^2 + 2 d_z s/w_z + 1)/(s^2/w_p^2
    + 2 d_p s/w_p + 1). "phase-bump": a notch whose zeros and poles have one damping and lie on
    either side of a frequency, turned by ``phase``. "lead-lag": (s/w_z + 1)/(s/w_p + 1).
    "low-pass": 1/(s^2/w^2 + 2 d s/w + 1). "sos": any, by coefficients of s^2, s and 1.
    """

    kind: Annotated[str, Choice(tuple(SECTIONS)), "which filter it is"]
    integral_time: Annotated[Time | None, 'T_i of a "pid"; default: no integral part'] = None
    derivative_time: Annotated[Time | None, 'T_d of a "pid"; default: no derivative part'] = None
    derivative_filter: Annotated[Ratio | None, 'eps of a "pid"; default: 0.1'] = None
    frequency: Annotated[Rate | None, 'corner w of a "low-pass", centre of a "phase-bump"'] = None
    damping: Annotated[Ratio | None, 'damping ratio of a "low-pass" or a "phase-bump"'] = None
    phase: Annotated[
        Angle | None, 'phase that a "phase-bump" adds at its frequency, negative: a lag'
    ] = None
    zero_frequency: Annotated[Rate | None, 'w_z of a "notch" or a "lead-lag"'] = None
    zero_damping: Annotated[Ratio | None, 'd_z of a "notch"'] = None
    pole_frequency: Annotated[Rate | None, 'w_p of a "notch" or a "lead-lag"'] = None
    pole_damping: Annotated[Ratio | None, 'd_p of a "notch"'] = None
    numerator: Annotated[
        tuple[float, ...] | None, ListOf("plain number"), '[b2, b1, b0] of an "sos", s in rad/s'
    ] = None
    denominator: Annotated[
        tuple[float, ...] | None, ListOf("plain number"), '[a2, a1, a0] of an "sos", s in rad/s'
    ] = None


@dataclass(frozen=True, slots=True, repr=False)
class Channel(Part):
    """A chain of filter sections, for the channels that it names; it replaces all that [controller]
    says for them.

    Names are those of the axes, or with coordinates "tilt-translate" translate_x, translate_y,
    tilt_x, tilt_y; of three bearings and more bend_1_x, bend_1_y and so on, which do nothing
    without a chain.
    """

    names: Annotated[tuple[str, ...], Texts(), "channels that it is for"]
    gain: Annotated[float, Quantity("current per displacement"), "gain of the chain"]
    sections: Annotated[tuple[Section, ...], "its sections in series"] = field(
        default=(), metadata={"key": "section"}
    )


@dataclass(frozen=True, slots=True, repr=False)
class Notch(Part):
    """A notch filter (s^2 + 2 zero_damping w s + w^2)/(s^2 + 2 pole_damping w s + w^2)."""

    frequency: Annotated[Rate, "centre frequency w"]
    pole_damping: Annotated[Ratio, "damping ratio of the poles"]
    zero_damping: Annotated[Ratio, "damping ratio of the zeros"]


@dataclass(frozen=True, slots=True, repr=False)
class PidSettings(Part):
    """The reference controller K_p (1 + 1/(T_i s) + T_d s/(eps T_d s + 1)) per axis.

    gain in the order of the machine's axes; coordinates "axes" (decentralised) or "tilt-translate";
    sample_time and delay are those of every controller that runs on the machine (``law.timing``).
    """

    gain: Annotated[
        tuple[float, ...],
        ListOf("current per displacement", scalar=True),
        "K_p, one for all axes or one per axis; not needed where every channel has a chain, nor "
        "to state sample_time and delay",
    ] = field(default=(), metadata={"required": False})
    integral_time: Annotated[Time | None, "T_i; default: no integral part"] = None
    derivative_time: Annotated[Time | None, "T_d; default: no derivative part"] = None
    derivative_filter: Annotated[Ratio, "eps"] = 0.1
    notches: Annotated[tuple[Notch, ...], "notch filters in series"] = field(
        default=(), metadata={"key": "notch"}
    )
    lead: Annotated[
        Pair | None, PairOf("angular rate", "zero, pole", scalar=False), "lead filter [zero, pole]"
    ] = None
    low_pass: Annotated[Rate | None, "corner frequency of a second-order low pass"] = None
    low_pass_damping: Annotated[Ratio, "damping ratio of the low pass"] = 0.7071067811865476
    coordinates: Annotated[str, Choice(CONTROLLER_COORDINATES), "controlled coordinates"] = "axes"
    tilt_gain: Annotated[Ratio, "gain of the tilting part relative to the translating part"] = 1.0
    sample_time: Annotated[
        Time | None, "sample time of the deployed controller; default: continuous"
    ] = None
    delay: Annotated[
        Time | None,
        "from the displacements read to the currents set, rounded up to whole samples; default: "
        "one sample",
    ] = None
    channels: Annotated[tuple[Channel, ...], "chains of filters of single channels"] = field(
        default=(), metadata={"key": "channel"}
    )
    synchronous: Annotated[tuple[Synchronous, ...], "blocks that reject the unbalance's signal"] = (
        field(default=(), metadata={"key": "synchronous"})
    )
    sample_rate: Annotated[
        float | None, Quantity("frequency"), "in place of sample_time: samples per second"
    ] = None

    def __post_init__(self) -> None:
        Part.__post_init__(self)
        rate = self.sample_rate
        if self.sample_time is None and isinstance(rate, int | float) and 0 < rate < inf:
            object.__setattr__(self, "sample_time", 1 / rate)

    def to_dict(self, *, defaults: bool = False) -> dict[str, Any]:
        """As of every part; a sample time that follows from the rate is not said a second time."""
        # slots: the class that super() means is another one
        table = super(PidSettings, self).to_dict(defaults=defaults)
        if self.sample_rate and self.sample_time == 1 / self.sample_rate:
            del table["sample_time"]
        return table
