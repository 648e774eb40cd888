"""Each effect against a closed form, with a sign; and what every effect must state. The vehicle is tinyprop where
nothing else is said: 0.373 kg, rotors at (+-0.16, +-0.16, 0) m in the plane of the centre of mass, thrust along z.
Rotors 1 to 4 are at (+,-), (-,-), (-,+), (+,+) and spin +, -, +, -."""

from dataclasses import replace
from math import cos, exp, pi, sin
from typing import Any

import pytest
import torch

from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import ConfigError, DataError, ShapeError, UnknownNameError
from aerial_gym.math.quaternion import quat_from_euler, quat_rotate
from aerial_gym.physics import (
    EFFECTS,
    INTEGRATORS,
    BodyState,
    accelerations,
    advance,
    build_model,
    condition_in,
    vehicle_from_config,
)
from aerial_gym.physics.effects.base import RotorSpeedsOfFlight
from aerial_gym.physics.model import Model, check_effects
from aerial_gym.robots import ROBOTS
from tests.physics.vehicles import (
    BATTERY,
    CEILING,
    F64,
    ON_RIGID,
    SpeedControl,
    asymmetric_robot,
    make_effects,
    random_state,
    rest_state,
)
from tests.refusals import assert_refused

MASS, ARM, SPEED, RADIUS = 0.373, 0.16, 1600.0, 0.04
INERTIA = (1.0e-3, 2.0e-3, 2.5e-3)


def plain_robot() -> RobotCfg:
    """Return tinyprop with a diagonal inertia and a known propeller."""
    robot = ROBOTS.get("tinyprop")
    rows = tuple(tuple(INERTIA[i] if i == j else 0.0 for j in range(3)) for i in range(3))
    rotor = replace(robot.rotor, radius=RADIUS)
    return replace(robot, body=replace(robot.body, inertia=rows), rotor=rotor, battery=BATTERY)


ROBOT = plain_robot()
THRUST = ROBOT.rotor.thrust_map[2] * SPEED**2
DRAG = 0.01 * THRUST


def make_model(values: dict[str, dict[str, float]], num_envs: int = 1, **options: float) -> Model:
    vehicle = vehicle_from_config(ROBOT, num_envs=num_envs, dtype=F64)
    return build_model(vehicle, make_effects(values, num_envs), **{"ceiling_height": CEILING, **options})


def effect_wrench(values: dict[str, dict[str, float]], state: BodyState, **options: float) -> torch.Tensor:
    result = []
    for model in (make_model(values, **options), make_model({}, **options)):
        felt = accelerations(model, state)
        w = state.ang_vel
        inertia = model.vehicle.inertia[0]
        torque = inertia @ felt.ang_acc[0] + torch.linalg.cross(w[0], inertia @ w[0])
        result.append(torch.cat((felt.specific_force[0] * model.vehicle.mass[0], torque)))
    return result[0] - result[1]


def assert_wrench(results: torch.Tensor, expected: list[float], size: float = 1.0) -> None:
    torch.testing.assert_close(results, torch.tensor(expected, dtype=F64), atol=1e-11 * size, rtol=1e-9)


def hover_state(**changes: list[float]) -> BodyState:
    return rest_state(**{"rotor_speed": [SPEED] * 4, **changes})


DRAG_XYZ = {"rotor_drag": {"dx": 0.3, "dy": 0.2, "dz": 0.1}}
FLAPPING = {"h_force_flapping": {"kh": 1e-5, "kf": 2e-6}}
TILTS = (sin(0.1) * THRUST, (cos(0.1) - 1.0) * THRUST, (cos(0.1) - 1.0) * DRAG)
"""What a tilt of 0.1 rad makes of a thrust across and along z, and of a drag torque."""

LOWER, UPPER = ((RADIUS / (4.0 * (0.1 + y * sin(0.2)))) ** 2 for y in (-ARM, ARM))


def roll_and_yaw(roll: float, yaw: float) -> list[float]:
    return quat_from_euler(torch.tensor([roll, 0.0, yaw], dtype=F64)).tolist()


