"""A law's kernel: a C function, so that one compiled loop serves all laws."""

from __future__ import annotations

import dis
import functools
import inspect
import operator
from collections.abc import Callable
from typing import Any

import numba
from llvmlite import ir
from numba import types
from numba.core.errors import NumbaError
from numba.extending import intrinsic, models, overload, register_model

from dolfinmpm._platform.argumentchecks import check_function, shown
from dolfinmpm._platform.errors import ParameterError, UserLawError

__all__ = ["KERNEL_SIGNATURE", "Kernel", "call_law", "law_kernel", "respond_at_points"]

_PACKAGE = __name__.partition(".")[0] + "."
_DOUBLES = types.CPointer(types.float64)
KERNEL_SIGNATURE = types.int32(_DOUBLES, _DOUBLES, _DOUBLES, _DOUBLES, _DOUBLES, _DOUBLES)


class _Discarded(types.Type):
    """An array of which compiled functions discard all values.

    A law's kernel compiled with this type for its tangent computes no tangent: the compiler removes
    computations without effect.
    """

    def __init__(self):
        super().__init__(name="Discarded")


_DISCARDED = _Discarded()


@register_model(_Discarded)
class _DiscardedModel(models.PrimitiveModel):
    def __init__(self, manager, kind):
        # an address, as the caller gives one
        super().__init__(manager, kind, ir.IntType(8).as_pointer())


@overload(operator.setitem)
def _set(array, index, value):
    if isinstance(array, _Discarded):
        return lambda array, index, value: None
    return None


@overload(operator.getitem)
def _get(array, index):
    if isinstance(array, _Discarded):
        return lambda array, index: 0.0
    return None


class Kernel:
    """A law's kernel, compiled at the first request of its address: no problem uses all laws."""

    def __init__(self, function: Callable):
        self._function = function
        #: Numbers of parameters and of internal variables with which it has been tried.
        self.tried: set[tuple[int, int]] = set()

    @property
    def is_own(self) -> bool:
        """Whether it is a user's kernel, and not one of the package."""
        return not self._function.__module__.startswith(_PACKAGE)

    @functools.cached_property
    def compiled(self) -> Any:
        """The compiled C function.

        Raises:
            UserLawError: Numba cannot compile it.
        """
        # Numba's cache goes by file and line. It would return an old kernel for a module under
        # another name, or after a change of a global number from another module. The package's
        # own kernels use no such numbers, and `forget_outdated` checks their sources.
        cache, name = not self.is_own, self._function.__name__
        try:
            return numba.cfunc(KERNEL_SIGNATURE, cache=cache, error_model="numpy")(self._function)
        except NumbaError as error:
            raise UserLawError(
                f"Numba cannot compile the kernel {name}. Use its six arrays by index only, and "
                f"return 0 at its end. Numba says: {error}"
            ) from error

    @functools.cached_property
    def address(self) -> int:
        """Address of the C function."""
        return self.compiled.address

    @functools.cached_property
    def stress_address(self) -> int:
        """Address of a kernel that writes no tangent, for explicit steps.

        Only the package's own kernels have one. For other kernels it is the address of the kernel
        itself, because they may use the tangent in ways that need a real array.
        """
        if self.is_own:
            return self.address
        signature = types.int32(*[_DOUBLES] * 5, _DISCARDED)
        kept = numba.cfunc(signature, cache=True, error_model="numpy")(self._function)
        self._without_tangent = kept
        return kept.address


def law_kernel(function: Callable) -> Kernel:
    """Make a law's kernel. It is compiled when a process first uses the law.

    The function takes six C pointers to doubles. Use them by index only, as in `stress[0] = ...`:
    they have no slices, lengths or methods. The function writes every entry of `new`, `stress` and
    `tangent`, and returns 0. It returns another number if the strain admits no stress:

    `kernel(parameters, strain, old, new, stress, tangent)`

    - `parameters`: the parameters in the declared order;
    - `strain`: the three principal trial logarithmic strains. A law with a return mapping replaces
      them by the elastic strains;
    - `old`: the internal variables at the start of the step;
    - `new`: the internal variables at the end of the step (output);
    - `stress`: the three principal Kirchhoff stresses (Pa, output);
    - `tangent`: the nine derivatives of stress by trial strain, row by row (Pa, output).

    Args:
        function: The function.

    Raises:
        ParameterError: The argument is not a function of six pointers, or it raises or prints.

    A law without shear stiffness, τ_i = K tr ε. The function can be tried before it is compiled:

    >>> import dolfinmpm as mpm
    >>> def water(parameters, strain, old, new, stress, tangent):
    ...     for i in range(3):
    ...         stress[i] = parameters[0] * (strain[0] + strain[1] + strain[2])
    ...         for j in range(3):
    ...             tangent[3 * i + j] = parameters[0]
    ...     return 0
    >>> kernel = mpm.materials.law_kernel(water)
    >>> stress, tangent = [0.0] * 3, [0.0] * 9
    >>> water([2e9], [1e-6, 0.0, 0.0], [], [], stress, tangent), stress
    (0, [2000.0, 2000.0, 2000.0])
    """
    check_function("function", function, "of six arrays, kernel(parameters, strain, ...)")
    try:
        inspect.signature(function).bind(*range(6))
    except TypeError as error:
        raise ParameterError(
            f"function = {shown(function)} must take six arrays, parameters, strain, old, new, "
            f"stress and tangent: {error}"
        ) from None
    _refuse_python(function)
    return Kernel(function)


def _refuse_python(function: Callable) -> None:
    """Refuse what a C function cannot do: an exception is lost, and print ends the program."""
    code = getattr(function, "__code__", None)
    for step in dis.get_instructions(code) if code is not None else ():
        found = None
        if step.opname == "RAISE_VARARGS":
            found = "raises or asserts", "return 1 where the strain admits no stress"
        elif step.argval == "print" and step.opname.startswith("LOAD"):
            found = "prints", "call the function itself, with lists, to look at its numbers"
        if found is not None:
            name = function.__name__
            raise ParameterError(f"the kernel {name} {found[0]}, as no C function can: {found[1]}")


@intrinsic
def call_law(typingctx, address, parameters, strain, old, new, stress, tangent):
    """Call a kernel by its address, with the addresses of its arrays; for compiled loops."""
    signature = types.int32(*[types.intp] * 7)

    def generate(context, builder, sig, args):
        pointer = ir.DoubleType().as_pointer()
        kind = ir.FunctionType(ir.IntType(32), [pointer] * 6)
        function = builder.inttoptr(args[0], kind.as_pointer())
        return builder.call(function, [builder.inttoptr(a, pointer) for a in args[1:]])

    return signature, generate


@numba.njit(cache=True, error_model="numpy")
def respond_at_points(law, parameters, strain, old, new, stress, tangent):
    """Call a kernel at n points; returns the first point without a stress, else -1."""
    for p in range(strain.shape[0]):
        at = p if parameters.shape[0] > 1 else 0
        status = call_law(
            law, parameters.ctypes.data + 8 * at * parameters.shape[1],
            strain.ctypes.data + 24 * p, old.ctypes.data + 8 * p * old.shape[1],
            new.ctypes.data + 8 * p * new.shape[1], stress.ctypes.data + 24 * p,
            tangent.ctypes.data + 72 * p,
        )  # fmt: skip
        if status != 0:
            return p
    return -1
