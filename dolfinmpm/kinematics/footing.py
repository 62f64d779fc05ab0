"""Rigid footings: a face of a body that follows a stiff plate, held by a penalty."""

from __future__ import annotations

import itertools

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from mpi4py import MPI
from ufl.algorithms import extract_coefficients
from ufl.core.expr import Expr

from dolfinmpm._platform.argumentchecks import check_kind, number, truth
from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.errors import FormError, ParameterError
from dolfinmpm._platform.readonce import ReadOnce
from dolfinmpm.body.formarguments import check_displacement
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.body.surface import Surface
from dolfinmpm.forms.carriedfields import CarriedField
from dolfinmpm.grid.constants import begin_at_zero, own_constant, reached
from dolfinmpm.grid.lattice import cell_size

__all__ = ["RigidFooting", "motions_under_footings", "refuse_footings"]

Array = npt.NDArray[np.float64]

# The default penalty in units of E/h: ten times more changes the reaction by less than a thousandth
# (cubic splines, which bend sharply at a footing's edge: by some per cent on few cells), and
# the first out-of-balance force, which a step's tolerance is relative to, is not yet all penalty.
_STIFFNESS = 1e4


class FaceMotion(CarriedField):
    """Motion of the faces under a footing since it was made (m), by the whole increments."""

    level = None
    # Young's modulus (Pa) that goes with the penalty, its owner, and what was given
    softest: tuple[float, str, str] | None = None


