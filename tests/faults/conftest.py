from pathlib import Path

import pytest

from playlearn.collection import job
from playlearn.config import save_config
from tests.faults import point


@pytest.fixture(autouse=True)
def _points(monkeypatch: pytest.MonkeyPatch) -> None:
    """In this process too, the play policy of the fake environment plays."""
    monkeypatch.setattr(job, "play_policy_for", point.play_policy)


@pytest.fixture
def config(tmp_path: Path) -> Path:
    """The file of `point.config()`."""
    path = tmp_path / "collect.yaml"
    save_config(point.config(), path)
    return path
