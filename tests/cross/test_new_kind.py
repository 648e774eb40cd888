"""A kind of effect that only this file knows: torch, the fused kernel, predictor and rollout run it without any change."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from aerial_gym.control import CONTROLLERS
from aerial_gym.errors import ConfigError
from aerial_gym.physics import EFFECTS, build_model, vehicle_from_config
from aerial_gym.physics.effects import Condition, EffectsByKind, Parameter, RotorEffect, SubstepStart, WrenchEffect
from aerial_gym.physics.effects.base import RotorSpeedsOfFlight, relax
from aerial_gym.robots import ROBOTS
from aerial_gym.sim2real.predict.channels import find_channels
from aerial_gym.sim2real.predict.model_params import ModelParams, expand_effects
from aerial_gym.sim2real.predict.predictor import Predictor
from aerial_gym.sim2real.predict.rollout import WindowBatch
from aerial_gym.sim2real.predict.tolerances import Tolerances
from tests.cross.test_backends import assert_same_flight
from tests.unit.sim2real.flat_flights import ROBOT
from tests.unit.sim2real.predict.test_scene import RATE, hover

TAU, G = 0.5, 9.81


class DuctEffect(RotorEffect, WrenchEffect):
    acts_on = "rotor"
    single = "duct"
    memory = (0.0,)

    def thrust(self, condition: Condition, params: Tensor) -> Tensor:
        return params[:, :1] * condition.rotor_thrust

    def wrench(self, condition: Condition, params: Tensor) -> Tensor:
        return torch.nn.functional.pad((params[:, 1] * params[:, 2]).unsqueeze(1), (0, 5))

    def remember(self, moment: SubstepStart, values: Tensor) -> Tensor:
        mean = moment.rotor_speed.mean(dim=1, keepdim=True)
        return mean + (values[:, 2:] - mean) * torch.exp(-moment.dt / TAU)

    def replay(self, track: RotorSpeedsOfFlight, params: Tensor) -> Tensor:
        rest = track.rotor_speed.mean(dim=1, keepdim=True).numpy()
        return torch.from_numpy(relax(rest, rest[0], tau=TAU, step=track.step))


class Duct(DuctEffect):
    name = "duct_of_this_test"
    summary = "a duct around the rotors"
    parameters = (
        Parameter(name="gain", unit="-", low=0.0, high=1.0, scale=0.1, meaning="added share of thrust"),
        Parameter(name="push", unit="N s/rad", low=-1.0, high=1.0, scale=1e-4, meaning="force per speed"),
    )
    excitation = "changes of thrust"
    confused_with = ()


@pytest.fixture(autouse=True)
def register_duct(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(EFFECTS._entries, Duct.name, Duct())


@pytest.mark.parametrize("integrator", ["euler", "rk4"])
def test_the_fused_kernel_flies_a_new_kind_like_torch(integrator: str) -> None:
    assert_same_flight(ROBOTS.get("tinyprop"), CONTROLLERS.get("no_control"), integrator, effects=(Duct.name,))


def test_both_hooks_share_parameters_and_memory() -> None:
    effects = EffectsByKind([(EFFECTS.get("constant_wind"), torch.zeros(2, 3)), (Duct(), torch.ones(2, 2))])
    assert effects[RotorEffect] == effects[WrenchEffect]
    assert [place.memory for place in effects.places(4)] == [slice(0, 0), slice(0, 1)]
    assert effects.names_with_memory == (Duct.name,)


def test_two_of_a_kind_that_is_single_are_refused() -> None:
    vehicle = vehicle_from_config(ROBOT, num_envs=1)
    with pytest.raises(ConfigError, match="one duct at most"):
        build_model(vehicle, [(Duct(), torch.zeros(1, 2))] * 2)


def test_predictor_and_rollout_follow_a_new_kind() -> None:
    """Speeds w that rise by a tenth at 2 s push ``k w (1 + 0.1 (1 - exp(-(t - 2) / tau)))``; thrust is a fifth larger."""
    flight, push_per_speed = hover("a", 5.0), 1e-3
    still = float(flight.rotor_speed[0].mean())
    more = np.where(flight.time >= 2.0, 1.1, 1.0)
    flight = replace(flight, rotor_speed=flight.rotor_speed * more[:, None])
    params = ModelParams(effects={Duct.name: np.array([0.2, push_per_speed])})

    def push(time: np.ndarray) -> np.ndarray:
        return push_per_speed * still * (1.0 + 0.1 * -np.expm1(-np.maximum(time - 2.0, 0.0) / TAU)) / ROBOT.body.mass

    predictor = Predictor(ROBOT, [flight], bandwidth=10.0, channels=find_channels([flight]), tolerances=Tolerances())
    ducted, bare = (predictor.predict(p)[0] for p in (params, ModelParams()))
    time = predictor.times[0]
    np.testing.assert_allclose((ducted - bare)[:, 0], push(time), rtol=4e-3)
    steady = np.abs(time - 2.0) > 0.5
    np.testing.assert_allclose((ducted - bare)[steady, 2], 0.2 * bare[steady, 2], rtol=1e-3)
    vehicle, rows = vehicle_from_config(ROBOT, num_envs=1, dtype=torch.float64), np.array([100, 180, 260])
    run = WindowBatch(vehicle, expand_effects(params, 3), [flight], np.zeros(3, dtype=int), rows)
    ((_, state, _),) = run.simulate_steps(run.state_of_flight(0), {run.num_steps(0.1)})
    np.testing.assert_allclose(state.lin_vel[:, 0], 0.1 * push(rows / RATE + 0.05), rtol=5e-3)
    np.testing.assert_allclose(state.lin_vel[:, 2], 0.1 * G * np.array([0.2, 0.2, 1.2 * 1.21 - 1.0]), rtol=1e-6)
