"""Try the wheel and the source archive of ``dist/`` in new environments: ``python -m tests.package_smoke [PYTHON ...]``.

Each Python gets an environment below ``build/smoke``. On the core alone a policy is trained and evaluated, and commands
name the extra they lack. With ``[all]`` nothing is missing, and the demo runs in an empty folder.
"""

import json
import os
import shutil
import subprocess
import sys
import tarfile
import zipfile
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).parents[1]
WORK = ROOT / "build" / "smoke"
MINORS = range(11, 14)  # Minor versions of Python 3 that are supported


def find_pythons() -> list[str]:
    """Return the Pythons of supported versions that start: those on the path, then those of pyenv."""
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv"), "versions")
    pythons = []
    for minor in MINORS:
        own = sorted(str(path) for path in pyenv.glob(f"3.{minor}.*/bin/python3.{minor}"))
        pythons += [python for python in (f"python3.{minor}", *own) if starts(python)][:1]
    return pythons


def starts(python: str) -> bool:
    """Return whether a Python is installed and can make environments."""
    try:
        return subprocess.run([python, "-c", "import venv"], capture_output=True, check=False).returncode == 0
    except FileNotFoundError:
        return False


def constraints(python: str) -> Path:
    """Return the tested versions for a Python."""
    code = "import sys; print(sys.version_info[:2] == (3, 11))"
    old = subprocess.run([python, "-c", code], capture_output=True, text=True, check=True).stdout.strip() == "True"
    return ROOT / ("constraints.txt" if old else "constraints-numpy2.txt")


class Environment:
    """A new environment with its working folder."""

    def __init__(self, python: str) -> None:
        self.folder = WORK / Path(python).name
        shutil.rmtree(self.folder, ignore_errors=True)
        subprocess.run([python, "-m", "venv", str(self.folder / "venv")], check=True)
        self._bin, self._versions = self.folder / "venv" / "bin", constraints(python)
        self._environ = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}

    def install(self, wheel: Path, extras: str = "") -> None:
        """Install the wheel with extras such as ``[all]`` in the tested versions."""
        command = [self._bin / "pip", "install", "-q", "--no-compile", "-c", self._versions, f"{wheel}{extras}"]
        subprocess.run(list(map(str, command)), env=self._environ, check=True)

    def run(self, *words: str, status: int = 0) -> tuple[str, str]:
        """Run a command of ``aerial-gym``, check its exit status, and return stdout and stderr."""
        command = [str(self._bin / "aerial-gym"), *words]
        done = subprocess.run(command, cwd=self.folder, env=self._environ, capture_output=True, text=True, check=False)
        assert done.returncode == status, f"{words}: status {done.returncode}\n{done.stdout}\n{done.stderr}"
        assert "Traceback" not in done.stderr, f"{words}:\n{done.stderr}"
        return done.stdout, done.stderr


TRAINING = ("train", "--num-envs", "64", "--max-time-s", "10", "--device", "cpu", "--out", "run")
LACKS = {
    ("log", "inspect", "flight.csv"): "sim2real",
    ("close-loop", "--robot", "base_quadrotor", "--train", "a.csv", "--test", "b.csv", "--out", "c"): "sim2real",
    ("view",): "viewer",
    ("export", "--policy", "run"): "export",
    ("train", "--trainer", "rl_games", "--out", "other"): "rl-games",
    ("demo", "--out", "demo"): "sim2real",
}
"""Commands with the extra that each names on the core alone."""


def try_core(environment: Environment) -> None:
    """Train, evaluate, and check that a missing extra is named."""
    report = json.loads(environment.run("doctor", "--json")[0])
    assert report["extras"]["sim2real"]["missing"], report["extras"]
    environment.run("list")
    told = environment.run(*TRAINING)[1]
    assert "aerial-gym[tensorboard]" in told, told
    environment.run("evaluate", "--policy", "run", "--num-envs", "16")
    for words, extra in LACKS.items():
        told = environment.run(*words, status=2)[1]
        assert f"pip install 'aerial-gym[{extra}]'" in told, f"{words}: {told}"


def try_all(environment: Environment) -> None:
    """Check that nothing of ``[all]`` is missing, and run the demo."""
    report = json.loads(environment.run("doctor", "--json")[0])
    for name in ("tensorboard", "sim2real", "logs", "viewer", "urdf", "export", "mujoco"):
        assert report["extras"][name]["missing"] == [], (name, report["extras"][name])
    environment.run("demo", "--out", "demo", "--train-time-s", "10")
    assert (environment.folder / "demo" / "index.html").stat().st_size > 100_000


def compare_archives(wheel: Path, source: Path) -> None:
    """Check that the source archive has every Python file and data file of the wheel."""
    with zipfile.ZipFile(wheel) as packed:
        names = {name for name in packed.namelist() if ".dist-info/" not in name}
    with tarfile.open(source) as packed:
        own = {name.partition("/")[2] for name in packed.getnames()}
    plant = "aerial_gym/cli/demo/plant/"
    lost = sorted(name for name in names if name.removeprefix(plant) not in own)
    assert lost == [], f"{source.name} lacks {lost}"
    assert any(name.startswith(plant) for name in names), f"{wheel.name} lacks the plant of the demo"


def main(pythons: Sequence[str]) -> None:
    """Try both archives with each Python, and print one line for each step."""
    (wheel,), (source,) = ROOT.glob("dist/*.whl"), ROOT.glob("dist/*.tar.gz")
    compare_archives(wheel, source)
    for python in pythons or find_pythons():
        environment = Environment(python)
        environment.install(wheel)
        try_core(environment)
        print(f"{python}: the core works", flush=True)
        environment.install(wheel, "[all]")
        try_all(environment)
        print(f"{python}: [all] works", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
