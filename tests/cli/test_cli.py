import dataclasses
import json
import os
import signal
import subprocess
import sys
import time
from argparse import Namespace
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

from playlearn import cli
from playlearn.cli import collect, doctor, parser, train
from playlearn.cli.verb import as_overrides
from playlearn.errors import NotLearnedError, StoreError, UsageError


def python(*arguments: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run([sys.executable, *arguments], capture_output=True, text=True, timeout=600, check=False)


def stand_in(monkeypatch: pytest.MonkeyPatch, act: Callable[[], object], module: ModuleType = doctor) -> None:
    """Let `playlearn doctor`, or another command, do something else."""

    def run(_arguments: Namespace) -> int:
        act()
        return 0

    monkeypatch.setattr(module, "VERB", dataclasses.replace(module.VERB, run=run))


def fail(error: BaseException) -> Callable[[], object]:
    def act() -> object:
        raise error

    return act


def test_help_needs_nothing_heavy() -> None:
    heavy = "{'torch', 'numpy', 'mujoco', 'yaml', 'draccus'}"
    code = f"import sys; from playlearn.cli import main; main(['--help']); sys.exit(str({heavy} & set(sys.modules)))"
    done = python("-c", code)
    assert "collect" in done.stdout
    assert done.stderr.strip() == "set()"


@pytest.mark.parametrize("verb", [module.VERB.name for module in parser.MODULES])
def test_every_command_explains_itself(verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main([verb, "--help"]) == 0
    assert f"usage: playlearn {verb}" in capsys.readouterr().out


@pytest.mark.parametrize("module", parser.MODULES, ids=lambda module: module.VERB.name)
def test_help_says_which_command_prints_the_fields(module: ModuleType, capsys: pytest.CaptureFixture[str]) -> None:
    verb = module.VERB
    assert cli.main([verb.name, "--help"]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert (f"`playlearn config {verb.config}`" in shown) == bool(verb.config)
    if verb.config:
        assert cli.parse(["config", verb.config]).name == verb.config


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ([], "COMMAND"),
        (["colect"], "colect"),
        (["info"], "STORE"),
        (["info", "x", "--frob", "1"], "--frob"),
        (["collect", "--out", "x"], "--config"),
        (["collect", "--config", "c", "--out", "x", "--workers", "-1"], "1 or more"),
        (["collect", "--config", "c", "--out", "x", "--episodes", "0"], "1 or more"),
        (["collect", "--config", "c", "--out", "x", "--workers", "two"], "--workers"),
        (["collect", "--config", "nosuch.yaml", "--out", "x"], "there is no config nosuch.yaml"),
        (["train", "--config", "nosuch.yaml", "--out", "x"], "there is no config nosuch.yaml"),
        (["eval", "--suite", "s", "--goal", "image", "--out", "x"], "--run --policy"),
        (["eval", "--suite", "s", "--goal", "image", "--out", "x", "--run", "r", "--policy", "expert"], "--policy"),
        (["eval", "--suite", "s", "--goal", "words", "--out", "x", "--run", "r"], "'words'"),
        (["render", "a", "b", "--camera", "front=64"], "front=64x64"),
        (["render", "a", "b", "--camera", "front=0x64"], "front=64x64"),
        (["view", "nosuch"], "nothing at nosuch"),
        (["export", "hdf5", "a", "b"], "hdf5"),
    ],
)
def test_wrong_usage_is_code_2_and_says_what(
    arguments: list[str], word: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(arguments) == 2
    errors = capsys.readouterr().err
    assert word in errors
    assert "Traceback" not in errors


def test_a_missing_store_is_code_2_and_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["info", str(tmp_path / "nosuch")]) == 2
    errors = capsys.readouterr().err
    assert "nosuch" in errors
    assert "Traceback" not in errors


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (UsageError("wrong words"), 2, "wrong words"),
        (StoreError("broken store"), 1, "broken store"),
        (NotLearnedError("nothing was learned"), 1, "nothing was learned"),
        (OSError(28, "No space left on device"), 1, "the disk is full"),
        (RuntimeError("IoError(Os { message: No space left on device })"), 1, "the disk is full"),
        (PermissionError(13, "Permission denied", "/x/y"), 1, "/x/y"),
        (FileNotFoundError(2, "No such file or directory", "/x/y"), 1, "/x/y"),
        (KeyboardInterrupt(), 130, "interrupted"),
    ],
)
def test_every_end_has_its_code_and_one_message(
    error: BaseException, code: int, words: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    stand_in(monkeypatch, fail(error))
    assert cli.main(["doctor"]) == code
    errors = capsys.readouterr().err
    assert words in errors
    assert errors.count("\n") == 1


def test_a_defect_of_ours_keeps_its_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    stand_in(monkeypatch, fail(ZeroDivisionError("ours")))
    with pytest.raises(ZeroDivisionError, match="ours"):
        cli.main(["doctor"])


def test_debug_shows_where_a_users_mistake_was_found(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PLAYLEARN_DEBUG", "1")
    stand_in(monkeypatch, fail(StoreError("broken store")))
    assert cli.main(["doctor"]) == 1
    assert "Traceback" in capsys.readouterr().err


def test_termination_ends_a_command_as_ctrl_c_does(monkeypatch: pytest.MonkeyPatch) -> None:
    def act() -> None:
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(10)
        went_on.append(True)

    former, went_on = signal.getsignal(signal.SIGTERM), []
    stand_in(monkeypatch, act)
    assert cli.main(["doctor"]) == 130
    assert not went_on, "it did not sleep to the end"
    assert signal.getsignal(signal.SIGTERM) is former


def test_a_reader_that_goes_away_is_no_error_of_ours() -> None:
    say_much = "replace(cli.doctor.VERB, run=lambda arguments: print('x' * 10**6) or 0)"
    imports = "import sys; from dataclasses import replace; from playlearn import cli"
    code = f"{imports}; cli.doctor.VERB = {say_much}; sys.exit(cli.main(['doctor']))"
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        process.stdout.read(1)
        process.stdout.close()
        assert process.wait(timeout=600) == 1
        assert process.stderr is not None
        assert process.stderr.read() == ""


@pytest.mark.parametrize("module", [collect, train])
def test_an_interrupted_job_says_how_to_go_on(
    module: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    stand_in(monkeypatch, fail(KeyboardInterrupt()), module)
    assert cli.main([module.VERB.name, "--config", "c", "--out", "o"]) == 130
    assert "kept, and the same command with --resume goes on" in capsys.readouterr().err


def test_flags_that_are_config_fields_become_overrides() -> None:
    given = Namespace(episodes=3, seed=None, store="12")
    # JSON quotes the store, so that a folder called 12 stays a path.
    assert as_overrides(given, "episodes", "seed", "store") == ["--episodes=3", '--store="12"']


def test_free_arguments_are_left_for_the_config() -> None:
    arguments = cli.parse(["train", "--config", "c", "--a.b", "-1", "--out", "o", "--c.d=[1, 2]"])
    assert arguments.overrides == ["--a.b", "-1", "--c.d=[1, 2]"]
    assert (arguments.config, arguments.out) == (Path("c"), Path("o"))


@pytest.mark.slow
def test_doctor_speaks_json(capsys: pytest.CaptureFixture[str]) -> None:
    code = cli.main(["doctor", "--json"])
    findings = json.loads(capsys.readouterr().out)
    assert code == int(any(finding["needed"] and not finding["ok"] for finding in findings))
