"""Films: of a run while it goes, or of files that `ParaView` has written."""

from __future__ import annotations

import contextlib
import math
import os
import pickle
import re
import tempfile
import weakref
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import check_kind, choice, number, shown
from dolfinmpm._platform.collective import collective
from dolfinmpm._platform.errors import DolfinMPMWarning, ParameterError, call_together, warn
from dolfinmpm._platform.filepaths import file_path
from dolfinmpm._platform.uncopied import Unchanged
from dolfinmpm.basis.refinement import leaves_on
from dolfinmpm.body.location import bounds
from dolfinmpm.body.points import MaterialPoints
from dolfinmpm.body.pyvistamesh import domains, load_pyvista
from dolfinmpm.contact.rigidbody import RigidBody, check_bodies
from dolfinmpm.io.encoding import ENDINGS, ffmpeg, join
from dolfinmpm.io.figures import check_colours, check_size
from dolfinmpm.io.frames import Frame, Series, present_frame
from dolfinmpm.io.gridlines import grid_lines, lines_of_lattice
from dolfinmpm.io.ownership import refuse_other, take_paths
from dolfinmpm.io.plots import (
    DRAW,
    check_colour,
    check_limits,
    default_draw,
    label_of,
    prefix_of,
    scalar_of,
)
from dolfinmpm.io.scene import Scene

__all__ = ["Film", "animate"]

Array = npt.NDArray[Any]


@dataclass(frozen=True)
class _Look:
    """How frames are drawn; the arguments of `animate`."""

    colour: str
    component: int | tuple[int, int] | str | None
    limits: tuple[float, float] | None
    view: tuple | str
    draw: str
    title: str
    cmap: str
    size: tuple[float, float]
    dpi: int
    rate: float


def _comm_of(film: Film, *_: Any, **__: Any) -> MPI.Intracomm:
    return film._comm


class Film(Unchanged):
    """A film of a run: call `write(time)` after each step, and `close()`, or use it in `with`.

    `mpm.animate(points, path, ...)` makes it. Frames are kept in a folder for temporary files until
    the film is closed. Then all of them are drawn with one range of colours.

    Attributes:
        path: The film that `close` writes.

    >>> import dolfinmpm as mpm
    >>> from mpi4py import MPI
    >>> grid = mpm.create_lattice(MPI.COMM_WORLD, [range(5), range(5)])
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (4, 2)), per_cell=2, density=2000.0)
    >>> from pathlib import Path
    >>> from tempfile import mkdtemp
    >>> film = mpm.animate(points, Path(mkdtemp(), "block.gif"), "density", size=(2, 2), dpi=50)
    >>> for time in (0.0, 1.0):
    ...     film.write(time)
    >>> film.close()
    >>> film.path.exists()
    True
    """

    def __init__(
        self,
        points: MaterialPoints,
        path: Path,
        look: Any = None,
        bodies: Sequence[RigidBody] = (),
    ):
        check_kind("look", look, _Look, "make a film with mpm.animate(points, path)")
        self.path = path
        self._points, self._bodies = points, list(bodies)
        self._look: _Look = look
        self._comm = points.comm
        # made on rank 0 alone, which is the rank that draws
        self._folder = tempfile.TemporaryDirectory() if self._comm.rank == 0 else None
        self._frames = 0
        self._extent = np.column_stack(bounds(points.grid))
        self._lines = self._present_lines()
        self._unit = points.unit_of(look.colour)
        take_paths(self, [path])
        self._undrawn = [0]  # number of frames, for a film that nobody closes
        weakref.finalize(self, _leave, self._comm, path, self._folder, self._undrawn)

    def __enter__(self) -> Film:
        """The film itself."""
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        """Close it; after an error too: the film then ends at the last frame."""
        if kind is None or self._frames > 0:
            self.close()
        elif self._folder is not None:
            self._folder.cleanup()

    @collective(comm_of=_comm_of)
    def write(self, time: float) -> None:
        """Add a frame with the present state. Collective.

        Args:
            time: Time (s), or share of the load; shown above the picture.

        Raises:
            ParameterError: The time is not finite, the film is closed, or another film has begun
                at this path in the meantime.
            OSError: There is no room for temporary files.
        """
        points, colour = self._points, self._look.colour
        if self._frames < 0:
            raise ParameterError(f"the film {self.path} is closed: make another one")
        call_together(self._comm, lambda: refuse_other(self, self.path, "film"))
        call_together(self._comm, lambda: number("time", time))
        refined = leaves_on(points.grid) is not None
        lines = self._present_lines() if refined else None
        frame = present_frame(points, colour, self._bodies, self._extent, lines, time)

        def keep() -> None:
            if self._folder is not None:
                file = Path(self._folder.name, f"frame{self._frames:06d}")
                file.write_bytes(pickle.dumps(frame))

        call_together(self._comm, keep)
        self._frames += 1
        self._undrawn[0] = self._frames

    def _present_lines(self) -> Array | None:
        """Lines of the grid, or of the leaves that there are now. Collective."""
        points = self._points
        return grid_lines(points.grid, None) if points.gdim == 2 else None

    @collective(comm_of=_comm_of)
    def close(self) -> None:
        """Draw all frames and write the film. Collective.

        Raises:
            ParameterError: There is no frame.
            MissingPackageError: There is no ffmpeg for .mp4, or no PyVista for points in 3D.
            OSError: The film cannot be written.
        """
        if self._frames < 0:
            return
        count, self._frames = self._frames, -1
        self._undrawn[0] = 0

        def draw() -> None:
            folder = self._folder or contextlib.nullcontext()
            with folder:
                if count == 0:
                    raise ParameterError(
                        "a film needs a frame or more; call write(time) after steps"
                    )
                if self._folder is None:
                    return
                folder = self._folder
                read = lambda k: pickle.loads(Path(folder.name, f"frame{k:06d}").read_bytes())  # noqa: E731
                _draw_all(read, count, self.path, self._look, self._extent, self._lines, self._unit)

        call_together(self._comm, draw)


