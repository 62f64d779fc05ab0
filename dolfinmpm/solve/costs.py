"""What set-ups and solutions cost, as counted: the same on every run, whatever else runs."""

from __future__ import annotations

from petsc4py import PETSc

__all__ = ["of_setup", "of_solution"]

# By preconditioner: nanoseconds of a flop of solutions, of a flop of a set-up, and of an entry of
# what a set-up makes. Fitted once, on one core of an AMD EPYC with PETSc 3.22, to scenes of
# `demos/studies` with 2,500 to 30,000 unknowns: elastic blocks and slopes in 3D (`solid_3d.py`),
# sand (`benchmark.py --plastic 80`) and columns in 2D, linear functions to quadratic splines. Only
# ratios matter. In dense blocks of factors flops are cheap; what lies beside them goes by entries.
_NANOSECONDS = {
    "ilu": (0.27, 0.25, 3.0),
    "bjacobi": (0.27, 0.25, 3.0),
    "lu": (0.55, 0.02, 10.0),
    "cholesky": (0.38, 0.04, 11.0),
    # substructures, of whose factors PETSc does not know the entries: those of the matrix
    "python": (0.38, 0.04, 60.0),
}
# of multigrid in all its forms, and of what a user has chosen
_OTHERWISE = (0.6, 1.0, 40.0)


def of_solution(pc: PETSc.PC, flops: float) -> float:
    """Cost of a solution on one rank (ns).

    Args:
        pc: The preconditioner.
        flops: What PETSc has counted on this rank.
    """
    return _NANOSECONDS.get(pc.getType(), _OTHERWISE)[0] * flops


def of_setup(pc: PETSc.PC, flops: float) -> float:
    """Cost of a set-up on one rank (ns).

    Args:
        pc: The preconditioner.
        flops: What PETSc has counted on this rank.
    """
    kind, A = pc.getType(), pc.getOperators()[1]
    _, a_flop, an_entry = _NANOSECONDS.get(kind, _OTHERWISE)
    if kind in ("lu", "cholesky") and pc.getFactorSolverType() in ("mumps", "cholmod", "petsc"):
        A = pc.getFactorMatrix()
        if pc.getFactorSolverType() == "mumps":
            # PETSc does not count these: what MUMPS's analysis expects of all ranks
            flops += A.getMumpsRinfog(1) / A.comm.size
    entries = A.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"] / A.comm.size
    return a_flop * flops + an_entry * entries
