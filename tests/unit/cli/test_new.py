"""``aerial-gym new``: every written file is complete, its test passes, and nothing is overwritten."""

import os
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest
import yaml

from aerial_gym.cli.new import NEXT_STEPS, TEMPLATES
from aerial_gym.config import build, read_yaml
from aerial_gym.config.robot import RobotCfg, load_robot
from tests.builders import simulation
from tests.integration.commands import run

ROOT = Path(__file__).parents[3]
OPTIONS = {"robot": ("--mass-kg", "0.7", "--propeller", "5x4.3x3", "--motor-kv", "1750", "--battery", "6S1300")}


@pytest.mark.parametrize("kind", NEXT_STEPS)
@pytest.mark.usefixtures("own_registries", "few_rays")
def test_written_test_passes(kind: str, tmp_path, capsys, monkeypatch) -> None:
    name = f"own_new_{kind}"
    status, out, _ = run(capsys, "new", kind, name, "--out", str(tmp_path), *OPTIONS.get(kind, ()))
    assert status == 0
    assert f"python -m pytest {tmp_path / f'test_{name}.py'}" in out
    assert all("my_" + kind not in file.read_text(encoding="utf-8") for file in tmp_path.iterdir())
    monkeypatch.syspath_prepend(tmp_path)
    module = import_module(f"test_{name}")
    tests = [function for word, function in vars(module).items() if word.startswith("test_")]
    assert tests
    for function in tests:
        function()


@pytest.mark.slow
def test_written_tests_pass_under_pytest(tmp_path, capsys) -> None:
    for kind in NEXT_STEPS:
        assert run(capsys, "new", kind, f"own_new_{kind}", "--out", str(tmp_path), *OPTIONS.get(kind, ()))[0] == 0
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q"], cwd=tmp_path, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout
    for kind in ("effect", "controller"):
        subprocess.run([sys.executable, f"own_new_{kind}.py"], cwd=tmp_path, env=environment, check=True)


@pytest.mark.slow
def test_optional_parts_of_a_robot_file_can_be_used(tmp_path, capsys) -> None:
    run(capsys, "new", "robot", "own_quad", "--out", str(tmp_path), *OPTIONS["robot"])
    optional = (TEMPLATES / "my_robot.yaml").read_text(encoding="utf-8").splitlines()[2:]
    fields = yaml.safe_load("\n".join(line.removeprefix("# ") for line in optional))
    assert len(fields) == len(optional) == 5
    robot = build(RobotCfg, read_yaml(tmp_path / "own_quad.yaml") | fields, where="here")
    env = simulation(robot, "lee_position_control")
    env.reset()
    assert "depth_range_pixels" in env.gtd


def test_every_number_of_a_robot_file_has_an_origin(tmp_path, capsys) -> None:
    _, out, _ = run(capsys, "new", "robot", "own_quad", "--out", str(tmp_path), *OPTIONS["robot"])
    assert "given: --propeller" in out
    lines = (tmp_path / "own_quad.yaml").read_text(encoding="utf-8").splitlines()
    numbers = [
        line for line in lines if any(c.isdigit() for c in line) and not line.startswith("#") and "position" not in line
    ]
    assert [
        line for line in numbers if "given: --" not in line and "assumed" not in line and "source" not in line
    ] == []
    assert load_robot(tmp_path / "own_quad.yaml").rotor.source == "aerial-gym new robot own_quad"


@pytest.mark.parametrize(("kind", "name", "words"), [
    ("effect", "rotor_drag", "effect 'rotor_drag' is registered already: choose another name"),
    ("task", "My-Task", "name 'My-Task': must be snake_case, such as my_task"),
    ("controller", "lambda", "name 'lambda': must be snake_case"),
])  # fmt: skip
def test_impossible_names_are_refused(kind: str, name: str, words: str, tmp_path, capsys) -> None:
    status, _, error = run(capsys, "new", kind, name, "--out", str(tmp_path / "sub"))
    assert (status, list(tmp_path.iterdir())) == (2, [])
    assert words in error


def test_an_environment_states_that_it_has_one_vehicle() -> None:
    assert "robots: [{name: lmf2, count: 3}]" in (TEMPLATES / "my_environment.yaml").read_text(encoding="utf-8")


def test_existing_files_stay(tmp_path, capsys) -> None:
    (tmp_path / "hall.yaml").write_text("mine", encoding="utf-8")
    status, _, error = run(capsys, "new", "environment", "hall", "--out", str(tmp_path))
    assert (status, sorted(file.name for file in tmp_path.iterdir())) == (2, ["hall.yaml"])
    assert "hall.yaml exists: choose another name or --out, or remove it" in error
