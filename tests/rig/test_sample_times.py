"""Sample times: a rate in the machine file, edges between samples, clocks some parts per million
apart.
"""

from dataclasses import replace

import numpy as np
import pytest

import ambrose as amb
from ambrose.core.checks import InvalidInput, same_clock
from ambrose.core.statespace import StateSpace, series
from ambrose.identification.output_error.problem import check_records
from ambrose.law.loop import Timing, machine_timing, timing_of
from ambrose.rig.linear import waveforms
from ambrose.rig.scenario import Prbs, Pulse, Scenario, bundled_scenarios, load_scenario
from ambrose.rig.virtual_rig import check_scenario

WRITTEN, TRUE = 66.667e-6, 1 / 15e3  # 15 kHz as a machine file has it, 5 ppm off


def test_a_rate_in_the_machine_file_is_a_sample_time(tmp_path):
    machine = amb.load_machine("seal-rig")
    path = tmp_path / "rig.toml"
    amb.save_machine(
        replace(machine, controller=replace(machine.controller, sample_rate=15e3)), path
    )
    assert 'sample_rate = "15000 Hz"' in path.read_text() and "sample_time" not in path.read_text()
    again = amb.load_machine(path)
    assert machine_timing(again).sample_time == TRUE and str(machine_timing(again)).startswith(
        "sampled at 15000 Hz"
    )
    path.write_text(path.read_text().replace('"15000 Hz"', '"15 kHz"'))
    assert amb.load_machine(path).controller == again.controller


@pytest.mark.parametrize(
    ("rate", "time", "words"),
    [
        (15e3, 1e-4, "leave one out"),
        (-1.0, None, "sample_rate"),
        (0.0, None, "sample_rate"),
        (1e9, None, "at least 1e-07 s"),
    ],
)
def test_wrong_rates_are_refused(rate, time, words):
    machine = amb.load_machine("seal-rig")
    with pytest.raises(InvalidInput, match=words):
        replace(machine, controller=replace(machine.controller, sample_rate=rate, sample_time=time))


def test_edges_move_to_the_nearest_sample():
    """ "bit_time must be a multiple of dt" was the answer to 66.667 us for 15 kHz."""
    scenario = Scenario(
        "x", 0.1, pulses=(Pulse("e_A", 1.0, 0.05, 0.01),), sequences=(Prbs("e_B", 1.0, 1e-3),)
    )
    _, true = waveforms(scenario, ["e_A", "e_B"], TRUE, 1500)
    _, written = waveforms(scenario, ["e_A", "e_B"], WRITTEN, 1500)
    assert np.array_equal(true, written)
    start = int(np.argmax(true[0, 0] > 0))
    assert start == 750 and true[0, 0].sum() == 150
    _, coarse = waveforms(scenario, ["e_A", "e_B"], 1 / 7e3 * 1.003, 600)
    assert abs(int(np.argmax(coarse[0, 0] > 0)) / 7e3 * 1.003 - 0.05) <= 0.5 / 7e3 * 1.003


def test_a_length_of_few_samples_is_not_stretched():
    for bit, usable in ((1.5e-4, False), (1.05e-4, True), (5.4e-4, True), (0.4e-4, False)):
        scenario = Scenario("x", 0.1, sequences=(Prbs("e_A", 1.0, bit),))
        if usable:
            waveforms(scenario, ["e_A"], 1e-4, 100)
        else:
            with pytest.raises(InvalidInput, match="to a tenth of it"):
                waveforms(scenario, ["e_A"], 1e-4, 100)


def test_every_bundled_scenario_runs_at_an_odd_rate():
    machine = amb.load_machine("seal-rig")
    for name in bundled_scenarios().keys() - {
        "five-axes",
        "surge",
        "thrust-step",
        "thrust-reversal",
    }:
        check_scenario(machine, load_scenario(name), WRITTEN)


def test_clocks_some_parts_per_million_apart_are_one():
    assert (
        same_clock(15000.0, 14999.9) and same_clock(WRITTEN, TRUE) and not same_clock(15e3, 15.1e3)
    )
    one, other = (StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], dt=dt) for dt in (TRUE, WRITTEN))
    assert series(one, other).dt == TRUE
    with pytest.raises(InvalidInput, match="sample times"):
        series(one, StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], dt=1e-4))
    assert Timing(WRITTEN).in_loop(one).dt == TRUE
    machine = amb.load_machine("seal-rig")
    records = [
        amb.Record(machine.name, rate, ("y_A_zeta",), ("m",), np.zeros((1, 9)))
        for rate in (15e3, 14999.9)
    ]
    assert check_records(machine, records)[1] == TRUE
    with pytest.raises(InvalidInput, match="sample rate of record 2"):
        check_records(machine, [records[0], replace(records[1], sample_rate_hz=14e3)])


def test_a_delay_of_whole_samples_stays_whole():
    """A sample of 66.667 us with a delay of 66.668 us is one sample late, and not two."""
    machine = amb.load_machine("seal-rig")
    late = replace(
        machine, controller=replace(machine.controller, sample_time=WRITTEN, delay=66.669e-6)
    )
    assert timing_of(late).delay_samples == 1
