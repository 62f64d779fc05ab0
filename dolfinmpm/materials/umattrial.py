"""One call of a UMAT in a process of its own, between guard values."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.errors import UserLawError
from dolfinmpm.materials import umatprobe
from dolfinmpm.materials.umatprobe import GUARDS
from dolfinmpm.materials.umatshim import OFFSETS, SIZES

__all__ = ["try_umat"]

Array = npt.NDArray[np.float64]

_LONGEST = 60.0  # seconds of one call
_SHOWN = 1500  # characters of output in a message
_STOPPED = 77  # exit code after XIT, see the shim
# two values of the guards: results that differ come from a read beyond an array
_VALUES = (3.1, 17.7)
# tensors and other arrays of a row, by their names in the interface
_TENSORS = ("STRESS", "STRAN", "DSTRAN")
_OTHERS = ("TIME", "DTIME", "COORDS", "DROT", "CELENT", "DFGRD0", "DFGRD1")


def try_umat(
    library: str,
    law: str,
    properties: Array,
    name: npt.NDArray[np.uint8],
    row: Array,
    components: int,
    variables: Sequence[str],
) -> None:
    """Call a UMAT twice with different guards, each in a process of its own.

    Args:
        library: Path of the compiled library.
        law: The law, for messages.
        properties: PROPS, shape (NPROPS,).
        name: CMNAME, 80 bytes.
        row: Data of a point, see `OFFSETS`.
        components: NTENS.
        variables: Names of the state variables.

    Raises:
        UserLawError: It crashes, stops, or reads or writes beyond an array.
    """
    task: dict[str, Any] = {
        "library": library, "name": bytes(name).decode(), "ntens": components, "ndi": 3,
        "nshr": components - 3, "nstatv": len(variables), "nprops": properties.size,
        "PROPS": properties.tolist(), "PNEWDT": [1.0],
    }  # fmt: skip
    for argument in _TENSORS + _OTHERS:
        start = OFFSETS[argument.lower()]
        size = components if argument in _TENSORS else SIZES[argument.lower()]
        task[argument] = row[start : start + size].tolist()
    start = OFFSETS["statev"]
    task["STATEV"] = row[start : start + len(variables)].tolist()
    results = [_call({**task, "guard": value}, law) for value in _VALUES]
    for argument, found in results[0].items():
        if found["behind"] or found["before"]:
            raise UserLawError(_beyond(law, argument, found["behind"], properties, variables))
    changed = [
        argument
        for argument, found in results[0].items()
        if not np.array_equal(found["values"], results[1][argument]["values"], equal_nan=True)
    ]
    if changed:
        raise UserLawError(
            f"{law} reads numbers beyond an array: {', '.join(changed)} depend on what lies behind "
            f"the arrays. It has {properties.size} properties and {len(variables)} state "
            "variables: give as many as the UMAT reads"
        )


def _call(task: dict[str, Any], law: str) -> dict[str, Any]:
    """The result of one call in a process of its own."""
    read, write = os.pipe()
    # -I: neither the current folder nor the environment counts
    command = [sys.executable, "-I", str(Path(umatprobe.__file__)), str(write)]
    try:
        done = subprocess.run(
            command, input=json.dumps(task), capture_output=True, text=True, pass_fds=[write],
            timeout=_LONGEST,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        os.close(read)
        raise UserLawError(
            f"{law} does not return within {_LONGEST:g} s from a strain increment of "
            f"{task['DSTRAN']} at the stress {task['STRESS']} Pa"
        ) from None
    finally:
        os.close(write)
    with os.fdopen(read) as pipe:
        text = pipe.read()
    if done.returncode == 0 and text:
        return json.loads(text)
    said = (done.stdout + done.stderr).strip()[-_SHOWN:]
    said = f"; it wrote:\n{said}" if said else ""
    if done.returncode < 0:
        end = f"crashes with {signal.Signals(-done.returncode).name}"
    elif done.returncode == _STOPPED:
        end = "stops the analysis by a call of XIT"
    else:
        end = f"ends the program with the exit code {done.returncode}"
    raise UserLawError(
        f"{law} {end} when it is called with NTENS = {task['ntens']}, the stress {task['STRESS']} "
        f"Pa, the strain increment {task['DSTRAN']}, {task['nprops']} properties and "
        f"{task['nstatv']} state variables{said}"
    )


def _beyond(law: str, argument: str, behind: int, properties: Array, variables) -> str:
    size = {"STATEV": len(variables), "PROPS": properties.size}.get(argument)
    if not behind or size is None:
        return f"{law} writes beyond the array {argument}"
    at_least = behind if behind < GUARDS else f"{GUARDS} or more"
    advice = (
        f"give state={size + behind} or more" if argument == "STATEV" else "give all properties"
    )
    return f"{law} writes {at_least} numbers behind the {size} numbers of {argument}: {advice}"
