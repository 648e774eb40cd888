"""Settings of a training by preflight results: which values are drawn, and what is refused."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from aerial_gym.config.task import TaskCfg
from aerial_gym.errors import ConfigError
from aerial_gym.for_real.plan import TrainingPlan, plan_training, robot_for_training
from aerial_gym.rl_training.policy_task import PolicyTask

TASK = PolicyTask(
    name="agile_tracking_task", robot="racing_quadrotor", controller=None, encoder=None, backend=None, level=None,
    settings=(), device="cpu", seed=0,
)  # fmt: skip


def constant(
    name: str, state: str, declared: float, low: float = 0.0, high: float = 0.0, tolerance: float = 0.0
) -> Any:
    """Return a finding as a written preflight result has it."""
    values = {"declared": declared, "value": 0.5 * (low + high), "low": low, "high": high, "tolerance": tolerance}
    return {"code": f"constant_{state}", "subject": name, "values": values, "text": f"{name}."}


def plan(
    *findings: Any, noise: dict[str, float] | None = None, task: PolicyTask = TASK
) -> tuple[TrainingPlan, TaskCfg]:
    """Return the plan, and the task with its settings."""
    made = plan_training(task, {"findings": findings, "noise": noise or {}})
    return made, replace(task, settings=made.settings).configurations()[0]


@pytest.mark.parametrize(("state", "high"), [("measured", 1.0), ("contradicted", 0.93)])
def test_a_value_of_the_log_is_drawn_within_its_interval(state: str, high: float) -> None:
    """A measured value agrees with the declared one, which may be right as well: the range reaches it."""
    _, cfg = plan(constant("thrust_per_weight", state, 1.0, 0.91, 0.93))
    drawn = cfg.randomize["effects.thrust_coefficient.scale"]
    assert drawn.how == "value"
    assert (drawn.low, drawn.high) == pytest.approx((0.91, high))


def test_an_assumed_value_is_drawn_within_its_tolerance() -> None:
    _, cfg = plan(constant("rotor_lag", "assumed", 0.033, tolerance=0.008))
    drawn = cfg.randomize["effects.motor_time_constant.tau"]
    assert (drawn.low, drawn.high) == pytest.approx((0.025, 0.041))


def test_an_exponent_becomes_an_offset_and_an_inertia_a_factor() -> None:
    _, cfg = plan(
        constant("thrust_exponent", "contradicted", 2.0, 2.15, 2.25),
        constant("inertia_roll", "measured", 0.002, 0.0018, 0.0021),
    )  # fmt: skip
    exponent, inertia = (cfg.randomize[f"effects.{name}"] for name in ("thrust_curve.k", "inertia_error.sx"))
    assert (exponent.low, exponent.high) == pytest.approx((0.15, 0.25))
    assert (inertia.low, inertia.high) == pytest.approx((0.9, 1.05))


def test_latency_and_jitter_become_whole_steps() -> None:
    """At 100 Hz: 33 to 37 ms, and a uniform delay of 12**0.5 times 3 ms on top: 3 to 5 steps."""
    _, cfg = plan(
        constant("command_latency", "contradicted", 0.0, 0.033, 0.037),
        constant("link_jitter", "measured", 0.0, 0.0029, 0.003),
        constant("position_latency", "contradicted", 0.0, 0.038, 0.039),
    )  # fmt: skip
    assert cfg.action.delay_steps == (3, 5)
    assert cfg.observations["policy"][0].delay_steps == (3, 4)


def test_without_findings_tolerances_and_noise_of_the_library_are_the_default() -> None:
    made, cfg = plan()
    states = {one.name: one.state for one in made.choices}
    assert (
        states["command_latency, link_jitter"]
        == states["noise of rotation_rows"]
        == states["com_offset.x"]
        == "default"
    )
    assert cfg.action.delay_steps == (0, 2)  # 8 ms, and the jitter of 3 ms
    assert all(entry.noise_std > 0.0 for entry in cfg.observations["policy"][:4])
    assert cfg.observations["policy"][4].noise_std == 0.0  # the target is no measurement


def test_noise_and_losses_of_the_log_are_those_of_the_observations() -> None:
    _, cfg = plan(constant("packet_loss", "contradicted", 0.0, 0.04, 0.06), noise={"position": 0.012, "ang_vel": 0.03})
    position, _, _, turning, *_ = cfg.observations["policy"]
    assert (position.noise_std, turning.noise_std) == (0.012, 0.03)
    assert (position.dropout, turning.dropout) == (0.06, 0.06)


def test_another_rate_of_the_link_is_that_of_the_training() -> None:
    made, cfg = plan(constant("link_rate", "contradicted", 100.0, 49.0, 51.0))
    _, _, env, sim = replace(TASK, settings=made.settings).configurations()
    assert sim.dt * env.physics_steps_per_env_step == pytest.approx(0.02)
    assert cfg.episode_len_steps == 300
    assert cfg.action.delay_steps == (0, 1)


def test_draws_of_a_close_loop_result_are_kept(tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(
        "extends: racing_quadrotor\nsummary: corrected\neffects: {thrust_coefficient: {scale: 0.95}}\neffects_source: a fit\n"
        "randomize: {effects.thrust_coefficient.scale: {how: value, distribution: normal, mean: 0.95, std: 0.01}}\n"
    )
    task = replace(TASK, robot=robot_for_training("racing_quadrotor", tmp_path / "log.csv"))
    assert task.robot == str(file)
    made, cfg = plan(constant("thrust_per_weight", "measured", 0.95, 0.94, 0.97), task=task)
    assert "effects.thrust_coefficient.scale" not in cfg.randomize
    assert made.choices[0].state == "close_loop"


def test_a_robot_file_without_draws_beside_the_log_is_not_used(tmp_path: Path) -> None:
    (tmp_path / "robot.yaml").write_text("extends: racing_quadrotor\nsummary: plain\n")
    assert robot_for_training("racing_quadrotor", tmp_path / "log.csv") == "racing_quadrotor"


def test_wrong_wiring_is_refused_and_a_wrong_sensor_named() -> None:
    with pytest.raises(ConfigError, match="Rotors differ. Correct it on the vehicle"):
        plan({"code": "rotor_order_contradicted", "subject": "", "values": {}, "text": "Rotors differ."})
    made, _ = plan(constant("gyro_scale_x", "contradicted", 1.0, 1.02, 1.03))
    assert made.corrections == ("gyro_scale_x.",)
