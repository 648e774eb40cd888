"""Rewards and ends of a step, and the observation before a reset, in one kernel.

Letters: E environments, T terms of the reward, K terminations.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from aerial_gym.config.task import POLICY, TaskCfg
from aerial_gym.config.task_terms import EndRewardCfg, RewardCfg, TerminationCfg
from aerial_gym.math.random import Randomness
from aerial_gym.robots.finite_watch import NonFinite
from aerial_gym.task.commands.command import TARGET, Command
from aerial_gym.task.step.observer import Observer
from aerial_gym.task.step.row_kernels import StepKernel
from aerial_gym.task.terms.term import BoundTerm
from aerial_gym.task.values import Values
from aerial_gym.task.vehicles.common_ends import ENDS, CommonEnds
from aerial_gym.task.vehicles.common_ends import REWARDS as COMMON_REWARDS

FINAL = "final_"  # In front of the name of a group: its observation before the reset
TIME_OUT = "time_out"  # Name under which an end by the length of the episode is counted
GATE_PASSED = "gate_passed"  # Flag of commands with gates, also in `info`
COLLISIONS = "collisions"  # Flag of `info`: the vehicle touched another one in this step
SUMS, TALLIES, ARRIVED = "episode_sums", "ended_tallies", "arrived"  # Buffers that persist between steps

FLAGS = ("terminated", "truncated", "crash", "success", "timeout", "bad")
"""Truth values of a step, side by side: every tensor that a kernel takes or gives costs the host some microseconds."""


@dataclass(frozen=True, kw_only=True)
class EpisodeEnds:
    """Flags of episode ends in a step, each bool (E,)."""

    crash: Tensor
    success: Tensor  # Of those that end: whether the episode is one
    terminated: Tensor
    truncated: Tensor
    arrived: Tensor  # Whether a success that counts was there in this episode
    causes: list[Tensor]  # Flags of the terminations that ended an episode; the last is the time limit


class Judge:
    """Computes the rewards of a step and the episodes that end."""

    def __init__(
        self, cfg: TaskCfg, rewards: Mapping[str, tuple[BoundTerm, RewardCfg]],
        terminations: Mapping[str, tuple[BoundTerm, TerminationCfg]], values: Values, *, command: Command,
        observer: Observer, random: Randomness, num_vehicles: int = 1,
    ) -> None:  # fmt: skip
        """Declare the buffers; the ``num_vehicles`` of an environment share their ends if there are several."""
        self._cfg, self._rewards, self._terminations = cfg, dict(rewards), dict(terminations)
        self._command, self._observer = command, observer
        ends = {"crash": cfg.crash_reward, "success": cfg.success_reward}
        self.reward_names = (*rewards, *(name for name, end in ends.items() if end is not None))
        """Columns of ``reward_terms``: the rewards in order, then those of ends."""
        self.end_names = (*terminations, TIME_OUT)  # Names of the conditions that end episodes
        by_difficulty = [each.difficulty_weight for _, each in rewards.values()]
        by_difficulty += [end.difficulty_value for end in ends.values() if end is not None]
        count, kinds = len(self.reward_names), len(self.end_names)
        values.declare(SUMS, (1 + count,), meaning="return of the present episode, in total and by term")
        meaning = "over ended episodes: return by term, their number, and counts by condition of the end"
        self._tallies = values.declare(TALLIES, (count + 1 + kinds,), meaning=meaning)
        if any(each.when == "counts" for _, each in terminations.values()):
            values.declare(ARRIVED, dtype=torch.bool, meaning="a success that counts was there in this episode")
        terms = [term for term, _ in (*rewards.values(), *terminations.values())]
        kept = tuple(name for name in (SUMS, TALLIES, ARRIVED) if name in values.own)
        names = ("sim_steps", "non_finite", "episodes", "crashes", *kept)
        names += (*command.reads, *(("difficulty",) if any(by_difficulty) else ()))
        names += (TARGET, "robot_position") if TARGET in values.own else ()
        reads = {name: values.find(name, "the task") for name in names} | values.term_inputs(*terms) | observer.reads
        moved = {name: values[name] for name in command.current_values(values)}
        self._common: CommonEnds | None = None
        if num_vehicles > 1:
            needs_all = [each.needs_all for _, each in terminations.values()]
            self._common = CommonEnds(
                self._own_outcome, values, reads=reads, needs_all=[*needs_all, False, False], num_rewards=len(rewards),
                shares_reward=cfg.share_reward, num_vehicles=num_vehicles,
            )  # fmt: skip
            reads |= self._common.reads
        gtd, own = values.gtd, values.own
        writes = {
            "non_finite": gtd["non_finite"], "crashes": gtd["crashes"], "truncations": gtd["truncations"],
            "ended": random.mask, "episodes": random.episode, **{name: own[name] for name in kept}, **moved,
        }  # fmt: skip
        self.buffers = {name: tensor for name, tensor in writes.items() if name != "ended"}
        """Tensors that persist and that a judgement writes, by name."""
        self.rows = StepKernel(
            self._step_outcome, "the judgement of a step", reads=reads, writes=writes,
            terms=[*terms, *observer.terms], graph=values.graph, keeps=tuple(moved),
        )  # fmt: skip
        """The kernel."""
        self.parts = [self.rows] if self._common is None else [self._common.rows, self.rows]
        """All kernels that evaluate terms."""
        self._early: StepKernel | None = None
        if any(name in moved for term in self.rows.apart for name in term.reads):  # they run before the kernel
            given = {name: reads[name] for name in ("sim_steps", *command.reads)}
            self._early = StepKernel(command.current_values, "the command", reads=given, writes=moved)

    def __call__(self) -> dict[str, Tensor]:
        """Judge every environment; return the results by name, (E, ...); launched, not waited for."""
        if self._early is not None:
            self._early()
        if self._common is not None:
            self._common()
        result = self.rows()
        result |= zip(FLAGS, result["flags"].unbind(-1), strict=True)
        return result | {"total": result["sums"][:, 0], "reward_terms": result["sums"][:, 1:]}

    def info(self, judged: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Return the ``info`` of a step: ends, episode sums and last observations; only the latter keep gradients."""
        info = {
            "time_outs": judged["truncated"], "successes": judged["success"], "crashes": judged["crash"],
            "timeouts": judged["timeout"], "episode_return": judged["total"].detach(),
            "episode_length": judged["length"], "reward_terms": judged["reward_terms"].detach(),
            "non_finite": judged["bad"],
        }  # fmt: skip
        if GATE_PASSED in judged:
            info[GATE_PASSED] = judged[GATE_PASSED]
        if "distance" in judged:
            info["distance"] = judged["distance"].detach()
        names = {group: f"{FINAL}{group}" for group in self._observer.groups}
        return info | {"final_observation" if group == POLICY else name: judged[name] for group, name in names.items()}

    def episode_means(self) -> dict[str, float]:
        """Return ``Task.episode_means``."""
        result = self.means_of_tallies(self._tallies)
        self._tallies.zero_()
        return result

    def means_of_tallies(self, tallies: Tensor) -> dict[str, float]:
        """Return ``Task.means_of_tallies``."""
        sums = tallies.double().sum(dim=0).tolist()
        terms, (episodes, *ended) = sums[: len(self.reward_names)], sums[len(self.reward_names) :]
        result = {"episodes": episodes}
        if episodes:
            result |= {f"reward/{name}": term / episodes for name, term in zip(self.reward_names, terms, strict=True)}
            result |= {f"ended/{name}": number / episodes for name, number in zip(self.end_names, ended, strict=True)}
        return result

    def _step_outcome(self, given: Mapping[str, Tensor]) -> dict[str, Tensor]:
        moved = self._command.current_values(given)
        values = {**given, **moved}
        if ENDS in given:
            labels = [term.label for term, _ in self._terminations.values()]
            values |= zip(labels, given[ENDS].unbind(-1), strict=False)
        finite, observed, _ = self._observer.observe(values, None)
        ends = self._episode_ends(values)
        terms, reward = self._reward_terms(values, ends)
        bits = values["non_finite"] + NonFinite.REWARD.value * (~reward.isfinite()).int()
        bits = bits + NonFinite.OBSERVATION.value * (~finite).int()
        bad = bits != 0
        ends = self._crash_non_finite(ends, bad | given[ENDS][:, -1] if ENDS in given else bad)
        crash_reward = _end_reward(self._cfg.crash_reward, values)
        terms, reward = self._replace_non_finite_rewards(terms, reward, bad, crash_reward)
        ended = ends.terminated | ends.truncated
        sums = values[SUMS] + torch.cat([reward.unsqueeze(-1), terms], dim=-1)
        counts = torch.stack([ended, *(cause & ended for cause in ends.causes)], dim=-1).to(sums.dtype)
        tallies = torch.cat([torch.where(ended.unsqueeze(-1), sums[:, 1:], 0.0), counts], dim=-1)
        timeout = ended & ~ends.crash & ~ends.success
        result = {
            "non_finite": bits, "crashes": ends.crash, "truncations": ended & ~ends.crash, "ended": ended,
            "episodes": values["episodes"] + ended, SUMS: torch.where(ended.unsqueeze(-1), 0.0, sums),
            TALLIES: values[TALLIES] + tallies, **moved,
            **{f"{FINAL}{group}": value for group, value in observed.items()}, "reward": reward, "sums": sums,
            "length": values["sim_steps"],
            "flags": torch.stack([ends.terminated, ends.truncated, ends.crash, ends.success, timeout, bad], dim=-1),
        }  # fmt: skip
        if ARRIVED in values:
            result[ARRIVED] = ends.arrived & ~ended
        if TARGET in values:
            distance = (values[TARGET] - values["robot_position"]).norm(dim=-1)
            result["distance"] = distance.nan_to_num(nan=torch.finfo(distance.dtype).max)
        return result

    def _own_outcome(self, given: Mapping[str, Tensor]) -> tuple[list[Tensor], list[Tensor]]:
        """Return the conditions of terminations, of the time limit and of non-finite numbers of each vehicle, and its reward
        terms."""
        values = {**given, **self._command.current_values(given)}
        finite, _, _ = self._observer.observe(values, None)
        rewards = list(self._term_rewards(values).values())
        for reward in rewards:
            finite = finite & reward.isfinite()
        bad = ~finite | (values["non_finite"] != 0)
        ends = [term.evaluate(values) for term, _ in self._terminations.values()]
        return [*ends, self._is_time_up(values), bad], rewards

    def _is_time_up(self, values: Mapping[str, Tensor]) -> Tensor:
        return values["sim_steps"] >= self._cfg.episode_len_steps

    def _episode_ends(self, values: Mapping[str, Tensor]) -> EpisodeEnds:
        no = torch.zeros_like(values["crashes"])
        flags = {name: term.evaluate(values) for name, (term, _) in self._terminations.items()}
        entries = {name: cfg for name, (_, cfg) in self._terminations.items()}

        def any_end(kind: str | None, when: str, *, bootstraps: bool | None = None) -> Tensor:
            result = no
            for name, cfg in entries.items():
                same = cfg.when == when and kind in (None, cfg.kind)
                if same and bootstraps in (None, cfg.bootstraps):
                    result = result | flags[name]
            return result

        time_up = values[ENDS][:, -2] if ENDS in values else self._is_time_up(values)
        crash, arrived = any_end("crash", "now"), any_end("success", "counts") | values.get(ARRIVED, no)
        now = any_end(None, "now")
        ended = now | time_up
        terminated = any_end(None, "now", bootstraps=False)
        if not self._cfg.time_out_bootstraps:
            terminated = terminated | time_up
        at_end = any_end("success", "at_end") & (time_up | any_end("time_out", "now"))
        success = (any_end("success", "now") | (ended & arrived) | at_end) & ~crash
        causes = [flags[name] if cfg.when == "now" else flags[name] & success for name, cfg in entries.items()]
        return EpisodeEnds(
            crash=crash, success=success, terminated=terminated, truncated=ended & ~terminated, arrived=arrived,
            causes=[*causes, time_up & ~now],
        )  # fmt: skip

    @staticmethod
    def _crash_non_finite(ends: EpisodeEnds, bad: Tensor) -> EpisodeEnds:
        """Return the ends, with a crash in rows with NaN or infinite values."""
        good = ~bad
        ends = replace(ends, success=ends.success & good, truncated=ends.truncated & good)
        return replace(ends, crash=ends.crash | bad, terminated=ends.terminated | bad)

    def _reward_terms(self, values: Mapping[str, Tensor], ends: EpisodeEnds) -> tuple[Tensor, Tensor]:
        """Return the terms, (E, T), and their sum, (E,)."""
        result = self._term_rewards(values)
        no_reward = torch.zeros_like(ends.crash, dtype=next(iter(result.values())).dtype)
        for name, when, end in (
            ("success", ends.success, self._cfg.success_reward),
            ("crash", ends.crash, self._cfg.crash_reward),
        ):
            if end is None:
                continue
            if end.how == "replace":
                result = {each: torch.where(when, 0.0, value) for each, value in result.items()}
            result[name] = torch.where(when, _end_reward(end, values), no_reward)
        columns = [result[name] for name in self.reward_names]
        return torch.stack(columns, dim=-1), sum(columns[1:], start=columns[0])

    def _term_rewards(self, values: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Return the weighted terms by name, (E,), without the rewards of ends."""
        if COMMON_REWARDS in values:
            return dict(zip(self._rewards, values[COMMON_REWARDS].unbind(-1), strict=True))
        plain = {name: term.evaluate(values) for name, (term, _) in self._rewards.items()}
        weighed: dict[str, Tensor] = {}
        for name, (_, cfg) in self._rewards.items():
            if not cfg.times:
                weighed[name] = self._apply_reward_weight(plain[name], cfg, values)
        for name, (_, cfg) in self._rewards.items():
            if cfg.times:
                first, *more = (weighed[each] for each in cfg.times)
                factor = sum(more, start=first)
                weighed[name] = factor * self._apply_reward_weight(plain[name], cfg, values)
        return {name: weighed[name] for name in self._rewards}

    @staticmethod
    def _apply_reward_weight(value: Tensor, cfg: RewardCfg, values: Mapping[str, Tensor]) -> Tensor:
        if cfg.difficulty_weight:
            return (cfg.weight + cfg.difficulty_weight * values["difficulty"]) * value
        return value if cfg.weight == 1.0 else cfg.weight * value

    def _replace_non_finite_rewards(
        self, terms: Tensor, reward: Tensor, bad: Tensor, worth: Tensor | float
    ) -> tuple[Tensor, Tensor]:
        """Return terms and reward, replaced in non-finite rows by the crash reward alone."""
        crash = torch.zeros_like(reward) + worth
        alone = torch.stack([crash * (name == "crash") for name in self.reward_names], dim=-1)
        return torch.where(bad.unsqueeze(-1), alone, terms), torch.where(bad, crash, reward)


def _end_reward(end: EndRewardCfg | None, values: Mapping[str, Tensor]) -> Tensor | float:
    """Return the reward of an end: a number, or (E,) where it depends on the difficulty."""
    if end is None:
        return 0.0
    return end.value + end.difficulty_value * values["difficulty"] if end.difficulty_value else end.value
