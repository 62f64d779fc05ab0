"""Pictures of one size, joined to a film by ffmpeg, or to an animated GIF by Pillow."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dolfinmpm._platform.errors import MissingPackageError

__all__ = ["ENDINGS", "ffmpeg", "join"]

ENDINGS = (".mp4", ".gif")


def ffmpeg() -> str:
    """The program ffmpeg: of the system, or of the package imageio-ffmpeg.

    Raises:
        MissingPackageError: There is neither.
    """
    if found := shutil.which("ffmpeg"):
        return found
    try:
        from imageio_ffmpeg import get_ffmpeg_exe

        return get_ffmpeg_exe()
    except (ImportError, RuntimeError):
        raise MissingPackageError(
            "a film as .mp4 needs ffmpeg: install it (apt install ffmpeg, or pip install "
            "imageio-ffmpeg), or write a .gif"
        ) from None


def join(pictures: Sequence[Path], path: Path, rate: float) -> None:
    """Write the film. The pictures get the size of the largest one, with white borders.

    Args:
        pictures: PNG files in order.
        path: Film to write; ends in .mp4 or .gif.
        rate: Pictures per second.

    Raises:
        MissingPackageError: There is no ffmpeg for .mp4.
        OSError: The film cannot be written.
    """
    _same_size(pictures)
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".gif":
        _gif(pictures, path, rate)
        return
    names = pictures[0].parent / "%06d.png"
    for number, picture in enumerate(pictures):
        picture.rename(picture.with_name(f"{number:06d}.png"))
    # H.264 in 4:2:0 is what all browsers play
    command = [
        ffmpeg(), "-y", "-loglevel", "error", "-framerate", f"{rate:g}", "-i", str(names),
        "-c:v", "libx264", "-crf", "20", "-pix_fmt", "yuv420p", "-movflags", "+faststart",
        str(path),
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise OSError(f"cannot write the film {path}: ffmpeg says {done.stderr.strip()[-500:]}")


def _same_size(pictures: Sequence[Path]) -> None:
    """Pad pictures at the right and at the top; sides become even, as 4:2:0 needs."""
    from PIL import Image

    sizes = []
    for picture in pictures:
        with Image.open(picture) as image:
            sizes.append(image.size)
    width, height = (int(side + side % 2) for side in np.max(sizes, axis=0))
    for picture, size in zip(pictures, sizes):
        if size == (width, height):
            continue
        with Image.open(picture) as image:
            whole = Image.new("RGB", (width, height), "white")
            whole.paste(image.convert("RGB"), (0, height - size[1]))
        whole.save(picture)


def _gif(pictures: Sequence[Path], path: Path, rate: float) -> None:
    from PIL import Image

    frames = []
    for picture in pictures:
        with Image.open(picture) as image:
            frames.append(image.convert("RGB").quantize(128))
    try:
        frames[0].save(path, save_all=True, append_images=frames[1:], duration=1000 / rate, loop=0)
    except OSError as cause:
        raise OSError(f"cannot write the film {path}: {cause}") from cause
