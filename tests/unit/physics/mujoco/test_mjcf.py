"""What the writer of MJCF says: its frames, numbers to the last digit, and what is left out."""

from xml.etree import ElementTree

import torch

from aerial_gym.physics.articulated.tree import Joint, Links, Tree
from aerial_gym.physics.mujoco.mjcf import Floor, write_mjcf

TREE = Tree(joints=(Joint(parent=0, axis=(0.0, 1.0, 0.0), position=(0.1, 0.2, 0.3), attitude=(0.5, -0.5, 0.1, 0.7)),))
LINKS = Links(
    mass=torch.tensor([[1.0, 2.0], [3.0, 0.1]], dtype=torch.float64),
    com=torch.zeros(2, 2, 3),
    inertia=torch.tensor([[1.0, 4.0, 5.0], [4.0, 2.0, 6.0], [5.0, 6.0, 3.0]]).expand(2, 2, 3, 3),
)


def written(**options):
    return ElementTree.fromstring(write_mjcf(TREE, LINKS, gravity=9.81, dt=0.1, **options))


def test_numbers_are_those_of_one_environment_in_the_order_of_mujoco() -> None:
    """Quaternions wxyz; inertia xx, yy, zz, xy, xz, yz; gravity down."""
    root = written(env=1)
    arm = root.find("worldbody/body/body")
    assert arm is not None
    assert arm.get("quat") == "0.7 0.5 -0.5 0.1"
    inertial = arm.find("inertial")
    assert inertial is not None
    assert inertial.attrib["fullinertia"] == "1.0 2.0 3.0 4.0 5.0 6.0"
    assert inertial.attrib["mass"] == "0.1"
    option = root.find("option")
    assert option is not None
    assert option.attrib["gravity"] == "0.0 0.0 -9.81"


def test_without_a_floor_nothing_touches_and_with_one_points_have_a_size() -> None:
    assert written().find("option/flag[@contact='disable']") is not None
    root = written(floor=Floor(height=-0.5, spheres=((0.1, 0.0, 0.0, 0.0),), friction=0.4))
    assert root.find("option/flag[@contact='disable']") is None
    plane, foot = root.find("worldbody/geom"), root.find("worldbody/body/geom")
    assert plane is not None
    assert foot is not None
    assert plane.attrib["pos"] == "0.0 0.0 -0.5"
    assert float(foot.attrib["size"]) == 1e-9
