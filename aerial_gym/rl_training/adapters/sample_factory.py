# pyright: reportAttributeAccessIssue=false, reportOptionalMemberAccess=false, reportArgumentType=false
# pyright: reportCallIssue=false, reportOperatorIssue=false
# (The library's type annotations are incomplete.)
"""A task as one batched environment of Sample Factory, and a training by its runner (APPO, serial and synchronous).

Letters: E environments, O entries of an observation, U entries of an action.
"""

import contextlib
import logging
import math
import os
import pickle
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium
import torch
from gymnasium import spaces
from sample_factory.algo.learning.batcher import Batcher
from sample_factory.algo.learning.learner import Learner
from sample_factory.algo.learning.learner_worker import LearnerWorker
from sample_factory.algo.runners.runner import AlgoObserver
from sample_factory.algo.runners.runner_serial import SerialRunner
from sample_factory.algo.utils.context import global_env_registry, global_model_factory
from sample_factory.algo.utils.env_info import env_info_cache_filename, extract_env_info
from sample_factory.algo.utils.make_env import make_env_func_batched
from sample_factory.algo.utils.misc import ExperimentStatus
from sample_factory.cfg.arguments import parse_full_cfg, parse_sf_args
from sample_factory.envs.env_utils import register_env
from sample_factory.model.actor_critic import ActorCritic, default_make_actor_critic_func
from sample_factory.utils.typing import Config
from signal_slot.signal_slot import EventLoop, EventLoopStatus
from torch import Tensor

from aerial_gym.errors import ConfigError, TrainingError
from aerial_gym.rl_training.learner_settings import PpoCfg
from aerial_gym.rl_training.run.checkpoint_keeper import CheckpointKeeper, Interruption
from aerial_gym.rl_training.run.progress import Report
from aerial_gym.rl_training.run.training_run import TrainingRun
from aerial_gym.rl_training.settings import TrainingCfg
from aerial_gym.rl_training.trainers.summaries import guard_writer
from aerial_gym.task import Task

OFF = 10**15  # A count that is never reached: switches a feature of the library off
NO_LIMIT = 1e9  # A value that clips nothing


class TaskBatchedEnv(gymnasium.Env):
    """A task as Sample Factory sees it: one environment with E agents, tensors in and out."""

    is_multiagent = True

    def __init__(self, task: Task, interruption: Interruption | None = None) -> None:
        """Take a built task and the interruption flag, as the library's start takes long before its first update."""
        self._task, self.num_agents = task, task.num_envs
        self._interruption = interruption or Interruption()
        space = task.observation_space
        assert isinstance(space, spaces.Dict)
        self.observation_space = spaces.Dict({"obs": space["observations"]})
        self.action_space = task.action_space
        self._low = torch.as_tensor(task.action_space.low, device=task.device)
        self._high = torch.as_tensor(task.action_space.high, device=task.device)

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[dict[str, Tensor], dict]:
        """Restart all episodes, at random ages. The library's ``seed`` is the index of its worker; the task has its own."""
        observation, _ = self._task.reset()
        self._task.stagger()
        return {"obs": observation["observations"]}, {}

    def step(self, actions: Tensor) -> tuple[dict[str, Tensor], Tensor, Tensor, Tensor, dict]:
        """Advance by actions (E, U), clamped to the action space, which the library does not do."""
        self._interruption.check()
        clamped = torch.clamp(actions, self._low, self._high)
        observation, reward, terminated, truncated, _ = self._task.step(clamped)
        return {"obs": observation["observations"]}, reward, terminated, truncated, {}

    def render(self) -> None:
        """Nothing to show."""


class _KeeperLearner(Learner):
    """A learner that saves and restores through a ``CheckpointKeeper``; the library takes the newest file by its name."""

    keeper: CheckpointKeeper

    def load_from_checkpoint(self, policy_id: int, load_progress: bool = True) -> None:
        """Resume from the checkpoint of the keeper, if any."""
        if self.keeper.resumes:
            self.keeper.restore(self._load_state)

    def init(self) -> Any:
        """Make network and optimiser, and keep a new run's first checkpoint."""
        data = super().init()
        if not self.keeper.resumes:
            self.save()
        return data

    def save(self) -> bool:
        """Write a checkpoint; return whether there was a state to save."""
        if not (self.is_initialized and self.keeper.ready):
            return False
        self.keeper.save(self._get_checkpoint_dict(), env_steps=int(self.env_steps))
        return True


