"""Bodies at rest: states of stress that are in balance before anything has moved."""

from __future__ import annotations

import numpy as np
from mpi4py import MPI

from dolfinmpm._platform.checks import check_kind, number, whole
from dolfinmpm._platform.errors import ConvergenceError, ParameterError
from dolfinmpm._platform.together import together
from dolfinmpm.body.boundary import OWN
from dolfinmpm.solve.operator import Operator
from dolfinmpm.solve.quasistatic import QuasiStatic

__all__ = ["equilibrate"]


@together
def equilibrate(problem: QuasiStatic, tolerance: float = 1e-9, most: int = 20) -> int:
    """Bring the stress of a body into balance with its loads, without moving it. Collective.

    Steps are taken as usual, and each time the points are put back to where they were at first,
    undeformed, with the stress that they have come to. What is out of balance after that is
    of the square of what was, so that two or three are enough, but for the force of a ghost
    penalty, which is of increments and is not kept: with it each step leaves a share. A level
    deposit whose stress and weight fit each other needs none.

    Internal variables, such as plastic strain, and the records of the steps stay.

    Args:
        problem: A quasi-static problem with points that have not been deformed.
        tolerance: Force out of balance that is left, as a share of external forces and reactions.
        most: Steps allowed.

    Returns:
        How many steps were taken.

    Raises:
        ParameterError: The problem is none, the points have been deformed, or a number is not what
            it may be.
        ConvergenceError: More steps would be needed, or one failed.
    """
    check_kind("problem", problem, QuasiStatic, "give an mpm.QuasiStatic")
    number("tolerance", tolerance, 0.0), whole("most", most, 1)
    points = problem.points
    F = points["F"]
    moved = float(np.abs(F - np.eye(F.shape[1])).max(initial=0.0))
    moved = points.comm.allreduce(moved, op=MPI.MAX)
    if moved > 0:
        raise ParameterError(
            f"the points have been deformed, by F − I of {moved:.3g}; bring a body into balance "
            "before its first step"
        )
    out = _out_of_balance(problem.operator())
    for taken in range(most):
        if out <= tolerance:
            return taken
        problem.step()
        _put_back(problem)
        out = _out_of_balance(problem.operator())
    if out <= tolerance:
        return most
    raise ConvergenceError(
        f"after {most} steps the force out of balance is {out:.3g} of external forces and "
        f"reactions (tolerance {tolerance:g}): the body flows under its loads, or a ghost penalty "
        "holds what its stress should; take more steps, or aggregation"
    )


def _out_of_balance(operator: Operator) -> float:
    found = operator.residual(np.zeros(operator.here.unknowns.owned))
    return found.norm / found.reference if found.reference > 0 else 0.0


def _put_back(problem: QuasiStatic) -> None:
    """Undo the deformation of points and markers. Collective."""
    points = problem.points
    points["F"] = np.eye(points["F"].shape[1])
    # the others have not moved
    boundaries = [of.boundary for of in problem.form.boundaries if of.boundary.follows]
    for sets, names in (
        (points, ("x", "V", "l")),
        *((b.markers, ("x", "area")) for b in boundaries),
    ):
        for name in names:
            sets[name] = sets[f"{name}0"]
        if sets is not points:
            sets["V"] = np.linalg.norm(sets["area"], axis=1)
            if OWN in sets.fields:
                sets[OWN] = np.eye(sets.strain_dim)
        sets.locate()
