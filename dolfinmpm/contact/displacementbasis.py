"""The basis functions of a displacement, as contact points use them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import scipy

from dolfinmpm.basis.stencils import Stencils, selected
from dolfinmpm.cut.activation import ActiveField, Basis

__all__ = ["DisplacementBasis"]

Rows = npt.NDArray[np.integer]


@dataclass(frozen=True)
class DisplacementBasis:
    """The basis functions of a displacement for corners.

    Attributes:
        basis: Basis of the displacement.
        total: Whether stencils are those at initial positions.
        C: Prolongation from the independent nodes to all nodes, or None.
        stencils: Function from rows of points to their stencils, with points numbered from 0.
        place: Row of each node of the basis in nodal forces, shape (nodes,); None for the same
            numbering.
        growth: Growth of domains, in steps in time, where corners move with the states of their
            points. None where corners move with the functions at the corners.
        followed: Whether corners in steps in time move with their faces, and their gaps are
            followed, see `dolfinmpm.contact.followedgaps`.
        domains: Growth of domains in other steps.
    """

    basis: Basis
    total: bool
    C: scipy.sparse.csr_matrix | None
    stencils: Callable[[Rows], Stencils]
    place: npt.NDArray[np.int32] | None = None
    growth: str | None = None
    followed: bool = False
    domains: str = "stretch"

    @property
    def columns(self) -> int:
        """Number of the independent nodes."""
        return self.basis.nodes.size if self.C is None else self.C.shape[1]

    @staticmethod
    def of(
        field: ActiveField, total: bool, count: int, follows: bool | None = None
    ) -> DisplacementBasis:
        """The basis functions of an active field.

        Args:
            field: The field.
            total: See the attribute.
            count: Number of material points.
            follows: Whether gaps are followed in steps in time; None in other steps.
        """

        def stencils(rows: Rows) -> Stencils:
            chosen = np.zeros(count, bool)
            chosen[rows] = True
            s = selected(field.stencils, chosen)
            return replace(s, order=np.searchsorted(rows, s.order).astype(np.int32))

        rule = field.space.domains
        growth = None if follows is None else rule
        return DisplacementBasis(
            field.basis, total, field.C, stencils, None, growth, bool(follows), rule
        )
