# pyright: reportAttributeAccessIssue=false, reportOptionalMemberAccess=false, reportArgumentType=false
# pyright: reportCallIssue=false, reportOperatorIssue=false
# (The library's type annotations are incomplete.)
"""A task as ``IVecEnv`` of rl-games, and a training run by ``rl_games.torch_runner.Runner``.

Letters: E environments, O entries of an observation, U entries of an action.
"""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest.mock import patch

from gymnasium import spaces
from rl_games.algos_torch.a2c_continuous import A2CAgent
from rl_games.common.algo_observer import AlgoObserver
from rl_games.common.ivecenv import IVecEnv
from rl_games.torch_runner import Runner
from torch import Tensor, distributed

from aerial_gym.rl_training.learner_settings import PpoCfg
from aerial_gym.rl_training.run.checkpoint_keeper import CheckpointKeeper
from aerial_gym.rl_training.run.progress import Report
from aerial_gym.rl_training.run.training_run import TrainingRun
from aerial_gym.rl_training.settings import TrainingCfg
from aerial_gym.rl_training.trainers.summaries import guard_writer
from aerial_gym.task import Task

OFF = 10**12  # A count that is never reached: switches a feature of the library off


class TaskVecEnv(IVecEnv):
    """A task as rl-games sees it: done is terminated or truncated, and ``time_outs`` lets it bootstrap the value."""

    def __init__(self, task: Task) -> None:
        self._task, self.num_rows = task, task.num_envs

    def reset(self) -> Tensor:
        """Restart all episodes, at random ages; return observations (E, O)."""
        observation, _ = self._task.reset()
        self._task.stagger()
        return observation["observations"]

    def step(self, actions: Tensor) -> tuple[Tensor, Tensor, Tensor, dict[str, Tensor]]:
        """Advance by actions (E, U); return observations (E, O), rewards (E,), done (E,) bool, infos."""
        observation, reward, terminated, truncated, info = self._task.step(actions)
        return observation["observations"], reward, terminated | truncated, {"time_outs": info["time_outs"]}

    def get_number_of_agents(self) -> int:
        """Return the agents per environment: one."""
        return 1

    def get_env_info(self) -> dict[str, object]:
        """Return spaces of a single environment."""
        space = self._task.observation_space
        assert isinstance(space, spaces.Dict)
        return {"observation_space": space["observations"], "action_space": self._task.action_space, "agents": 1}


class KeeperAgent(A2CAgent):
    """PPO that saves and restores through a ``CheckpointKeeper``; file names that the library chooses are not used."""

    keeper: CheckpointKeeper
    after_epoch: Callable[[], None]

    def __init__(self, base_name: str, params: dict[str, Any]) -> None:
        self._device = params["config"]["device"]
        with patch.object(distributed, "init_process_group", lambda *_, **__: None):
            super().__init__(base_name, params)
        if self._device == "cpu":
            self.local_rank = -1  # of no GPU

    @property
    def device_name(self) -> str:
        """The device; the library would set a GPU where there are several processes."""
        return self._device

    @device_name.setter
    def device_name(self, name: str) -> None:
        """Ignore the library's choice."""

    def train_epoch(self) -> tuple[Any, ...]:
        """Train one epoch; ranks other than 0 report its end, as the library does not."""
        statistics = super().train_epoch()
        if self.global_rank != 0:
            self.frame += self.curr_frames * self.world_size
            self.after_epoch()
        return statistics

    def update_lr(self, lr: float) -> None:
        """Take the rate of rank 0 for good; the library would go back to its own after the next minibatch."""
        super().update_lr(lr)
        if self.multi_gpu:
            self.last_lr = self.optimizer.param_groups[0]["lr"]

    def save(self, fn: str) -> None:
        """Do nothing: the library saves in rank 0 alone."""

    def save_checkpoint(self) -> None:
        """Write a checkpoint."""
        if self.keeper.ready:
            self.keeper.save(self.get_full_state_weights(), env_steps=int(self.frame))

    def restore(self, fn: str, set_epoch: bool = True) -> None:
        """Resume from the checkpoint of the keeper, with its adapted learning rate."""
        self.keeper.restore(self._load_library_state)

    def _load_library_state(self, state: dict[str, Any]) -> None:
        self.set_full_state_weights(state)
        self.last_lr = self.optimizer.param_groups[0]["lr"]


