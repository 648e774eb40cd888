"""The law of a quadrotor without a rotor: stable as it is sampled, mirrored as the vehicle is, and flown."""

from dataclasses import replace
from math import inf, nan

import numpy as np
import pytest
import torch
from scipy.linalg import expm

from aerial_gym.control.lost_rotor import LostRotorLaw, Tolerances, declared_model, hover_gain, lost_rotor_law
from aerial_gym.control.relaxed_hover import TURN, UP, linearised, motion_from_body, relaxed_hover
from aerial_gym.errors import ConfigError
from aerial_gym.physics import BodyState
from aerial_gym.physics.memory import make_memory
from aerial_gym.physics.state import state_at_rest
from aerial_gym.robots import ROBOTS
from tests.physics.swing import fly_remembering
from tests.physics.vehicles import F64, random_state

GRAVITY, ROBOT, DT = 9.81, ROBOTS.get("base_quadrotor_braked_in_spin"), 0.01
MIRROR = torch.tensor([1.0, -1.0, 1.0], dtype=F64)
"""Of a place or a velocity, across the plane of x and z; of a turn its negative."""


@pytest.fixture(scope="module")
def law() -> LostRotorLaw:
    return lost_rotor_law(ROBOT, GRAVITY, share=0.1)


@pytest.mark.parametrize("lost", range(4))
def test_the_closed_loop_comes_to_rest(lost: int) -> None:
    """Lag of the rotors included; as it is sampled every 10 ms with commands held too, and with half and twice the gain."""
    model = declared_model(ROBOT, GRAVITY)
    motion = relaxed_hover(model, lost, 0.1)
    a, b, rows = linearised(model, motion, lost)
    kept = [i for i in range(4) if i != lost]
    gain = hover_gain(model, motion, lost) @ rows.T
    assert bool((gain[lost] == 0.0).all())
    assert float(torch.linalg.eigvals(a - b @ gain[kept]).real.max()) < -1.0
    held = expm(np.block([[a.numpy(), b.numpy()], [np.zeros((3, len(a) + 3))]]) * DT)[: len(a)]
    for factor in (0.5, 1.0, 2.0):
        step = held[:, : len(a)] - factor * held[:, len(a) :] @ gain[kept].numpy()
        assert np.abs(np.linalg.eigvals(step)).max() < 1.0


def test_without_the_law_it_does_not() -> None:
    model = declared_model(ROBOT, GRAVITY)
    a, _, _ = linearised(model, relaxed_hover(model, 0, 0.1), 0)
    assert float(torch.linalg.eigvals(a).real.max()) > -1e-9


def test_the_law_of_a_mirrored_vehicle_is_mirrored(law: LostRotorLaw) -> None:
    """Across the plane of x and z rotors 1 and 4, 2 and 3 change places; attitude (x, y, z, w) becomes (-x, y, -z, w)."""
    state, target = random_state(40), torch.zeros(40, 3, dtype=F64)
    law = LostRotorLaw(hover=law.hover.double(), gain=law.gain.double(), reach=law.reach)
    mirrored = BodyState(
        position=MIRROR * state.position,
        attitude=torch.cat((-MIRROR, torch.ones(1, dtype=F64))) * state.attitude,
        lin_vel=MIRROR * state.lin_vel,
        ang_vel=-MIRROR * state.ang_vel,
        rotor_speed=state.rotor_speed.flip(1),
    )
    for lost, other in ((0, 3), (1, 2)):
        one = law.rotor_command(state, target, torch.full((40,), lost))
        two = law.rotor_command(mirrored, target, torch.full((40,), other))
        torch.testing.assert_close(two, one.flip(1), rtol=0.0, atol=0.01)
        assert bool((one[:, lost] == 0.0).all())
        assert float(one.max()) > 0.0


def test_each_rotor_is_done_without_from_hover_and_from_far_away(law: LostRotorLaw) -> None:
    """Level, with all rotors at the speed of hover, one stops: within 2 cm after 6 s, of a target 7 m away after 11.5 s."""
    lost, away = torch.arange(4).repeat(2), torch.tensor([0.0] * 4 + [5.0] * 4)
    model, state = (
        declared_model(ROBOT, GRAVITY, num_envs=8),
        state_at_rest(8, 4, device=torch.device("cpu"), dtype=F64),
    )
    state.rotor_speed.fill_(1326.3)
    target, memory = torch.stack((away, -away, 0.5 * away), dim=-1).double(), make_memory(model, DT)
    law = LostRotorLaw(hover=law.hover.double(), gain=law.gain.double(), reach=law.reach)
    distance = []
    for _ in range(1200):
        command = law.rotor_command(state, target, lost).minimum(model.vehicle.speed_high)
        state, memory = fly_remembering(model, memory, state, [command], DT, "euler")
        distance.append((state.position - target).norm(dim=-1))
    path = torch.stack(distance)
    assert float(path[:, :4].max()) < 1.0
    assert float(path[600:, :4].max()) < 0.02
    assert float(path[1150:].max()) < 0.02
    motion, hover = motion_from_body(state, target), law.hover[lost]
    torch.testing.assert_close(motion[:, UP], hover[:, UP], rtol=0.0, atol=0.02)
    torch.testing.assert_close(motion[:, TURN], hover[:, TURN], rtol=0.0, atol=0.5)


@pytest.mark.parametrize("value", [0.0, -1.0, nan, inf])
def test_tolerances_without_an_inverse_are_refused(value: float) -> None:
    with pytest.raises(ConfigError, match=r"Tolerances\.turn"):
        replace(Tolerances(), turn=value)
