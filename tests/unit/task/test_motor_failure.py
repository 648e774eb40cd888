"""motor_failure_task: one drawn rotor follows a drawn part of its command from a drawn moment on, in every environment."""

from math import exp

import torch

from aerial_gym.math.quaternion import quat_rotate_inverse
from aerial_gym.task import Task
from aerial_gym.task.terms.catalog import OBSERVATIONS
from tests.unit.task.hover import begin

NAME, HOVER = "motor_failure_task", -0.387
"""The action for 0.613 N of each rotor, a quarter of the weight."""


def draws(task: Task) -> list[torch.Tensor]:
    return [task.env.draws()[f"effects.motor_failure.{key}"].flatten().clone() for key in ("motor", "scale", "time")]


def test_a_drawn_rotor_keeps_a_drawn_part_of_its_speed_from_a_drawn_moment() -> None:
    """Told the same, rotors turn alike before; 0.3 s after, seven time constants, one has its share, to exp(-7.5)."""
    with begin(NAME, 200) as task:
        motor, scale, moment = draws(task)
        gtd, first, told = task.env.gtd, torch.ones(200, dtype=torch.bool), torch.full((200, 4), HOVER)
        whole, broken = torch.zeros(200, dtype=torch.bool), torch.zeros(200, dtype=torch.bool)
        for step in range(1, 361):
            _, _, terminated, truncated, _ = task.step(told)
            first &= ~(terminated | truncated)
            speed, time = gtd["rotor_speed"], 0.01 * step
            sought = speed.gather(1, motor.long().unsqueeze(1) - 1)[:, 0]
            share = sought / speed.max(dim=1).values
            before, after = first & (time <= moment - 0.01) & (time > 0.5), first & (time >= moment + 0.31)
            assert (share[before] > 1.0 - 1e-4).all()
            torch.testing.assert_close(share[after], scale[after], atol=1e-3, rtol=0.0)
            whole |= before
            broken |= after
        assert whole.all()
        assert broken.float().mean() > 0.8  # the others had drifted 8 m away before


def test_the_drag_of_its_rotors_brakes_a_spin_as_that_of_the_source() -> None:
    """At hover ``r = r0 exp(-c t)`` with ``c = g M L² / (m l² Izz)``: g = 2.75e-3 N m s of m = 0.5 kg with arms l = 0.17 m."""
    with begin(NAME, 2) as task:
        state, body = task.env.robot_manager.tensors.state, task.env.robot_manager.cfg.body
        arm = sum(x * x for x in task.env.robot_manager.cfg.mounts.layout[0].position)
        rate = 2.75e-3 * body.mass * arm / (0.5 * 0.17**2 * body.inertia[2][2])
        for _ in range(30):  # rotors come to hover
            task.step(torch.full((2, 4), HOVER))
        state.ang_vel.copy_(torch.tensor([[0.0, 0.0, 5.0], [0.0, 0.0, -5.0]]))
        for _ in range(50):
            task.step(torch.full((2, 4), HOVER))
        expected = 5.0 * exp(-0.5 * rate)
        assert 0.2 < expected / 5.0 < 0.8
        torch.testing.assert_close(state.ang_vel[:, 2], torch.tensor([expected, -expected]), rtol=0.02, atol=0.0)


def test_up_is_told_in_the_body() -> None:
    turn = torch.nn.functional.normalize(torch.randn(50, 4, generator=torch.Generator().manual_seed(0)), dim=-1)
    expected = quat_rotate_inverse(turn, torch.tensor([[0.0, 0.0, 1.0]]).expand(50, 3))
    torch.testing.assert_close(OBSERVATIONS.get("up_body").value(turn), expected)