class _Observer(AlgoObserver):
    """Reports after every update, saves from time to time, and tells the agent to end."""

    def __init__(self, run: TrainingRun) -> None:
        self._run = run
        self.algo: KeeperAgent | None = None

    def after_init(self, algo: KeeperAgent) -> None:
        self.algo, algo.keeper = algo, self._run.keeper
        algo.after_epoch = lambda: self.after_print_stats(algo.frame, algo.epoch_num, 0.0)
        self._summaries = () if algo.writer is None else (guard_writer(algo.writer),)
        if not algo.keeper.resumes:
            algo.save_checkpoint()

    def after_print_stats(self, frame: int, epoch_num: int, total_time: float) -> None:
        algo = self.algo
        assert algo is not None
        known = algo.game_rewards.current_size > 0
        report = Report(
            env_steps=int(algo.frame),
            episode_return=float(algo.game_rewards.get_mean()[0]) if known else None,
            episode_length=float(algo.game_lengths.get_mean().item()) if known else None,
        )
        if self._run.report_update(report, self._summaries, algo.save_checkpoint):
            algo.max_epochs = epoch_num  # the agent ends, and saves, after this epoch
        limit, lowest_log_std = self._run.learning_rate_and_std_limits
        algo.scheduler.max_lr, algo.last_lr = limit, min(algo.last_lr, limit)
        algo.model.a2c_network.sigma.data.clamp_(min=lowest_log_std)


def train(run: TrainingRun) -> bool:
    """Train as ``Trainer.run`` states; return whether it was interrupted."""
    task, observer = run.task, _Observer(run)
    runner = Runner(observer)
    runner.algo_factory.register_builder("a2c_continuous", lambda **kwargs: KeeperAgent(**kwargs))
    params: dict[str, Any] = library_params(run.cfg, TaskVecEnv(task), run.folder.path, device=str(task.device))
    params["config"]["multi_gpu"] = run.ranks.size > 1
    if task.curriculum is not None and run.ranks.joined:
        task.curriculum.of_all = run.ranks.sum_
    runner.load_config(params)
    interrupted = False
    try:
        runner.run({"train": True, "play": False, "checkpoint": "of the keeper" if run.keeper.resumes else None})
    except KeyboardInterrupt:
        interrupted = True
    finally:
        if observer.algo is not None and observer.algo.writer is not None:
            observer.algo.writer.close()
    if observer.algo is not None:
        observer.algo.save_checkpoint()
    return interrupted


def library_params(cfg: TrainingCfg, env: TaskVecEnv, out: Path, *, device: str) -> dict[str, object]:
    """Return the settings as rl-games names them."""
    ppo, rows = cfg.section(PpoCfg), env.num_rows
    return {
        "seed": cfg.seed,
        "torch_threads": 0,  # set by the caller
        "algo": {"name": "a2c_continuous"},
        "model": {"name": "continuous_a2c_logstd"},
        "network": {
            "name": "actor_critic",
            "separate": ppo.separate_value_network,
            "space": {
                "continuous": {
                    "mu_activation": "None",
                    "sigma_activation": "None",
                    "mu_init": {"name": "variance_scaling_initializer", "scale": ppo.head_variance},
                    "sigma_init": {"name": "const_initializer", "val": math.log(ppo.initial_std)},
                    "fixed_sigma": True,
                }
            },
            "mlp": {
                "units": list(ppo.hidden_layers), "activation": ppo.activation, "d2rl": False,
                "initializer": {"name": "default"}, "regularizer": {"name": "None"},
            },
        },
        "config": {
            "name": cfg.task, "full_experiment_name": "rl_games", "train_dir": str(out), "env_name": cfg.task,
            "vec_env": env, "env_info": env.get_env_info(), "num_actors": rows, "device": device, "ppo": True,
            "mixed_precision": False, "torch_compile": False, "print_stats": False, "max_epochs": OFF,
            "save_best_after": OFF, "save_frequency": 0, "gamma": ppo.discount, "tau": ppo.gae_lambda,
            "learning_rate": ppo.learning_rate, "lr_schedule": "adaptive", "schedule_type": "standard",
            "kl_threshold": ppo.kl_threshold, "e_clip": ppo.clip_range, "clip_value": ppo.clip_value,
            "critic_coef": ppo.value_coef, "entropy_coef": ppo.entropy_coef, "bounds_loss_coef": ppo.bound_coef,
            "truncate_grads": True, "grad_norm": ppo.max_grad_norm, "normalize_input": ppo.normalize_observation,
            "normalize_value": ppo.normalize_value, "normalize_advantage": True, "value_bootstrap": True,
            "horizon_length": ppo.horizon, "minibatch_size": rows * ppo.horizon // ppo.num_minibatches,
            "mini_epochs": ppo.num_epochs, "reward_shaper": {"scale_value": ppo.reward_scale},
        },
    }  # fmt: skip
