"""Ground contact against the closed form of a body that falls without thrust or drag."""

import pytest
import torch

from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.physics import BodyState, Ground, TorchBackend, WarpBackend, build_model, vehicle_from_config
from aerial_gym.physics.ground import touches_ground
from aerial_gym.robots import ROBOTS
from tests.physics.vehicles import asymmetric_robot

HEIGHTS = torch.tensor([1.0, 2.0, 5.0])


def fall(backend, span: float, *, spheres, substeps: int = 100) -> torch.Tensor:
    vehicle = vehicle_from_config(ROBOTS.get("base_quadrotor"), num_envs=3)
    law = make_controller(CONTROLLERS.get("rotor_speed_control"), vehicle, 9.81)
    contact = torch.zeros(3, dtype=torch.bool)
    ground = Ground(height=0.0, spheres=torch.tensor(spheres), contact=contact)
    backend.allocate(build_model(vehicle), law, integrator="rk4", ground=ground)
    state = BodyState(
        position=torch.stack((torch.zeros(3), torch.zeros(3), HEIGHTS), dim=-1),
        attitude=torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(3, 1),  # upside down: body z points down
        lin_vel=torch.zeros(3, 3),
        ang_vel=torch.zeros(3, 3),
        rotor_speed=torch.zeros(3, 4),
    )
    backend.step(state, torch.zeros(3, 4), span / substeps, substeps)
    return contact


@pytest.mark.parametrize("backend", [pytest.param(TorchBackend, marks=pytest.mark.slow), WarpBackend])
def test_contact_comes_when_the_lowest_sphere_has_fallen_to_the_ground(backend) -> None:
    """From height h the body falls ``g t²/2``; turned over, a sphere at body z = 0.3 of radius 0.1 hangs 0.4 m below it."""
    spheres = [[0.0, 0.0, 0.0, 0.05], [0.0, 0.0, 0.3, 0.1]]
    for height in HEIGHTS.tolist():
        landing = (2.0 * (height - 0.4) / 9.81) ** 0.5
        before = fall(backend(), 0.98 * landing, spheres=spheres)
        after = fall(backend(), 1.02 * landing, spheres=spheres)
        assert before.tolist() == torch.lt(HEIGHTS, height).tolist()
        assert after.tolist() == torch.le(HEIGHTS, height).tolist()


def test_contact_within_a_step_is_kept_though_the_body_is_free_at_its_end() -> None:
    """A body that dips below the ground and is thrown up again by its rotors touched it: seen between the substeps."""
    result = []
    for backend in (TorchBackend(), WarpBackend()):
        vehicle = vehicle_from_config(ROBOTS.get("base_quadrotor"), num_envs=1)
        law = make_controller(CONTROLLERS.get("no_control"), vehicle, 9.81)
        contact = torch.zeros(1, dtype=torch.bool)
        ground = Ground(height=0.0, spheres=torch.tensor([[0.0, 0.0, 0.0, 0.1]]), contact=contact)
        backend.allocate(build_model(vehicle), law, integrator="euler", ground=ground)
        state = BodyState(
            position=torch.tensor([[0.0, 0.0, 0.11]]),
            attitude=torch.tensor([[0.0, 0.0, 0.0, 1.0]]),
            lin_vel=torch.tensor([[0.0, 0.0, -1.0]]),
            ang_vel=torch.zeros(1, 3),
            rotor_speed=torch.full((1, 4), 1300.0),
        )
        backend.step(state, torch.full((1, 4), 2.0), 0.005, 100)
        assert not touches_ground(ground, state).any()
        result.append(contact.item())
    assert result == [True, True]


def test_the_offset_of_the_centre_of_mass_does_not_move_the_ground() -> None:
    """Spheres are placed from the body origin, whatever the mass does."""
    robot = asymmetric_robot(com=(0.0, 0.0, 0.2))
    for backend in (TorchBackend(), WarpBackend()):
        vehicle = vehicle_from_config(robot, num_envs=2)
        contact = torch.zeros(2, dtype=torch.bool)
        ground = Ground(height=0.0, spheres=torch.tensor([[0.0, 0.0, 0.0, 0.1]]), contact=contact)
        law = make_controller(CONTROLLERS.get("rotor_speed_control"), vehicle, 9.81)
        backend.allocate(build_model(vehicle), law, integrator="euler", ground=ground)
        state = BodyState(
            position=torch.tensor([[0.0, 0.0, 0.11], [0.0, 0.0, 0.09]]),
            attitude=torch.tensor([[0.0, 0.0, 0.0, 1.0]]).repeat(2, 1),
            lin_vel=torch.zeros(2, 3),
            ang_vel=torch.zeros(2, 3),
            rotor_speed=torch.zeros(2, 4),
        )
        backend.step(state, torch.zeros(2, 4), 1e-4, 1)
        assert contact.tolist() == [False, True]
