"""Boundaries that do not fit the grid in explicit steps: where forces act, and how stiffly.

A step begins with the forces of what conditions have kept until then, gaps and shears, which
follow the velocities of its end as the points do: a symplectic Euler step of penalty and body.

With the trace Σ N_i v_i, N_i ≥ 0 and Σ N_i = 1, the power of a penalty k is by Jensen's inequality

    ∫ k |Σ N_i v_i|² da ≤ Σ_i |v_i|² ∫ k N_i da,

so that no square of a frequency that it makes exceeds the largest of ∫ k N_i da / m_i: row sums of
its stiffness over the lumped mass, and in the critical step it stands beside the body's own.
Behind a C that ties nodes, where N_i have signs, it is ∫ k |N_i| Σ|N_j| da over the mass of the
nodes that others are tied to, without what these bring. Nitsche's terms −2 ∫ t(v)·v da are no
more than half the body's energy and once more the penalty, which is twice the constant of
∫ |t(v)|² da by the energy.

Where the body ends just behind a boundary, nodes beyond it have next to no mass, and these sums no
bound. So where conditions need no more than values, a trace weighs nodes that are lighter than a
share θ of a full cell by their mass over that, w_i, and is Σ w_i N_i v_i / Σ w_i N_i: it is taken
a little further inside, by less than a cell's part that has no body, forces keep their sum, and
the penalty is less by 2 Σ w_i N_i where that is below 1.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numba
import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.errors import FormError
from dolfinmpm.basis import Stencils
from dolfinmpm.body.axisymmetry import ring
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.participants import Activation, ActiveField
from dolfinmpm.cut.unknowns import Nodal
from dolfinmpm.dynamics.mass import point_masses
from dolfinmpm.dynamics.transfer import collect, scatter
from dolfinmpm.grid.lattice import smallest_height
from dolfinmpm.solve.weakform import WeakForm

__all__ = ["Stiffness", "check_boundaries", "weighed"]

Array = npt.NDArray[np.float64]

# θ: nodes of full cells have at least 1/8 of one
_LIGHT = 0.1
# Share of the body's own energy that Nitsche's terms may add
_NITSCHE = 0.5


@dataclass(frozen=True)
class Stiffness:
    """What boundaries add to the squares of the frequencies of a body.

    Attributes:
        rate: At most so much (1/s²).
        share: And so much of the body's own.
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
    """An activation with traces that spare light nodes, and what stiffness is left. Collective.

    Penalties at the markers become smaller where traces have hardly any mass.

    Args:
        form: The weak form, with its penalties set.
        here: What is active.
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
            full = _full_masses(markers)
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
    # what has no mass does not move, nor does what is held
    moves = (m > 0) & ~fixed & (np.arange(m.size) < owned)
    rate = float(np.max(rows[moves] / m[moves], initial=0.0))
    rate = points.comm.allreduce(rate, op=MPI.MAX)
    return replace(here, boundaries=made), Stiffness(rate, share)


def _node_masses(field: ActiveField, points: MaterialPoints) -> Array:
    """Lumped masses of all nodes (kg), on all ranks that know them. Collective."""
    sums = Nodal([field.basis.nodes], [1])
    scatter(field.seen, point_masses(points), np.ones((len(points), 1)), sums.arrays[0])
    sums.add_up()
    sums.spread()
    return sums.arrays[0][:, 0]


def _full_masses(markers: MaterialPoints) -> Array:
    """Masses of a cell that the body fills (kg), at the markers of a boundary."""
    volume = smallest_height(markers.grid) ** markers.gdim
    full = markers["density"] * volume
    return ring(markers["x"][:, 0], full) if markers.axisymmetric else full


def _weighed(s: Stencils, m: Array, full: Array, kept: Array) -> Stencils:
    """Stencils of markers whose values spare light nodes.

    Args:
        s: The stencils.
        m: Masses of the nodes (kg).
        full: Mass of a full cell at each marker (kg).
        kept: Written: which share of its stiffness each marker keeps.
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
