"""The nonlinear system of an arc-length step: equilibrium, and one equation for the load factor."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from dolfinx import fem
from dolfinx.la import InsertMode
from dolfinx.mesh import Mesh
from mpi4py import MPI
from petsc4py import PETSc
from ufl.algorithms import expand_derivatives, extract_coefficients
from ufl.algorithms.analysis import extract_constants
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.algorithms.apply_derivatives import apply_derivatives

from dolfinmpm._platform.errors import FormError, ParameterError
from dolfinmpm.assembly.evaluation import PointEvaluator
from dolfinmpm.assembly.gridterms import OrdinaryAssembler
from dolfinmpm.basis.space import Space
from dolfinmpm.body.points import GHOST_FACETS, MaterialPoints
from dolfinmpm.cut.active import ghost_facets
from dolfinmpm.forms.splitting import split
from dolfinmpm.solve.linesearch import name_of
from dolfinmpm.solve.newton import NewtonSystem

__all__ = ["BorderedSystem", "Constraint", "LoadFactor"]

Array = npt.NDArray[np.float64]

# How well the length of a step is met: it chooses the next state, it is no physics.
_LENGTH_TOLERANCE = 1e-6


class _VectorForm:
    """A form linear in the test function, assembled beside the system's own."""

    def __init__(self, form: ufl.Form, spaces: Sequence[Space], points: MaterialPoints):
        parts = split(form, spaces, points)
        if any(part is not None for part in parts.ordinary.internal):
            raise FormError(
                "the load factor multiplies a term over cells or facets of the grid that contains "
                "the increment; integrate it over the points instead"
            )
        self.evaluator = PointEvaluator(parts.points, spaces, points)
        self.ordinary = OrdinaryAssembler(parts.ordinary, spaces) if parts.has_ordinary else None
        self.varies = parts.points.internal is not None


class LoadFactor:
    """The load factor λ and the constants that it multiplies.

    Args:
        form: Weak form that contains the constants.
        grid: Background grid.
        constants: DOLFINx constants; their present values are the load at λ = 1.
        factor: λ at first.

    Raises:
        ParameterError: There is no constant, one is not what it may be, or all are zero.
        FormError: The form does not contain them.
    """

    def __init__(
        self, form: ufl.Form, grid: Mesh, constants: Sequence[fem.Constant], factor: float
    ):
        if not constants or not all(isinstance(c, fem.Constant) for c in constants):
            raise ParameterError(
                f"load = {constants!r} must be one or several dolfinx.fem.Constant of the form"
            )
        if not math.isfinite(factor):
            raise ParameterError(f"factor = {factor} must be finite")
        _check_load(form, constants)
        self.constants = list(constants)
        self._reference = [np.array(c.value, float) for c in constants]
        if not any(np.any(r) for r in self._reference):
            raise ParameterError(
                "the load's constants are all zero; set them to the load at factor 1 before"
            )
        self._factor = fem.Constant(grid, np.float64(factor))
        self.derivative = self._derive(form, grid)

    def _derive(self, form: ufl.Form, grid) -> ufl.Form:
        """∂(form)/∂λ, where the constants are λ times what they are now."""
        factor = ufl.variable(self._factor)
        scaled = {
            c: factor * fem.Constant(grid, r) for c, r in zip(self.constants, self._reference)
        }
        kept = []
        for integral in expand_derivatives(
            ufl.replace(expand_derivatives(form), scaled)
        ).integrals():
            lowered = apply_algebra_lowering(ufl.diff(integral.integrand(), factor))
            slope = apply_derivatives(lowered)
            if ufl.algorithms.extract_arguments(slope):
                kept.append(integral.reconstruct(slope))
        return ufl.Form(kept)

    @property
    def value(self) -> float:
        """λ now."""
        return float(self._factor.value)

    def describe(self) -> str:
        """The load at λ = 1, for messages."""
        values = [", ".join(f"{value:.9g}" for value in r.flat) for r in self._reference]
        return " and ".join(f"({value})" for value in values)

    def set(self, factor: float) -> None:
        """Set λ, and with it the constants."""
        self._factor.value = factor
        for constant, reference in zip(self.constants, self._reference):
            constant.value = factor * reference


def _check_load(form: ufl.Form, constants: Sequence[fem.Constant]) -> None:
    integrands = [integral.integrand() for integral in expand_derivatives(form).integrals()]
    found = {c for i in integrands for c in extract_constants(i)}
    missing = [k for k, constant in enumerate(constants) if constant not in found]
    if missing:
        raise FormError(f"constant {missing[0]} of the load is in no term of the form")
    for coefficient in {c for i in integrands for c in extract_coefficients(i)}:
        operand = getattr(coefficient, "operand", None)
        if operand is not None and any(c in constants for c in extract_constants(operand)):
            raise FormError(
                f"the law '{coefficient}' takes a constant of the load as its argument; the load "
                "factor can only multiply terms outside laws"
            )


