"""The common style of all pictures, and their files."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import choice, number, shown
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm._platform.filepaths import file_path

__all__ = ["LOOK", "check_picture", "check_size", "figure", "save", "two_numbers"]

# Points along a side of the largest picture
_WIDEST = 2**15
# Least dots per inch: letters have some dots then
_LEAST_DPI = 10.0

# Okabe & Ito's colours can be told apart by the colour-blind
LOOK = {
    "font.size": 8,
    "axes.labelsize": 8,
    "axes.titlesize": 8,
    "axes.linewidth": 0.6,
    "axes.grid": True,
    "axes.formatter.min_exponent": 2,
    "axes.axisbelow": True,
    "axes.prop_cycle": "cycler('color', ['0072B2', 'D55E00', '009E73', 'CC79A7', "
    "'E69F00', '56B4E9', '000000'])",
    "grid.color": "0.9",
    "grid.linewidth": 0.5,
    "legend.fontsize": 7,
    "legend.frameon": False,
    "lines.linewidth": 1.2,
    "lines.markersize": 3.5,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "mathtext.fontset": "dejavusans",
}


@contextlib.contextmanager
def figure(
    path: str | os.PathLike[str],
    width: float = 3.5,
    height: float = 2.6,
    *,
    dpi: int = 300,
    **subplots: Any,
) -> Iterator[tuple[Any, Any]]:
    """A Matplotlib figure in the common style, saved at the end of its context.

    `with mpm.figure("output/error.png") as (fig, ax): ax.loglog(h, error)`. Not collective: all
    ranks may call it, or rank 0 alone. Only rank 0 saves the figure.

    Args:
        path: File to write. Its ending selects the format (.png, .pdf, ...). Parent folders are
            created.
        width: Width (inch); 3.5 is one column of a paper.
        height: Height (inch).
        dpi: Dots per inch.
        subplots: Arguments of Matplotlib's `Figure.subplots`, such as nrows and ncols.

    Raises:
        ParameterError: An argument has the wrong type or a value outside its range.
        OSError: The file cannot be written; on rank 0 only.

    >>> import dolfinmpm as mpm
    >>> from pathlib import Path
    >>> from tempfile import mkdtemp
    >>> file = Path(mkdtemp(), "error.png")
    >>> with mpm.figure(file, dpi=50) as (fig, ax):
    ...     line = ax.loglog([0.1, 0.2], [0.01, 0.04])
    >>> file.exists()
    True
    """
    import matplotlib
    from matplotlib.figure import Figure

    check_picture(path)
    check_size((width, height), dpi)
    with matplotlib.rc_context(LOOK):
        result = Figure(figsize=(width, height), layout="constrained")
        try:
            axes = result.subplots(**subplots)
        except (TypeError, ValueError) as error:
            raise ParameterError(
                f"figure cannot make its axes: {error}; it takes the arguments of Matplotlib's "
                "Figure.subplots"
            ) from error
        yield result, axes
        if MPI.COMM_WORLD.rank == 0:
            save(result, path, dpi)


def check_size(size: Any, dpi: Any = 300) -> None:
    """Raise ParameterError if width and height (inch), or dots per inch, are not positive."""
    if min(two_numbers("size", size)) <= 0:
        raise ParameterError(f"size = {shown(size)} inch must be two positive numbers")
    number("dpi", dpi, _LEAST_DPI, closed=True)
    if max(size) * dpi > _WIDEST:
        raise ParameterError(
            f"size = {shown(size)} inch with dpi = {dpi:g} makes a picture of more than {_WIDEST} "
            "points a side, which takes minutes and gigabytes; give less of one"
        )


def two_numbers(what: str, values: Any) -> tuple[float, float]:
    """Two numbers, or a ParameterError with the argument's name."""
    if not isinstance(values, (tuple, list, np.ndarray)) or len(values) != 2:
        raise ParameterError(f"{what} = {shown(values)} must be two numbers")
    return number(f"{what}[0]", values[0]), number(f"{what}[1]", values[1])


def check_picture(path: Any, cmap: Any = None) -> None:
    """Raise ParameterError if Matplotlib cannot write the format, or lacks the colour map."""
    from matplotlib.backend_bases import FigureCanvasBase

    ending = file_path("path", path).suffix[1:].lower()
    known = FigureCanvasBase.filetypes
    if ending not in known:
        raise ParameterError(
            f"the path of a picture ends in .png, .pdf, ..., got '{path}'; Matplotlib writes "
            f"{', '.join(sorted(known))}"
        )
    check_colours(cmap)


def check_colours(cmap: Any) -> None:
    """Raise ParameterError if Matplotlib lacks a colour map."""
    import matplotlib
    from matplotlib.colors import Colormap

    if cmap is None or isinstance(cmap, Colormap):
        return
    if not isinstance(cmap, str) or cmap not in matplotlib.colormaps:
        names = [name for name in matplotlib.colormaps if not name.endswith("_r")]
        near = choice("cmap", cmap, names)
        raise ParameterError(f"cmap = {shown(cmap)} is {near!r} in Matplotlib: write it so")


def save(result, path: str | os.PathLike[str], dpi: int) -> None:
    """Write a Matplotlib figure, and create its parent folders."""
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        result.savefig(path, dpi=dpi, bbox_inches="tight", pad_inches=0.03)
    except OSError as cause:
        raise OSError(f"cannot write the picture {path}: {cause}") from cause
