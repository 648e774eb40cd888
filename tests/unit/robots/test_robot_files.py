"""Robot files that come with the package: sources of their numbers, where vehicles hover, and which way rotors turn them."""

from dataclasses import replace
from math import cos, pi, sin
from pathlib import Path

import numpy as np
import pytest
import torch

from aerial_gym.config import CONFIG_DIR
from aerial_gym.config.robot import RobotCfg
from aerial_gym.config.sim import STANDARD_GRAVITY
from aerial_gym.control.allocation import allocation_matrix
from aerial_gym.errors import CapabilityError, ConfigError
from aerial_gym.physics import rotor_state_for_thrust, vehicle_from_config
from aerial_gym.physics.model import check_effects, effects_on_rigid, robot_effects
from aerial_gym.physics.rotors import rotor_thrust
from aerial_gym.robots import ROBOTS
from aerial_gym.robots.catalog import robot_by_name
from aerial_gym.robots.tune import tune_robot
from aerial_gym.sim2real.identify.selection.select import select_effects
from aerial_gym.sim2real.judge.analysis import correct_robot, untestable_effects
from aerial_gym.sim2real.predict.model_params import params_from_robot
from tests.builders import simulation
from tests.refusals import assert_refused
from tests.unit.sim2real.judge.builders import make_excess, make_setup
from tests.unit.sim2real.predict.test_scene import hover
from tests.unit.sim2real.set_fits import make_selection


def test_every_file_is_a_registered_robot_and_every_robot_has_a_file() -> None:
    files = list((CONFIG_DIR / "robots").rglob("*.yaml"))
    assert sorted(file.stem for file in files) == sorted(ROBOTS)  # of each name one, in whichever room
    assert all(summary for summary in ROBOTS.summaries().values())


@pytest.mark.parametrize("robots", [["x500", "lmf2"], ("x500",), {"leader": "x500"}])
def test_several_robots_are_refused_with_the_alternative(robots: object) -> None:
    words = "robot_name = .*: there is one vehicle here; build_env"
    assert_refused(CapabilityError, words, simulation, robots)


def test_drags_are_those_of_the_sources_for_each_kilogram() -> None:
    """0.544 and 0.386 1/s times the mass; a spin of 0.5 kg on arms of 0.17 m braked by 2.75e-3 N m s/rad is -4 kh w l² r."""
    robot = ROBOTS.get("base_quadrotor_with_drag")
    drag, mass = robot.effects["rotor_drag"], robot.body.mass
    np.testing.assert_allclose((drag["dx"], drag["dy"]), (0.544 * mass, 0.386 * mass), rtol=1e-12)
    robot = ROBOTS.get("base_quadrotor_braked_in_spin")
    rotor = robot.the_rotor("a test")
    hover, kh = rotor_state_for_thrust(rotor, 0.25 * mass * STANDARD_GRAVITY), robot.effects["h_force_flapping"]["kh"]
    np.testing.assert_allclose(4.0 * kh * hover / mass, 2.75e-3 / (0.5 * 0.17**2), rtol=1e-12)


def test_speeds_and_offsets_are_those_of_the_sources() -> None:
    """PX4's x500 turns at 150 to 1000 rad/s; the ARPL flights tell offsets of 0.028 m."""
    rotor = ROBOTS.get("x500_px4").the_rotor("a test")
    speeds = [rotor_state_for_thrust(rotor, thrust) for thrust in rotor.thrust_range]
    np.testing.assert_allclose(speeds, (150.0, 1000.0), rtol=1e-9)
    robots = (ROBOTS.get(name) for name in ("crazyflie_2x_arpl", "crazyflie_21"))
    here, there = (np.array([mount.position for mount in robot.mounts.layout]) for robot in robots)
    np.testing.assert_allclose(here, 0.028 / 0.0325 * there, rtol=1e-12)


