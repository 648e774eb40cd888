"""Vehicles on the page: meshes, rotors that turn, links that bend, arrows of forces."""

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from aerial_gym.robots.catalog import robot_by_name

pytest.importorskip("viser", reason="viser is not installed")

from aerial_gym.viewer.vehicle import ARROW_M, SLOWER, VehicleView

if TYPE_CHECKING:
    from viser import ViserServer


def handle(server: "ViserServer", name: str) -> Any:
    node = server.scene.get_handle_by_name(name)
    assert node is not None
    return node


UPRIGHT, QUARTER = [0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.5**0.5, 0.5**0.5]


def test_hubs_follow_the_pose(server: "ViserServer") -> None:
    """A quarter turn about z takes the hub (x, y) to (-y, x)."""
    robot = robot_by_name("base_quadrotor")
    view = VehicleView(server, "/turned", robot, count=2)
    view.update(np.array([[1.0, 2.0, 3.0], [0.0, 0.0, 0.0]]), np.array([QUARTER, UPRIGHT]))
    hubs = handle(server, "/turned/discs").batched_positions.reshape(2, 4, 3)
    x, y, _ = np.array([mount.position for mount in robot.mounts.layout]).T
    np.testing.assert_allclose(hubs[0, :, :2], np.stack((1.0 - y, 2.0 + x), axis=1), atol=1e-6)
    np.testing.assert_allclose(hubs[1, :, :2], np.stack((x, y), axis=1), atol=1e-6)
    body = handle(server, "/turned/body_0")
    np.testing.assert_allclose(body.batched_positions[0], (1.0, 2.0, 3.0))
    np.testing.assert_allclose(body.batched_wxyzs[0], (0.5**0.5, 0.0, 0.0, 0.5**0.5), atol=1e-7)


def test_one_vehicle_moves_as_a_node(server: "ViserServer") -> None:
    """Its meshes stay in the frame of the node, which has its pose."""
    robot = robot_by_name("base_quadrotor")
    view = VehicleView(server, "/alone", robot)
    view.update(np.array([[1.0, 2.0, 3.0]]), np.array([QUARTER]))
    node = handle(server, "/alone")
    np.testing.assert_allclose(node.position, (1.0, 2.0, 3.0))
    np.testing.assert_allclose(node.wxyz, (0.5**0.5, 0.0, 0.0, 0.5**0.5), atol=1e-7)
    hubs = [mount.position[:2] for mount in robot.mounts.layout]
    np.testing.assert_allclose(handle(server, "/alone/discs").batched_positions[:, :2], hubs, atol=1e-6)
    np.testing.assert_allclose(handle(server, "/alone/body_0").batched_positions, np.zeros((1, 3)))


def test_rotors_turn_with_their_speed_and_sense(server: "ViserServer") -> None:
    """After ``elapsed`` a blade has turned by ``SLOWER spin speed elapsed`` about its axis: 2 atan2(z, w)."""
    robot = robot_by_name("base_quadrotor")
    view = VehicleView(server, "/spinning", robot)
    speed = np.array([[100.0, 200.0, 0.0, 300.0]]) if robot.rotor_types[0].mode == "speed" else None
    if speed is None:
        pytest.skip("the rotors of this robot have no speed")
    view.update(np.zeros((1, 3)), np.array([UPRIGHT]), rotor_state=speed, elapsed=0.1)
    turns = handle(server, "/spinning/blades").batched_wxyzs
    angles = 2.0 * np.arctan2(turns[:, 3], turns[:, 0])
    spins = np.array([mount.spin for mount in robot.mounts.layout])
    expected = np.remainder(SLOWER * spins * speed[0] * 0.1, 2.0 * np.pi)
    np.testing.assert_allclose(np.remainder(angles, 2.0 * np.pi), expected, atol=1e-5)


def test_links_and_their_rotors_go_where_the_links_are(server: "ViserServer") -> None:
    robot = robot_by_name("morphy")
    view = VehicleView(server, "/bent", robot)
    links = np.tile([0.0, 0.0, 1.0, *UPRIGHT], (1, len(robot.link_names), 1))
    number = robot.link_names.index(robot.mounts.layout[2].link)
    links[0, number, :3] += (0.0, 0.0, 0.5)
    view.update(links[:, 0, :3], links[:, 0, 3:], links=links)
    height = handle(server, "/bent/discs").batched_positions[:, 2]
    np.testing.assert_allclose(height[2] - height[0], 0.5, atol=1e-6)


def test_arrow_of_a_force_begins_at_the_vehicle(server: "ViserServer") -> None:
    robot = robot_by_name("base_quadrotor")
    view = VehicleView(server, "/pushed", robot, count=2)
    place, weight = np.array([[0.0, 0.0, 1.0], [5.0, 0.0, 1.0]]), robot.body.mass * 9.81
    for share in (0.5, 1.0):
        force = np.array([[0.0, 0.0, -share * weight], [share * weight, 0.0, 0.0]])
        view.update(place, np.array([UPRIGHT, UPRIGHT]), forces={"drag": force})
        arrows = handle(server, "/pushed_forces/drag").points
        np.testing.assert_allclose(arrows[:, 0], place)
        np.testing.assert_allclose(arrows[:, 1] - arrows[:, 0], ARROW_M * view.size * force / weight, atol=1e-6)


def test_removed_vehicles_leave_nothing(server: "ViserServer") -> None:
    VehicleView(server, "/gone", robot_by_name("base_quadrotor")).remove()
    assert server.scene.get_handle_by_name("/gone/blades") is None


def test_thousand_vehicles_are_instances_of_the_same_meshes(server: "ViserServer") -> None:
    robot, count = robot_by_name("base_quadrotor"), 1000
    one, many = VehicleView(server, "/one", robot), VehicleView(server, "/many", robot, count=count)
    place = np.zeros((count, 3))
    place[:, 0] = np.arange(count)
    many.update(place, np.tile(UPRIGHT, (count, 1)))
    nodes = [name for name in server.scene._handle_from_node_name if name.startswith(("/one", "/many"))]
    assert sum(name.startswith("/one") for name in nodes) == sum(name.startswith("/many") for name in nodes)
    np.testing.assert_allclose(handle(server, "/many/body_0").batched_positions, place)
    assert handle(server, "/many/blades").batched_positions.shape == (4 * count, 3)
    one.remove()
    many.remove()
