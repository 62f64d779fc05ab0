"""A process that calls a UMAT once, between guard values; run as a script, without the package.

It reads a task as JSON from its input, calls the UMAT, and writes the result as JSON to the file
descriptor of its first argument. The caller sees a crash as the end of this process.
"""

from __future__ import annotations

import ctypes
import json
import os
import sys

__all__ = ["GUARDS", "SIZES", "call"]

GUARDS = 64  # numbers before and behind each array
# Arrays of doubles in the order of the interface, with their sizes; names are sizes of the task
SIZES = (
    ("STRESS", "ntens"), ("STATEV", "nstatv"), ("DDSDDE", "ntens2"), ("SSE", 1), ("SPD", 1),
    ("SCD", 1), ("RPL", 1), ("DDSDDT", "ntens"), ("DRPLDE", "ntens"), ("DRPLDT", 1),
    ("STRAN", "ntens"), ("DSTRAN", "ntens"), ("TIME", 2), ("DTIME", 1), ("TEMP", 1), ("DTEMP", 1),
    ("PREDEF", 1), ("DPRED", 1), ("CMNAME", 0), ("NDI", 0), ("NSHR", 0), ("NTENS", 0),
    ("NSTATV", 0), ("PROPS", "nprops"), ("NPROPS", 0), ("COORDS", 3), ("DROT", 9), ("PNEWDT", 1),
    ("CELENT", 1), ("DFGRD0", 9), ("DFGRD1", 9), ("NOEL", 0), ("NPT", 0), ("LAYER", 0),
    ("KSPT", 0), ("JSTEP", 0), ("KINC", 0),
)  # fmt: skip


def call(task: dict) -> dict:
    """Call `umat_` of a library between guards.

    Args:
        task: "library"; "guard", the value of the guards; "ntens", "nstatv", "nprops", "ndi",
            "nshr"; and first values of arrays by their names.
    """
    umat = ctypes.CDLL(task["library"]).umat_
    umat.restype = None
    sizes = {**task, "ntens2": task["ntens"] ** 2}
    whole = {"NPT": 1, "LAYER": 1, "KSPT": 1, "KINC": 1, "NOEL": 1, "JSTEP": 1}
    whole |= {name: task[name.lower()] for name in ("NDI", "NSHR", "NTENS", "NSTATV", "NPROPS")}
    arguments: list = []
    arrays = {}
    for name, size in SIZES:
        if name == "CMNAME":
            arguments.append(ctypes.create_string_buffer(task["name"].ljust(80).encode(), 80))
        elif name in whole:
            arguments.append((ctypes.c_int * 4)(*[whole[name]] * 4))
        else:
            number = size if isinstance(size, int) else sizes[size]
            given = task.get(name, [0.0] * number)
            values = [task["guard"]] * GUARDS + list(given) + [task["guard"]] * GUARDS
            block = (ctypes.c_double * len(values))(*values)
            arrays[name] = (block, number)
            arguments.append(ctypes.byref(block, 8 * GUARDS))
    umat(*arguments, ctypes.c_size_t(80))
    result = {}
    for name, (block, number) in arrays.items():
        values = list(block)
        before, after = values[:GUARDS], values[GUARDS + number :]
        damaged = [k for k, v in enumerate(after) if v != task["guard"]]
        result[name] = {
            "values": values[GUARDS : GUARDS + number],
            "behind": damaged[-1] + 1 if damaged else 0,
            "before": any(v != task["guard"] for v in before),
        }
    return result


if __name__ == "__main__":
    found = call(json.load(sys.stdin))
    with os.fdopen(int(sys.argv[1]), "w") as out:
        json.dump(found, out)
