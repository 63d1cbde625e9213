"""The undamped critical-speed map against closed forms, printed critical speeds and the plant."""

import math
from dataclasses import replace

import numpy as np
import pytest

import ambrose as amb
from ambrose.annexes.rotordynamics.critical_map import critical_map, dynamic_stiffness
from ambrose.annexes.rotordynamics.loop import shaft_loop
from ambrose.annexes.rotordynamics.page import critical_map_figure, lateral_page
from ambrose.annexes.rotordynamics.stations import lay_out
from ambrose.law.loop import Timing
from ambrose.machine.file.toml import loads_machine
from ambrose.model.static_load import magnet_coefficients
from coarse import coarse

RPM = math.pi / 30
FILE = """
[machine]
schema = 1
name = "bar"
beam_theory = "{theory}"
[material.bar]
density = {density}
youngs_modulus = {modulus}
[[shaft]]
length = "1 m"
outer_diameter = {diameter}
elements = 24
material = "bar"
{disc}
[[journal_bearing]]
name = "DE"
position = 0.0
K_xx = [{k}]
K_yy = [{k}]
C_xx = [10.0]
C_yy = [10.0]
[[journal_bearing]]
name = "NDE"
position = 1.0
K_xx = [{k}]
K_yy = [{other}]
C_xx = [10.0]
C_yy = [10.0]
[[operation.point]]
label = "mcs"
speed = {top}
"""
DISC = '[[disc]]\nname = "wheel"\nposition = 0.5\nmass = {m}\npolar_inertia = {p}\n'
DISC += "diametral_inertia = {d}"


def bar(
    k=1e5, *, density=7800.0, modulus=2.1e11, diameter=0.02, disc="", theory="rayleigh", other=None
):
    text = FILE.format(
        theory=theory,
        density=density,
        modulus=modulus,
        diameter=diameter,
        disc=disc,
        k=k,
        other=k if other is None else other,
        top=300.0,
    )
    return loads_machine(text, "bar")


def mapped(machine, law=None, timing=None, top=2000.0):
    layout = lay_out(machine)
    point = machine.operation.nominal

    def loop_at(speed):
        return shaft_loop(layout, replace(point, speed=speed), law, timing)

    return critical_map(layout, loop_at(point.speed), loop_at, law, (10.0, top))


def at(found, number, k):
    """The curve of a critical speed at a stiffness; both axes are logarithmic."""
    logs = np.interp(math.log(k), np.log(found.stiffness), np.log(found.speeds[number - 1]))
    return math.exp(logs)


def test_a_rigid_rotor_on_two_springs():
    """m z'' + 2 k z = 0; and in tilt, whirling as it spins, (I_d - I_p) W^2 = 2 k (L/2)^2."""
    machine = bar(modulus=2.1e17, diameter=0.2)
    (section,) = machine.shaft
    m = section.material.density * math.pi / 4 * 0.2**2
    polar, diametral = m * 0.1**2 / 2, m * (0.1**2 / 4 + 1 / 12)
    found = mapped(machine)
    # on softer springs than a thousandth of the shaft's own
    for k in found.stiffness[:21:5]:
        assert at(found, 1, k) == pytest.approx(math.sqrt(2 * k / m), rel=1e-4)
        assert at(found, 2, k) == pytest.approx(math.sqrt(k / 2 / (diametral - polar)), rel=1e-4)


def test_a_jeffcott_rotor_on_springs():
    """1/W^2 = m (L^3/(48 E I) + 1/(2 k)): flexible shaft without mass, a disc in the middle."""
    m, E, d = 20.0, 2.1e11, 0.03
    wheel = DISC.format(m=m, p=0.2, d=0.1)
    machine = bar(density=1.0, diameter=d, disc=wheel, theory="bernoulli-euler")
    inertia = math.pi * d**4 / 64
    found = mapped(machine)
    for k in found.stiffness[::10]:
        exact = (m * (1 / (48 * E * inertia) + 1 / (2 * k))) ** -0.5
        assert at(found, 1, k) == pytest.approx(exact, rel=1e-3)
    # the disc's polar inertia is the larger one: in tilt it never whirls as fast as it spins
    assert found.rigid[0] == pytest.approx(math.sqrt(48 * E * inertia / m), rel=1e-3)
    assert found.speeds[1].min() > 50 * found.speeds[0].max()


def test_a_slender_bar_goes_from_free_to_pinned_ends():
    """beta L = 4.73004, 7.8532 of free ends and pi, 2 pi of pinned ones, sqrt(E I/(rho A)) d/4."""
    machine = bar(diameter=0.004)
    c = math.sqrt(2.1e11 / 7800) * 0.004 / 4
    found = mapped(machine, top=1000.0)
    soft, hard = found.stiffness[[0, -1]]
    assert hard / soft >= 1e5
    for number, root in ((3, 4.730041), (4, 7.853205)):
        assert found.speeds[number - 1, 0] == pytest.approx(root**2 * c, rel=3e-3)
    for number in (1, 2):
        pinned = (number * math.pi) ** 2 * c
        assert found.rigid[number - 1] == pytest.approx(pinned, rel=1e-3)
        assert found.speeds[number - 1, -1] == pytest.approx(pinned, rel=2e-2)
    # never slower on a stiffer support, never above that of a rigid one
    assert (np.diff(found.speeds) > 0).all()
    assert (found.speeds < found.rigid[:, None]).all()