def test_arms_creep_as_identified_per_inertia_of_a_point_mass() -> None:
    joints, inertia = ROBOTS.get("morphy_creeping").joints, 0.01625 * 0.07**2
    springs = [joint.spring for joint in joints.layout if joint.name.startswith("elevation")]
    assert len(springs) == 4
    for spring in springs:
        result = (spring.stiffness, spring.damping, *(each.stiffness for each in spring.creep))
        np.testing.assert_allclose(result, inertia * np.array((4877.9, 56.623, 3474.6, 1665.6, 656.34)), rtol=1e-12)


@pytest.mark.parametrize("rods", [4, 5, 6])
def test_a_snake_is_a_regular_polygon_of_equal_rods(rods: int) -> None:
    """Rod k lies along ``(cos k c, sin k c)``, ``c = 2 pi / N``, and follows the one before; the body is all rods together."""
    robot = ROBOTS.get(f"snakey{'' if rods == 4 else rods}")
    headings, end = 2.0 * pi / rods * np.arange(rods), np.array((-0.5, 0.0, 0.0))
    for k, (heading, mount) in enumerate(zip(headings, robot.mounts.layout, strict=True)):
        along = np.array((cos(heading), sin(heading), 0.0))
        np.testing.assert_allclose(mount.position, end + 0.5 * along, atol=1e-14)
        for joint in robot.joints.layout[2 * k - 2 : 2 * k] if k else ():
            np.testing.assert_allclose(joint.position, end, atol=1e-14)
            axis = (0.0, 0.0, 1.0) if joint.name == f"yaw_{k}" else along
            np.testing.assert_allclose((*joint.axis, joint.reference), (*axis, axis[2] * 2.0 * pi / rods), atol=1e-14)
        _check_rod(robot, k, heading)
        end = end + along
    np.testing.assert_allclose(end, (-0.5, 0.0, 0.0), atol=1e-14)


def _check_rod(robot: RobotCfg, k: int, heading: float) -> None:
    capsule, middle = robot.collision.shapes[k], robot.mounts.layout[k].position
    assert (capsule.radius, capsule.height + 2.0 * capsule.radius) == (0.02, 1.0)
    np.testing.assert_allclose((*capsule.center, *capsule.euler), (*middle, 0.0, 0.5 * pi, heading), atol=1e-14)
    assert capsule.link == robot.mounts.layout[k].link == ("base" if k == 0 else f"roll_{k}")
    if k:
        link = robot.joints.layout[2 * k - 1].link
        np.testing.assert_allclose((link.mass, *link.com), (0.30625, *middle), atol=1e-14)
        np.testing.assert_allclose(link.inertia, _inertia_of_rod(heading), atol=1e-14)


def _inertia_of_rod(heading: float) -> np.ndarray:
    """Return that of a cylinder of 0.30625 kg, 1 m and a radius of 0.02 m that lies level."""
    turn = np.array(((cos(heading), -sin(heading), 0.0), (sin(heading), cos(heading), 0.0), (0.0, 0.0, 1.0)))
    across = 0.30625 * (1.0 / 12.0 + 0.02**2 / 4.0)
    return turn @ np.diag((0.5 * 0.30625 * 0.02**2, across, across)) @ turn.T


@pytest.mark.parametrize(("robot", "speed"), [
    ("lmf1", 742.97),  # 1.235 9.81 / 4 = 3.02884 N = 5.487e-6 w²
    ("lmf2", 2.0 * pi * 470.12),  # 1.24 9.81 / 4 = 3.0411 N = 1.376e-5 n², n in rev/s
    ("lmf2_with_camera", 2.0 * pi * 470.12),
    ("lmf2_radar", 2.0 * pi * 470.12),
    ("magpie", 2.0 * pi * 470.12),
])  # fmt: skip
def test_each_hovers_at_the_speed_worked_out_by_hand(robot: str, speed: float) -> None:
    cfg = ROBOTS.get(robot)
    vehicle = vehicle_from_config(cfg, num_envs=1, dtype=torch.float64)
    thrust = rotor_thrust(vehicle, torch.full((1, 4), speed, dtype=torch.float64))
    assert thrust.sum().item() == pytest.approx(9.81 * cfg.body.mass, rel=1e-4)


