"""Puts the sources of the site together in docs/_build/source.

Sphinx writes beside its sources. Here that is a folder of its own, so the repository keeps only
what people write. A program becomes a page by sphinx-gallery: its docstring gives the title and the
reasons, its comments before a block of code become text. The programs of demos/ are plain programs:
a comment of several lines that stands at the margin after an empty line is taken for such a text.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from pathlib import Path

DOCS = Path(__file__).resolve().parents[1]
ROOT = DOCS.parent
BUILD = DOCS / "_build"
SOURCE = BUILD / "source"
PAGES = ("*.md", "*.bib", "*.png", "theory/*.*", "howto/*.*", "reference/*.md", "notebooks/*.ipynb")


def lecture(program: str) -> str:
    """The program with its title underlined and its longer comments as cells of text.

    Parameters
    ----------
    program
        The source of a Python program that begins with a docstring, whose first line is its title.
    """
    title, rest = program.removeprefix('"""').split("\n", 1)
    if title.endswith('"""'):
        title, rest = title.removesuffix('"""'), f'"""\n{rest}'
    title = title.rstrip(".")
    lines = [f'"""{title}', "=" * (len(title) + 3)]
    block: list[str] = []
    for line in rest.split("\n"):
        if line.startswith("#"):
            block.append(line)
            continue
        long = len(block) > 1 and not block[0].startswith("# %%") and lines[-1] == ""
        lines += ["# %%", *block] if long else block
        block = []
        lines.append(line)
    return "\n".join(lines + block)


def write(path: Path, text: str) -> None:
    """Writes a file if its text is new: what has not changed is not built again."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.exists() or path.read_text() != text:
        path.write_text(text)


def copy_pages() -> set[Path]:
    found = {file for pattern in PAGES for file in DOCS.glob(pattern) if file.is_file()}
    written = set()
    for file in found:
        target = SOURCE / file.relative_to(DOCS)
        written.add(target)
        target.parent.mkdir(parents=True, exist_ok=True)
        if not target.exists() or target.read_bytes() != file.read_bytes():
            shutil.copy(file, target)
    return written


def copy_programs() -> set[Path]:
    written = set()
    for folder, target in ((DOCS / "course", "course"), (ROOT / "demos", "demos")):
        for file in sorted(folder.glob("*.py")):
            place = BUILD / "programs" / target / file.name
            write(place, lecture(file.read_text()))
            written.add(place)
        header = DOCS / "site" / f"{target}_header.rst"
        write(BUILD / "programs" / target / "GALLERY_HEADER.rst", header.read_text())
    for file in sorted((ROOT / "demos" / "umat").iterdir()):
        write(BUILD / "programs" / "demos" / "umat" / file.name, file.read_text())
    return written


def forget(place: Path, kept: set[Path], patterns: tuple[str, ...]) -> None:
    """Removes copies whose originals are gone."""
    for pattern in patterns:
        for file in place.glob(pattern):
            if file.is_file() and file not in kept:
                file.unlink()


def digest(*texts: str) -> str:
    return hashlib.sha256("\0".join(texts).encode()).hexdigest()


def is_made(page: Path, *sources: Path) -> bool:
    """Whether a generated page is there, made with this package and these sources.

    If not, the caller makes it, and calls `mark_made`.
    """
    stamp = BUILD / "made" / page.name
    return page.exists() and stamp.exists() and stamp.read_text() == _key(*sources)


def mark_made(page: Path, *sources: Path) -> None:
    write(BUILD / "made" / page.name, _key(*sources))


def _key(*sources: Path) -> str:
    return digest((BUILD / "package").read_text(), *map(Path.read_text, sources))


def renew_results() -> None:
    """Lets all examples run again where the package has changed since they ran."""
    digest = hashlib.sha256()
    for file in sorted((ROOT / "dolfinmpm").rglob("*.py")):
        digest.update(file.read_bytes())
    stamp = BUILD / "package"
    if stamp.exists() and stamp.read_text() != digest.hexdigest():
        for sums in SOURCE.rglob("*.md5"):
            sums.unlink()
    write(stamp, digest.hexdigest())


def check_cards() -> None:
    """Ends the build where a demo has no card in the gallery, or a card no program."""
    import cards

    named = set(cards.entries()["demos"])
    there = {file.stem for file in (ROOT / "demos").glob("*.py")}
    if named != there:
        raise SystemExit(f"docs/site/gallery.toml: cards and demos differ: {sorted(named ^ there)}")


def main() -> None:
    SOURCE.mkdir(parents=True, exist_ok=True)
    made = {SOURCE / "reference" / name for name in ("errors.md", "laws.md")}
    forget(SOURCE, copy_pages() | made, PAGES)
    forget(BUILD / "programs", copy_programs(), ("*/*.py",))
    renew_results()
    import api
    import errorindex
    import lawpictures
    import studies

    check_cards()
    api.write_pages(write, SOURCE)
    errorindex.write_page(write, SOURCE)
    runs = os.environ.get("DOLFINMPM_SITE_EXAMPLES") != "none"
    lawpictures.write_page(write, SOURCE, runs)
    studies.run_studies(runs)


if __name__ == "__main__":
    main()
