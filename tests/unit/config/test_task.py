"""Task files: what they say comes back, and fields of earlier versions name what takes their place."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from aerial_gym import task_registry
from aerial_gym.config import build, dump_yaml, load, to_mapping
from aerial_gym.config.task import TaskCfg
from aerial_gym.config.task_terms import ActionCfg, CommandCfg, EndRewardCfg, ImageCfg, ObservationCfg, RewardCfg
from aerial_gym.errors import ConfigError


@pytest.mark.parametrize("name", task_registry.names())
def test_a_task_is_written_and_read_again(name: str, tmp_path: Path) -> None:
    points = CommandCfg(generator="sequence", params={"points": ((0.0, 0.0, 1.0), (1.0, 0.0, 1.0)), "radius": 0.2})
    late = ActionCfg(delay_steps=(1, 3), filter_time_s=0.1)
    cfg = replace(task_registry.get(name), command=points, action=late, images={"depth": ImageCfg()})
    (tmp_path / "task.yaml").write_text(dump_yaml(cfg))
    assert load(TaskCfg, tmp_path / "task.yaml") == cfg


@pytest.mark.parametrize(("field", "way_out"), [
    ("reward", "give rewards: "),
    ("reward_params", "each of the rewards has params of its own; that of a crash is crash_reward"),
    ("max_distance", "term: far_from_target, kind: crash"),
    ("success_radius", "term: at_target, kind: success, when: at_end"),
    ("target", "generator: point"),
    ("target_ratio_low", "generator: drawn_point"),
    ("target_ratio_high", "generator: drawn_point"),
    ("action_params", "action: {transform: NAME"),
])  # fmt: skip
def test_a_field_of_an_earlier_version_names_the_way_out(field: str, way_out: str) -> None:
    fields = to_mapping(task_registry.get("position_setpoint_task"))
    with pytest.raises(ConfigError, match=f"my.yaml: field {field!r} is gone: .*{way_out}"):
        build(TaskCfg, fields | {field: 1.0}, where="my.yaml")


def test_forms_of_an_earlier_version_say_what_they_must_be() -> None:
    fields = to_mapping(task_registry.get("position_setpoint_task"))
    words = "my.yaml: action: must be a mapping of the fields of ActionCfg, found 'direct'"
    with pytest.raises(ConfigError, match=words):
        build(TaskCfg, fields | {"action": "direct"}, where="my.yaml")
    with pytest.raises(ConfigError, match="my.yaml: observations = .*: must be a mapping"):
        build(TaskCfg, fields | {"observations": [{"term": "attitude"}]}, where="my.yaml")


OBSERVATION = partial(ObservationCfg, term="attitude")


@pytest.mark.parametrize(("make", "given", "message"), [
    (OBSERVATION, {"noise_std": -0.1}, "noise_std = -0.1: must be >= 0"),
    (OBSERVATION, {"dropout": 1.0}, "dropout = 1.0: must be a probability, 0 <= dropout < 1"),
    (OBSERVATION, {"dropout_value": float("inf")}, "dropout_value = inf: must be finite"),
    (OBSERVATION, {"hold_steps": 3}, "hold_steps = 3: must be >= 0, and needs a dropout"),
    (OBSERVATION, {"delay_steps": -1}, "delay_steps = -1: must be >= 0"),
    (OBSERVATION, {"delay_steps": (3, 1)}, r"delay_steps = \(3, 1\): must be >= 0, or the fewest and the most"),
    (OBSERVATION, {"history": 0}, "history = 0: must be >= 1"),
    (OBSERVATION, {"scale": 0.0}, "scale = 0.0: must be finite and not 0"),
    (OBSERVATION, {"scale": float("nan")}, "scale = nan"),
    (ActionCfg, {"noise_std": -0.1}, "ActionCfg.noise_std = -0.1: must be >= 0"),
    (ActionCfg, {"filter_time_s": -1.0}, "ActionCfg.filter_time_s = -1.0"),
    (ActionCfg, {"delay_steps": -1}, "ActionCfg.delay_steps = -1"),
    (ImageCfg, {"dtype": "int8"}, "ImageCfg.dtype = 'int8': must be uint8, float16, float32"),
    (ImageCfg, {"largest": 0.0}, "ImageCfg.largest = 0.0"),
])  # fmt: skip
def test_numbers_of_a_task_are_checked(make: Callable, given: dict, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        make(**given)


@pytest.mark.parametrize("number", [3.5e38, -1e308, float("inf"), float("nan")])
@pytest.mark.parametrize("name", ["value", "difficulty_value"])
def test_what_ends_and_terms_are_worth_is_finite_in_single_precision(name: str, number: float) -> None:
    with pytest.raises(ConfigError, match=rf"EndRewardCfg.{name} = .*: must be finite, and at most 3.4e\+38"):
        EndRewardCfg(**({"value": 0.0} | {name: number}))
    with pytest.raises(ConfigError, match=r"RewardCfg.weight = .*: must be finite"):
        RewardCfg(term="distance_bell", weight=number)
    assert EndRewardCfg(value=-3.4028234e38).value < 0.0


@pytest.mark.parametrize("number", [1e308, -3.5e38, 10**400])
def test_a_parameter_of_a_term_is_no_larger_than_single_precision(number: float) -> None:
    fields = to_mapping(task_registry.get("position_setpoint_task"))
    fields["command"] = {"generator": "point", "params": {"position": [0.0, number, 0.0]}}
    with pytest.raises(ConfigError, match=r"my.yaml: command: params.position\[1\] = .*: must be at most 3.4e\+38"):
        build(TaskCfg, fields, where="my.yaml")
