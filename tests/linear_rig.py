"""The seal rig as a linear plant without bending modes, and its PID at 10 kHz: what records of
identification are made of.
"""

from functools import cache

from ambrose import load_machine
from ambrose.core.sampling import c2d
from ambrose.judge.result import pid_synthesis
from ambrose.law.loop import match_controller
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import free_mode_reduction

DT = 1e-4
AXES = ("A_zeta", "A_eta", "B_zeta", "B_eta")
Y, E = tuple(f"y_{a}" for a in AXES), tuple(f"e_{a}" for a in AXES)


@cache
def rig():
    """Machine, plant, continuous controller, and the controller sampled every ``DT`` [s]."""
    machine = load_machine("seal-rig")
    plant = free_mode_reduction(assemble(machine), 0)
    controller = pid_synthesis(plant).controller
    return machine, plant, controller, match_controller(c2d(controller, DT, "tustin"), plant)