WRENCHES: list[tuple[dict[str, dict[str, float]], dict[str, Any], list[float]]] = [
    # Yawed by 90 degrees, a velocity along world x is along body -y
    (DRAG_XYZ, {"attitude": roll_and_yaw(0.0, pi / 2), "lin_vel": [1.0, 0.0, 0.0]}, [0.0, 0.2, 0.0, 0.0, 0.0, 0.0]),
    # -d |v| v with v = (3, 4, 0)
    ({"quadratic_drag": {"dx": 0.01, "dy": 0.02, "dz": 0.05}}, {"lin_vel": [3.0, 4.0, 0.0]}, [-0.15, -0.4, 0, 0, 0, 0]),
    # -d |v_i| v_i of each axis
    (
        {"quadratic_drag_of_axes": {"dx": 0.01, "dy": 0.02, "dz": 0.05}},
        {"lin_vel": [3.0, -4.0, 2.0]},
        [-0.09, 0.32, -0.2, 0, 0, 0],
    ),
    # -d v, and -k (T / m g) v across the axes of the rotors, here with T = 4 THRUST
    (
        {"rotor_drag_of_thrust": {"dx": 0.3, "dy": 0.2, "dz": 0.1, "k": 0.5}},
        {"lin_vel": [1.0, -2.0, 3.0]},
        [-0.3 - 0.5 * 4 * THRUST / (MASS * 9.81), 0.4 + 4 * THRUST / (MASS * 9.81), -0.3, 0.0, 0.0, 0.0],
    ),
    # Wind drags a body at rest, and not one that moves with it
    (DRAG_XYZ | {"constant_wind": {"x": 2.0, "y": -1.0, "z": 0.5}}, {}, [0.6, -0.2, 0.05, 0.0, 0.0, 0.0]),
    (DRAG_XYZ | {"constant_wind": {"x": 2.0, "y": -1.0, "z": 0.5}}, {"lin_vel": [2.0, -1.0, 0.5]}, [0.0] * 6),
    *(  # At four times the height of reference the wind is twice as strong; below the ground there is none
        (
            DRAG_XYZ | {"wind_shear": {"x": 2.0, "y": -1.0, "z_ref": 2.0, "exponent": 0.5}},
            {"position": [0.0, 0.0, height]},
            [gain * 0.6, gain * -0.2, 0.0, 0.0, 0.0, 0.0],
        )
        for height, gain in ((2.0, 1.0), (8.0, 2.0), (-1.0, 0.0))
    ),
    # Forward the hub force holds back and the hub moment lifts the nose, which is negative about y
    (FLAPPING, {"lin_vel": [3.0, 0, 0]}, [-1e-5 * 4 * SPEED * 3, 0, 0, 0, -2e-6 * 4 * SPEED * 3, 0]),
    (FLAPPING, {"lin_vel": [0, 3.0, 0]}, [0, -1e-5 * 4 * SPEED * 3, 0, 2e-6 * 4 * SPEED * 3, 0, 0]),
    (FLAPPING, {"lin_vel": [0, 0, 3.0]}, [0.0] * 6),
    # Hubs move by r_z x l: tau_z = -kh sum(w) (x² + y²) r
    (FLAPPING, {"ang_vel": [0, 0, 2.0]}, [0, 0, 0, 0, 0, -1e-5 * 4 * SPEED * 2 * ARM**2 * 2]),
    ({"axial_inflow": {"ka": 2e-5}}, {"lin_vel": [1.0, -1.0, 3.0]}, [0, 0, -2e-5 * 4 * SPEED * 3, 0, 0, 0]),
    ({"axial_inflow": {"ka": 2e-5}}, {"ang_vel": [2.0, 0, 0]}, [0, 0, 0, -2e-5 * 4 * SPEED * ARM**2 * 2, 0, 0]),
    ({"translational_lift": {"kt": 0.005}}, {"lin_vel": [-3.0, -4.0, 2.0]}, [0, 0, 4 * 0.005 * 25, 0, 0, 0]),
    # Rotors 1 and 3 have spin +1: their drag turns the body negatively
    ({"torque_ratio": {"scale": 1.3}}, {"rotor_speed": [SPEED, 0, SPEED, 0]}, [0, 0, 0, 0, 0, -0.3 * 2 * DRAG]),
    # Rotors 3 and 4 are on the left: longer levers roll right, and the yaw moment stays
    ({"arm_length": {"scale": 1.2}}, {"rotor_speed": [0, 0, SPEED, SPEED]}, [0, 0, 0, 0.2 * 2 * ARM * THRUST, 0, 0]),
    (
        {"thrust_coefficient": {"scale": 1.05}},
        {"rotor_speed": [SPEED, 0, SPEED, 0]},
        [0.0, 0.0, 0.05 * 2 * THRUST, 0.0, 0.0, -0.05 * 2 * DRAG],
    ),
    # Rotor 2 is at (-x, -y), of spin -1
    (
        {"weak_motor": {"motor": 2, "scale": 0.8}},
        {},
        [0.0, 0.0, -0.2 * THRUST, ARM * 0.2 * THRUST, -ARM * 0.2 * THRUST, -0.2 * DRAG],
    ),
    # Roll about x turns the thrust towards -y, pitch about y towards +x; rotor 4 is at (+x, +y), its drag is +z
    (
        {"motor_tilt": {"motor": 4, "roll": 0.1, "pitch": 0.0}},
        {},
        [0.0, -TILTS[0], TILTS[1], ARM * TILTS[1], -ARM * TILTS[1] - DRAG * sin(0.1), -ARM * TILTS[0] + TILTS[2]],
    ),
    (
        {"motor_tilt": {"motor": 4, "roll": 0.0, "pitch": 0.1}},
        {},
        [TILTS[0], 0.0, TILTS[1], ARM * TILTS[1] + DRAG * sin(0.1), -ARM * TILTS[1], -ARM * TILTS[0] + TILTS[2]],
    ),
    # Cheeseman and Bennett: one radius above the ground 1 / (1 - 1/16); it stops growing at half a radius
    ({"ground_effect": {"k": 1.0}}, {"position": [0, 0, RADIUS]}, [0, 0, 4 * THRUST / 15, 0, 0, 0]),
    ({"ground_effect": {"k": 1.0}}, {"position": [0, 0, 0.5 * RADIUS]}, [0, 0, 4 * THRUST / 3, 0, 0, 0]),
    ({"ground_effect": {"k": 1.0}}, {"position": [0, 0, -0.1]}, [0, 0, 4 * THRUST / 3, 0, 0, 0]),
    # k (R / 4 h)² = 1.875 is past its pole: the thrust doubles at most
    ({"ground_effect": {"k": 30.0}}, {"position": [0, 0, RADIUS]}, [0, 0, 4 * THRUST, 0, 0, 0]),
    # Rolled by +a the side at -y is lower: more thrust there rights it
    (
        {"ground_effect": {"k": 1.0}},
        {"position": [0.0, 0.0, 0.1], "attitude": roll_and_yaw(0.2, 0.0)},
        [
            0.0, 0.0, 2 * THRUST * (LOWER / (1 - LOWER) + UPPER / (1 - UPPER)),
            2 * THRUST * ARM * (UPPER / (1 - UPPER) - LOWER / (1 - LOWER)), 0.0, 0.0,
        ],
    ),
    ({"ground_effect": {"k": 1.0}}, {"position": [0, 0, 2 + RADIUS], "ground_height": 2.0}, [0, 0, 4 * THRUST / 15, 0, 0, 0]),
    *(  # The same law of a ceiling, of the room above; not closer than half a radius, and the same above it
        (
            {"ceiling_effect": {"k": 1.0}},
            {"position": [0, 0, 2.0], "ceiling_height": 2.0 + room},
            [0, 0, 4 * THRUST / (16 * (felt / RADIUS) ** 2 - 1), 0, 0, 0],
        )
        for room, felt in ((3.0 * RADIUS, 3.0 * RADIUS), (RADIUS, RADIUS), (0.4 * RADIUS, 0.5 * RADIUS), (-1.0, 0.5 * RADIUS))
    ),
    *(  # Parts of a curve: 1 at their peaks, 1/4 an octave away, (2 - x)³ / 4 in between; a loss; constant below half a radius
        (
            {f"{name}_curve": {f"g{one}": float(size == one) * change for one in (1, 2, 4, 8)}},
            {"position": [0, 0, height], "ceiling_height": height + room},
            [0, 0, 4 * THRUST * change * share, 0, 0, 0],
        )
        for size, change, distance, share in (
            (4, 0.2, 4.0, 1.0), (4, -0.3, 8.0, 0.25), (4, 0.2, 4.0 * 2**1.5, 0.125 / 4), (2, 0.2, 8.0, 0.0), (1, 0.4, 0.1, 0.25)
        )
        for name, height, room in (
            ("ground_effect", distance * RADIUS, 50.0), ("ceiling_effect", 50.0, distance * RADIUS)
        )
    ),
    *(  # 2 N right below the other vehicle, a Gaussian of 0.3 m beside, none above; along world z, at the centre of mass
        (
            {"downwash": {"force": 2.0, "sigma": 0.3}},
            {"position": place, "attitude": roll_and_yaw(0.4, 0.0), "other_position": torch.tensor([[1.0, -2.0, 3.0]])},
            [0.0, -2.0 * share * sin(0.4), -2.0 * share * cos(0.4), 0.0, 0.0, 0.0],
        )
        for place, share in (
            ([1.0, -2.0, 0.0], 1.0), ([1.3, -2.0, 0.0], exp(-0.5)), ([1.0, -2.6, 0.0], exp(-2.0)), ([1.0, -2.0, 3.1], 0.0)
        )
    ),
    *(  # A jet of 2 N at 1 m, a quarter of it and twice as wide at 2 m, not nearer than 0.3 m; a core with an edge of power 8
        (
            {f"downwash_{law}": {"force": 2.0, **numbers}},
            {"position": place, "other_position": torch.tensor([[1.0, -2.0, 3.0]])},
            [0.0, 0.0, -2.0 * share, 0.0, 0.0, 0.0],
        )
        for law, numbers, place, share in (
            ("jet", {"spread": 0.2}, [1.0, -2.0, 2.0], 1.0),
            ("jet", {"spread": 0.2}, [1.2, -2.0, 2.0], exp(-1.0)),
            ("jet", {"spread": 0.2}, [1.0, -1.6, 1.0], 0.25 * exp(-1.0)),
            ("jet", {"spread": 0.2}, [1.0, -2.0, 2.9], 0.3**-2),
            ("jet", {"spread": 0.2}, [1.0, -2.0, 3.1], 0.0),
            ("core", {"sigma": 0.3, "power": 8.0}, [1.15, -2.0, 0.0], exp(-0.5 * 0.5**8)),
            ("core", {"sigma": 0.3, "power": 8.0}, [1.0, -2.6, 0.0], exp(-0.5 * 2.0**8)),
        )
    ),
    # Without another vehicle the wake stands over the origin
    ({"downwash": {"force": 2.0, "sigma": 0.3}}, {"position": [0, 0, 1e3]}, [0, 0, -2.0, 0, 0, 0]),
]  # fmt: skip
"""Effects, what differs from hover at the origin without surroundings, and force [N] and torque [N m] of the effects, body."""


