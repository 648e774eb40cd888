"""Evaluation of a policy: position error, settling and crashes over one episode per environment.

Letters: E environments, O entries of an observation, U entries of an action.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import inf

import torch
from torch import Tensor, nn

from aerial_gym.errors import ConfigError
from aerial_gym.interop import usual_settings
from aerial_gym.rl_training.policies.policy import Pilot, Policy
from aerial_gym.rl_training.policies.pursuit import PursuitPilot
from aerial_gym.task import Task
from aerial_gym.task.commands.evader import IS_LEARNED
from aerial_gym.task.step.judge import COLLISIONS, GATE_PASSED

SUCCESS_RADIUS_M = 0.1  # A flight succeeds, and has settled, within this distance of its target [m], if no task says


FINAL_SPAN_S = 1.0  # The final error is the mean distance over this last part of an episode [s]


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """Figures over the first episode of every environment. Errors and settling are of the flights without a crash."""

    num_starts: int  # Random starts E, each of one vehicle
    episode_s: float  # Length of an episode [s]
    success_rate: float  # Share of flights without a crash that end within the success radius, or the task's own
    crash_rate: float  # Share of flights that crashed
    timeout_rate: float  # Share of flights that did neither: they lasted to the end and were not there
    final_error_mean_m: float | None  # Mean distance over the last second [m]; None if all crashed or have no aim
    final_error_p95_m: float | None  # 95th percentile of it [m]
    final_error_max_m: float | None  # Largest of it [m]
    settled_rate: float  # Share of flights that came within the success radius and stayed
    settling_time_mean_s: float | None  # Mean time from which a flight stays within the success radius [s]
    settling_time_p95_s: float | None  # 95th percentile of it [s]
    success_time_mean_s: float | None  # Mean time at which flights succeeded [s], as of a race; None if none did
    gates_passed_mean: float | None  # Mean number of gates passed per flight; None without gates
    collision_rate: float | None  # Share of flights in which the vehicle touched another one; None with one vehicle
    learned_evader_success_rate: float | None = None  # Success rate against a learned evader; None without one
    return_mean: float  # Mean sum of rewards
    success_radius_m: float  # The radius [m]
    reward_terms: dict[str, float]  # Mean return of each reward term of the task; their sum is `return_mean`
    ended_by: dict[str, float]  # Share of flights that each termination of the task ended; `time_out` is its length

    def __repr__(self) -> str:
        rates = f"{self.success_rate:.1%} succeeded, {self.crash_rate:.1%} crashed, {self.timeout_rate:.1%} timed out"
        parts = [f"Evaluation: of {self.num_starts} starts {rates}"]
        for name, value, unit in (
            ("mean final error", self.final_error_mean_m, " m"), ("mean settling time", self.settling_time_mean_s, " s"),
            ("mean time to success", self.success_time_mean_s, " s"), ("mean gates passed", self.gates_passed_mean, ""),
            ("collision rate", self.collision_rate, ""),
            ("success rate against the learned evader", self.learned_evader_success_rate, ""),
        ):  # fmt: skip
            parts += [] if value is None else [f"{name} {value:.3g}{unit}"]
        return "; ".join(parts)


@dataclass(frozen=True, kw_only=True)
class Flights:
    """The first episode of every environment of a task, row by row."""

    succeeded: Tensor  # Whether it succeeded, bool (E,)
    crashed: Tensor  # bool (E,)
    final_error: Tensor  # Mean distance over the last second [m], infinite without a target, (E,)
    last_outside: Tensor  # Last step outside the success radius, int, (E,)
    ended_at: Tensor  # Step of its end, (E,)
    total: Tensor  # Sum of rewards, (E,)
    collided: Tensor | None  # Whether it touched another vehicle, bool (E,); None with one vehicle
    gates_passed: Tensor | None  # Number of gates passed, (E,); None without gates
    tallies: Tensor  # Sums of the episode for ``Task.means_of_tallies``, (E, N)
    success_radius: float  # [m]


@torch.no_grad()
@usual_settings
def fly_episodes(
    policy: Pilot, task: Task, *, success_radius: float | None = None,
    on_start: Callable[[Task], None] | None = None, on_step: Callable[[int, int], None] | None = None,
) -> Flights:  # fmt: skip
    """Fly one episode in every environment of ``task``, which is reset first.

    Args:
        policy: Its memory is cleared at the start and at the end of each episode.
        task: Where to fly; its seed decides the starts.
        success_radius: Distance that counts as there [m]; the task's own, or ``SUCCESS_RADIUS_M``, if not given.
        on_start: Called after the reset, before the first step.
        on_step: Called with the number of the step and of all steps.

    Raises:
        ConfigError: If the policy is on another device than the task.
    """
    where = next(policy.parameters()).device if isinstance(policy, nn.Module) else task.device
    if where != task.device:
        raise ConfigError(f"policy: is on {where}, the task on {task.device}. Use load_policy(..., device=task.device)")
    steps, dt = task.cfg.episode_len_steps, task.env.dt
    final_steps = min(steps, max(1, round(FINAL_SPAN_S / dt)))
    ends_count = success_radius is None and task.cfg.defines_success
    radius = success_radius or task.cfg.success_radius or SUCCESS_RADIUS_M
    observation, _ = task.reset()
    if on_start is not None:
        on_start(task)
    policy.reset()
    flying = torch.ones(task.num_envs, dtype=torch.bool, device=task.device)
    crashed = torch.zeros_like(flying)
    total, error_sum = torch.zeros(task.num_envs, device=task.device), torch.zeros(task.num_envs, device=task.device)
    succeeded, collided = torch.zeros_like(flying), torch.zeros_like(flying)
    passed, ended_at = torch.zeros_like(total), torch.full_like(total, steps)
    no_gates, no_others = True, True
    earlier, tallies = task.tallies.clone(), torch.zeros_like(task.tallies)
    distance = torch.zeros_like(total)
    nowhere = torch.full_like(total, inf)  # of a task without a target
    outside_until = torch.zeros(task.num_envs, dtype=torch.int64, device=task.device)
    for step in range(1, steps + 1):
        observation, reward, terminated, truncated, info = task.step(policy(observation))
        policy.reset(terminated | truncated)
        distance = torch.where(
            flying, info.get("distance", nowhere), distance
        )  # of an episode that is over, the last one
        total += torch.where(flying, reward, 0.0)
        crashed |= flying & info["crashes"]
        if ends_count:
            succeeded |= flying & info["successes"]
        if COLLISIONS in info:
            collided, no_others = collided | (flying & info[COLLISIONS]), False
        if GATE_PASSED in info:
            passed, no_gates = passed + (flying & info[GATE_PASSED]), False
        ended = terminated | truncated
        ended_at = torch.where(flying & ended, step, ended_at)
        tallies = torch.where((flying & ended).unsqueeze(-1), task.tallies - earlier, tallies)
        flying &= ~ended
        outside_until = torch.where(distance < radius, outside_until, step)
        if step > steps - final_steps:
            error_sum += distance
        if on_step is not None:
            on_step(step, steps)
    error = error_sum / final_steps
    return Flights(
        succeeded=succeeded if ends_count else ~crashed & (error < radius), crashed=crashed, final_error=error,
        last_outside=outside_until, ended_at=ended_at, total=total,
        collided=None if no_others else collided, gates_passed=None if no_gates else passed,
        tallies=tallies, success_radius=radius,
    )  # fmt: skip


@torch.no_grad()
def evaluate(
    policy: Pilot, task: Task, *, success_radius: float | None = None,
    on_step: Callable[[int, int], None] | None = None, evader: Policy | None = None,
) -> Evaluation:  # fmt: skip
    """Return the figures of one episode in every environment of ``task``; arguments and errors as of ``fly_episodes``.
    A learned ``evader`` flees in further episodes, as many."""
    flown = fly_episodes(policy, task, success_radius=success_radius, on_step=on_step)
    escaped = None
    if evader is not None:
        escaped = fly_episodes(
            PursuitPilot(policy, evader, task), task, success_radius=success_radius, on_step=on_step
        ).succeeded
        task.values.own[IS_LEARNED].zero_()  # later flights are from the rule
    count, steps, dt = task.num_envs, task.cfg.episode_len_steps, task.env.dt
    error = flown.final_error[~flown.crashed & flown.final_error.isfinite()]
    settling = (flown.last_outside * dt)[~flown.crashed & (flown.last_outside < steps)]
    means = task.means_of_tallies(flown.tallies)
    return Evaluation(
        num_starts=count, episode_s=steps * dt, success_rate=float(flown.succeeded.sum()) / count,
        crash_rate=float(flown.crashed.sum()) / count,
        timeout_rate=float((~flown.succeeded & ~flown.crashed).sum()) / count, final_error_mean_m=_mean_or_none(error),
        final_error_p95_m=_percentile95_or_none(error),
        final_error_max_m=float(error.max()) if error.numel() else None,
        settled_rate=settling.numel() / count, settling_time_mean_s=_mean_or_none(settling),
        settling_time_p95_s=_percentile95_or_none(settling),
        success_time_mean_s=_mean_or_none((flown.ended_at * dt)[flown.succeeded]),
        collision_rate=None if flown.collided is None else float(flown.collided.sum()) / count,
        learned_evader_success_rate=None if escaped is None else float(escaped.sum()) / count,
        gates_passed_mean=None if flown.gates_passed is None else float(flown.gates_passed.mean()),
        return_mean=float(flown.total.mean()), success_radius_m=flown.success_radius,
        reward_terms=_part(means, "reward/"), ended_by=_part(means, "ended/"),
    )  # fmt: skip


def _part(means: dict[str, float], prefix: str) -> dict[str, float]:
    return {name.removeprefix(prefix): mean for name, mean in means.items() if name.startswith(prefix)}


def _mean_or_none(values: Tensor) -> float | None:
    return float(values.double().mean()) if values.numel() else None


def _percentile95_or_none(values: Tensor) -> float | None:
    return float(torch.quantile(values.double(), 0.95)) if values.numel() else None
