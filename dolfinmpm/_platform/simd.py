"""Four doubles in one register, for compiled loops.

What a node has is a vector of four; sums of such vectors over nodes are one instruction each
where the processor has registers of 256 bits, and LLVM splits them where it has not. Numba
alone makes no such instructions of sums that are written out.
"""

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.extending import intrinsic, models, register_model

__all__ = [
    "add_at",
    "axpy",
    "four",
    "lanes",
    "load",
    "number_at",
    "store",
    "times",
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
        flags = ("contract",)
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
