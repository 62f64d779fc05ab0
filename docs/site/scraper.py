"""What a program has written to output/ goes to its page: pictures and films."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import judged
from sphinx_gallery.scrapers import figure_rst

FILMS = Path(__file__).resolve().parents[1] / "_build" / "static" / "films"
VIDEO = """
.. raw:: html

    <video class="film" controls loop muted playsinline preload="metadata"
           src="../_static/films/{name}" aria-label="{label}"></video>
"""


def ffmpeg(*arguments: str) -> None:
    from dolfinmpm.io.encoding import ffmpeg as program

    subprocess.run([program(), "-y", "-loglevel", "error", *arguments], check=True)


def film(file: Path, name: str) -> str:
    """A film for browsers, .mp4 whatever it was, and what shows it on a page."""
    FILMS.mkdir(parents=True, exist_ok=True)
    target = FILMS / f"{name}.mp4"
    if file.suffix == ".mp4":
        shutil.copy(file, target)
    else:
        even = "scale=trunc(iw/2)*2:trunc(ih/2)*2"
        how = ("-vf", even, "-pix_fmt", "yuv420p", "-movflags", "+faststart")
        ffmpeg("-i", str(file), *how, str(target))
    return VIDEO.format(name=target.name, label=file.stem.replace("_", " "))


def last_picture(file: Path, target: Path) -> None:
    """The last picture of a film, for the card of the program."""
    ffmpeg("-sseof", "-1", "-i", str(file), "-update", "1", str(target))


# files that this process has opened to write, or has given to another program, since the last block
WRITTEN: set[Path] = set()
ENDINGS = {".png", ".gif", ".mp4"}


def _watch(event: str, arguments: tuple[Any, ...]) -> None:
    """Keeps the pictures and films that this process writes: see `sys.addaudithook`."""
    if event == "open" and isinstance(arguments[1], str) and set(arguments[1]) & set("wax+"):
        named = [arguments[0]]
    elif event == "os.rename":
        named = [arguments[1]]
    elif event == "subprocess.Popen":
        named = list(arguments[1])
    else:
        return
    for name in named:
        if isinstance(name, (str, Path)) and Path(name).suffix in ENDINGS:
            WRITTEN.add(Path(name).absolute())


sys.addaudithook(_watch)


class NewFiles:
    """Takes the pictures and films that the block of code before has written to output/.

    sphinx-gallery calls it after each block of a program, in the folder of the program. It knows
    figures of pyplot only; those of dolfinmpm are files. All programs write to one folder, and
    several processes run them at once, so neither names nor times tell whose a file is.
    """

    def __repr__(self) -> str:
        return "NewFiles"

    def __call__(self, block: Any, variables: dict[str, Any], conf: dict[str, Any]) -> str:
        program = Path(variables["src_file"])
        if entries := judged.judge(block[1], vars(variables["fake_main"])):
            judged.keep(program.stem, entries)
        mine = sorted(f for f in WRITTEN if f.parent.name == "output" and f.is_file())
        WRITTEN.clear()
        pictures, films = [], ""
        for file in mine:
            target = Path(next(variables["image_path_iterator"])).with_suffix(".png")
            if file.suffix == ".png":
                shutil.copy(file, target)
                pictures.append(str(target))
            else:
                films += film(file, f"{program.stem}_{file.stem}")
                last_picture(FILMS / f"{program.stem}_{file.stem}.mp4", target)
        WRITTEN.clear()
        return figure_rst(pictures, conf["src_dir"]) + films