def test_a_thrust_curve_turns_about_hover() -> None:
    """In hover nothing, at four times that thrust, twice the speed, 2^k times the thrust, at a quarter 2^-k times."""
    effect = EFFECTS.get("thrust_curve")
    vehicle = vehicle_from_config(asymmetric_robot(), num_envs=3, dtype=F64)
    state = random_state(3)
    condition = condition_in(build_model(vehicle, []), state, torch.zeros(3, 4, dtype=F64))
    hover = float(vehicle.mass[0]) * 9.81 / 4
    thrust = hover * torch.tensor([1.0, 4.0, 0.25], dtype=F64)[:, None].expand(3, 4)
    result = effect.thrust(condition.with_thrust(thrust), torch.full((3, 1), 0.2, dtype=F64))
    expected = hover * torch.tensor([0.0, 4.0 * (2**0.2 - 1.0), 0.25 * (2**-0.2 - 1.0)], dtype=F64)[:, None].expand(
        3, 4
    )
    torch.testing.assert_close(result, expected, rtol=1e-6, atol=1e-8)


def test_a_torque_gain_is_an_inverse_inertia_but_for_gyroscopic_torques() -> None:
    """At rest w' = k tau / J as with J / k; in rotation the inertia alone changes the moment w x J w."""
    gains, at_rest = (1.3, 0.8, 1.1), random_state(8)
    at_rest = replace(at_rest, ang_vel=torch.zeros_like(at_rest.ang_vel))
    robot = replace(asymmetric_robot(com=(0.0, 0.0, 0.0)), effects={})
    vehicle = vehicle_from_config(robot, num_envs=8, dtype=F64)
    flat = torch.zeros_like(vehicle.rotor_axis) + torch.tensor([0.0, 0.0, 1.0], dtype=F64)
    diagonal = torch.diag_embed(vehicle.inertia.diagonal(dim1=-2, dim2=-1))
    vehicle = replace(vehicle, rotor_axis=flat, inertia=diagonal)

    def turn(name: str, values: tuple[float, ...], state: BodyState) -> torch.Tensor:
        own = dict(zip(("sx", "sy", "sz"), values, strict=True))
        return accelerations(build_model(vehicle, make_effects({name: own}, 8)), state).ang_acc

    inverse, plain = tuple(1.0 / gain for gain in gains), accelerations(build_model(vehicle, []), at_rest).ang_acc
    torch.testing.assert_close(turn("torque_gain", gains, at_rest), plain * torch.tensor(gains, dtype=F64))
    torch.testing.assert_close(turn("inertia_error", inverse, at_rest), plain * torch.tensor(gains, dtype=F64))
    moving = replace(at_rest, ang_vel=torch.tensor([[2.0, -3.0, 4.0]], dtype=F64).expand(8, 3))
    size, w = diagonal[0].diagonal(), moving.ang_vel[0]
    gyroscopic = -torch.linalg.cross(w, size * w) / size
    alone = turn("torque_gain", gains, moving) - turn("torque_gain", gains, at_rest)
    torch.testing.assert_close(alone, gyroscopic.expand(8, 3))