def test_each_rotor_of_lmf1_turns_it_as_px4_says() -> None:
    """Front right, back left, front left, back right: 0.1 m to the side and 0.05 m of drag torque per newton, by hand.
    A rotor on the right rolls it to the left (negative, x forward), one in front pitches it up (negative, y left); the
    body turns against its rotor. The last holds in flight, too: 1 N more from one rotor alone."""
    matrix = allocation_matrix(vehicle_from_config(ROBOTS.get("lmf1"), num_envs=1, dtype=torch.float64), 9.81)[0, 3:]
    by_hand = torch.tensor([[-0.1, -0.1, -0.05], [0.1, 0.1, -0.05], [0.1, -0.1, 0.05], [-0.1, 0.1, 0.05]])
    torch.testing.assert_close(matrix.T, by_hand.double())
    env = simulation("lmf1", num_envs=4)
    env.reset()
    env.robot_manager.tensors.state.ang_vel.zero_()
    for _ in range(5):
        env.step(3.03 + torch.eye(4))
    turned = env.gtd["robot_body_angvel"].double()
    inertia = torch.tensor([0.013, 0.014, 0.013], dtype=torch.float64)
    assert torch.equal(turned.sign(), by_hand.double().sign())
    direction = torch.nn.functional.normalize(by_hand / inertia, dim=-1)
    torch.testing.assert_close(torch.nn.functional.normalize(turned, dim=-1), direction, rtol=0.0, atol=0.02)


def test_variants_differ_by_their_sensor_alone() -> None:
    lmf2 = ROBOTS.get("lmf2")
    assert lmf2.sensors == ()
    for name, sensor in (("lmf2_with_camera", "base_depth_camera"), ("lmf2_radar", "fake_radar")):
        assert replace(lmf2, sensors=(sensor,), summary=ROBOTS.get(name).summary) == ROBOTS.get(name)
    assert ROBOTS.get("magpie").sensors == ROBOTS.get("base_quadrotor_with_dome_lidar").sensors


RANDOM_MATRIX = (
    (0.0, -0.321393805, -0.454519478, -0.342020143, 0.96984631, 0.342020143, 0.866025404, -0.754406507),
    (1.0, -0.342020143, -0.707106781, 0.0, -0.173648178, 0.939692621, 0.5, -0.173648178),
    (0.0, -0.883022222, 0.54167522, 0.939692621, 0.171010072, 0.0, 0.0, 0.633022222),
    (0.175, 0.123788742, -0.0569783368, 0.134977168, 0.0336959042, -0.266534135, -0.078839746, -0.0206893989),
    (0.01, 0.278845133, -0.0432852308, -0.272061766, -0.197793856, 0.0863687139, 0.156554446, -0.17126129),
    (0.282487373, -0.14173549, -0.0858541103, 0.0384858939, -0.333468026, 0.0836741468, 0.00846777988, -0.0874336259),
)
"""``base_random_config.allocation_matrix`` of Aerial Gym Simulator 2.0.1."""

OCTAROTOR_MATRIX = (
    (-0.78867513, 0.21132487, -0.21132487, 0.78867513, 0.78867513, -0.21132487, 0.21132487, -0.78867513),
    (0.21132487, 0.78867513, -0.78867513, -0.21132487, -0.21132487, -0.78867513, 0.78867513, 0.21132487),
    (0.57735027, -0.57735027, -0.57735027, 0.57735027, 0.57735027, -0.57735027, -0.57735027, 0.57735027),
    (0.14226497, -0.21547005, 0.25773503, 0.01547005, -0.01547005, -0.25773503, 0.21547005, -0.14226497),
    (-0.25773503, 0.01547005, 0.14226497, 0.21547005, -0.21547005, -0.14226497, -0.01547005, 0.25773503),
    (0.11547005, -0.23094011, -0.11547005, 0.23094011, -0.23094011, 0.11547005, 0.23094011, -0.11547005),
)
"""``base_octarotor_config.allocation_matrix`` of the same; its own motors have a tenth of its torque ratio."""


