"""A small rotor on two radial bearings and a thrust bearing, for the tests of the axis."""

from __future__ import annotations

from ambrose.machine.file.toml import loads_machine
from ambrose.machine.machine import Machine

RADIAL = """
[machine]
schema = 1
name = "expander"
[[shaft]]
length = "400 mm"
outer_diameter = "48 mm"
elements = 6
[[bearing]]
name = "A"
position = "80 mm"
bias_current = "4 A"
force_per_current = "100 N/A"
negative_stiffness = "0.8 N/um"
[[bearing]]
name = "B"
position = "320 mm"
bias_current = "4 A"
force_per_current = "100 N/A"
negative_stiffness = "0.8 N/um"
[[sensor]]
bearing = "A"
position = "80 mm"
[[sensor]]
bearing = "B"
position = "320 mm"
[amplifier]
order = "first"
bandwidth = "1.5 kHz"
[controller]
gain = "20 A/mm"
derivative_time = "1.5 ms"
sample_rate = "10 kHz"
[operation]
[[operation.point]]
label = "rest"
[[operation.point]]
label = "rated"
speed = "20000 rpm"
"""
THRUST = """
[[thrust_bearing]]
name = "T"
position = "200 mm"
collar_radius = "60 mm"
collar_thickness = "12 mm"
gap = "0.5 mm"
bias_current = "3 A"
max_current = "3 A"
touchdown_gap = "0.25 mm"
conductivity = 4e6
permeability = 600
[[thrust_bearing.stator]]
turns = 80
inner_pole = ["25 mm", "34 mm"]
outer_pole = ["54 mm", "60 mm"]
slot_depth = "15 mm"
back_wall = "10 mm"
[thrust_bearing.sensor]
position = "390 mm"
growth = ["-20 um", "40 um"]
[[thrust_bearing.load]]
point = "rated"
force = "120 N"
[[thrust_bearing.tolerance]]
parameter = "thrust_bearing.T.force_per_current"
relative = "10 %"
[[thrust_bearing.tolerance]]
parameter = "thrust_bearing.T.negative_stiffness"
relative = "20 %"
[thrust_bearing.controller]
gain = "22 A/mm"
integral_time = "60 ms"
derivative_time = "4 ms"
derivative_filter = 0.05
"""


def machine(change: dict[str, str] | None = None) -> Machine:
    """The rotor, texts of its file replaced."""
    text = RADIAL + THRUST
    for old, new in (change or {}).items():
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return loads_machine(text)
