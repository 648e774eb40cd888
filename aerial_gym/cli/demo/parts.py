"""Parts of the demo: cameras, training and closed loop. Each returns the content of its section of the page."""

import csv
import subprocess
import sys
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from aerial_gym.cli.render_gallery import id_colors, png_url, share_colors
from aerial_gym.cli.terminal import progress_bar
from aerial_gym.env_manager import SimBuilder
from aerial_gym.errors import DataError
from aerial_gym.rl_training.evaluation import evaluate
from aerial_gym.rl_training.policies.load import load_policy
from aerial_gym.rl_training.settings import load_settings, settings_for
from aerial_gym.rl_training.training import train
from aerial_gym.sensors import SENSORS
from aerial_gym.sim2real.loop import close_loop
from aerial_gym.sim2real.report.canvas import panels
from aerial_gym.sim2real.report.figures import figures_of_errors
from aerial_gym.sim2real.report.plots import CORRECTED, FLIGHTS, MEASURED
from aerial_gym.sim2real.report.tables import channel_rows
from aerial_gym.sim2real.report.verdict_json import verdict_json
from aerial_gym.task import task_registry

NUM_PICTURES = 4
NUM_EVALUATION_STARTS = 512
NUM_DRAWN_FLIGHTS = 24
SUCCESS_M = 0.1  # Distance of the level in the figure of flights

TRAIN_PATTERNS = ("square_*.csv", "random*.csv", "multisine_*.csv")
TEST_PATTERN = "melon_*.csv"
TRAIN_EVERY = 4  # Every so many of them is trained on: all take minutes


def record_cameras(seed: int, backend: str | None = None) -> dict[str, Any]:
    """Simulate a few steps in the obstacle environment and return the camera images as ``data:`` addresses."""
    env = SimBuilder().build_env(
        sim_name="base_sim", env_name="env_with_obstacles", robot_name="base_quadrotor_with_camera",
        controller_name="lee_velocity_control", num_envs=NUM_PICTURES, device="cpu", seed=seed, backend=backend,
    )  # fmt: skip
    env.reset()
    for _ in range(5):
        env.step(torch.tensor([0.5, 0.0, 0.0, 0.0]).expand(NUM_PICTURES, 4))
    env.render()
    depth, ids = env.gtd["depth_range_pixels"][:, 0].numpy(), env.gtd["segmentation_pixels"][:, 0].numpy()
    far = SENSORS.get("base_depth_camera").max_range
    pictures = [
        {
            "depth": png_url(share_colors(np.where(image < 0.0, np.nan, image / far))),
            "segmentation": png_url(id_colors(labels)),
        }
        for image, labels in zip(depth, ids, strict=True)
    ]
    return {"pictures": pictures, "tensors": str(env.gtd)}


def train_hover(out: Path, seed: int, time_s: float, backend: str | None = None) -> dict[str, Any]:
    """Train a policy from scratch, evaluate it on fresh starts, and return figures and numbers."""
    cfg = load_settings(settings_for("ppo", "position_setpoint_task", device="cpu"))
    result = train(replace(cfg, seed=seed, max_time_s=time_s, device="cpu", backend=backend), out / "training")
    policy, _ = load_policy(out / "training")
    with task_registry.make_task(
        cfg.task, num_envs=NUM_EVALUATION_STARTS, device="cpu", seed=seed + 1_000_003, backend=backend
    ) as task:
        evaluation = evaluate(policy, task)
        figure = flights_figure(_position_errors(policy, task), task.env.dt)
    return {
        "result": asdict(result),
        "evaluation": asdict(evaluation),
        "curve": learning_figure(out / "training" / "curve.csv"),
        "flights": figure,
    }


@torch.no_grad()
def _position_errors(policy: Any, task: Any) -> Any:
    """Return the errors (T, n, 3) [m] of some flights of one episode."""
    observation, _ = task.reset()
    policy.reset()
    rows = []
    for _ in range(task.cfg.episode_len_steps - 1):
        rows.append(-observation["observations"][:NUM_DRAWN_FLIGHTS, :3].double().numpy())
        observation, _, terminated, truncated, _ = task.step(policy(observation))
        policy.reset(terminated | truncated)
    return np.stack(rows)


@dataclass(frozen=True, kw_only=True)
class DemoFlights:
    """Flight logs for the loop, with their description."""

    robot: str  # Registered robot or robot file
    train: tuple[Path, ...]  # Training flights
    test: tuple[Path, ...]  # Test flights
    mapping: str | None  # Layout of the logs; None for this package's own
    story: str  # One paragraph for the page


