"""Line searches of SNES, which petsc4py 3.22 reaches through the options alone, and its ends."""

from __future__ import annotations

from petsc4py import PETSc

__all__ = ["SEARCHES", "name_of", "set_search"]

# In the order in which they are tried: full steps, then those to where the residual has no
# component along the step, which is what ends cycles between two states.
SEARCHES = ("basic", "cp")
_OPTION = "snes_linesearch_type"
_REASONS = {v: k for k, v in vars(PETSc.SNES.ConvergedReason).items() if isinstance(v, int)}


def name_of(reason: int) -> str:
    """PETSc's name for why SNES ended."""
    return _REASONS.get(reason, str(reason))


def set_search(snes: PETSc.SNES, prefix: str, kind: str) -> None:
    """Choose the line search. Collective."""
    database = PETSc.Options()
    database[prefix + _OPTION] = kind
    snes.setFromOptions()
    # what stays in the database would pass for the user's choice
    database.delValue(prefix + _OPTION)
