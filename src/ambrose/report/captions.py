"""What to look at in a curve: a sentence by the curve's name, else by its kind."""

from __future__ import annotations

from ambrose.judge.checks import Curve

# The first entry whose words all occur in the curve's name applies.
_BY_NAME = {
    "complementary": "The peak bounds the multiplicative plant error that the loop survives "
    "(1/peak); it should fall off "
    "steeply before the first bending mode.",
    "control": "Current asked for per metre of sensor noise or run-out. The plateau at high "
    "frequency is the controller's gain "
    "there: noise times this is current.",
    "sensitivity input": "Peak against the zone limits, seen at the plant's input. It should not "
    "exceed the output sensitivity "
    "by much; if it does, the axes are unequal.",
    "sensitivity": "The peak is what counts: its inverse is the distance to instability. ISO "
    "14839-3 judges each axis by the "
    "zone limits; the maximum singular value covers all axes at once. A narrow spike at a bending "
    "mode is spillover, a broad "
    "hump is poor damping of the rigid modes.",
    "compliance": "Displacement per force on the rotor. The peak shows the softest frequency, the "
    "left end the static "
    "stiffness (integral action makes it fall).",
    "unbalance current": "Control current under the residual unbalance. Look at the largest "
    "against the amplifier's limit.",
    "unbalance": "Orbit (zero to peak) under the worst placement of the residual unbalance. Look "
    "at the passages through the "
    "critical speeds and at the margin to the limit over the speed range.",
    "margin loop": "One loop cut open, the others closed. Stability margins are read where the "
    "curve passes 1.",
    "campbell": "Damped frequencies over speed; solid forward or planar, dashed backward whirl. "
    "Crossings with the 1× line are "
    "the critical speeds.",
    "current": "Control currents. Look at the largest against the amplifier's limit: beyond it "
    "the linear result does not "
    "hold.",
    "displacement": "Displacements at the sensors. Look at the largest against the touchdown gap "
    "and at how fast they settle.",
}

_BY_KIND = {
    "frequency": "Circles mark the peaks that the legend quotes.",
    "speed": "Look for crossings and for lines that leave their limits inside the speed range.",
    "time": "Look at the largest excursion and at how fast it settles.",
    "poles": "Everything in the shaded half is unstable. Left: rigid-body and controller poles; "
    "right: all poles, the "
    "bending modes at high frequency with little damping.",
}

_ALIASES = {"T": "complementary", "KS": "control", "S": "sensitivity"}


def caption(curve: Curve) -> str:
    """The caption of a figure of that curve."""
    name = " ".join(
        _ALIASES.get(part, part) for part in curve.name.replace(".", " ").split()
    ).lower()
    if curve.kind != "poles":
        for words, text in _BY_NAME.items():
            if all(word in name for word in words.split()):
                return text
    return _BY_KIND.get(curve.kind, "")
