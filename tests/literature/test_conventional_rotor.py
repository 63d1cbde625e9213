"""A conventional rotor on oil films, from the textbook's figures, against ROSS.

1. The rotor of Friswell, Penny, Garvey & Lees (2010), Dynamics of Rotating Machines, Example 5.9.1
   (1.5 m, 50 mm, discs of 280 and 350 mm, 70 mm thick), on the short films of its page 177 (525 N,
   30 mm long, 100 mm in diameter, 0.1 mm radial clearance, 0.1 Pa s), whose closed form stands
   here. Both were read in the documentation of ROSS, not in the book.
2. What ROSS 2.3.0 makes of them (ross-rotordynamics, run once in an environment of its own, twelve
   elements, the unbalance that ``lateral`` places).
3. The figures of ROSS's own test of its clearance analysis before 3.1 (its tests of results,
   631a249a of August 2026, which calls itself 2.3.0; facts only). For 3.1: test_ross_31.py.

Both codes have a consistent mass. ROSS interpolates tables by splines, Ambrose linearly, so that
they are compared at the tables' speeds, and at a peak that is 9 rpm away from one.
"""

import math

import numpy as np
import pytest

import ambrose as amb
from ambrose.annexes.rotordynamics import standard
from ambrose.annexes.rotordynamics.loop import shaft_loop
from ambrose.annexes.rotordynamics.placement import place, shaft_modes
from ambrose.annexes.rotordynamics.stations import lay_out
from ambrose.machine.file.toml import loads_machine

pytestmark = pytest.mark.literature

RPM = math.pi / 30
SPEEDS = (100, 200, 300, 450, 600, 750, 900, 1050, 1200, 1350, 1500, 1650, 1800, 1950, 2100)
DENSITY, E, G = 7810.0, 211e9, 81.2e9


def film(rpm, clearance=1e-4, load=525.0, length=0.03, diameter=0.1, viscosity=0.1):
    """K and C (2, 2) of a short film (Ocvirk): eccentricity e from the modified Sommerfeld number,
    then the closed form of Friswell et al., p. 177.
    """
    w = rpm * RPM
    s = diameter * w * viscosity * length**3 / (8 * clearance**2 * load)
    p = math.pi**2
    roots = np.roots([1, -4, 6 - s**2 * (16 - p), -(4 + p * s**2), 1])
    (square,) = [r.real for r in roots if abs(r.imag) < 1e-12 and 0 < r.real < 1]
    e, q = math.sqrt(square), math.sqrt(1 - square)
    h = (p * q**2 + 16 * square) ** -1.5
    k_xx = 4 * h * (p * (2 - square) + 16 * square)
    k_xy = h * math.pi * (p * q**4 - 16 * square**2) / (e * q)
    more = p * q**2 * (1 + 2 * square) + 32 * square * (1 + square)
    k_yx = -h * math.pi * more / (e * q)
    k_yy = 4 * h * (p * (1 + 2 * square) + 32 * square * (1 + square) / q**2)
    both = p * (1 + 2 * square) - 16 * square
    c_xx, c_xy = 2 * h * math.pi * q * both / e, -8 * h * both
    c_yy = 2 * h * math.pi * (p * q**4 + 48 * square) / (e * q)
    K = np.array([[k_xx, k_xy], [k_yx, k_yy]]) * load / clearance
    C = np.array([[c_xx, c_xy], [c_xy, c_yy]]) * load / (clearance * w)
    return K, C


def bearing(name, position, rpms, clearance):
    tables = [film(rpm, clearance) for rpm in rpms]
    rows = [f'[[journal_bearing]]\nname = "{name}"\nposition = {position}']
    if len(rpms) > 1:
        rows.append(f"speed = {[rpm * RPM for rpm in rpms]}")
    for letter, k in (("K", 0), ("C", 1)):
        for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)):
            values = [float(table[k][i, j]) for table in tables]
            rows.append(f"{letter}_{'xy'[i]}{'xy'[j]} = {values}")
    return "\n".join(rows)


def disc(name, position, diameter):
    mass = DENSITY * 0.07 * math.pi / 4 * (diameter**2 - 0.05**2)
    polar = mass * (diameter**2 + 0.05**2) / 8
    return (
        f'[[disc]]\nname = "{name}"\nposition = {position}\nmass = {mass}\n'
        f"polar_inertia = {polar}\ndiametral_inertia = {polar / 2 + mass * 0.07**2 / 12}"
    )


def probe(end, position, axis):
    return (
        f'[[probe]]\nname = "{end}-{axis}"\nposition = {position}\n'
        f'direction = "{0 if axis == "x" else 90} deg"'
    )


