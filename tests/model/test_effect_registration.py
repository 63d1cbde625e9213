"""A physical effect is one file and one registration: a spring with a lag, written here, goes from
the machine file to C through ``registry.register`` alone.

    f = -k x_l,    x_l' = w (q - x_l)

on either axis: a spring that follows late, which takes damping away.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import pytest
from click.testing import CliRunner

import ambrose as amb
from ambrose import registry
from ambrose.cli import main
from ambrose.core.checks import InvalidInput
from ambrose.core.statespace import poles
from ambrose.machine.attachment import TILTED, by_table
from ambrose.machine.description import Coupling, Tolerance
from ambrose.machine.file.tables import machine_schema
from ambrose.machine.file.toml import dumps_machine, loads_machine, machine_hash
from ambrose.machine.file.update import annotated_machine, update_machine_file
from ambrose.machine.kinds import Angle, Length, Name, Quantity, Rate, StiffnessPair
from ambrose.machine.part import Part
from ambrose.machine.validation.parts import not_positive
from ambrose.model.assemble import assemble
from ambrose.model.effect import Action, Effect, Reaction
from ambrose.model.effects.rotor import finite_element_rotor, mass_properties
from ambrose.model.uncertainty import free_mode_reduction, modal_reduction, perturbed
from ambrose.rig import virtual_rig
from ambrose.rig.engine.equilibrium import linear_view, slope, state_at_rest
from ambrose.rig.engine.inputs import plan, stretch
from ambrose.rig.engine.state import build
from ambrose.rig.scenario import Pulse, Scenario
from pole_sets import matched

# ---- the file of the effect


@dataclass(frozen=True, slots=True, repr=False)
class LaggedSpring(Part):
    """A spring to the ground whose force lags."""

    name: Annotated[Name, "name, different from all other attachments"]
    position: Annotated[Length, "axial position, from the left end"]
    stiffness: Annotated[StiffnessPair, "stiffness at rest"]
    rate: Annotated[Rate, "corner frequency of the lag"]
    angle: Annotated[Angle, "angle of the axis zeta from the global x"] = 0.0


def lagged_findings(where: str, part: LaggedSpring) -> Iterator[str]:
    yield from not_positive(where, part, "a spring holds back", "stiffness", zero=True)
    yield from not_positive(where, part, "a lag has a corner frequency", "rate")


def lagged_reaction(part: LaggedSpring, point: amb.OperatingPoint) -> Reaction:
    none, eye = np.zeros((2, 2)), np.eye(2)
    k = np.diag(part.stiffness)
    return Reaction(none, none, A=-part.rate * eye, B=part.rate * eye, H=-k)


def lagged_actions(
    part: LaggedSpring, point: amb.OperatingPoint, quantity: str
) -> Iterator[Action]:
    for axis, k in zip(TILTED, part.stiffness, strict=True):
        port = f"{part.name}_{axis}"
        yield Action(port, k, ((f"h_{port}", 1 / k),))


LAGGED_SPRING = Effect(
    table="lagged_spring",
    part=LaggedSpring,
    findings=lagged_findings,
    quantities={"stiffness": ("stiffness", TILTED)},
    reaction=lagged_reaction,
    actions=lagged_actions,
)

# ---- and what it goes through


MACHINE = """
[machine]
schema = 1
name = "cylinder"
modal_damping = 0.005

[[shaft]]
length = "400 mm"
outer_diameter = "60 mm"
elements = 8

[[bearing]]
name = "A"
position = "100 mm"
bias_current = "2 A"
force_per_current = "200 N/A"
negative_stiffness = "0.8 N/um"
touchdown_gap = "0.2 mm"
max_current = "2 A"
[[bearing]]
name = "B"
position = "300 mm"
bias_current = "2 A"
force_per_current = "200 N/A"
negative_stiffness = "0.8 N/um"
touchdown_gap = "0.2 mm"
max_current = "2 A"

[[sensor]]
bearing = "A"
position = "100 mm"
[[sensor]]
bearing = "B"
position = "300 mm"

# the effect of this test
[[lagged_spring]]
name = "wedge"
position = "200 mm"
stiffness = "0.5 N/um" # of either axis
rate = "100 Hz"

