"""Motion of the nodes of a window in fused steps, see `dolfinmpm.dynamics.window`."""

from __future__ import annotations

import math

import numba
import numpy as np

from dolfinmpm.dynamics.passes import FAST

__all__ = ["divide", "fastest", "move_nodes", "take_means"]


@numba.njit(cache=True, error_model="numpy")
def _apply_friction(mark, friction, velocity):
    """Stop a node that would leave the grid through a side, and let friction act on its slip."""
    for face in range(friction.shape[0]):
        if (mark >> np.uint64(face)) & np.uint64(1) == 0:
            continue
        axis, outward, mu = int(friction[face, 0]), friction[face, 1], friction[face, 2]
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


@numba.njit(cache=True, error_model="numpy")
def _constrain_stopped(mark, friction, fixed, per_momentum, taken, mapped):
    """See `Faces.constrain_stopped`, for one node; taken are momenta here."""
    for face in range(friction.shape[0]):
        axis, outward, mu = int(friction[face, 0]), friction[face, 1], friction[face, 2]
        out = outward * taken[axis] * per_momentum
        if (mark >> np.uint64(face)) & np.uint64(1) == 0 or not out > 0.0:
            continue
        if not fixed[axis]:
            mapped[axis] -= min(max(mapped[axis], -out), out)
        size = rubbed = 0.0
        for i in range(mapped.size):
            if i != axis:
                size, rubbed = size + mapped[i] ** 2, rubbed + taken[i] ** 2
        grip = max(mu * out - math.sqrt(rubbed) * per_momentum, 0.0)
        left = max(0.0, 1.0 - grip / max(math.sqrt(size), 1e-300))
        for i in range(mapped.size):
            if i != axis and not fixed[i]:
                mapped[i] *= left


@numba.njit(cache=True, error_model="numpy", fastmath=FAST)
def move_nodes(
    box, columns, out, nodes, own, fixed, before, after, faces, pushed, g, dt, kick, begins, kept,
    mass_scaling, damping, known, last, done,
):  # fmt: skip
    """Accelerate the nodes of a box.

    Args:
        own: Mask of the nodes whose work this rank counts.
        before, after: Velocities of fixed components at the start and at the end of the step.
        faces: Friction and dashpots at sides of the grid, see `Faces.by_nodes`.
        pushed: Output: changes of velocity by forces alone; or empty.
        dt, kick: Time during which nodes move, and time during which forces act on them (s).
        begins: Whether a run begins with the step.
        kept: Share of the points' own velocities in their new ones, see `Mapping.kept_share`.
        known: Whether velocities for the strain are set already.
        last: Whether the points move by these velocities. The sums are then cleared.
        done: Sums to add to, see `FusedSteps.done`.
    """
    _, mass, force, second = columns
    d = fixed.shape[1]
    marks, friction, dashpots, taken, resisted = faces
    ends, forces, resisting, given = np.empty(d), np.empty(d), np.zeros(d), np.empty(d)
    resists = damping > 0.0 or dashpots.shape[0] > 0
    work = grid = damped = rubbed = start = 0.0
    for block in range(box[0], box[1]):
        for k in range(block * box[4] + box[2], block * box[4] + box[3]):
            m = out[k, mass]
            half = 0.5 * m * mass_scaling if own[k] else 0.0
            per_mass = 1.0 / m if m > 0.0 else 0.0
            for i in range(d):
                y = out[k, i] * per_mass
                f = out[k, force + i] + m * g[i]
                resisting[i] = 0.0
                # a side that moves where a run begins has met the body before
                given[i] = y if begins and after[k, i] != 0.0 else before[k, i]
                if damping > 0.0:
                    resisting[i] = damping * abs(f) * np.sign(given[i] if fixed[k, i] else y)
                    f -= resisting[i]
                forces[i] = f
                ends[i] = given[i] if fixed[k, i] else y + kick * f * per_mass / mass_scaling
            if dashpots.shape[0] > 0 and m > 0.0:
                for i in range(d):
                    if not fixed[k, i]:
                        # dashpots resist the mean of the velocities before and after the forces
                        y, rate = out[k, i] * per_mass, 0.5 * kick * dashpots[k, i]
                        rate *= per_mass / mass_scaling
                        ends[i] = (ends[i] - rate * y) / (1.0 + rate)
                        resisting[i] += 0.5 * dashpots[k, i] * (y + ends[i])
            if marks.shape[0] > 0 and marks[k] != 0:
                for i in range(d):
                    taken[k, i] = ends[i]
                _apply_friction(marks[k], friction, ends)
                for i in range(d):
                    lost = 0.0 if fixed[k, i] else m * mass_scaling * (taken[k, i] - ends[i])
                    taken[k, i] = lost
                    if last and own[k]:
                        # friction works on the velocities of the strain, as stresses do
                        rubbed += dt / kick * lost * ends[i]
            for i in range(d):
                y, f, end = out[k, i] * per_mass, forces[i], ends[i]
                change = kick * f * per_mass / mass_scaling
                if fixed[k, i]:
                    if own[k]:
                        # a prescribed motion works against forces and inertia of the node; the
                        # impulse by which a run begins works on the mean of both velocities
                        was, end = kept * given[i] + (1.0 - kept) * y, after[k, i]
                        mean = 0.5 * (given[i] + end) if begins else end
                        work += m * mass_scaling * (end - was) * mean - kick * f * end
                    y, end, change = given[i], after[k, i], 0.0
                nodes[k, force + i] = end - y
                if resists:
                    # it takes energy by the mean of the strains' velocities before and after it
                    resisted[k, i] = 0.5 * kick * resisting[i] if own[k] else 0.0
                    damped += resisted[k, i] * (y + end if last else y)
                grid += half * (end * end - y * y)
                if begins:
                    start += half * change * (end - y)
                nodes[k, i] = end
                if not known:
                    nodes[k, second + i] = end
                if pushed.shape[0] > 0:
                    pushed[k, i] = change
                if own[k] and last:
                    work += dt * m * g[i] * end
            if last:
                for i in range(out.shape[1]):
                    out[k, i] = 0.0
    done[1] += work
    done[3] += grid
    done[4] += damped
    done[5] += rubbed
    done[8] += start


