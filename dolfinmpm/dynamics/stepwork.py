"""Works in a step in time: of loads, contacts, penalties and dashpots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import Tags
from dolfinmpm.cut.activation import Activation
from dolfinmpm.cut.unknowns import Nodal
from dolfinmpm.dynamics.boundarywork import forces_without_contact, has_walls, wall_forces
from dolfinmpm.dynamics.explicitbase import ExplicitStep
from dolfinmpm.dynamics.mappings import NodalMotion
from dolfinmpm.dynamics.nodalmass import Mass
from dolfinmpm.dynamics.sidedashpots import SideDashpots
from dolfinmpm.dynamics.worksums import Work
from dolfinmpm.solve.operator import Operator
from dolfinmpm.solve.step import Step

__all__ = [
    "MovingNodes",
    "add_losses",
    "add_work_of_nodes",
    "energy_of_start",
    "mean_contact_forces",
    "work_at_nodes",
    "work_of_contact",
    "work_of_frictional_sides",
    "work_of_loads",
    "work_of_waves",
]

Array = npt.NDArray[np.float64]


@dataclass
class MovingNodes:
    """The nodes of a field that moves points, in a step.

    Attributes:
        k: Number of the field.
        tags: Tags of the points moved by the field, or None for all points.
        mass: Mass of the nodes.
        momenta: Momenta mapped from the points (kg m/s), shape (nodes, d).
        V, A: Velocities (m/s) and accelerations (m/s²) at the start, shape (nodes, d).
        motion: Motion up to the end of the step, as soon as it is known.
        held: Forces that hold prescribed components against the mean forces of contact (N), shape
            (nodes, d), or None without contact.
    """

    k: int
    tags: Tags
    mass: Mass
    momenta: Array
    V: Array
    A: Array
    motion: NodalMotion = field(init=False)
    held: Array | None = None


def mean_contact_forces(operator: Operator) -> list[Array]:
    """Mean forces of contact on the nodes of each field (N). Collective."""
    means = operator.form.contact_weights
    assert means is not None
    forces = [np.asarray(-force / means.weight) for force in operator.forces_of("contact")]
    if has_walls(operator):
        forces = [a + b for a, b in zip(forces, wall_forces(operator, "force"))]
    return forces


def work_of_contact(operator: Operator, nodes: Sequence[MovingNodes]) -> float:
    """Work of mean forces of contact on the nodes in a step (J). Collective."""
    done, forces, unknowns = 0.0, mean_contact_forces(operator), operator.here.unknowns
    for one in nodes:
        owned = unknowns.fields[one.k].owned_nodes
        done += float(np.sum((forces[one.k] * operator.increments[one.k])[owned]))
    return unknowns.comm.allreduce(done, op=MPI.SUM)


def _load_work(operator: Operator, of: Sequence[Array] | None = None) -> float:
    """Work of the present loads on increments that move points (J). Collective.

    Sources of other fields, such as the flow of water, do no work.

    Args:
        operator: The equations.
        of: The increments; by default the present increments.
    """
    here, work = operator.here, 0.0
    increments = operator.increments if of is None else of
    for k, (load, u) in enumerate(zip(operator.loads, increments)):
        if k not in here.movers:
            continue
        owned = here.unknowns.fields[k].owned_nodes
        work -= float(np.sum(load[owned] * u[owned]))
    return here.unknowns.comm.allreduce(work)


def _work_at_prescribed(operator: Operator, forces: Sequence[Array]) -> float:
    """Work of forces at prescribed components that move points (J). Collective.

    Args:
        operator: The equations.
        forces: Forces (N), shape (nodes, components) per field, summed at the nodes' owners.
    """
    here, work = operator.here, 0.0
    for k in here.movers:
        force, u, fixed = forces[k], operator.increments[k], here.unknowns.fields[k].places[1]
        work += float(force.reshape(-1)[fixed] @ u.reshape(-1)[fixed])
    return here.unknowns.comm.allreduce(work)


def work_of_loads(
    operator: Operator,
    x: Array,
    scale: float,
    nodes: Sequence[MovingNodes],
    dt: float,
    varying: bool,
    kept: float = 0.0,
) -> float:
    """Work of loads and of prescribed motions in a step (J). Collective.

    Prescribed motions change the momentum of their nodes, and do work against the mean of the
    forces before and after the step, with the velocity u/Δt. This work is of second order.

    Args:
        operator: The step's equations, at their solution.
        x: Unknowns at the level of balance, shape (owned,).
        scale: Increments at the end over increments at the level of balance.
        nodes: The nodes that move points.
        dt: Length of the step (s).
        varying: Whether any load changes in the step.
        kept: Share of the points' own velocities in their new ones, see `Mapping.kept_share`.
    """
    here = operator.here
    if not (here.driven or varying):
        return _load_work(operator)
    plain = Operator(operator.form, here)
    if not here.driven:
        plain.move(x, scale)
        return _load_work(plain)
    plain.move_to_start()
    start = forces_without_contact(plain)
    plain.move(x, scale)
    both = zip(start, forces_without_contact(plain), mean_contact_forces(operator))
    forces = [0.5 * (f + g) - push for f, g, push in both]
    for one in nodes:
        # points that keep their velocities get no more than the change of the nodes' velocities
        before = kept * one.mass.times(one.V).arrays[0] + (1.0 - kept) * one.momenta
        forces[one.k] += (one.mass.times(one.motion.V_end).arrays[0] - before) / dt
    return _load_work(plain) + _work_at_prescribed(plain, forces)


def work_at_nodes(
    operator: Operator,
    mass: Mass,
    forces: Nodal,
    motion: tuple[Array, Array, Array],
    step: ExplicitStep,
    momenta: Nodal,
    kept: float,
) -> float:
    """Work of loads and of prescribed motions in an explicit step (J). Collective.

    Args:
        operator: The step's equations.
        mass: Mass of the nodes.
        forces: Forces on the nodes (N).
        motion: Velocities at the start and at the end of the step, and velocities by which the
            points move (m/s), shape (nodes, d).
        step: The step.
        momenta: Momenta of the points' velocities at the nodes (kg m/s).
        kept: Share of these velocities in the new ones, see `Mapping.kept_share`.
    """
    V, V_end, V_move = motion
    external = _load_work(operator, [step.dt * V_move])
    here = operator.here
    if here.driven:
        # a prescribed motion changes the momentum of its nodes, against their forces; the impulse
        # by which a run begins works on the mean of both velocities
        at = here.unknowns.fields[0].places[1]
        before = kept * mass.times(V).arrays[0] + (1.0 - kept) * momenta.arrays[0]
        impulse = mass.times(V_end).arrays[0] - before
        mean = 0.5 * (V + V_end) if step.begins else V_end
        done = float(impulse.reshape(-1)[at] @ mean.reshape(-1)[at])
        done -= step.kick * float(forces.arrays[0].reshape(-1)[at] @ V_end.reshape(-1)[at])
        external += mass.comm.allreduce(done, op=MPI.SUM)
    return external


def energy_of_start(
    mass: Mass, forces: Nodal, change: Array, here: Activation, kick: float
) -> float:
    """Energy of the step that begins a run, see `dolfinmpm.dynamics.energies` (J). Collective.

    Args:
        mass: Mass of the nodes.
        forces: Forces on the nodes (N).
        change: Change of their velocities in the step (m/s), shape (nodes, d).
        here: The activation.
        kick: Time during which forces act (s).
    """
    own = here.unknowns.fields[0]
    done = np.where(own.fixed, 0.0, forces.arrays[0] * change)[own.owned_nodes]
    return mass.comm.allreduce(0.5 * kick * float(done.sum()), op=MPI.SUM)


def work_of_frictional_sides(mass: Mass, stopped: Array | None, u: Array, kick: float) -> float:
    """Work taken by frictional sides in an explicit step (J). Collective.

    Friction works on the velocities that strain the body, as stresses do.

    Args:
        mass: Mass of the nodes.
        stopped: What the sides have taken from the velocities of the nodes (m/s), shape (nodes, d),
            or None without such sides.
        u: Increments by the velocities that strain the body (m), likewise.
        kick: Time during which forces act (s).
    """
    return 0.0 if stopped is None else mass.inner(u, mass.blocks, stopped) / kick


def add_losses(
    work: Work,
    mass: Mass,
    motion: tuple[Array, Array, Array],
    resisting: Mapping[str, Array],
    at_sides: tuple[SideDashpots, Array] | None,
    kick: float,
) -> None:
    """Add changes of the nodes' kinetic energy, and dissipation, in an explicit step. Collective.

    Kinetic energy of a ghost mass exists only within a step. It is no loss, because points get the
    work of all forces.

    Args:
        work: Sums to add to.
        mass: Mass of the nodes.
        motion: See `work_at_nodes`.
        resisting: Name of a loss → dissipative forces on the nodes (N), shape (nodes, d).
        at_sides: Dashpots of sides, and the velocities that they resist (m/s), or None.
        kick: Time during which forces act (s).
    """
    V, V_end, V_move = motion
    found = [sum(mass.kinetic(v)) for v in (V, V_end)]
    work.grid += found[1] - found[0]
    # an impulse changes the energy by the mean of the strains' velocities before and after it
    owned, mean = mass.nodes.owned, 0.5 * (V + V_move)
    for name, force in resisting.items():
        done = kick * float(np.sum((force * mean)[:owned]))
        work.losses[name] += mass.comm.allreduce(done, op=MPI.SUM)
    if at_sides is not None:
        sides, at_side = at_sides
        came, lost = sides.works(at_side, mean)
        work.external += came
        work.losses["damping"] += lost


def add_work_of_nodes(
    work: Work,
    one: MovingNodes,
    operator: Operator,
    share: float,
    expected: Array,
    faces: Any,
) -> float:
    """Add changes of the nodes' kinetic energy, and losses by penalties and dashpots. Collective.

    Args:
        work: Sums to add to.
        one: The nodes.
        operator: The step's equations, at their solution.
        share: Share of the penalties' forces in the step's mean forces.
        expected: Increments (m) that penalties on changes of the velocity do not resist, shape
            (nodes, d).
        faces: Faces of the grid that act on the nodes, or None.

    Returns:
        Energy taken by penalties on changes of the velocity (J).
    """
    mass, motion, losses, here = one.mass, one.motion, work.losses, operator.here
    found = [mass.kinetic(V) for V in (motion.V, motion.V_end)]
    work.grid += found[1][0] - found[0][0]
    losses["ghost mass"] += found[1][1] - found[0][1]
    u = motion.u
    assert u is not None
    plain = [*here.blocks_of("stiffness", one.k), *here.blocks_of("penalty", one.k)]
    stored = share * mass.inner(u, here.blocks_of("changes", one.k), u - expected)
    losses["ghost stiffness"] += share * mass.inner(u, plain, u) + stored
    if faces is not None and faces.dashpots is not None:
        mean = 0.5 * (motion.V + motion.V_end)
        done = _sum_where_free(faces.dashpots * mean * u, here, one.k)
        losses["damping"] += mass.comm.allreduce(done, op=MPI.SUM)
    return stored


def work_of_waves(faces: Any, step: Step, one: MovingNodes, operator: Operator) -> float:
    """Work of waves that come in through absorbing sides in a step (J). Collective.

    Args:
        faces: The sides, see `Faces`.
        step: The step.
        one: The nodes.
        operator: The step's equations, at their solution.
    """
    mean, u = 0.5 * (faces.wave_forces(step.start) + faces.wave_forces(step.t)), one.motion.u
    assert u is not None
    done = _sum_where_free(mean * u, operator.here, one.k)
    return one.mass.comm.allreduce(done, op=MPI.SUM)


def _sum_where_free(values: Array, here: Activation, k: int) -> float:
    """Sum over this rank's nodes of a field, without components that conditions hold.

    No side acts on what a condition holds.

    Args:
        values: Shape (nodes, d).
        here: The activation.
        k: Number of the field.
    """
    own = here.unknowns.fields[k]
    return float(np.sum(np.where(own.fixed, 0.0, values)[own.owned_nodes]))
