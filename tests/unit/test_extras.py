"""Extras by package and module, and the error for a missing package."""

import subprocess
import sys
import tomllib
from collections.abc import Iterator
from email.message import Message
from importlib import metadata, util
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from aerial_gym import extras
from aerial_gym.errors import MissingDependencyError
from tests.refusals import assert_refused

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


@pytest.fixture
def project_metadata(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Metadata of a project with a core package and three extras, one for newer Pythons only and one that joins others."""
    project = Message()
    for row in (
        "gnat>=1", 'moth>=2; extra == "logs"', 'wasp-lib>=3; extra == "tune"', 'moth>=2; extra == "tune"',
        'hornet>=1; python_version < "3" and extra == "logs"', 'aerial-gym[logs,tune]; extra == "all"',
        'fly>=1; extra == "both"', 'aerial-gym[logs]; extra == "both"',
    ):  # fmt: skip
        project["Requires-Dist"] = row
    for name in ("logs", "tune", "all", "both"):
        project["Provides-Extra"] = name
    monkeypatch.setattr(metadata, "metadata", lambda name: project)
    extras.requirements.cache_clear()
    yield
    extras.requirements.cache_clear()


@pytest.mark.usefixtures("project_metadata")
def test_an_extra_is_found_by_the_module_of_its_package() -> None:
    extra_by_module = {module: extras.find_extra(module) for module in ("moth", "wasp_lib", "gnat", "hornet", "bee")}
    assert extra_by_module == {"moth": "logs", "wasp_lib": "tune", "gnat": None, "hornet": None, "bee": None}
    assert [row.name for row in extras.requirements()[""]] == ["gnat"]
    assert [row.name for row in extras.extra_packages("both")] == ["fly", "moth"]
    assert extras.extra_packages("all") == ()


@pytest.mark.usefixtures("project_metadata")
def test_a_missing_package_is_named_with_the_command_that_installs_it() -> None:
    told = r"reading needs moth and bee and wasp_lib: pip install 'aerial-gym\[logs,tune\]' bee"
    assert_refused(MissingDependencyError, told, extras.require, "reading", "moth", "sys", "bee", "wasp_lib")
    with pytest.raises(MissingDependencyError, match=r"^reading needs moth: pip install 'aerial-gym\[logs\]'$"):  # noqa: SIM117
        with extras.optional_import("reading"):
            import moth.wings  # noqa: F401  # pyright: ignore[reportMissingImports]
    with pytest.raises(ModuleNotFoundError, match="bee"), extras.optional_import("reading"):
        import bee  # noqa: F401  # pyright: ignore[reportMissingImports]
    extras.require("reading", "sys")


def test_without_metadata_the_package_itself_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(extras, "PROJECT", "no-such-project")
    extras.requirements.cache_clear()
    assert extras.requirements() == {}
    assert str(extras.missing_dependency("reading", ["moth"])) == "reading needs moth: pip install moth"
    extras.requirements.cache_clear()


def test_every_package_of_the_project_has_its_module_name() -> None:
    rows = [Requirement(text) for texts in PROJECT["optional-dependencies"].values() for text in texts]
    rows += [Requirement(text) for text in PROJECT["dependencies"]]
    installed = {each.metadata["Name"].lower().replace("_", "-") for each in metadata.distributions()}
    packages = {row.name for row in rows if row.name.lower() in installed} - {extras.PROJECT}
    assert len(packages) > 20
    assert [name for name in sorted(packages) if util.find_spec(extras.module_name(name)) is None] == []


BLOCKER = """
import importlib.util
import sys
find_spec = importlib.util.find_spec
importlib.util.find_spec = lambda name, package=None: None if name in {blocked} else find_spec(name, package)
class Blocker:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {blocked}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Blocker())
from aerial_gym.cli.main import main
for words in {commands}:
    print(main(words), flush=True, file=sys.stderr)
"""


def run_on_core(blocked: tuple[str, ...], *commands: str) -> list[tuple[str, str]]:
    """Return the exit status and the last line on stderr of each command in a process without some modules."""
    code = BLOCKER.format(blocked=set(blocked), commands=[command.split() for command in commands])
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    lines = done.stderr.splitlines()
    return [(line, lines[at - 1]) for at, line in enumerate(lines) if line.isdecimal()]


def test_a_command_without_scipy_names_its_extra() -> None:
    (told,) = run_on_core(("scipy",), "log inspect pyproject.toml")
    assert told == ("2", "aerial-gym: log inspect needs scipy: pip install 'aerial-gym[sim2real]'")


OPTIONAL = (
    "scipy", "pandas", "matplotlib", "PIL", "jinja2", "viser", "yourdfpy", "mujoco", "onnx", "onnxscript", "onnxruntime",
    "wandb", "rl_games", "sample_factory", "pyulog", "rosbags", "mcap", "pyarrow", "tensorboard", "tensorboardX",
)  # fmt: skip

NEEDS = {
    "robot check base_quadrotor --no-fly --page {out}/p.html": "sim2real",
    "robot import README.md --out {out}/r.yaml": None,
    "robot from-log README.md --out {out}/r.yaml": "sim2real",
    "log convert README.md --to csv --out {out}/x.csv": "sim2real",
    "log plot README.md --out {out}/x.html": "sim2real",
    "view --task position_setpoint_task --policy zero": "viewer",
    "train --trainer rl_games --out {out}/t": "rl-games",
    "train --trainer sample_factory --out {out}/t": "sample-factory",
    "train --wandb project --out {out}/t": "wandb,tensorboard",
    "play --policy {out}/none --video {out}/x.gif": "sim2real",
    "replay base_quadrotor README.md": "sim2real",
    "watch base_quadrotor README.md": "sim2real",
    "close-loop --robot base_quadrotor --train README.md --test README.md --out {out}/c": "sim2real",
    "identify motor README.md": "sim2real",
    "bench physics --backend mujoco --num-envs 2 --device cpu": "mujoco",
    "render-gallery --out {out}/g": "sim2real",
    "demo --out {out}/d": "sim2real",
}
"""Commands with the extras that each names on a core installation; None: refused for another reason."""


@pytest.mark.slow
def test_every_command_on_a_core_installation_names_the_extra_it_lacks(tmp_path: Path) -> None:
    told = run_on_core(OPTIONAL, *(command.format(out=tmp_path) for command in NEEDS))
    assert [status for status, _ in told] == ["2"] * len(NEEDS)
    for (command, extra), (_, line) in zip(NEEDS.items(), told, strict=True):
        assert ("pip install" in line) == (extra is not None), (command, line)
        assert extra is None or f"pip install 'aerial-gym[{extra}]'" in line, (command, line)