[amplifier]
order = "first"
bandwidth = "1 kHz"

[controller]
gain = "20 A/mm"
derivative_time = "2 ms"
delay = "20 us"

[[tolerance]]
parameter = "lagged_spring.wedge.stiffness"
relative = "20 %"
"""
K, W = 0.5e6, 200 * np.pi


@pytest.fixture(scope="module", autouse=True)
def _registered() -> Iterator[None]:
    registry.register("effect", "lagged_spring", LAGGED_SPRING)
    yield
    registry.unregister("effect", "lagged_spring")


@pytest.fixture(scope="module")
def machine(_registered: None) -> amb.Machine:
    return loads_machine(MACHINE)


@pytest.fixture(scope="module")
def controller(machine: amb.Machine) -> object:
    return amb.design(machine, "pid")


def test_the_table_is_read_with_units(machine):
    wedge = LaggedSpring("wedge", 0.2, (K, K), W)
    assert machine.effects == (wedge,)
    assert by_table(machine.effects) == {"lagged_spring": [wedge]}
    schema = machine_schema()
    assert schema["properties"]["lagged_spring"]["items"] == {"$ref": "#/$defs/LaggedSpring"}
    assert "rate" in schema["$defs"]["LaggedSpring"]["required"]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("rate =", "pace =", '[[lagged_spring]] wedge: unknown key "pace"'),
        ('rate = "100 Hz"', 'rate = "100 mm"', "rate"),
        ('rate = "100 Hz"\n', "", "[[lagged_spring]] wedge: rate is missing"),
        ('"100 Hz"', "0", "[[lagged_spring]] wedge: rate is 0 rad/s, but must be positive"),
        ('"0.5 N/um"', "[-1, 1]", "stiffness (zeta) is -1 N/m, but must be zero or positive"),
        ('"wedge"', '"A"', 'name "A" is taken by a [[bearing]]'),
        ('position = "200 mm"', "position = 2", "position is 2 m, but must be on the shaft"),
        ("wedge.stiffness", "wedge.rate", 'unknown quantity "rate"'),
        ("spring.wedge.", "spring.edge.", 'names the unknown lagged_spring "edge"'),
    ],
)
def test_what_is_wrong_is_refused(old, new, words):
    assert old in MACHINE
    with pytest.raises(InvalidInput) as wrong:
        loads_machine(MACHINE.replace(old, new))
    assert words in str(wrong.value)


def test_too_many_are_refused(machine):
    many = tuple(replace(machine.effects[0], name=f"wedge{i}") for i in range(21))
    with pytest.raises(InvalidInput, match="21 entries of"):
        replace(machine, effects=many, tolerances=())


def test_without_its_registration_the_table_is_unknown(machine):
    registry.unregister("effect", "lagged_spring")
    try:
        with pytest.raises(InvalidInput, match=r"\[lagged_spring\]: unknown table"):
            loads_machine(MACHINE)
        with pytest.raises(TypeError, match="LaggedSpring is not part of a registered effect"):
            replace(machine, name="other")
    finally:
        registry.register("effect", "lagged_spring", LAGGED_SPRING)
    with pytest.raises(RuntimeError, match="registered already"):
        registry.register("effect", "coupling", LAGGED_SPRING)


def test_saved_and_read_again(machine, tmp_path):
    assert loads_machine(dumps_machine(machine)) == machine
    assert loads_machine(annotated_machine(machine, "title")) == machine
    stiffer = replace(machine, effects=(replace(machine.effects[0], stiffness=(6e5, 6e5)),))
    text = update_machine_file(MACHINE, stiffer)
    assert text == MACHINE.replace('"0.5 N/um" #', '"0.6 N/um" #')
    assert machine_hash(stiffer) != machine_hash(machine)
    two = replace(machine, effects=(*machine.effects, LaggedSpring("end", 0.39, (1e5, 1e5), 50.0)))
    amb.save_machine(two, tmp_path / "two.toml")
    assert amb.load_machine(tmp_path / "two.toml") == two
    without = replace(machine, effects=(), tolerances=())
    assert "lagged_spring" not in update_machine_file(MACHINE, without)


def test_check_knows_it(machine, tmp_path):
    amb.save_machine(machine, tmp_path / "machine.toml")
    done = CliRunner().invoke(main, ["check", str(tmp_path / "machine.toml")])
    assert done.exit_code == 0, done.output


def test_poles_of_a_rigid_rotor(machine):
    """Bounce of the rigid rotor on two magnets and the spring at its centre of mass m:

        s^2 - 2 k_s / m + (k / m) w / (s + w) = 0,

    three poles in either plane; the tilt is the magnets' alone, s^2 = 2 k_s a^2 / I.
    """
    plant = free_mode_reduction(assemble(machine), 0)
    properties = mass_properties(finite_element_rotor(machine))
    k_s, m = 0.8e6, properties.mass
    a, b = 2 * k_s / m, K / m
    bounce = np.roots([1, W, -a, (b - a) * W])
    tilt = np.sqrt(2 * k_s * 0.1**2 / properties.diametral_inertia)
    expected = np.array([*bounce, *bounce, tilt, tilt, -tilt, -tilt])
    assert matched(poles(plant.rotor), expected) == pytest.approx(expected, rel=1e-9, abs=1e-6)


def test_its_states_are_kept_by_the_reduction(machine):
    plant = assemble(machine)
    reduced = modal_reduction(plant, 2)
    assert reduced.plant.rotor.A.shape[0] == 8 + 4 * 2 + 2
    omega = [50.0, 500.0, 3000.0]
    for w in omega:
        full, small = (_compliance(item, w) for item in (plant, reduced.plant))
        assert small == pytest.approx(full, rel=1e-3)


def _compliance(plant: amb.Plant, w: float) -> complex:
    s = plant.rotor
    column, row = s.inputs.index("f_wedge_zeta"), s.outputs.index("q_wedge_zeta")
    x = np.linalg.solve(1j * w * np.eye(len(s.A)) - s.A, s.B[:, column])
    return complex(s.C[row] @ x + s.D[row, column])


def test_a_tolerance_moves_the_plant_as_a_new_machine_does(machine):
    plant = free_mode_reduction(assemble(machine), 1)
    moved = perturbed(plant, {"lagged_spring.wedge.stiffness": 0.7})
    other = replace(machine, effects=(replace(machine.effects[0], stiffness=(1.14 * K, 1.14 * K)),))
    expected = poles(free_mode_reduction(assemble(other), 1).system)
    assert matched(poles(moved.system), expected) == pytest.approx(expected, rel=1e-8, abs=1e-6)


def test_verified_over_its_tolerance(machine, controller):
    verdict = amb.verify(machine, controller)
    assert "lagged_spring.wedge.stiffness" in str(verdict.to_dict())


def test_the_rig_is_the_plant_around_its_centre(machine):
    rig = build(machine, bending_modes=2)
    drive = stretch(plan(rig, Scenario("still", 0.01), 1e-4, 0), 0, 1)
    still, off = state_at_rest(rig, np.zeros(rig.coordinates), np.zeros(4)), np.zeros(4)
    A, _ = linear_view(rig, drive, still, off)
    # the plant is without bias currents, which the rig follows with a pole of its own
    kept = np.r_[: rig.bias.start, rig.bias.stop : rig.states]
    used = [i for i in kept if A[i].any()]
    plant = free_mode_reduction(assemble(machine), 2)
    expected, found = (
        _upper(p) for p in (poles(plant.system), np.linalg.eigvals(A[np.ix_(used, used)]))
    )
    assert found == pytest.approx(expected, rel=1e-6, abs=1e-3)


def _upper(values: np.ndarray) -> np.ndarray:
    """One of each conjugate pair, by size; real ones by value."""
    kept = values[values.imag > -1e-6 * np.abs(values)]
    return kept[np.lexsort((kept.real, np.abs(kept).round(3)))]


def test_the_rig_runs_as_the_linear_loop_does(machine, controller):
    push = Scenario("push", 0.05, pulses=(Pulse("f_wedge_zeta", 1.0, 0.005, 0.002),))
    run = amb.simulate(machine, controller, push, rate=1e5, delay_samples=1)
    line = amb.simulate(machine, controller, push, linear=True)
    row = "q_wedge_zeta"
    a, b = run.record, line.record
    found = np.interp(b.time, a.time, a[row] - a[row][0])
    assert np.abs(b[row]).max() > 1e-8
    assert np.abs(found - b[row]).max() < 0.02 * np.abs(b[row]).max()


def test_its_controller_is_exported_as_c(machine, controller, tmp_path):
    amb.export(controller, tmp_path / "code", to="c", machine=machine)
    assert list((tmp_path / "code").rglob("*.c"))


# ---- what is not linear: the force at an address


@dataclass(frozen=True, slots=True, repr=False)
class HardSpring(Part):
    """A spring to the ground that grows stiffer, f = -(k + h r^2) (x, y)."""

    name: Annotated[Name, "name"]
    position: Annotated[Length, "axial position"]
    stiffness: Annotated[float, Quantity("stiffness"), "stiffness at the centre"]
    growth: Annotated[float, Quantity("plain number"), "growth h [N/m3]"]


def hard_force(x, y, vx, vy, speed, p):
    k = p[0] + p[1] * (x * x + y * y)
    return -k * x, -k * y


HARD_SPRING = Effect(
    table="hard_spring",
    part=HardSpring,
    reaction=lambda part, point: Reaction(part.stiffness * np.eye(2), np.zeros((2, 2))),
    force=hard_force,
    constants=lambda part: (part.stiffness, part.growth),
)


@pytest.fixture
def _hard() -> Iterator[None]:
    registry.register("effect", "hard_spring", HARD_SPRING)
    yield
    registry.unregister("effect", "hard_spring")


def test_a_force_that_is_not_linear_acts_on_the_rig(machine, controller, _hard):
    hard = replace(machine, effects=(HardSpring("hard", 0.2, K, 0.0),), tolerances=())
    soft = replace(hard, effects=(), couplings=(Coupling("hard", 0.2, (K, K)),))
    push = Scenario("push", 0.02, pulses=(Pulse("f_hard_x", 50.0, 0.001, 0.01),))
    along = replace(push, pulses=(replace(push.pulses[0], signal="f_hard_zeta"),))
    law = controller.controller
    one, two = virtual_rig.run(hard, law, push), virtual_rig.run(soft, law, along)
    expected, found = two.record["q_hard_zeta"], one.record["q_hard_x"]
    assert np.abs(expected).max() > 5e-6
    assert np.abs(found - expected).max() < 1e-5 * np.abs(expected).max()

    harder = replace(hard, effects=(HardSpring("hard", 0.2, K, 1e15),))
    bend = _forces(harder, 1e-5) - _forces(hard, 1e-5)
    first = build(hard).constants.shape[2, :2]
    # the force on the bounce coordinate, whose deflection at the spring is ``first``
    assert bend[:4:2] == pytest.approx(-1e15 * 1e-15 * first, rel=1e-9)


def _forces(machine: amb.Machine, x: float) -> np.ndarray:
    """Accelerations of the modal coordinates with the rotor moved along x by x [m]."""
    rig = build(machine)
    drive = stretch(plan(rig, Scenario("still", 0.01), 1e-4, 0), 0, 1)
    q = np.zeros(rig.coordinates)
    q[0] = x / rig.constants.shape[2, 0]
    n = rig.coordinates
    return slope(rig, drive, state_at_rest(rig, q, np.zeros(4)), np.zeros(4))[n : 2 * n]


def test_a_tolerance_of_a_coupling_is_no_special_case(machine):
    """Its channels come from its registration, too."""
    coupled = replace(
        machine,
        effects=(),
        couplings=(Coupling("spring", 0.1, (2e5, 3e5), (10.0, 20.0)),),
        tolerances=(Tolerance("coupling.spring.damping.eta", relative=0.5),),
    )
    plant = free_mode_reduction(assemble(coupled), 0)
    moved = perturbed(plant, {"coupling.spring.damping.eta": 1.0})
    other = replace(coupled, couplings=(replace(coupled.couplings[0], damping=(10.0, 30.0)),))
    expected = poles(free_mode_reduction(assemble(other), 0).system)
    assert matched(poles(moved.system), expected) == pytest.approx(expected, rel=1e-8, abs=1e-6)
