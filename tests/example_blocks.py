"""Control blocks for the tests of what is written from them: no synthesis, so that they take no
time.
"""

import numpy as np
import scipy.linalg as sla

from ambrose import StateSpace
from ambrose.code.block.block import ControlBlock, build_block
from ambrose.code.sampled import deploy

ERROR = 0.5e-3
CURRENT = 4.0
DT = 1e-4
AXES = ("A_zeta", "A_eta", "B_zeta", "B_eta")
_PAIRS = (
    (60.0, 200.0),
    (90.0, 700.0),
    (150.0, 1500.0),
    (300.0, 3000.0),
    (900.0, 5000.0),
    (2500.0, 9000.0),
)
_REAL = (40.0, 55.0, 400.0, 800.0, 3000.0, 5000.0, 8000.0, 11000.0)


def rig_controller() -> StateSpace:
    """24 states, 4 errors, 4 currents: four integrators, six oscillations, eight real poles; as
    large as the seal rig's.
    """
    rng = np.random.default_rng(5)
    blocks = [np.zeros((4, 4)), *([[-a, w], [-w, -a]] for a, w in _PAIRS), *([[-a]] for a in _REAL)]
    A = sla.block_diag(*blocks)
    B = rng.normal(0, 1, (24, 4)) * np.r_[np.ones(4), np.abs(np.diag(A)[4:]) + 100][:, None]
    C = rng.normal(0, 1, (4, 24)) * np.r_[np.full(4, 1e4), np.full(20, 3e3)]
    D = 2e4 * np.eye(4) + rng.normal(0, 1e3, (4, 4))
    return StateSpace(A, B, C, D, [f"err_{a}" for a in AXES], [f"u_{a}" for a in AXES])


def rig_block(delay: int = 1, name: str = "rig") -> ControlBlock:
    return build_block(deploy(rig_controller(), DT, delay * DT, force=True), name, ERROR, CURRENT)


def small_controller() -> StateSpace:
    """Two inputs, one output, an integrator, a complex pair and a real pole; no direct term."""
    A = [[0.0, 0, 0, 0], [0, -200.0, 900.0, 0], [0, -900.0, -200.0, 0], [0, 0, 0, -3000.0]]
    B, C = [[40.0, 10.0], [0, 5e5], [5e5, 0], [9e6, 4e6]], [[500.0, 1.0, 1.0, 2.0]]
    return StateSpace(A, B, C, [[0.0, 0.0]], ["err_x", "err_y"], ["u_x"])


def small_block(
    delay: int = 1, name: str = "small", system: StateSpace | None = None
) -> ControlBlock:
    K = small_controller() if system is None else system
    return build_block(deploy(K, DT, delay * DT, force=True), name, 1e-3, 2.0)


def gain_block(name: str = "gain") -> ControlBlock:
    """A gain without states: nothing to track, nothing to wind up."""
    K = StateSpace([], [], [], [[2.1e3, 0.0], [0.0, 3.1e3]], ["err_x", "err_y"], ["u_x", "u_y"])
    return build_block(deploy(K, 1e-3, 1e-3, force=True), name, 1e-3, 2.0)
