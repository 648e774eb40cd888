"""A control law of a user's own package: the one of the guide, without Warp code, on both backends."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from aerial_gym.control import CONTROL_LAWS, CONTROLLERS, make_controller
from aerial_gym.errors import ConfigError
from aerial_gym.physics import BodyState, TorchBackend, WarpBackend, build_model, state_at_rest, vehicle_from_config
from aerial_gym.robots import ROBOTS
from tests.physics.vehicles import random_state

GUIDE = Path(__file__).parents[3] / "docs" / "guides" / "own_law.md"
ROBOT, DT = ROBOTS.get("base_quadrotor"), 0.004


@pytest.fixture
def own_law(monkeypatch: pytest.MonkeyPatch) -> str:
    """Return the name of the guide's controller, registered for one test."""
    for registry in (CONTROL_LAWS, CONTROLLERS):
        monkeypatch.setattr(registry, "_entries", dict(registry._entries))
    blocks = re.findall(r"^```python\n(.*?)^```", GUIDE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    assert "warp" not in blocks[0]
    names: dict[str, Any] = {"__name__": "own_law"}
    exec(blocks[0], names)
    return "climb_rate_control"


def test_an_own_law_flies_alike_on_both_backends(own_law: str) -> None:
    """At its own rate, with delayed actions, from random states, 40 steps; some rotors reach their limits."""
    cfg = replace(CONTROLLERS.get(own_law), rate_hz=50.0, action_delay=0.02)
    start, ends = random_state(8, seed=3, rotor_speed=400.0), []
    for backend in (TorchBackend(), WarpBackend()):
        vehicle = vehicle_from_config(ROBOT, num_envs=8)
        backend.allocate(build_model(vehicle), make_controller(cfg, vehicle, 9.81, dt=DT), integrator="euler")
        state = BodyState(**{name: rows.float() for name, rows in vars(start).items()})
        backend.step(state, torch.tensor([[0.5, 0.3, -0.2, 0.1]]).repeat(8, 1), DT, 40)
        ends.append(state)
    for name, rows in vars(ends[0]).items():
        torch.testing.assert_close(getattr(ends[1], name), rows, rtol=1e-4, atol=1e-4, msg=name)


def test_its_integral_carries_an_unknown_load(own_law: str) -> None:
    """With a vehicle 20 % heavier than declared it climbs as commanded; ``4 I = 0.2 g`` is what the integral then carries."""
    declared = vehicle_from_config(ROBOT, num_envs=1)
    law, backend = make_controller(CONTROLLERS.get(own_law), declared, 9.81, dt=DT), WarpBackend()
    backend.allocate(
        build_model(replace(declared, mass=declared.share(1.2 * declared.mass[0]))), law, integrator="euler"
    )
    state = state_at_rest(1, 4, device=torch.device("cpu"), dtype=torch.float32)
    backend.step(state, torch.tensor([[0.5, 0.0, 0.0, 0.0]]), DT, 4000)
    assert float(state.lin_vel[0, 2]) == pytest.approx(0.5, abs=1e-3)
    assert backend.law_memory is not None
    assert float(backend.law_memory.numbers[0, 0]) == pytest.approx(0.05 * 9.81, abs=2e-3)


def test_an_unknown_law_is_refused_with_the_known_ones(own_law: str) -> None:
    vehicle = vehicle_from_config(ROBOT, num_envs=1)
    with pytest.raises(ConfigError, match=r"ControllerCfg.law = 'climb': unknown. Known: thrust, .*, climb_rate"):
        make_controller(replace(CONTROLLERS.get(own_law), law="climb"), vehicle, 9.81, dt=DT)
    with pytest.raises(ConfigError, match="needs a time step"):
        make_controller(CONTROLLERS.get(own_law), vehicle, 9.81)
