"""Unbalance: the force of a mass off the shaft's centre line while the rotor turns, at any speed
profile.

The mass m at radius e and angle theta + phase sits at e (cos, sin); minus m times its acceleration
acts on the rotor. The linear view at constant speed is the rotating force m e Omega^2 (verify and
simulate.linear use that); here the angular acceleration adds the tangential part.
"""

from __future__ import annotations

import math


def linearised(amount: float, speed: float) -> complex:
    """The force m e Omega^2 [N] as a phasor on exp(j Omega t): along x as it stands, along y times
    -j.

    amount m e [kg m]; speed [rad/s], constant.
    """
    return complex(amount * speed**2)


def force(
    angle: float, speed: float, acceleration: float, p: tuple[float, ...]
) -> tuple[float, float]:
    """Force (x, y) [N] on the rotor at a spin angle [rad], speed [rad/s] and angular acceleration
    [rad/s2].

    p: (amount m e [kg m], phase [rad] of the mass from x at angle zero). Compiles with numba as it
    stands.
    """
    cosine, sine = math.cos(angle + p[1]), math.sin(angle + p[1])
    radial, tangential = p[0] * speed * speed, p[0] * acceleration
    return radial * cosine + tangential * sine, radial * sine - tangential * cosine
