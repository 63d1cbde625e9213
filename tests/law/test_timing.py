"""When a controller acts: who is heard first, and the two forms of its loop."""

from dataclasses import replace

import numpy as np
import pytest

from ambrose import load_machine
from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import frequency_response
from ambrose.core.sampling import c2d, delayed
from ambrose.core.statespace import StateSpace, transfer_function
from ambrose.judge.result import Provenance, Synthesis, pid_synthesis
from ambrose.law.loop import Timing, machine_timing, timing_of
from ambrose.law.pid import pid_controller
from ambrose.machine.file.toml import dumps_machine, loads_machine
from ambrose.machine.part import PidSettings
from ambrose.model.assemble import assemble
from ambrose.synthesis.design import methods_for

MACHINE = load_machine("seal-rig")
LAW = pid_controller(MACHINE.controller, MACHINE)


def stating(sample_time, delay=None):
    """The seal rig with a sample time and a delay in its file."""
    return replace(
        MACHINE, controller=replace(MACHINE.controller, sample_time=sample_time, delay=delay)
    )


def designed(rate, samples):
    """A law that was designed for a rate."""
    settings = {"rate": rate, "delay_samples": samples}
    return Synthesis(LAW, provenance=Provenance(settings=settings))


def test_nothing_known_is_none():
    assert (
        machine_timing(MACHINE) is None
        and timing_of(MACHINE, LAW) is None
        and timing_of(None) is None
    )


@pytest.mark.parametrize(
    ("machine", "controller", "rate", "samples", "expected"),
    [
        (stating(50e-6), LAW, None, None, (50e-6, 1)),
        (stating(50e-6, 0.0), LAW, None, None, (50e-6, 0)),
        (stating(50e-6, 100e-6), LAW, None, None, (50e-6, 2)),
        # the design goes before the machine
        (stating(50e-6, 100e-6), designed(8e3, 1), None, None, (1 / 8e3, 1)),
        # and a sampled law before both
        (stating(50e-6, 100e-6), c2d(LAW, 1e-4, "tustin"), None, None, (1e-4, 2)),
        # and what is asked for before all
        (stating(50e-6, 100e-6), designed(8e3, 1), 5e3, None, (2e-4, 2)),
        (stating(50e-6, 100e-6), LAW, None, 0, (50e-6, 0)),
        (MACHINE, LAW, 1e4, None, (1e-4, 1)),
        (None, LAW, 1e4, 3, (1e-4, 3)),
    ],
)
def test_who_is_heard_first(machine, controller, rate, samples, expected):
    found = timing_of(machine, controller, rate, samples)
    assert (found.sample_time, found.delay_samples) == pytest.approx(expected)


def test_a_delay_without_a_rate_is_refused():
    with pytest.raises(InvalidInput, match=r"delay_samples is 1.*given with a rate"):
        timing_of(MACHINE, LAW, delay_samples=1)
    for samples in (-1, 1.5, True):
        with pytest.raises(InvalidInput, match="whole number of samples"):
            Timing(1e-4, samples)


def test_a_fraction_of_a_sample_in_a_machine_file_is_rounded_up_and_said():
    """Identification finds such delays; outputs are set when a sample is taken."""
    found = machine_timing(stating(100e-6, 140e-6))
    assert (
        found.delay_samples == 2
        and str(found) == "sampled at 10000 Hz, 2 samples late (machine file, 1.4 rounded up)"
    )
    assert machine_timing(stating(100e-6, 100e-6)).source == "machine file"
    assert machine_timing(stating(None, 100e-6)) is None  # a delay alone tells no rate


def test_the_late_continuous_law_follows_the_sampled_one():
    """Both forms of the same loop: to 1 kHz at 10 kHz they agree within 0.4 % and 0.4 degrees but
    for Tustin's bend.
    """
    law, timing = transfer_function([1.0], [1e-4, 1.0], "err_a", "u_a"), Timing(1e-4, 1)
    omega = 2 * np.pi * np.geomspace(1, 1000, 40)
    # an integrator behind a hold
    held = c2d(StateSpace([[0.0]], [[1.0]], [[1.0]], [[0.0]], ["u_a"], ["y_a"]), 1e-4)
    whole = (
        frequency_response(timing.in_loop(law), omega).values
        * frequency_response(held, omega).values
    )
    bent = (
        frequency_response(c2d(law, 1e-4, "tustin"), omega).values
        / frequency_response(law, omega).values
    )
    model = frequency_response(timing.late(law), omega).values * bent / (1j * omega)[:, None, None]
    ratio = (model / whole)[:, 0, 0]
    assert np.abs(np.abs(ratio) - 1).max() < 0.02 and np.abs(np.angle(ratio, deg=True)).max() < 0.4
    assert np.abs(np.abs(ratio[omega < 2 * np.pi * 300]) - 1).max() < 0.002


def test_a_sampled_law_of_another_rate_is_refused():
    with pytest.raises(InvalidInput, match="sample time"):
        Timing(1e-4).in_loop(c2d(LAW, 2e-4, "tustin"))
    np.testing.assert_array_equal(
        Timing(1e-4, 2).in_loop(LAW).A, delayed(c2d(LAW, 1e-4, "tustin"), 2).A
    )


def test_a_controller_table_may_state_the_rate_alone():
    """A machine without gains yet: when its controllers run is known, a reference controller is
    not.
    """
    machine = replace(MACHINE, controller=PidSettings(sample_time=1e-4, delay=2e-4))
    assert machine.reference is None and machine_timing(machine).delay_samples == 2
    assert loads_machine(dumps_machine(machine)) == machine
    assert "pid" not in methods_for(assemble(machine)) and "hinf" in methods_for(assemble(machine))
    with pytest.raises(
        InvalidInput, match=r"has no reference controller; add a \[controller\] with its gain"
    ):
        pid_synthesis(assemble(machine))
    with pytest.raises(InvalidInput, match=r"gain .* is missing"):
        replace(MACHINE, controller=PidSettings(sample_time=1e-4, integral_time=0.1))
