"""What privileged information was used: joined, written, read back, and shown in one line."""

from pathlib import Path

from playlearn.privileges import Privileges

POSES = Privileges(training=("object poses", "clean labels"), relabeling=("object poses",))
EXPERT = Privileges(training=("clean labels", "expert"), goal=("object poses",))


def test_two_join_to_what_either_used_and_read_back_as_written() -> None:
    both = POSES | EXPERT
    assert both == Privileges(("object poses", "clean labels", "expert"), ("object poses",), ("object poses",))
    assert Privileges.from_dict(both.to_dict()) == both


def test_a_table_shows_none_or_which() -> None:
    assert str(Privileges()) == "none"
    assert str(POSES) == "training: object poses, clean labels; relabeling: object poses"
    assert str(POSES | EXPERT).endswith("; goal: object poses")
    assert str(Privileges.from_dict(None)) == "unknown"


def test_a_run_without_a_record_is_unknown(tmp_path: Path) -> None:
    assert str(Privileges.of_run(tmp_path)) == "unknown"
    (tmp_path / "run.json").write_text("{}")
    assert str(Privileges.of_run(tmp_path)) == "unknown"