class RigidFooting(ReadOnce):
    """A rigid footing that is pressed into a face of the body by a given settlement.

    A penalty holds the faces of the surface's points at the footing. It acts on the total gap
    g = n·d + s, with the motion d of the face since the footing was made, and the settlement s. So
    the next step sees a gap that one step leaves, and errors do not add up. A rough footing holds
    the faces sideways too; a smooth one does not. Both stay in contact, and pull when they are
    lifted.

    Where the body goes on beside the faces, the footing has an edge, which stays in place. Faces of
    points that slide out from under it are held up to the edge, and not at all once their points
    have left. The edges are those of the box around all faces.

    The points get the field `<surface>_motion` (m), the motion d. It is a sum of increments. The
    difference of two places would have too few digits for a gap of some 1e-7 m. The name ends with
    a number if the surface had a footing before.

    Args:
        surface: The surface under the footing, with an axis as its normal.
        settlement: Motion of the footing into the body (m) since it was made, against the outward
            normal: a scalar DOLFINx constant. A value that it has already acts in the first step.
            Substeps take a share of its change, as of any load. In time the footing moves evenly
            over each step. Begin and end its motion smoothly: `Newmark` does not damp what a sudden
            velocity sets swinging, `GeneralisedAlpha(rho_inf=0.5)` does.
        rough: Whether the faces are held sideways too.
        E: Young's modulus of the body (Pa), for the default stiffness 10⁴ E/h. h is the size of
            the largest cell.
        stiffness: Penalty (Pa/m), instead of E.

    Raises:
        ParameterError: The surface has no axis for its normal, the settlement is not a scalar
            constant, neither E nor the stiffness is positive and finite, or an argument is
            assigned to later. A problem raises it if a law has fbar="volumes", or if the penalty is
            less than a hundredth of the default one for the law.
        FormError: `Explicit` raises it, because its steps would be very short.

    A footing of 2 m, 1 cm down:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=2000.0)
    >>> V = mpm.Space(grid, "gimp")
    >>> F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, V.increment, V.test)
    >>> from dolfinx import fem
    >>> top = mpm.Surface(points, lambda x: (x[1] > 1.9) & (x[0] < 2.0), normal=(0, 1))
    >>> footing = mpm.RigidFooting(top, fem.Constant(grid, 0.01), E=1e6)
    >>> F += footing.contact(V.increment, V.test)
    >>> record = mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom")).step()
    >>> round(footing.load(), -2)
    16000.0
    """

    _attributes = frozenset({"surface", "settlement", "rough", "stiffness"})

    @collective
    def __init__(
        self,
        surface: Surface,
        settlement: fem.Constant,
        *,
        rough: bool = True,
        E: float | None = None,
        stiffness: float | None = None,
    ):
        check_kind("surface", surface, Surface, "make it with mpm.Surface(points, where, normal)")
        points = surface.points
        if surface.normal is None:
            raise ParameterError(
                f"the surface '{surface.name}' was made from arrays and has no single normal; make "
                "it with Surface(points, where, normal)"
            )
        if not isinstance(settlement, fem.Constant) or settlement.ufl_shape != ():
            raise ParameterError(
                f"settlement = {settlement!r} must be a scalar dolfinx.fem.Constant (m), which "
                "steps change"
            )
        if settlement.ufl_domain() != points.grid.ufl_domain():
            raise ParameterError(
                "the settlement is a constant of another mesh; make it with "
                "dolfinx.fem.Constant(points.grid, 0.0)"
            )
        number("settlement", float(settlement.value), unit="m")
        cell = _largest_cell(points)
        if stiffness is None:
            if E is None:
                raise ParameterError(
                    "a footing needs the Young's modulus of the body, E = ... (Pa), for the "
                    f"stiffness {_STIFFNESS:g} E/h by default, or stiffness = ... (Pa/m)"
                )
            stiffness = _STIFFNESS * number("E", E, 0.0, unit="Pa") / cell
        elif E is not None:
            raise ParameterError("E and stiffness are both given; give one of them")
        self.surface, self.settlement = surface, settlement
        self.rough = truth("rough", rough)
        self.stiffness = number("stiffness", stiffness, 0.0, unit="Pa/m")
        # constants of the form, for numbers would be compiled into it
        self._k = own_constant(points.grid, self.stiffness)
        begin_at_zero("settlement", settlement)
        names = (f"{surface.name}_motion{k or ''}" for k in itertools.count())
        motion = next(name for name in names if name not in points.fields)
        points.add_field(motion, (points.gdim,), "m")
        self._motion = FaceMotion(points, motion, (points.gdim,), "m")
        goes_with = self.stiffness * cell / _STIFFNESS
        given = f"E = {goes_with:g} Pa"
        if E is None:
            given = f"stiffness = {self.stiffness:g} Pa/m, which goes with {given}"
        self._motion.softest = goes_with, f"the RigidFooting on '{surface.name}'", given
        edges = _edges(surface)
        self._faces = surface._cut(edges) if np.isfinite(edges).any() else surface
        self._motion.surface = self._faces
        self._in_contact = False

    def _instead(self, name: str) -> str:
        """See `ReadOnce`."""
        if name == "settlement":
            return "set the value of the constant that it was made with, settlement.value = ..."
        return f"make a new RigidFooting with {name}=..., and a new problem with its contact"

    def contact(self, u, v) -> ufl.Form:
        """Contact of the footing with the body, to be added: ∫ k g·v(x_s) dA0.

        Args:
            u: Increment of the step, `Space.increment`.
            v: Test function, `Space.test`.

        Raises:
            ParameterError: u is no increment, or v no test function.
        """
        faces = self._faces
        check_displacement(faces.points, u=u)
        self._in_contact = True
        n = ufl.as_vector([float(c) for c in self.surface.normal])
        moved = self._motion + faces.at(u)
        for left in _have_left(faces):
            # no gap
            moved = ufl.conditional(left, -self.settlement * n, moved)
        self._motion.update = moved
        gap = moved + self.settlement * n
        if not self.rough:
            gap = ufl.dot(gap, n) * n
        name = f"the contact of a footing on '{faces.name}'"
        return faces.term(-self._k * gap, v, name, once=True)

    def gaps(self) -> Array:
        """Gaps that the penalty left in the last step (m), shape (points on this rank, gdim)."""
        n = self.surface.normal
        # a value that is set for the next step has moved nothing yet
        settled = reached(self.settlement)
        assert settled is not None
        gap = self.surface.points[self._motion.name] + settled * n
        gap = gap if self.rough else np.outer(gap @ n, n)
        return np.where(self.surface._sizes()[:, None] > 0, gap, 0.0)

    @collective
    def reaction(self) -> Array:
        """Force of the footing on the body in the last step (N; N/m in plane strain). Collective.

        Shape (gdim,). Of axisymmetric bodies it is the whole force.

        Raises:
            ParameterError: There is a settlement, and the contact of the footing is in no form.
        """
        if not self._in_contact and self.settlement.value != 0.0:
            raise ParameterError(
                f"the footing on '{self.surface.name}' has no force: its contact is in no form; "
                "add it before the problem is made, F += footing.contact(u, v)"
            )
        force = -self.stiffness * (self.surface._sizes() @ self.gaps())
        return self.surface.points.comm.allreduce(force, op=MPI.SUM)

    @collective
    def load(self) -> float:
        """Force that presses the footing into the body (N; N/m in plane strain). Collective.

        It is that of the last step, and 0 before the first one; see `reaction`.
        """
        return float(-self.reaction() @ self.surface.normal)


