"""Random fields by a few modes, equal on any number of ranks."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from dolfinmpm._platform.argumentchecks import (
    check_dictionary,
    check_kind,
    choice,
    coordinates,
    number,
    per_direction,
    shown,
    truth,
    whole,
)
from dolfinmpm._platform.errors import ParameterError
from dolfinmpm._platform.uncopied import Unchanged

__all__ = ["RandomField"]

Array = npt.NDArray[np.float64]

# Correlation over the scaled distance
_KERNELS = {"gaussian": lambda r: np.exp(-(r**2)), "exponential": lambda r: np.exp(-r)}
# Nodes per correlation length, and the most nodes of a field
_PER_LENGTH, _MOST = 4, 2500
# Kernels with a cusp lose much of their variance between nodes, in proportion to the distance:
# twice as many nodes per direction, some per mode, while the eigenvalues take about a second
_CUSPS, _PER_MODE, _FINE = ("exponential",), 4, 1600
# Share of the largest entry of a mode from which an entry counts as a peak
_PEAK = 1.0 - 1e-6
# Entries of a matrix of correlations that are in memory at once
_AT_ONCE = 2_000_000


class RandomField(Unchanged):
    """A lognormal or normal random field over a box, by its Karhunen–Loève modes.

    The field is exp(μ + σ Σ √λᵢ φᵢ(x) ξᵢ), or its exponent alone, with independent standard normal
    ξᵢ. The modes φᵢ solve ∫ C(x, y) φᵢ(y) dy = λᵢ φᵢ(x) by Nyström's method on the midpoints of a
    grid in the box. They have values anywhere, whatever points and ranks there are. The number of
    modes decides which share of the variance the field has. See Ghanem & Spanos (1991), *Stochastic
    finite elements*, chapter 2.

    Args:
        low, high: Corners of the box (m).
        lengths: Correlation length per direction (m), or one number. The correlation is
            exp(−r²), or exp(−r), with r² = Σ (Δxᵢ/lengthᵢ)².
        mean: Mean of the field.
        coefficient: Its coefficient of variation.
        modes: Number of modes.
        kernel: "gaussian" or "exponential".
        lognormal: Whether the logarithm of the field is normal.
        name: Start of the names of the parameters ξᵢ.

    Attributes:
        names: Names of ξᵢ.
        share: Share of the variance that the field has, between 0 and 1, as a mean over the box
            between the nodes.

    Raises:
        ParameterError: A value is outside its range, or the box has too many correlation lengths.

    >>> import dolfinmpm as mpm
    >>> field = mpm.study.RandomField((0, 0), (10, 5), 4.0, mean=20e3, coefficient=0.3, modes=6)
    >>> round(field.share, 2)
    0.95
    >>> xi = field.sample(seed=1)
    >>> len(xi), field.at([(5.0, 2.5)], xi).shape
    (6, (1,))
    >>> round(float(field.at([(5.0, 2.5)], {})[0]))
    19157
    """

    def __init__(
        self,
        low: Sequence[float],
        high: Sequence[float],
        lengths: float | Sequence[float],
        *,
        mean: float,
        coefficient: float,
        modes: int,
        kernel: str = "gaussian",
        lognormal: bool = True,
        name: str = "xi",
    ):
        self._low, self._high = coordinates("low", low), coordinates("high", high)
        gdim, ends = self._low.size, (self._low, self._high)
        if any(end.shape != (gdim,) or not 1 <= gdim <= 3 for end in ends) or not all(
            np.isfinite(end).all() for end in ends
        ):
            raise ParameterError(
                f"low = {shown(low)} and high = {shown(high)} must be two corners of a box, with 1 "
                "to 3 finite coordinates (m) each, such as (0, 0) and (10, 5)"
            )
        if not (self._high > self._low).all():
            raise ParameterError(
                f"high = {shown(high)} must be above low = {shown(low)} in each direction"
            )
        self._lengths = per_direction("lengths", lengths, gdim)
        for length in self._lengths:
            number("lengths", float(length), 0.0, unit="m")
        self._kernel = choice("kernel", kernel, _KERNELS)
        mean, coefficient = number("mean", mean), number("coefficient", coefficient, 0.0, 10.0)
        self._lognormal = truth("lognormal", lognormal)
        if self._lognormal:
            number("mean", mean, 0.0)
            self._deviation = math.sqrt(math.log1p(coefficient**2))
            self._middle = math.log(mean) - 0.5 * self._deviation**2
        else:
            self._middle, self._deviation = mean, coefficient * abs(mean)
        count = whole("modes", modes, 1, _MOST)
        check_kind("name", name, str, 'such as "xi"')
        self.names = [f"{name}{k + 1}" for k in range(count)]
        self.share = self._solve(count)

    def _numbers(self, count: int) -> npt.NDArray[np.int64]:
        """Numbers of nodes per direction, shape (gdim,), for a number of modes.

        Raises:
            ParameterError: The box has too many correlation lengths, or there are too many modes.
        """
        ratio = (self._high - self._low) / self._lengths
        nodes = np.maximum(np.ceil(_PER_LENGTH * ratio), 6.0)
        if (total := math.prod(nodes.tolist())) > _MOST:
            raise ParameterError(
                f"the box has {', '.join(f'{r:.3g}' for r in ratio)} correlation lengths, which "
                f"take {total:.4g} nodes; {_MOST} is the limit: take a smaller box or longer "
                "lengths"
            )
        numbers = nodes.astype(int)
        if self._kernel in _CUSPS:
            wanted = min(max(2**ratio.size * total, _PER_MODE * count), _FINE)
            factor = (wanted / total) ** (1 / ratio.size)
            numbers = np.maximum(numbers, np.floor(factor * numbers).astype(int))
        total = int(np.prod(numbers))
        if count > total:
            raise ParameterError(f"modes = {count} must be at most the number of nodes, {total}")
        return numbers

    def _solve(self, count: int) -> float:
        """Find the modes at the nodes; returns the share of the variance between the nodes."""
        # SciPy's algebra takes a second to import
        from scipy.linalg import eigh

        numbers = self._numbers(count)
        total = int(np.prod(numbers))
        widths = (self._high - self._low) / numbers
        # from the corner of the box: far from the origin, distances would lose digits
        lines = [(np.arange(n) + 0.5) * w for n, w in zip(numbers, widths)]
        self._nodes = np.stack([x.ravel() for x in np.meshgrid(*lines, indexing="ij")], axis=-1)
        # equal weights: eigenvalues as shares of the variance
        matrix = self._correlation(self._nodes) / total
        values, vectors = eigh(matrix, subset_by_index=(total - count, total - 1))
        values, vectors = np.maximum(values[::-1], 1e-14), vectors[:, ::-1]
        # the sign of an eigenvector is chance; in a mode with two equal peaks of opposite signs, so
        # is which of them is larger: the first one decides
        size = np.abs(vectors)
        at = np.argmax(size > _PEAK * size.max(axis=0), axis=0)
        vectors = vectors * np.sign(vectors[at, np.arange(count)])
        # √λ φ(x) = Σ C(x, xⱼ) vⱼ / √(λ total)
        self._vectors = vectors / np.sqrt(values * total)
        # With a cusp, Σ λ φ² is largest at the nodes, and has its mean over a cell a quarter of the
        # cell beside its node. The box is symmetric, so that one of the quarters stands for all.
        modes = self._correlation(self._nodes + widths / 4) @ self._vectors
        return min(float(np.mean(np.sum(modes**2, axis=1))), 1.0)

    def _correlation(self, x: Array) -> Array:
        scaled = x / self._lengths
        nodes = self._nodes / self._lengths
        square = np.sum((scaled[:, None, :] - nodes[None, :, :]) ** 2, axis=2)
        return np.asarray(_KERNELS[self._kernel](np.sqrt(square)))

    def at(self, x: npt.ArrayLike, xi: Mapping[str, float]) -> Array:
        """Values of the field, shape (n,).

        Args:
            x: Places (m), shape (n, gdim), such as `points["x"]`, or one place, shape (gdim,). On a
                line shape (n,) will do.
            xi: Name → ξ. Names that are not there count as zero; other names are left alone.

        Raises:
            ParameterError: The places have another dimension than the box, or one of them is not
                finite or more than a correlation length outside of it; or a ξ is no number.
        """
        places, gdim = coordinates("x", x), self._low.size
        fits = places.ndim > 0 and (gdim == 1 or places.shape[-1] == gdim or places.shape == (0,))
        if places.ndim > 2 or not fits or (gdim == 1 and places.shape[1:] not in {(), (1,)}):
            raise ParameterError(
                f"x has the shape {places.shape} and must have the shape (n, {gdim}): the box of "
                f"the field has {gdim} coordinates, so give those of each place"
            )
        places = places.reshape(-1, gdim)
        self._check_places(places)
        check_dictionary("xi", xi, " of numbers, such as field.sample(seed=1)")
        given = np.array([number(f"xi['{name}']", xi.get(name, 0.0)) for name in self.names])
        places = places - self._low
        at_nodes = self._vectors @ given
        # part by part: a matrix of all places and nodes may not fit in memory
        parts = np.array_split(places, max(1, math.ceil(places.size * len(at_nodes) / _AT_ONCE)))
        modes = np.concatenate([self._correlation(part) @ at_nodes for part in parts])
        exponent = self._middle + self._deviation * modes
        return np.asarray(np.exp(exponent) if self._lognormal else exponent)

    def _check_places(self, places: Array) -> None:
        """Raise an error about places that have next to nothing of the field.

        Raises:
            ParameterError: A place is not finite, or more than a correlation length outside the
                box: the modes fade there, and the field would be no random one.
        """
        out = np.maximum(self._low - places, places - self._high) / self._lengths
        bad = np.flatnonzero(~(out.max(axis=1, initial=0.0) <= 1.0))
        if bad.size:
            box = f"the box of the field, {self._low} to {self._high} m"
            raise ParameterError(
                f"x = {places[bad[0]]} m must be finite, and at most a correlation length, "
                f"{self._lengths} m, outside {box}, where its modes fade ({bad.size} such places "
                "here): make the box as large as the body"
            )

    def sample(self, seed: int) -> dict[str, float]:
        """Random ξ by their names, the same for the same seed and on all ranks.

        Args:
            seed: Seed of NumPy's generator, a whole number of at least 0.

        Raises:
            ParameterError: The seed is something else. Without a seed, ranks would differ.
        """
        rng = np.random.default_rng(whole("seed", seed, 0, math.inf))
        values = rng.standard_normal(len(self.names))
        return {name: float(xi) for name, xi in zip(self.names, values)}
