"""One process of several that train together on a CPU; ``test_ranks.py`` starts them as ``torchrun`` would. usage:
python -m tests.integration.training.ranks_worker ACT OUT PORT ..."""

import os
import signal
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

import tests.conftest  # noqa: F401 - kernels as this test's process has them, and has compiled them
from aerial_gym.cli.main import main
from aerial_gym.rl_training import TrainingCfg, load_settings, settings_for, train
from aerial_gym.rl_training.ranks import Ranks, join_ranks
from aerial_gym.rl_training.run.progress import Progress, Report
from aerial_gym.rl_training.trainers.learners import PpoTrainer
from aerial_gym.rl_training.trainers.native import NativeTraining
from aerial_gym.task import task_registry

ENVS = 64  # Environments of all processes together
STEPS_OF_ONE = 16 * ENVS  # Environment steps of an iteration, in all processes together


def settings(size: int, **ppo: object) -> TrainingCfg:
    cfg = load_settings(settings_for("ppo", "position_setpoint_task", device="cpu"))
    cfg = replace(cfg, num_envs=ENVS // size, device="cpu", max_time_s=None, max_env_steps=100 * STEPS_OF_ONE)
    numbers = {"horizon": 16, "num_minibatches": 4, "normalize_observation": True} | ppo
    return replace(cfg, ppo=replace(cfg.ppo, **numbers))


def train_ranks(ranks: Ranks, *, iterations: int, like_one: bool) -> dict[str, Any]:
    """Return the training state of a process after some iterations; ``like_one``: explore as a single process does."""
    cfg = settings(ranks.size, **({"num_minibatches": 1} if like_one else {}))
    first = ranks.rank * cfg.num_envs
    with task_registry.make_task(cfg.task, num_envs=cfg.num_envs, device="cpu", seed=0, first_env=first) as task:
        training = PpoTrainer().make_training(cfg, task, ranks=ranks)
        draw, noise = torch.randn, torch.Generator().manual_seed(5)
        if like_one:
            torch.randn = lambda size, **_: draw(size[0], ENVS, size[2], generator=noise)[:, first : first + size[1]]
        try:
            for _ in range(iterations):
                training.advance()
        finally:
            torch.randn = draw
        kept = training.learner.state_tensors()
        common = {name: kept[name].clone() for name in kept if name.startswith(("adam", "rate", "sums"))}
        common |= training.state()["model"]
        seen = kept["observation.observations"].clone()
        return {"common": common, "seen": seen, "env_steps": training.env_steps}


def learn(out: Path, ports: list[str]) -> None:
    for name, like_one in (("own", False), ("one", True)):
        os.environ["MASTER_PORT"] = ports.pop()
        with join_ranks("cpu") as ranks:
            torch.save(train_ranks(ranks, iterations=2, like_one=like_one), out / f"{name}_{ranks.rank}.pt")


def resume(out: Path, ports: list[str]) -> None:
    """Train at one go, and interrupted by a signal to rank 1 alone; go on with what one process has trained."""
    cfg, update, updates = replace(settings(2), max_env_steps=6 * STEPS_OF_ONE), Progress.update, []

    def and_then_signal(self: Progress, report: Report) -> bool:
        updates.append(report)
        if len(updates) == 3 and os.environ["RANK"] == "1":
            signal.raise_signal(signal.SIGTERM)
        return update(self, report)

    def run(name: str, *, resume: bool) -> bool:
        os.environ["MASTER_PORT"] = ports.pop()
        return train(cfg, out / name, resume=resume, show_progress=False).interrupted

    assert not run("whole", resume=False)
    Progress.update = and_then_signal
    assert run("parts", resume=False)
    assert not run("parts", resume=True)
    assert not run("more", resume=True)


def fail(out: Path, ports: list[str]) -> None:
    """Train by the command; rank 1 fails in its third iteration."""
    advance, calls = NativeTraining.advance, []

    def fails(self: NativeTraining) -> Report:
        calls.append(self)
        if len(calls) == 3 and os.environ["RANK"] == "1":
            raise ValueError("a fault of rank 1")
        return advance(self)

    NativeTraining.advance = fails
    os.environ["MASTER_PORT"] = ports.pop()
    limits = ["--num-envs", "32", "--device", "cpu", "--max-env-steps", "99999"]
    sys.exit(main(["train", "--out", str(out / "fault"), *limits]))


def learn_with_rl_games(out: Path, ports: list[str]) -> None:
    """Train and go on; each process leaves the weights that it has whenever all of them save."""
    from aerial_gym.rl_training.adapters.rl_games import KeeperAgent

    cfg = load_settings(settings_for("rl_games", "position_setpoint_task"))
    cfg = replace(cfg, num_envs=32, device="cpu", max_time_s=None, max_env_steps=1, torch_threads=1)
    keep, saves = KeeperAgent.keep, []

    def and_leave_weights(self: KeeperAgent) -> None:
        keep(self)
        saves.append(self)
        model = {name: value.clone() for name, value in self.model.state_dict().items()}
        torch.save(model, out / f"save_{len(saves)}_{os.environ['RANK']}.pt")

    KeeperAgent.keep = and_leave_weights
    for iterations in (3, 5):
        os.environ["MASTER_PORT"] = ports.pop()
        steps = iterations * cfg.ppo.horizon * 2 * cfg.num_envs
        train(replace(cfg, max_env_steps=steps), out / "run", resume=iterations > 3, show_progress=False)


if __name__ == "__main__":
    torch.set_num_threads(1)
    acts = {"learn": learn, "resume": resume, "fail": fail, "rl_games": learn_with_rl_games}
    acts[sys.argv[1]](Path(sys.argv[2]), sys.argv[3:])
