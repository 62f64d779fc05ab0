"""Checks of essential conditions: rigid motions that stay free, and conditions without nodes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.errors import IdleConditionWarning, warn
from dolfinmpm.basis.conditions import Condition, node_coordinates
from dolfinmpm.basis.space import Space

__all__ = ["free_motions", "idle", "warn_idle"]


def idle(
    conditions: Sequence[Condition],
    spaces: Sequence[Space],
    active: Sequence[npt.NDArray[np.int32]],
) -> list[str]:
    """Places whose conditions constrain no active node on any rank. Collective.

    Args:
        conditions: The conditions. Conditions with `follows=True`, and conditions of refined
            spaces, are not looked at.
        spaces: Spaces of the fields.
        active: Active nodes of each space, in the numbering of the conditions.

    Returns:
        Names of the places, each name once.
    """
    conditions = [c for c in conditions if c.place is None and c.space.refinement is None]
    if not conditions:
        return []
    acts = np.zeros(len(conditions), np.int32)
    for space, nodes in zip(spaces, active):
        moved = np.zeros(space.basis.nodes.size, bool)
        moved[nodes] = True
        for k, condition in enumerate(conditions):
            if condition.space is space:
                acts[k] = moved[condition.nodes].any()
    spaces[0].grid.comm.Allreduce(MPI.IN_PLACE, acts, op=MPI.MAX)
    return list(dict.fromkeys(c.where for c, acting in zip(conditions, acts) if not acting))


def warn_idle(comm: MPI.Intracomm, names: Sequence[str]) -> None:
    """Warn on rank 0 of conditions that constrain no active node.

    Args:
        comm: Communicator of the ranks.
        names: Names of their places, see `idle`.
    """
    if names:
        places = ", ".join(f"'{name}'" for name in names)
        warn(
            comm,
            f"the conditions at {places} hold no node that the body moves: the body does not reach "
            "these places now. The conditions do nothing until the body reaches them. Names of "
            "sides mean sides of the grid; give a function of positions to hold the body elsewhere",
            IdleConditionWarning,
        )


def free_motions(
    conditions: Sequence[Condition],
    space: Space,
    active: npt.NDArray[np.int32],
    axisymmetric: bool = False,
) -> list[str]:
    """Rigid motions that no condition constrains, in words. Collective.

    Args:
        conditions: The conditions.
        space: Space of the displacement.
        active: Its active nodes.
        axisymmetric: Whether the body is axisymmetric. Its only rigid motion is along the axis.

    Returns:
        Descriptions such as "along x" and "1 with a turn"; empty if all motions are constrained.
    """
    x, gdim, comm = node_coordinates(space), space.grid.geometry.dim, space.grid.comm
    moved = np.zeros(len(x), bool)
    moved[active] = True
    sums = comm.allreduce(np.append(x[moved].sum(axis=0), moved.sum()), op=MPI.SUM)
    middle = sums[:-1] / max(sums[-1], 1.0)
    spread = np.abs(x[moved] - middle).max(initial=0.0)
    size = max(comm.allreduce(spread, op=MPI.MAX), np.finfo(float).tiny)
    turns = [(i, j) for i in range(gdim) for j in range(i + 1, gdim)]
    square = np.zeros((gdim + len(turns),) * 2)
    for condition in conditions:
        if condition.space is not space:
            continue
        nodes = condition.nodes[moved[condition.nodes]]
        rows = np.zeros((nodes.size, len(square)))
        k, r = condition.component, (x[nodes] - middle) / size
        rows[:, k] = 1.0
        for at, (i, j) in enumerate(turns):
            if k in (i, j):
                rows[:, gdim + at] = -r[:, j] if k == i else r[:, i]
        square += rows.T @ rows
    square = comm.allreduce(square, op=MPI.SUM)
    if axisymmetric:
        return ["along y"] if square[1, 1] == 0.0 else []
    values, vectors = np.linalg.eigh(square)
    free = vectors[:, values <= 1e-12 * max(values.max(), 1.0)].T
    if not len(free):
        return []
    # axes along which the body can move alone, without another motion
    along = [f"along {'xyz'[i]}" for i in range(gdim) if abs(np.linalg.norm(free[:, i]) - 1) < 1e-9]
    turning = len(free) - len(along)
    return along + ([f"{turning} with a turn"] if turning else [])