def test_thrust_follows_the_voltage_by_a_power() -> None:
    """At 81 % of the nominal voltage a power of 1/2 leaves 90 % of the thrust; in a flight the voltage is the logged one."""
    effect = EFFECTS.get("thrust_voltage")
    vehicle = replace(
        vehicle_from_config(asymmetric_robot(), num_envs=2, dtype=F64), battery=torch.full((2, 6), 16.0, dtype=F64)
    )
    condition = condition_in(build_model(vehicle, []), random_state(2), torch.zeros(2, 4, dtype=F64))
    voltage = torch.tensor([16.0, 12.96], dtype=F64)
    track = RotorSpeedsOfFlight(
        vehicle=vehicle, rotor_speed=torch.zeros(2, 4), step=0.01, voltage=voltage, begins_on_ground=False
    )
    params = torch.cat((torch.full((2, 1), 0.5, dtype=F64), effect.replay(track, torch.tensor([[0.5]]))), dim=-1)
    lost = torch.tensor([[0.0], [-0.1]], dtype=F64) * condition.rotor_thrust
    torch.testing.assert_close(effect.thrust(condition, params), lost, rtol=1e-12, atol=1e-12)
    with pytest.raises(DataError):
        effect.replay(replace(track, voltage=None), torch.tensor([[0.5]]))


