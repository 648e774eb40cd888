"""Cells of a plan: signs, sizes and neighbours of effects, and what cannot be flown."""

from dataclasses import replace
from pathlib import Path

import pytest

from aerial_gym.errors import ConfigError
from aerial_gym.physics import EFFECTS
from aerial_gym.rl_training.policy_task import PolicyTask
from aerial_gym.rl_training.robustness.cell import Plan
from aerial_gym.rl_training.robustness.plan import make_plan

HOVER = PolicyTask(
    name="position_setpoint_task", robot=None, controller=None, encoder=None, backend=None, level=None, settings=(),
    device="cpu", seed=3,
)  # fmt: skip


RANGES = """summary: quadrotor whose centre of mass is uncertain
extends: base_quadrotor
effects: {{com_offset: {{x: {mean}, y: 0.0, z: 0.0}}}}
effects_source: test
randomize:
  effects.com_offset.x: {{how: value, distribution: normal, mean: {mean}, std: {std}, low: -0.1, high: 0.1}}
"""


@pytest.fixture(scope="module")
def plan() -> Plan:
    return make_plan(HOVER)


def variant_values(plan: Plan, name: str) -> list[dict[tuple[str, str], float]]:
    (cell,) = (cell for group in plan.groups for cell in group.cells if cell.name == name)
    return [dict(variant.values) for variant in cell.variants]


def test_an_effect_has_cells_of_half_one_and_two_scales_in_both_directions(plan: Plan) -> None:
    scale = EFFECTS.get("com_offset").parameters[0].scale
    for name, size in (("small", 0.5), ("moderate", 1.0), ("large", 2.0)):
        signed = [{("com_offset", axis): sign * size * scale} for axis in "xyz" for sign in (1.0, -1.0)]
        assert variant_values(plan, f"com_offset/{name}") == signed


def test_a_weak_rotor_is_each_rotor_in_turn(plan: Plan) -> None:
    expected = [{("weak_motor", "motor"): float(n), ("weak_motor", "scale"): 0.8} for n in (1, 2, 3, 4)]
    assert variant_values(plan, "weak_rotor/20%") == [pytest.approx(each) for each in expected]


def test_a_parameter_stays_within_its_bounds(plan: Plan) -> None:
    assert {value > 0.0 for values in variant_values(plan, "rotor_drag/large") for value in values.values()} == {True}


def test_a_shape_that_changes_nothing_alone_is_no_variant(plan: Plan) -> None:
    """A correlation time without gusts, or the damping of a load without mass, leaves the vehicle as it is."""
    parameters = {
        name for values in variant_values(plan, "gusts/large") for effect, name in values if effect == "gusts"
    }
    assert parameters == {"std"}
    assert {name for values in variant_values(plan, "slung_payload/large") for _, name in values} == {"mass"}


def test_wind_acts_through_drag_on_a_robot_without_drag(plan: Plan) -> None:
    assert all(values["rotor_drag", "dx"] > 0.0 for values in variant_values(plan, "constant_wind/small"))
    with_drag = make_plan(replace(HOVER, robot="base_quadrotor_with_drag"))
    assert all(("rotor_drag", "dx") not in values for values in variant_values(with_drag, "constant_wind/small"))


def test_effects_that_overwrite_each_other_are_on_different_vehicles(plan: Plan) -> None:
    """At its neutral values each lag effect sets the declared lag, and a vehicle carries one load."""
    for pair in ({"motor_time_constant", "motor_asymmetry"}, {"slung_payload", "slung_payload_rod"}):
        together = [group for group in plan.groups if pair <= {cell.subject for cell in group.cells}]
        assert not together
    assert sum(group.compared for group in plan.groups) == 2


def test_names_are_unique_and_effects_not_flown_have_a_reason(plan: Plan) -> None:
    names = [cell.name for group in plan.groups for cell in group.cells]
    assert len(set(names)) == len(names) == plan.num_conditions + 1
    flown = {cell.subject for group in plan.groups for cell in group.cells}
    assert {*plan.not_flown, *(flown & {*EFFECTS})} == {*EFFECTS}
    assert all(plan.not_flown.values())


def test_another_rate_keeps_the_times_of_the_task(plan: Plan) -> None:
    settings = {group.cells[0].name: dict(text.split("=") for text in group.settings) for group in plan.groups}
    for rate, substeps, dt in ((50, 2, 0.01), (250, 1, 0.004), (500, 1, 0.002)):
        changed = settings[f"rate/{rate} Hz"]
        assert float(changed["sim.dt"]) == pytest.approx(dt)
        assert int(changed["env.physics_steps_per_env_step"]) == substeps
        assert int(changed["task.episode_len_steps"]) == 5 * rate


def test_intervals_of_a_robot_file_become_cells(tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(RANGES.format(mean=0.005, std=0.001))
    plan = make_plan(HOVER, quick=True, ranges=file)
    for end, value in (("low", 0.00304), ("high", 0.00696)):
        (values,) = variant_values(plan, f"ranges/com_offset.x/{end}")
        assert values["com_offset", "x"] == pytest.approx(value)
    file.write_text("summary: plain\nextends: base_quadrotor\n")
    with pytest.raises(ConfigError, match="close-loop --ranges"):
        make_plan(HOVER, ranges=file)
