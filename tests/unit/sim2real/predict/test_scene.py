"""Ground, ceiling and another vehicle in predictions and rollouts, against closed forms in hover."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from aerial_gym.errors import CapabilityError, DataError
from aerial_gym.physics import BACKENDS, EFFECTS, build_model, vehicle_from_config
from aerial_gym.sim2real import LogMapping, find_mapping, judge_flights, read_flight_log
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.flight_replay import replay_flights
from aerial_gym.sim2real.logs.flights import Flight
from aerial_gym.sim2real.predict.model_params import ModelParams
from aerial_gym.sim2real.predict.scene import finding_on_absent_data
from tests.physics.vehicles import SpeedControl
from tests.unit.sim2real.flat_flights import ROBOT, flight, make_predictor, write
from tests.unit.sim2real.one_rollout import roll_out

RADIUS, HUB = 0.1, 0.01
NEAR = replace(ROBOT, rotor=replace(ROBOT.rotor, radius=RADIUS))
G, RATE = 9.81, 100.0


def hover(name: str, height: float, **more: object) -> Flight:
    """Return 4 s of level hover at a height of the body origin; the hubs are 1 cm above it."""
    rows = 400
    zeros = np.zeros((rows, 3))
    defaults = {
        "path": name, "rate": RATE, "time": np.arange(rows) / RATE, "position": zeros + np.array([0.0, 0.0, height]),
        "attitude": np.tile([0.0, 0.0, 0.0, 1.0], (rows, 1)), "lin_vel": zeros, "ang_vel": zeros, "gyro": True,
        "specific_force": zeros + np.array([0.0, 0.0, G]), "accelerometer": True,
        "rotor_speed": np.full((rows, 4), np.sqrt(0.6 * G / 4.0 / 1.2e-6)),
    }  # fmt: skip
    return Flight(name=name, **defaults | more)


def lift(flights: list[Flight], effect: str, params: list[float]) -> list[np.ndarray]:
    """Return the contribution of an effect to the specific force along z in each flight [m/s²]."""
    predictor = make_predictor(flights, NEAR)
    with_effect = predictor.predict(ModelParams(effects={effect: np.array(params)}))
    return [(more - own)[:, 2] for more, own in zip(with_effect, predictor.predict(ModelParams()), strict=True)]


def gain(k: float, distance: float) -> float:
    """Return ``1 / (1 - k (R / 4 h)²) - 1``."""
    return 1.0 / (1.0 - k * (RADIUS / 4.0 / distance) ** 2) - 1.0


def test_each_flight_has_its_own_ceiling_and_ground() -> None:
    flights = [hover("low", 1.0, ceiling_height=1.11, ground_height=0.81)]
    flights += [hover("high", 1.0, ceiling_height=1.31, ground_height=-5.0)]
    for effect, rooms in (("ceiling_effect", (0.1, 0.3)), ("ground_effect", (0.2, 6.01))):
        for result, room in zip(lift(flights, effect, [1.5]), rooms, strict=True):
            np.testing.assert_allclose(result, G * gain(1.5, room), rtol=1e-9, atol=1e-9)


def test_the_wake_of_another_vehicle_pushes_down_where_it_is_known() -> None:
    """-F exp(-d² / 2 s²) / m below it; nothing above it, nor in a gap of its log."""
    rows = np.arange(400)
    other = np.column_stack((np.full(400, 0.2), np.zeros(400), np.full(400, 3.0)))
    gap, under = other.copy(), other.copy()
    gap[200:] = np.nan
    under[:, 2] = 0.5
    flights = [hover(str(i), 1.0, other_position=path) for i, path in enumerate((other, gap, under))]
    full, half, none = lift(flights, "downwash", [0.6, 0.3])
    push = -0.6 * np.exp(-0.5 * (0.2 / 0.3) ** 2) / 0.6
    np.testing.assert_allclose(full, push, rtol=1e-9)
    np.testing.assert_allclose(none, 0.0, atol=1e-12)
    kept = np.linspace(rows[0], rows[-1], half.size)
    np.testing.assert_allclose(half[kept < 160], push, rtol=0.02)
    np.testing.assert_allclose(half[kept > 240], 0.0, atol=-0.02 * push)


@pytest.mark.parametrize("effect", ["ceiling_effect", "downwash"])
def test_a_rollout_feels_its_surroundings(effect: str) -> None:
    """From rest, to first order: z = a t² / 2 with the acceleration at the start; the second flight has another one."""
    other = np.column_stack((np.full(400, 0.2), np.zeros(400), np.full(400, 3.0)))
    far = other + np.array([9.0, 0.0, 0.0])
    flights = [hover("near", 1.0, ceiling_height=1.31, other_position=other)]
    flights += [hover("far", 1.0, ceiling_height=9.0, other_position=far)]
    params, acc = {
        "ceiling_effect": ([1.5], (G * gain(1.5, 0.3), G * gain(1.5, 7.99))),
        "downwash": ([0.6, 0.3], (-np.exp(-0.5 * (0.2 / 0.3) ** 2), 0.0)),
    }[effect]
    errors = roll_out(NEAR, flights, ModelParams(effects={effect: np.array(params)}), horizons=(0.1,))
    for place in (0, 1):
        moved = errors.position[errors.windows.flight == place, 0]
        np.testing.assert_allclose(moved, abs(acc[place]) * 0.1**2 / 2.0, rtol=0.02, atol=1e-12)


def test_what_the_logs_do_not_tell_is_said() -> None:
    flights = [hover("a", 1.0, ceiling_height=3.0), hover("b", 1.0)]
    needs = {name: EFFECTS.get(name).needs for name in ("ceiling_effect", "downwash")}
    assert finding_on_absent_data("ceiling_effect", needs["ceiling_effect"], flights[:1]) is None
    ceiling, other = (finding_on_absent_data(*need, flights) for need in needs.items())
    assert ceiling == Finding("logs_lack", "ceiling_effect", {"flights": "b", "need": "ceiling_height"})
    assert other == Finding("logs_lack", "downwash", {"flights": "all logs", "need": "other_position"})
    pair = [*flights, hover("c", 1.0, other_position=np.zeros((400, 3)))]
    assert finding_on_absent_data("downwash", needs["downwash"], pair) is None  # the others fly alone
    declares = replace(NEAR, effects={"ceiling_effect": {"k": 1.0}})
    message = "declares ceiling_effect, which these flights cannot show: b: without the height"
    with pytest.raises(DataError, match=message):
        replay_flights(declares, flights, bandwidth=10.0)
    with pytest.raises(DataError, match=message):
        judge_flights(declares, flights[:1], flights[1:])


def test_heights_are_read_as_one_number_a_flight(tmp_path: Path) -> None:
    table = flight(0, seconds=3.0, rate=100.0)
    plain = read_flight_log(write(table, tmp_path / "a.csv"))
    assert (plain.ground_height, plain.ceiling_height, plain.other_position) == (0.0, None, None)
    stated = write(table.assign(ceiling_z=12.5, ground_z=-0.5), tmp_path / "b.csv")
    log = read_flight_log(stated)
    assert (log.ground_height, log.ceiling_height) == (-0.5, 12.5)
    down = LogMapping(**{**vars(find_mapping("aerial_gym")), "world_frame": "ned"})
    log = read_flight_log(stated, mapping=down)
    assert (log.ground_height, log.ceiling_height) == (0.5, -12.5)
    with pytest.raises(DataError, match=r"ceiling_height varies from 0 to 2\.99 m, must be constant"):
        read_flight_log(write(table.assign(ceiling_z=table["t"]), tmp_path / "c.csv"))


def test_gaps_in_the_place_of_another_vehicle_stay_gaps(tmp_path: Path) -> None:
    table = flight(0, seconds=3.0, rate=100.0).assign(other_p_x=1.0, other_p_y=2.0, other_p_z=3.0)
    table.loc[50:79, ["other_p_x", "other_p_y", "other_p_z"]] = np.nan
    log = read_flight_log(write(table, tmp_path / "a.csv"))
    assert np.isnan(log.other_position).any(axis=1).sum() == 30
    np.testing.assert_array_equal(log.other_position[80], (1.0, 2.0, 3.0))


def test_the_warp_backend_takes_one_height_of_the_ceiling_only() -> None:
    vehicle = vehicle_from_config(ROBOT, num_envs=2)
    model = build_model(vehicle, ceiling_height=torch.ones(2, 1))
    with pytest.raises(CapabilityError, match="one height of the ceiling for all"):
        BACKENDS.get("warp")().allocate(model, SpeedControl(), integrator="rk4")