@pytest.mark.parametrize(
    ("values", "changes", "expected"), WRENCHES, ids=lambda v: "+".join(v) if isinstance(v, dict) else ""
)
def test_wrenches_are_those_by_hand(
    values: dict[str, dict[str, float]], changes: dict[str, Any], expected: list[float]
) -> None:
    around = {key: changes[key] for key in ("ground_height", "ceiling_height", "other_position") if key in changes}
    state = hover_state(**{key: value for key, value in changes.items() if key not in around})
    assert_wrench(effect_wrench(values, state, **around), expected)


def test_quadratic_drag_has_a_finite_gradient_at_rest() -> None:
    velocity = torch.zeros(1, 3, dtype=F64, requires_grad=True)
    model = make_model({"quadratic_drag": {"dx": 0.01, "dy": 0.02, "dz": 0.05}})
    accelerations(model, replace(rest_state(), lin_vel=velocity)).specific_force.sum().backward()
    assert torch.isfinite(velocity.grad).all()


def test_com_offset_is_the_same_as_a_vehicle_declared_with_that_centre() -> None:
    state = random_state(16)
    offset = {"com_offset": {"x": 0.01, "y": -0.02, "z": 0.03}}
    shifted = build_model(
        vehicle_from_config(asymmetric_robot(com=(0.0, 0.0, 0.0)), num_envs=16, dtype=F64), make_effects(offset, 16)
    )
    declared = build_model(vehicle_from_config(asymmetric_robot(), num_envs=16, dtype=F64))
    a, b = accelerations(shifted, state), accelerations(declared, state)
    torch.testing.assert_close(a.specific_force, b.specific_force, atol=1e-12, rtol=1e-12)
    torch.testing.assert_close(a.ang_acc, b.ang_acc, atol=1e-10, rtol=1e-12)


@pytest.mark.parametrize(("dm", "left"), [(0.1, MASS + 0.1), (-0.1, MASS - 0.1), (-5.0, 0.4 * MASS)])
def test_a_payload_changes_the_specific_force_and_leaves_four_tenths_at_least(dm: float, left: float) -> None:
    result = accelerations(make_model({"payload_mass": {"dm": dm}}), hover_state())
    assert_wrench(result.specific_force[0], [0.0, 0.0, 4 * THRUST / left])
    assert_wrench(result.ang_acc[0], [0.0, 0.0, 0.0], size=1e3)


@pytest.mark.parametrize(("axis", "speeds", "torque"), [
    (0, [0.0, 0.0, SPEED, SPEED], 2 * ARM * THRUST),
    (1, [0.0, SPEED, SPEED, 0.0], 2 * ARM * THRUST),
    (2, [0.0, SPEED, 0.0, SPEED], 2 * DRAG),
])  # fmt: skip
def test_an_inertia_error_divides_each_angular_acceleration(axis: int, speeds: list[float], torque: float) -> None:
    scale = (1.5, 0.8, 1.2)
    model = make_model({"inertia_error": dict(zip(("sx", "sy", "sz"), scale, strict=True))})
    result = accelerations(model, rest_state(rotor_speed=speeds)).ang_acc[0]
    expected = torch.zeros(3, dtype=F64)
    expected[axis] = torque / (INERTIA[axis] * scale[axis])
    torch.testing.assert_close(result, expected, rtol=1e-9, atol=1e-9)


def test_an_inertia_error_keeps_the_inertia_positive_definite() -> None:
    vehicle = vehicle_from_config(asymmetric_robot(), num_envs=1, dtype=F64)
    values = {"inertia_error": {"sx": 0.1, "sy": 10.0, "sz": 0.1}}
    inertia = build_model(vehicle, make_effects(values, 1)).vehicle.inertia[0]
    assert torch.linalg.eigvalsh(inertia).min() > 0
    torch.testing.assert_close(
        inertia.diagonal(), vehicle.inertia[0].diagonal() * torch.tensor([0.1, 10.0, 0.1]).to(F64)
    )


