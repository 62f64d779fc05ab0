"""A conforming finite-element method to check the material point method against.

Plane strain on rectangles, or on mapped ones, of eight-node quadrilaterals with 2×2
Gauss points: reduced integration, which does not lock, and whose one hourglass mode
cannot pass from element to element. The grid is never reset: large strain is

    ΔF = F F_n⁻¹,   b = ΔF b_n ΔFᵀ,   ∫ τ : ∇v dV₀ with ∇ on the present configuration,

small strain ε = ε_n + Δε. Nothing but the law's kernel, by `Law.respond`, is shared with
the package: shapes, kinematics, tangent, assembly, solver and stepping are written anew.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from petsc4py import PETSc
from reference.conforming_mesh import Mesh

from dolfinmpm._platform.errors import ConvergenceError, StateError
from dolfinmpm.materials import Law

Array = npt.NDArray[np.float64]


@dataclass
class State:
    """Where the body is at the end of a step.

    Attributes:
        u: Displacements (m), shape (nodes, 2).
        F: Deformation gradients at the Gauss points, shape (points, 2, 2).
        elastic: Elastic strain in the plane: b if strains are large, else ε; shape
            (points, 2, 2).
        across: The same, out of the plane, shape (points,).
        internal: Internal variables of the law, shape (points, variables).
        stress: Kirchhoff (large strain) or Cauchy stress (Pa), shape (points, 3, 3).
    """

    u: Array
    F: Array
    elastic: Array
    across: Array
    internal: Array
    stress: Array


class Body:
    """A mesh of one law, with its state, in plane strain.

    Args:
        mesh: Mesh.
        law: Constitutive law.
        strain: "large" or "small".
        fixed: Which displacements are prescribed, shape (nodes, 2).

    Attributes:
        state: State at the end of the last step.
        iterations: Newton iterations of each step so far.
        residuals: Relative residuals of the last solve.
        halvings: How often a step was halved.
    """

    def __init__(self, mesh: Mesh, law: Law, strain: str, fixed: npt.NDArray[np.bool_]):
        assert strain in ("large", "small")
        self.mesh, self.law, self.large = mesh, law, strain == "large"
        self.fixed = fixed.ravel()
        n = len(mesh.weights)
        eye = np.tile(np.eye(2), (n, 1, 1))
        first = law.first_internal(law.parameter_array())
        internal = np.broadcast_to(first, (n, first.shape[1])).copy()
        elastic = eye.copy() if self.large else np.zeros_like(eye)
        across = np.full(n, 1.0 if self.large else 0.0)
        self.state = State(np.zeros_like(mesh.x), eye, elastic, across, internal, np.empty(0))
        self.state = self._evaluate(self.state.u)[0]
        self.iterations: list[int] = []
        self.residuals: list[float] = []
        self.halvings = 0
        self._last = np.zeros(0)
        self._pushed: Array | None = None
        self._increment = np.zeros(mesh.x.size)  # of the displacements in the last whole step
        self._prepare()

    def _prepare(self) -> None:
        """Where the entries of the element matrices go in the rows of the free unknowns."""
        unknowns = (2 * self.mesh.cells[:, :, None] + np.arange(2)).reshape(-1, 16)
        self.unknowns = unknowns
        number = np.full(len(self.fixed), -1)
        number[~self.fixed] = np.arange((~self.fixed).sum())
        size = int((~self.fixed).sum())
        row = np.repeat(number[unknowns], 16, axis=1).ravel()
        column = np.tile(number[unknowns], (1, 16)).ravel()
        self._inner = (row >= 0) & (column >= 0)
        keys, self._slot = np.unique(
            row[self._inner] * size + column[self._inner], return_inverse=True
        )
        starts = np.searchsorted(keys, np.arange(size + 1) * size)
        index = PETSc.IntType
        self._pattern = starts.astype(index), (keys % size).astype(index)
        self._size = size
        self._matrix = PETSc.Mat().createAIJ(
            (size, size), csr=(*self._pattern, np.zeros(len(keys))), comm=PETSc.COMM_SELF
        )
        self._solver = PETSc.KSP().create(PETSc.COMM_SELF)
        self._solver.setOperators(self._matrix)
        self._solver.setType("preonly")
        self._solver.getPC().setType("lu")
        self._solver.getPC().setFactorSolverType("mumps")

    def _evaluate(self, u: Array, tangent: bool = False):
        """State at displacements u; internal forces of the elements; their matrices or None.

        Raises:
            StateError: An element is turned over, or the law finds no stress.
        """
        mesh, old = self.mesh, self.state
        at_nodes = np.repeat(u[mesh.cells], 4, axis=0)
        grad = np.swapaxes(at_nodes, 1, 2) @ mesh.gradients
        F = grad + np.eye(2)
        if self.large:
            dF = F @ np.linalg.inv(old.F)
            if not (np.linalg.det(dF) > 0).all():
                raise StateError("an element is turned over")
            trial = dF @ old.elastic @ np.swapaxes(dF, 1, 2)
            stretch, Q = np.linalg.eigh(trial)
            strain = np.log(np.concatenate([stretch, old.across[:, None]], axis=1)) / 2
            gradients = mesh.gradients @ np.linalg.inv(F)
        else:
            change = F - old.F
            trial = old.elastic + (change + np.swapaxes(change, 1, 2)) / 2
            strain, Q = np.linalg.eigh(trial)
            strain = np.concatenate([strain, old.across[:, None]], axis=1)
            gradients = mesh.gradients
        answer = self.law.respond(strain, internal=old.internal)
        tau, D = answer.stress, answer.tangent
        left = np.exp(2 * answer.strain) if self.large else answer.strain
        turned = np.swapaxes(Q, 1, 2)
        stress = np.zeros((len(Q), 3, 3))
        stress[:, :2, :2] = (Q * tau[:, None, :2]) @ turned
        stress[:, 2, 2] = tau[:, 2]
        elastic = (Q * left[:, None, :2]) @ turned
        state = State(u, F, elastic, left[:, 2], answer.internal, stress)

        # from nodal displacements to gradients in principal axes, rows 11, 12, 21, 22
        G = gradients @ Q
        B = np.einsum("nia,nkb->nabki", Q, G).reshape(-1, 4, 16)
        weights = mesh.weights
        forces = weights[:, None] * (B[:, 0] * tau[:, :1] + B[:, 3] * tau[:, 1:2])
        forces = forces.reshape(-1, 4, 16).sum(axis=1)
        if not tangent:
            return state, forces, None
        C = np.zeros((len(Q), 4, 4))
        C[:, 0, 0], C[:, 0, 3] = D[:, 0, 0], D[:, 0, 1]
        C[:, 3, 0], C[:, 3, 3] = D[:, 1, 0], D[:, 1, 1]
        # dτ₁₂ = (τ₁ − τ₂)/(b₁ − b₂) (b₂ l₁₂ + b₁ l₂₁), with l the gradient of the change
        gap = strain[:, 0] - strain[:, 1]
        near = np.abs(gap) < 1e-7
        secant = np.where(near, 1.0, tau[:, 0] - tau[:, 1]) / np.where(near, 1.0, gap)
        limit = (D[:, 0, 0] - D[:, 0, 1] - D[:, 1, 0] + D[:, 1, 1]) / 2
        secant = np.where(near, limit, secant)
        # gap/(b₁ − b₂) times b₂ and b₁
        safe = np.where(near, 1.0, gap)
        second = np.where(near, 0.5, safe / np.expm1(2 * safe)) if self.large else 0.5
        first = np.where(near, 0.5, -safe / np.expm1(-2 * safe)) if self.large else 0.5
        C[:, 1, 1] = C[:, 2, 1] = secant * second
        C[:, 1, 2] = C[:, 2, 2] = secant * first
        if self.large:  # the gradient of the test function changes too
            C[:, 0, 0] -= tau[:, 0]
            C[:, 3, 3] -= tau[:, 1]
            C[:, 1, 2] -= tau[:, 0]
            C[:, 2, 1] -= tau[:, 1]
        K = np.swapaxes(B, 1, 2) @ (weights[:, None, None] * C) @ B
        return state, forces, K.reshape(-1, 4, 16, 16).sum(axis=1)

    def _gather(self, elements: Array) -> Array:
        return np.bincount(self.unknowns.ravel(), elements.ravel(), minlength=len(self.fixed))

    def _solve(self, external, prescribed, follower, tolerance: float, most: int, guess: Array):
        u = self.state.u.ravel() + guess
        free = ~self.fixed
        self.residuals = []
        for _ in range(most):
            state, forces, K = self._evaluate(u.reshape(-1, 2), tangent=True)
            inner = self._gather(forces)
            load = external
            if follower is not None:
                present = (self.mesh.x.ravel() + u)[self.unknowns]
                load = external + self._gather(np.einsum("eij,ej->ei", follower, present))
                K -= follower
            residual = load - inner
            size = max(np.linalg.norm(load), np.linalg.norm(forces))
            move = np.where(self.fixed, prescribed - u, 0.0)
            norm = np.linalg.norm(residual[free]) / size if size > 0.0 else 0.0
            self.residuals.append(float(norm))
            if not move.any() and norm <= tolerance:
                self.state = state
                self.iterations.append(len(self.residuals) - 1)
                return inner
            if not np.isfinite(norm) or norm > 1e6:
                break
            residual -= self._gather(np.einsum("eij,ej->ei", K, move[self.unknowns]))
            entries = np.bincount(self._slot, K.ravel()[self._inner])
            self._matrix.setValuesCSR(*self._pattern, entries)
            self._matrix.assemble()
            right = PETSc.Vec().createWithArray(residual[free], comm=PETSc.COMM_SELF)
            answer = right.duplicate()
            self._solver.solve(right, answer)
            move[free] = answer.array_r
            u += move
        raise ConvergenceError(f"no convergence: relative residuals {self.residuals}")

    def step(
        self, external: Array, prescribed: Array | None = None, follower: Array | None = None, *,
        tolerance: float = 1e-9, most: int = 25, halvings: int = 8,
    ) -> Array:  # fmt: skip
        """Go on to equilibrium under new loads, in halves if it fails in one piece.

        Args:
            external: Nodal forces (N/m), shape (nodes, 2).
            prescribed: Displacements (m), of which those that are fixed count; 0 by default.
            follower: Element matrices of pressure that stays normal to its edges, as
                `Mesh.follower` gives them for 1 Pa.
            tolerance: Bound on the residual by the external and the internal forces.
            most: Newton iterations.
            halvings: How often the step may be halved.

        Returns:
            Internal forces of the nodes (N/m), shape (nodes, 2): reactions where nodes
            are fixed.
        """
        target = external.ravel(), np.zeros(external.size)
        if prescribed is not None:
            target = external.ravel(), np.ascontiguousarray(prescribed, float).ravel()
        last = self._last if len(self._last) else np.zeros(external.size)
        start = last, np.where(self.fixed, self.state.u.ravel(), 0.0)
        before = self._pushed
        done, piece, level = 0.0, 1.0, 0
        inner = np.zeros(external.size)
        while done < 1.0:
            t = done + piece
            loads = [a + t * (b - a) if t < 1.0 else b for a, b in zip(start, target)]
            push = None
            if follower is not None:
                push = follower * t if before is None else before + t * (follower - before)
            # steps are equal as a rule, and the last one's increment leads past the elastic
            # answer to new loads, from which iterations on perfect plasticity may not return
            guess = piece * self._increment
            began = self.state.u
            try:
                inner = self._solve(*loads, push, tolerance, most, guess)
                self._increment = (self.state.u - began).ravel() / piece
            except (ConvergenceError, StateError):
                if guess.any():
                    self._increment = np.zeros_like(guess)
                    continue
                level += 1
                self.halvings += 1
                if level > halvings:
                    raise
                piece /= 2
                continue
            done = t
        self._last, self._pushed = target[0].copy(), follower
        return inner.reshape(-1, 2)
