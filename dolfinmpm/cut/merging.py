"""Sums of blocks between the same fields, with each pair of nodes once."""

from __future__ import annotations

from collections.abc import Sequence

import numba
import numpy as np
import numpy.typing as npt

from dolfinmpm.cut.pattern import Blocks

__all__ = ["one_block_per_pair", "summed"]

Array = npt.NDArray[np.float64]
Nodes = npt.NDArray[np.int32]


@numba.njit(cache=True, error_model="numpy")
def _sum(rows, columns, values, start, order, place, new_rows, new_columns, new_values):
    """Sums of the values of each pair, by rows and columns. Returns the number of pairs.

    A counting sort brings the entries of a row together. `place` is -1 everywhere.
    """
    n, width = rows.size, values.shape[1]
    for e in range(n):
        start[rows[e] + 1] += 1
    for a in range(start.size - 1):
        start[a + 1] += start[a]
    for e in range(n):
        order[start[rows[e]]] = e
        start[rows[e]] += 1
    count = at = 0
    while at < n:
        row, first = rows[order[at]], count
        # the first position of each row has moved to its end
        for k in range(at, start[row]):
            column = columns[order[k]]
            if place[column] < 0:
                place[column] = 0
                # rows have few columns, mostly in order
                b = count
                while b > first and new_columns[b - 1] > column:
                    new_columns[b] = new_columns[b - 1]
                    b -= 1
                new_columns[b] = column
                count += 1
        for b in range(first, count):
            place[new_columns[b]] = b
            new_rows[b] = row
            for c in range(width):
                new_values[b, c] = 0.0
        for k in range(at, start[row]):
            e = order[k]
            b = place[columns[e]]
            for c in range(width):
                new_values[b, c] += values[e, c]
        for b in range(first, count):
            place[new_columns[b]] = -1
        at = start[row]
    return count


def summed(rows: Nodes, columns: Nodes, values: Array) -> tuple[Nodes, Nodes, Array]:
    """Sums of the values of each pair of nodes, ordered by rows and then by columns.

    Args:
        rows, columns: Nodes, shape (n,).
        values: Shape (n, ...).
    """
    n, width = rows.size, int(np.prod(values.shape[1:]))
    size = 1 + max(int(rows.max(initial=-1)), int(columns.max(initial=-1)))
    flat = np.ascontiguousarray(values).reshape(n, width)
    found_rows, found_columns, found = np.empty_like(rows), np.empty_like(rows), np.empty_like(flat)
    start, place = np.zeros(size + 1, np.int64), np.full(size, -1, np.int32)
    count = _sum(
        rows, columns, flat, start, np.empty(n, np.int32), place, found_rows, found_columns, found
    )
    shape = count, *values.shape[1:]
    return found_rows[:count], found_columns[:count], found[:count].reshape(shape)


def one_block_per_pair(blocks: Sequence[Blocks]) -> list[Blocks]:
    """One block per pair of fields, with the sums of all. Single blocks are not copied."""
    pairs: dict[tuple[int, int], list[Blocks]] = {}
    for b in blocks:
        pairs.setdefault((b.row_field, b.column_field), []).append(b)
    return [parts[0] if len(parts) == 1 else _joined(parts) for parts in pairs.values()]


def _joined(parts: Sequence[Blocks]) -> Blocks:
    rows, columns, values = (
        np.concatenate([getattr(b, name) for b in parts]) for name in ("rows", "columns", "values")
    )
    return Blocks(parts[0].row_field, parts[0].column_field, *summed(rows, columns, values))
