"""Forces and moments in a section of a body, such as a wall, a pile or a beam of material points.

A section has the forces of a slab around it, as a mean with the weight of a hat: 1 in the section,
and 0 at the width of a cell to both sides. The stress of a point counts with the mean weight of its
domain. In linear functions and GIMP the stress in a bent beam swings from cell to cell; a hat two
cells wide takes the mean of what swings.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import as_tags, number, shown, vector
from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.errors import ParameterError, SectionAtEndWarning, warn
from dolfinmpm._platform.uncopied import FOUND, unchanged
from dolfinmpm.body.axisymmetry import in_section
from dolfinmpm.body.formarguments import check_points
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.grid.lattice import largest_cell, lattice_of

__all__ = ["SectionForces", "section_forces"]

Array = npt.NDArray[np.float64]

# Share of a slab beyond the end of the body from which on a warning tells it
_MOST_MISSING = 0.02


@unchanged(FOUND)
@dataclass(frozen=True)
class SectionForces:
    """Force and moment in a section, see `section_forces`.

    Attributes:
        force: Force of the side to which the normal points, on the other side (N; N/m for plane
            bodies), shape (gdim,). Along the normal it is positive in tension.
        moment: Its moment about the centre of the section (N m; N m/m for plane bodies), shape
            (1,) in 2D and (3,) in 3D. In 2D it is positive where that side turns the other one
            counter-clockwise.
        centre: Centre of the section (m), shape (gdim,).
        area: Area of the section (m²; m for plane bodies).

    A wall, 2 m thick, under a pressure of 1 kPa:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(7), range(7)])
    >>> points = mpm.fill(grid, mpm.Box((1, 0), (3, 5)), per_cell=2, density=2000.0)
    >>> points["stress"][:, 1, 1] = -1e3
    >>> found = mpm.section_forces(points, place=(1, 2.5), normal=(0, 1))
    >>> found.force.round(6).tolist(), found.moment.round(6).tolist(), found.centre.tolist()
    ([0.0, -2000.0], [0.0], [2.0, 2.5])
    """

    force: Array
    moment: Array
    centre: Array
    area: float


@collective
def section_forces(
    points: MaterialPoints,
    place: Any,
    normal: Any,
    *,
    tag: int | tuple[int, ...] | None = None,
    width: float | None = None,
) -> SectionForces:
    """Force and moment in a plane section of a body in its present state. Collective.

    They are those of the stresses of the points in a slab around the section. What a ghost penalty
    carries is not in them. Of soil with water it is the effective stress.

    With k cells over the thickness of a bent plate, linear functions and GIMP miss the force and
    the moment by about 0.3/k² of them: 7, 2 and 0.5 % with 2, 4 and 8 cells. With 4 cells of
    quadratic splines it is below 0.2 %. Moments that vary along the beam count in their mean over
    the slab, which must lie within the body: keep away from its ends by `width`. At the end itself
    half of the slab is missing, and half of the force and of the moment. A warning tells it.

    Args:
        points: Material points.
        place: A place in the section (m), shape (gdim,).
        normal: Normal of the section, of any length, shape (gdim,).
        tag: Tags of the points that count, such as those of the wall; None for all points.
        width: Distance from the section at which stresses count no more (m): by default the
            length along the normal of the largest cell that the section cuts, and of the largest
            cell of a grid that is not rectangular. Give the size of the leaves in a refined space.
            Less than a cell takes what swings from cell to cell for the mean: half a cell missed
            the weight above a section by up to 9 % with GIMP. It is at least the length of the
            points' domains.

    Returns:
        Force, moment, centre and area. For axisymmetric bodies they are those of the whole
        circumference, and the centre has the mean radius of its area.

    Raises:
        ParameterError: An argument is not valid, or no point is in the section.

    Warns:
        SectionAtEndWarning: A part of the slab lies beyond the end of the body.

    A layer of soil, 8 m wide, reaches 5 m above the section:

    >>> import dolfinmpm as mpm, ufl
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(9), range(12)])
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (8, 10)), per_cell=2, density=2000.0)
    >>> V = mpm.Space(grid, "gimp")
    >>> F = mpm.momentum(mpm.materials.Hencky(1e8, 0.3), points, V.increment, V.test)
    >>> F -= ufl.inner(points.density * ufl.as_vector([0.0, -10.0]), V.test) * points.dX
    >>> bcs = mpm.fixed(V, "bottom") + mpm.rollers(V, "left", "right")
    >>> record = mpm.QuasiStatic(F, V.increment, points, bcs).step()
    >>> found = mpm.section_forces(points, (0, 5), (0, 1))
    >>> found.force[1].round(-4).item(), round(found.area, 2)
    (-800000.0, 8.0)
    """
    check_points(points)
    d = points.gdim
    x0, n = vector("place", place, d, "m"), vector("normal", normal, d)
    size = float(np.linalg.norm(n))
    if not size > 0:
        raise ParameterError(f"normal = {shown(normal)} must not be zero")
    n = np.asarray(n / size, np.float64)
    tags = as_tags(tag)
    x, read = points["x"], points.fields.read
    # half-lengths of the domains across the section
    half = read("l") @ np.abs(n)
    counts = np.ones(len(x), bool) if tags is None else np.isin(read("tag"), tags)
    along = (x - x0) @ n
    if width is None:
        w = _cell_along(points, x[counts & (np.abs(along) <= half)], n)
    else:
        w = number("width", width, 0.0, unit="m")
    V = read("V") * _mean_weight(along, half, w) * counts
    reach = (along + half)[counts], (half - along)[counts], half[V > 0]
    ends = (float(np.max(d, initial=-np.inf)) for d in reach)
    up, down, longest = (points.comm.allreduce(end, op=MPI.MAX) for end in ends)
    if width is not None and w < 2 * longest * (1 - 1e-6):
        raise ParameterError(
            f"width = {w:g} m must be at least the length of the points' domains along the normal, "
            f"{2 * longest:.6g} m; the size of a cell is best"
        )
    t = in_section(points, read("stress"))[:, :d, :d] @ n
    sums = points.comm.allreduce(np.concatenate([[V.sum()], V @ x, V @ t]), op=MPI.SUM)
    area = float(sums[0])
    if not area > 0:
        raise ParameterError(_nothing(points, x0, n, tags))
    _warn_at_end(points, x0, min(up, down), w)
    centre = sums[1 : 1 + d] / area
    centre = centre - ((centre - x0) @ n) * n
    # arms lie in the section: shear forces of the slab make no moment in its middle
    arms = x - centre
    arms -= (arms @ n)[:, None] * n
    more = ((0, 0), (0, 3 - d))
    moment = np.cross(np.pad(arms, more), np.pad(t, more))
    total = points.comm.allreduce(V @ moment, op=MPI.SUM)
    return SectionForces(sums[1 + d :], total if d == 3 else total[2:], centre, area)


def _cell_along(points: MaterialPoints, x: Array, n: Array) -> float:
    """Greatest length along a normal of the cells at some positions (m). Collective.

    The largest cell of the whole grid would smear moments where the cells are fine.
    """
    grid, lattice = points.grid, lattice_of(points.grid)
    square = np.zeros(len(x))
    for i, line in enumerate(() if lattice is None else lattice.lines):
        cell = np.clip(np.searchsorted(line, x[:, i]) - 1, 0, len(line) - 2)
        square += (n[i] * np.diff(line)[cell]) ** 2
    found = grid.comm.allreduce(float(square.max(initial=0.0)), op=MPI.MAX)
    return found**0.5 if found > 0 else largest_cell(grid)


def _mean_weight(distance: Array, half: Array, w: float) -> Array:
    """Mean over domains of a hat's weight, whose integral is 1 (1/m), shape (points,).

    Args:
        distance: Distance of the domains' middles from the section (m).
        half: Half-lengths of the domains along the normal (m).
        w: Distance at which the weight becomes zero (m).
    """

    def below(s: Array) -> Array:
        """Integral of the weight from far below up to a distance."""
        s = np.clip(s / w, -1.0, 1.0)
        return 0.5 + s - 0.5 * s * np.abs(s)

    return (below(distance + half) - below(distance - half)) / (2 * half)


def _warn_at_end(points: MaterialPoints, place: Array, left: float, w: float) -> None:
    """Warn if a slab reaches beyond the end of a body.

    Args:
        points: Material points.
        place: A place in the section (m).
        left: Distance from the section to the nearer end of the body (m).
        w: Half of the width of the slab (m).
    """
    missing = 0.5 * max(1 - max(left, 0.0) / w, 0.0) ** 2
    if missing > _MOST_MISSING:
        warn(
            points.comm,
            f"the section through place = {place} m is {max(left, 0.0):.3g} m from the end of the "
            f"points along its normal, and forces are means up to the width {w:.3g} m to both "
            f"sides: {100 * missing:.0f} % is beyond the end, and force, moment and area are too "
            f"small by about as much. Keep away from the end by {w:.3g} m; for the value at the "
            "end continue the line through two such places",
            SectionAtEndWarning,
        )


def _nothing(points: MaterialPoints, place: Array, n: Array, tags: Any) -> str:
    """Message for a section without points: where they are along the normal. Collective."""
    along = points["x"] @ n
    if tags is not None:
        along = along[np.isin(points["tag"], tags)]
    low = points.comm.allreduce(along.min(initial=np.inf), op=MPI.MIN)
    high = points.comm.allreduce(along.max(initial=-np.inf), op=MPI.MAX)
    of = "the points" if tags is None else f"the points of tag {', '.join(map(str, tags))}"
    where = f"lie between {low:.6g} and {high:.6g} m there" if low <= high else "do not exist"
    return (
        f"no point is in the section through place = {place} m, at {place @ n:.6g} m along its "
        f"normal; {of} {where}: give a place in the body"
    )
