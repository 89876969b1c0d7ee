"""The scripts that `playlearn completion` prints, in the shells themselves."""

import shutil
import subprocess
from pathlib import Path

import pytest

from playlearn import cli

BASH = """
source {script}
COMP_WORDS=({words}) COMP_CWORD={last}
_playlearn
printf '%s\\n' "${{COMPREPLY[@]}}"
"""
# The widgets of zsh's completion, printing what they are given.
ZSH = """
compdef() {{ : }}
_describe() {{ for one in ${{(P)2}}; do print -r -- ${{one%%:*}}; done }}
compadd() {{ shift; print -rl -- "$@" }}
_files() {{ : }}
source {script}
words=({words}) CURRENT={last}
(( CURRENT++ ))
PREFIX=$words[-1]
_playlearn
"""
SHELLS = {"bash": BASH, "zsh": ZSH}
CASES = [
    (["playlearn", "tr"], {"train"}, {"--config"}),
    (
        ["playlearn", "train", "--"],
        {"--config", "--out", "--resume", "--policy.head.type", "--data.goals.ahead"},
        {"train"},
    ),
    (["playlearn", "train", "--policy.head.type", ""], {"flow", "diffusion", "gaussian"}, {"--config"}),
    (["playlearn", "eval", "--goal", ""], {"image", "state"}, {"--suite"}),
    (["playlearn", "export", ""], {"lerobot", "robomimic", "policy"}, {"train"}),
    (["playlearn", "dagger", "--gather.type", ""], {"rollouts", "play", "noise"}, {"--suite"}),
]


@pytest.fixture(scope="module", params=sorted(SHELLS))
def shell(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path]:
    if shutil.which(request.param) is None:
        pytest.skip(f"no {request.param} here")
    script = tmp_path_factory.mktemp("completion") / request.param
    with pytest.MonkeyPatch.context() as patch, script.open("w") as file:
        patch.setattr("sys.stdout", file)
        assert cli.main(["completion", request.param]) == 0
    return request.param, script


@pytest.mark.parametrize(
    ("words", "offered", "not_offered"),
    CASES,
    ids=lambda case: " ".join(sorted(case) if isinstance(case, set) else case)[:40],
)
def test_completion_offers_what_may_come_next(
    shell: tuple[str, Path], words: list[str], offered: set[str], not_offered: set[str]
) -> None:
    name, script = shell
    quoted = " ".join(f"'{word}'" for word in words)
    program = SHELLS[name].format(script=script, words=quoted, last=len(words) - 1)
    done = subprocess.run([name, "-c", program], capture_output=True, text=True, timeout=600, check=True)
    found = set(done.stdout.split())
    assert offered <= found, done.stderr
    assert not not_offered & found


def test_an_unknown_shell_is_wrong_usage(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["completion", "fish"]) == 2
    assert "'fish'" in capsys.readouterr().err
