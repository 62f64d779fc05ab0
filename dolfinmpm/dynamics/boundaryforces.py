"""Boundaries that do not fit the grid, in explicit steps: places and stiffness of their forces.

Conditions keep gaps and shears from step to step. A step begins with the forces of these values.
The values then follow the velocities at the end of the step, like the points. This is a symplectic
Euler step of penalty and body.

With the trace Σ N_i v_i, N_i ≥ 0 and Σ N_i = 1, the power of a penalty k is by Jensen's inequality

    ∫ k |Σ N_i v_i|² da ≤ Σ_i |v_i|² ∫ k N_i da,

So no squared frequency of the penalty exceeds the largest ∫ k N_i da / m_i: row sums of its
stiffness over the lumped mass. The critical step adds it to the squared frequency of the body. With
constraints C the N_i may be negative. The bound is then ∫ k |N_i| Σ|N_j| da over the mass of the
independent nodes, without the mass of nodes that follow them. Nitsche's terms −2 ∫ t(v)·v da are
at most half the body's energy plus once the penalty. The penalty is twice the constant of
∫ |t(v)|² da by the energy.

If the body ends just behind a boundary, nodes beyond it have very little mass, and these sums have
no bound. Some conditions need only values, no gradients. For these a trace weighs light nodes:
nodes below a share θ of the mass of a full cell have the weight w_i, their mass over this share.
The trace is Σ w_i N_i v_i / Σ w_i N_i. It lies a little further inside, by less than the empty part
of a cell. The sum of forces is unchanged. The penalty has the factor 2 Σ w_i N_i where this is
below 1.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numba
import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.errors import FormError
from dolfinmpm.basis import LeafBasis, Stencils
from dolfinmpm.body.axisymmetry import ring
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.activation import Activation, ActiveField
from dolfinmpm.cut.unknowns import Nodal
from dolfinmpm.dynamics.mass import point_masses
from dolfinmpm.dynamics.transfer import collect, scatter
from dolfinmpm.grid.lattice import smallest_height
from dolfinmpm.solve.weakform import WeakForm

__all__ = ["Stiffness", "check_boundaries", "weighed"]

Array = npt.NDArray[np.float64]

# θ: nodes of full cells have at least 1/8 of the mass of a cell
_LIGHT = 0.1
# Share of the body's own energy that Nitsche's terms may add
_NITSCHE = 0.5


@dataclass(frozen=True)
class Stiffness:
    """Upper bound of the squared frequencies that boundaries add to a body.

    Attributes:
        rate: Absolute part (1/s²).
        share: Part relative to the body's own squared frequency.
    """

    rate: float = 0.0
    share: float = 0.0


def check_boundaries(form: WeakForm, mass: str) -> None:
    """Raise FormError unless explicit steps can take the boundaries of a form.

    Args:
        form: The weak form.
        mass: "lumped" or "consistent".
    """
    for of in form.boundaries:
        if mass != "lumped":
            raise FormError(
                f'the form has terms over {of.boundary}, and mass = "{mass}" gives no bound of the '
                'step that their stiffness allows; take mass="lumped"'
            )
        for condition in of.conditions:
            if getattr(condition, "method", None) == "skew":
                raise FormError(
                    f'{of.boundary} has a condition by method="skew", whose unsymmetric forces '
                    'feed energy to what moves freely; take "nitsche" or "penalty"'
                )


def weighed(form: WeakForm, here: Activation) -> tuple[Activation, Stiffness]:
    """An activation with reduced weights of light nodes, and the remaining stiffness. Collective.

    Penalties at the markers become smaller where traces have very little mass.

    Args:
        form: The weak form, with its penalties set.
        here: The activation.
    """
    field, points = here.fields[0], form.points
    m = _node_masses(field, points)
    made, share = {}, 0.0
    sums = Nodal([field.basis.nodes], [1])
    for of in form.boundaries:
        markers = of.boundary.markers
        active = here.boundaries[markers.number]
        parts = active.regions
        exact = any(condition.exact for condition in of.conditions)
        if field.C is None and not exact:
            kept = np.ones(len(markers))
            full = _full_masses(markers, field.basis)
            parts = [
                replace(part, stencils=[_weighed(s, m, full, kept) for s in part.stencils])
                for part in parts
            ]
            for condition in of.conditions:
                markers[condition.stiffness] *= kept
        made[markers.number] = replace(active, regions=parts)
        for condition in of.conditions:
            stiff = condition.stiffest() * markers["V"] * (2.0 if condition.exact else 1.0)
            share = max(share, _NITSCHE * condition.exact)
            for part in parts:
                _add_rows(part.stencils[0], stiff, sums.arrays[0])
    sums.add_up()
    fixed = here.unknowns.fields[0].fixed.all(axis=1)
    rows, owned = sums.arrays[0][:, 0], field.basis.nodes.owned
    # nodes without mass and constrained nodes do not move
    moves = (m > 0) & ~fixed & (np.arange(m.size) < owned)
    rate = float(np.max(rows[moves] / m[moves], initial=0.0))
    rate = points.comm.allreduce(rate, op=MPI.MAX)
    return replace(here, boundaries=made), Stiffness(rate, share)


def _node_masses(field: ActiveField, points: MaterialPoints) -> Array:
    """Lumped masses of all nodes (kg), on all ranks that know them. Collective."""
    sums = Nodal([field.basis.nodes], [1])
    scatter(field.full_stencils, point_masses(points), np.ones((len(points), 1)), sums.arrays[0])
    sums.add_up()
    sums.spread()
    return sums.arrays[0][:, 0]


def _full_masses(markers: MaterialPoints, basis: Any) -> Array:
    """Mass of a full cell (kg) at each marker of a boundary, shape (markers,)."""
    volume: Any = smallest_height(markers.grid) ** markers.gdim
    if isinstance(basis, LeafBasis):
        # a marker beside the leaves is at one of the size of the others
        cells, sizes = basis.cells_at(markers["x"]), basis.cell_sizes()
        edge = np.where(cells >= 0, sizes[cells], sizes.min(initial=np.inf))
        volume = edge**markers.gdim
    full = markers["density"] * volume
    return ring(markers["x"][:, 0], full) if markers.axisymmetric else full


def _weighed(s: Stencils, m: Array, full: Array, kept: Array) -> Stencils:
    """Stencils of markers with reduced weights of light nodes.

    Args:
        s: The stencils.
        m: Masses of the nodes (kg).
        full: Mass of a full cell at each marker (kg).
        kept: Output: remaining share of the stiffness of each marker.
    """
    N = s.N.copy()
    _weigh(s.order, s.groups, s.node_start, s.nodes, s.value_start, m, _LIGHT * full, N, kept)
    return replace(s, N=N)


@numba.njit(cache=True, error_model="numpy")
def _weigh(order, groups, node_start, nodes, value_start, m, light, N, kept):
    for g in range(groups.size - 1):
        first = node_start[g]
        number = node_start[g + 1] - first
        for position in range(groups[g], groups[g + 1]):
            p = order[position]
            at = value_start[g] + (position - groups[g]) * number
            total = 0.0
            for a in range(number):
                total += N[at + a] * min(1.0, m[nodes[first + a]] / light[p])
            kept[p] = min(1.0, 2.0 * total)
            if total > 0.0:
                for a in range(number):
                    N[at + a] *= min(1.0, m[nodes[first + a]] / light[p]) / total


def _add_rows(s: Stencils, stiff: Array, out: Array) -> None:
    """Add Σ k |N_i| Σ|N_j| over markers to the nodes i (N/m), shape (nodes, 1)."""
    sizes = replace(s, N=np.abs(s.N))
    total = collect(sizes, np.ones_like(out), len(stiff))
    scatter(sizes, stiff, total, out)
