"""What happens once a control sample, compiled: the controller or a program in its place, and what
the amplifiers are told.

This module imports numba: import it only inside functions.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ambrose.rig.engine.inlined import by_address, compiled

if TYPE_CHECKING:
    from ambrose.rig.engine.controller import SampledLaw


@compiled
def control(
    law: SampledLaw, drive: Any, k: int, y: Any, x: Any, held: Any, u: Any, err: Any, ahead: Any
) -> None:
    """One sample of the controller: err = r - y, u (a,) what acts now, held (a,) what acts later;
    ahead (m,) is scratch.
    """
    n, m = x.shape[0], y.shape[0]
    # e = r - y; with a delay of one sample what was computed last acts now
    for a in range(m):
        u[a] = held[a]
        err[a] = drive.reference[a, k] - y[a]
    for a in range(m):
        value = 0.0
        for j in range(n):
            value += law.C[a, j] * x[j]
        for j in range(m):
            value += law.D[a, j] * err[j]
        held[a] = min(max(value, -law.limit[a]), law.limit[a])

    # x_(k+1) = A x_k + B e_k
    for i in range(n):
        value = 0.0
        for j in range(n):
            value += law.A[i, j] * x[j]
        for j in range(m):
            value += law.B[i, j] * err[j]
        ahead[i] = value
    for i in range(n):
        x[i] = ahead[i]
    if law.delay == 0:
        for a in range(m):
            u[a] = held[a]


@compiled
def run_program(
    law: SampledLaw, program: Any, drive: Any, k: int, y: Any, held: Any, u: Any, err: Any
) -> int:
    """One sample of a program at an address: what it computes acts at the next one. Negative where
    it gave up.
    """
    m = y.shape[0]
    for a in range(m):
        u[a] = held[a]
        err[a] = drive.reference[a, k] - y[a]

    # signals: inputs (m), outputs (m), then what it is scheduled over; 8 bytes each
    for i in range(m):
        program.signals[i] = err[program.into[i]]
    for i in range(drive.told.shape[1]):
        program.signals[2 * m + i] = drive.told[k, i]
    at = program.place
    failed: int = by_address(program.address, program.first, at, at + 16 * m, at + 8 * m)
    for a in range(m):
        held[a] = min(max(program.signals[m + program.out[a]], -law.limit[a]), law.limit[a])
    return failed


@compiled
def command(drive: Any, work: Any, k: int, u: Any) -> None:
    """What the amplifiers are told: controller plus excitation; nothing without power."""
    for a in range(u.shape[0]):
        work.command[a] = (u[a] + drive.excitation[a, k]) * drive.powered[a, k]
