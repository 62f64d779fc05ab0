"""Pointwise programs: UFL expressions, compiled by FFCx and called from Numba once per point.

FFCx compiles quadrature points into the kernels of integrals. An expression of constants has no
quadrature points. All values that vary from point to point therefore enter the compiled function
as constants. A loop calls the function with the values of each point.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import basix.ufl
import numba
import numpy as np
import numpy.typing as npt
import ufl
from mpi4py import MPI
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from ufl.algorithms.analysis import extract_constants
from ufl.core.expr import Expr

from dolfinmpm._platform.compat import jit_expression, kernel_arguments
from dolfinmpm._platform.errors import FormError

__all__ = ["Program", "call_tabulate", "compile_here", "compile_program", "input_numbers"]

Array = npt.NDArray[np.float64]


@intrinsic
def call_tabulate(typingctx, function, out, constants):
    """Call `tabulate_tensor(A, w, c, coordinates, entity, permutation, ...)` at an address.

    For compiled loops. The arguments are the addresses of the function, of A and of the constants
    c. The function adds to A.
    """
    signature = types.void(types.intp, types.intp, types.intp)
    number = kernel_arguments()

    def generate(context, builder, sig, args):
        from llvmlite import ir

        pointer = ir.IntType(8).as_pointer()
        kind = ir.FunctionType(ir.VoidType(), [pointer] * number)
        address = builder.inttoptr(args[0], kind.as_pointer())
        a = builder.inttoptr(args[1], pointer)
        c = builder.inttoptr(args[2], pointer)
        null = cgutils.get_null_value(pointer)
        builder.call(address, [a, null, c] + [null] * (number - 3))
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def _pointer(typingctx, address):
    """An address as a pointer to doubles."""
    signature = types.CPointer(types.float64)(types.intp)

    def generate(context, builder, sig, args):
        return builder.inttoptr(args[0], context.get_value_type(sig.return_type))

    return signature, generate


@numba.njit(cache=True, error_model="numpy")
def _run(function, addresses, strides, sizes, out):
    constants = np.empty(max(sizes.sum(), 1))
    for p in range(out.shape[0]):
        at = 0
        for s in range(addresses.size):
            source = _pointer(addresses[s] + 8 * p * strides[s])
            for i in range(sizes[s]):
                constants[at + i] = source[i]
            at += sizes[s]
        for i in range(out.shape[1]):
            out[p, i] = 0.0
        call_tabulate(function, out.ctypes.data + 8 * p * out.shape[1], constants.ctypes.data)


@dataclass(frozen=True)
class Program:
    """A compiled pointwise expression.

    Attributes:
        function: Address of the compiled C function.
        size: Number of values per point.
        inputs: Keys of the inputs, in the order of the function's constants.
        keep: Objects that must live as long as the address is used.
    """

    function: int
    size: int
    inputs: tuple[Any, ...]
    keep: Any

    def run(self, data: Mapping[Any, Array], out: Array) -> None:
        """Evaluate at n points.

        Args:
            data: A C-contiguous float64 array for every key in `inputs`, shape (n, ...), or
                shape (1, ...) for one value at all points.
            out: Written: the values, shape (n, size).
        """
        addresses = np.empty(len(self.inputs), np.intp)
        strides = np.empty(len(self.inputs), np.intp)
        sizes = np.empty(len(self.inputs), np.intp)
        arrays = [data[key] for key in self.inputs]
        for s, values in enumerate(arrays):
            size = values.size // len(values) if len(values) else 0
            addresses[s] = values.__array_interface__["data"][0]  # much faster than values.ctypes
            sizes[s] = size
            strides[s] = size if len(values) != 1 else 0
        _run(self.function, addresses, strides, sizes, out)

    def values(self, numbers: Array) -> Array:
        """Values of a program of `compile_here`, shape (n, size).

        Args:
            numbers: Its numbers at n points, shape (n, numbers), C-contiguous.
        """
        out = np.empty((len(numbers), self.size))
        self.run(dict.fromkeys(self.inputs, numbers), out)
        return out


def input_numbers(size: int) -> ufl.Constant:
    """So many numbers in UFL, the inputs of a program of `compile_here`, shape (size,).

    They live on an interval, so that grids of all kinds share compiled functions.
    """
    element = basix.ufl.element("Lagrange", "interval", 1, shape=(1,))
    return ufl.Constant(ufl.Mesh(element, ufl_id=0), shape=(size,))


def compile_program(
    grid, expressions: Sequence[Expr], sources: Mapping[ufl.Constant, Any]
) -> Program:
    """Compile scalar expressions of constants into one function. Collective.

    Args:
        grid: Background grid.
        expressions: Values that the function writes, in this order.
        sources: Key of the data for every constant in the expressions.

    Raises:
        FormError: FFCx cannot compile an expression.
    """
    return _compile(grid.comm, grid.topology.dim, expressions, sources)


def compile_here(expressions: Sequence[Expr], numbers: ufl.Constant) -> Program:
    """Like `compile_program`, on this rank alone. Ranks with the same expressions compile once.

    Args:
        expressions: Values that the function writes, in this order.
        numbers: The only constant in the expressions; see `input_numbers`.

    Raises:
        FormError: FFCx cannot compile an expression.
    """
    return _compile(MPI.COMM_SELF, 1, expressions, {numbers: "numbers"})


def _compile(comm: MPI.Comm, tdim: int, expressions, sources) -> Program:
    vector = ufl.as_vector(list(expressions))
    inputs = tuple(sources[c] for c in extract_constants(vector))
    middle = np.full((1, tdim), 0.25)
    try:
        function, keep = jit_expression(comm, vector, middle)
    except Exception as error:
        raise FormError(
            f"FFCx cannot compile the pointwise integrand {str(vector)[:500]}: {error}"
        ) from error
    return Program(function, len(expressions), inputs, keep)