def _leave(comm: MPI.Comm, path: Path, folder: Any, frames: list[int]) -> None:
    """Warn of a film that has frames and was never closed: at its end, or at that of the run."""
    if frames[0] > 0 and folder is not None:
        folder.cleanup()
        warn(
            comm,
            f"the film {path} has frames, and was never closed: no file is written. Use it in "
            "`with mpm.animate(...) as film:`, or call film.close()",
            DolfinMPMWarning,
        )


@collective
def animate(
    source: Any,
    path: str | os.PathLike[str],
    colour: str = "stress",
    *,
    component: int | tuple[int, int] | str | None = None,
    limits: tuple[float, float] | None = None,
    view: str | tuple = "grid",
    draw: str | None = None,
    title: str = "t = {time:.3g}",
    cmap: str = "viridis",
    size: tuple[float, float] = (6.0, 4.0),
    dpi: int = 150,
    rate: float = 10.0,
    bodies: Sequence[RigidBody] = (),
) -> Film | None:
    """A film of the material points as .mp4 or .gif. Collective.

    In 1D and 2D Matplotlib draws as `plot` does, also the leaves of a refined space as they are at
    the time of the frame. In 3D PyVista draws the domains of the points.

    Args:
        source: The .pvd file of a series that `ParaView` has written: the film is written at once.
            Or material points, or a problem: then a `Film` is returned, and each `write(time)`
            adds a frame.
        path: Film to write: .mp4 (needs ffmpeg, or the package imageio-ffmpeg) or .gif (needs
            Pillow, which Matplotlib has). Parent folders are created.
        colour: Name of a field of the points, or "displacement" (m).
        component: See `plot`.
        limits: Range of colours, in the field's unit. By default the range over all frames.
        view: "grid", or ranges (m) of the axes, ((x0, x1), (y0, y1)).
        draw: "deformed", "domains" or "dots", see `plot`.
        title: Text above the picture; {time} is the time of the frame.
        cmap: Matplotlib colour map.
        size: Largest width and height of the axes with the colour bar (inch).
        dpi: Dots per inch.
        rate: Frames per second.
        bodies: Rigid bodies to draw. A series has those that were written.

    Returns:
        None, or a `Film` to be used in `with`.

    Raises:
        ParameterError: An argument has the wrong type or value.
        CheckpointError: The series cannot be read.
        MissingPackageError: There is no ffmpeg for .mp4, or no PyVista for points in 3D.
        OSError: The film cannot be written.

    A film of a block that is pressed down:

    >>> import dolfinmpm as mpm
    >>> from dolfinx.mesh import CellType, create_unit_square
    >>> from mpi4py import MPI
    >>> grid = create_unit_square(MPI.COMM_WORLD, 4, 4, CellType.quadrilateral)
    >>> points = mpm.fill(grid, mpm.Box((0, 0), (1, 0.75)), per_cell=2, density=1.0)
    >>> V = mpm.Space(grid, "gimp")
    >>> F = mpm.momentum(mpm.materials.Hencky(1.0, 0.0), points, V.increment, V.test)
    >>> down = mpm.prescribed(V, "top", 1, increment=-0.01)
    >>> problem = mpm.QuasiStatic(F, V.increment, points, mpm.fixed(V, "bottom"))
    >>> import tempfile
    >>> file = f"{tempfile.mkdtemp()}/block.gif"
    >>> with mpm.animate(points, file, size=(2, 2), dpi=50) as film:
    ...     for share in (0.5, 1.0):
    ...         film.write(share)
    """
    points = getattr(source, "points", source)
    comm = points.comm if isinstance(points, MaterialPoints) else MPI.COMM_WORLD

    def check() -> tuple[Path, _Look]:
        file = file_path("path", path)
        if file.suffix not in ENDINGS:
            raise ParameterError(f"the path of a film ends in .mp4 or .gif, got '{file}'")
        if comm.rank == 0 and file.suffix == ".mp4":
            ffmpeg()
        if comm.rank == 0 and isinstance(points, MaterialPoints) and points.gdim == 3:
            # to be told before the run, and not after it
            load_pyvista()
        check_limits(limits)
        check_size(size, dpi)
        number("rate", rate, 1e-3, 1e3, "frames per second", closed=True)
        if comm.rank == 0:
            check_colours(cmap)
        check_kind("title", title, str, '"t = {time:.2f} s"')
        try:
            title.format(time=1.0)
        except (KeyError, IndexError, ValueError) as cause:
            raise ParameterError(f"title = {title!r} may have {{time}} in it alone") from cause
        how = draw
        if how is None:
            how = default_draw(points) if isinstance(points, MaterialPoints) else "deformed"
        how = choice("draw", how, DRAW)
        return file, _Look(
            colour, component, limits, view, how, title, cmap, size, dpi, float(rate)
        )  # fmt: skip

    file, look = call_together(comm, check)
    if isinstance(points, MaterialPoints):
        call_together(comm, lambda: check_colour(points, colour, component, None, view))
        check_bodies(bodies, points.gdim)
        return Film(points, file, look, bodies)

    def of_series() -> None:
        if not isinstance(source, (str, os.PathLike)):
            raise ParameterError(
                f"source = {shown(source)} must be a .pvd file, material points, or a problem"
            )
        if comm.rank != 0:
            return
        series = Series(Path(source))
        lines = None
        if series.lines is not None and series.gdim == 2:
            lines = lines_of_lattice(*series.lines)
        read: Callable[[int], Frame] = lambda k: series.frame(k, colour)  # noqa: E731
        unit = series.units.get(colour, "")
        _draw_all(read, len(series), file, look, series.box, lines, unit)

    call_together(comm, of_series)
    return None


