"""How much seal pressure does the reference PID survive? The pressure as one uncertain
parameter.
"""

import numpy as np
from scipy.optimize import brentq

import ambrose as amb

machine = amb.load_machine("seal-rig")
full = amb.assemble(machine)
small = amb.reduce(full, 0)
controller = amb.design(machine, "pid").controller


def abscissa(plant, delta):
    """Largest real part of the closed-loop poles [rad/s] at (1 + delta) times the nominal
    pressure.
    """
    return amb.spectral_abscissa(
        amb.closed_loop(amb.perturbed(plant, {"seal.center.pressure": delta}), controller)
    )


limit = brentq(lambda delta: abscissa(small, delta), 0.0, 1.0, xtol=1e-6)
limit_full = brentq(lambda delta: abscissa(full, delta), 0.0, 1.0, xtol=1e-4)
pressure_bar = machine.seals[0].reference_pressure * (1 + limit_full) / 1e5

if __name__ == "__main__":
    for delta in np.linspace(-1, 1, 5):
        print(
            f"{1 + delta:4.0%} of nominal pressure: largest real part "
            f"{abscissa(small, delta):7.2f} rad/s"
        )
    print(
        f"stable up to {1 + limit_full:.1%} ({1 + limit:.1%} on the reduced model) of the "
        f"pressure, {pressure_bar:.2f} bar"
    )
