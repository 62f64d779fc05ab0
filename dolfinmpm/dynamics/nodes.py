"""What explicit steps do at the nodes of a window, see `dolfinmpm.dynamics.window`."""

from __future__ import annotations

import math

import numba
import numpy as np

from dolfinmpm.dynamics.passes import FAST

__all__ = ["divide", "fastest", "move_nodes", "take_means"]


@numba.njit(cache=True, error_model="numpy")
def _rub(mark, rubbing, velocity):
    """Stop a node that would move out of sides of the grid, and let friction act on its slip."""
    for face in range(rubbing.shape[0]):
        if (mark >> np.uint64(face)) & np.uint64(1) == 0:
            continue
        axis, outward, mu = int(rubbing[face, 0]), rubbing[face, 1], rubbing[face, 2]
        out = outward * velocity[axis]
        if not out > 0.0:
            continue
        velocity[axis] = 0.0
        slip = 0.0
        for i in range(velocity.size):
            slip += velocity[i] ** 2
        left = max(0.0, 1.0 - mu * out / max(math.sqrt(slip), 1e-300))
        for i in range(velocity.size):
            velocity[i] *= left


@numba.njit(cache=True, error_model="numpy", fastmath=FAST)
def move_nodes(
    box, columns, out, nodes, own, fixed, before, held, faces, pushed, g, dt, kick, scaling,
    damping, known, last, done,
):  # fmt: skip
    """Accelerate the nodes of a box.

    Args:
        own: Whose work this rank counts.
        before, held: Velocities of fixed components at the start and the end of the step.
        faces: What acts at sides of the grid, see `Faces.by_nodes`.
        pushed: Written unless empty, changes of velocity by forces alone.
        dt, kick: For how long nodes move, and for how long forces act on them (s).
        known: Whether velocities for the strain have been set before.
        last: Whether the points move by these velocities; then the sums are done with, and cleared.
        done: Added to, see `FusedSteps.done`.
    """
    _, mass, force, second = columns
    d = fixed.shape[1]
    marks, rubbing, dashpots = faces
    ends, forces, resisting = np.empty(d), np.empty(d), np.zeros(d)
    work = grid = damped = rubbed = 0.0
    for block in range(box[0], box[1]):
        for k in range(block * box[4] + box[2], block * box[4] + box[3]):
            m = out[k, mass]
            half = 0.5 * m * scaling if own[k] else 0.0
            per_mass = 1.0 / m if m > 0.0 else 0.0
            for i in range(d):
                y = out[k, i] * per_mass
                f = out[k, force + i] + m * g[i]
                if damping > 0.0:
                    resisting[i] = damping * abs(f) * np.sign(before[k, i] if fixed[k, i] else y)
                    f -= resisting[i]
                forces[i] = f
                ends[i] = before[k, i] if fixed[k, i] else y + kick * f * per_mass / scaling
            if dashpots.shape[0] > 0 and m > 0.0:
                for i in range(d):
                    damped += half * ends[i] ** 2
                    ends[i] /= 1.0 + kick * dashpots[k, i] / (m * scaling)
                    damped -= half * ends[i] ** 2
            if marks.shape[0] > 0 and marks[k] != 0:
                for i in range(d):
                    rubbed += half * ends[i] ** 2
                _rub(marks[k], rubbing, ends)
                for i in range(d):
                    rubbed -= half * ends[i] ** 2
            for i in range(d):
                y, f, end = out[k, i] * per_mass, forces[i], ends[i]
                change = kick * f * per_mass / scaling
                if fixed[k, i]:
                    y, end, change = before[k, i], held[k, i], 0.0
                    if own[k]:
                        # what moves the node does work against its forces and its inertia
                        work += (m * scaling * (end - y) - kick * f) * end
                nodes[k, force + i] = end - y
                grid += half * (end * end - y * y)
                nodes[k, i] = end
                if not known:
                    nodes[k, second + i] = end
                if pushed.shape[0] > 0:
                    pushed[k, i] = change
                if own[k]:
                    if last:
                        work += dt * m * g[i] * end
                    # what moves a node works against its damping too
                    damped += 0.5 * dt * resisting[i] * (y + end)
            if last:
                for i in range(out.shape[1]):
                    out[k, i] = 0.0
    done[1] += work
    done[3] += grid
    done[4] += damped
    done[5] += rubbed


@numba.njit(cache=True, error_model="numpy", fastmath=FAST)
def divide(box, columns, out, momentum, nodes, fixed, held, own, g, dt, done, last):
    """Velocities for the strain from momenta.

    If they move the points, too, weight works on them, and the sums are done with and cleared; see
    `move_nodes` for the arguments.
    """
    work = 0.0
    for block in range(box[0], box[1]):
        for k in range(block * box[4] + box[2], block * box[4] + box[3]):
            m = out[k, columns[1]]
            per_mass = 1.0 / m if m > 0.0 else 0.0
            for i in range(fixed.shape[1]):
                y = out[k, momentum + i] * per_mass
                y = held[k, i] if fixed[k, i] else y
                nodes[k, columns[3] + i] = y
                if last and own[k]:
                    work += dt * m * g[i] * y
            if last:
                for i in range(out.shape[1]):
                    out[k, i] = 0.0
    done[1] += work


@numba.njit(cache=True, error_model="numpy")
def fastest(box, nodes, column, d):
    """Largest speed, √(v·v), in d columns from one on, at the nodes of a box."""
    most = 0.0
    for block in range(box[0], box[1]):
        for k in range(block * box[4] + box[2], block * box[4] + box[3]):
            square = 0.0
            for i in range(d):
                square += nodes[k, column + i] ** 2
            most = max(most, square)
    return math.sqrt(most)


@numba.njit(cache=True, error_model="numpy")
def take_means(box, sums):
    """Means from sums of volumes and of volumes times a change, in their place."""
    for block in range(box[0], box[1]):
        for k in range(block * box[4] + box[2], block * box[4] + box[3]):
            if sums[k, 0] > 0.0:
                sums[k, 1] /= sums[k, 0]