def test_the_speeds_that_nelson_and_mcvaugh_print():
    """Forward critical speeds on 43.78 MN/m, as test_rotor_literature.py has them: within 0.5 %;
    read off the map, between two of its values of k.
    """
    machine = amb.load_machine("nelson-mcvaugh-rotor")
    found = mapped(machine, amb.design(machine, "pid"), top=10_000.0)
    for number, printed in enumerate((17159, 49983, 96457), 1):
        assert at(found, number, 4.378e7) / RPM == pytest.approx(printed, rel=5e-3)


def test_films_are_drawn_where_their_tables_are_and_meet_the_map():
    """Equal films: both critical speeds of the rigid rotor on exactly their stiffness; unequal
    ones: a line each.
    """
    k = 1e5
    found = mapped(bar(k, modulus=2.1e16, diameter=0.2), top=400.0)
    (support,) = found.supports
    assert support.axes == ("DE K_xx", "DE K_yy", "NDE K_xx", "NDE K_yy")
    m = 7800 * math.pi / 4 * 0.2**2
    first, second = found.crossings
    assert first.speed == pytest.approx(math.sqrt(2 * k / m), rel=1e-4)
    assert second.speed == pytest.approx(math.sqrt(k / 2 / (m * (1 / 12 - 0.1**2 / 4))), rel=1e-4)
    assert first.stiffness == second.stiffness == k
    assert [item.name for item in mapped(bar(k, other=3 * k)).supports] == [
        "DE K_xx, DE K_yy, NDE K_xx",
        "NDE K_yy",
    ]


@pytest.mark.parametrize("order", ["as it stands", "current-loop"])
def test_the_magnets_stiffness_is_what_the_plant_does(order):
    """f = -K(jW) q with sensors at the magnets: the receptance at the magnets, inverted, is that
    of the rotor and K, coupling of axes and back-EMF included.
    """
    machine = coarse("turboexpander")
    places = {bearing.name: bearing.position for bearing in machine.bearings}
    machine = uncontrolled = replace(
        machine,
        sensors=tuple(replace(s, position=places[s.bearing]) for s in machine.sensors),
    )
    if order == "current-loop":
        drive = replace(
            machine.amplifier, order=order, bandwidth=9e3, inductance=5e-3, resistance=0.2
        )
        machine = replace(machine, amplifier=drive)
    layout, law = lay_out(machine), amb.design(machine, "pid")
    point = machine.operation.nominal
    loop = shaft_loop(layout, point, law, Timing(1e-5, 1))
    # rotor, seal and negative stiffness, without back-EMF
    bare = shaft_loop(lay_out(uncontrolled), point, None, None)
    # rows that read, and forces that act along, the control axes
    turn = []
    for bearing in machine.bearings:
        at = layout.nearest(bearing.position)
        for way in (0.0, math.pi / 2):
            row = np.zeros(2 * len(layout.positions))
            angle = bearing.angle + way
            row[2 * at : 2 * at + 2] = math.cos(angle), math.sin(angle)
            turn.append(row)
    N = np.array(turn)
    _, k_s = magnet_coefficients(machine, point)
    omega = np.array([50.0, 400.0, 3000.0, 9000.0])
    K = dynamic_stiffness(machine, loop, None, omega)
    for w, stiffness in zip(omega, K, strict=True):
        held, free = (np.linalg.inv(N @ one.read @ one.states(1j * w, N.T)) for one in (loop, bare))
        expected = held - free - np.diag(k_s)
        np.testing.assert_allclose(stiffness, expected, atol=1e-6 * np.abs(expected).max())


def test_a_reviewer_sees_map_meetings_and_rigid_supports():
    machine = bar(2e6, diameter=0.05)
    result = amb.lateral(machine)
    found = result.critical_map
    (row,) = [item for item in result.items if item.name == "undamped"]
    assert f"{found.rigid[0] / RPM:.5g} rpm" in row.note and row.passed is None
    (section,) = [
        part for part in lateral_page(result).sections if part.title == "Undamped critical speeds"
    ]
    (table,) = section.tables
    assert len(table.rows) == len(found.crossings) + len(found.rigid)
    assert "K_xx and K_yy" in section.text and "magnet" not in section.text
    figure = critical_map_figure(found, result.speeds)
    assert figure.layout.xaxis.type == figure.layout.yaxis.type == "log"
    lines = [t for t in figure.data if t.mode == "lines" and len(t.x) == len(found.stiffness)]
    assert len(lines) == len(found.speeds)


def test_an_unstable_loop_has_its_map():
    """It needs no loop, and it is the first figure that tells why a machine is not held."""
    machine = coarse("turboexpander")
    law = amb.design(machine, "pid")
    result = amb.lateral(machine, law, rate=1e4, tolerances=False)
    assert result.response is None and [item.name for item in result.items] == [
        "stability",
        "undamped",
    ]
    titles = [section.title for section in lateral_page(result).sections]
    assert "Undamped critical speeds" in titles and "Unbalance response" not in titles
