"""What this machine has, what is missing, and the command that fixes it."""

import importlib.metadata
import json
import os
import platform
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
GL_COMMAND = "apt-get update && apt-get install -y --no-install-recommends libegl1 libgl1-mesa-dri libosmesa6"
GIB = 2**30
PROBE = """
import mujoco
from OpenGL import GL
model = mujoco.MjModel.from_xml_string(
    "<mujoco><worldbody><light pos='0 0 3'/><geom type='plane' size='9 9 1' rgba='1 0 0 1'/></worldbody></mujoco>")
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
with mujoco.Renderer(model, 32, 32) as renderer:
    renderer.update_scene(data)
    red = int(renderer.render()[..., 0].max())
    print(GL.glGetString(GL.GL_RENDERER).decode() if red > 100 else "")
"""


@dataclass(frozen=True)
class Finding:
    """One finding.

    name: what was examined.
    found: the result.
    ok: whether it is as it should be.
    needed: the project does not work without it.
    fix: command that fixes it, if there is one.
    """

    name: str
    found: str
    ok: bool = True
    needed: bool = False
    fix: str = ""


def doctor(*, json_output: bool = False) -> int:
    """Print the findings; 0 if everything that is needed is there, else 1."""
    findings = examine()
    if json_output:
        print(json.dumps([asdict(finding) for finding in findings], indent=2))
    else:
        print("\n".join(_lines(findings)))
    return 0 if all(finding.ok or not finding.needed for finding in findings) else 1


def examine() -> list[Finding]:
    """Everything that `playlearn doctor` examines; nothing is changed."""
    return [
        _python(),
        _packages(ROOT / "requirements.lock"),
        *gl(),
        _accelerator(),
        _cores(),
        _memory(),
        _disk(),
        _program("chromium", "tests of the report page", "apt-get install -y --no-install-recommends chromium"),
        _program(
            "ffmpeg", "faster video decoding in lerobot, which has its own without it", "apt-get install -y ffmpeg"
        ),
    ]


def gl() -> list[Finding]:
    """Headless OpenGL, tested by rendering with each back end in its own process."""
    drawn = {backend: _draw(backend) for backend in ("egl", "osmesa")}
    chosen = os.environ.get("MUJOCO_GL", "egl")
    works = bool(drawn.get(chosen) or _draw(chosen))
    fix = GL_COMMAND
    if not works and any(drawn.values()):
        fix = f"export MUJOCO_GL={next(backend for backend, device in drawn.items() if device)}"
    return [
        Finding(
            f"images by {chosen}", "can be rendered" if works else "cannot be rendered", works, needed=True, fix=fix
        ),
        *(
            Finding(f"GL by {backend}", device or "does not render", bool(device), fix=GL_COMMAND)
            for backend, device in drawn.items()
        ),
    ]


def main() -> int:
    """For set-up: 0 if images can be rendered, else 1 and the command that fixes it on stdout."""
    images = gl()[0]
    if not images.ok:
        print(images.fix)
    return 0 if images.ok else 1


def _draw(backend: str) -> str:
    """The device that rendered a red plane; "" if none could."""
    environment = {**os.environ, "MUJOCO_GL": backend, "PYOPENGL_PLATFORM": backend}
    try:
        done = subprocess.run(
            [sys.executable, "-c", PROBE], env=environment, capture_output=True, text=True, timeout=120, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""


def _python() -> Finding:
    right = sys.version_info[:2] == (3, 12)
    return Finding("Python", f"{platform.python_version()} ({sys.executable})", right, needed=True, fix="make setup")


def _packages(lock: Path) -> Finding:
    """Installed packages compared with the lock file; outside a checkout there is none."""
    if not lock.exists():
        return Finding("packages", "no lock file to compare with")
    wrong = []
    pinned = _pinned(lock.read_text(encoding="utf-8"))
    for name, version in pinned.items():
        try:
            installed = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            installed = "missing"
        if installed != version:
            wrong.append(f"{name} {installed}, not {version}")
    found = f"{len(pinned) - len(wrong)} of {len(pinned)} as locked"
    return Finding("packages", "; ".join([found, *wrong[:5]]), not wrong, needed=True, fix="make setup")


def _pinned(lock: str) -> dict[str, str]:
    """Package -> version, for the lines that apply to this machine."""
    from packaging.markers import Marker

    lines = re.findall(r"^([\w.-]+)==([^\s;]+)(?: ; ([^\\\n]+))?", lock, re.MULTILINE)
    return {name: version for name, version, marker in lines if not marker or Marker(marker.strip()).evaluate()}


def _accelerator() -> Finding:
    import torch

    if not torch.cuda.is_available():
        return Finding("GPU", f"none; torch {torch.__version__} runs on the CPU")
    return Finding("GPU", f"{torch.cuda.get_device_name(0)}, torch {torch.__version__}")


def _cores() -> Finding:
    from playlearn.executor import available_cores

    return Finding("cores", f"{available_cores()} to use of {os.cpu_count()}")


def _memory() -> Finding:
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / GIB
    return Finding("memory", f"{total:.0f} GiB (4 are enough for the demo)", total >= 4)


def _disk() -> Finding:
    free = shutil.disk_usage(Path.cwd()).free / GIB
    return Finding("disk", f"{free:.0f} GiB free here (the demo takes about 2)", free >= 2)


def _program(name: str, purpose: str, fix: str) -> Finding:
    path = shutil.which(name)
    return Finding(name, path or f"missing (only for {purpose})", path is not None, fix=fix)


def _lines(findings: Sequence[Finding]) -> list[str]:
    width = max(len(finding.name) for finding in findings)
    lines = []
    for finding in findings:
        mark = "ok" if finding.ok else "MISSING" if finding.needed else "-"
        lines.append(f"{mark:<8}{finding.name:<{width}}  {finding.found}")
        if not finding.ok and finding.fix:
            lines.append(f"{'':<8}{'':<{width}}  fix: {finding.fix}")
    return lines


if __name__ == "__main__":
    sys.exit(main())
