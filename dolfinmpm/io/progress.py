"""Loads of a stepwise computation, with a progress bar."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

from mpi4py import MPI

from dolfinmpm._platform.argumentchecks import check_kind, whole

__all__ = ["progress", "progress_to", "steps"]

Item = TypeVar("Item")


def steps(number: int, *, label: str = "") -> Iterator[float]:
    """Loads 1/number, 2/number, ..., 1 with a progress bar on rank 0.

    The bar is drawn if standard error is a terminal. Under mpirun it usually is no terminal. The
    environment variable DOLFINMPM_PROGRESS=1 always draws the bar, and DOLFINMPM_PROGRESS=0 never
    draws it.

    Args:
        number: Number of steps, at least 1.
        label: Text before the bar.

    Returns:
        An iterator over the shares of the load (-), the last one exactly 1.

    Raises:
        ParameterError: The number is not a whole number of at least 1.

    >>> import dolfinmpm as mpm
    >>> list(mpm.steps(4))
    [0.25, 0.5, 0.75, 1.0]
    """
    count = whole("number of steps", number, 1)
    check_kind("label", label, str, "the text before the bar")
    # checked here, because a generator would check only at the first step
    return (k / count for k in progress(range(1, count + 1), label))


def progress(items: Sequence[Item], label: str = "") -> Iterator[Item]:
    """The items one after the other, with a progress bar on rank 0 as `steps` draws it."""
    check_kind("label", label, str, "the text before the bar")
    bar = _bar(len(items), label, "step")
    try:
        for item in items:
            yield item
            if bar is not None:
                bar.update()
    finally:
        if bar is not None:
            bar.close()


@contextlib.contextmanager
def progress_to(duration: float, label: str = "") -> Iterator[Callable[[float], None]]:
    """A progress bar in simulated time, as `steps` draws it.

    Args:
        duration: Time to be simulated (s).
        label: Text before the bar.

    Returns:
        A context with a function of the time since the start (s). The function moves the bar.
    """
    bar = _bar(duration, label, "s")
    if bar is None:
        yield lambda t: None
        return
    try:
        yield lambda t: bar.update(t - bar.n)
    finally:
        bar.close()


def _bar(number: float, label: str, unit: str):
    """A tqdm bar if it would be visible, else None."""
    forced = os.environ.get("DOLFINMPM_PROGRESS", "")
    shown = forced == "1" or (forced != "0" and sys.stderr is not None and sys.stderr.isatty())
    if not shown or MPI.COMM_WORLD.rank != 0:
        return None
    try:
        from tqdm import tqdm
    except ImportError:
        return None
    return tqdm(total=number, desc=label or None, unit=unit, file=sys.stderr)
