"""Golden results of tasks: 100 steps of every registered task on the ``torch`` and the ``warp`` backend. Letters: E
environments."""

from collections import defaultdict
from hashlib import sha256
from typing import Any

import torch
from torch import Tensor

from aerial_gym.task import Task, task_registry

BACKENDS = ("torch", "warp")

NUM_ENVS, STEPS, SEED = 4, 100, 3

EARLY = (1, 10)
"""Steps whose numbers are stored: rounding has not grown yet."""

HAS_PROSE = False

TOLERANCE_ELSEWHERE = 5e-3
"""Largest relative difference of early numbers on another machine; AVX-512 in place of SSE changes them by up to 3e-4."""

QUICK = ("dce_navigation_task", "racing_task")
"""Tasks that run with every test run: obstacles with a camera and an encoder, gates."""


def items() -> dict[str, bool]:
    """Return the names of all results, and whether each is a quick one."""
    return {f"{task}/{backend}": task in QUICK for task in task_registry.names() for backend in BACKENDS}


def measure(item: str) -> dict[str, Any]:
    """Return hashes, early numbers and keys of one task on one backend."""
    name, backend = item.split("/")
    with task_registry.make_task(name, num_envs=NUM_ENVS, device="cpu", seed=SEED, backend=backend) as task:
        return _fly(task)


def _fly(task: Task) -> dict[str, Any]:
    generator = torch.Generator().manual_seed(SEED)
    low, high = (torch.as_tensor(bound) for bound in (task.action_space.low, task.action_space.high))
    observation, _ = task.reset(seed=SEED)
    hashes = {key: sha256(_bytes(value)) for key, value in observation.items()}
    early: dict[str, Any] = {f"reset/{key}": _numbers(value) for key, value in observation.items()}
    ended: dict[str, int] = defaultdict(int)
    info: dict[str, Tensor] = {}
    for step in range(1, STEPS + 1):
        action = low + (high - low) * torch.rand((task.num_envs, *low.shape), generator=generator)
        observation, reward, terminated, truncated, info = task.step(action)
        values = {**observation, "rewards": reward, "terminated": terminated, "truncated": truncated}
        for key, value in values.items():
            hashes.setdefault(key, sha256()).update(_bytes(value))
        ended["terminated"] += int(terminated.sum())
        ended["truncated"] += int(truncated.sum())
        if step in EARLY:
            early |= {f"{step}/{key}": _numbers(values[key]) for key in (*observation, "rewards")}
            early |= {f"{step}/{key}": count for key, count in ended.items()}
    late = {key: _numbers(value) for key, value in observation.items()} | dict(ended)
    keys = {
        "shapes": {key: list(value.shape[1:]) for key, value in observation.items()},
        "info": sorted(info),
        "rewards": list(task.reward_names),
        "tensors": sorted(task.env.gtd),
    }
    return {"hash": {key: each.hexdigest()[:12] for key, each in hashes.items()}, "early": early, "late": late, **keys}


def _bytes(value: Tensor) -> bytes:
    """Return the bytes of a tensor; both zeros are the same."""
    return (value + 0.0 if value.is_floating_point() else value).contiguous().numpy().tobytes()


def _numbers(value: Tensor) -> list[float]:
    """Return mean and root mean square."""
    value = value.double()
    return [float(value.mean()), float(value.square().mean().sqrt())]
