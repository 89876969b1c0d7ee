"""Export a trained policy in the Hub's format: config.json, model.safetensors, processors and a card."""

import json
from dataclasses import asdict
from pathlib import Path

from playlearn.config import built_beside, to_dict
from playlearn.errors import StoreError, UsageError
from playlearn.policies import Policy
from playlearn.privileges import Privileges
from playlearn.report.template import template


def export_policy(run: Path, out: Path) -> list[str]:
    """Write the policy of a run to `out`: built beside it, loaded back, then moved there. Returns the inputs it reads.

    Raises:
        MissingRunError: there is no policy at `run`.
        UsageError: `out` is taken, or the policy does not act.
        BusyError: another process exports to `out`.
        DiskError: it cannot be written; nothing was left there.
    """
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise UsageError(f"{out} already exists: name another folder")
    policy = Policy.load(run / "policy")
    if policy.spec.predicts != "actions":
        raise UsageError(f"{run} proposes subgoals and does not act: LeRobot has no place for it")
    # Slow to import.
    from playlearn.lerobot.configuration_playlearn import PlaylearnConfig, features
    from playlearn.lerobot.goals import GOAL_IMAGES, GOAL_PROPRIO, GOAL_STATE
    from playlearn.lerobot.modeling_playlearn import PlaylearnPolicy
    from playlearn.lerobot.processor_playlearn import make_playlearn_pre_post_processors

    inputs, outputs = features(policy.spec, policy.config)
    built = json.dumps({"config": to_dict(policy.config), "spec": asdict(policy.spec)}, default=dict)
    config = PlaylearnConfig(
        built=built,
        input_features=inputs,
        output_features=outputs,
        device="cpu",
        push_to_hub=False,
        license="apache-2.0",
    )
    exported = PlaylearnPolicy(config)
    exported.policy.load_state_dict(policy.state_dict())
    goals = [key for key in inputs if key.startswith((GOAL_STATE, GOAL_PROPRIO, GOAL_IMAGES))]
    with built_beside(out) as building:
        building.mkdir()
        exported.save_pretrained(building)
        for pipeline in make_playlearn_pre_post_processors(config):
            pipeline.save_pretrained(building)
        used = Privileges.of_run(run).to_dict()
        facts = {"title": out.name, "spec": policy.spec, "config": policy.config, "privileged": used}
        card = template("policy_card.md.j2").render(facts, inputs=list(inputs), goals=goals)
        (building / "README.md").write_text(card, encoding="utf-8")
        back = PlaylearnPolicy.from_pretrained(building, strict=True)
        written, read = policy.state_dict(), back.policy.state_dict()
        if any(not bool((written[name] == read[name]).all()) for name in written):
            raise StoreError("other weights were read back than were written: please report this as a bug")
    return list(inputs)
