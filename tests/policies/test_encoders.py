"""Laws of the encoders: what they may read, and how goals are withheld."""

import dataclasses
import json
import shutil
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from playlearn.config import from_dict, to_dict
from playlearn.errors import UsageError
from playlearn.policies import Policy, PolicyConfig
from playlearn.policies.encoders.cameras import pixels, random_shift
from playlearn.policies.encoders.cnn import SpatialSoftmax
from playlearn.policies.encoders.objects import ObjectTokens
from playlearn.policies.encoders.tokens import TokenPool
from tests.policies.parts import ENCODERS, SPEC, Examples, examples, generator, policy, spreads

ESTIMATE = {"state_supervision": 1.0, "use_estimated_state": True}


@pytest.mark.parametrize("fusion", ["early", "late"])
@pytest.mark.parametrize("more", [{}, ESTIMATE])
def test_an_image_policy_never_acts_on_the_true_achieved(fusion: str, more: dict[str, object]) -> None:
    made = policy("cnn", encoder_options={"fusion": fusion, **more}).eval()
    batch, other = examples(), examples(seed=3)
    blind = dataclasses.replace(batch, achieved=other.achieved, goal_achieved=other.goal_achieved)
    assert torch.equal(made.act(batch, generator()), made.act(blind, generator()))
    assert not torch.equal(made.loss(batch, generator())[0], made.loss(blind, generator())[0]) or not more


@pytest.mark.parametrize("encoder", ENCODERS)
def test_a_withheld_goal_leaves_no_trace(encoder: str) -> None:
    made = policy(encoder).eval()
    batch, other = examples(), examples(seed=3)
    elsewhere = dataclasses.replace(batch, goal_achieved=other.goal_achieved, goal_images=other.goal_images)
    keep = torch.zeros(5, dtype=torch.bool)
    one, two = (made.encoder(made.normalized(inputs), keep) for inputs in (batch, elsewhere))
    assert torch.equal(one.goal, two.goal)
    assert torch.equal(one.steps, two.steps)


@pytest.mark.parametrize("encoder", [kind for kind in ENCODERS if policy(kind).cameras])
def test_a_camera_may_have_dots_in_its_name(encoder: str, tmp_path: Path) -> None:
    """As BEHAVIOR's `observation.images.rgb.head`: the same policy, whatever its cameras are called."""
    named = {"front": "rgb.head", "wrist": "rgb.left.wrist"}
    plain = policy(encoder)
    written = json.dumps(to_dict(plain.config))
    for camera, name in named.items():
        written = written.replace(f'"{camera}"', f'"{name}"')
    spec = dataclasses.replace(SPEC, cameras={named[camera]: size for camera, size in SPEC.cameras.items()})
    dotted = from_dict(PolicyConfig, json.loads(written)).build(spec, spreads(), 0)
    dotted.save(tmp_path)
    seen = examples()
    images = {named[camera]: frames for camera, frames in seen.images.items()}
    goals = {named[camera]: frames for camera, frames in seen.goal_images.items() if camera == "front"}
    renamed = dataclasses.replace(seen, images=images, goal_images=goals)
    acted = Policy.load(tmp_path).act(renamed, generator())
    assert torch.equal(acted, plain.eval().act(seen, generator()))


@pytest.mark.parametrize("fusion", ["early", "late"])
def test_with_an_estimate_too_a_withheld_goal_leaves_no_trace(fusion: str) -> None:
    made = policy("cnn", encoder_options={"fusion": fusion, **ESTIMATE}).eval()
    batch, other = examples(), examples(seed=3)
    elsewhere = dataclasses.replace(batch, goal_images=other.goal_images)
    assert torch.equal(made.act(batch, generator(), guidance=0.0), made.act(elsewhere, generator(), guidance=0.0))


def test_the_auxiliary_loss_trains_the_estimate_and_the_policy_only_if_configured() -> None:
    """Detached, the policy's loss gives the estimate's own layers no gradient; attached, it does."""
    for detached in (True, False):
        made = policy("cnn", encoder_options={**ESTIMATE, "detach_estimate": detached})
        batch = examples()
        keep = torch.ones(5, dtype=torch.bool)
        features, extra = made._features(made.normalized(batch), keep, None)
        features.square().sum().backward(retain_graph=True)
        layers = list(made.encoder.estimate.parameters())
        assert all(p.grad is None for p in layers) == detached
        extra["achieved"].backward()
        assert all(p.grad is not None for p in layers)