def test_products_of_inertia_turn_the_principal_axes() -> None:
    """A torque about x also turns y: J_yy w_y' = -J_xy w_x', with J_xy = p sqrt(J_xx J_yy); the largest p stay a body."""
    speeds, (xx, yy, _), p = [0.0, 0.0, SPEED, SPEED], INERTIA, 0.3
    values = {"products_of_inertia": {"xy": p, "xz": 0.0, "yz": 0.0}}
    result = accelerations(make_model(values), rest_state(rotor_speed=speeds)).ang_acc[0]
    roll = 2 * ARM * THRUST / (xx * (1.0 - p**2))
    assert_wrench(result, [roll, -p * (xx / yy) ** 0.5 * roll, 0.0], size=1e3)
    extreme = make_model({"products_of_inertia": {"xy": 0.45, "xz": 0.45, "yz": -0.45}})
    assert torch.linalg.eigvalsh(extreme.vehicle.inertia[0]).min() > 0.0


@pytest.mark.parametrize(
    ("values", "taus"),
    [
        ({"motor_asymmetry": {"tau_up": 0.02, "tau_down": 0.08}}, (0.02, 0.08)),
        ({"motor_time_constant": {"tau": 0.05}}, (0.05, 0.05)),
    ],
)
def test_rotors_lag_by_their_direction(values: dict[str, dict[str, float]], taus: tuple[float, float]) -> None:
    for (start, end), tau in zip(((500.0, 1500.0), (1500.0, 500.0)), taus, strict=True):
        state, command = rest_state(rotor_speed=[start] * 4), torch.full((1, 4), end, dtype=F64)
        after = advance(make_model(values), INTEGRATORS["rk4"], SpeedControl(), state, command, 0.01, 4)
        assert_wrench(after.rotor_speed[0], [end + (start - end) * exp(-0.04 / tau)] * 4, size=1e3)


def test_a_command_curve_has_an_idle_speed_and_an_exponent() -> None:
    """``491 + 3564 (c / 4000)^0.71``; a command of 0 stops the rotor, and no curve turns it backwards."""
    params = torch.tensor([[491.0 / 4000.0, 3564.0 / 4000.0, 0.71, 4000.0], [-0.5, 1.0, 1.0, 4000.0]], dtype=F64)
    command = torch.tensor([0.0, 400.0, 2000.0, 4000.0], dtype=F64).expand(2, 4)
    speed = EFFECTS.get("command_curve").command(command, make_model({}, 2).vehicle, params)
    expected = [0.0, *(491.0 + 3564.0 * share**0.71 for share in (0.1, 0.5, 1.0))]
    torch.testing.assert_close(speed, torch.tensor([expected, [0.0, 0.0, 0.0, 2000.0]], dtype=F64))


def test_a_start_of_fits_is_near_any_wake() -> None:
    """On a pass over the middle, one of the starts correlates by 0.91 or more with every width from 3 cm to 1 m."""
    wake, square = EFFECTS.get("downwash"), torch.linspace(-8.0, 8.0, 4001, dtype=torch.float64).square()
    widths = torch.tensor(
        [width for _, width in wake.starts(ROBOTS.get("tinyprop"))] + [0.03 * 1.1**k for k in range(37)]
    )
    forces = torch.stack([wake.share(square, square, torch.tensor([[1.0, float(width)]])) for width in widths])
    forces = forces / forces.norm(dim=1, keepdim=True)
    assert float((forces[4:] @ forces[:4].T).max(dim=1).values.min()) > 0.91


def test_ground_effect_asks_for_the_radius() -> None:
    robot = replace(ROBOTS.get("tinyprop"), effects={"ground_effect": {"k": 1.0}})
    robot = replace(robot, rotor=replace(robot.rotor, radius=None))
    assert_refused(ConfigError, r"ground_effect: the robot file must give rotor.radius", check_effects, robot)


@pytest.mark.parametrize("motor", [0, 5, 1.5])
def test_a_rotor_that_is_not_there_is_refused(motor: float) -> None:
    robot = replace(ROBOTS.get("tinyprop"), effects={"weak_motor": {"motor": motor, "scale": 0.9}})
    assert_refused(ConfigError, r"weak_motor.motor = ", check_effects, robot)


def momentum(model: Model, state: BodyState, jr: float) -> torch.Tensor:
    """Return the angular momentum of body and rotors, world, (E, 3)."""
    axis = model.vehicle.rotor_spin.unsqueeze(-1) * model.vehicle.rotor_axis
    own = (model.vehicle.inertia @ state.ang_vel.unsqueeze(-1)).squeeze(-1)
    return quat_rotate(state.attitude, own + jr * (state.rotor_speed.unsqueeze(-1) * axis).sum(1))


