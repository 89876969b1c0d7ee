"""A path in a file means the same from any folder, and after the folders were moved together."""

from dataclasses import dataclass
from pathlib import Path

import pytest

from playlearn.config import copy_config, load_config, read_config, save_config, spelled_from
from playlearn.errors import UsageError


@dataclass(frozen=True)
class Toy:
    store: Path
    other: Path | None = None
    name: str = "plain"


def test_a_saved_config_means_the_same_from_any_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("project/runs/a", "project/play", "elsewhere"):
        (tmp_path / name).mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "project")
    record = Path("runs/a/config.yaml")
    save_config(Toy(Path("play"), Path("runs/a/corrections")), record)
    assert read_config(record)["name"] == "plain"
    assert str(tmp_path) not in record.read_text(), "no path of this machine"
    assert "../../play" in record.read_text()
    for folder in ("project", "elsewhere", "project/runs/a"):
        monkeypatch.chdir(tmp_path / folder)
        read = load_config(Toy, tmp_path / "project" / record)
        assert read.store.resolve() == tmp_path / "project" / "play"
        assert read.other is not None
        assert read.other.resolve() == tmp_path / "project/runs/a/corrections"
    (tmp_path / "project").rename(tmp_path / "moved")
    assert load_config(Toy, tmp_path / "moved" / record).store.resolve() == tmp_path / "moved" / "play"


def test_a_run_behind_a_symbolic_link_finds_its_play_by_either_name(tmp_path: Path) -> None:
    for name in ("project/play", "scratch/runs/a"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "project" / "runs").symlink_to(tmp_path / "scratch" / "runs")
    save_config(Toy(tmp_path / "project/play"), tmp_path / "project/runs/a/config.yaml")
    for run in ("project/runs/a", "scratch/runs/a"):
        assert load_config(Toy, tmp_path / run / "config.yaml").store == tmp_path / "project/play"


def test_what_a_person_writes_is_looked_for_from_the_working_directory_unless_it_begins_with_a_dot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "configs").mkdir()
    path = tmp_path / "configs" / "toy.yaml"
    path.write_text("store: play\nother: ../play\nname: ./a text\n")
    monkeypatch.chdir("/")
    read = load_config(Toy, path)
    assert (read.store, read.other) == (Path("play"), tmp_path / "play")
    assert read.name == "./a text", "no path"
    assert load_config(Toy, path, ["--other=./x"]).other == Path("x"), "on the command line, from where it is typed"


def test_a_copied_config_names_the_same(tmp_path: Path) -> None:
    save_config(Toy(tmp_path / "play"), (tmp_path / "config.yaml"))
    (tmp_path / "deep" / "er").mkdir(parents=True)
    copy_config(tmp_path / "config.yaml", tmp_path / "deep" / "er" / "config.yaml")
    assert load_config(Toy, tmp_path / "deep" / "er" / "config.yaml").store == tmp_path / "play"


@pytest.mark.parametrize(("path", "spelled"), [("a", "./"), ("a/b", "./b"), (".", "../"), ("c", "../c")])
def test_a_spelled_path_begins_with_a_dot_and_a_slash(tmp_path: Path, path: str, spelled: str) -> None:
    (tmp_path / "a").mkdir()
    assert spelled_from(tmp_path / "a")(tmp_path / path).rstrip(".") in (spelled, spelled.rstrip("."))


def test_an_empty_file_is_not_a_config_of_defaults(tmp_path: Path) -> None:
    """What a full disk leaves of `playlearn config train > my.yaml`."""
    (tmp_path / "my.yaml").touch()
    with pytest.raises(UsageError, match=r"my\.yaml is empty"):
        load_config(Toy, tmp_path / "my.yaml")
