from pathlib import Path

import pytest

from playlearn.config import RunFolder
from playlearn.config.run_folder import differences
from playlearn.errors import UsageError


def folder(path: Path, **settings: tuple[str, ...]) -> RunFolder:
    return RunFolder(path, "job.json", "toy run", **settings)  # type: ignore[arg-type]  # only collections are given


@pytest.mark.parametrize("resume", [False, None])
def test_a_missing_or_empty_folder_is_free(tmp_path: Path, resume: bool | None) -> None:
    assert not folder(tmp_path / "new").begun(resume=resume)
    (tmp_path / ".job.json.1-2.tmp").touch()  # left by a kill in the middle of the record
    (tmp_path / "part").mkdir()
    assert not folder(tmp_path, leftovers=("part",)).begun(resume=resume)


@pytest.mark.parametrize("resume", [True, False, None])
def test_another_folder_or_file_is_refused(tmp_path: Path, resume: bool | None) -> None:
    (tmp_path / "thesis.tex").touch()
    for taken in (tmp_path, tmp_path / "thesis.tex"):
        with pytest.raises(UsageError, match=r"holds no toy run \(no job\.json\): choose another --out"):
            folder(taken).begun(resume=resume)


def test_a_begun_job_continues_unless_a_new_one_was_asked_for(tmp_path: Path) -> None:
    (tmp_path / "job.json").touch()
    assert folder(tmp_path).begun()
    assert folder(tmp_path).begun(resume=True)
    with pytest.raises(UsageError, match=r"is there already: choose another --out, or continue it with --resume"):
        folder(tmp_path).begun(resume=False)


def test_there_must_be_something_to_resume(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"there is no toy run at .* to resume; start it without --resume"):
        folder(tmp_path / "new").begun(resume=True)


def test_every_setting_that_differs_is_named(tmp_path: Path) -> None:
    before, now = {"lr": 1, "head": {"type": "flow", "steps": 3}}, {"lr": 2, "head": {"type": "flow", "steps": 4}}
    with pytest.raises(UsageError, match=r"begun with another head\.steps, lr: give the same, or choose another --out"):
        folder(tmp_path).check_same(before, now)
    folder(tmp_path, adjustable=("head", "lr")).check_same(before, now)
    with pytest.raises(UsageError, match=r"another lr:"):
        folder(tmp_path, adjustable=("head.steps",)).check_same(before, now)


def test_a_tuple_is_the_list_that_json_makes_of_it(tmp_path: Path) -> None:
    folder(tmp_path).check_same({"range": [1, 2]}, {"range": (1, 2)})


def test_entries_may_come_and_go_but_not_change(tmp_path: Path) -> None:
    job = folder(tmp_path, entries=("variants",))
    job.check_same({"variants": {"a": {"lr": 1}, "b": {}}}, {"variants": {"a": {"lr": 1}, "c": {}}})
    with pytest.raises(UsageError, match=r"another variants\.a\.lr:"):
        job.check_same({"variants": {"a": {"lr": 1}}}, {"variants": {"a": {"lr": 2}}})


def test_a_block_that_appears_differs_as_a_whole() -> None:
    assert differences({"a": None, "c": 1}, {"a": {"b": 1}, "d": None}) == ["a", "c"]


def test_what_a_job_reads_must_be_what_it_was_begun_with(tmp_path: Path) -> None:
    """Only of what both read: a variant of a comparison may come later."""
    job = folder(tmp_path)
    job.check_inputs({"store": {"episode 0": "a"}})
    job.keep_inputs({"store": {"episode 0": "a", "episode 1": "b", "episode 2": "c"}, "left out": {"x": "1"}})
    job.check_inputs({"store": {"episode 0": "a", "episode 1": "b", "episode 2": "c"}, "new": {"x": "2"}})
    with pytest.raises(
        UsageError,
        match=r"begun with other inputs: store: 1 added \(episode 7\), 1 removed \(episode 2\), 1 changed \(episode 1\)"
        r"\. Put it back as it was, or choose another --out",
    ):
        job.check_inputs({"store": {"episode 0": "a", "episode 1": "x", "episode 7": "c"}})
    assert not job.begun(), "its inputs are written before its record"
