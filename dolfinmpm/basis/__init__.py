"""Bases: each turns material points into stencils of nodes, values and gradients."""

from dolfinmpm.basis.latticebasis import LatticeBasis
from dolfinmpm.basis.leafbasis import LeafBasis
from dolfinmpm.basis.linear import LinearBasis
from dolfinmpm.basis.stencils import Placement, Stencils

__all__ = ["LatticeBasis", "LeafBasis", "LinearBasis", "Placement", "Stencils"]
