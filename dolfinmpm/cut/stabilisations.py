"""Stabilisation against small cuts: the choice of a stabilisation and its parameters."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import ufl
from mpi4py import MPI
from ufl.core.expr import Expr

from dolfinmpm._platform.argumentchecks import choice, number, shown
from dolfinmpm._platform.errors import DoubtfulInputWarning, ParameterError, warn
from dolfinmpm._platform.uncopied import unchanged
from dolfinmpm._platform.units import LARGEST_MODULUS
from dolfinmpm.basis import Placement, Stencils
from dolfinmpm.basis.space import Space
from dolfinmpm.body.axisymmetry import ring
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.cut.aggregation import MeshRoots, constraint_matrix
from dolfinmpm.cut.fractions import fill_fractions, support_shares
from dolfinmpm.cut.penalties import (
    ADAPTIVE,
    GHOST_FACTORS,
    SCALINGS,
    check_word,
    ghost,
    penalty_factor,
    soft,
)
from dolfinmpm.grid.lattice import mean_size

if TYPE_CHECKING:
    from scipy import sparse

__all__ = ["Stabilisation"]

KINDS = ("none", "ghost", "aggregation", "weak-aggregation", "extended", "soft")

# Arguments of each kind, besides the moduli
_OWN = {
    "ghost": ("factor", "scaling", "target"),
    "aggregation": ("threshold",),
    "weak-aggregation": ("factor", "threshold"),
    "extended": ("threshold",),
    "soft": ("eta",),
}

# Factors of the penalty of weak aggregation for linear functions, quadratic and cubic splines
WEAK_FACTORS = {1: 1.0, 2: 0.3, 3: 0.1}
# Fill fractions below which nodes are constrained to others
THRESHOLDS = {1: 0.5, 2: 0.7, 3: 0.9}
# Factor beyond all usual ones, which are at most 1e4
_LARGEST_USUAL = 1e6


@unchanged()
@dataclass(frozen=True)
class Stabilisation:
    """A stabilisation against small cuts and its parameters.

    Args:
        kind: One of

            - "none";
            - "ghost": penalty on jumps across ghost facets;
            - "aggregation": nodes of ill-filled cells follow the nearest well-filled cell;
            - "weak-aggregation": a penalty on the distance from the aggregated values;
            - "extended": aggregation with the inner functions of extended B-splines;
            - "soft": a share of the elastic stiffness of whole cells, in the preconditioner only.
        E: Young's modulus (Pa) for the scaling of penalties; by default that of the law.
        nu: Poisson's ratio, likewise.
        factor: Factor of the ghost penalty, by the laws or in units of E/30, or "adaptive", see
            `ghost`; of "weak-aggregation" in units of E. The default is 1 on linear functions. A
            ghost penalty has 100 on quadratic and 10⁴ on cubic splines, because their last
            functions are much smaller where a body ends. Weak aggregation has 0.3 and 0.1, because
            the weights of continuations are larger.
        scaling: Scaling of the ghost penalty, see `ghost`. The default is "tangent": by the moduli
            of the laws' tangent at the facet. Where E is given it is "scaled".
        target: Local constant of an adaptive ghost penalty; see `ghost`.
        threshold: Fill fraction from which a cell is well-filled. The default is 0.5, and 0.7 and
            0.9 for quadratic and cubic splines. For its meaning on splines see
            `constraint_matrix` in `dolfinmpm.cut.aggregation`.
        eta: Share of the elastic stiffness for "soft", 1e-3 by default.

    E and nu are moduli of the soil, and every kind accepts them. The other parameters belong to
    single kinds, see `takes`.

    Raises:
        ParameterError: A parameter has the wrong type or a value outside its range, or the kind
            has no such parameter. The message names the parameter.

    >>> import dolfinmpm as mpm
    >>> weak = mpm.Stabilisation("ghost", factor=0.1)
    >>> weak.kind, weak.factor, mpm.Stabilisation.takes("aggregation")
    ('ghost', 0.1, ('threshold',))
    """

    kind: str = "none"
    _: KW_ONLY
    E: float | None = None
    nu: float | None = None
    factor: float | str | None = None
    scaling: str | None = None
    threshold: float | None = None
    eta: float | None = None
    target: float | None = None

    @staticmethod
    def takes(kind: str) -> tuple[str, ...]:
        """Names of the arguments of a kind, besides E and nu.

        Args:
            kind: The stabilisation's kind.

        Raises:
            ParameterError: There is no stabilisation with this name.
        """
        return _OWN.get(choice("stabilisation", kind, KINDS), ())

    def __post_init__(self):
        # frozen: words are kept in the spelling of this module
        object.__setattr__(self, "kind", choice("stabilisation", self.kind, KINDS))
        if self.scaling is not None:
            scaling = choice("stabilisation's scaling", self.scaling, SCALINGS)
            object.__setattr__(self, "scaling", scaling)
        if self.E is not None:
            number("stabilisation's E", self.E, 0.0, LARGEST_MODULUS, unit="Pa")
        if self.nu is not None:
            number("stabilisation's nu", self.nu, -1.0, 0.5)
        if isinstance(self.factor, str) and self.kind == "ghost":
            check_word("stabilisation's factor", self.factor)
        elif self.factor is not None:
            self._check_factor(self.factor)
        if self.target is not None:
            number("stabilisation's target", self.target, 1.0)
        if self.threshold is not None:
            share = number("stabilisation's threshold", self.threshold)
            if not 0 < share <= 1:
                raise ParameterError(f"stabilisation's threshold = {share:g} must be in (0, 1]")
        if self.eta is not None:
            number("stabilisation's eta", self.eta, 0.0, 1.0)
        for name in ("factor", "scaling", "threshold", "eta", "target"):
            value = getattr(self, name)
            if value is not None and name not in _OWN.get(self.kind, ()):
                having = [f'"{kind}"' for kind, own in _OWN.items() if name in own]
                raise ParameterError(
                    f"{name} = {shown(value)} would do nothing: it belongs to the stabilisation "
                    f'{" and ".join(having)}, and this is "{self.kind}"; leave it out'
                )
        if self.target is not None and self.factor != ADAPTIVE:
            raise ParameterError(
                f'stabilisation\'s target = {self.target:g} belongs to factor="{ADAPTIVE}" only'
            )

    def _check_factor(self, factor: Any) -> None:
        """Raise ParameterError for no factor, and warn of one beyond all usual ones."""
        if penalty_factor("stabilisation's factor", factor) <= _LARGEST_USUAL:
            return
        warn(
            MPI.COMM_WORLD,
            f"stabilisation's factor = {factor:g} multiplies the usual penalty, which has 1 on "
            "linear functions and GIMP, 100 and 1e4 on splines: the body becomes too stiff near "
            "its cuts. It is no modulus: give that as E=",
            DoubtfulInputWarning,
        )

    @property
    def needs_modulus(self) -> bool:
        """Whether it needs Young's modulus E."""
        if self.kind == "ghost":
            return not self.follows_tangent
        return self.kind in ("weak-aggregation", "soft")

    @property
    def follows_tangent(self) -> bool:
        """Whether it is a ghost penalty in units of the laws' tangent."""
        if self.kind != "ghost":
            return False
        usual = "tangent" if self.E is None else "scaled"
        return self.factor == ADAPTIVE or (self.scaling or usual) == "tangent"

    def force_terms(
        self, points: MaterialPoints, u: Expr, v: Expr, known: Expr | None = None
    ) -> ufl.Form | None:
        """The term of the stabilisation in the weak form, or None.

        Args:
            points, u, v: See `ghost`.
            known: γ in literal scaling, if a term of the form gives it.
        """
        if self.kind != "ghost":
            return None
        if known is not None:
            return ghost(points, u, v, self.factor_of(u) * known, scaling="literal")
        if self.factor == ADAPTIVE:
            scaling = "literal" if self.scaling == "literal" else "scaled"
            return ghost(points, u, v, scaling=scaling, target=self.target, factor=ADAPTIVE)
        if self.follows_tangent:
            return ghost(points, u, v, factor=self.factor_of(u))
        assert self.E is not None
        return ghost(
            points, u, v, self.factor_of(u) * self.E / 30, scaling=self.scaling or "scaled"
        )

    def factor_of(self, u: Expr) -> float:
        """The ghost penalty's factor for an increment."""
        if self.factor is not None:
            assert not isinstance(self.factor, str)
            return self.factor
        space = getattr(u, "_dolfinmpm_space", None)
        return GHOST_FACTORS[space.basis.degree if space is not None else 1]

    def tangent_terms(self, points: MaterialPoints, u: Expr, v: Expr) -> ufl.Form | None:
        """The term of the stabilisation in the tangent only, or None."""
        if self.kind != "soft":
            return None
        assert self.E is not None
        return soft(
            points, u, v, E=self.E, nu=self.nu or 0.0, eta=1e-3 if self.eta is None else self.eta
        )

    @property
    def constrains_nodes(self) -> bool:
        """Whether constraints, or penalties on constraints, make nodes follow others."""
        return self.kind in ("aggregation", "weak-aggregation", "extended")

    def level(self, degree: int) -> float:
        """Fill fraction from which a cell is well-filled, for functions of a degree."""
        return THRESHOLDS[degree] if self.threshold is None else self.threshold

    def measure(self, where: Placement, stencils: Stencils, basis) -> npt.NDArray[np.float64]:
        """Fill fractions of cells, or for splines the shares of functions. Collective."""
        if basis.degree == 1:
            return fill_fractions(where, stencils, basis)
        return support_shares(where, stencils, basis)

    def constraint_matrix(
        self, where: Placement, basis, stencils: Stencils, nodes, fixed, roots: MeshRoots | None
    ) -> sparse.csr_matrix:
        """The matrix C of the constraints, u = C x. Collective."""
        filled = self.measure(where, stencils, basis)
        level, extended = self.level(basis.degree), self.kind == "extended"
        return constraint_matrix(basis, nodes, filled, level, extended, fixed, roots)

    def penalty(
        self,
        space: Space,
        C: sparse.csr_matrix,
        nodes,
        radius: npt.NDArray[np.float64] | None = None,
        sizes: npt.NDArray[np.float64] | None = None,
    ) -> tuple[npt.NDArray, npt.NDArray, npt.NDArray]:
        """Weak aggregation: factor E h^{d−2} Σ (u − C u)_a · (v − C v)_a over the following nodes.

        Aggregation makes the distance of a node from the continued polynomial zero. Weak
        aggregation penalises this distance (after Badia, Neiva & Verdugo 2022, doi
        10.1016/j.cma.2021.114093). The penalty has the scale of a stiffness, E h^{d−2}. In
        axisymmetric bodies, with a radius r, it has the factor 2π r, with r at least half a cell.

        Returns:
            Rows, columns and blocks, in the format of the ordinary terms.
        """
        from scipy import sparse

        assert self.E is not None
        size: Any = mean_size(space.cell_size) if sizes is None else sizes
        own = np.zeros(C.shape[0], bool)
        own[nodes] = True
        D = sparse.identity(C.shape[0], format="csr") - C
        # a far continuation has large weights, and must not outweigh the body
        norms = np.asarray(D.multiply(D).sum(axis=1)).ravel()
        share = own / np.maximum(norms, 1.0)
        factor = WEAK_FACTORS[space.basis.degree] if self.factor is None else self.factor
        assert not isinstance(factor, str)
        if radius is not None:
            share *= ring(np.maximum(radius, 0.5 * size), 1.0)
        weights = sparse.diags(share * factor * self.E * size ** (space.grid.geometry.dim - 2))
        product = sparse.coo_matrix(D.T @ weights @ D)
        blocks = product.data[:, None, None] * np.eye(space.components)
        return product.row.astype(np.int32), product.col.astype(np.int32), blocks
