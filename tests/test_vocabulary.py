"""The field's words: what was renamed does not come back, in code, configs, checkpoints and results.

Prose is free: "share" and "hold" are plain English. Identifiers, YAML keys, state-dict keys and JSON columns are not.
"""

import ast
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from safetensors import safe_open

from playlearn.policies import EncoderConfig, HeadConfig, TrunkConfig
from tests.policies.parts import policy

ROOT = Path(__file__).resolve().parents[1]

# What it is called now stands beside it, for whoever trips over it.
IDENTIFIERS = {
    "world": "env", "worlds": "envs", "driver": "skill_library", "Idea": "SkillOption",
    "Player": "PlayPolicy", "Teacher": "ExpertPolicy", "Hand": "EndEffector", "Leaning": "TiltedSkill",
    "Mixed": "DatasetMixture, DaggerActor", "Source": "DatasetSource", "Sharing": "InterventionRule",
    "Practice": "RolloutSpec", "Tried": "RolloutRecord", "practise": "collect_rollouts", "practice": "rollouts",
    "Drift": "GateSignal", "Latch": "HysteresisGate", "cohort": "batch, num_envs", "run_cohort": "run_batch",
    "Contender": "ActorRecipe", "contenders": "recipes", "Trained": "TrainedRecipe", "Stepwise": "HierarchicalRecipe",
    "Setup": "EvalEpisode", "Link": "ChainGoal", "Attempt": "EpisodeResult, SkillAttempt",
    "Track": "Trajectory, CurveGroup",
    "Thing": "GraspableObject", "find_cause": "classify_failure", "cause": "failure_mode",
    "Law": "ComponentDistribution",
    "eyes": "backbones", "proposer": "high_level", "believed": "estimate_achieved", "adopt": "load_from",
    "luck": "rng_state, uniforms", "sentence": "token_ids", "enter": "in_proj", "leave": "out_proj", "rise": "mlp_up",
    "fall": "mlp_down", "recogniser": "posterior_encoder", "goal_arm": "goal_proprio", "goal_body": "uses_goal_proprio",
    "goal_state": "goal_proprio, goal_sim_state", "crew": "workers", "bury": "join", "dismiss": "stop",
    "execute": "n_action_steps", "heldout": "val", "heldout_share": "val_fraction", "stray": "max_label_deviation",
    "detours": "allow_detours", "picture_share": "image_goal_prob", "feed_estimate": "use_estimated_state",
    "judged": "evaluated", "stretch": "switch_every", "thrown_away": "discarded", "agreeing": "close_after",
    "bow": "path_noise", "aimless": "idle", "told": "given, note", "said": "format_summary ...",
}  # fmt: skip
# In skills a hand does rise and leave; these are kept there.
PLAIN = {"envs": {"rise", "leave", "enter", "fall"}, "oracles": {"rise", "leave", "enter", "fall"}}
KEYS = {
    "agreeing", "aimless", "auxiliary", "bow", "cause", "causes", "cohort", "detours", "drift", "driven", "execute",
    "feed_estimate", "goal_arm", "goal_state", "heldout", "heldout_batches", "heldout_every", "heldout_share", "hold",
    "init", "judged", "judged_seed", "learn", "like", "more", "picture_share", "planned", "practice", "shares",
    "soft", "stray", "stretch", "thrown_away",
}  # fmt: skip
WEIGHTS = {
    "enter",
    "leave",
    "rise",
    "fall",
    "mix",
    "places",
    "told",
    "words",
    "eyes",
    "goal_eye",
    "recogniser",
    "normaliser",
}
KINDS = [
    (part, kind)
    for part, base in (("encoder", EncoderConfig), ("head", HeadConfig), ("trunk", TrunkConfig))
    for kind in sorted(base.get_known_choices())
]
BRITISH = re.compile(
    r"colour|centre|behaviour|normalis|labell|metre|neighbour|recognis|optimis|favour|practis", re.IGNORECASE
)


def names(path: Path) -> Iterator[tuple[int, str]]:
    """What a module itself gives a name to: classes, functions, parameters, variables, attributes."""
    for node in ast.walk(ast.parse(path.read_text())):
        match node:
            case ast.ClassDef() | ast.FunctionDef():
                yield node.lineno, node.name
            case ast.arg():
                yield node.lineno, node.arg
            case ast.Name(ctx=ast.Store()):
                yield node.lineno, node.id
            case ast.Attribute(ctx=ast.Store()):
                yield node.lineno, node.attr


ROOMS = sorted(path.name for path in (ROOT / "playlearn").iterdir() if path.name != "__pycache__")


@pytest.mark.parametrize("room", ROOMS)
def test_identifiers(room: str) -> None:
    place = ROOT / "playlearn" / room
    found = []
    for file in [place] if place.is_file() else sorted(place.rglob("*.py")):
        for line, name in names(file):
            bare = name if name.startswith("__") else name.strip("_")
            if (bare in IDENTIFIERS and bare not in PLAIN.get(room, ())) or BRITISH.search(name):
                found.append(f"{file.relative_to(ROOT)}:{line}: {name} is now {IDENTIFIERS.get(bare, 'American')}")
    assert not found, "\n".join(found)


def keys(value: Any) -> Iterator[str]:
    """All keys of nested mappings; those of dotted overrides one by one."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from str(key).split(".")
            yield from keys(inner)
    elif isinstance(value, list):
        for inner in value:
            yield from keys(inner)


def documents() -> list[Path]:
    places = ("configs", "eval/suites", "eval/pretrained", "eval/results", "datasets/sample")
    return [file for place in places for file in sorted((ROOT / place).rglob("*")) if file.suffix in (".yaml", ".json")]


def test_keys_of_configs_and_results() -> None:
    found = []
    for file in documents():
        read = json.loads if file.suffix == ".json" else yaml.safe_load
        old = {key for key in keys(read(file.read_text())) if key in KEYS or BRITISH.search(key)}
        found += [f"{file.relative_to(ROOT)}: {key}" for key in sorted(old)]
    assert len(documents()) > 100
    assert not found, "\n".join(found)


def test_weights_that_are_shipped() -> None:
    for file in sorted((ROOT / "eval" / "pretrained").rglob("*.safetensors")):
        with safe_open(file, "np") as weights:
            assert {part for name in weights.keys() for part in name.split(".")}.isdisjoint(WEIGHTS), file  # noqa: SIM118


@pytest.mark.parametrize(("part", "kind"), KINDS)
def test_weights_of_every_kind(part: str, kind: str) -> None:
    options = {"encoder_options": {"goal": "both"}} if kind == "tokens" else {}
    weights = policy(**{part: kind}, **options).state_dict()
    assert {word for name in weights for word in name.split(".")}.isdisjoint(WEIGHTS)
