"""Search settings of ``ppo`` with Ray Tune: random ones, of which the worst end early, or a population that learns from itself.

usage: python examples/search_with_ray_tune.py [--population] [--samples 16] [--slices 8] [--gpus-each 0.25] [--out runs/search]

A trial trains in slices: after each it reports, keeps its run folder, and goes on from it; in a population perhaps from another
one's, with settings near to those. Needs ``pip install 'aerial-gym[tune]'``.
"""

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import tyro
from ray import init, tune
from ray.tune.schedulers import ASHAScheduler, PopulationBasedTraining

from aerial_gym.rl_training import load_settings, settings_for, train

SPACE = {
    "max_learning_rate": tune.loguniform(2e-3, 5e-2),
    "kl_threshold": tune.loguniform(0.005, 0.05),
    "gae_lambda": tune.uniform(0.9, 0.99),
    "bound_coef": tune.loguniform(1e-5, 1e-2),
}
"""Fields of ``PpoCfg``."""


def trial(chosen: dict[str, Any]) -> None:
    """Train in slices of equal steps, and report the return after each."""
    numbers, first = {name: chosen[name] for name in SPACE}, 1
    cfg = load_settings(settings_for("ppo", chosen["task"], device=chosen["device"]))
    cfg = replace(cfg, task=chosen["task"], device=chosen["device"], num_envs=chosen["num_envs"])
    cfg = replace(cfg, max_time_s=None, max_env_steps=chosen["slices"] * chosen["slice_steps"])
    cfg = replace(cfg, ppo=replace(cfg.ppo, **numbers))
    with tempfile.TemporaryDirectory() as folder:
        kept = tune.get_checkpoint()
        if kept is not None:
            kept.to_directory(folder)
            first = int((Path(folder) / "slice.txt").read_text()) + 1
        for number in range(first, chosen["slices"] + 1):
            limited = replace(cfg, max_env_steps=number * chosen["slice_steps"])
            result = train(limited, folder, resume=number > 1, show_progress=False)
            (Path(folder) / "slice.txt").write_text(str(number))
            reported = {"episode_return": result.episode_return or 0.0, "slices": number}
            tune.report(reported, checkpoint=tune.Checkpoint.from_directory(folder))


def main(
    task: str = "position_setpoint_task",
    device: str = "auto",
    num_envs: int = 4096,
    samples: int = 16,
    slices: int = 8,
    slice_steps: int = 20_000_000,
    gpus_each: float = 0.0,
    population: bool = False,
    out: Path = Path("runs/search"),
) -> None:
    """Search, and print the best settings and where its run folder lies."""
    fixed = {"task": task, "device": device, "num_envs": num_envs, "slices": slices, "slice_steps": slice_steps}
    time = {"time_attr": "slices", "metric": "episode_return", "mode": "max"}
    if population:
        scheduler = PopulationBasedTraining(**time, perturbation_interval=1, hyperparam_mutations=SPACE)
    else:
        scheduler = ASHAScheduler(**time, max_t=slices, grace_period=1)
    init(include_dashboard=False, ignore_reinit_error=True)
    results = tune.Tuner(
        tune.with_resources(trial, {"cpu": 1, "gpu": gpus_each}),
        param_space=SPACE | fixed,
        tune_config=tune.TuneConfig(num_samples=samples, scheduler=scheduler),
        run_config=tune.RunConfig(name=out.name, storage_path=str(out.resolve().parent)),
    ).fit()
    best = results.get_best_result("episode_return", "max")
    print({name: best.config[name] for name in SPACE}, best.metrics["episode_return"])
    print("evaluate it: aerial-gym evaluate --policy", best.checkpoint.path)


if __name__ == "__main__":
    tyro.cli(main)
