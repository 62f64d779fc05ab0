"""Laws from an elastic energy in UFL, alone or with a yield function in UFL."""

from __future__ import annotations

import functools
import inspect
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import ufl
from mpi4py import MPI
from ufl.algorithms.ad import expand_derivatives
from ufl.core.expr import Expr

from dolfinmpm._platform.argumentchecks import check_dictionary
from dolfinmpm._platform.compat import jit_expression
from dolfinmpm._platform.errors import FormError, ParameterError, StateError
from dolfinmpm.forms.pointwise import Program, compile_here, input_numbers
from dolfinmpm.materials.base import Law
from dolfinmpm.materials.parametrised import Array, Parameter, Value
from dolfinmpm.materials.returnmapping import return_kernel, yield_values

__all__ = ["EnergyWithYield", "mises"]

HARDENING = "plastic_strain"


def mises(stress: Expr, yield_stress: Expr) -> Expr:
    """Von Mises' yield function of principal stresses (Pa), in UFL; see `VonMises`.

    f = √(2 J₂) − √(2/3) σ_y, σ_y being the uniaxial yield stress.
    """
    a, b, c = stress
    size = ufl.sqrt(((a - b) ** 2 + (b - c) ** 2 + (c - a) ** 2) / 3)
    return size - math.sqrt(2.0 / 3.0) * yield_stress


