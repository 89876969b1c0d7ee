import json
from importlib import metadata
from pathlib import Path

import pytest

from playlearn import doctor
from playlearn.doctor import Finding


@pytest.mark.slow
def test_every_missing_requirement_comes_with_the_command_that_fixes_it() -> None:
    findings = doctor.examine()
    assert {"Python", "packages", "cores", "memory", "disk", "chromium"} <= {finding.name for finding in findings}
    assert all(finding.ok or finding.fix for finding in findings if finding.needed)


@pytest.mark.parametrize(("ok", "needed", "code"), [(True, True, 0), (False, False, 0), (False, True, 1)])
def test_only_what_is_needed_and_missing_fails(
    ok: bool, needed: bool, code: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    finding = Finding("thing", "somewhere", ok, needed, fix="fetch thing")
    monkeypatch.setattr(doctor, "examine", lambda: [finding])
    assert doctor.doctor() == code
    assert ("fetch thing" in capsys.readouterr().out) is not ok
    assert doctor.doctor(json_output=True) == code
    assert [Finding(**found) for found in json.loads(capsys.readouterr().out)] == [finding]


def test_packages_are_compared_with_the_lock(tmp_path: Path) -> None:
    lock, numpy = tmp_path / "requirements.lock", metadata.version("numpy")
    lock.write_text(
        f"numpy=={numpy} \\\n    --hash=sha256:0\nnosuch==1 ; sys_platform == 'never' \\\n    --hash=sha256:0\n"
    )
    assert doctor._packages(lock).ok  # lines for other machines are ignored
    lock.write_text(f"numpy=={numpy}\nnosuch==1\npyyaml==0.0.1\n")
    finding = doctor._packages(lock)
    assert not finding.ok
    assert finding.found.startswith("1 of 3 as locked; nosuch missing, not 1; pyyaml ")


@pytest.mark.slow
def test_back_ends_that_cannot_render_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "disable")  # mujoco's own word for "no rendering at all"
    images, *backends = doctor.gl()
    assert not images.ok
    working = [found.name.removeprefix("GL by ") for found in backends if found.ok]
    assert images.fix == (f"export MUJOCO_GL={working[0]}" if working else doctor.GL_COMMAND)
