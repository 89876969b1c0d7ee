"""Laws of the tree itself."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def files() -> list[Path]:
    """What is or would be committed."""
    done = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        pytest.skip("not a git checkout")
    return [ROOT / name for name in done.stdout.splitlines() if (ROOT / name).is_file()]


def read(file: Path) -> str:
    return file.read_text(encoding="utf-8", errors="ignore")


def test_the_lock_pins_everything_by_hash_and_names_no_address() -> None:
    lock = read(ROOT / "requirements.lock")
    assert not re.search(r"https?://|git\+|file:", lock)
    packages = re.split(r"\n(?=\S)", lock.strip())
    assert len(packages) > 100
    for package in packages:
        assert re.match(r"[\w.-]+==\S+", package)
        assert "--hash=sha256:" in package


def test_the_lock_holds_what_the_project_asks_for() -> None:
    import tomllib

    from packaging.requirements import Requirement

    project = tomllib.loads(read(ROOT / "pyproject.toml"))
    locked = dict(re.findall(r"^([\w.-]+)==([^\s;]+)", read(ROOT / "requirements.lock"), re.MULTILINE))
    for text in project["project"]["dependencies"] + project["dependency-groups"]["dev"]:
        wanted = Requirement(text)
        assert wanted.specifier.contains(locked[wanted.name]), f"{text} is locked at {locked[wanted.name]}"


def test_no_file_knows_one_machine(files: list[Path]) -> None:
    home = re.compile(r"(?<![\w.-])/(?:root|work|home/\w+|Users/\w+)/")
    texts = {
        file: read(file) for file in files if file.suffix not in {".png", ".gif", ".webp", ".parquet", ".safetensors"}
    }
    assert [file for file, text in texts.items() if home.search(text) and file != Path(__file__)] == []


def test_files_stay_small(files: list[Path]) -> None:
    assert [file for file in files if file.stat().st_size > 10 * 2**20] == []
    long = [file for file in files if file.suffix == ".py" and read(file).count("\n") > 400]
    assert long == []  # a file fits one screenful of ideas: mostly under 200 lines, seldom over 300


def test_no_folder_shadows_an_installed_package() -> None:
    # lerobot imports the installed `datasets`, which our folder of that name must not become.
    assert not list((ROOT / "datasets").glob("*.py"))


def test_imports_go_down_only() -> None:
    code = "import sys; from importlinter.cli import lint_imports; sys.exit(lint_imports(no_cache=True))"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


def test_every_module_is_typed() -> None:
    assert (ROOT / "playlearn" / "py.typed").exists()


def test_no_pickle_and_no_global_randomness(files: list[Path]) -> None:
    forbidden = re.compile(
        r"^\s*(import pickle|from pickle|import random\b|from random )|np\.random\.(seed|rand|normal|choice)\(",
        re.MULTILINE,
    )
    # robosuite's placement knows only numpy's global state; it is lent a seed there, and what was global is put back
    lent = ROOT / "playlearn" / "envs" / "tabletop.py"
    sources = [file for file in files if file.match("playlearn/**/*.py") and file != lent]
    assert [file for file in sources if forbidden.search(read(file))] == []


def test_the_set_up_scripts_are_sound() -> None:
    assert (ROOT / ".ci" / "run").stat().st_mode & 0o111
    for script in [*(ROOT / ".ci").glob("*.sh"), ROOT / ".ci" / "run"]:
        shell = "bash" if "bash" in read(script).partition("\n")[0] else "sh"
        assert subprocess.run([shell, "-n", str(script)], check=False).returncode == 0, script


@pytest.mark.parametrize("path", sorted((ROOT / "configs" / "collect").glob("*.yaml")), ids=lambda path: path.stem)
def test_every_collect_config_is_right(path: Path) -> None:
    from playlearn.collection import CollectConfig
    from playlearn.config import load_config

    assert load_config(CollectConfig, path).episodes > 0


@pytest.mark.parametrize("path", sorted((ROOT / "configs" / "train").glob("*.yaml")), ids=lambda path: path.stem)
def test_every_train_config_is_right(path: Path) -> None:
    from playlearn.config import load_config
    from playlearn.training import TrainConfig

    assert load_config(TrainConfig, path).resolved().steps > 0


@pytest.mark.parametrize("path", sorted((ROOT / "eval" / "suites").glob("*.yaml")), ids=lambda path: path.stem)
def test_every_suite_is_right_and_named_as_its_file(path: Path) -> None:
    from playlearn.evaluation import load_suite

    assert load_suite(path).name == path.stem
