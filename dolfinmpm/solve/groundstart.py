"""The start of the ground: stress by K0, layers and water table, then balance with the loads."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import check_kind
from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.errors import ParameterError, call_together
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.body.tags import tags_in_use
from dolfinmpm.kinematics.deposits import Deposit
from dolfinmpm.kinematics.lawterms import set_stress
from dolfinmpm.solve.initialbalance import check_undeformed, equilibrate
from dolfinmpm.solve.quasistatic import QuasiStatic

__all__ = ["start_at_rest"]

Array = npt.NDArray[np.float64]

# Beyond this ratio of their vertical stresses, loads and ground have weights in two units
_UNITS = 10.0
# The loads are the total weight if the stress is as close to it as this
_SAME = 0.02


@collective
def start_at_rest(
    problem: QuasiStatic, ground: Deposit, *, tolerance: float = 1e-9, most: int = 20
) -> int:
    """Give the points the stress of layered ground, and balance it with the loads. Collective.

    Each law of the problem gets the stress of the ground at its points, see `set_stress`: vertical
    stress by the effective weight above, horizontal stress by K0, and pore pressure apart. Then
    `equilibrate` brings this stress into balance with the loads of the problem, without moving the
    points. Level ground is in balance at once with linear functions and GIMP. With splines its
    stress changes beside the base and the surface, because sums over points are not exact there:
    with two points per cell and direction by up to 6 % of the weight of a cell, 11 % where a ghost
    penalty acts and the surface cuts cells; with four by 2 and 3 %. Below a slope, K0 is only a
    first guess.

    The law takes the stress only within its yield surface. In soil without cohesion a K0 of
    1 − sin φ is within that of Mohr and Coulomb. It is within a cone of Drucker and Prager with the
    fit "compression", and with the other fits up to φ = 35.9°.

    Args:
        problem: A quasi-static problem with undeformed points, and its weight as a load.
        ground: The layers; its surface may be a `Terrain`.
        tolerance, most: See `equilibrate`.

    Returns:
        The number of steps.

    Raises:
        ParameterError: The problem has no law, is not quasi-static, or its points are deformed. Or
            the loads are not the weight of the ground: their mean vertical stress is above ten
            times or below a tenth of it, or that of the total weight below a water table.
        StateError: A stress lies outside the yield surface of its law.
        ConvergenceError: The force is not in balance after `most` steps, or a step failed.

    A hillside at rest in one call:

    >>> import dolfinmpm as mpm
    >>> import ufl
    >>> from mpi4py import MPI
    >>> hill = mpm.Terrain(([0, 8],), [3.0, 2.0])
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(9), range(5)])
    >>> points = mpm.fill(grid, hill.ground(0.0), per_cell=2, density=1800.0, exact=True)
    >>> V = mpm.Space(grid, "gimp")
    >>> soil = mpm.materials.Hencky(E=20e6, nu=0.3)
    >>> F = mpm.momentum(soil, points, V.increment, V.test)
    >>> F -= ufl.inner(points.density * ufl.as_vector((0.0, -9.81)), V.test) * points.dX
    >>> bcs = mpm.fixed(V, "bottom") + mpm.rollers(V, "left", "right")
    >>> problem = mpm.QuasiStatic(F, V.increment, points, bcs, stabilisation="aggregation")
    >>> ground = mpm.Deposit(hill, mpm.Layer(0.0, unit_weight=1800 * 9.81, K0=0.5))
    >>> steps = mpm.start_at_rest(problem, ground)
    >>> bool((points["x"] == points["x0"]).all()), bool(points["stress"][:, 1, 1].max() < 0)
    (True, True)
    """
    check_kind("problem", problem, QuasiStatic, "give an mpm.QuasiStatic")
    check_kind("ground", ground, Deposit, "make it with mpm.Deposit(surface, layers)")
    points = problem.points
    declarations = problem.form.parts.declarations
    if not declarations:
        raise ParameterError("the problem has no law that could take a stress: add mpm.momentum")
    check_undeformed(points, "start the ground")
    stress: Callable[[Any], Array] = ground.stress
    x = points["x"].T
    below = call_together(points.comm, lambda: bool(x.size and np.any(ground.stress(x))))
    if not points.comm.allreduce(below, op=MPI.LOR):
        raise ParameterError(
            "no point has a stress: all are above the surface of the ground, whose heights must "
            "be those of the grid, or its layers have no weight"
        )
    in_use = tags_in_use(points)
    # a form may have a law of fill whose points come later
    here = [one for one in declarations if one.tags is None or not in_use.isdisjoint(one.tags)]
    for one in here or declarations:
        tags = None if one.tags is None else tuple(one.tags)
        set_stress(one.law, points, stress, strain=one.strain, tag=tags)
    count = equilibrate(problem, tolerance=tolerance, most=most)
    _check_weight(points, ground)
    return count


def _check_weight(points: MaterialPoints, ground: Deposit) -> None:
    """Compare the vertical stress in balance with that of the ground. Collective.

    On a level base the integrals of both are the same, whatever the shape of the surface.

    Raises:
        ParameterError: The loads are not the effective weight of the ground.
    """
    x, V, axis = points["x"].T, points["V"], points.gdim - 1
    dry = Deposit(ground.surface, ground.layers)

    def integrals() -> Array:
        given = ground.vertical_stress(x)
        all_of_it = given - ground.pore_pressure(x)
        values = (points["stress"][:, axis, axis], given, all_of_it, dry.vertical_stress(x))
        return np.array([V @ value for value in values] + [V.sum()])

    *sums, volume = points.comm.allreduce(call_together(points.comm, integrals))
    found, given, *others = (float(value / volume) for value in sums)
    told = (
        f"the loads give the body a mean vertical stress of {found:.6g} Pa, and the layers of the "
        f"ground give {given:.6g} Pa"
    )
    if not abs(given) / _UNITS < -found < abs(given) * _UNITS:
        raise ParameterError(
            f"{told}: give unit weights in N/m³, densities in kg/m³, and the weight as a load"
        )
    for other in others:
        if abs(given - other) > 5 * _SAME * abs(other) and abs(found - other) < _SAME * abs(other):
            raise ParameterError(
                f"{told}, which is effective: below the water table the load must be the effective "
                "weight, F -= ufl.inner(ground.body_force(points), v) * points.dX. If both are "
                "meant as they are, call mpm.set_stress and mpm.equilibrate"
            )
