"""The gallery: a card per program, with filters."""

from __future__ import annotations

import html
import tomllib
from pathlib import Path
from typing import Any

import judged
import programs
from docutils import nodes
from docutils.parsers.rst import Directive
from sphinx.addnodes import pending_xref

SITE = Path(__file__).resolve().parent
FILTERS = ("physics", "dimension", "basis", "solver")
Entries = dict[str, dict[str, dict[str, Any]]]


def entries() -> Entries:
    """The cards by kind, "demos" or "studies", and by name."""
    return tomllib.loads((SITE / "gallery.toml").read_text())


def raw(text: str) -> nodes.raw:
    return nodes.raw("", text, format="html")


def link(docname: str, title: str, here: str) -> nodes.paragraph:
    return nodes.paragraph(
        "",
        "",
        pending_xref(
            "",
            nodes.inline("", title),
            refdomain="std",
            reftype="doc",
            reftarget=docname,
            refexplicit=True,
            refdoc=here,
            refwarn=True,
        ),
    )


class Gallery(Directive):
    """Cards of all programs, and choices that filter them."""

    def run(self) -> list[nodes.Node]:
        env = self.state.document.settings.env
        env.note_dependency(str(SITE / "gallery.toml"))
        found = entries()
        shown: list[nodes.Node] = [raw(_choices(found))]
        for kind, cards in found.items():
            for name, card in cards.items():
                if (
                    Path(env.srcdir, kind, name)
                    .with_suffix(".rst" if kind == "demos" else ".md")
                    .exists()
                ):
                    shown += _card(env, kind, name, card)
        return [*shown, raw("</div>")]


def _card(env: Any, kind: str, name: str, card: dict[str, Any]) -> list[nodes.Node]:
    import studies

    title = programs.title(kind, name)
    if kind == "demos":
        picture = f"demos/images/thumb/sphx_glr_{name}_thumb.png"
        off = judged.told(name, card.get("assertions", (0,)))
        env.note_dependency(str(judged.FOLDER / f"{name}.json"))
    else:
        drawn = [file for file in studies.pictures(name) if file.suffix != ".mp4"]
        picture = f"studies/pictures/{drawn[0].name}" if drawn else ""
        off = "; ".join(studies.measured(card)).replace("**", "") or studies.printed(name, card)
    data = " ".join(f'data-{key}="{html.escape(card[key])}"' for key in FILTERS)
    parts: list[nodes.Node] = [raw(f'<div class="gallery-card" {data}>')]
    if picture and Path(env.srcdir, picture).exists():
        parts.append(nodes.image(uri=f"/{picture}", alt=title))
    tags = "".join(f"<span>{html.escape(card[key])}</span>" for key in FILTERS)
    off = f"<br><b>{html.escape(off)}</b>" if off else ""
    text = (
        f'<p class="judged">{html.escape(card["judged"])}{off}</p><p class="tags">{tags}</p></div>'
    )
    return [*parts, link(f"/{kind}/{name}", title, env.docname), raw(text)]


def _choices(found: Entries) -> str:
    lines = ['<div class="gallery-filters">']
    for key in FILTERS:
        values = sorted({card[key] for cards in found.values() for card in cards.values()})
        options = "".join(f"<option>{html.escape(value)}</option>" for value in values)
        lines.append(
            f'<label>{key} <select data-filter="{key}"><option value="">all</option>'
            f"{options}</select></label>"
        )
    lines.append('<span class="gallery-count" aria-live="polite"></span></div>')
    return "".join([*lines, '<div class="gallery-cards">'])
