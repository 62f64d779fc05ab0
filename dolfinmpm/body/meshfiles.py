"""Mesh files that meshio reads, and what is said of those that it does not."""

from __future__ import annotations

import contextlib
import io
from typing import Any

import numpy as np

from dolfinmpm._platform.filepaths import existing_file

__all__ = ["read_mesh"]


def read_mesh(path: Any) -> Any:
    """A `meshio.Mesh` from a file.

    Args:
        path: The file.

    Raises:
        OSError: There is no file, or it is none that meshio reads, or is broken.
        ParameterError: It is no path.
    """
    import meshio

    # meshio ends the interpreter where a file is not there
    file = existing_file("mesh", path)
    said = io.StringIO()
    try:
        # its reader of Gmsh's files prints empty lines, and why a file is none
        # a file of text passes for one of numbers until its length is looked at
        quiet = np.errstate(over="ignore")
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said), quiet:
            return meshio.read(file)
    except (Exception, SystemExit) as error:
        # readers of broken files end in any error, and meshio in the interpreter's end
        why = " ".join(said.getvalue().split()) if isinstance(error, SystemExit) else str(error)
        raise OSError(
            f"meshio cannot read {file}, which is broken, or of another kind than its ending says: "
            f"{why or type(error).__name__}"
        ) from error
