"""Commands as Python functions: the options, the result, and the errors."""

import json
import subprocess
import sys
from dataclasses import fields
from inspect import signature
from pathlib import Path

import numpy as np
import pytest

import aerial_gym
from aerial_gym import check, close_loop, evaluate, play, robustness, train
from aerial_gym.cli.main import COMMANDS, main
from aerial_gym.errors import ConfigError, DataError, UnknownNameError
from aerial_gym.rl_training.run.run_folder import RunFolder
from tests.refusals import assert_refused

FUNCTIONS = {
    "train": train,
    "evaluate": evaluate,
    "play": play,
    "close-loop": close_loop,
    "robot check": check,
    "robustness": robustness,
}
HOVER = "pretrained/position_setpoint_task"


def test_import_loads_neither_torch_nor_warp() -> None:
    names = ", ".join(function.__name__ for function in FUNCTIONS.values())
    heavy = ("torch", "warp", "numpy", "pandas", "matplotlib")
    code = f"import sys; from aerial_gym import {names}; print([m for m in {heavy} if m in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"


@pytest.mark.parametrize("name", FUNCTIONS)
def test_arguments_are_the_options_of_the_command(name: str) -> None:
    function, command = FUNCTIONS[name], COMMANDS[name].load()
    parameters = signature(function).parameters
    assert list(parameters) == [field.name for field in fields(command) if field.name != "json"]
    assert all(parameters[field.name].default is not None or field.default is None for field in fields(command)[1:-1])
    assert (function.__doc__ or "").startswith(command.__doc__)
    assert function.__name__ in dir(aerial_gym)


def test_wrong_arguments_are_refused_as_the_command_refuses_them() -> None:
    assert_refused(ConfigError, "train: .*'max_time'. Did you mean 'max_time_s'", train, max_time=3)
    assert_refused(ConfigError, "train: max_time_s = 'long': must be a number", train, max_time_s="long")
    assert_refused(ConfigError, "evaluate: json belongs to the command line", evaluate, HOVER, json=True)
    assert_refused(ConfigError, "evaluate: field 'policy' is missing", evaluate)
    assert_refused(UnknownNameError, "no task 'hover'", train, "hover")
    assert_refused(DataError, "nowhere.csv", close_loop, "x500", train="nowhere.csv", test="nowhere.csv", out="out")


def test_check_returns_the_report_that_the_command_prints(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["robot", "check", "x500", "--no-fly", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    (report,) = check("x500", fly=False)
    assert json.loads(json.dumps(report.as_mapping())) == printed
    assert (
        repr(report) == "RobotReport x500: 1.656 kg, 4 rotors, hovers at 20% of the thrust range, thrust to weight 4.92"
    )
    assert len(check(["x500", "tinyprop"], fly=False)) == 2


def test_a_training_can_be_evaluated_and_played(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = tmp_path / "run"
    result = train(num_envs=64, max_env_steps=2048, device="cpu", seed=3, out=str(run))
    assert repr(result).startswith("TrainingResult: ppo, 2,048 environment steps")
    assert repr(RunFolder(run)).startswith(
        f"RunFolder {run}: position_setpoint_task, trainer ppo, 64 environments; checkpoint_"
    )
    assert repr(RunFolder(tmp_path)) == f"RunFolder {tmp_path}: no run"
    figures = evaluate(str(run), num_envs=8)
    assert main(["evaluate", "--policy", str(run), "--num-envs", "8", "--json"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1]) == vars(figures)
    assert repr(figures).startswith("Evaluation: of 8 starts ")
    assert capsys.readouterr().out == ""


def test_play_returns_the_flights_that_the_command_writes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flights = play(HOVER, num_envs=3, num_steps=5, out=tmp_path / "flights.csv")
    assert main(["play", "--policy", HOVER, "--num-envs", "3", "--num-steps", "5"]) == 0
    printed = capsys.readouterr().out
    assert (tmp_path / "flights.csv").read_text(encoding="utf-8") == printed
    assert flights["p_z"].shape == (6, 3)
    assert flights["t"][:, 0].tolist() == pytest.approx([0.01 * step for step in range(6)])
    column = [float(line.split(",")[4]) for line in printed.splitlines()[1:]]
    np.testing.assert_array_equal(flights["p_z"].ravel(), column)
    assert repr(flights).startswith("FlightTable: 18 rows of 3 environments; columns t, env, p_x")
    assert_refused(UnknownNameError, "no column 'p_zz'. Did you mean 'p_z'", flights.__getitem__, "p_zz")
