"""Four doubles in one register, and small arrays on the stack, for compiled loops.

A node has vectors of four. A sum of such vectors over nodes is one instruction per node where the
processor has registers of 256 bits; LLVM splits the vectors elsewhere. Numba alone makes no such
instructions.

LLVM unrolls loops over the few entries of a small array on the stack, and keeps the entries in
registers. So index notation costs nothing.
"""

from __future__ import annotations

import math

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, models, register_model
from numba.np.arrayobj import populate_array

__all__ = [
    "add_at",
    "axpy",
    "four",
    "integers",
    "lanes",
    "load",
    "matrix",
    "number_at",
    "numbers",
    "store",
    "times",
    "vectors",
]

_VECTOR = ir.VectorType(ir.DoubleType(), 4)


class _Four(types.Type):
    def __init__(self):
        super().__init__(name="Four")


_FOUR = _Four()


@register_model(_Four)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, manager, kind):
        super().__init__(manager, kind, _VECTOR)


def _index(k):
    return ir.Constant(ir.IntType(32), k)


def _spread(builder, number):
    """A number in all four lanes."""
    first = builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), number, _index(0))
    mask = ir.Constant(ir.VectorType(ir.IntType(32), 4), [0] * 4)
    return builder.shuffle_vector(first, first, mask)


@intrinsic
def four(typingctx, a, b, c, d):
    """The vector of four numbers."""

    def generate(context, builder, sig, args):
        result = ir.Constant(_VECTOR, ir.Undefined)
        for k, number in enumerate(args):
            result = builder.insert_element(result, number, _index(k))
        return result

    return _FOUR(*[types.float64] * 4), generate


@intrinsic
def lanes(typingctx, vector):
    """The four numbers of a vector."""
    signature = types.UniTuple(types.float64, 4)(_FOUR)

    def generate(context, builder, sig, args):
        numbers = [builder.extract_element(args[0], _index(k)) for k in range(4)]
        return context.make_tuple(builder, sig.return_type, numbers)

    return signature, generate


@intrinsic
def times(typingctx, number, vector):
    """A number times a vector."""

    def generate(context, builder, sig, args):
        return builder.fmul(_spread(builder, args[0]), args[1])

    return _FOUR(types.float64, _FOUR), generate


@intrinsic
def axpy(typingctx, number, vector, other):
    """A number times a vector, plus another."""

    def generate(context, builder, sig, args):
        flags = ("contract", "nsz")
        product = builder.fmul(_spread(builder, args[0]), args[1], flags=flags)
        return builder.fadd(product, args[2], flags=flags)

    return _FOUR(types.float64, _FOUR, _FOUR), generate


@intrinsic
def load(typingctx, address):
    """The vector at an address."""

    def generate(context, builder, sig, args):
        return builder.load(builder.inttoptr(args[0], _VECTOR.as_pointer()), align=8)

    return _FOUR(types.intp), generate


@intrinsic
def store(typingctx, address, vector):
    """Put a vector at an address."""

    def generate(context, builder, sig, args):
        builder.store(args[1], builder.inttoptr(args[0], _VECTOR.as_pointer()), align=8)
        return context.get_dummy_value()

    return types.void(types.intp, _FOUR), generate


@intrinsic
def add_at(typingctx, address, number):
    """Add a number to the one at an address."""

    def generate(context, builder, sig, args):
        pointer = builder.inttoptr(args[0], ir.DoubleType().as_pointer())
        builder.store(builder.fadd(builder.load(pointer), args[1], flags=("contract",)), pointer)
        return context.get_dummy_value()

    return types.void(types.intp, types.float64), generate


@intrinsic
def number_at(typingctx, address):
    """The number at an address."""

    def generate(context, builder, sig, args):
        return builder.load(builder.inttoptr(args[0], ir.DoubleType().as_pointer()))

    return types.float64(types.intp), generate


def _on_stack(kind, *sizes):
    """Array of literal sizes on the stack of the function that asks, as an intrinsic has it."""

    def generate(context, builder, sig, args):
        shape = [size.literal_value for size in sizes]
        width = context.get_abi_sizeof(context.get_value_type(kind))
        strides = [width * math.prod(shape[k + 1 :]) for k in range(len(shape))]
        array = context.make_array(sig.return_type)(context, builder)
        populate_array(
            array,
            data=cgutils.alloca_once(builder, context.get_value_type(kind), size=math.prod(shape)),
            shape=[context.get_constant(types.intp, size) for size in shape],
            strides=[context.get_constant(types.intp, stride) for stride in strides],
            itemsize=context.get_constant(types.intp, width),
            meminfo=None,
        )
        return array._getvalue()

    return types.Array(kind, len(sizes), "C")(*sizes), generate


@intrinsic(prefer_literal=True)
def numbers(typingctx, size):
    """An array of so many doubles on the stack."""
    return _on_stack(types.float64, size)


@intrinsic(prefer_literal=True)
def integers(typingctx, size):
    """An array of so many integers on the stack."""
    return _on_stack(types.intp, size)


@intrinsic(prefer_literal=True)
def matrix(typingctx, rows, columns):
    """An array of rows and columns of doubles on the stack."""
    return _on_stack(types.float64, rows, columns)


@intrinsic(prefer_literal=True)
def vectors(typingctx, size):
    """So many vectors on the stack, by their numbers."""

    def generate(context, builder, sig, args):
        return cgutils.alloca_once(builder, _VECTOR, size=size.literal_value)

    return types.CPointer(_FOUR)(size), generate
