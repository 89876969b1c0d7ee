"""Pictures from files and arrays, as policies see them: (h, w, 3) uint8, upright, red first."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps, UnidentifiedImageError

from playlearn.errors import UsageError

Picture = NDArray[np.uint8]
Size = tuple[int, int]  # (height, width)

COLOR = ("RGB", "RGBA", "P", "CMYK", "YCbCr")  # Pillow's modes of 8 bits a color
ASPECT = 0.03  # by which two shapes of pictures may differ: rounding to whole pixels


def resized(picture: Picture, size: Size) -> Picture:
    """The picture (h, w, 3) uint8 resized to (height, width)."""
    return picture if picture.shape[:2] == size else np.asarray(Image.fromarray(picture).resize(size[::-1]))


def read_picture(path: Path, size: Size, *, keep_aspect: bool = True) -> Picture:
    """The picture in a file, scaled to (height, width), turned upright as its camera says.

    keep_aspect: refuse a picture of another shape; else it is squeezed.

    Raises:
        UsageError: it is no color picture, is in part transparent, smaller than `size` or of another shape.
    """
    try:
        with Image.open(path) as file:
            opened = ImageOps.exif_transpose(file)
            if opened.mode not in COLOR:
                raise UsageError(f"{path} is a picture of mode {opened.mode}, and a color picture is read: take it so")
            if opened.has_transparency_data and np.asarray(opened.convert("RGBA"))[..., 3].min() < 255:
                raise UsageError(f"{path} is in part transparent: put it on a background, as a camera would see it")
            picture = np.asarray(opened.convert("RGB"))
    except UnidentifiedImageError as error:
        raise UsageError(f"{path} is no picture that can be read: give a PNG or JPEG file") from error
    except OSError as error:
        raise UsageError(f"{path} cannot be read ({error.strerror or error})") from error
    _check(path, (picture.shape[0], picture.shape[1]), size, keep_aspect=keep_aspect)
    return resized(picture, size)


def fits(found: Size, size: Size) -> bool:
    """Whether a picture of the size `found` can be scaled to `size`: it is no smaller, and of the same shape."""
    return found[0] >= size[0] and found[1] >= size[1] and abs(found[0] * size[1] / (found[1] * size[0]) - 1) <= ASPECT


def check_picture(picture: object, size: Size, what: str) -> None:
    """Raises UsageError where an array is no picture (h, w, 3) uint8 of this size. what: it is, for the message."""
    array = np.asarray(picture)
    if array.shape == (*size, 3) and array.dtype == np.uint8:
        return
    wanted = f"{what} must be {size[0]}x{size[1]} pixels, (height, width, 3) uint8"
    shape, advice = array.shape, "`playlearn.load_goal` reads it from a file"
    if array.dtype != np.uint8 and shape == (*size, 3):
        advice = "give whole numbers, 0 to 255"
    elif len(shape) == 2 or shape[-1:] == (1,):
        advice = "it has one channel: give it in color"
    elif shape[-1:] == (4,):
        advice = "it has four channels: leave the last one, alpha, out"
    elif len(shape) == 3 and shape[0] in (3, 4) and shape[2] != 3:
        advice = "its channels come first: move that axis to the end"
    raise UsageError(f"{wanted}, here it is {shape} {array.dtype}; {advice}")


def _check(path: Path, found: Size, size: Size, *, keep_aspect: bool) -> None:
    """Raises UsageError where the picture is too small or, where that is kept, of another shape."""
    own, wanted = f"{found[0]}x{found[1]}", f"{size[0]}x{size[1]}"
    if found[0] < size[0] or found[1] < size[1]:
        raise UsageError(f"{path} is {own} (height, width), less than the {wanted} that are seen: take a larger one")
    if keep_aspect and abs(found[0] * size[1] / (found[1] * size[0]) - 1) > ASPECT:
        raise UsageError(
            f"{path} is {own} (height, width), of another shape than the {wanted} that are seen: cut it to that shape, "
            "or give `keep_aspect=False` where the images of the play were squeezed in the same way"
        )