def find_or_simulate_flights(folder: Path | None, out: Path, seed: int) -> DemoFlights:
    """Return the measured flights in ``folder``, or flights of the independent plant where there are none.

    Raises:
        DataError: If a folder was asked for and holds no such flights, or the plant is not there either.
    """
    if folder is not None:
        trains = tuple(sorted(path for pattern in TRAIN_PATTERNS for path in folder.glob(pattern))[::TRAIN_EVERY])
        tests = tuple(sorted(folder.glob(TEST_PATTERN)))
        if not trains or not tests:
            raise DataError(f"{folder}: holds no {', '.join(TRAIN_PATTERNS)} and {TEST_PATTERN}; leave out --flights")
        story = (
            "Real flights of a Crazyflie 2.1 Brushless with measured rotor speeds (Busetto et al., arXiv 2512.14450). "
            f"The loop learns from {len(trains)} flights along squares, random paths and multisines and is scored on "
            f"{len(tests)} flights along another trajectory. The declared vehicle has no drag."
        )
        return DemoFlights(
            robot="crazyflie_21_brushless", train=trains, test=tests, mapping="idsia_nanodrone", story=story
        )
    return _flights_of_plant(out / "flights", seed)


def _flights_of_plant(folder: Path, seed: int) -> DemoFlights:
    homes = (Path(__file__).parents[3], Path(__file__).parent / "plant")  # of a clone, and of a wheel (`setup.py`)
    root = next((home for home in homes if (home / "benchmarks" / "undeclared").is_dir()), None)
    if root is None:
        raise DataError("no measured flights and no benchmarks/undeclared beside the package: give --flights FOLDER")
    folder = folder.resolve()  # the plant runs in another folder
    command = [sys.executable, "-m", "benchmarks.undeclared", "--out", str(folder), "--seed", str(seed)]
    command += ["--effect", "com_offset", "--nuisance"]
    done = subprocess.run(command, cwd=root, capture_output=True, encoding="utf-8", errors="replace", check=False)
    if done.returncode != 0:
        raise DataError(f"the undeclared plant failed: {done.stderr.strip()}")
    story = (
        "Flights of an independent simulated plant (benchmarks/undeclared, no shared code) whose centre of mass is not "
        "where its robot file says, with sensor noise and small errors everywhere else. The loop is not told what is wrong."
    )
    trains, tests = (tuple(sorted(folder.glob(f"{role}_*.csv"))) for role in ("train", "test"))
    return DemoFlights(robot=str(folder / "robot.yaml"), train=trains, test=tests, mapping=None, story=story)


def close_the_loop(flights: DemoFlights, out: Path) -> dict[str, Any]:
    """Run the closed loop on the flights; return the content of ``verdict.json``, and table and figures of the errors."""
    with progress_bar() as progress:
        verdict = close_loop(
            flights.robot, flights.train, flights.test, out, mapping=flights.mapping, progress=progress
        )
    before, after = verdict.before, verdict.after if verdict.corrects else None
    return {
        "story": flights.story,
        "verdict": verdict_json(verdict),
        "rows": channel_rows(before, after, verdict.outcomes),
        "figures": figures_of_errors(before, after),
    }


def learning_figure(curve_file: Path) -> str:
    """Return the mean return of an episode over training time as a figure."""
    with curve_file.open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["episode_return"]]
    figure, ((panel,),) = panels(1, 1, width=8.0, height=2.4, title="Mean return of an episode", zooms=True)
    time, returns = (np.array([float(row[name]) for row in rows]) for name in ("time_s", "episode_return"))
    panel.line(time, returns, CORRECTED)
    panel.x_label = "training time [s]"
    return figure.html()


def flights_figure(paths: NDArray[np.float64], dt: float) -> str:
    """Return distance to the target over time, and the paths from above; ``paths`` (T, n, 3) are errors [m]."""
    figure, ((left, right),) = panels(1, 2, width=(5.0, 3.2), height=3.2, title=f"{paths.shape[1]} flights")
    left.log, left.zooms, right.square = True, True, True
    for number, path in enumerate(np.moveaxis(paths, 1, 0)):
        colour = FLIGHTS[number % len(FLIGHTS)]
        left.line(dt * np.arange(len(path)), np.linalg.norm(path, axis=-1), colour)
        right.line(path[:, 0], path[:, 1], colour)
    left.levels.append(SUCCESS_M)
    right.dots(np.zeros(1), np.zeros(1), MEASURED, width=5.0)
    left.title, left.x_label, left.y_label = "distance to the target", "t [s]", "[m]"
    right.title, right.x_label, right.y_label = "from above", "x [m]", "y [m]"
    return figure.html()