def rotor(second, elements, rpms, clearances, top):
    parts = [
        f"""[machine]
schema = 1
name = "two-discs-on-oil"
beam_theory = "timoshenko"
modal_damping = 0.0
gravity_direction = "-90 deg"
[material.steel]
density = {DENSITY}
youngs_modulus = {E}
poisson_ratio = {E / (2 * G) - 1}
[[shaft]]
length = 1.5
outer_diameter = 0.05
elements = {elements}
material = "steel"
""",
        disc("left", 0.5, 0.28),
        disc("right", 1.0, second),
        bearing("DE", 0.0, rpms, clearances[0]),
        bearing("NDE", 1.5, rpms, clearances[1]),
        *(probe(end, x, axis) for end, x in (("DE", 0.0), ("NDE", 1.5)) for axis in "xy"),
        f'[[operation.point]]\nlabel = "mcs"\nspeed = {top}\n',
        f"[requirements]\nrunning_speeds = [{1500 * RPM}, {top}]\n" if top < 1000 else "",
    ]
    return loads_machine("\n".join(parts), "two-discs-on-oil")


def test_the_closed_form_is_the_one_that_is_documented():
    """Four figures that ROSS's documentation prints for 1500 rpm."""
    K, _ = film(1500)
    assert K.ravel().astype(int).tolist() == [12807959, 16393593, -25060393, 8815302]


# what ROSS gives at the unbalance of the second placement: all of it in the middle
THEIRS = """kind;speed [rpm];amplitude [um p-p];log_decrement [-];whirl;probe;case
mode;933.49226;;2.7322963;forward;;
mode;962.78333;;2.7351037;forward;;
mode;1039.0291;;0.0583998;forward;;
mode;1047.8489;;0.0319967;planar;;
critical;1058.75;23.003;;;DE-x;962.78 rpm mode
critical;1057.75;18.204;;;DE-y;962.78 rpm mode
critical;1058.75;26.557;;;NDE-x;962.78 rpm mode
critical;1057.75;21.139;;;NDE-y;962.78 rpm mode
response;1050;13.613;;;DE-x;962.78 rpm mode
response;1200;2.8049;;;DE-x;962.78 rpm mode
response;1200;2.4939;;;DE-y;962.78 rpm mode
response;1200;3.3513;;;NDE-x;962.78 rpm mode
response;1200;2.9838;;;NDE-y;962.78 rpm mode
response;1500;1.4630;;;NDE-x;962.78 rpm mode
response;1500;1.3524;;;NDE-y;962.78 rpm mode
response;1800;1.1310;;;NDE-x;962.78 rpm mode
response;1800;1.1374;;;DE-x;933.49 rpm mode
response;1800;1.2044;;;NDE-y;933.49 rpm mode
"""


def test_the_report_is_what_ross_computes_within_a_thousandth(tmp_path):
    machine = rotor(0.35, 12, SPEEDS, (1e-4, 1e-4), 1800 * RPM)
    result = amb.lateral(machine)
    one, middle = result.response.cases
    assert [result.layout.positions[w.station] for w in one.weights] == [0.0, 1.5]
    (weight,) = middle.weights
    assert weight.amount == pytest.approx(2 * 6350 * 107.1173374750693 / 1800 * 1e-6, rel=1e-7)
    path = tmp_path / "ross.csv"
    path.write_text(THEIRS)
    found = amb.compare(result, path, within=0.1)
    assert found.passed, found.to_frame()
    # oil whip is near: the log decrement of the least damped mode fails, the report says so
    assert "level_two.log_decrement" in result.failed


def test_rosss_own_clearance_test():
    """One unbalance at the antinode of the first forward mode, at 3600 rad/s: 3.57961 and 8.86627
    um at the two bearings after scaling. Their ratio is the response's and ours within 0.1 %.

    Not the same, and why: the larger one is 25.4 * 12000/N there; the standard's limit as recalled
    here has the square root, 15.0 um. And the motion, peak to peak, is held there against 75 % of
    the radial clearance (90 um of 120), here against 75 % of the diametral one.
    """
    speed = 3600.0
    # one row: films as at 3600 rpm, at every speed
    machine = rotor(0.28, 6, (3600,), (1.2e-4, 1.8e-4), speed)
    layout = lay_out(machine)
    loop = shaft_loop(layout, machine.operation.nominal, None, None)
    # their node 3
    modes = [mode for mode in shaft_modes(loop, speed) if mode.forward]
    first = next(m for m in modes if [0.75] == antinodes(layout, m, speed))
    # theirs is |s| = 135.77344 rad/s at a log decrement of -0.16892768
    assert abs(first.pole) == pytest.approx(135.77344241, rel=1e-6)
    assert first.log_decrement == pytest.approx(-0.16892768, rel=1e-5)
    forces = np.zeros(2 * len(layout.positions), complex)
    middle = layout.nearest(0.75)
    forces[2 * middle : 2 * middle + 2] = 1.0, -1j
    motion = loop.read @ loop.states(1j * speed, forces)
    x = [abs(motion[2 * layout.nearest(position)]) for position in (0.0, 1.5)]
    assert x[0] / x[1] == pytest.approx(3.5796145419750083 / 8.866272600131191, rel=1e-3)
    n = speed / RPM
    assert 25.4 * 12_000 / n == pytest.approx(8.866272600131191, rel=1e-9)
    assert standard.vibration_limit(n) == pytest.approx(25.4 * math.sqrt(12_000 / n))


def antinodes(layout, mode, speed):
    return [
        float(layout.positions[weight.station])
        for case in place(layout, mode, speed)
        for weight in case.weights
    ]