class Constraint:
    """The equation that closes an arc-length step.

    Spherical: ⟨Δu, Δu⟩ + ψ² Δλ² = ℓ², cylindrical: the same with ψ = 0 (Crisfield 1981,
    doi 10.1016/0045-7949(81)90108-5), where ⟨a, b⟩ = Σ V0 a_p·b_p / Σ V0 is a mean over
    the material points: nodes of cut cells that next to nothing holds have no part in
    it, and it does not change with the grid. ψ is ‖du/dλ‖ in the first step. A linear
    form c(v) instead closes it by c(Δu) = ℓ: displacement control.

    Args:
        control: "spherical", "cylindrical" or a form over the points, linear in the test
            function alone.
        u: Increment.
        v: Test function.
        points: Material points.

    Raises:
        ParameterError: The control is not known.
        FormError: The form contains the increment or other than points.
    """

    def __init__(self, control: str | ufl.Form, u, v, points: MaterialPoints):
        self.linear = isinstance(control, ufl.Form)
        if not self.linear and control not in ("spherical", "cylindrical"):
            raise ParameterError(
                f'control = {control!r} must be "spherical", "cylindrical" or a form linear in the '
                "test function, such as surface.mean((0, 1), v)"
            )
        self.kind = "displacement" if self.linear else control
        volume = points.comm.allreduce(float(points["V0"].sum()), op=MPI.SUM)
        weight = fem.Constant(points.grid, 1 / volume)
        self.form = control if self.linear else weight * ufl.inner(u, v) * points.dX
        self.weight = 1 / volume
        self.psi: float | None = None if control == "spherical" else 0.0