class EnergyWithYield(Law):
    """A law from an elastic energy in UFL, with an optional yield function in UFL.

    The Kirchhoff stress is τ_i = ∂ψ/∂ε_i, with the elastic principal logarithmic strains ε_i. The
    flow is Δεᵖ_i = Δγ ∂g/∂τ_i with f(τ, α) = 0. The accumulated plastic strain α grows by
    √(2/3) ‖Δεᵖ‖.

    UFL takes all derivatives: ∂ψ/∂ε and its Hessian, ∂f/∂τ, ∂g/∂τ and its derivatives. FFCx
    compiles them into C functions. A closest-point return in principal axes calls these functions
    (Simo & Hughes, Computational Inelasticity, 1998, box 3.1; the exponential map keeps its form
    under large strain). The tangent is consistent with the return.

    The functions must not depend on the order of the axes. They must be smooth where a return can
    end: round off apices (√(J₂ + a²) for √J₂) and corners.

    `EnergyWithYield(lambda e, K: K * sum(e) ** 2 / 2 + ..., yield_stress=20e3, K=1e6)`

    Args:
        energy: Function of the elastic principal logarithmic strains, a UFL vector of
            three, and of parameters by their names. It returns ψ (J per initial m³).
        yield_function: Function of the principal Kirchhoff stresses (Pa), a UFL vector of
            three, and of parameters by their names. The law yields where its value is positive.
            A parameter named `plastic_strain` is α. By default `mises` if a `yield_stress` is
            given, the uniaxial yield stress (Pa). Else the law is elastic.
        potential: g, likewise. By default f: associated flow.
        ranges: Name of a parameter → `Parameter` with its range. By default any finite number.
        values: Every parameter named by the functions: a number, or one value per point as in any
            `Law`.

    Raises:
        ParameterError: A parameter is missing, unknown or outside its range, or a
            function depends on the order of the axes.
        FormError: The result of a function is not a UFL scalar, or FFCx cannot compile it.

    Collective over all ranks: the functions are compiled.

    Hencky's energy with the yield function of von Mises:

    >>> import dolfinmpm as mpm
    >>> import ufl
    >>> def energy(e, K, G):
    ...     return (K / 2 - G / 3) * sum(e) ** 2 + G * ufl.inner(e, e)
    >>> law = mpm.materials.EnergyWithYield(energy, yield_stress=1e3, K=4e6 / 3, G=8e5)
    >>> law.respond([[2e-3, -1e-3, -1e-3]]).stress[0].round(6).tolist()
    [666.666667, -333.333333, -333.333333]
    """

    def __init__(
        self,
        energy: Callable[..., Expr],
        yield_function: Callable[..., Expr] | None = None,
        *,
        potential: Callable[..., Expr] | None = None,
        ranges: Mapping[str, Parameter] | None = None,
        **values: Value,
    ):
        if yield_function is None and "yield_stress" in values:
            yield_function = mises
        if potential is not None and yield_function is None:
            raise ParameterError(
                "EnergyWithYield: a potential needs a yield function; give yield_function or "
                "yield_stress"
            )
        given = [f for f in (energy, yield_function, potential) if f is not None]
        names = dict.fromkeys(name for f in given for name in _names(f))
        if HARDENING in _names(energy):
            raise ParameterError(f"EnergyWithYield: an energy must not depend on {HARDENING}")
        names.pop(HARDENING, None)
        ranges = {} if ranges is None else ranges
        check_dictionary("EnergyWithYield: ranges", ranges, ", name → Parameter")
        self.parameters = {name: ranges.get(name, Parameter("")) for name in names}
        unknown = set(ranges) - set(names)
        if unknown:
            raise ParameterError(
                f"EnergyWithYield: ranges of unknown parameters {', '.join(sorted(unknown))}; "
                f"there are {', '.join(names)}"
            )
        # principal values, α and parameters: the inputs of a compiled function
        self._z = input_numbers(4 + len(names))
        self.internal = {HARDENING: ("", 0.0)} if yield_function else {}
        self._functions = {"energy": energy, "yield": yield_function, "potential": potential}
        if yield_function is None:
            self.strengths = ()
        elif yield_function is mises:
            self.strengths = ("yield_stress",)
        super().__init__(**values)
        self._keep: list[Any] = []
        self._compile(yield_function, potential or yield_function)
        if not self.varies:
            self._check_isotropy()
            self._check_sign()

    def _compile(self, yield_function, potential) -> None:
        """Compile values and derivatives; see `return_kernel` for their outputs."""
        functions = [self._elastic()]
        if yield_function is not None:
            f, (tau, alpha) = self._of(yield_function, "yield function")
            slopes = [ufl.diff(f, t) for t in (*tau, alpha)]
            g, (tau, alpha) = self._of(potential, "potential")
            flow = [ufl.diff(g, t) for t in tau]
            turn = [ufl.diff(n, t) for n in flow for t in (*tau, alpha)]
            # a cone's slope is NaN at its apex, but its value is a number
            functions += [[f], [f, *slopes, *flow, *turn]]
        stored = self._compiled(functions[0])
        self._yield, full = [self._compiled(f) for f in functions[1:]] or (0, 0)
        self._own_kernel = return_kernel(stored, self._yield, full, len(self.parameters))

    def _of(self, function, what: str):
        """The function's UFL, and the variables of its derivatives."""
        z = self._z
        state = [ufl.variable(z[i]) for i in range(4)]
        named = {name: z[4 + k] for k, name in enumerate(self.parameters)}
        named[HARDENING] = state[3]
        given = {n: named[n] for n in _names(function)}
        try:
            result = function(ufl.as_vector(state[:3]), **given)
        except Exception as error:
            raise FormError(
                f"EnergyWithYield: the {what} failed with {type(error).__name__}: {error}. It gets "
                "a vector of three principal values and its parameters, all in UFL"
            ) from error
        if what == "energy" and isinstance(result, (int, float)):
            raise FormError(
                f"EnergyWithYield: the energy is {result:g}, whatever the strain, and has no stress"
            )
        if not isinstance(result, (Expr, int, float)) or (
            isinstance(result, Expr) and result.ufl_shape != ()
        ):
            raise FormError(
                f"EnergyWithYield: the {what} must be a scalar expression of UFL, got "
                f"{getattr(result, 'ufl_shape', type(result).__name__)}"
            )
        return ufl.as_ufl(result), (state[:3], state[3])

    def _compiled(self, expressions: list[Expr]) -> int:
        vector = expand_derivatives(ufl.as_vector(expressions))
        try:
            address, keep = jit_expression(MPI.COMM_WORLD, vector, np.full((1, 1), 0.25))
        except Exception as error:
            raise FormError(
                f"FFCx cannot compile a function of EnergyWithYield, {str(vector)[:300]}: {error}"
            ) from error
        self._keep.append(keep)
        return address

    def _check_isotropy(self) -> None:
        strain = 1e-4 * np.array([[1.0, 2.0, -4.0], [2.0, 1.0, -4.0], [1.0, -4.0, 2.0]])
        try:
            stress = self.respond(strain).stress
        except StateError:
            return
        size = np.abs(stress).max()
        wrong = np.abs(stress - stress[0][[[0, 1, 2], [1, 0, 2], [0, 2, 1]]]).max()
        if wrong > 1e-6 * size:
            raise ParameterError(
                f"EnergyWithYield: stresses change by {wrong:g} Pa of {size:g} Pa when the axes of "
                "strain are exchanged; energy, yield function and potential must treat the three "
                "principal values alike"
            )

    def _check_sign(self) -> None:
        """Refuse an energy that falls with every strain, whose body would rise under its weight."""
        try:
            moduli = self.respond(np.zeros((1, 3))).tangent[0]
        except StateError:
            return
        if np.isfinite(moduli).all() and np.linalg.eigvalsh(moduli + moduli.T).max() < 0.0:
            raise ParameterError(
                f"EnergyWithYield: the energy falls with every strain, with moduli down to "
                f"{np.linalg.eigvalsh(0.5 * (moduli + moduli.T)).min():g} Pa without strain; a "
                "stored energy rises: give it the other sign"
            )

    @property
    def address(self) -> int:
        """Address of the compiled kernel."""
        return self._own_kernel.address

    def energy(self, strain: Array, parameters: Array) -> Array:
        """ψ (J/m³), without the energy stored by hardening; see `Law.energy`."""
        z = np.zeros((len(strain), 4 + len(self.parameters)))
        z[:, :3], z[:, 4:] = strain, parameters
        return self._energy_program.values(z)[:, 0]

    @functools.cached_property
    def _energy_program(self) -> Program:
        energy, _ = self._of(self._functions["energy"], "energy")
        return compile_here([energy], self._z)

    def elastic_tangent(self, strain: Array, internal: Array, parameters: Array) -> Array:
        """Second derivatives of ψ (Pa), shape (n, 3, 3).

        The tangent of the law would not do: on the yield surface rounding decides whether it is
        the elastic or the plastic one.
        """
        z = np.zeros((len(strain), 4 + len(self.parameters)))
        z[:, :3], z[:, 4:] = strain, parameters
        return self._elastic_program.values(z)[:, 3:].reshape(-1, 3, 3)

    @functools.cached_property
    def _elastic_program(self) -> Program:
        return compile_here([expand_derivatives(e) for e in self._elastic()], self._z)

    def _elastic(self) -> list[Expr]:
        """Stresses and their derivatives by the strains."""
        energy, (strain, _) = self._of(self._functions["energy"], "energy")
        stress = [ufl.diff(energy, e) for e in strain]
        return [*stress, *(ufl.diff(s, e) for s in stress for e in strain)]

    def yield_function(self, stress: Array, internal: Array, parameters: Array) -> Array:
        """Yield function f of principal Kirchhoff stresses, shape (n,); see `Law`."""
        if not self._yield:
            return super().yield_function(stress, internal, parameters)
        z = np.empty((len(stress), 4 + len(self.parameters)))
        z[:, :3], z[:, 3:4], z[:, 4:] = stress, internal, parameters
        return yield_values(self._yield, z)

    def __repr__(self) -> str:
        # two different laws of one name must stay distinct
        names = "".join(
            f"{k}={getattr(f, '__qualname__', repr(f))}, " for k, f in self._functions.items() if f
        )
        return super().__repr__().replace("(", f"({names}", 1)


def _names(function: Callable) -> list[str]:
    """Names of a function's arguments after the first."""
    if not callable(function):
        raise ParameterError(
            f"EnergyWithYield: expected a function that returns UFL, got {type(function).__name__}"
        )
    given = list(inspect.signature(function).parameters.values())
    if not given or any(p.kind in (p.VAR_POSITIONAL, p.VAR_KEYWORD) for p in given):
        raise ParameterError(
            "EnergyWithYield: a function takes the principal values first and then parameters by "
            "their names, neither * nor **"
        )
    return [p.name for p in given[1:]]
