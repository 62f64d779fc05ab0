"""Laws that others have published as UMATs: Fortran subroutines with Abaqus's interface."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.argumentchecks import coordinates, shown, whole
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm.grid.userfunctions import call_function
from dolfinmpm.materials.parametrised import Array, Parametrised, Value
from dolfinmpm.materials.umatcall import call_at_points
from dolfinmpm.materials.umatcheck import check_umat
from dolfinmpm.materials.umatlibrary import open_umat
from dolfinmpm.materials.umatshim import OFFSETS
from dolfinmpm.materials.umattrial import try_umat

__all__ = ["UMAT"]

State = int | Sequence[str] | Mapping[str, Value]


class UMAT(Parametrised):
    """A law from a UMAT, the Fortran subroutine of Abaqus's interface.

    The source is compiled once, by gfortran, into the cache of FFCx. The compiled loop over the
    points calls the subroutine. The law is incremental: it gets the Cauchy stress at the start of
    the step and the strain increment. Use it with strain="jaumann" or strain="small" in
    `mpm.momentum`.

    The conventions are those of Abaqus. Components are in the order 11, 22, 33, 12, 13, 23, shear
    strains are engineering strains, tension is positive. Plane strain and axisymmetry have
    NTENS = 4, three dimensions NTENS = 6; in axisymmetry 11 is radial, 22 axial and 33 hoop. Units
    are those of the problem (Pa, s). With Jaumann's rate STRESS and STRAN arrive rotated, and DROT
    is the rotation. DDSDDE must be the derivative of STRESS by DSTRAN. The library adds the terms
    of rotation and volume, see `dolfinmpm.kinematics.umatloop`. TIME and DTIME are those of the
    step; a step without time has DTIME = 1 or a share of 1. NOEL is the number of the point.

    The step fails and is halved where PNEWDT < 1, where a number is not finite, and where the
    UMAT calls XIT or stops. SSE and SPD are fields of the points, `elastic_energy` and
    `plastic_dissipation` (J/m³). The total strain is the field `total_strain`. State variables are
    fields of their names: they are saved, drawn and moved between ranks as all fields are.

    Before the first step one call is tried in a process of its own, between guard values. So a
    crash, or a read or write beyond an array, ends in a `UserLawError`.

    Args:
        path: Fortran source (.f, .for, .f90), or a shared library (.so) with the symbol `umat_`.
        properties: Material constants PROPS, shape (NPROPS,), in the units of the UMAT.
        state: Number of state variables, named `state_1`, `state_2`, ...; or their names; or name
            → first value. A first value is a number, an array with one value per point of this
            rank, or a function of the first positions (m), shape (gdim, n), that returns n values.
            Without a first value it is 0.
        name: CMNAME, at most 80 characters.
        flags: Options of gfortran, such as "-ffree-form".

    Raises:
        ParameterError: There is no such file, or an argument is out of range.
        MissingPackageError: gfortran is not installed.
        UserLawError: The source cannot be compiled, or has no subroutine UMAT.

    Collective over all ranks: the source is compiled.

    Elasticity in Fortran, and its check:

    >>> import pathlib, tempfile
    >>> import dolfinmpm as mpm
    >>> source = pathlib.Path(tempfile.mkdtemp()) / "elastic.f90"
    >>> _ = source.write_text('''
    ... subroutine umat(stress, statev, ddsdde, sse, spd, scd, rpl, ddsddt, drplde, drpldt, &
    ...   stran, dstran, time, dtime, temp, dtemp, predef, dpred, cmname, ndi, nshr, ntens, &
    ...   nstatv, props, nprops, coords, drot, pnewdt, celent, dfgrd0, dfgrd1, noel, npt, layer, &
    ...   kspt, jstep, kinc)
    ...   implicit none
    ...   integer :: ndi, nshr, ntens, nstatv, nprops, noel, npt, layer, kspt, jstep(4), kinc, i
    ...   real(8) :: stress(ntens), ddsdde(ntens, ntens), dstran(ntens), props(nprops)
    ...   real(8) :: statev, sse, spd, scd, rpl, ddsddt, drplde, drpldt, stran, time, dtime, temp
    ...   real(8) :: dtemp, predef, dpred, coords, drot, pnewdt, celent, dfgrd0, dfgrd1
    ...   character(80) :: cmname
    ...   ddsdde(1:ndi, 1:ndi) = props(1)
    ...   do i = 1, ntens
    ...     ddsdde(i, i) = ddsdde(i, i) + merge(2, 1, i <= ndi) * props(2)
    ...   end do
    ...   stress = stress + matmul(ddsdde, dstran)
    ... end subroutine
    ... ''')
    >>> law = mpm.materials.UMAT(source, properties=[6e5, 4e5])
    >>> law.check()
    []
    """

    symmetric = False
    strengths = None
    friction_angles: tuple[str, ...] = ()
    has_moduli = False

    def __init__(
        self,
        path: str | os.PathLike[str],
        properties: npt.ArrayLike = (),
        state: State = 0,
        *,
        name: str = "UMAT",
        flags: Sequence[str] = ("-O2",),
    ):
        super().__init__()
        self.properties = coordinates("properties", properties).astype(float).ravel()
        if not np.isfinite(self.properties).all():
            raise ParameterError(f"properties = {shown(properties)} must be finite numbers")
        self.properties.flags.writeable = False
        self._first = _first_values(state)
        self.internal = dict.fromkeys(self._first, ("", 0.0))
        if not isinstance(name, str) or len(name) > 80 or not name.isascii():
            raise ParameterError(f"name = {shown(name)} must be at most 80 ASCII characters")
        if isinstance(flags, str) or not all(isinstance(flag, str) for flag in flags):
            raise ParameterError(f"flags = {shown(flags)} must be a list of words")
        self.name = np.frombuffer(name.ljust(80).encode(), np.uint8).copy()
        self._library = open_umat(path, flags)
        self._path = os.fspath(path)

    @property
    def address(self) -> int:
        """Address of the C function that calls the UMAT."""
        return self._library.address

    @property
    def library(self) -> str:
        """Path of the compiled library."""
        return str(self._library.path)

    def numbers(self, components: int) -> npt.NDArray[np.int64]:
        """NDI, NSHR, NTENS, NSTATV, NPROPS and NOEL, shape (6,)."""
        sizes = (3, components - 3, components, len(self.internal), self.properties.size, 1)
        return np.array(sizes, np.int64)

    @property
    def varies_at_first(self) -> bool:
        """Whether first values of state variables differ from point to point."""
        return not all(isinstance(value, float) for value in self._first.values())

    def first_state(self, x: Array) -> Array:
        """First values of the state variables at points, shape (n, variables).

        Args:
            x: First positions (m), shape (n, gdim).

        Raises:
            ParameterError: A value is not finite, or there is not one value per point.
        """
        result = np.empty((len(x), len(self._first)))
        for k, (name, value) in enumerate(self._first.items()):
            given = call_function(f"state: {name}", value, x) if callable(value) else value
            if np.shape(given) not in ((), (len(x),)):
                raise ParameterError(
                    f"state: {name} has the shape {np.shape(given)}, expected one value for each "
                    f"of {len(x)} points"
                )
            result[:, k] = given
            if not np.isfinite(result[:, k]).all():
                raise ParameterError(f"state: {name} must be finite numbers")
        return result

    def work(self, stress: Array, state: Array, components: int = 6) -> Array:
        """Arrays of calls, with rows as `call_at_points` takes them; strain increments are 0.

        Args:
            stress: Cauchy stress (Pa), shape (n, components).
            state: State variables, shape (n, variables).
            components: NTENS.
        """
        result = np.zeros((len(stress), OFFSETS["statev"] + max(state.shape[1], 1)))
        for matrix in ("drot", "dfgrd0", "dfgrd1"):
            result[:, OFFSETS[matrix] + np.array([0, 4, 8])] = 1.0
        result[:, OFFSETS["dtime"]] = result[:, OFFSETS["celent"]] = 1.0
        result[:, OFFSETS["stress"] : OFFSETS["stress"] + components] = stress
        result[:, OFFSETS["statev"] : OFFSETS["statev"] + state.shape[1]] = state
        return result

    def call(self, work: Array, components: int = 6) -> npt.NDArray[np.int32]:
        """Call the UMAT with each row of an array; returns the numbers of failures, shape (n,).

        Args:
            work: See `work`; read and written.
            components: NTENS.
        """
        status = np.zeros(len(work), np.int32)
        numbers = self.numbers(components)
        call_at_points(self.address, self.properties, numbers, self.name, work, status)
        return status

    def beyond_strength(self, stress: Array) -> Array:
        """Yield function of Cauchy stresses (Pa), shape (n,); −inf, as a source does not tell it.

        Args:
            stress: Cauchy stress (Pa), shape (n, 3, 3).
        """
        return np.full(len(stress), -np.inf)

    def try_once(self, row: Array, components: int) -> None:
        """Call the UMAT once in a process of its own. Not collective.

        Args:
            row: Data of a point, a row of `work`.
            components: NTENS.

        Raises:
            UserLawError: It crashes, stops, or reads or writes beyond an array.
        """
        try_umat(self.library, repr(self), self.properties, self.name, row, components,
                 list(self.internal))  # fmt: skip

    def check(
        self,
        stress: float | Sequence[float] = -100e3,
        *,
        strain: float = 1e-4,
        components: int = 6,
        tolerance: float = 1e-3,
    ) -> list[str]:
        """Look for faults of the UMAT: state between points, and a wrong tangent.

        Points with different stresses and strain increments are evaluated in two orders, which
        must give the same numbers. DDSDDE is compared with central differences of the stress.
        Points at which the stress has a kink do not count.

        Args:
            stress: Stress around which the points are (Pa): a number for the same stress in all
                directions, or NTENS components.
            strain: Size of the strain increments (-).
            components: NTENS: 6 in three dimensions, 4 in plane strain and axisymmetry.
            tolerance: Largest share by which DDSDDE may differ from the differences.

        Returns:
            The faults as text; an empty list if there are none.

        Raises:
            ParameterError: An argument is out of range.
            UserLawError: The UMAT crashes, or reads or writes beyond an array.
        """
        whole("components", components, 4)
        return check_umat(self, stress, strain, components, tolerance)

    def __repr__(self) -> str:
        name = bytes(self.name).decode().strip()
        label = "" if name == "UMAT" else f", name={name!r}"
        return (
            f"UMAT({os.path.basename(self._path)!r}, {self.properties.size} properties, "
            f"{len(self.internal)} state variables{label})"
        )


def _first_values(state: Any) -> dict[str, Any]:
    """Name of a state variable → its first value."""
    if isinstance(state, Mapping):
        pairs: Iterator[tuple[Any, Any]] = iter(state.items())
    elif isinstance(state, (list, tuple)):
        pairs = ((name, 0.0) for name in state)
    else:
        pairs = ((f"state_{k + 1}", 0.0) for k in range(whole("state", state, 0)))
    found: dict[str, float | Array | Callable] = {}
    for name, value in pairs:
        if not isinstance(name, str) or not name.isidentifier() or name in found:
            raise ParameterError(
                f"state has the name {shown(name)}: names must be different words, such as "
                "'void_ratio'"
            )
        found[name] = value if callable(value) else _number(name, value)
    return found


def _number(name: str, value: Any) -> float | Array:
    array = coordinates(f"state: {name}", value)
    if not np.isfinite(array).all():
        raise ParameterError(f"state: {name} = {shown(value)} must be finite")
    return float(array) if array.ndim == 0 else array.copy()
