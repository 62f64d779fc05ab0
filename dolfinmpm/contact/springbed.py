"""A bed of springs under a face of a body (Winkler 1867): t = −k (n·d) n.

d is the displacement of the face since the springs were made, and n is its initial normal. The bed
stands for ground outside the grid. This file contains the whole term; see
`dolfinmpm.assembly.term`.

The displacement along n is a sum of increments of the functions at the faces, those on which the
springs act. So they store as much energy as they take, and a body on them is in balance with a
uniform stress. What moves the points without the springs, in another problem, is added.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy
import ufl
from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import check_kind, number
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.assembly.term import ActiveTerm, NewState, Term, as_form
from dolfinmpm.basis.stencils import stencil_matrix
from dolfinmpm.body.formarguments import check_displacement
from dolfinmpm.body.surface import Surface
from dolfinmpm.cut.activation import Activation
from dolfinmpm.cut.pattern import Blocks
from dolfinmpm.terms.surfaceterm import face_stencils

__all__ = ["springs"]

Array = npt.NDArray[np.float64]


class SpringBed(Term):
    """A bed of springs in a weak form; see `springs`.

    Attributes:
        surface: The face.
        stiffness: k (Pa/m).
    """

    kind = "springs"
    holds_faces = True

    def __init__(self, surface: Surface, u: Any, stiffness: float):
        self.points, self.surface, self.stiffness = surface.points, surface, stiffness
        self._u = u
        points, names = surface.points, surface.points.fields
        self._way, self._motion = (f"{surface.name}_spring_{one}" for one in ("way", "motion"))
        new = self._way not in names
        points.add_field(self._way, (), "m")
        points.add_field(self._motion, (), "m")
        if new:
            points[self._motion] = self._along()

    def _along(self) -> Array:
        """Displacements of the faces along their normals (m), shape (points,)."""
        return np.sum(self.normals[0] * self.surface.displacements(), axis=1)

    @property
    def way(self) -> Array:
        """Displacements along the normals since the springs were made (m), shape (points,)."""
        return self.points[self._way] + (self._along() - self.points[self._motion])

    def keep(self, way: Array, new: NewState) -> None:
        """Add the displacements at the end of a step to a new state.

        Args:
            way: See the attribute, at the end of the step.
            new: The new state.
        """
        points, F = self.points, new.fields.get("F", self.points["F"])
        x = new.fields.get("x", points["x"])
        new.fields[self._way] = way
        moved = self.surface.displacements_of(x, F)
        new.fields[self._motion] = np.sum(self.normals[0] * moved, axis=1)

    def __repr__(self) -> str:
        return f"the springs at '{self.surface.name}', {self.stiffness:g} Pa/m"

    def describe(self) -> str:
        """See `Term`."""
        return repr(self)

    def on(self, here: Activation) -> ActiveSprings:
        """See `Term`."""
        return ActiveSprings(self, here)

    @property
    def normals(self) -> tuple[Array, Array]:
        """Normals n, shape (points, gdim), and springs k A (N/m), shape (points,)."""
        area = self.points[self.surface.area.name]
        size = np.linalg.norm(area, axis=1)
        return area / np.where(size > 0.0, size, 1.0)[:, None], self.stiffness * size

    def stiffness_per_area(self) -> float:
        """k (Pa/m)."""
        return self.stiffness

    def energy(self) -> tuple[float, float]:
        """See `Term`. Collective."""
        own = 0.5 * float(self.normals[1] @ self.way**2)
        return self.points.comm.allreduce(own, op=MPI.SUM), 0.0

    def rate(self, scaling: float) -> float:
        """See `Term`: a node at the edge of the body has half of the mass of its points."""
        mass = self.points["density"] * self.points["V0"]
        worst = float((2.0 * self.normals[1] / mass).max(initial=0.0)) / scaling
        return self.points.comm.allreduce(worst, op=MPI.MAX)


class ActiveSprings(ActiveTerm):
    """A bed of springs on an activation; see `ActiveTerm`."""

    kind = "springs"
    # the springs store energy, and are not a load
    is_load = False

    def __init__(self, bed: SpringBed, here: Activation):
        self._bed, points = bed, bed.points
        fields = here.fields
        self._k = next(k for k, f in enumerate(fields) if f.space.increment is bed._u)
        s = face_stencils(bed.surface, fields[self._k], here)
        shape = len(points), fields[self._k].basis.nodes.size
        self._rows = np.flatnonzero(bed.normals[1])
        self._seen = scipy.sparse.csr_matrix(stencil_matrix(s, s.N, shape))[self._rows]
        self.stiffness = [self._blocks()]

    def _blocks(self) -> Blocks:
        """Stiffness of the springs; nodes that a point sees are coupled anyway."""
        n, k = (values[self._rows] for values in self._bed.normals)
        W = self._seen
        pairs = scipy.sparse.coo_matrix(abs(W).T @ abs(W))
        d = n.shape[1]
        values = np.empty((pairs.nnz, d, d))
        for i in range(d):
            for j in range(d):
                part = scipy.sparse.csr_matrix(W.T @ scipy.sparse.diags(k * n[:, i] * n[:, j]) @ W)
                values[:, i, j] = np.asarray(part[pairs.row, pairs.col]).ravel()
        rows, columns = (x.astype(np.int32) for x in (pairs.row, pairs.col))
        return Blocks(self._k, self._k, rows, columns, values)

    def external(self, out: Sequence[Array]) -> None:
        """See `ActiveTerm`: forces at the start of the step, which resist."""
        n, k = (values[self._rows] for values in self._bed.normals)
        out[self._k][...] += self._seen.T @ ((k * self._bed.way[self._rows])[:, None] * n)

    def move(self, u: Sequence[Array]) -> None:
        """See `ActiveTerm`."""
        self._u = u[self._k]

    def _moved(self) -> Array:
        """Displacements along the normals in the step (m), shape (springs,)."""
        normals = self._bed.normals[0][self._rows]
        return np.sum(normals * (self._seen @ self._u), axis=1)

    def work_at_end(self) -> float:
        """See `ActiveTerm`. Collective."""
        k, moved = self._bed.normals[1][self._rows], self._moved()
        done = -float(np.sum(k * (self._bed.way[self._rows] + moved) * moved))
        return self._bed.points.comm.allreduce(done, op=MPI.SUM)

    def update(self, new: NewState) -> None:
        """See `ActiveTerm`."""
        way = self._bed.way
        way[self._rows] += self._moved()
        self._bed.keep(way, new)


def springs(surface: Surface, u: Any, v: Any, *, stiffness: float) -> ufl.Form:
    """A bed of springs at a face of a body, a term to be added: F += mpm.springs(...).

    The springs act along the normal of the face, in compression and in tension. They are free of
    stress when they are made. The points keep the displacement of the face along its normal since
    then in the field `<surface>_spring_way` (m). Springs on a surface that has had springs go on
    with it.

    Args:
        surface: The face, `mpm.Surface`.
        u: Increment of the step, `Space.increment`.
        v: Test function, `Space.test`.
        stiffness: k, force per area and displacement (Pa/m).

    Raises:
        ParameterError: An argument has the wrong type or a value outside its range. Or the space
            of the field has configuration="total".

    A bed of springs below the body, 1 MN/m³, under 10 kPa:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=2000.0)
    >>> V = mpm.Space(grid, "gimp")
    >>> F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, V.increment, V.test)
    >>> from dolfinx import fem
    >>> top = mpm.Surface(points, lambda x: x[1] > 1.9, normal=(0, 1))
    >>> bottom = mpm.Surface(points, lambda x: x[1] < 0.1, normal=(0, -1))
    >>> F += mpm.springs(bottom, V.increment, V.test, stiffness=1e6)
    >>> F += top.traction(fem.Constant(grid, (0.0, -1e4)), V.test)
    >>> record = mpm.QuasiStatic(F, V.increment, points, mpm.rollers(V, "left")).step()
    >>> bottom.mean_displacement()[1].round(6).item()
    -0.01
    """
    check_kind("surface", surface, Surface, "make it with mpm.Surface(points, where, normal)")
    check_displacement(surface.points, u=u, v=v)
    number("stiffness", stiffness, 0.0, unit="Pa/m")
    if u._dolfinmpm_space.configuration == "total":
        raise ParameterError(
            'springs act at present positions: take Space(..., configuration="updated"), got '
            '"total"'
        )
    return as_form(SpringBed(surface, u, stiffness), u, v)