@pytest.mark.parametrize(("integrator", "order"), [("euler", 1.0), ("rk4", 4.0)])
def test_rotor_inertia_conserves_angular_momentum(integrator: str, order: float) -> None:
    """Rotors without thrust and drag that change speed in a tumbling body: the error falls with the method's order."""
    jr, robot = 2e-6, asymmetric_robot()
    still_air = replace(
        robot.rotor, thrust_map=(0.0, 0.0, 1e-30), torque_map=(0.0, 0.0, 0.0), thrust_range=(0.0, 1e-24)
    )
    vehicle = vehicle_from_config(replace(robot, rotor=still_air), num_envs=8, dtype=F64)
    model = build_model(vehicle, make_effects({"rotor_inertia": {"jr": jr}}, 8), gravity=0.0)
    start = random_state(8)
    command = start.rotor_speed * torch.tensor([1.5, 0.4, 1.2, 0.8], dtype=F64)
    errors = []
    for steps in (32, 64):
        end = advance(model, INTEGRATORS[integrator], SpeedControl(), start, command, 0.2 / steps, steps)
        errors.append(float((momentum(model, end, jr) - momentum(model, start, jr)).norm(dim=1).max()))
    assert 0.75 * 2**order < errors[0] / errors[1] < 1.5 * 2**order
    assert errors[1] < 1e-2 * float(momentum(model, start, jr).norm(dim=1).max())


def test_a_rotor_without_lag_reacts_over_one_step() -> None:
    model = make_model({"rotor_inertia": {"jr": 1e-6}})
    zero = torch.zeros_like(model.vehicle.time_constant_up)
    vehicle = replace(
        model.vehicle, time_constant_up=zero, time_constant_down=zero, torque_map=0.0 * model.vehicle.torque_map
    )
    command = torch.tensor([[SPEED + 100.0, SPEED, SPEED + 100.0, SPEED]], dtype=F64)
    for integrator in ("euler", "rk4"):
        end = advance(
            replace(model, vehicle=vehicle), INTEGRATORS[integrator], SpeedControl(), hover_state(), command, 0.01, 1
        )
        assert_wrench(end.ang_vel[0, 2:], [-200.0 * 1e-6 / INERTIA[2]])


def test_imu_bias_adds_to_both_sensors() -> None:
    effect = EFFECTS.get("imu_bias")
    params = torch.tensor([[0.1, -0.2, 0.3, 0.01, -0.02, 0.03]], dtype=F64)
    force, rate = effect.measure(torch.tensor([[1.0, 2.0, 9.81]], dtype=F64), torch.zeros(1, 3, dtype=F64), params)
    assert_wrench(force[0], [1.1, 1.8, 10.11])
    assert_wrench(rate[0], [0.01, -0.02, 0.03])


def test_an_imu_that_is_rolled_left_side_up_feels_gravity_on_its_y() -> None:
    """Sensors rolled by +a: their y axis points up by sin a, and so reads +g sin a at rest; yawed by +90°, x is body y."""
    effect, rest = EFFECTS.get("imu_misalignment"), torch.tensor([[0.0, 0.0, 9.81]], dtype=F64)
    force, _ = effect.measure(rest, rest, torch.tensor([[0.1, 0.0, 0.0]], dtype=F64))
    assert_wrench(force[0], [0.0, 9.81 * sin(0.1), 9.81 * cos(0.1)])
    force, rate = effect.measure(
        rest, torch.tensor([[1.0, 2.0, 3.0]], dtype=F64), torch.tensor([[0.0, 0.1, 0.0]], dtype=F64)
    )
    assert_wrench(force[0], [-9.81 * sin(0.1), 0.0, 9.81 * cos(0.1)])
    assert_wrench(rate[0], [cos(0.1) - 3 * sin(0.1), 2.0, sin(0.1) + 3 * cos(0.1)])
    _, rate = effect.measure(
        rest, torch.tensor([[0.0, 1.0, 0.0]], dtype=F64), torch.tensor([[0.0, 0.0, 0.5]], dtype=F64)
    )
    assert_wrench(rate[0], [sin(0.5), cos(0.5), 0.0])


def test_a_rotor_speed_scale_is_undone() -> None:
    effect, speed = EFFECTS.get("rotor_speed_scale"), torch.tensor([[100.0, 200.0]], dtype=F64)
    params = torch.tensor([[7.0]], dtype=F64)
    assert_wrench(effect.measure(speed, params)[0], [700.0, 1400.0], size=1e3)
    assert_wrench(effect.true_speed(effect.measure(speed, params), params)[0], [100.0, 200.0], size=1e3)


