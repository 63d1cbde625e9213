"""A run-up for machines without speeds of their own: 20 to 300 Hz in one second, G2.5 at 300 Hz
parted between A and B.
"""

import math

from ambrose.rig.scenario import Scenario, Unbalance

HERTZ = 2 * math.pi
RUN_UP = Scenario(
    "run-up to 300 Hz",
    1.0,
    unbalances=tuple(
        Unbalance(port, grade=2.5e-3, grade_speed=300 * HERTZ, share=0.5) for port in "AB"
    ),
    speed=20 * HERTZ,
    to_speed=300 * HERTZ,
)