class _Runner(SerialRunner):
    """The library's runner with a kept learner, and without a catch-all: an error keeps its own sentence."""

    def __init__(self, cfg: Config, keeper: CheckpointKeeper) -> None:
        super().__init__(cfg)
        self._keeper = keeper
        self.summaries = [guard_writer(writer) for writer in self.writers.values()]

    def _make_learner(self, event_loop: EventLoop, policy_id: int, batcher: Batcher) -> LearnerWorker:
        worker = super()._make_learner(event_loop, policy_id, batcher)
        learner = _KeeperLearner(
            self.cfg, self.env_info, self.buffer_mgr.policy_versions, policy_id, worker.param_server
        )
        learner.keeper, worker.learner = self._keeper, learner
        return worker

    def run(self) -> int:
        """Train until the end or an interruption; return the status."""
        with self.timing.timeit("main_loop"):
            if self.event_loop.exec() == EventLoopStatus.INTERRUPTED:
                self.status = ExperimentStatus.INTERRUPTED
            self.stop.emit(self.object_id)
        return self.status

    def save(self) -> None:
        """Write a checkpoint."""
        for worker in self.learners.values():
            worker.learner.save()


class _Observer(AlgoObserver):
    """Reports after every update, saves from time to time, and tells the runner to end."""

    def __init__(self, run: TrainingRun) -> None:
        self._run = run

    def on_training_step(self, runner: _Runner, training_iteration_since_resume: int) -> None:
        if 0 not in runner.env_steps:
            return
        returns, lengths = (runner.policy_avg_stats.get(key, [()])[0] for key in ("reward", "len"))
        report = Report(
            env_steps=int(runner.env_steps[0]),
            episode_return=float(sum(returns) / len(returns)) if returns else None,
            episode_length=float(sum(lengths) / len(lengths)) if lengths else None,
        )
        if self._run.report_update(report, runner.summaries, runner.save):
            runner.total_train_seconds = OFF  # the runner compares it with its limit right after this call
        learner, (limit, lowest_log_std) = runner.learners[0].learner, self._run.learning_rate_and_std_limits
        learner.lr_scheduler.max_lr, learner.curr_lr = limit, min(learner.curr_lr, limit)
        learner.actor_critic.action_parameterization.learned_stddev.data.clamp_(min=lowest_log_std)


def train(run: TrainingRun) -> bool:
    """Train as ``Trainer.run`` states, in one process; return whether it was interrupted.

    Raises:
        ConfigError: If the library cannot use the device.
        TrainingError: If the library gave up.
    """
    cfg, task, progress = run.cfg, run.task, run.progress
    if task.device.type == "cuda" and (task.device.index or 0) != 0:
        raise ConfigError(f"device {task.device}: Sample Factory uses cuda:0. Choose the GPU with CUDA_VISIBLE_DEVICES")
    name = f"{cfg.task}_{uuid.uuid4().hex[:8]}"
    with _library_log(), _task_registration(name, cfg, task, run.interruption):
        runner = _Runner(
            library_config(cfg, run.folder.path, env_name=name, device=task.device, num_vehicles=task.num_vehicles),
            run.keeper,
        )
        try:
            status = _run_library_training(runner, _Observer(run))
        finally:
            for writer in runner.writers.values():
                writer.close()
        steps = runner.env_steps.get(0, progress.env_steps)  # the last update came after the last report
        progress.env_steps = int(steps)
    if status not in (ExperimentStatus.SUCCESS, ExperimentStatus.INTERRUPTED):
        raise TrainingError(f"Sample Factory gave up; {run.folder.log_file} says why")
    return status == ExperimentStatus.INTERRUPTED


def _run_library_training(runner: _Runner, observer: _Observer) -> int:
    """Run the training, save if it is interrupted, and return the runner's status."""
    runner.register_observer(observer)
    try:
        with _env_info_cache(runner.cfg):
            status = runner.init()
        if status == ExperimentStatus.SUCCESS:
            status = runner.run()
    except KeyboardInterrupt:
        status = ExperimentStatus.INTERRUPTED
    if status == ExperimentStatus.INTERRUPTED:
        runner.save()
    return status