def motions_under_footings(form: ufl.Form) -> list[str]:
    """Names of the fields in a form with the motions of faces under footings."""
    return sorted(c.name for c in extract_coefficients(form) if isinstance(c, FaceMotion))


def refuse_footings(form: ufl.Form) -> None:
    """Raise FormError if explicit steps are given a form with a footing.

    Their critical step does not know its penalty, by which it would be some hundred times shorter.
    """
    names = motions_under_footings(form)
    if names:
        raise FormError(
            f"the form has the contact of a RigidFooting, with the field {names[0]}: its penalty "
            "would make explicit steps very short; take mpm.RigidBody with mpm.contact, or Newmark"
        )


def _edges(surface: Surface) -> Array:
    """Lower and upper corner of the box around a footing (m), shape (2, gdim).

    The box has an end where the body goes on beside the footing. It is infinite along the normal,
    and where the footing covers the body.
    """
    points, comm, normal = surface.points, surface.points.comm, np.abs(surface.normal)
    x, half, chosen = points["x"], points["l"], surface._sizes() > 0
    ends = np.array(
        [
            (x - half)[chosen].min(axis=0, initial=np.inf),
            -(x + half)[chosen].max(axis=0, initial=-np.inf),
        ]
    )
    comm.Allreduce(MPI.IN_PLACE, ends, op=MPI.MIN)
    low, high = ends[0], -ends[1]
    level = ((x > low) & (x < high) | (normal == 0)).all(axis=1)[:, None]
    # points that touch the edge, to rounding
    below, above = (x < low) & (x + 1.1 * half > low), (x > high) & (x - 1.1 * half < high)
    goes_on = np.array([(side & level).any(axis=0) for side in (below, above)])
    comm.Allreduce(MPI.IN_PLACE, goes_on, op=MPI.LOR)
    return np.where(goes_on & (normal == 0), [low, high], [[-np.inf], [np.inf]])


def _have_left(faces: Surface) -> list[Expr]:
    """Conditions for points whose faces have left the box of a footing, one per edge."""
    x, within = faces.points.x, faces.within
    if within is None:
        return []
    ends = [(k, side) for k in range(faces.points.gdim) for side in (0, 1)]
    return [
        (ufl.gt if side else ufl.lt)(x[k], own_constant(faces.points.grid, within[side, k]))
        for k, side in ends
        if np.isfinite(within[side, k])
    ]


def _largest_cell(points: MaterialPoints) -> float:
    h = cell_size(points.grid)
    sizes = h.x.array if isinstance(h, fem.Function) else np.array([h.value])
    return points.comm.allreduce(float(sizes.max(initial=0.0)), op=MPI.MAX)
