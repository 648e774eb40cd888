"""``aerial-gym evaluate``: how well a trained policy flies from fresh random starts."""

import json
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from aerial_gym.cli.terminal import print_table, progress_bar
from aerial_gym.config.set_option import SetOption

if TYPE_CHECKING:
    from aerial_gym.rl_training import Evaluation
    from aerial_gym.rl_training.policies.policy import Policy
    from aerial_gym.rl_training.policy_task import PolicyTask


@dataclass(frozen=True, kw_only=True)
class PolicyOptions:
    """Options of commands that fly a policy."""

    policy: Path = field(kw_only=False)
    """Run folder of a training, of which the last checkpoint is taken, one checkpoint in it, pretrained/NAME (aerial-gym list
    pretrained), or an exported file (.onnx, .pt, .c)."""

    task: str | None = None  # Registered task, task file (.yaml), module:Name or file.py:Name; else the training's
    robot: str | None = None  # Robot, or a robot file, in place of the training's: a policy on the corrected vehicle
    backend: str | None = None  # Registered physics backend (aerial-gym list backends); that of the sim if not given
    device: str = "cpu"  # Torch device; auto takes the GPU if there is one
    seed: int = 1_000_003  # Seed of the starts; keep it apart from the seeds of trainings
    level: int | None = None  # Level at which the curriculum of the task stays; its highest if not given

    set: SetOption = ()
    """Setting of task, robot, env or sim in place of its own, such as robot.body.mass=0.3; can be repeated. Those of the
    training apply too."""

    def load(self) -> "tuple[Any, str, PolicyTask]":
        """Return the policy, the task of its training, and the task that it flies."""
        from aerial_gym.config.changes import settings_of_run
        from aerial_gym.export.pilot import load_pilot
        from aerial_gym.rl_training.policy_task import PolicyTask

        policy, cfg = load_pilot(self.policy, self.device)
        kept = settings_of_run(cfg.settings, robot=self.robot, task=self.task)
        flown = PolicyTask(
            name=self.task or cfg.task, robot=self.robot or cfg.robot, controller=cfg.controller, encoder=cfg.encoder,
            backend=self.backend, level=self.level, settings=(*kept, *self.set), device=self.device, seed=self.seed,
        )  # fmt: skip
        return policy, cfg.task, flown


@dataclass(frozen=True, kw_only=True)
class EvaluateCmd(PolicyOptions):
    """Measure success and crash rates of a policy, its returns by term, the ends of its episodes, and position errors."""

    num_envs: int = 512  # Random starts

    evader: Path | None = None
    """Run folder of a self-play, or one checkpoint in it: its evader flees in further flights, as many as from the rule.
    Default: the evader of --policy, if it learned one."""

    firmware: str | None = None  # Firmware that flies the vehicle in place of the controller: betaflight or crazyflie
    watch: Path | None = None  # CSV file for the last 64 steps of rows with NaN or infinity; play --replay shows it
    json: bool = False  # Print one JSON object

    def run(self) -> int:
        """Fly and print the figures; return the exit status."""
        result = self.result()
        if self.json:
            print(json.dumps(asdict(result)))
            return 0
        figures = {name: value for name, value in asdict(result).items() if not isinstance(value, dict)}
        print_table((name, f"{value:.4g}") for name, value in figures.items() if value is not None)
        for head, means in (
            (("reward term", "mean return"), result.reward_terms),
            (("ended by", "share of flights"), result.ended_by),
        ):
            print_table(((name, f"{value:.4g}") for name, value in means.items()), head)
        return 0

    def result(self) -> "Evaluation":
        """Return the figures of one episode from every start."""
        from aerial_gym.interop import one_thread
        from aerial_gym.rl_training.evaluation import evaluate
        from aerial_gym.rl_training.policies.load import check_fits

        policy, trained_on, flown = self.load()
        evader = self._load_evader()
        with (
            replace(flown, firmware=self.firmware).make(self.num_envs) as task,
            progress_bar() as progress,
            one_thread(),
        ):
            check_fits(policy, task, trained_on)
            if self.watch is not None:
                task.watch()
            result = evaluate(policy, task, on_step=lambda step, steps: progress("flying", step / steps), evader=evader)
            if self.watch is not None:
                task.dump(self.watch)
        return result

    def _load_evader(self) -> "Policy | None":
        """Return the learned evader; None if there is none."""
        from aerial_gym.export.pilot import STEPS
        from aerial_gym.rl_training.policies.load import find_checkpoint, load_evader

        if self.evader is None:
            exported = self.policy.suffix in STEPS
            if exported or not getattr(find_checkpoint(self.policy)[1].learner, "opponents", 0):
                return None
        return load_evader(self.evader or self.policy, device=self.device)
