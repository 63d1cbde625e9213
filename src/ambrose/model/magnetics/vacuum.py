"""The permeability of vacuum."""

import math

VACUUM_PERMEABILITY = 4e-7 * math.pi  # mu_0 [V s/(A m)]; the measured value differs by 1e-10
