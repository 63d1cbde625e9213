import numpy as np
import pytest

from ambrose import StateSpace, load_machine
from ambrose.code.sampled import deploy, unmet_limits
from ambrose.core.checks import InvalidInput, UnstableSystem
from ambrose.core.frequency import frequency_response
from ambrose.core.sampling import c2d
from ambrose.core.statespace import feedback, poles, select, series, static_gain
from ambrose.judge.result import Certificate, Synthesis
from ambrose.judge.sampled import check_over_box
from ambrose.law.design_problem import design_plant
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import perturbed, reduce
from ambrose.synthesis.design import design
from ambrose.synthesis.hinf import hinf_synthesis

DT = 1e-4


@pytest.fixture(scope="module")
def plants():
    machine = load_machine("seal-rig")
    return [reduce(assemble(machine, point), 1) for point in machine.operation.points]


@pytest.fixture(scope="module")
def pid(plants):
    return design(plants[0], "pid")


@pytest.fixture(scope="module")
def robust(plants):
    """An H-infinity controller: stable from zero to twice the nominal pressure."""
    return hinf_synthesis(
        design_plant(reduce(assemble(load_machine("seal-rig")), 0), uncertain=False)
    )


def test_a_controller_that_holds_everywhere_is_verified(plants, robust):
    found = deploy(robust, DT, DT, plants=plants)
    assert found.verified
    assert found.delay == 1
    assert len(found.checks) == len(plants)
    assert found.in_loop.n_states == found.controller.n_states + 4
    assert found.box[0]["sampled.stability.box"].value == 0
    assert all("limit" in text for text in unmet_limits(found))


def test_sampled_sensitivity_against_frequency_response(plants, robust):
    """The peak over the box is at least what the sampled loop's response shows at its corners, and
    nearly that.
    """
    late = deploy(robust, DT, DT, plants=plants[:1]).in_loop
    worst = 0.0
    omega = np.geomspace(1, 0.99 * np.pi / DT, 4000)
    for delta in np.linspace(-1, 1, 17):
        plant = perturbed(plants[0], {"seal.center.pressure": delta})
        G = c2d(select(plant.system, plant.named("u"), plant.named("y")), DT)
        S = feedback(static_gain(np.eye(4), dt=DT), series(late, G))
        worst = max(
            worst, float(np.linalg.norm(frequency_response(S, omega).values, 2, axis=(1, 2)).max())
        )
    value = check_over_box(plants[0], late)["sampled.sensitivity.box"].value
    assert worst * (1 - 1e-9) <= value <= 1.01 * worst


def test_refused_where_the_sampled_loop_is_unstable(plants, pid):
    with pytest.raises(
        UnstableSystem,
        match=r"the sampled loop is unstable at twice nominal pressure; .* points of the tol",
    ):
        deploy(pid, DT, DT, plants=plants)
    found = deploy(pid, DT, DT, plants=plants, force=True)
    assert not found.verified
    assert not found.box[0].checks[0].passed


def test_delay_counts(plants, robust):
    """Enough computing delay destabilises: the delay is in the loop that is verified."""
    with pytest.raises(UnstableSystem, match="the sampled loop is unstable at nominal pressure"):
        deploy(robust, DT, 20 * DT, plants=plants[:1])


def test_refused_without_verification(pid):
    with pytest.raises(UnstableSystem, match="never verified on a plant"):
        deploy(pid.controller, DT)
    with pytest.raises(UnstableSystem, match="not examined: no plant was given"):
        deploy(pid, DT)


def test_refused_when_the_status_is_unstable(plants, robust):
    bad = Synthesis(
        robust.controller, "hinf", 1.0, "unstable", Certificate(False, 1.0, np.inf, 1.0)
    )
    with pytest.raises(UnstableSystem, match="status is 'unstable', not 'verified'"):
        deploy(bad, DT, plants=plants)


def test_refused_when_the_controller_itself_is_unstable():
    K = StateSpace([[3.0]], [[1.0]], [[1.0]], [[0.0]])
    with pytest.raises(
        UnstableSystem, match=r"the controller itself is unstable \(a pole at \+3 rad/s\)"
    ):
        deploy(K, DT)


def test_sample_rate_too_low_states_the_needed_one():
    K = StateSpace([[-1000.0 * np.pi]], [[1.0]], [[1.0]], [[0.0]])
    message = (
        r"the sample rate is 500 Hz, but must be at least 1000 Hz for a pole at 3142 rad/s; sample "
        r"at 1000 Hz or more"
    )
    with pytest.raises(InvalidInput, match=message):
        deploy(K, 2e-3, force=True)
    assert deploy(K, 0.99e-3, force=True).controller.n_states == 1


@pytest.mark.parametrize("delay", [0.5 * DT, -DT, np.nan])
def test_delay_that_is_no_whole_number_of_samples(delay):
    with pytest.raises(InvalidInput, match="the computing delay"):
        deploy(StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]]), DT, delay, force=True)


@pytest.mark.parametrize("sample_time", [0.0, -1.0, np.inf, np.nan])
def test_sample_time_that_means_nothing(sample_time):
    with pytest.raises(InvalidInput, match="the sample time"):
        deploy(StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]]), sample_time, force=True)


@pytest.mark.parametrize(
    ("method", "prewarp"),
    [("tustin", None), ("tustin", 600.0), ("zoh", None), ("backward-euler", None)],
)
def test_modal_form_is_the_same_controller(robust, method, prewarp):
    found = deploy(robust, DT, method=method, prewarp=prewarp, force=True)
    dense = c2d(robust.controller, DT, method, prewarp=prewarp)
    omega = np.geomspace(1, 0.99 * np.pi / DT, 300)
    expected, got = (frequency_response(K, omega).values for K in (dense, found.controller))
    assert np.abs(got - expected).max() <= 1e-9 * np.abs(expected).max()
    assert (
        np.abs(found.increment[np.abs(np.subtract.outer(np.arange(20), np.arange(20))) > 1]) == 0
    ).all()


@pytest.mark.parametrize("prewarp", [None, 2000.0])
def test_matched_channels_in_modal_form(pid, prewarp):
    """The increment is A - I of the poles exp(s dt), with all digits of a slow one."""
    found = deploy(pid, DT, method="matched", prewarp=prewarp, force=True)
    omega = np.geomspace(1, 0.99 * np.pi / DT, 300)
    dense = c2d(pid.controller, DT, "matched", prewarp=prewarp)
    expected, got = (frequency_response(K, omega).values for K in (dense, found.controller))
    assert np.abs(got - expected).max() <= 1e-9 * np.abs(expected).max()
    held = np.sort(np.expm1(poles(pid.controller).real * DT))
    np.testing.assert_allclose(np.sort(np.diag(found.increment)), held, rtol=1e-9, atol=1e-15)


def test_slow_poles_keep_their_digits(robust):
    """1.5e-3 rad/s at 10 kHz is 1 - 1.5e-7: from A alone nine digits would be left."""
    found = deploy(robust, DT, force=True)
    continuous = poles(robust.controller)[:4].real
    slow = np.sort(np.diag(found.increment)[:4])[::-1]
    expected = np.sort(continuous * DT / (1 - continuous * DT / 2))[::-1]
    assert np.abs(slow / expected - 1).max() < 1e-10


def test_a_sampled_controller_keeps_its_rate():
    K = StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], dt=DT)
    assert deploy(K, DT, force=True).controller.dt == DT
    with pytest.raises(InvalidInput, match="sampled already"):
        deploy(K, 2 * DT, force=True)
