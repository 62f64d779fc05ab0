"""Short tables in HTML, by which notebooks show objects."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from typing import Any

__all__ = ["listing", "table"]


def _text(value: Any) -> str:
    shown = f"{value:.6g}" if isinstance(value, float) else str(value)
    return html.escape(shown)


def table(rows: Sequence[Mapping[str, Any]], caption: str = "") -> str:
    """A table with one line per mapping; all have the keys of the first."""
    names = list(rows[0]) if rows else []
    head = "".join(f"<th>{_text(name)}</th>" for name in names)
    cells = ["".join(f"<td>{_text(row[name])}</td>" for name in names) for row in rows]
    lines = "".join(f"<tr>{row}</tr>" for row in cells)
    top = f"<caption>{_text(caption)}</caption>" if caption else ""
    return f"<table>{top}<thead><tr>{head}</tr></thead><tbody>{lines}</tbody></table>"


def listing(entries: Mapping[str, Any], caption: str = "") -> str:
    """A table with one line per entry: its name and its value."""
    texts = [(_text(name), _text(value)) for name, value in entries.items()]
    lines = "".join(f"<tr><th>{name}</th><td>{value}</td></tr>" for name, value in texts)
    top = f"<caption>{_text(caption)}</caption>" if caption else ""
    return f"<table>{top}<tbody>{lines}</tbody></table>"
