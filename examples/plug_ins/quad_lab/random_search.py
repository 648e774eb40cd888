"""A trainer: random search over the weights of the policy."""

import torch

from aerial_gym.rl_training import Policy, Trainer
from aerial_gym.rl_training.policies.load import body_cfg
from aerial_gym.rl_training.run.progress import Report
from aerial_gym.rl_training.run.training_run import TrainingRun


class RandomSearch(Trainer):
    """Keeps a random step of the weights if the next steps of the task give more reward."""

    name = "random_search"
    summary = "random search over the weights"

    def run(self, run: TrainingRun) -> bool:
        """Search until a limit of the settings is reached."""
        cfg, task = run.cfg, run.task
        observation, _ = task.reset()
        shape = tuple(observation["observations"].shape[1:])
        policy = Policy(body_cfg(cfg, {"observations": shape}), task.action_space.shape[0]).to(task.device)
        best, steps, done = -torch.inf, 0, False
        while not done:
            kept = {name: weights.clone() for name, weights in policy.state_dict().items()}
            for weights in policy.parameters():
                weights.data += 0.05 * torch.randn_like(weights)
            total = 0.0
            for _ in range(cfg.learner.horizon):
                run.interruption.check()
                observation, reward, *_ = task.step(policy(observation))
                total += float(reward.mean())
            if total < best:
                policy.load_state_dict(kept)
            best, steps = max(best, total), steps + cfg.learner.horizon * task.num_envs
            done = run.progress.update(Report(env_steps=steps, episode_return=None, episode_length=None))
        model = {f"actor.{name}": weights for name, weights in policy.state_dict().items()}
        network = {"shapes": {"observations": list(shape)}, "num_actions": policy.num_actions}
        run.keeper.save({"model": model, "network": network}, env_steps=steps)
        return False
