"""Condition numbers and critical time steps of matrices."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI
from petsc4py import PETSc

from dolfinmpm._platform.argumentchecks import check_kind, coordinates, truth
from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.errors import ParameterError, call_together
from dolfinmpm.cut.activation import Activation
from dolfinmpm.cut.unknowns import Unknowns

__all__ = ["condition_number", "critical_step", "near_kernel", "near_kernel_within", "rigid_modes"]

Array = npt.NDArray[np.float64]

# Up to this number of unknowns, all eigenvalues are computed. Beyond, Lanczos iterations find the
# smallest and the largest eigenvalue.
DENSE_LIMIT = 1500


def _definite_spectrum(A: Array) -> Array:
    """Eigenvalues of a positive definite matrix, also small ones with all their digits.

    The Cholesky factor after scaling to a unit diagonal keeps entries of different sizes separate.
    A direct eigenvalue solver would lose small entries by rounding.
    """
    from scipy import linalg

    if np.any(np.diag(A) <= 0):
        return np.maximum(linalg.eigvalsh(A), 0.0)
    scale = np.sqrt(np.diag(A))
    try:
        factor = linalg.cholesky(A / np.outer(scale, scale), lower=True)
    except linalg.LinAlgError:
        return np.maximum(linalg.eigvalsh(A), 0.0)
    return np.sort(_singular_values(factor.T * scale) ** 2)


def _singular_values(A: Array) -> Array:
    """Singular values of a well-conditioned matrix with scaled columns, each with all its digits.

    LAPACK's preconditioned one-sided Jacobi rotations find them (Drmač & Veselić 2008, doi
    10.1137/050639193). An SVD by bidiagonalisation loses values below 1e-16 of the largest.
    """
    # joba = 0: accurate whatever the scales of the columns are; jobu, jobv = 3: no vectors
    from scipy import linalg

    values, _, _, work, _, info = linalg.lapack.dgejsv(A, joba=0, jobu=3, jobv=3)
    if info:
        raise linalg.LinAlgError(f"LAPACK's dgejsv found no singular values, info = {info}")
    return values * (work[0] / work[1])


def _dense(matrix: PETSc.Mat) -> Array:
    """All entries of a matrix, on every rank. Collective."""
    from scipy import sparse

    start, indices, values = matrix.getValuesCSR()
    rows = sparse.csr_matrix((values, indices, start), (start.size - 1, matrix.getSize()[1]))
    return np.concatenate(matrix.comm.tompi4py().allgather(rows.toarray()))


def _vector(matrix: PETSc.Mat, values: Array) -> PETSc.Vec:
    """A vector of a matrix, with values."""
    made = matrix.createVecRight()
    made.getArray()[:] = values
    return made


def _step_of(largest: float) -> float:
    """Step of the largest eigenvalue (1/s²), nan if this is not found."""
    return math.inf if largest <= 0 else 2 / math.sqrt(largest)


def _check_matrix(what: str, given: Any) -> None:
    """Raise ParameterError unless an argument is a square PETSc matrix."""
    check_kind(what, given, PETSc.Mat, "give problem.stiffness(), or another matrix of PETSc")
    if given.getSize()[0] != given.getSize()[1]:
        raise ParameterError(f"{what} is of {given.getSize()} rows and columns and must be square")


def _kernel_of(matrix: PETSc.Mat, kernel: Any) -> Array | None:
    """The checked vectors of the kernel. Collective."""
    comm, rows = matrix.comm.tompi4py(), matrix.getLocalSize()[0]

    def checked() -> Array | None:
        if kernel is None:
            return None
        given = coordinates("kernel", kernel)
        if given.ndim != 2 or len(given) != rows:
            raise ParameterError(
                f"kernel has the shape {given.shape} and must have the rows of this rank, "
                f"({rows}, n): give what study.rigid_modes returns"
            )
        return given

    found = call_together(comm, checked)
    counts = comm.allgather(0 if found is None else found.shape[1])
    if len(set(counts)) > 1:
        raise ParameterError(
            f"kernel has {counts} vectors on the ranks, and must have as many on all of them"
        )
    return found


@collective(local=("kernel",))
def condition_number(
    matrix: PETSc.Mat, *, kernel: Array | None = None, scaled: bool = False
) -> float:
    """Ratio of the largest to the smallest eigenvalue of a symmetric matrix. Collective.

    Args:
        matrix: Symmetric, positive semi-definite.
        kernel: Vectors to leave out, such as rigid modes, shape (owned rows, n).
        scaled: Whether to scale rows and columns first, so that the diagonal is 1. Then it is the
            condition number that iterations with Jacobi's preconditioner have.

    Returns:
        The ratio, or inf if the smallest eigenvalue is zero or negative.

    Raises:
        ParameterError: The argument is no square PETSc matrix with rows, or the kernel has other
            rows.

    >>> import dolfinmpm as mpm
    >>> from petsc4py import PETSc
    >>> K = PETSc.Mat().createDense((2, 2), array=[[2.0, 0.0], [0.0, 50.0]])
    >>> K.assemble()
    >>> round(mpm.study.condition_number(K), 9)
    25.0
    """
    from scipy import linalg

    _check_matrix("matrix", matrix)
    kernel = _kernel_of(matrix, kernel)
    n = matrix.getSize()[0]
    if n == 0:
        raise ParameterError("a matrix without rows has no condition number; activate points first")
    if truth("scaled", scaled):
        matrix, kernel = _with_unit_diagonal(matrix, kernel)
    if n > DENSE_LIMIT:
        low, high = _ends(matrix, kernel)
    elif kernel is None or kernel.shape[1] == 0:
        A = _dense(matrix)
        values = _definite_spectrum(0.5 * (A + A.T))
        low, high = values[0], values[-1]
    else:
        modes = np.concatenate(matrix.comm.tompi4py().allgather(kernel))
        basis = linalg.null_space(modes.T)
        A = basis.T @ _dense(matrix) @ basis
        values = linalg.eigvalsh(0.5 * (A + A.T))
        low, high = values[0], values[-1]
    return float(high / low) if low > 0 else math.inf


def _with_unit_diagonal(matrix: PETSc.Mat, kernel: Array | None) -> tuple[PETSc.Mat, Array | None]:
    """D^-½ A D^-½ with the diagonal D of A, and its kernel D^½ z. Collective.

    Raises:
        ParameterError: A diagonal entry is not positive.
    """
    diagonal = matrix.getDiagonal()
    _, least = diagonal.min()
    if not least > 0:
        raise ParameterError(
            f"the matrix has {least:g} on its diagonal, and cannot be scaled to a diagonal of 1: "
            "leave out scaled=True"
        )
    root = np.sqrt(diagonal.array_r)
    diagonal.array[:] = 1.0 / root
    matrix = matrix.copy()
    matrix.diagonalScale(diagonal, diagonal)
    return matrix, None if kernel is None else root[:, None] * kernel


def _ends(matrix: PETSc.Mat, kernel: Array | None) -> tuple[float, float]:
    """Smallest and largest eigenvalue. Collective."""
    space = [_vector(matrix, mode) for mode in (() if kernel is None else kernel.T)]
    high = _eigenvalue([matrix], space)
    # slightly below zero, so that a kernel does not make the shifted matrix singular
    return _eigenvalue([matrix], space, -1e-12 * high), high


def _eigenvalue(
    operators: list[PETSc.Mat], space: list[PETSc.Vec], target: float | None = None
) -> float:
    """The largest eigenvalue or that at a target, or nan, by Lanczos iterations; SLEPc. Collective.

    Args:
        operators: K, or K and M of K x = λ M x.
        space: Vectors that are left out.
        target: Value to which the eigenvalue is nearest.
    """
    from slepc4py import SLEPc

    eps = SLEPc.EPS().create(operators[0].comm)
    eps.setOperators(*operators)
    kinds, which = SLEPc.EPS.ProblemType, SLEPc.EPS.Which
    eps.setProblemType(kinds.HEP if len(operators) == 1 else kinds.GHEP)
    eps.setDimensions(1)
    eps.setTolerances(1e-8, 1000)
    eps.setDeflationSpace(space)
    eps.setWhichEigenpairs(which.LARGEST_REAL if target is None else which.TARGET_REAL)
    st = eps.getST()
    if target is not None:
        eps.setTarget(target)
        st.setType("sinvert")
    if target is not None or len(operators) > 1:
        st.getKSP().setType("preonly")
        st.getKSP().getPC().setType("lu")
        st.getKSP().getPC().setFactorSolverType("mumps")
    eps.solve()
    return eps.getEigenvalue(0).real if eps.getConverged() else math.nan


@collective
def critical_step(stiffness: PETSc.Mat, mass: PETSc.Mat, *, lumped: bool = False) -> float:
    """Largest stable step of central differences, 2/√λ_max of K x = λ M x (s). Collective.

    Args:
        stiffness: K, symmetric.
        mass: M, symmetric and positive definite.
        lumped: Whether M is replaced by its row sums.

    Returns:
        The step, or 0 if M is singular.

    Raises:
        ParameterError: The arguments are no square PETSc matrices of one size.

    A mass of 1 kg at a spring of 100 N/m, 2/ω:

    >>> import dolfinmpm as mpm
    >>> from petsc4py import PETSc
    >>> K = PETSc.Mat().createDense((1, 1), array=[[100.0]])
    >>> M = PETSc.Mat().createDense((1, 1), array=[[1.0]])
    >>> K.assemble()
    >>> M.assemble()
    >>> round(mpm.study.critical_step(K, M), 9)
    0.2
    """
    from scipy import linalg

    _check_matrix("stiffness", stiffness)
    _check_matrix("mass", mass)
    if stiffness.getSize() != mass.getSize():
        raise ParameterError(
            f"stiffness is of {stiffness.getSize()[0]} unknowns and mass of {mass.getSize()[0]}: "
            "give matrices of one problem"
        )
    n = stiffness.getSize()[0]
    if n > DENSE_LIMIT:
        return _critical_step_of_many(stiffness, mass, lumped)
    K, M = _dense(stiffness), _dense(mass)
    if lumped:
        M = np.diag(M.sum(axis=1))
    # functions without points inside have neither mass nor stiffness; they are left out
    used = (np.diag(M) > 0) | (np.diag(K) > 0)
    K, M = K[np.ix_(used, used)], M[np.ix_(used, used)]
    if np.any(np.diag(M) <= 0):
        return 0.0
    n = len(M)
    # scaling keeps digits at nodes of small mass, because only their ratio to K counts
    scale = 1 / np.sqrt(np.diag(M))
    K, M = (0.5 * np.outer(scale, scale) * (A + A.T) for A in (K, M))
    try:
        return _step_of(linalg.eigh(K, M, eigvals_only=True, subset_by_index=(n - 1, n - 1))[0])
    except linalg.LinAlgError:
        return 0.0


def _critical_step_of_many(stiffness: PETSc.Mat, mass: PETSc.Mat, lumped: bool) -> float:
    if lumped:
        sums = mass.createVecLeft()
        ones = mass.createVecRight()
        ones.set(1.0)
        mass.mult(ones, sums)
        # PETSc's diagonal matrices lose their values when several ranks convert them
        mass = PETSc.Mat().createAIJ(mass.getSizes(), nnz=1, comm=mass.comm)
        mass.setDiagonal(sums)
    return _step_of(_eigenvalue([stiffness, mass], []))


def _motions(comm: MPI.Comm, x: Array) -> list[Array]:
    """Orthonormal rigid motions of nodes at positions, shape (nodes here, d) each. Collective.

    PETSc makes such modes, too. But its sums depend on the position of vectors in memory. So modes
    and multigrid hierarchies would differ by rounding from run to run.
    """
    d = x.shape[1]
    # rotations about the mean position, so that translations do not dominate them
    x = x - comm.allreduce(x.sum(axis=0)) / comm.allreduce(len(x))
    modes = [np.tile(row, (len(x), 1)) for row in np.eye(d)]
    for i, j in itertools.combinations(range(d), 2):
        mode = np.zeros_like(x)
        mode[:, i], mode[:, j] = x[:, j], -x[:, i]
        modes.append(mode)
    for k, mode in enumerate(modes):
        for before in modes[:k]:
            mode -= comm.allreduce(float(np.vdot(before, mode))) * before
        # nodes on a line have no rotation about this line
        mode /= math.sqrt(comm.allreduce(float(np.vdot(mode, mode)))) or 1.0
    return modes


def _rigid(unknowns: Unknowns, x: Array) -> list[Array]:
    """Orthonormal rigid modes in the owned rows, for nodes with all components. Collective."""
    return [unknowns.shared_out(mode.ravel()) for mode in _motions(unknowns.comm, x)]


def near_kernel(here: Activation, matrix: PETSc.Mat) -> PETSc.NullSpace:
    """Rigid modes of unknowns in blocks, with prescribed ones, for multigrid. Collective.

    They are the modes of the independent nodes of C. C reproduces linear functions, so other nodes
    follow the modes.
    """
    unknowns, basis = here.unknowns, here.fields[0].basis
    nodes = unknowns.fields[0].owned_nodes
    x = basis.node_coordinates()[nodes, : basis.grid.geometry.dim]
    vectors = [_vector(matrix, mode) for mode in _rigid(unknowns, x)]
    return PETSc.NullSpace().create(vectors=vectors, comm=unknowns.comm)


def near_kernel_within(here: Activation, matrix: PETSc.Mat, rows: PETSc.IS) -> PETSc.NullSpace:
    """Rigid modes of the first of several fields, a displacement, without prescribed components.

    Args:
        here: The activation.
        matrix: The tangent of all fields.
        rows: Rows of the displacement.
    """
    unknowns, basis = here.unknowns, here.fields[0].basis
    field = unknowns.fields[0]
    nodes, modes = field.owned_nodes, list[PETSc.Vec]()
    x = basis.node_coordinates()[nodes, : basis.grid.geometry.dim]
    for mode in _motions(unknowns.comm, x):
        entries = np.zeros(unknowns.mine)
        entries[: field.size] = mode.ravel()[~field.fixed[nodes].ravel()]
        vector = _vector(matrix, unknowns.shared_out(entries))
        part = vector.getSubVector(rows)
        modes.append(part.copy())
        vector.restoreSubVector(rows, part)
    for k, one in enumerate(modes):
        for before in modes[:k]:
            one.axpy(-one.dot(before), before)
        one.normalize()
    return PETSc.NullSpace().create(vectors=modes, comm=unknowns.comm)


@collective
def rigid_modes(here: Activation) -> Array:
    """Translations and rotations in the unknowns of a single field, shape (owned unknowns, n).

    The modes are orthonormal, and exact for every basis that reproduces linear functions. There are
    no modes if conditions hold the body anywhere. Collective.

    Raises:
        ParameterError: The argument is no activation.

    A free body in two dimensions has three:

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=2000.0)
    >>> V = mpm.Space(grid, "gimp")
    >>> F = mpm.momentum(mpm.materials.Hencky(1e6, 0.3), points, V.increment, V.test)
    >>> problem = mpm.QuasiStatic(F, V.increment, points)
    >>> mpm.study.rigid_modes(problem.activate()).shape[1]
    3
    """
    check_kind("here", here, Activation, "give problem.activate()")
    unknowns, basis = here.unknowns, here.fields[0].basis
    field, d = unknowns.fields[0], basis.grid.geometry.dim
    nodes = field.owned_nodes
    other = bool(np.any(field.fixed[nodes])) or field.components != d or len(unknowns.fields) > 1
    if unknowns.comm.allreduce(other, op=MPI.LOR):
        return np.empty((unknowns.owned, 0))
    return np.stack(_rigid(unknowns, basis.node_coordinates()[nodes, :d]), axis=1)
