"""Where the GTD shows a load: on its link, moving as it says, and with the momentum that gravity gives both bodies."""

from dataclasses import replace

import pytest
import torch

from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.env_manager import SIMS, EnvManager
from tests.builders import simulation

LOAD, LENGTH = 0.05, 0.5


def make(backend: str, *, num_envs: int = 3, differentiable: bool = False, **drawn: RandomizeCfg) -> EnvManager:
    env = simulation(
        "base_quadrotor_with_payload",
        sim=replace(SIMS.get("base_sim_2ms"), backend=backend, integrator="rk4"),
        env="empty_env_2ms",
        num_envs=num_envs,
        seed=2,
        randomize={f"effects.slung_payload.{name}": each for name, each in drawn.items()},
        differentiable=differentiable,
    )
    env.reset()
    return env


TORCH_SLOWLY = [pytest.param("torch", marks=pytest.mark.slow), "warp"]


@pytest.mark.parametrize("backend", TORCH_SLOWLY)
def test_a_load_hangs_below_and_swings_on_its_link(backend: str) -> None:
    """Straight down at the reset; later at the same distance, and its place changes as its velocity says, to ``a dt / 2``."""
    env = make(backend)
    gtd, told = env.gtd, torch.tensor([[0.7, 0.7, 0.8, 0.8]]).expand(3, -1)
    torch.testing.assert_close(gtd["load_position"], gtd["robot_position"] - torch.tensor([0.0, 0.0, LENGTH]))
    torch.testing.assert_close(gtd["load_linvel"], gtd["robot_linvel"])
    for _ in range(100):
        before, velocity = gtd["load_position"].clone(), gtd["load_linvel"].clone()
        env.step(told)
        away = gtd["load_position"] - gtd["robot_position"]
        torch.testing.assert_close(away.norm(dim=-1), torch.full((3,), LENGTH), rtol=1e-5, atol=0.0)
        mean = 0.5 * (velocity + gtd["load_linvel"])
        torch.testing.assert_close((gtd["load_position"] - before) / env.dt, mean, atol=0.03, rtol=0.0)
    assert away[:, :2].norm(dim=-1).min() > 0.01  # it does swing


@pytest.mark.parametrize("backend", TORCH_SLOWLY)
def test_both_bodies_together_fall_as_gravity_and_thrust_say(backend: str) -> None:
    """Without thrust both bodies together lose ``(m + M) g t``, to half a unit in the last place of 8 m/s in each substep."""
    env, off = make(backend), torch.zeros(3, 4)
    gtd, mass = env.gtd, 0.25

    def momentum() -> torch.Tensor:
        return mass * gtd["robot_linvel"] + LOAD * gtd["load_linvel"]

    for _ in range(50):  # until the rotors stand still: exp(-0.5 / 0.04)
        env.step(off)
    before = momentum()
    for _ in range(20):
        env.step(off)
    fallen = torch.tensor([0.0, 0.0, -(mass + LOAD) * env.sim_cfg.gravity * 20 * env.dt]).expand(3, -1)
    torch.testing.assert_close(momentum() - before, fallen, atol=2e-5, rtol=0.0)


@pytest.mark.parametrize("backend", TORCH_SLOWLY)
def test_a_reset_hangs_new_loads_in_the_rows_of_the_mask_alone(backend: str) -> None:
    env = make(backend, length=RandomizeCfg(how="value", low=0.3, high=1.0))
    told, mask = torch.tensor([[0.7, 0.7, 0.8, 0.8]]).expand(3, -1), torch.tensor([True, False, True])
    for _ in range(50):
        env.step(told)
    keys = ("load_position", "load_linvel")
    kept = {key: env.gtd[key].clone() for key in keys}
    lengths = env.gtd["effect_slung_payload"][:, 1].clone()
    env.reset(mask)
    for key in keys:
        assert torch.equal(env.gtd[key][~mask], kept[key][~mask])
    away = env.gtd["load_position"] - env.gtd["robot_position"]
    new = env.gtd["effect_slung_payload"][:, 1]
    assert (new != lengths).tolist() == mask.tolist()
    torch.testing.assert_close(away[mask], torch.stack((0.0 * new, 0.0 * new, -new), dim=-1)[mask])


def test_both_backends_and_one_with_gradients_show_the_same_load() -> None:
    ends = []
    for backend, differentiable in (("torch", False), ("warp", False), ("torch", True)):
        env = make(backend, differentiable=differentiable)
        for _ in range(40):
            env.step(torch.tensor([[0.7, 0.7, 0.8, 0.8]]).expand(3, -1))
        ends.append(torch.cat((env.gtd["load_position"], env.gtd["load_linvel"]), dim=-1))
    torch.testing.assert_close(ends[1], ends[0], atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(ends[2], ends[0], atol=1e-4, rtol=1e-4)


def test_a_robot_without_a_load_has_no_such_keys() -> None:
    env = simulation("base_quadrotor")
    assert "load_position" not in env.gtd
