"""Write plots and pictures as PNG files, each whole or not at all."""

import io
from pathlib import Path
from typing import TYPE_CHECKING

from playlearn.config import atomic_write

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from PIL.Image import Image


def save_figure(figure: "Figure", path: Path, dpi: int) -> None:
    """Write a plot of matplotlib; raises DiskError where it cannot be written."""
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=dpi, format="png")
    atomic_write(path, buffer.getvalue())


def save_picture(picture: "Image", path: Path) -> None:
    """Write a picture of PIL; raises DiskError where it cannot be written."""
    buffer = io.BytesIO()
    picture.save(buffer, "PNG")
    atomic_write(path, buffer.getvalue())