def test_goal_names_choose_what_a_goal_speaks_of() -> None:
    made = policy("state", encoder_options={"goal_names": ["red.*"]}).eval()
    batch = examples()
    lamp, red = batch.goal_achieved.clone(), batch.goal_achieved.clone()
    lamp[:, SPEC.achieved_names.index("lamp")] += 1
    red[:, SPEC.achieved_names.index("red.x")] += 1
    plain = made.act(batch, generator())
    assert torch.equal(made.act(dataclasses.replace(batch, goal_achieved=lamp), generator()), plain)
    assert not torch.equal(made.act(dataclasses.replace(batch, goal_achieved=red), generator()), plain)
    with pytest.raises(UsageError, match=r"'green\.\*' matches none of: red\.x"):
        policy("state", encoder_options={"goal_names": ["green.*"]})


def test_a_policy_that_is_left_without_a_goal_is_refused_by_name() -> None:
    with pytest.raises(UsageError, match=r"encoder\.goal_names is \[\].*without a goal; name some of red\.x"):
        policy("state", encoder_options={"goal_names": []})
    with pytest.raises(UsageError, match=r"this play records none: the policy is left without a goal"):
        PolicyConfig().build(dataclasses.replace(SPEC, achieved_names=()), None, seed=0)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"cameras": ["wrist"]}, "goal_camera 'front' is not among"),
        ({"cameras": ["front", "side"]}, "wants camera 'side'"),
        ({"use_estimated_state": True}, "needs encoder.state_supervision above 0"),
    ],
)
def test_a_config_that_cannot_be_built_says_why(options: dict[str, object], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        policy("cnn", encoder_options=options)


def test_torchvision_names_and_weights_are_checked() -> None:
    with pytest.raises(UsageError, match="'resnet_18' is no torchvision classifier"):
        policy("torchvision", encoder_options={"name": "resnet_18"})
    with pytest.raises(UsageError, match="'BEST'"):
        policy("torchvision", encoder_options={"weights": "BEST"})


def test_weights_that_cannot_be_fetched_are_one_message(monkeypatch: pytest.MonkeyPatch) -> None:
    def unreachable(*_: object, **__: object) -> None:
        raise OSError("no route to host")

    monkeypatch.setattr("torchvision.models._api.WeightsEnum.get_state_dict", unreachable)
    with pytest.raises(UsageError, match=r"cannot be downloaded \(no route to host\); set encoder.weights to null"):
        policy("torchvision", encoder_options={"weights": "DEFAULT"})


def test_pixels_are_channels_last_in_minus_one_to_one() -> None:
    frames = torch.tensor([0, 255], dtype=torch.uint8).view(2, 1, 1, 1).expand(2, 4, 4, 3)
    out = pixels(frames.contiguous())
    assert out.shape == (2, 3, 4, 4)
    assert out.is_contiguous(memory_format=torch.channels_last)
    assert (out[0] == -1).all()
    assert (out[1] == 1).all()


def test_a_shift_moves_all_frames_of_an_example_alike() -> None:
    """A picture whose value is its place shows by how much it was moved: never beyond the limit."""
    place = torch.arange(16 * 16, dtype=torch.int32).view(1, 1, 16, 16, 1).expand(64, 2, 16, 16, 1)
    moved = random_shift(place.contiguous(), 2, generator())
    assert torch.equal(moved[:, 0], moved[:, 1])
    center = moved[:, 0, 8, 8, 0] - place[0, 0, 8, 8, 0]
    down, right = torch.div(center + 2, 16, rounding_mode="floor"), (center + 2) % 16 - 2
    assert set(down.tolist()) == set(right.tolist()) == {-2, -1, 0, 1, 2}


def test_spatial_softmax_finds_a_peak() -> None:
    """One hot pixel at row 0, column 4 of 5 x 5 is x = 1, y = -1; it is worth 50 there and 2 on the mean."""
    maps = torch.zeros(1, 1, 5, 5)
    maps[0, 0, 0, 4] = 50.0
    out = SpatialSoftmax(1, 5, 5)(maps)
    torch.testing.assert_close(out, torch.tensor([[1.0, -1.0, 50.0, 2.0]]))


BLOCKS = dataclasses.replace(
    SPEC,
    state_names=("eef.x", "eef.y", "gripper.opening"),
    achieved_names=("red.x", "red.y", "drawer.opening", "blue.x", "blue.y"),
)


def object_tokens(
    goal_names: tuple[str, ...] = ("*",),
) -> tuple[ObjectTokens, torch.Tensor, torch.Tensor, torch.Tensor]:
    torch.manual_seed(0)
    made = ObjectTokens(BLOCKS, goal_names, hidden=16, width=8)
    draw = generator()
    return made, *(torch.randn(shape, generator=draw) for shape in ((4, 2, 3), (4, 2, 5), (4, 5)))


def test_objects_of_one_kind_are_seen_through_the_same_weights() -> None:
    """Blocks that trade places trade tokens, but for the name that each token carries; the drawer's stays."""
    made, state, achieved, goal = object_tokens()
    keep = torch.ones(4, dtype=torch.bool)
    swap = torch.tensor([3, 4, 2, 0, 1])
    with torch.no_grad():
        made.kinds[0].name.zero_()
        tokens = made(state, achieved, goal, keep)  # red, blue, drawer, robot
        swapped = made(state, achieved[..., swap], goal[:, swap], keep)
    assert tokens.shape == (4, 2, made.count, 8)
    torch.testing.assert_close(swapped, tokens[:, :, [1, 0, 2, 3]])
    assert not torch.allclose(tokens[:, :, 0], tokens[:, :, 1])


def test_an_object_token_depends_only_on_its_object_and_the_gripper() -> None:
    """Moving blue, or blue's goal, leaves the tokens of red, the drawer and the robot as they were."""
    made, state, achieved, goal = object_tokens()
    keep = torch.ones(4, dtype=torch.bool)
    before = made(state, achieved, goal, keep)
    moved, wanted = achieved.clone(), goal.clone()
    moved[..., 3] += 1.0
    wanted[:, 4] -= 1.0
    after = made(state, moved, wanted, keep)
    changed = [(before[:, :, i] - after[:, :, i]).abs().max().item() > 1e-6 for i in range(made.count)]
    assert changed == [False, True, False, False]
    near = made(state + torch.tensor([0.5, 0.0, 0.0]), achieved, goal, keep)
    changed = [(before[:, :, i] - near[:, :, i]).abs().max().item() > 1e-6 for i in range(made.count)]
    assert changed == [True, True, False, True]  # a drawer has no place of its own


def test_the_cameras_that_are_fed_must_be_there_and_show_a_goal() -> None:
    with pytest.raises(UsageError, match="'side' is not among"):
        policy("cnn", encoder_options={"feed_cameras": ["side"]})
    with pytest.raises(UsageError, match="use_estimated_state"):
        policy("cnn", encoder_options={"feed_cameras": ["wrist"]})
    fed = policy("cnn", encoder_options={**ESTIMATE, "fusion": "late", "feed_cameras": ["wrist"]})
    assert set(fed.encoder.project) == {"wrist"}


def test_a_goal_changes_nothing_of_what_is_looked_at_until_something_is_learned() -> None:
    """FiLM starts as the identity: the tokens of a step are at first the same with any goal, and none after a step."""
    made = policy("tokens")
    batch, other = examples(), examples(seed=3)
    elsewhere = dataclasses.replace(batch, goal_images=other.goal_images)
    keep = torch.ones(5, dtype=torch.bool)

    def steps(inputs: Examples) -> torch.Tensor:
        return made.encoder(made.normalized(inputs), keep).steps

    assert torch.equal(steps(batch), steps(elsewhere))
    optimizer = torch.optim.SGD(made.parameters(), lr=0.1)
    made(batch, generator())[0].backward()
    optimizer.step()
    assert not torch.allclose(steps(batch), steps(elsewhere))


def test_a_token_is_what_is_under_its_map_and_where() -> None:
    """A map that is all in one corner, row 0 and column 4 of 5 x 5, gives that corner's channels and x = 1, y = -1."""
    pool = TokenPool(2, 1)
    with torch.no_grad():
        pool.attend.weight.copy_(torch.tensor([1.0, 0.0]).view(1, 2, 1, 1))
        maps = torch.zeros(1, 2, 5, 5)
        maps[0, :, 0, 4] = torch.tensor([50.0, -3.0])
        torch.testing.assert_close(pool(maps), torch.tensor([[[50.0, -3.0, 1.0, -1.0]]]), atol=1e-4, rtol=0)


def test_layers_of_an_image_tokens_encoder_must_match() -> None:
    with pytest.raises(UsageError, match=r"one each a layer \(2, 3, 2\)"):
        policy("tokens", encoder_options={"kernels": [3, 3, 3]})


TINY = {"hidden_size": 16, "num_hidden_layers": 1, "num_attention_heads": 2, "intermediate_size": 16, "patch_size": 8}
BACKBONES = {
    "vit": TINY,
    "dinov2": {key: value for key, value in TINY.items() if key != "intermediate_size"},
    "convnextv2": {"hidden_sizes": [8, 16], "depths": [1, 1], "num_stages": 2},
}


@pytest.mark.parametrize("name", BACKBONES)
def test_a_vision_model_is_built_by_its_name(name: str) -> None:
    """All that is to be trained gets a gradient; what features never depend on (a masked patch's token) is not."""
    made = policy("transformers", encoder_options={"name": name, "options": BACKBONES[name]}, goal_dropout=0.5)
    made(examples(8), generator())[0].backward()
    assert [n for n, p in made.named_parameters() if p.requires_grad and p.grad is None] == []


def small_vit(path: Path) -> None:
    """A folder as the hub keeps them: a ViT of three channels for 16 x 16 images."""
    from transformers import ViTConfig, ViTModel

    torch.manual_seed(5)
    ViTModel(ViTConfig(image_size=16, **TINY)).save_pretrained(path)


@pytest.mark.parametrize("fusion", ["early", "late"])
def test_weights_are_used_kept_frozen_and_never_asked_for_again(fusion: str, tmp_path: Path) -> None:
    small_vit(tmp_path / "hub")
    options = {"weights": str(tmp_path / "hub"), "frozen": True, "fusion": fusion, "options": {}}
    made = policy("transformers", encoder_options=options)
    held = load_file(tmp_path / "hub" / "model.safetensors")["embeddings.patch_embeddings.projection.weight"]
    state = made.state_dict()
    name = next(key for key in state if key.startswith("encoder.front") and key.endswith("projection.weight"))
    # fused early, two images share the weights: of the same image twice they see what one image showed
    images = 2 if fusion == "early" else 1
    torch.testing.assert_close(state[name], held.repeat(1, images, 1, 1) / images)
    before = {key: value.clone() for key, value in state.items() if ".model." in key}
    optimizer = torch.optim.SGD((p for p in made.parameters() if p.requires_grad), lr=0.1)
    made.train()(examples(), generator())[0].backward()
    optimizer.step()
    assert all(torch.equal(made.state_dict()[key], value) for key, value in before.items())
    made.save(tmp_path / "policy")
    shutil.rmtree(tmp_path / "hub")
    loaded = Policy.load(tmp_path / "policy")
    assert torch.equal(loaded.act(examples(), generator()), made.eval().act(examples(), generator()))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"name": "resnt", "options": {}}, "encoder.name 'resnt'"),
        ({"name": "bert", "options": {}, "fusion": "late"}, "'bert' does not read a 16x16 image"),
        ({"name": "vit", "options": {"depth": 3}}, "the config of vit has no field 'depth'"),
        ({"frozen": True}, "frozen needs encoder.weights"),
        ({"weights": "nowhere/at-all"}, "'nowhere/at-all' cannot be loaded.*set encoder.weights to null"),
    ],
)
def test_a_vision_model_that_cannot_be_says_why(
    options: dict[str, object], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unreachable(*_: object, **__: object) -> None:
        raise OSError("no route to host")

    monkeypatch.setattr("transformers.AutoConfig.from_pretrained", unreachable)
    with pytest.raises(UsageError, match=message):
        policy("transformers", encoder_options=options)


def test_a_frozen_torchvision_body_needs_weights() -> None:
    with pytest.raises(UsageError, match="frozen needs"):
        policy("torchvision", encoder_options={"frozen": True})