class BorderedSystem(NewtonSystem):
    """Equilibrium r(u, λ) = 0 with one more equation g(u, λ) = 0 for the load factor.

    Every iteration solves for two right-hand sides with one factorisation,
    K b = −r and K a = −∂r/∂λ, and takes δu = b + δλ a with the δλ that fulfils the
    linearised g: Newton's method for both equations together (Batoz & Dhatt 1979,
    doi 10.1002/nme.1620140811), of second order in the arc's length too.

    Args:
        arguments: Those of `NewtonSystem`.
        load: The load factor.
        constraint: The equation for it.
        trail: Field of the points with their increment in the last step (m).

    Attributes:
        length: Length of the step (m), set before `solve`.
        last_change: Change of the factor in the last step, or None before the first.
        first: What the first step is to add to the factor, where `length` is not set.
    """

    def __init__(self, arguments: Sequence[Any], load: LoadFactor, constraint: Constraint, trail):
        spaces, points = arguments[1], arguments[2]
        super().__init__(*arguments)
        self._load, self._constraint, self._trail = load, constraint, trail
        self._slope = _VectorForm(load.derivative, spaces, points)
        self._control = _VectorForm(constraint.form, spaces, points)
        if constraint.linear and (self._control.varies or self._control.ordinary is not None):
            raise FormError(
                "a control must be a form over the points that contains the test function, and "
                "neither the increment nor terms over cells or facets"
            )
        self.length: float | None = None
        self.last_change: float | None = None
        self.first = 0.0
        if self._slope.ordinary is not None:
            self._assemblers.append(self._slope.ordinary)
            self._moving |= self._slope.ordinary.moving
            if GHOST_FACETS in self._moving and self._facets is None:
                self._facets = ghost_facets(points.grid)

    def _set_numbering(self) -> None:
        renewed = self._numbering is not self.basis.nodes
        super()._set_numbering()
        if renewed:
            self._beside = self._numbering.vector(self.components)

    def activate(self, share: float) -> None:
        """See `NewtonSystem.activate`."""
        super().activate(share)
        for part in (self._slope, self._control):
            part.evaluator.start_step(self._stencils)

    def _assemble(self, part: _VectorForm) -> Array:
        """A vector at the present increments, its owned unknowns. Collective."""
        out = self._beside.array.reshape(-1, self.components)
        out[:] = 0.0
        evaluator = part.evaluator
        evaluator.update_constants()
        if part.varies:
            evaluator.interpolate(self._u)
            if not evaluator.add_internal(out):
                out[:] = math.nan
        evaluator.add_external(out)
        if part.ordinary is not None:
            self._add_ordinary(part.ordinary.add_external, out)
        if self.comm.size > 1:
            self._beside.scatter_reverse(InsertMode.add)
        nodes = self.unknowns.owned_nodes
        return out[nodes][~self.unknowns.fixed[nodes]]

    def _dot(self, a: Array, b: Array) -> float:
        return self.comm.allreduce(float(a @ b), op=MPI.SUM)

    def _solve_for(self, right: Array) -> PETSc.Vec:
        """Solve K y = −right with the tangent that was assembled last. Collective."""
        b, y = self._x.duplicate(), self._x.duplicate()
        b.getArray()[:] = -right
        ksp = self._snes.getKSP()
        ksp.setOperators(self._matrix.petsc)
        ksp.solve(b, y)
        return y

    def set_factor(self, factor: float) -> None:
        """Set λ, and the forces that do not depend on the increments with it. Collective."""
        self._load.set(factor)
        self.evaluator.update_constants()
        self._assemble_external()

    def solve(self) -> str | None:
        """Find increments and load factor; returns why it did not, or None. Collective."""
        self.residuals = []
        self.iterations = 0
        self._reference = self._first = self._motion = 0.0
        if self.unknowns.total == 0:
            return "no unknown is free"
        try:
            return self._predict_factor() or self._correct()
        except PETSc.Error as error:
            return self._singular(error)

    def _predict_factor(self) -> str | None:
        """Along the tangent of the path, on the side that the last step came to. Collective."""
        constraint, x = self._constraint, self._x
        self._start = self._load.value
        self.tangent_matrix()
        q = self._assemble(self._slope)
        a = self._solve_for(q)
        self.iterations += 1
        rate = a.getArray(readonly=True)
        self._spread(rate)
        along = self._dot(self._assemble(self._control), rate)
        if not math.isfinite(along) or along == 0.0:
            return "the tangent is singular, or the load does not move what controls the step"
        if constraint.linear:
            assert self.length is not None
            change = self.length / along
        else:
            if constraint.psi is None:
                constraint.psi = math.sqrt(along)
            speed = math.sqrt(along + constraint.psi**2)
            if self.length is None:
                self.length = abs(self.first) * speed
            change = math.copysign(self.length / speed, self._side())
        self._motion = abs(change) * math.sqrt(self._dot(q, q))
        x.getArray()[:] = change * rate
        self._load.set(self._start + change)
        return None

    def _side(self) -> float:
        """Sign of the predictor: no turning back on the last step's increment. Collective."""
        if self.last_change is None:
            return self.first
        moved = self._trail.array
        rate = self.evaluator.value[:, : moved.shape[1]]
        V0 = self._points["V0"]
        forward = self._constraint.weight * self._dot(V0, np.sum(moved * rate, axis=1))
        assert self._constraint.psi is not None
        return forward + self._constraint.psi**2 * self.last_change

    def _gap(self, x: Array) -> tuple[float, npt.NDArray[Any], float]:
        """The constraint at the present increments, over its size, and its derivatives."""
        constraint = self._constraint
        assert self.length is not None
        w = self._assemble(self._control)
        if constraint.linear:
            return self._dot(w, x) / self.length - 1, w / self.length, 0.0
        change, square = self._load.value - self._start, self.length**2
        assert constraint.psi is not None
        value = (self._dot(w, x) + constraint.psi**2 * change**2) / square - 1
        return value, 2 * w / square, 2 * constraint.psi**2 * change / square

    def _correct(self) -> str | None:
        x, f = self._x, self._x.duplicate()
        while True:
            self.set_factor(self._load.value)
            self._residual(None, x, f)
            r = f.getArray(readonly=True)
            norm = math.sqrt(self._dot(r, r))
            gap, by_u, by_factor = self._gap(x.getArray(readonly=True))
            # the force out of balance after a predictor is no load to measure against: hence 1
            reason = self._test(None, len(self.residuals) + 1, (0.0, 0.0, norm))
            if reason == PETSc.SNES.ConvergedReason.CONVERGED_FNORM_RELATIVE:
                if abs(gap) <= _LENGTH_TOLERANCE:
                    return None
                if len(self.residuals) > self._max_iterations:
                    return "the length of the step was not met"
            elif reason != PETSc.SNES.ConvergedReason.ITERATING:
                return name_of(reason)
            self._jacobian(None, None, None, None)
            b = self._solve_for(r).getArray(readonly=True)
            a = self._solve_for(self._assemble(self._slope)).getArray(readonly=True)
            self.iterations += 1
            slope = self._dot(by_u, a) + by_factor
            change = -(gap + self._dot(by_u, b)) / slope if slope else math.nan
            if not math.isfinite(change):
                return "the bordered system is singular"
            x.getArray()[:] += b + change * a
            self._load.set(self._load.value + change)