def test_a_tachometer_scale_is_undone_on_its_rotor_alone() -> None:
    effect, speed = EFFECTS.get("tachometer_scale"), torch.tensor([[100.0, 200.0, 300.0]], dtype=F64).expand(2, 3)
    params = torch.tensor([[2.0, 1.1], [3.0, 0.5]], dtype=F64)
    read = effect.measure(speed, params)
    torch.testing.assert_close(read, torch.tensor([[100.0, 220.0, 300.0], [100.0, 200.0, 150.0]], dtype=F64))
    torch.testing.assert_close(effect.true_speed(read, params), speed)


def test_a_motor_gain_scales_the_command_of_its_rotor_alone() -> None:
    params, command = torch.tensor([[3.0, 0.9, 0.0]], dtype=F64), torch.full((1, 4), 1000.0, dtype=F64)
    speed = EFFECTS.get("motor_gain").command(command, make_model({}, 1).vehicle, params)
    assert_wrench(speed[0], [1000.0, 1000.0, 900.0, 1000.0], size=1e3)


def test_a_motor_tilt_is_a_rotation_of_any_axis() -> None:
    """R = R_y(pitch) R_x(roll), as the quaternion of these Euler angles turns it."""
    vehicle = vehicle_from_config(asymmetric_robot(), num_envs=1, dtype=F64)
    tilted = build_model(vehicle, make_effects({"motor_tilt": {"motor": 1, "roll": 0.3, "pitch": -0.4}}, 1)).vehicle
    turn = quat_from_euler(torch.tensor([[0.3, -0.4, 0.0]], dtype=F64))
    torch.testing.assert_close(tilted.rotor_axis[:, 0], quat_rotate(turn, vehicle.rotor_axis[:, 0]))
    torch.testing.assert_close(tilted.rotor_axis[:, 1:], vehicle.rotor_axis[:, 1:])


def test_effects_differ_between_environments() -> None:
    vehicle = vehicle_from_config(ROBOTS.get("tinyprop"), num_envs=2, dtype=F64)
    effect = EFFECTS.get("rotor_drag")
    params = torch.tensor([[0.1, 0.0, 0.0], [0.2, 0.0, 0.0]], dtype=F64)
    force = accelerations(build_model(vehicle, [(effect, params)]), rest_state(2, lin_vel=[1.0, 0, 0])).specific_force
    torch.testing.assert_close(force[:, 0] * 0.373, torch.tensor([-0.1, -0.2], dtype=F64))


@pytest.mark.parametrize("name", EFFECTS.names())
def test_every_effect_states_what_it_is(name: str) -> None:
    effect = EFFECTS.get(name)
    assert effect.name == name
    assert effect.summary
    assert effect.excitation
    neutral = effect.neutral(ROBOTS.get("tinyprop"))
    assert len(neutral) == len(effect.parameters)
    for value, parameter in zip(neutral, effect.parameters, strict=True):
        assert parameter.low <= value <= parameter.high
        assert parameter.unit
        assert parameter.scale > 0


@pytest.mark.parametrize("name", ON_RIGID)
def test_neutral_parameters_leave_a_symmetric_rotor_vehicle_as_declared(name: str) -> None:
    robot, state = ROBOT, random_state(16)
    effect = EFFECTS.get(name)
    values = dict(zip([p.name for p in effect.parameters], effect.neutral(robot), strict=True))
    with_effect, without = make_model({name: values}, 16), make_model({}, 16)
    command = state.rotor_speed * 1.1
    a, b = (advance(m, INTEGRATORS["rk4"], SpeedControl(), state, command, 0.01, 5) for m in (with_effect, without))
    for x, y in zip(a.tensors(), b.tensors(), strict=True):
        torch.testing.assert_close(x, y, atol=1e-12, rtol=1e-12)


def test_unknown_and_impossible_parameters_are_named() -> None:
    assert_refused(UnknownNameError, "Did you mean 'rotor_drag'", make_effects, {"rotor_drg": {}}, 1)
    with pytest.raises(ConfigError, match=r"rotor_drag: parameters \['dx'\] given, needs exactly \['dx', 'dy', 'dz'\]"):
        make_effects({"rotor_drag": {"dx": 0.1}}, 1)
    with pytest.raises(ConfigError, match=r"rotor_drag.dx = -1.0: must lie in \[0, 10\] N s/m"):
        make_effects({"rotor_drag": {"dx": -1.0, "dy": 0.0, "dz": 0.0}}, 1)
    with pytest.raises(ConfigError, match="nan"):
        make_effects({"rotor_drag": {"dx": float("nan"), "dy": 0.0, "dz": 0.0}}, 1)
    vehicle = vehicle_from_config(ROBOTS.get("tinyprop"), num_envs=1, dtype=F64)
    with pytest.raises(ShapeError, match=r"shape \(2, 3\), expected \(1, 3\)"):
        build_model(vehicle, [(EFFECTS.get("rotor_drag"), torch.zeros(2, 3, dtype=F64))])
