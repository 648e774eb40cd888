"""``python -m benchmarks.speed.several_vehicles``: time of a step of E environments with V vehicles in each.

The figures are steps of ``--substeps`` substeps, replayed from one CUDA graph: physics alone, and physics with
collisions. ``--downwash`` lets the vehicles blow on each other. ``--render`` measures depth cameras of 64 x 64 pixels that see
the other vehicles and the obstacles of ``--environment``.
"""

import argparse
import statistics
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch

from aerial_gym import SimBuilder
from aerial_gym.config.changes import Changes
from aerial_gym.env_manager import EnvManager
from aerial_gym.env_manager.sim_builder import environment_by_name
from aerial_gym.robots.catalog import robot_by_name
from aerial_gym.workloads.measure import device_name, make_batch, print_figures, provenance, time_launches


@dataclass
class Repeated:
    """Calls of one part of a simulation, from states that are put back before each stretch."""

    env: EnvManager
    call: Callable[[], None]
    launches_per_batch: int = 20
    batches_per_stretch: int = 5

    def __post_init__(self) -> None:
        """Keep the start and record the calls."""
        self.device = self.env.device
        self._states = [group.state for group in self.env.kinds.values()]
        self._start = [state.clone() for state in self._states]
        self.run_batch = make_batch(self.call, self.launches_per_batch, self.device)

    def restore(self) -> None:
        """Put the states back."""
        for state, start in zip(self._states, self._start, strict=True):
            state.copy_(start)

    def check(self, *, started: bool) -> None:
        """Refuse states that are not finite."""
        del started
        if not all(bool(torch.isfinite(state).all()) for state in self._states):
            raise RuntimeError("a state is not finite: the figure would mean nothing")


def build(asked: argparse.Namespace, num_envs: int, vehicles: int) -> EnvManager:
    """Build ``num_envs`` environments with ``vehicles`` each."""
    robot = robot_by_name("base_quadrotor_with_camera" if asked.render else "base_quadrotor")
    settings = []
    if asked.downwash:
        settings += [f"robot.effects.downwash={asked.downwash_strength}"]
    if asked.render:
        settings += ["robot.sensors.depth_camera.width=64", "robot.sensors.depth_camera.height=64"]
    changes = Changes(tuple(settings))
    robot = changes.apply("robot", robot)
    changes.finish()
    where = replace(environment_by_name(asked.environment), physics_steps_per_env_step=asked.substeps)
    one = vehicles == 1
    env = SimBuilder().build_env(
        sim_name="base_sim", env_name=where, controller_name="lee_velocity_control", num_envs=num_envs,
        device=asked.device, seed=0, robot_name=robot if one else None,
        robots=None if one else [{"name": robot, "count": vehicles}],
    )  # fmt: skip
    env.reset()
    return env


def measure(asked: argparse.Namespace, num_envs: int, vehicles: int) -> dict[str, float]:
    """Return the times of the parts of one simulation [us], and rates."""
    env = build(asked, num_envs, vehicles)
    rows = (num_envs, vehicles) if vehicles > 1 else (num_envs,)
    actions = torch.zeros(*rows, env.robot_manager.num_actions, device=env.device)
    env.step(actions)

    def step() -> None:
        env.fly()
        env.collide()

    parts: dict[str, Callable[[], None]] = {
        "physics": env.fly,
        "step": step,
    }
    if asked.render:
        parts = {"render": env.render}
    figures: dict[str, float] = {"num_envs": num_envs, "vehicles": vehicles}
    for name, call in parts.items():
        seconds = time_launches(Repeated(env, call), repeats=asked.repeats, repeat_time_s=asked.repeat_time_s)
        figures |= {f"{name}_us": 1e6 * statistics.median(seconds), f"{name}_us_max": 1e6 * max(seconds)}
        if name == "render":
            figures["images_per_s"] = num_envs * vehicles / statistics.median(seconds)
        else:
            figures[f"{name}_substeps_per_s"] = num_envs * vehicles * asked.substeps / statistics.median(seconds)
    env.close()
    return figures


def main() -> None:
    """Measure each case and print its figures, and the ratio of each physics time to that of the first case."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="cuda")
    parser.add_argument("--cases", nargs="+", default=["65536x1", "8192x8"], help="environments x vehicles")
    parser.add_argument("--environment", default="empty_env")
    parser.add_argument("--substeps", type=int, default=10)
    parser.add_argument("--downwash", action="store_true", help="let the vehicles blow on each other")
    parser.add_argument("--downwash-strength", type=float, default=1.0)
    parser.add_argument("--render", action="store_true", help="measure depth images instead of steps")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--repeat-time-s", type=float, default=0.5)
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    first = None
    for case in asked.cases:
        num_envs, vehicles = (int(part) for part in case.split("x"))
        figures = measure(asked, num_envs, vehicles)
        key = "render_us" if asked.render else "physics_us"
        first = first or figures[key]
        figures["ratio_to_first"] = figures[key] / first
        settings = {name: getattr(asked, name) for name in ("environment", "substeps", "downwash")}
        print_figures(
            {"device": device_name(torch.device(asked.device)), **settings, **figures, **provenance()},
            as_json=asked.json,
        )


if __name__ == "__main__":
    main()
