"""Rewards and ends of a step: kinds of terminations, what is bootstrapped, what is logged."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from aerial_gym.config.task_terms import EndRewardCfg, RewardCfg, TerminationCfg
from aerial_gym.errors import ConfigError
from aerial_gym.task import Task
from tests.refusals import assert_refused
from tests.unit.task.hover import make
from tests.unit.task.hover import put as put_at

CONTACT = TerminationCfg(term="contact", kind="crash")
FAR = TerminationCfg(term="far_from_target", kind="crash", params={"distance": 8.0})
REWARDS = {"alive": RewardCfg(term="constant", weight=0.5), "near": RewardCfg(
    term="distance_linear", params={"offset": 0.0, "scale": 1.0}
)}  # fmt: skip
STAY = torch.zeros(3, 4)


def make_task(there: TerminationCfg, **changes: object) -> Task:
    task = make(3, **{"rewards": REWARDS, "terminations": {"contact": CONTACT, "far": FAR, "there": there}} | changes)
    task.reset()
    return task


def put(task: Task, *distances: float) -> None:
    put_at(task, [(distance, 0.0, 0.0) for distance in distances])


def flags(info: dict[str, Tensor], terminated: Tensor, truncated: Tensor) -> dict[str, list[bool]]:
    result = {name: info[name].tolist() for name in ("successes", "crashes", "timeouts", "time_outs")}
    return result | {"terminated": terminated.tolist(), "truncated": truncated.tolist()}


NONE = [False, False, False]
AT_TARGET = TerminationCfg(term="at_target", kind="success", params={"radius": 1.0})


@pytest.mark.parametrize("bootstrap", [None, False, True])
def test_a_success_ends_the_episode_at_once(bootstrap: bool | None) -> None:
    task = make_task(replace(AT_TARGET, bootstrap=bootstrap))
    put(task, 0.5, 2.0, 9.0)
    _, _, terminated, truncated, info = task.step(STAY)
    goes_on = bool(bootstrap)
    assert flags(info, terminated, truncated) == {
        "successes": [True, False, False], "crashes": [False, False, True], "timeouts": NONE,
        "time_outs": [goes_on, False, False], "terminated": [not goes_on, False, True],
        "truncated": [goes_on, False, False],
    }  # fmt: skip
    assert task.env.gtd["sim_steps"].tolist() == [0, 1, 0]


@pytest.mark.parametrize(("when", "successes"), [("counts", [True, True, False]), ("at_end", [False, True, False])])
def test_a_success_that_does_not_end_is_counted_at_the_end(when: str, successes: list[bool]) -> None:
    task = make_task(replace(AT_TARGET, when=when), episode_len_steps=3)
    info = {"successes": torch.zeros(3)}
    for distances in ((0.5, 2.0, 2.0), (3.0, 2.0, 2.0), (3.0, 0.5, 2.0)):
        assert not info["successes"].any()  # none before the end
        put(task, *distances)
        _, _, terminated, truncated, info = task.step(STAY)
    assert flags(info, terminated, truncated) == {
        "successes": successes, "crashes": NONE, "timeouts": [not each for each in successes],
        "time_outs": [True] * 3, "terminated": NONE, "truncated": [True] * 3,
    }  # fmt: skip
    for _ in range(3):  # what counted has been forgotten
        put(task, 3.0, 3.0, 3.0)
        *_, info = task.step(STAY)
    assert (info["successes"].tolist(), info["timeouts"].tolist()) == (NONE, [True] * 3)


def test_a_crash_goes_before_an_arrival() -> None:
    task = make_task(replace(AT_TARGET, when="counts"))
    put(task, 0.5, 0.5, 0.5)
    task.step(STAY)
    put(task, 9.0, 2.0, 0.5)
    _, _, terminated, _, info = task.step(STAY)
    assert info["crashes"].tolist() == terminated.tolist() == [True, False, False]
    assert info["successes"].tolist() == NONE


def test_a_time_out_of_ones_own_and_lengths_that_do_not_bootstrap() -> None:
    away = TerminationCfg(term="far_from_target", kind="time_out", params={"distance": 2.5})
    task = make_task(away, episode_len_steps=2, time_out_bootstraps=False)
    put(task, 3.0, 1.0, 1.0)
    _, _, terminated, truncated, info = task.step(STAY)
    assert truncated.tolist() == info["timeouts"].tolist() == [True, False, False]
    assert not terminated.any()
    put(task, 1.0, 1.0, 1.0)
    _, _, terminated, truncated, info = task.step(STAY)
    assert terminated.tolist() == info["timeouts"].tolist() == [False, True, True]
    assert not truncated.any()
    assert not info["crashes"].any()


@pytest.mark.parametrize(("how", "expected"), [("replace", [-5.0, 10.0, -1.5]), ("add", [-13.5, 10.0, -1.5])])
def test_what_an_end_is_worth_replaces_the_reward_or_comes_on_top(how: str, expected: list[float]) -> None:
    """0.5 - d of the terms: -8.5 at 9 m, 0 at 0.5 m, -1.5 at 2 m; a crash is worth -5, a success 10."""
    task = make_task(AT_TARGET, crash_reward=EndRewardCfg(value=-5.0, how=how), success_reward=EndRewardCfg(value=10.0))
    put(task, 9.0, 0.5, 2.0)
    _, reward, *_, info = task.step(STAY)
    torch.testing.assert_close(reward, torch.tensor(expected), atol=1e-2, rtol=0.0)
    assert task.reward_names == ("alive", "near", "crash", "success")
    torch.testing.assert_close(info["reward_terms"].sum(dim=-1), reward)
    assert (info["reward_terms"][0, 2], info["reward_terms"][1].tolist()) == (-5.0, [0.0, 0.0, 0.0, 10.0])


def test_what_an_end_is_worth_may_rise_with_the_difficulty() -> None:
    """A crash 9 m away and a row that is not finite cost -5 - 20 / 4 a quarter of the way up, an arrival earns 10 + 8 / 4."""
    crash, success = EndRewardCfg(value=-5.0, difficulty_value=-20.0), EndRewardCfg(value=10.0, difficulty_value=8.0)
    task = make_task(AT_TARGET, crash_reward=crash, success_reward=success)
    task.values["difficulty"].fill_(0.25)
    put(task, 9.0, 0.5, float("nan"))
    _, reward, *_ = task.step(STAY)
    assert reward.tolist() == [-10.0, 12.0, -10.0]


def test_terms_are_summed_over_an_episode_and_their_means_logged() -> None:
    task = make_task(AT_TARGET, episode_len_steps=4, crash_reward=EndRewardCfg(value=-5.0))
    assert task.episode_means() == {"episodes": 0.0}
    sums = torch.zeros(3, 3)
    for distances in ((3.0, 3.0, 3.0), (2.0, 2.0, 3.0), (2.0, 2.0, 9.0), (2.0, 2.0, 3.0)):
        put(task, *distances)
        *_, info = task.step(STAY)
        sums = info["reward_terms"].clone() if distances[2] == 9.0 else sums
    torch.testing.assert_close(info["reward_terms"][:2, 0], torch.full((2,), 2.0))
    torch.testing.assert_close(info["reward_terms"].sum(dim=-1), info["episode_return"])
    assert info["reward_terms"][2, 0] == 0.5  # of the next episode
    means = task.episode_means()
    assert (means["episodes"], means["reward/alive"]) == (3.0, pytest.approx((2.0 + 2.0 + 1.0) / 3.0))
    assert means["reward/crash"] == pytest.approx(-5.0 / 3.0)
    assert means["reward/near"] == pytest.approx(float(info["reward_terms"][:2, 1].sum() + sums[2, 1]) / 3.0)
    shares = {name: means[f"ended/{name}"] for name in ("contact", "far", "there", "time_out")}
    assert shares == pytest.approx({"contact": 0.0, "far": 1.0 / 3.0, "there": 0.0, "time_out": 2.0 / 3.0})
    assert task.episode_means() == {"episodes": 0.0}


def test_a_term_is_weighed_and_multiplied_by_the_sum_of_others() -> None:
    linear = {"offset": 3.0, "scale": 1.0}
    rewards = {
        "a": RewardCfg(term="distance_linear", params=linear, weight=2.0),
        "b": RewardCfg(term="constant", params={"value": 4.0}),
        "c": RewardCfg(term="distance_linear", params=linear, weight=-1.0, times=("a", "b")),
    }
    task = make(3, rewards=rewards, crash_reward=None)
    task.reset()
    put(task, 2.0, 2.0, 2.0)
    *_, info = task.step(STAY)
    d = info["distance"][0].item()
    a = 2.0 * (3.0 - d)
    torch.testing.assert_close(info["reward_terms"][0], torch.tensor([a, 4.0, -(3.0 - d) * (a + 4.0)]))


def test_what_cannot_be_is_refused() -> None:
    for changes, message in (
        ({"kind": "crash", "when": "counts"}, "when = 'counts': only for kind success; a crash ends now"),
        ({"kind": "landing"}, "kind = 'landing': must be one of crash, success, time_out"),
        ({"when": "later"}, "when = 'later': must be one of now, counts, at_end"),
        ({"when": "at_end", "bootstrap": True}, "a success that at_end ends nothing. Leave it out"),
    ):
        assert_refused(ConfigError, message, replace, AT_TARGET, **changes)
    for rewards, message in (
        ({"crash": RewardCfg(term="constant")}, "rewards.crash: the name is that of crash_reward"),
        ({"a": RewardCfg(term="constant", times=("b",))}, "rewards.a.times: no reward 'b'. Known: a"),
        ({"a": RewardCfg(term="constant", times=("a",))}, "reward 'a' is multiplied by others itself"),
        ({}, "rewards: needs at least one"),
    ):
        assert_refused(ConfigError, message, make, 1, rewards=rewards)
    assert_refused(ConfigError, "success_reward: needs a termination", make, 1, success_reward=EndRewardCfg(value=1.0))
    assert_refused(ConfigError, "EndRewardCfg.how = 'times': must be one", EndRewardCfg, value=1.0, how="times")
    assert_refused(ConfigError, "EndRewardCfg.difficulty_value", EndRewardCfg, value=1.0, difficulty_value=float("nan"))