@pytest.mark.parametrize(
    ("name", "torque_ratio", "published"),
    [("base_random", None, RANDOM_MATRIX), ("base_octarotor", 0.1, OCTAROTOR_MATRIX)],
)
def test_the_derived_matrix_is_the_published_one(name: str, torque_ratio: float | None, published) -> None:
    """With 0.1 m in place of the 0.01 m of its motor model all 48 entries of the octarotor agree."""
    robot = ROBOTS.get(name)
    changes = {} if torque_ratio is None else {"rotor": replace(robot.rotor, torque_ratio=torque_ratio)}
    result, expected = vehicle_matrix(replace(robot, **changes)), torch.tensor(published, dtype=torch.float64)
    torch.testing.assert_close(result, expected, rtol=0.0, atol=1e-6 if changes else 1e-7)
    assert not changes or (vehicle_matrix(robot) - expected).abs().max() > 0.05


def vehicle_matrix(robot: RobotCfg) -> torch.Tensor:
    return allocation_matrix(vehicle_from_config(robot, num_envs=1, dtype=torch.float64), 9.81)[0]


@pytest.mark.parametrize("robot", ["base_octarotor", "base_random", "tilted_hexarotor", "omnidirectional_octarotor"])
def test_fully_actuated_robots_push_and_turn_about_every_axis(robot: str) -> None:
    """Rank 6, with the smallest singular value a hundred times above round-off."""
    size = torch.linalg.svdvals(vehicle_matrix(ROBOTS.get(robot)))
    assert size[5] > 0.01 * size[0]


@pytest.mark.parametrize("robot", ["typhoon_hexarotor", "coaxial_octarotor", "racing_quadrotor"])
def test_flat_robots_push_along_one_axis(robot: str) -> None:
    matrix = vehicle_matrix(ROBOTS.get(robot))
    assert int(torch.linalg.matrix_rank(matrix, rtol=1e-9)) == 4
    torch.testing.assert_close(matrix[:3].sum(1)[:2], torch.zeros(2, dtype=torch.float64))


FILE = """
extends: morphy
effects:
  link_drag: {qx: 0.002, qz: 0.004, azimuth_1.qz: 0.01, base.qz: 0.02}
  quadratic_drag: {dx: 0.01, dy: 0.01, dz: 0.02}
effects_source: test
"""


@pytest.fixture
def drag_robot(tmp_path: Path) -> RobotCfg:
    (tmp_path / "dragged.yaml").write_text(FILE)
    return robot_by_name(str(tmp_path / "dragged.yaml"))


def test_what_takes_it_as_rigid_leaves_drag_of_links_out(drag_robot: RobotCfg) -> None:
    assert list(effects_on_rigid(drag_robot)) == list(params_from_robot(drag_robot).effects) == ["quadratic_drag"]
    effects = robot_effects(drag_robot, num_envs=1, device=torch.device("cpu"), dtype=torch.float64, rigid=True)
    assert [effect.name for effect, _ in effects] == ["quadratic_drag"]
    tune_robot(drag_robot, name="dragged", attitude=5.0, position=1.0, damping=0.8, dt=0.002)


def test_the_loop_lists_it_as_not_testable_and_keeps_it(drag_robot: RobotCfg) -> None:
    selection, air = make_selection(), make_excess()
    told = untestable_effects(selection, drag_robot, air)
    acting = dict.fromkeys(("link_drag", "link_buoyancy", "link_added_mass"), "acts_on_links")
    assert {name: finding.code for name, finding in told.items()} == acting
    assert untestable_effects(selection, ROBOTS.get("tinyprop"), air) == {}
    params = params_from_robot(drag_robot).with_effect("rotor_drag", torch.tensor([0.1, 0.2, 0.3]).numpy())
    result = correct_robot(make_setup([hover("f", 1.0)], robot=drag_robot), params, ["rotor_drag"])
    assert set(result.effects) == {"link_drag", "quadratic_drag", "rotor_drag"}
    assert result.effects["link_drag"] == drag_robot.effects["link_drag"]
    check_effects(result)


def test_it_cannot_be_requested() -> None:
    with pytest.raises(ConfigError, match="link_drag acts on links where they are.* cannot be asked for"):
        select_effects(None, None, None, lambda *_: None, candidates=("link_drag",))