FIXED_OPTIONS = f"""
    experiment=sample_factory use_rnn=False adaptive_stddev=False policy_initialization=torch_default
    serial_mode=True async_rl=False batched_sampling=True num_workers=1 num_envs_per_worker=1 worker_num_splits=1
    env_gpu_actions=True use_env_info_cache=True with_vtrace=False value_bootstrap=True shuffle_minibatches=False
    lr_schedule=kl_adaptive_epoch kl_loss_coeff=0.0 log_to_file=False with_wandb=False save_every_sec={OFF // 10}
    save_best_after={OFF} train_for_env_steps={OFF} train_for_seconds={OFF // 10} experiment_summaries_interval=3
    flush_summaries_interval=5
"""  # One batched environment in this process; the keeper schedules checkpoints

PPO_OPTIONS = """
    nonlinearity=activation initial_stddev=initial_std rollout=horizon num_batches_per_epoch=num_minibatches
    num_epochs=num_epochs gamma=discount gae_lambda=gae_lambda learning_rate=learning_rate
    lr_schedule_kl_threshold=kl_threshold ppo_clip_ratio=clip_range value_loss_coeff=value_coef
    exploration_loss_coeff=entropy_coef max_grad_norm=max_grad_norm reward_scale=reward_scale
    normalize_input=normalize_observation normalize_returns=normalize_value
"""  # Options of the library, each with its field of `PpoCfg`


def library_config(
    cfg: TrainingCfg, out: Path, *, env_name: str, device: torch.device, num_vehicles: int = 1
) -> Config:
    """Return the settings as Sample Factory names them, made by its own parser from a list, never from ``sys.argv``."""
    ppo, gpu = cfg.section(PpoCfg), device.type == "cuda"
    options: dict[str, object] = {**dict(pair.split("=") for pair in FIXED_OPTIONS.split())}
    options |= {name: getattr(ppo, field) for name, field in (pair.split("=") for pair in PPO_OPTIONS.split())}
    options |= {
        "env": env_name,
        "train_dir": out,
        "seed": cfg.seed,
        "device": "gpu" if gpu else "cpu",
        "env_gpu_observations": gpu,
        "actor_critic_share_weights": not ppo.separate_value_network,
        "batch_size": num_vehicles * cfg.num_envs * ppo.horizon // ppo.num_minibatches,
        "ppo_clip_value": ppo.clip_range if ppo.clip_value else NO_LIMIT,
    }
    arguments = [f"--{key}={value}" for key, value in options.items()]
    arguments += ["--encoder_mlp_layers", *(str(width) for width in ppo.hidden_layers)]
    arguments += ["--actor_worker_gpus", "0"] if gpu else []
    parser, _ = parse_sf_args(arguments)
    return parse_full_cfg(parser, arguments)


@contextlib.contextmanager
def _task_registration(name: str, cfg: TrainingCfg, task: Task, interruption: Interruption) -> Iterator[None]:
    """Register the task and the initial weights with the library for the time of the block."""

    def make_network(library_cfg: Config, obs_space: spaces.Space, action_space: spaces.Space) -> ActorCritic:
        network = default_make_actor_critic_func(library_cfg, obs_space, action_space)
        head = network.action_parameterization.distribution_linear
        torch.nn.init.normal_(head.weight, std=math.sqrt(cfg.learner.head_variance / head.in_features))
        torch.nn.init.zeros_(head.bias)
        return network

    factory = global_model_factory()
    kept = factory.make_actor_critic_func
    factory.register_actor_critic_factory(make_network)
    register_env(name, lambda *_: TaskBatchedEnv(task, interruption))
    try:
        yield
    finally:
        factory.register_actor_critic_factory(kept)
        del global_env_registry()[name]


@contextlib.contextmanager
def _env_info_cache(cfg: Config) -> Iterator[None]:
    """Fill the library's cache with spaces and sizes; otherwise it builds the task again in another process."""
    file = env_info_cache_filename(cfg)
    info = extract_env_info(make_env_func_batched(cfg, env_config=None), cfg)
    with open(file, "wb") as stream:
        pickle.dump(info, stream)
    try:
        yield
    finally:
        os.remove(file)


@contextlib.contextmanager
def _library_log() -> Iterator[None]:
    """Redirect the library's terminal logger to the log of the run (the root's handler)."""
    log = logging.getLogger("rl")
    kept, log.handlers = log.handlers, list(logging.getLogger().handlers)
    try:
        yield
    finally:
        log.handlers = kept
