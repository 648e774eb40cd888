"""Ground and ceiling near rotors that blow down or up: closed forms of both signs, mirror images, limits."""

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from aerial_gym.control import CONTROLLERS, make_controller
from aerial_gym.physics import EFFECTS, BodyState, WarpBackend, accelerations, build_model, vehicle_from_config
from aerial_gym.physics.model import Model
from tests.physics.rotor_types import FORCE, REVERSIBLE, with_rotor
from tests.physics.vehicles import F64, asymmetric_robot, single

RADIUS, MASS = 0.1, 0.8
K = {"ground_effect": 2.0, "ceiling_effect": 1.5}
UPRIGHT, OVER = [0.0, 0.0, 0.0, 1.0], [1.0, 0.0, 0.0, 0.0]


def level_robot(rotor=FORCE):
    robot = with_rotor(asymmetric_robot(com=(0.0, 0.0, 0.0)), rotor)
    mounts = robot.mounts.layout
    layout = tuple(replace(m, position=(*m.position[:2], 0.0), axis=(0.0, 0.0, 1.0)) for m in mounts)
    return replace(robot, mounts=replace(robot.mounts, layout=layout))


def make_model(*names: str, rotor=FORCE, **scene: float) -> Model:
    vehicle = vehicle_from_config(level_robot(rotor), num_envs=1, dtype=F64)
    rows = [(EFFECTS.get(name), torch.tensor([[K[name]]], dtype=F64)) for name in names]
    return build_model(vehicle, rows, **{"ground_height": 0.0, "ceiling_height": None, **scene})


def body_state(height: float, state: float, attitude: list[float] = UPRIGHT) -> BodyState:
    zero = torch.zeros(1, 3, dtype=F64)
    position = torch.tensor([[0.3, -0.2, height]], dtype=F64)
    turn, rotors = torch.tensor([attitude], dtype=F64), torch.full((1, 4), state, dtype=F64)
    return BodyState(position=position, attitude=turn, lin_vel=zero, ang_vel=zero.clone(), rotor_speed=rotors)


def push(model: Model, state: BodyState) -> Tensor:
    return MASS * accelerations(model, state).specific_force[0]


def gain(name: str, distance: float) -> float:
    """Return ``1 / (1 - k (R / 4 h)²)``."""
    return 1.0 / (1.0 - K[name] * (RADIUS / 4.0 / distance) ** 2)


@pytest.mark.parametrize(
    ("name", "blows", "floor", "roof"),
    [
        ("ground_effect", "down", 0.12, None),
        ("ground_effect", "up", None, 0.2),
        ("ceiling_effect", "down", None, 0.2),
        ("ceiling_effect", "up", 0.12, None),
    ],
)
@pytest.mark.parametrize("attitude", [UPRIGHT, OVER])
def test_each_surface_acts_on_the_rotors_on_its_side(name, blows, floor, roof, attitude) -> None:
    """0.12 m over the ground, 0.2 m under the ceiling, thrust of either sign, either side up: the gain is that of one
    surface. The wake goes down where thrust along the axis and the axis have the same sign."""
    thrust = 1.5 if (blows == "down") == (attitude is UPRIGHT) else -1.5
    result = push(make_model(name, ceiling_height=0.32), body_state(0.12, thrust, attitude))
    expected = 4.0 * thrust * gain(name, roof if floor is None else floor)
    torch.testing.assert_close(result, torch.tensor([0.0, 0.0, expected], dtype=F64), rtol=1e-12, atol=1e-12)
    assert abs(expected) > 6.0


@pytest.mark.parametrize("thrust", [1.5, -1.5])
def test_a_room_turned_over_is_the_mirror_image(thrust: float) -> None:
    """Turned over half-way up in a room, with the same rotors, the body feels the same; air has no up."""
    model = make_model("ground_effect", "ceiling_effect", ceiling_height=0.4)
    here, there = push(model, body_state(0.15, thrust)), push(model, body_state(0.25, thrust, OVER))
    torch.testing.assert_close(there, here, rtol=1e-12, atol=1e-12)
    assert not torch.allclose(push(model, body_state(0.25, thrust)), here, rtol=1e-3)


@pytest.mark.parametrize("rotor", [FORCE, REVERSIBLE])
def test_gains_vanish_where_thrust_passes_through_zero(rotor) -> None:
    """Continuous: what comes to the thrust on either side of zero is proportional to it."""
    more = (gain("ground_effect", 0.1) + gain("ceiling_effect", 0.1) - 2.0) * (1.0 + 1e-9)
    model, bare = (make_model(*names, rotor=rotor, ceiling_height=0.2) for names in (K, ()))
    for state in (1e-6, -1e-6, 0.0):
        own = push(bare, body_state(0.1, state))
        assert (push(model, body_state(0.1, state)) - own).abs().max() <= more * own.abs().max()


def test_surfaces_far_away_or_absent_do_nothing() -> None:
    for names, state in ((("ground_effect",), body_state(0.1, -1.5)), (("ground_effect",), body_state(1e6, 1.5))):
        torch.testing.assert_close(push(make_model(*names), state), push(make_model(), state), rtol=1e-12, atol=1e-12)
    far = push(make_model("ceiling_effect", ceiling_height=1e9), body_state(1e6, -1.5))
    torch.testing.assert_close(far, push(make_model(), body_state(1e6, -1.5)), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(
    ("names", "ceiling"),
    [pytest.param(("ground_effect",), None, marks=pytest.mark.slow), (("ground_effect", "ceiling_effect"), 0.3)],
)
def test_the_kernel_tells_the_surfaces_apart(names, ceiling) -> None:
    for thrust in (1.2, -1.2):
        model = make_model(*names, ceiling_height=ceiling).to(torch.float32)
        backend, state = WarpBackend(), single(body_state(0.1, thrust))
        backend.allocate(model, make_controller(CONTROLLERS.get("no_control"), model.vehicle, 9.81), integrator="euler")
        backend.step(state, torch.full((1, 4), thrust), 0.001, 1)
        felt = 4.0 * thrust * gain("ground_effect", 0.1) if thrust > 0.0 else 4.0 * thrust
        if ceiling is not None:
            one, other = (0.1, 0.2) if thrust > 0.0 else (0.2, 0.1)
            felt = 4.0 * thrust * (gain("ground_effect", one) + gain("ceiling_effect", other) - 1.0)
        expected = 0.001 * (felt / MASS - model.gravity)
        assert state.lin_vel[0, 2].item() == pytest.approx(expected, rel=2e-6)
