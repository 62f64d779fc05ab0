"""Motion of the nodes of a window in fused steps, see `dolfinmpm.dynamics.window`."""

from __future__ import annotations

import math

import numba
import numpy as np

from dolfinmpm.dynamics.passes import FAST

__all__ = ["divide", "fastest", "move_nodes", "take_means"]


@numba.njit(cache=True, error_model="numpy")
def _rub(mark, rubbing, velocity):
    """Stop a node that would leave the grid through a side, and let friction act on its slip."""
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
        own: Mask of the nodes whose work this rank counts.
        before, held: Velocities of fixed components at the start and at the end of the step.
        faces: Friction and dashpots at sides of the grid, see `Faces.by_nodes`.
        pushed: Output: changes of velocity by forces alone; or empty.
        dt, kick: Time during which nodes move, and time during which forces act on them (s).
        known: Whether velocities for the strain are set already.
        last: Whether the points move by these velocities. The sums are then cleared.
        done: Sums to add to, see `FusedSteps.done`.
    """
    _, mass, force, second = columns
    d = fixed.shape[1]
    marks, rubbing, dashpots = faces
    ends, free, forces, resisting = np.empty(d), np.empty(d), np.empty(d), np.zeros(d)
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
                    if not fixed[k, i]:
                        ends[i] /= 1.0 + kick * dashpots[k, i] / (m * scaling)
                        if own[k]:
                            damped += kick * dashpots[k, i] * ends[i] ** 2
            if marks.shape[0] > 0 and marks[k] != 0:
                for i in range(d):
                    free[i] = ends[i]
                _rub(marks[k], rubbing, ends)
                for i in range(d):
                    if not fixed[k, i]:
                        # the impulse works on the mean velocity, see `Mass.taken`
                        rubbed += half * (free[i] - ends[i]) * (out[k, i] * per_mass + ends[i])
            for i in range(d):
                y, f, end = out[k, i] * per_mass, forces[i], ends[i]
                change = kick * f * per_mass / scaling
                if fixed[k, i]:
                    y, end, change = before[k, i], held[k, i], 0.0
                    if own[k]:
                        # a prescribed motion works against forces and inertia of the node
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
                    # a prescribed motion also works against the damping
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
    """Velocities for the strain from momenta; see `move_nodes` for the arguments.

    If these velocities also move the points, the work of gravity is added, and sums are cleared.
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
    """Largest speed √(v·v) at the nodes of a box; v are d columns, from a given column."""
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
    """Replace sums of volumes times a change by means over the sums of volumes."""
    for block in range(box[0], box[1]):
        for k in range(block * box[4] + box[2], block * box[4] + box[3]):
            if sums[k, 0] > 0.0:
                sums[k, 1] /= sums[k, 0]
