"""What is drawn: upright, a function of the state alone, in any size, and all that a full drawing would show."""

import gc
from typing import Any

import mujoco
import numpy as np
import pytest

from playlearn.bench.render import ssim
from playlearn.envs import PlayTableConfig
from playlearn.envs.playtable.env import PlayTableEnv, _paint
from playlearn.envs.playtable.scene import PlayTable
from playlearn.errors import RenderError
from playlearn.sim.rendering import renderer
from playlearn.sim.rendering.gl import our_context
from playlearn.sim.rendering.renderer import _Stage
from playlearn.sim.rendering.simplify import FINEST, simplified_model

SIZE = 84


@pytest.fixture(scope="module")
def env() -> PlayTableEnv:
    made = PlayTableConfig().build()
    try:
        made.renderer()
    except RenderError as error:
        pytest.skip(str(error))
    return made


@pytest.fixture(scope="module")
def states(env: PlayTableEnv) -> list[np.ndarray]:
    """The hand low over the table, tilted at its edge, looking far out, and held up."""
    kept = []
    ways = (
        (0.5, 0.2, -1, 0, 0, 0.2),
        (-0.5, 1, -0.6, 0.3, -0.4, 0.5),
        (0.6, -1, -0.5, 0.3, -0.4, 0.5),
        (1, 0, 0.8, 0, 0.4, 0),
    )
    for seed, way in enumerate(ways):
        env.reset(seed)
        for step in range(24):
            env.step(np.array([*way, 1 if step > 12 else -1]))
        kept.append(env.sim_state())
    return kept


@pytest.fixture(scope="module")
def fine(env: PlayTableEnv) -> _Stage:
    """The scene as it is: every triangle of it."""
    return _Stage(simplified_model(mujoco.MjSpec.from_string(env._xml), env._home, 2 * FINEST), _paint)


def drawn_at_once(stage: _Stage, env: PlayTableEnv, camera: str, height: int, width: int) -> np.ndarray:
    """(2 h, 2 w, 3): everything there is in one picture, whether it can be seen or not."""
    stage.draw(env.data.qpos, env._shown(), camera, height, width)  # puts everything in place
    image = np.empty((2 * height, 2 * width, 3), np.uint8)
    with pytest.MonkeyPatch.context() as patch, our_context():
        patch.setattr(stage._cover, "seen", lambda *_: (np.ones(stage._model.ngeom, bool), True))
        stage._shoot(stage._model.camera(camera).id, stage._visual, True, image, None)
    return image


def halved(image: np.ndarray) -> np.ndarray:
    height, width = image.shape[0] // 2, image.shape[1] // 2
    sums = image[::-1].reshape(height, 2, width, 2, 3).astype(int).sum(axis=(1, 3))
    return (sums + 2) // 4


@pytest.mark.slow
def test_a_stored_state_is_drawn_as_it_was_live(env: PlayTableEnv) -> None:
    env.reset(0)
    for _ in range(5):
        env.step(np.array([0.3, 0.2, -0.5, 0, 0, 0.3, -1]))
    live, state = env.observe(("front", "wrist")), env.sim_state()
    env.reset(1)
    env.set_state(state)
    for camera, image in live.images.items():
        np.testing.assert_array_equal(env.render(camera), image)


@pytest.mark.slow
def test_a_picture_does_not_depend_on_what_was_drawn_before(
    env: PlayTableEnv, states: list[np.ndarray], fine: _Stage
) -> None:
    """Other cameras, sizes and lamps; another renderer of the same process; another process would begin so."""
    env.set_state(states[0])
    before = {camera: env.render(camera) for camera in ("front", "wrist")}
    for camera, height, width in (("wrist", 40, 90), ("front", 100, 200), ("agentview", 64, 96), ("front", 60, 90)):
        env.set_state(states[1])
        env.switch(True)
        env.render(camera, height, width)
    fine.draw(env.data.qpos, env._shown(), "front", 32, 32)
    anew = PlayTableConfig().build()
    for other in (env, anew):
        other.set_state(states[0])
        for camera, image in before.items():
            np.testing.assert_array_equal(other.render(camera), image)


@pytest.mark.slow
def test_robosuite_draws_beside_us(env: PlayTableEnv, states: list[np.ndarray]) -> None:
    """Each in its own context: neither what it draws with nor what it forgets is the other's."""
    their_env: Any = None
    pictures: list[tuple[np.ndarray, np.ndarray]] = []
    env.set_state(states[0])
    for _ in range(2):
        their_env = PlayTable(has_renderer=False, has_offscreen_renderer=True, use_camera_obs=False)
        their_env.reset()  # forgets a context, which is collected some time later
        their_env.sim.data.qpos[:] = env.data.qpos
        their_env.sim.forward()
        their_env.sim._render_context_offscreen.gl_ctx.make_current()  # once: we are to leave it so
        for _ in range(2):
            theirs = their_env.sim.render(camera_name="wrist", width=64, height=64)[::-1]
            pictures.append((theirs, env.render("wrist")))
    their_env = None
    gc.collect()
    pictures.append((theirs, env.render("wrist")))
    for theirs, ours in pictures:
        np.testing.assert_array_equal(theirs, pictures[0][0])
        np.testing.assert_array_equal(ours, pictures[0][1])
        assert ssim(theirs, ours) > 0.9


