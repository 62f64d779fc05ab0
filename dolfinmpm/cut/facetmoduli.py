"""Moduli of a ghost penalty that follow the tangent of the laws at the facet.

Each point carries two moduli of its tangent at the end of the last step: the P-wave modulus M and
the shear modulus G of the nearest isotropic tensor. A facet has their averages over the points of
its two cells, weighted by volumes. They are constant in a step, so that the penalty stays linear in
the increment.

Facets of axisymmetric points go around the axis. So a value has the factor 2π r, with the radius r
of the middle between the centres of the facet's cells.

The tangent at the start of a step would not do: yielding points lie on the yield surface, where
rounding decides between an elastic and a plastic tangent.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numba
import numpy as np
import numpy.typing as npt
from dolfinx import fem
from mpi4py import MPI

from dolfinmpm._platform.compat import geometry_dofmap
from dolfinmpm.basis import LatticeBasis, LeafBasis, Placement
from dolfinmpm.body.axisymmetry import ring
from dolfinmpm.body.points import GHOST_FACETS, MaterialPoints
from dolfinmpm.cut.fractions import cell_sums
from dolfinmpm.grid.lattice import once_per_grid

if TYPE_CHECKING:
    from dolfinmpm.cut.activation import ActiveField

__all__ = [
    "FIELD",
    "LEAST",
    "FacetModulus",
    "FacetRing",
    "bounded",
    "isotropic_moduli",
    "update",
]

Array = npt.NDArray[np.float64]

# Name of the points' field: M and G (Pa); zero before a law has given values.
FIELD = "tangent_moduli"

# Least M and G, as shares of the elastic ones. A point on the apex of a cone has no stiffness, and
# a point that unloads in the next step has the elastic stiffness again. With this bound the local
# constant exceeds its target at most ten times. Shear alone leaves at least 0.4 of M in the soils
# of demos/studies/ghost_parameter.py.
LEAST = 0.1

# Largest M of laws with F-bar, by the elastic G (M at ν = 1/3). Near incompressibility, F-bar
# leaves one volume change per cell to resist M, but a penalty in units of M would resist all.
MOST = 4.0


@once_per_grid
def _constants_by_cell(grid) -> fem.FunctionSpace:
    return fem.functionspace(grid, ("DG", 0))


class FacetModulus(fem.Function):
    """A modulus in a term over ghost facets, with one value per facet.

    For UFL and FFCx it is a function that is constant in every cell. The integration of the term
    replaces it by `values`.

    Args:
        points: Material points.
        u: Increment of the laws.
        target: Target of the local constant, see `dolfinmpm.assembly.facetpenalties`; None for the
            modulus that `part` names.
        scaling: Scaling of the term, see `ghost`.
        part: Which modulus it is without a target: "M", or "G" and "lambda" = M − 2G.
        source: Another modulus of the same term; this one has its M and G.

    Attributes:
        points, increment, target, scaling, source: The arguments.
        moduli: M and G of each facet (Pa; times 2π r in axisymmetric problems), in the order of
            the field's entities, shape (facets, 2).
        values: Value at each facet (Pa), shape (facets,).
    """

    def __init__(
        self, points: MaterialPoints, u, target: float | None = None, scaling: str = "scaled",
        part: str = "M", source: FacetModulus | None = None,
    ):  # fmt: skip
        super().__init__(_constants_by_cell(points.grid), name="facet_modulus")
        # it is no load of the user
        self._dolfinmpm_own = True
        self.points, self.increment, self.target = points, u, target
        self.scaling, self._part, self.source = scaling, part, source
        self.moduli: Array = np.empty((0, 2))
        self.values: Array = np.empty(0)

    def plain(self, M: Array, G: Array) -> Array:
        """Its values without a target (Pa), shape (facets,).

        Args:
            M, G: The two moduli of each facet, likewise.
        """
        if self._part == "M":
            return M.copy()
        # M − 2G is negative in auxetic materials, and a penalty must not be
        G = np.minimum(G, 0.5 * M)
        return G if self._part == "G" else M - 2 * G


class FacetRing(FacetModulus):
    """2π r of axisymmetric ghost facets (m), in a term whose modulus is a number.

    Args:
        points: Material points.
        u: Increment in the term.
    """

    def __init__(self, points: MaterialPoints, u):
        super().__init__(points, u, None, "literal")


@once_per_grid
def _radii(grid) -> Array:
    """Radii of the centres of the local cells (m)."""
    return grid.geometry.x[geometry_dofmap(grid), 0].mean(axis=1)


def _rings(field: ActiveField, facets: npt.NDArray[np.int32]) -> Array:
    """2π r of facets, shape (facets, 1)."""
    basis = field.basis
    if isinstance(basis, LeafBasis):
        low, high = basis.cell_corners()
        small = facets[:, 0]
        # a facet normal to the axis is at the middle radius of the smaller leaf
        radius = 0.5 * (low[small, 0] + high[small, 0])
        side = np.where(facets[:, 1] % 2 == 1, high[small, 0], low[small, 0])
        return ring(np.where(facets[:, 1] < 2, side, radius)[:, None], 1.0)
    radii = _radii(field.space.grid)
    if isinstance(basis, LatticeBasis) and basis.coarsen > 1:
        # parts of a coarse facet have one penalty
        line, of = basis.lattice.lines[0], basis.lattice.cell_ijk[:, 0]
        radii = 0.5 * (line[of] + line[of + 1])
    cells = radii[facets[:, [0, 2]]]
    return ring(cells.mean(axis=1, keepdims=True), 1.0)


def isotropic_moduli(tangent: Array) -> Array:
    """M and G of the isotropic tensors nearest to tangents, shape (n, 2).

    The traces D_iikk and D_ijij of the symmetric part determine the two moduli of an isotropic
    tensor. So the moduli do not depend on axes, and commute with averages.

    Args:
        tangent: D_ijkl (Pa), shape (n, d, d, d, d).
    """
    out = np.zeros((len(tangent), 2))
    d = tangent.shape[1]
    slopes = np.ascontiguousarray(tangent).reshape(-1, d * d, d * d)
    add_isotropic_moduli(slopes, np.ones(len(out)), np.arange(len(out)), out)
    return out


@numba.njit(cache=True, error_model="numpy")
def add_isotropic_moduli(slopes, share, rows, out):
    """Add the moduli of `isotropic_moduli`, times shares, to those of some points; in one pass.

    Args:
        slopes: Tangents (Pa), shape (n, d², d²).
        share: Factors (-), shape (n,).
        rows: Numbers of the points, shape (n,).
        out: M and G of all points (Pa), shape (points, 2).
    """
    d = 1
    while d * d < slopes.shape[1]:
        d += 1
    for p in range(slopes.shape[0]):
        if d == 1:
            out[rows[p], 0] += share[p] * slopes[p, 0, 0]
            continue
        volume = whole = 0.0
        for i in range(d):
            for j in range(d):
                volume += slopes[p, i * d + i, j * d + j]
                whole += 0.5 * (slopes[p, i * d + j, i * d + j] + slopes[p, i * d + j, j * d + i])
        # the traces of λ δ_ij δ_kl + μ (δ_ik δ_jl + δ_il δ_jk) are d² λ + 2 d μ, d λ + d (d + 1) μ
        mu = (d * whole - volume) / (d * (d + 2.0) * (d - 1.0))
        lmbda = (volume - 2.0 * d * mu) / (d * d)
        out[rows[p], 0] += share[p] * (lmbda + 2.0 * mu)
        out[rows[p], 1] += share[p] * mu


def bounded(moduli: Array, elastic: Array, shared: npt.NDArray[np.bool_] | None = None) -> Array:
    """M and G within their bounds, G at most M; shapes (n, 2).

    Args:
        moduli: M and G (Pa).
        elastic: Elastic M and G (Pa). M and G are at least `LEAST` times the elastic ones.
        shared: Whether points share their volume change (F-bar), shape (n,). M is then at most
            `MOST` times the elastic G.
    """
    M = np.maximum(moduli[:, 0], LEAST * elastic[:, 0])
    if shared is not None:
        M = np.where(shared, np.minimum(M, MOST * elastic[:, 1]), M)
    return np.stack([M, np.clip(moduli[:, 1], LEAST * elastic[:, 1], M)], axis=1)


def update(modulus: FacetModulus, field: ActiveField) -> None:
    """Set moduli of ghost facets from the present moduli of the points. Collective.

    Args:
        modulus: The modulus; its `moduli` are set, after those of its source.
        field: The active field of its increment.
    """
    if modulus.source is not None:
        modulus.moduli = modulus.source.moduli
        return
    points = modulus.points
    facets = field.entities[GHOST_FACETS].reshape(-1, 4)
    if isinstance(modulus, FacetRing):
        modulus.moduli = _rings(field, facets) * [1.0, 0.0]
        return
    where: Placement = points.placement(field.space.configuration)
    M, G = points[FIELD].T
    # points without a law do not count
    weights = np.where(M > 0, where.volume, 0.0)
    left, right = facets[:, 0], facets[:, 2]
    if field.basis.grid_cells is not None:
        left, right = field.basis.grid_cells[left], field.basis.grid_cells[right]
    wanted = np.zeros(field.basis.cells.size, bool)
    wanted[left] = wanted[right] = True
    wanted = field.basis.cells.share_flags(wanted)
    sums = [
        cell_sums(where, field.full_stencils, field.basis, w, wanted)
        for w in (weights, weights * M, weights * G)
    ]
    weight, M, G = (s[left] + s[right] for s in sums)
    means = np.stack([M, G], axis=1)
    known = weight > 0
    means[known] /= weight[known, None]
    if points.comm.allreduce(not known.all(), op=MPI.LOR):
        # cells that contain only points without a law
        own = np.array(
            [weights.sum(), weights @ points[FIELD][:, 0], weights @ points[FIELD][:, 1]]
        )
        total = points.comm.allreduce(own)
        means[~known] = total[1:] / total[0] if total[0] > 0 else 0.0
    modulus.moduli = means * _rings(field, facets) if points.axisymmetric else means
