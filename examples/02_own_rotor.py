"""A machine file of your own, written as text: bending frequencies, critical speeds, and a bearing that lies between nodes."""

import numpy as np

from ambrose.machine.file.toml import loads_machine
from ambrose.physics.rotor import finite_element_rotor, free_bending_frequencies, mass_properties
from ambrose.plant.assemble import assemble
from ambrose.synthesis.pid import pid_synthesis

TEXT = """
[machine]
schema = 1
name = "bench rotor"

[[shaft]]
length = "600 mm"
outer_diameter = "40 mm"
elements = 11

[[disc]]
name = "wheel"
position = "300 mm"
mass = 8
polar_inertia = 0.04
diametral_inertia = 0.02

[[bearing]]
name = "A"
position = "70 mm"
bias_current = 3
force_per_current = 180
negative_stiffness = 0.7e6
[[bearing]]
name = "B"
position = "530 mm"
bias_current = 3
force_per_current = 180
negative_stiffness = 0.7e6

[[sensor]]
bearing = "A"
position = "90 mm"
[[sensor]]
bearing = "B"
position = "510 mm"

[amplifier]
order = "first"
bandwidth = "1.5 kHz"

[controller]
gain = 12000
integral_time = "0.1 s"
derivative_time = "3 ms"
derivative_filter = 0.1
"""

machine = loads_machine(TEXT)
rotor = finite_element_rotor(machine)
mass = mass_properties(rotor).mass
bending_hz = free_bending_frequencies(rotor, 2) / (2 * np.pi)
result = pid_synthesis(assemble(machine))

if __name__ == "__main__":
    print(f"{mass:.1f} kg, free bending at {bending_hz[0]:.0f} and {bending_hz[1]:.0f} Hz")
    print(f"PID: {result.status}, largest sensitivity {result.certificate.margins.get('sensitivity_peak', np.inf):.2f}")
