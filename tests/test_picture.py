"""Goal pictures from files: scaled to what a policy sees, or refused with what to do."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from playlearn.episode import Array, Goal
from playlearn.errors import UsageError
from playlearn.picture import check_picture, read_picture
from playlearn.policies import PolicyActor
from tests.policies.parts import policy

SIZE = (24, 32)  # height, width


def scene(height: int = 48, width: int = 64) -> Array:
    """Red above, blue below."""
    picture = np.zeros((height, width, 3), np.uint8)
    picture[: height // 2, :, 0], picture[height // 2 :, :, 2] = 200, 200
    return picture


def saved(path: Path, array: Array, mode: str | None = None, **more: Any) -> Path:
    opened = Image.fromarray(array)
    (opened if mode is None else opened.convert(mode)).save(path, **more)
    return path


@pytest.mark.parametrize("mode", ["RGB", "RGBA", "P", "CMYK"])
def test_a_color_picture_is_scaled_and_stays_red_first(mode: str, tmp_path: Path) -> None:
    path = saved(tmp_path / ("goal.tiff" if mode == "CMYK" else "goal.png"), scene(), mode)
    picture = read_picture(path, SIZE)
    assert (picture.shape, picture.dtype) == ((*SIZE, 3), np.uint8)
    assert picture[3, 3, 0] > 150 > 50 > picture[3, 3, 2]
    assert picture[-3, 3, 2] > 150 > 50 > picture[-3, 3, 0]


def test_a_phone_that_was_held_sideways_is_turned_back(tmp_path: Path) -> None:
    """Orientation 6: what is stored must be turned by 90 degrees to the right."""
    exif = Image.Exif()
    exif[0x0112] = 6
    path = saved(tmp_path / "goal.jpg", np.rot90(scene()), exif=exif, quality=95)
    picture = read_picture(path, SIZE)
    assert picture[3, 3, 0] > 150
    assert picture[-3, 3, 2] > 150


def test_pictures_that_do_not_fit_are_refused_with_what_to_do(tmp_path: Path) -> None:
    half = np.dstack([scene(), np.full((48, 64), 90, np.uint8)])
    refused = {
        r"mode L, and a color picture is read": saved(tmp_path / "gray.png", scene()[..., 0]),
        r"mode I;16, and a color": saved(tmp_path / "deep.png", scene()[..., 0].astype(np.uint16) * 200),
        r"in part transparent: put it on a background": saved(tmp_path / "half.png", half),
        r"is 48x48 .* another shape than the 24x32 .* cut it": saved(tmp_path / "square.png", scene(48, 48)),
        r"is 64x48 .* another shape": saved(tmp_path / "upright.png", scene(64, 48)),
        r"is 12x16 .* less than the 24x32 .* larger one": saved(tmp_path / "small.png", scene(12, 16)),
        r"cannot be read \(No such file": tmp_path / "none.png",
    }
    (tmp_path / "text.png").write_text("no picture")
    for said, path in {**refused, r"is no picture that can be read": tmp_path / "text.png"}.items():
        with pytest.raises(UsageError, match=said):
            read_picture(path, SIZE)
    assert read_picture(tmp_path / "square.png", SIZE, keep_aspect=False).shape == (*SIZE, 3)


@pytest.mark.parametrize(
    ("picture", "said"),
    [
        (scene(48, 64), r"must be 24x32 pixels, .* here it is \(48, 64, 3\) uint8; .*load_goal"),
        (scene(24, 32)[..., 0], r"one channel: give it in color"),
        (np.zeros((24, 32, 4), np.uint8), r"leave the last one, alpha, out"),
        (np.zeros((3, 24, 32), np.uint8), r"its channels come first"),
        (np.zeros((24, 32, 3), np.float32), r"float32; give whole numbers, 0 to 255"),
    ],
)
def test_an_array_that_is_no_picture_of_that_size_is_named(picture: Array, said: str) -> None:
    with pytest.raises(UsageError, match=said):
        check_picture(picture, SIZE, "the goal image")


def test_an_actor_refuses_a_goal_image_of_another_size() -> None:
    actor = PolicyActor(policy("cnn"), n_action_steps=1)
    good = np.zeros((16, 16, 3), np.uint8)
    actor.reset([Goal(np.zeros(4, np.float32), {"front": good})], [0])
    with pytest.raises(UsageError, match=r"goal image of 'front' for policy must be 16x16 .* here it is \(16, 20, 3\)"):
        actor.reset([Goal(np.zeros(4, np.float32), {"front": np.zeros((16, 20, 3), np.uint8)})], [0])