@numba.njit(cache=True, error_model="numpy", fastmath=FAST)
def divide(
    box, columns, out, momentum, nodes, fixed, after, faces, own, g, dt, kick, mass_scaling,
    damping, done, last,
):  # fmt: skip
    """Velocities for the strain from momenta; see `move_nodes` for the arguments.

    If these velocities also move the points, the works of gravity and of friction and the rest of
    the losses by damping are added, sides hold the nodes that they have stopped, and sums are
    cleared.
    """
    work, rubbed, damped, d = 0.0, 0.0, 0.0, fixed.shape[1]
    marks, friction, dashpots, taken, resisted = faces
    resists = damping > 0.0 or dashpots.shape[0] > 0
    for block in range(box[0], box[1]):
        for k in range(block * box[4] + box[2], block * box[4] + box[3]):
            m = out[k, columns[1]]
            per_mass = 1.0 / m if m > 0.0 else 0.0
            for i in range(fixed.shape[1]):
                y = out[k, momentum + i] * per_mass
                y = after[k, i] if fixed[k, i] else y
                nodes[k, columns[3] + i] = y
            if last and marks.shape[0] > 0 and marks[k] != 0:
                mapped, per_momentum = (
                    nodes[k, columns[3] : columns[3] + d],
                    per_mass / mass_scaling,
                )
                _constrain_stopped(marks[k], friction, fixed[k], per_momentum, taken[k], mapped)
                for i in range(d):
                    if own[k]:
                        rubbed += dt / kick * taken[k, i] * mapped[i]
            if last:
                for i in range(d):
                    if own[k]:
                        work += dt * m * g[i] * nodes[k, columns[3] + i]
                    if resists:
                        damped += resisted[k, i] * nodes[k, columns[3] + i]
                for i in range(out.shape[1]):
                    out[k, i] = 0.0
    done[1] += work
    done[4] += damped
    done[5] += rubbed


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
