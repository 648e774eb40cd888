"""Answers of effects that are asked again and again: they stand as long as nothing that was read has changed, and no longer."""

import copy
import pickle
from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from aerial_gym.physics import accelerations, build_model, condition_in, effects_from_config, vehicle_from_config
from aerial_gym.physics.effect_cache import EffectCache
from aerial_gym.physics.effects import Condition
from aerial_gym.physics.model import Model
from aerial_gym.physics.rigid_body import MOVES_OF_VEHICLE, adapt_condition
from aerial_gym.physics.vehicle import is_shared, share_row
from tests.physics.test_rigid_body import F64, asymmetric_robot, random_state

ROWS = 6
VALUES = {
    "axial_inflow": {"ka": 1e-4}, "h_force_flapping": {"kh": 1e-5, "kf": 1e-6}, "translational_lift": {"kt": 1e-3},
    "rotor_drag": {"dx": 0.1, "dy": 0.2, "dz": 0.05},
}  # fmt: skip


def make_model(values: dict[str, dict[str, float]]) -> Model:
    vehicle = vehicle_from_config(asymmetric_robot(), num_envs=ROWS, dtype=F64)
    effects = effects_from_config(values, num_envs=ROWS, device=torch.device("cpu"), dtype=F64)
    return build_model(vehicle, effects)


def make_condition(model: Model) -> Condition:
    state = random_state(ROWS)
    return condition_in(model, state, torch.zeros_like(state.rotor_speed))


class _Law:
    def __init__(self) -> None:
        self.asked = 0

    def __call__(self, condition: Condition, params: Tensor) -> Tensor:
        self.asked += 1
        return params * (condition.rotor_thrust * condition.vehicle.rotor_spin).sum(1, keepdim=True)


def test_an_answer_stands_until_something_that_was_read_changes() -> None:
    answers, law, condition = EffectCache[Condition](), _Law(), make_condition(make_model({}))
    params, vehicle = torch.full((ROWS, 1), 2.0, dtype=F64), condition.vehicle
    first = answers.ask(law, condition, params)
    unread = replace(condition, position=condition.position + 1.0, vehicle=replace(vehicle, mass=2.0 * vehicle.mass))
    assert answers.ask(law, unread, params.clone()) is first
    assert law.asked == 1
    for condition_now, params_now in (
        (condition.with_thrust(1.5 * condition.rotor_thrust), params),
        (replace(condition, vehicle=replace(vehicle, rotor_spin=-vehicle.rotor_spin)), params),
        (condition, 3.0 * params),
    ):
        before = law.asked
        result = answers.ask(law, condition_now, params_now)
        assert torch.equal(result, law(condition_now, params_now))
        assert law.asked == before + 2  # once by the answers, once here
        assert torch.equal(answers.ask(law, condition, params), first)


def test_results_that_a_model_does_not_ask_for_are_freed() -> None:
    answers, law, condition = EffectCache[Condition](), _Law(), make_condition(make_model({}))
    params = torch.full((ROWS, 1), 2.0, dtype=F64)
    for asked in (1, 2):
        answers.ask(law, condition, params)
        answers.drop_unused()
        answers.ask(law, condition, params)
        assert law.asked == asked
        answers.drop_unused()
        answers.drop_unused()


def test_numbers_that_are_none_never_stand() -> None:
    answers, law, condition = EffectCache[Condition](), _Law(), make_condition(make_model({}))
    unknown = condition.with_thrust(torch.full_like(condition.rotor_thrust, torch.nan))
    for _ in range(2):
        answers.ask(law, unknown.with_thrust(unknown.rotor_thrust.clone()), torch.ones(ROWS, 1, dtype=F64))
    assert law.asked == 2


def test_accelerations_do_not_depend_on_earlier_calls() -> None:
    answers, state = EffectCache[Condition](), random_state(ROWS)
    for name, numbers in VALUES.items():
        for number in numbers:
            model = make_model(VALUES | {name: numbers | {number: 1.5 * numbers[number]}})
            for flown in (make_model(VALUES), model):
                result, plain = accelerations(flown, state, answers=answers), accelerations(flown, state)
                assert torch.equal(result.specific_force, plain.specific_force)
                assert torch.equal(result.ang_acc, plain.ang_acc)


def test_a_condition_follows_from_nothing_else_of_the_vehicle() -> None:
    model = make_model({})
    vehicle, seen = model.vehicle, make_condition(model)
    names = (
        "position", "air_velocity", "rotor_thrust", "lever", "axis", "hub_velocity", "hub_altitude", "wake_room",
        "rotor_drag_torque",
    )  # fmt: skip
    assert all(getattr(seen, name).shape[0] for name in names)  # now cached
    for field, rows in vehicle.tensors_by_name().items():
        other = replace(vehicle, **{field: rows + 0.1 * (1.0 + rows.abs())})
        moved = make_condition(replace(model, vehicle=other))
        if field not in MOVES_OF_VEHICLE:
            kept = adapt_condition(other, seen)
            assert kept.vehicle is other
            assert all(torch.equal(getattr(kept, name), getattr(moved, name)) for name in names), field


def test_thrusts_of_a_vehicle_that_moves_likewise_stand_where_its_maps_are_the_same() -> None:
    seen = make_condition(make_model({}))
    assert is_shared(seen.vehicle.thrust_map)
    other = replace(seen.vehicle, thrust_map=share_row(seen.vehicle.thrust_map[0].clone(), ROWS))
    assert adapt_condition(other, seen).rotor_thrust is seen.rotor_thrust


@pytest.mark.parametrize("field", [*MOVES_OF_VEHICLE, "thrust_map"])
def test_what_a_condition_sees_of_the_vehicle_moves_it(field: str) -> None:
    model = make_model({})
    moved = replace(model.vehicle, **{field: 1.1 * getattr(model.vehicle, field) + 0.01})
    names = ("air_velocity", "rotor_thrust", "lever", "axis")
    seen, now = make_condition(model), make_condition(replace(model, vehicle=moved))
    assert not all(torch.equal(getattr(seen, name), getattr(now, name)) for name in names)


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda answers: pickle.loads(pickle.dumps(answers))])
def test_answers_can_be_copied(copied: Callable[[EffectCache[Condition]], EffectCache[Condition]]) -> None:
    answers, law, condition = EffectCache[Condition](), _Law(), make_condition(make_model({}))
    params = torch.full((ROWS, 1), 2.0, dtype=F64)
    result = answers.ask(law, condition, params)
    assert torch.equal(copied(answers).ask(law, condition, params), result)
