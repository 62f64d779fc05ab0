"""Settings of MUMPS, and more workspace after a factorisation without enough workspace."""

from __future__ import annotations

from petsc4py import PETSc

from dolfinmpm.solve.options import Options

__all__ = ["WORKSPACE", "Mumps"]

# MUMPS's numbers of settings, and its errors about too little integer, real and send workspace
_ORDERING, WORKSPACE = 7, 14
_SHORT_OF_WORKSPACE = (-8, -9, -17)


class Mumps:
    """Settings of MUMPS for the solvers of one problem.

    Args:
        gdim: Dimension of space.
        options: PETSc options.

    Attributes:
        settings: Settings by MUMPS's numbers.
    """

    def __init__(self, gdim: int, options: Options):
        self._options = options
        # minimum fill: a tenth less time and memory than with the ordering that MUMPS chooses
        self.settings = {_ORDERING: 2} if gdim < 3 else {}

    def apply(self, ksp: PETSc.KSP, A: PETSc.Mat) -> None:
        """Create MUMPS's factors with the settings, unless options set them. Collective."""
        settings = {k: v for k, v in self.settings.items() if not self._given(k)}
        if not (_solves(ksp) and settings and A.getSize()[0]):
            return
        ksp.setOperators(A)
        ksp.getPC().setFactorSetUpSolverType()
        for number, value in settings.items():
            ksp.getPC().getFactorMatrix().setMumpsIcntl(number, value)

    def enlarge(self, ksp: PETSc.KSP, A: PETSc.Mat) -> bool:
        """Double the workspace if the last factorisation had too little. Collective.

        A plastic tangent near a limit load needs pivots off the diagonal. They fill in more than
        the 20 % that MUMPS adds to its forecast. The factors are made anew, because failed factors
        would fail again.

        Returns:
            Whether the workspace was doubled.
        """
        if not _solves(ksp) or self._given(WORKSPACE):
            return False
        share = 2 * self.settings.get(WORKSPACE, 50)
        short = ksp.getPC().getFactorMatrix().getMumpsInfog(1) in _SHORT_OF_WORKSPACE
        if not short or share > 1000:
            return False
        self.settings[WORKSPACE] = share
        ksp.getPC().reset()
        self.apply(ksp, A)
        return True

    def _given(self, number: int) -> bool:
        return f"mat_mumps_icntl_{number}" in self._options.names


def _solves(ksp: PETSc.KSP) -> bool:
    pc = ksp.getPC()
    return pc.getType() in ("lu", "cholesky") and pc.getFactorSolverType() == "mumps"
