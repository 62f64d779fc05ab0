"""Calls of a UMAT from compiled loops, by its address."""

from __future__ import annotations

import numba
from numba import types
from numba.extending import intrinsic

from dolfinmpm.materials.umatshim import OFFSETS

__all__ = ["DDSDDE", "FAILURES", "STATEV", "STRESS", "call_at_points", "call_umat"]

STRESS, DDSDDE, STATEV = OFFSETS["stress"], OFFSETS["ddsdde"], OFFSETS["statev"]
_PNEWDT = OFFSETS["pnewdt"]
# Why a call fails, by the number that it returns
FAILURES = {
    1: "stopped by XIT, STOP or an error at run time",
    2: "asks for a shorter step (PNEWDT < 1)",
    3: "gives a stress or a state variable that is not finite",
    4: "writes behind the last number of STATEV (give more state variables by state=)",
}


@intrinsic
def call_umat(typingctx, address, work, properties, numbers, name):
    """Call `dolfinmpm_umat` with the addresses of its arrays; returns its number."""
    signature = types.int32(*[types.intp] * 5)

    def generate(context, builder, sig, args):
        from llvmlite import ir

        pointer = ir.IntType(8).as_pointer()
        kind = ir.FunctionType(ir.IntType(32), [pointer] * 4)
        function = builder.inttoptr(args[0], kind.as_pointer())
        return builder.call(function, [builder.inttoptr(a, pointer) for a in args[1:]])

    return signature, generate


@numba.njit(cache=True, error_model="numpy")
def call_at_points(address, properties, numbers, name, work, status):
    """Call a UMAT with each row of an array; see `OFFSETS` for its columns.

    Args:
        address: Address of `dolfinmpm_umat`.
        properties: Material properties, shape (properties,).
        numbers: NDI, NSHR, NTENS, NSTATV, NPROPS and NOEL, shape (6,).
        name: CMNAME, 80 bytes.
        work: Data of the points, shape (n, columns); read and written.
        status: Written: 0 or the number of a failure, shape (n,).
    """
    for p in range(work.shape[0]):
        work[p, _PNEWDT] = 1.0
        status[p] = call_umat(
            address, work.ctypes.data + 8 * p * work.shape[1], properties.ctypes.data,
            numbers.ctypes.data, name.ctypes.data,
        )  # fmt: skip
