"""A UMAT at the points: an incremental law, whose state is the Cauchy stress."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import Tags
from dolfinmpm._platform.errors import ParameterError, StateError, call_together
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.forms.operators import KeptTangents
from dolfinmpm.grid.lattice import smallest_height
from dolfinmpm.kinematics.formulations import Jaumann, SmallStrain
from dolfinmpm.kinematics.strainformulation import Array, Rows, StrainFormulation
from dolfinmpm.kinematics.umatloop import kept_of_umat, umat_kernel
from dolfinmpm.materials.umat import UMAT
from dolfinmpm.materials.umatcall import DDSDDE, FAILURES
from dolfinmpm.materials.umatshim import OFFSETS

__all__ = ["ENERGIES", "Incremental"]

# fields of SSE, SPD and SCD
ENERGIES = ("elastic_energy", "plastic_dissipation", "creep_dissipation")
_FUNCTIONS = {"jaumann": Jaumann, "small": SmallStrain}
# size of the strain increment of the trial before the first step (-)
_TRIAL = 1e-6
# points that are asked at a time for a tangent: their arrays fit into the cache
_CHUNK = 4096
# shares of mean stress and deviator by which a stress is moved into the yield surface
_INSIDE, _LESS_DEVIATOR = 1e-6, 2e-6
# no values at the end of a step are asked for
_NOTHING = np.empty((0, 3, 3)), np.empty((0, 6)), np.empty((3, 0)), np.empty((0, 0))


class Incremental(StrainFormulation):
    """A UMAT with Jaumann's rate or small strain.

    The state is the field `stress`. Binding adds `total_strain` (STRAN with tensor shear strains:
    xx, yy, zz, xy, yz, zx), the energies per present volume `elastic_energy` (SSE),
    `plastic_dissipation` (SPD) and `creep_dissipation` (SCD) in J/m³, and the state variables.

    Args:
        law: The UMAT.
        points: Material points.
        strain: "jaumann" or "small".
        tags: Tags of the points with this law; None means all points.
    """

    multiplicative = False
    state = "total_strain"
    rest = (0.0,) * 6
    from_stress = True

    def __init__(self, law: UMAT, points: MaterialPoints, strain: str, tags: Tags = None):
        if strain not in _FUNCTIONS:
            raise ParameterError(
                f"strain = {strain!r}: {law!r} takes strain increments and rotated stresses; use "
                'strain="jaumann", or strain="small"'
            )
        self.strain = strain
        self.functions = _FUNCTIONS[strain].functions
        super().__init__(law, points, tags)  # type: ignore[arg-type]
        # axisymmetric points have three dimensions, without shear out of the plane
        self._components = 6 if points.gdim == 3 else 4
        self._loop = umat_kernel(points.strain_dim, self._components, strain == "jaumann")
        self._tried, self._size = False, 1.0
        self.umat = law
        self.keeps = kept_of_umat(self._components, len(law.internal))

    def bind(self) -> None:
        """Add the fields, and try the UMAT at one point. Collective.

        Raises:
            ParameterError: A first value of a state variable is not finite.
            UserLawError: The UMAT crashes, or reads or writes beyond an array.
        """
        super().bind()
        # collective at its first call
        self._size = smallest_height(self.points.grid)
        for name in ENERGIES:
            self.points.add_field(name, (), "J/m³")
        rows = self.rows
        if not self._tried:
            call_together(self.points.comm, lambda: self._try(rows))
        self._tried = True

    def _try(self, rows: Rows) -> None:
        # one rank is enough, and processes cost time
        if len(rows):
            work = self._work(rows[:1])
            at = OFFSETS["dstran"]
            work[:, at : at + self._components] = _TRIAL
            self.umat.try_once(work[0], self._components)

    def first_internal(self, rows: Rows) -> Array:
        """First values of the state variables, shape (1 or rows, variables). Collective."""
        points, names = self.points, [f"has_{name}" for name in self.umat.internal]
        if not self.umat.varies_at_first:
            return self.umat.first_state(np.zeros((1, points.gdim)))
        known = all(name in points.fields and points[name][rows].all() for name in names)
        if points.comm.allreduce(known, op=MPI.LAND):
            # later calls need values only for new points
            return np.zeros((1, len(names)))
        return call_together(points.comm, lambda: self.umat.first_state(points["x0"][rows]))

    def weaken(self, factor: float | None) -> None:
        """Refuse a reduced strength: a UMAT does not tell its strength.

        Raises:
            ParameterError: Always, unless the full strength is asked for.
        """
        if factor is not None:
            raise ParameterError(
                f"{self.law!r} does not tell its strength: reduce its properties, and make a new "
                "law and a new problem for each factor"
            )

    def _respond(
        self, operand: Array, rows: Rows, kept: KeptTangents | None, S, A, new, status
    ) -> int:
        points, law, read = self.points, self.umat, self.points.fields.read
        values, known = (
            (np.empty((1, self.keeps)), False) if kept is None else (kept.values, kept.known)
        )
        energies = tuple(read(name) for name in ENERGIES)
        of_all = read("F"), read("stress"), read(self.state), energies, read("x"), read("id")
        start, length = points.interval
        time = np.array([start, length, self._size])
        return self._loop(
            law.address, law.properties, law.numbers(self._components), law.name,
            time, np.ascontiguousarray(operand),
            np.ascontiguousarray(rows, np.int32), of_all, self.internal(rows), values, known, S, A,
            new, status,
        )  # fmt: skip

    def evaluate(
        self,
        operand: Array,
        value: Array,
        tangent: Array | None,
        rows: Rows,
        kept: KeptTangents | None = None,
        end: tuple[Array, Array, Array] | None = None,
    ) -> int:
        """Compute the flux S (Pa) and its derivative by ∇ũ; see `KeepingLaw`.

        `commit` writes the state at the end of the step, so that `end` is not used.
        """
        assert end is None
        if len(rows) == 0:
            return -1
        A = np.empty((0, 1, 1)) if tangent is None else tangent
        return self._respond(operand, rows, kept, value, A, _NOTHING, np.zeros(1, np.int32))

    def commit(
        self, operand: Array, rows: Rows, kept: KeptTangents | None = None
    ) -> dict[str, Array]:
        """Stress, total strain, energies and state variables at the end of the step."""
        n, names = len(rows), list(self.umat.internal)
        new = np.empty((n, 3, 3)), np.empty((n, 6)), np.empty((3, n)), np.empty((len(names), n))
        if n:
            none = np.empty((0, 1)), np.empty((0, 1, 1))
            known = kept if kept is not None and kept.known else None
            bad = self._respond(operand, rows, known, *none, new, np.zeros(1, np.int32))
            if bad >= 0:
                new[0][bad:] = np.nan
        stress, strain, energies, state = new
        fields = {"stress": stress, self.state: strain}
        return fields | dict(zip(ENERGIES, energies)) | dict(zip(names, state))

    def _work(self, rows: Rows) -> Array:
        """Arrays of calls at the present state, without strain increments."""
        points, m = self.points, self._components
        stress = points.fields.read("stress")[rows].reshape(-1, 9)[:, [0, 4, 8, 1, 2, 5]]
        return self.umat.work(stress[:, :m], self.internal(rows), m)

    def energy(self) -> Array | None:
        """SSE per initial volume at the law's points (J/m³), or None if the UMAT leaves it 0."""
        points, rows = self.points, self.rows
        stored = points[ENERGIES[0]][rows]
        if self.strain == "jaumann":
            stored = stored * points["V"][rows] / points["V0"][rows]
        return stored if stored.any() or not points["stress"][rows].any() else None

    def _of_tangents(self, size: int, measure: Callable[[Array], Array]) -> Array:
        """A function of DDSDDE at the present state without a strain increment.

        Points that have yielded lie on the yield surface, where rounding would decide between the
        elastic and the plastic DDSDDE. So the stress is a little within it, see `_move_inside`.

        Args:
            size: Number of values of the function per point.
            measure: Function of DDSDDE (Pa), shape (n, 6, 6) or (n, 4, 4), with results of the
                shape (n, size).

        Raises:
            StateError: The UMAT finds no stress.
        """
        m, every = self._components, self.rows
        result = np.empty((len(every), size))
        for first in range(0, len(every), _CHUNK):
            rows = every[first : first + _CHUNK]
            work = self._work(rows)
            _move_inside(work[:, OFFSETS["stress"] : OFFSETS["stress"] + m])
            status = self.umat.call(work, m)
            D = work[:, DDSDDE : DDSDDE + m * m].reshape(-1, m, m)
            bad = np.flatnonzero((status == 1) | ~np.isfinite(D.sum(axis=(1, 2))))
            if bad.size:
                p = rows[bad[0]]
                raise StateError(
                    f"{self.law!r} has no tangent at the stress "
                    f"{self.points['stress'][p].tolist()} Pa of point {self.points['id'][p]}: "
                    f"{FAILURES.get(int(status[bad[0]]), 'NaN')}. Set an initial stress with "
                    "mpm.set_stress, and first values of the state variables"
                )
            result[first : first + _CHUNK] = measure(D)
        return result

    def stiffness(self) -> Array:
        """Largest stiffness along one axis at the law's points (Pa), for wave speeds."""
        return self._of_tangents(
            1, lambda D: np.abs(D[:, [0, 1, 2], [0, 1, 2]]).max(axis=1, keepdims=True)
        )[:, 0]

    def moduli(self) -> Array:
        """P-wave modulus and shear modulus of DDSDDE at the law's points (Pa), shape (n, 2)."""

        def measure(D: Array) -> Array:
            along = np.einsum("pii->p", D[:, :3, :3]) / 3
            across = np.diagonal(D, axis1=1, axis2=2)[:, 3:].mean(axis=1)
            return np.stack([np.abs(along), np.abs(across)], axis=1)

        return self._of_tangents(2, measure)

    def describe(self, operand: Array, row: int) -> str:
        """Description of a point at which the UMAT found no stress, for messages.

        Args:
            operand: Gradient of the increment at the point, shape (d, d).
            row: Number of the point on this rank.
        """
        d, status = self.points.strain_dim, np.zeros(1, np.int32)
        H = np.array(operand, float).reshape(1, d * d)
        S, A = np.empty((1, d * d)), np.empty((0, 1, 1))
        self._respond(H, np.array([row], np.int32), None, S, A, _NOTHING, status)
        number = int(self.points["id"][row])
        if status[0] == 0:
            det = float(np.linalg.det(np.eye(d) + H.reshape(d, d)))
            return f"det ΔF = {det:.4g} of the increment turns the point {number} inside out"
        one = slice(row, row + 1)
        state = ", ".join(f"{k} = {v:g}" for k, v in zip(self.law.internal, self.internal(one)[0]))
        advice = "" if status[0] == 4 else ". Take smaller steps"
        return (
            f"{self.law!r} {FAILURES[int(status[0])]} at point {number}: increment "
            f"{H.reshape(d, d).tolist()}, stress {self.points['stress'][row].tolist()} Pa, "
            f"{state or 'no state variables'}{advice}"
        )


def _move_inside(stress: Array) -> None:
    """Move stresses on the yield surface a little into it, in place.

    A smaller stress is within each convex surface around the origin or through it, and a deviator
    that falls by more than the mean is within each cone from the origin.

    Args:
        stress: Components of a UMAT (Pa), shape (n, NTENS).
    """
    mean = stress[:, :3].mean(axis=1, keepdims=True)
    stress *= 1.0 - _LESS_DEVIATOR
    stress[:, :3] += (_LESS_DEVIATOR - _INSIDE) * mean
