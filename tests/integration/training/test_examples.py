"""Examples run as they stand, shortly; a training becomes C on the command line."""

import json
import re
import runpy
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from shutil import which

import numpy as np
import pytest
import torch

from aerial_gym import task_registry
from aerial_gym.cli.main import main
from aerial_gym.config import dump_yaml
from aerial_gym.rl_training import load_settings, settings_for
from aerial_gym.rl_training.run.run_folder import RunFolder

EXAMPLES = Path(__file__).parents[3] / "examples"

TASKS = task_registry.names()  # Those of the package: examples that run in the same process register more


@pytest.mark.slow
def test_motor_commands_become_c_code(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.setattr("sys.argv", ["motor_commands.py", str(tmp_path / "run"), "3"])
    runpy.run_path(str(EXAMPLES / "motor_commands.py"), run_name="__main__")
    assert "beside the target" in capsys.readouterr().out
    header = (tmp_path / "run" / "export" / "motors.h").read_text()
    assert "[N]" in header  # thrusts come out
    assert "rotation_rows: the first two rows of the rotation matrix body to world" in header


@pytest.mark.slow
def test_a_student_of_noisy_sensors_learns_from_its_teacher(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.setattr("sys.argv", ["student_of_noise.py", str(tmp_path), "2"])
    runpy.run_path(str(EXAMPLES / "student_of_noise.py"), run_name="__main__")
    told = capsys.readouterr().out
    assert all(f"{run}: " in told for run in ("teacher", "student", "forgetful"))


@pytest.mark.slow
def test_a_drawn_flight_ends_where_its_episode_does() -> None:
    """At full thrust a vehicle leaves the arena, 2.5 m high, within two seconds; after that there are no places."""
    flights = runpy.run_path(str(EXAMPLES / "race_picture.py"))["flights"]
    with task_registry.make_task("racing_random_track_task", num_envs=3, device="cpu", seed=0) as task:
        observation, _ = task.reset()
        full = torch.tensor([[1.0, 0.0, 0.0, 0.0]]).expand(3, 4)
        places, speeds = flights(lambda seen: full, task, observation)
    height, steps = places[..., 2], places.shape[1]
    assert steps < 100
    assert bool((height[:, 0] < 0.1).all())
    assert 2.3 < float(height.nan_to_num(0.0).max()) < 2.5
    assert torch.equal(height.isnan(), speeds.isnan())
    assert int(height[:, -1].isnan().sum()) < 3  # the last one is in flight in the last row


@pytest.mark.slow
def test_reversible_rotors_hover_upside_down(capsys: pytest.CaptureFixture[str]) -> None:
    """Body z points down, and all rotors turn backwards at the speed of hover, ``sqrt(m g / 4 k)`` = 1326 rad/s."""
    runpy.run_path(str(EXAMPLES / "upside_down.py"), run_name="__main__")
    up, away, speed = (float(number) for number in re.findall(r"-?[\d.]+", capsys.readouterr().out))
    assert up < -0.999
    assert away < 0.01
    assert speed == pytest.approx(-1326.0, abs=5.0)


Told = Callable[..., list[tuple[str, list[float]]]]
"""From a file in ``examples/tasks`` and its arguments to its lines: what stands before the colon, and the numbers behind it."""


@pytest.fixture
def run_example(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Told:
    def run(name: str, *arguments: object) -> list[tuple[str, list[float]]]:
        monkeypatch.syspath_prepend(str(EXAMPLES / "tasks"))
        monkeypatch.setattr("sys.argv", [name, *map(str, arguments)])
        runpy.run_path(str(EXAMPLES / "tasks" / name), run_name="__main__")
        lines = [line.partition(": ") for line in capsys.readouterr().out.splitlines()]
        return [(label, [float(number) for number in re.findall(r"[\d.]+(?=%| m)", rest)]) for label, _, rest in lines]

    return run


@pytest.mark.slow
def test_a_law_holds_a_point_by_body_rates_and_by_rotor_thrusts(run_example: Told) -> None:
    caught = run_example("hold.py", 64, "recovery_task", "position_setpoint_task_sim2real_px4")
    assert all(lost < 15.0 for _, (lost, *_) in caught)
    assert all(error < 0.01 and stay == 100.0 for label, (_, error, stay, _) in caught if "px4" in label)


SOFT = ("position_setpoint_task_morphy", "position_setpoint_task_morphy_stiff")
RIGID = (
    *("position_setpoint_task", "position_setpoint_task_sim2real", "position_setpoint_task_acceleration_sim2real"),
    "smooth_position_setpoint_task",
)


@pytest.mark.slow
@pytest.mark.parametrize(("tasks", "most"), [(SOFT, 0.15), (RIGID, 0.02)], ids=["soft and stiff arms", "other actions"])
def test_a_law_holds_a_point(run_example: Told, tasks: tuple[str, ...], most: float) -> None:
    """By attitude, velocities and accelerations."""
    for _, (lost, error, stay, _) in run_example("hold.py", 16, *tasks):
        assert lost == 0.0
        assert error < most
        assert stay == 100.0


@pytest.mark.slow
def test_a_law_that_waits_above_a_platform_lands_on_it(run_example: Told) -> None:
    (_, (_, crash)), (_, (landed, less)) = run_example("land.py", 64)
    assert landed > 40.0
    assert less < 20.0 < crash


@pytest.mark.slow
def test_a_law_that_knows_its_load_holds_it_at_its_point(run_example: Told) -> None:
    (_, (held, far)), (_, (more, near)) = run_example("carry.py", 64)
    assert held == 0.0
    assert more > 50.0
    assert near < 0.03 < far


@pytest.mark.slow
def test_a_law_flies_through_gates_one_over_the_other(run_example: Told) -> None:
    ((_, (complete, crash, *_)),) = run_example("race.py", 16)
    assert complete > 80.0
    assert crash < 20.0


@pytest.mark.slow
def test_a_law_that_leads_follows_more_closely(run_example: Told, tmp_path: Path) -> None:
    (_, (_, behind)), (_, (_, near)), (_, (_, far)), (_, (_, less)) = run_example("follow.py", tmp_path / "out.png", 16)
    assert near < 0.25 * behind
    assert less < far
    assert (tmp_path / "out.png").read_bytes().startswith(b"\x89PNG")
    (_, (_, behind)), (_, (_, near)) = run_example("follow.py", tmp_path / "smooth.png", 16, "smooth_tracking_task")
    assert near < 0.25 * behind


@pytest.mark.slow
def test_smooth_tracks_are_followed_more_closely_by_their_acceleration(run_example: Told) -> None:
    (_, (slow, _)), (_, (near, speed)), (_, (quick, _)), (_, (less, faster)) = run_example("smooth_track.py", 16)
    assert near < 0.5 * slow
    assert less < 0.5 * quick
    assert 1.0 < speed < 2.5 < faster < 5.0


@pytest.mark.slow
@pytest.mark.parametrize("name", runpy.run_path(str(EXAMPLES / "tasks" / "learn.py"))["TASKS"])
def test_what_no_law_flies_is_learned(run_example: Told, tmp_path: Path, name: str) -> None:
    ((label, (right, crash)),) = run_example("learn.py", tmp_path, 1, 16, name)
    assert label == name
    assert 0.0 <= right + crash <= 100.0
    assert (tmp_path / name / "curve.csv").exists()


@pytest.mark.parametrize("name", TASKS)
def test_each_task_has_a_short_example(name: str) -> None:
    files = [path for path in EXAMPLES.rglob("*.py") if re.search(rf"\b{name}\b", path.read_text(encoding="utf-8"))]
    assert any(len(path.read_text(encoding="utf-8").splitlines()) < 60 for path in files)


@pytest.mark.slow
def test_a_rule_flies_through_obstacles_seen_as_cells_logarithms_and_images(run_example: Told) -> None:
    tasks = ("navigation_task", "safe_navigation_task", "pixel_navigation_task")
    few = run_example("through_obstacles.py", 32, *tasks)[::2]
    assert all(arrive > 60.0 and crash < 25.0 for _, (arrive, crash) in few)
    assert len(few) == 3


@pytest.mark.slow
def test_a_rule_flies_backwards_by_lidar(run_example: Told) -> None:
    (_, (arrive, crash)), _ = run_example("backwards_by_lidar.py", 32)
    assert arrive > 80.0
    assert crash < 15.0


def test_a_task_of_an_own_file_is_trained_and_evaluated_from_any_folder(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(EXAMPLES)
    out = str(tmp_path / "run")
    asked = ["--trainer", "ppo", "--num-envs", "256", "--max-env-steps", "9000", "--max-time-s", "120", "--out", out]
    assert main(["train", "--task", "custom_task.py:FIGURE_EIGHT", *asked, "--device", "cpu"]) == 0
    monkeypatch.chdir(tmp_path)
    capsys.readouterr()
    assert main(["evaluate", "--policy", out, "--num-envs", "4", "--device", "cpu", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["num_starts"] == 4


@pytest.mark.parametrize(
    "more", [pytest.param((), id="random"), pytest.param(("--population",), id="population", marks=pytest.mark.slow)]
)
def test_a_search_leaves_a_policy(more: tuple[str, ...], tmp_path: Path) -> None:
    """With Ray Tune, on a CPU; in a process of its own, as Ray starts servers."""
    reason = "Ray Tune is not installed: pip install 'aerial-gym[tune]'"
    pytest.importorskip("ray.tune", reason=reason, exc_type=ImportError)
    size = ("--device", "cpu", "--num-envs", "64", "--samples", "2", "--slices", "2", "--slice-steps", "4096")
    script = str(EXAMPLES / "search_with_ray_tune.py")
    command = [sys.executable, script, *size, "--out", str(tmp_path / "search"), *more]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    [said] = [line for line in done.stdout.splitlines() if line.startswith("evaluate it:")]
    kept = RunFolder(said.split("--policy ")[1]).newest_readable_checkpoint()
    assert kept[1]["env_steps"] >= 2 * 4096


@pytest.mark.parametrize("robot", ["base_quadrotor", "x500", "crazyflie_21", "tinyprop"])
def test_a_policy_of_another_simulator_hovers_but_loses_a_vehicle_of_little_thrust(robot: str) -> None:
    """Axes, signs, order of the rotors and steps are those that it knows; x500 counts its rotors in another order. It keeps
    41 % of 64 of ``tinyprop`` (thrust to weight 1.31); fewer than 1 % of draws of 16 are out of bounds."""
    errors = runpy.run_path(str(EXAMPLES / "outside_policy.py"))["hover_errors"](robot, num_envs=16, seconds=6.0)
    assert errors.shape == (16,)
    if robot == "tinyprop":
        assert 0.31 < float(np.isinf(errors).mean()) < 0.88
    else:
        assert float(np.max(errors)) < 0.05


@pytest.mark.skipif(which("gcc") is None and which("cc") is None, reason="needs a C compiler")
def test_a_training_is_exported_and_flies_as_it_did(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run, settings = tmp_path / "run", tmp_path / "small.yaml"
    cfg = load_settings(settings_for("ppo", "position_setpoint_task"))
    settings.write_text(dump_yaml(cfg))
    train = ["train", "--config", str(settings), "--num-envs", "32", "--max-env-steps", "2048", "--device", "cpu"]
    assert main([*train, "--out", str(run)]) == 0
    assert main(["export", "--policy", str(run), "--to", "c99", "torchscript", "--name", "hover", "--json"]) == 0
    rows = [json.loads(line) for line in capsys.readouterr().out.splitlines() if line.startswith("{")]
    assert [row["to"] for row in rows[-2:]] == ["c99", "torchscript"]
    assert all(row["agrees"] for row in rows[-2:])
    returns = []
    for policy in (run, run / "export" / "hover.c", run / "export" / "hover.pt"):
        assert main(["evaluate", "--policy", str(policy), "--num-envs", "8", "--json"]) == 0
        returns.append(json.loads(capsys.readouterr().out.splitlines()[-1])["return_mean"])
    assert returns[1:] == pytest.approx(returns[:1] * 2, rel=1e-4)
    assert main(["evaluate", "--policy", str(tmp_path / "no.onnx"), "--num-envs", "8"]) == 2