@pytest.mark.slow
@pytest.mark.parametrize("camera", ["front", "wrist", "agentview", "sideview"])
def test_what_is_left_out_cannot_be_seen(env: PlayTableEnv, states: list[np.ndarray], camera: str) -> None:
    """Out of view, covered by the table, or drawn once for all: to the last bit what one full drawing shows."""
    for state in states:
        env.set_state(state)
        picture = env.render(camera, 60, 80)
        stage = env._renderer._stage(60)
        np.testing.assert_array_equal(picture, halved(drawn_at_once(stage, env, camera, 60, 80)))


def test_something_is_left_out(env: PlayTableEnv, states: list[np.ndarray]) -> None:
    """Else the law above holds of nothing: low over the table there is no sky, and of what is under it nothing."""
    under = "table_visual", "table_leg3_visual", "fixed_mount0_pedestal_vis"
    kept = set()
    for state in states:
        env.set_state(state)
        env.render("wrist")
        stage = env._renderer._stage(64)
        seen, sky = stage._cover.seen(stage._data, stage._model.camera("wrist").id, 1.0)
        assert seen[stage._visual].mean() < 0.8
        kept.add((sky, *(bool(seen[stage._model.geom(name).id]) for name in under)))
    assert (False, False, False, False) in kept
    assert (True, True, True, True) in kept


@pytest.mark.slow
def test_at_its_size_a_picture_is_the_full_one(env: PlayTableEnv, states: list[np.ndarray], fine: _Stage) -> None:
    """Beside every triangle drawn, at this size and four times as large: leaving triangles out costs no likeness.

    What is short of 1 in the latter is the floor's far planks, in four samples a pixel: 0.9 where they fill the view.
    """
    for state in states:
        env.set_state(state)
        for camera in ("front", "wrist"):
            lean = env.render(camera, SIZE, SIZE)
            full, large = (fine.draw(env.data.qpos, env._shown(), camera, k * SIZE, k * SIZE) for k in (1, 4))
            reference = large.reshape(SIZE, 4, SIZE, 4, 3).mean(axis=(1, 3))
            assert ssim(lean, full) > 0.97
            assert ssim(lean, reference) > max(0.88, ssim(full, reference) - 0.01)


@pytest.mark.slow
def test_meshes_are_as_fine_as_the_image(env: PlayTableEnv, fine: _Stage) -> None:
    def drawn(stage: _Stage) -> int:
        model = stage._model
        meshes = stage._visual & (model.geom_type == mujoco.mjtGeom.mjGEOM_MESH)
        return int(model.mesh_facenum[model.geom_dataid[meshes]].sum())

    full, larger, small = (drawn(stage) for stage in (fine, env._renderer._stage(84), env._renderer._stage(64)))
    assert full > 150_000  # as robosuite's Panda on its mount has them
    assert larger < 0.2 * full
    assert small < 0.8 * larger


@pytest.mark.slow
def test_sizes_are_as_asked_and_agree_with_each_other(env: PlayTableEnv) -> None:
    env.reset(0)
    small, large = env.render("front", 60, 90), env.render("front", 240, 360)
    assert (small.shape, large.shape) == ((60, 90, 3), (240, 360, 3))
    reduced = large.reshape(60, 4, 90, 4, 3).mean(axis=(1, 3))
    assert np.abs(reduced - small).mean() < 4  # of 255: edges and far planks differ, the picture does not


def test_images_are_upright_and_the_robot_stands_behind(env: PlayTableEnv) -> None:
    """The nearer half of the table, which is empty and light, is at the bottom."""
    env.reset(0)
    image = env.render("front").astype(float)
    bottom = image[-10:].mean(axis=(0, 1))
    assert bottom.min() > 150
    assert image[:10].mean() < bottom.mean() - 20


@pytest.mark.slow
def test_colors_stand_where_the_blocks_do(env: PlayTableEnv) -> None:
    """Moving the red block along +y moves the red pixels to the right: the camera looks back at the robot."""
    env.reset(0)
    red = []
    for y in (-0.1, 0.05):
        env.put(0, [0.12, y, 0.8201], 0.0)
        env._refresh()
        image = env.render("front", 96, 144).astype(int)
        red.append((image[..., 0] > 90) & (image[..., 1] < 70) & (image[..., 2] < 70))
    left, came = red[0] & ~red[1], red[1] & ~red[0]
    assert min(left.sum(), came.sum()) > 10
    # 0.15 m of a view some 0.9 m wide is about 24 of 144 columns.
    assert 15 < np.nonzero(came)[1].mean() - np.nonzero(left)[1].mean() < 35


def test_the_lamp_is_seen_to_be_lit(env: PlayTableEnv) -> None:
    env.reset(0)
    pictures = []
    for lit in (False, True):
        env.switch(lit)
        pictures.append(env.render("front").astype(int))
    changed = np.abs(pictures[1] - pictures[0]).max(axis=2) > 60
    assert 8 < changed.sum() < 0.05 * changed.size  # a bulb of some pixels, and nothing else


def test_at_the_interpreters_end_a_context_goes_with_the_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """The module has lost its own names by then: none of them may be used."""
    stage = object.__new__(_Stage)
    stage._context = object()
    for name in ("sys", "our_context", "mujoco", "np"):
        monkeypatch.setattr(renderer, name, None)
    stage.__del__(lambda: True)
    stage._context = None
