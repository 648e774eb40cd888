"""Flights of PX4 in the simulation, for as long as it is asked to fly."""

import time
from dataclasses import dataclass, replace
from pathlib import Path

import torch

from aerial_gym.env_manager import SIMS
from aerial_gym.env_manager.sim_builder import environment_by_name
from aerial_gym.firmware.flight import OnStep, count_steps
from aerial_gym.firmware.px4.environment import PERIOD_S, Px4Env
from aerial_gym.firmware.px4.links import PORT
from aerial_gym.interop import usual_settings
from aerial_gym.robots.catalog import robot_by_name


@dataclass(frozen=True, kw_only=True)
class Px4Flight:
    """Figures of a flight, by environment."""

    instances: int
    duration_s: float
    wall_s: float  # Duration by the clock, without the wait for connections
    real_time_factor: float
    armed_s: list[float]  # Time with armed motors [s]
    highest_m: list[float]  # Largest height above the start [m]
    ended: dict[int, str]  # Instances that ended early, with the reason


def make_px4_env(robot: str | Path, *, instances: int, port: int = PORT, seed: int = 0) -> Px4Env:
    """Return vehicles at rest on flat ground, which wait for one instance of PX4 each."""
    ground = environment_by_name("landing_env")
    wide = {"bounds_upper_low": (500.0, 500.0, 500.0), "bounds_upper_high": (500.0, 500.0, 500.0)}
    wide |= {"bounds_lower_low": (-500.0, -500.0, 0.0), "bounds_lower_high": (-500.0, -500.0, 0.0)}
    env = Px4Env(
        port=port, sim=replace(SIMS.get("base_sim"), dt=PERIOD_S), env=replace(ground, **wide), num_envs=instances,
        robot=robot_by_name(robot), device=torch.device("cpu"), seed=seed,
    )  # fmt: skip
    env.reset()
    return env


@usual_settings
@torch.no_grad()
def fly_px4(env: Px4Env, *, duration: float, on_step: OnStep | None = None) -> Px4Flight:
    """Fly connected instances for a time [s], or until all have ended; ``on_step`` receives the share that is done."""
    steps = count_steps(env, duration)
    start, highest = env.gtd["robot_position"][:, 2].clone(), torch.zeros(env.num_envs)
    armed, begin, flown = torch.zeros(env.num_envs), time.perf_counter(), 0
    for step in range(steps):
        env.step()
        flown += 1
        highest = torch.maximum(highest, env.gtd["robot_position"][:, 2] - start)
        armed[[number for number, link in env.links.links.items() if link.armed]] += env.dt
        if on_step is not None:
            on_step((step + 1) / steps)
        if not env.links.links:
            break
    wall = time.perf_counter() - begin
    return Px4Flight(
        instances=env.num_envs, duration_s=flown * env.dt, wall_s=wall, real_time_factor=flown * env.dt / wall,
        armed_s=armed.tolist(), highest_m=highest.tolist(), ended=dict(env.ended),
    )  # fmt: skip
