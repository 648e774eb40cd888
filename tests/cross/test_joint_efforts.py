"""The applied efforts of drives and dry friction in the Global Tensor Dictionary, on all backends, in closed form."""

from dataclasses import replace

import pytest
import torch

from aerial_gym.config.joint import DriveCfg, SpringCfg
from aerial_gym.env_manager import SIMS, EnvManager
from aerial_gym.errors import UnknownNameError
from tests.builders import simulation
from tests.physics.articulated.test_complementarity import INERTIA
from tests.physics.test_links_seen import LEFT, arm, bending
from tests.repetitions import frequent_values

DT, LIMIT, FRICTION = 0.002, 4.0 * INERTIA, INERTIA

DRIVE = DriveCfg(mode="effort", limit=LIMIT, command_range=(-6.0 * INERTIA, 6.0 * INERTIA))

BACKENDS = frequent_values(("torch", "warp", "mujoco"), ("torch", "warp"))


def make(backend: str, axis: tuple[float, float, float], friction: float, *, rate: float = 0.0, **changes: object):
    spring = SpringCfg(friction=friction)
    manager = simulation(
        bending(arm(axis, 0.0, rate=rate, spring=spring, **changes)), seed=1, num_envs=3,
        sim=replace(SIMS.get("base_sim"), backend=backend, dt=DT),
    )  # fmt: skip
    manager.reset()
    return manager


def efforts(manager: EnvManager) -> tuple[torch.Tensor, torch.Tensor]:
    return manager.gtd["dof_drive_effort"][:, 0].double(), manager.gtd["dof_friction_effort"][:, 0].double()


@pytest.mark.parametrize("backend", BACKENDS)
def test_efforts_of_a_drive_and_of_friction_are_their_laws_and_change_the_rate(backend: str) -> None:
    """Commands below, at and beyond the limit against friction: ``I w' = clamp(T, limit) - F`` with both signs."""
    if backend == "mujoco":
        pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'aerial-gym[mujoco]'")
    manager = make(backend, LEFT, FRICTION, drive=DRIVE)
    command = torch.tensor([2.0, -6.0, 6.0]) * INERTIA
    for _ in range(3):
        before = manager.gtd["dof_velocity"][:, 0].double()
        manager.step(torch.cat((torch.zeros(3, 4), command.unsqueeze(1)), dim=1))
    drive, friction = efforts(manager)
    expected = torch.tensor([2.0, -4.0, 4.0]).double() * INERTIA
    torch.testing.assert_close(drive, expected, rtol=1e-5, atol=0.0)
    torch.testing.assert_close(friction, -FRICTION * torch.sign(expected), rtol=1e-5, atol=0.0)
    change = (manager.gtd["dof_velocity"][:, 0].double() - before) / DT
    torch.testing.assert_close(change * INERTIA, drive + friction, rtol=1e-3, atol=0.0)


@pytest.mark.parametrize("backend", ["torch", "warp"])
def test_a_reset_clears_the_efforts_of_its_environments(backend: str) -> None:
    manager = make(backend, LEFT, FRICTION, rate=1.0)
    manager.step(torch.zeros(3, 4))
    manager.reset(torch.tensor([False, True, False]))
    assert efforts(manager)[1].tolist() == pytest.approx([-FRICTION, 0.0, -FRICTION])


def test_a_robot_without_drives_and_friction_has_no_such_keys() -> None:
    manager = simulation("morphy", num_envs=1)
    with pytest.raises(UnknownNameError):
        manager.gtd["dof_drive_effort"]
