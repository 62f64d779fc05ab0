"""What the studies of linear consolidation share: steps in time, values at nodes, round edges."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scene import finish, say, solver_figures

import dolfinmpm as mpm

# Of water that is next to nothing, and of soils whose strains are
WATER = mpm.Fluid(density=1000.0, gravity=10.0)
PERMEABILITY = 1e-6  # m/s
SMALL = 1e-6  # largest stress, by E


def consolidation_coefficient(E: float, nu: float) -> float:
    """c_v = k M/γ_w (m²/s), M being the P-wave modulus of E (Pa) and ν."""
    M = E * (1 - nu) / ((1 + nu) * (1 - 2 * nu))
    return PERMEABILITY * M / WATER.unit_weight


def add_times(add: Callable[..., Any], numbers: Callable, times: Sequence[float], steps: int):
    """Arguments of when to measure, and in how many steps."""
    add("--times", type=numbers(float), default=list(times), help="at which to measure")
    add("--steps", type=int, default=steps, help="up to the last time, in geometric progression")
    add("--theta", type=float, default=0.5, help="1: backward Euler; 0.5: Crank–Nicolson")
    add("--stabilisation", choices=("none", "ghost", "aggregation"), default="none")


def instants(times: Sequence[float], steps: int) -> np.ndarray:
    """Times to step to, from one that drains next to nothing; those to measure at among them."""
    first = min(1e-4, 1e-2 * min(times))
    return np.unique(np.concatenate([np.geomspace(first, max(times), steps), times]))


def node_value(space: mpm.Space, place: Sequence[float], component: int = 0) -> float:
    """Value of an increment of linear functions at the node at a place. Collective."""
    function, comm = space.increment, space.grid.comm
    x = function.function_space.tabulate_dof_coordinates()
    size = function.function_space.dofmap.index_map_bs
    own = function.function_space.dofmap.index_map.size_local
    d = space.grid.geometry.dim
    near = np.linalg.norm(x[:own, :d] - np.asarray(place), axis=1)
    least = np.min(comm.allgather(near.min(initial=np.inf)))
    found = near == least
    values = function.x.array.reshape(-1, size)[:own][found, component]
    # ranks that do not own it have nothing to say
    return float(comm.allreduce(values.sum()) / comm.allreduce(int(found.sum())))


def rim(points: mpm.MaterialPoints, radius: float, segments: int = 20000) -> mpm.Surface:
    """The circle about the origin as a surface: each of its segments belongs to the nearest point.

    For a body in the first quadrant, on one rank.
    """
    from scipy.spatial import cKDTree

    angle = 0.5 * np.pi * (np.arange(segments) + 0.5) / segments
    normal = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    length = 0.5 * np.pi * radius / segments
    _, owner = cKDTree(points["x"]).query(radius * normal)
    count = len(points)
    area = np.stack([np.bincount(owner, length * n, count) for n in normal.T], axis=1)
    share = np.maximum(np.bincount(owner, minlength=count), 1)
    place = np.stack([np.bincount(owner, radius * n, count) for n in normal.T], axis=1)
    offset = np.where(share[:, None] * area.any(axis=1)[:, None], place / share[:, None], 0.0)
    offset = np.where(area.any(axis=1)[:, None], offset - points["x"], 0.0)
    return mpm.Surface.from_arrays(points, offset, area, "rim")


def report(args: Any, problem: Any, columns: dict[str, Any], **more: Any) -> None:
    """Print the columns by time, and write them and what the solver took."""
    names = [name for name in columns if not name.endswith("_exact")]
    say("     time  " + "".join(f"{name[:20]:>22}" for name in names))
    for k, t in enumerate(args.times):
        cells = []
        for name in names:
            exact = columns.get(f"{name}_exact")
            beside = "" if exact is None else f" ({exact[k]:.5f})"
            cells.append(f"{columns[name][k]:.5f}{beside}")
        say(f"{t:9g}  " + "".join(f"{cell:>22}" for cell in cells))
    lists = {name: np.asarray(values).tolist() for name, values in columns.items()}
    finish(args, {**lists, **more, **solver_figures(problem)})