def _draw_all(read, count: int, path: Path, look: _Look, extent, lines, unit: str) -> None:
    """Draw all frames with one range of colours, and join them."""
    low, high = math.inf, -math.inf
    for k in range(count):
        frame = read(k)
        values, _ = scalar_of(frame.values, look.component, frame.x.shape[1])
        values = values[np.isfinite(values)]
        low, high = min(low, values.min(initial=low)), max(high, values.max(initial=high))
    limits = look.limits or ((low, high) if high > low else None)
    scale, prefix = (1.0, "")
    if unit == "Pa":
        scale, prefix = prefix_of(
            np.array([0.0 if limits is None else max(map(abs, limits))]), None
        )
    shown_limits = None if limits is None else np.divide(limits, scale)
    with tempfile.TemporaryDirectory() as folder:
        pictures = []
        for k in range(count):
            picture = Path(folder, f"picture{k:06d}.png")
            frame = read(k)
            values, index = scalar_of(frame.values, look.component, frame.x.shape[1])
            label = label_of(look.colour, index, prefix + unit)
            draw = _draw_solid if frame.x.shape[1] == 3 else _draw_flat
            draw(frame, values / scale, label, shown_limits, picture, look, extent, lines)
            pictures.append(picture)
        join(pictures, path, look.rate)


def _draw_flat(frame, values, label, limits, picture, look: _Look, extent, lines) -> None:
    if frame.lines is not None:
        lines = frame.lines
    scene = Scene(
        frame.x, frame.edges(look.draw), values, label, look.draw == "dots", lines, limits, 5.0,
        look.cmap, look.size, frame.bodies,
    )  # fmt: skip
    title = look.title.format(time=frame.time)
    scene.write(picture, extent, look.view, None, title, look.dpi)


def _draw_solid(frame, values, label, limits, picture, look: _Look, extent, lines) -> None:
    """Domains in 3D by PyVista, seen from the front, the right and above."""
    mesh = domains(frame.x, frame.edges(look.draw))
    import pyvista

    mesh.cell_data["values"] = values
    pixels = [2 * int(side * look.dpi / 2) for side in look.size]
    plotter = pyvista.Plotter(off_screen=True, window_size=pixels)
    plotter.set_background("white")
    plain = re.sub(r"\$|\\mathrm|\\sigma|[{}]", lambda m: "σ" if "sigma" in m[0] else "", label)
    bar = {"title": plain.replace("\\ ", " "), "color": "black", "fmt": "%.3g", "n_labels": 5}
    plotter.add_mesh(
        mesh, scalars="values", clim=limits, cmap=look.cmap, scalar_bar_args=bar, ambient=0.3
    )
    for facets in frame.bodies:
        faces = np.column_stack(
            [np.full(len(facets), 3), np.arange(3 * len(facets)).reshape(-1, 3)]
        )
        surface = pyvista.PolyData(facets.reshape(-1, 3), faces.ravel())
        plotter.add_mesh(surface, color="grey", opacity=0.4)
    box = np.array(look.view, float) if not isinstance(look.view, str) else extent
    plotter.add_mesh(pyvista.Box(box.ravel()), style="wireframe", color="grey", line_width=1)
    plotter.add_text(look.title.format(time=frame.time), font_size=10, color="black")
    plotter.view_vector((1.0, -1.6, 0.8), viewup=(0, 0, 1))
    plotter.screenshot(picture)
    plotter.close()
