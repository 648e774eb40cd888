"""What the writer of MJCF says: its frames, numbers to the last digit, and what is left out; limits of contacts."""

from dataclasses import replace
from math import inf
from xml.etree import ElementTree

import pytest
import torch

from aerial_gym.config.environment import ContactCfg
from aerial_gym.physics.articulated.tree import Joint, Links, Tree
from aerial_gym.physics.ground import LinkContacts, Solid, Solids
from aerial_gym.physics.mujoco.mjcf import Floor, contact_softness, solver_numbers, write_mjcf

TREE = Tree(joints=(Joint(parent=0, axis=(0.0, 1.0, 0.0), position=(0.1, 0.2, 0.3), attitude=(0.5, -0.5, 0.1, 0.7)),))
LINKS = Links(
    mass=torch.tensor([[1.0, 2.0], [3.0, 0.1]], dtype=torch.float64),
    com=torch.zeros(2, 2, 3),
    inertia=torch.tensor([[1.0, 4.0, 5.0], [4.0, 2.0, 6.0], [5.0, 6.0, 3.0]]).expand(2, 2, 3, 3),
)


def write_tree(**options):
    return ElementTree.fromstring(write_mjcf(TREE, LINKS, gravity=9.81, dt=0.1, **options))


def test_numbers_are_those_of_one_environment_in_the_order_of_mujoco() -> None:
    root = write_tree(env=1)
    arm = root.find("worldbody/body/body")
    assert arm.get("quat") == "0.7 0.5 -0.5 0.1"
    inertial = arm.find("inertial")
    assert inertial.attrib["fullinertia"] == "1.0 2.0 3.0 4.0 5.0 6.0"
    assert inertial.attrib["mass"] == "0.1"
    option = root.find("option")
    assert option.attrib["gravity"] == "0.0 0.0 -9.81"


def test_without_a_floor_nothing_touches_and_with_one_points_have_a_size() -> None:
    assert write_tree().find("option/flag[@contact='disable']") is not None
    root = write_tree(floor=Floor(height=-0.5, spheres=((0.1, 0.0, 0.0, 0.0),), friction=0.4))
    assert root.find("option/flag[@contact='disable']") is None
    plane, foot = root.find("worldbody/geom"), root.find("worldbody/body/geom")
    assert plane.attrib["pos"] == "0.0 0.0 -0.5"
    assert float(foot.attrib["size"]) == 1e-9


def test_obstacles_are_bodies_of_their_environment_all_of_one_size() -> None:
    table = (Solid(kind="box", size=(1.0, 2.0, 3.0)), Solid(kind="cylinder", size=(0.5, 1.0, 0.0)))
    part = torch.tensor([[0, 1], [1, -1]])
    solids = Solids(table=table, part=part, carrier=torch.zeros_like(part), state=torch.zeros(2, 1, 13))
    for env, kinds in enumerate((["box", "cylinder"], ["cylinder", "sphere"])):
        for moves in (False, True):
            on = LinkContacts(links=(), solids=replace(solids, moves=moves))
            root = write_tree(env=env, floor=Floor(height=-inf, spheres=(), friction=0.4, on_links=on))
            bodies = root.findall("worldbody/body")[1:]
            geoms = [geom for body in bodies for geom in body.iter("geom")]
            assert [geom.get("type") for geom in geoms] == kinds
            assert [geom.get("contype") for geom in geoms] == ["2", "0" if env else "2"]
            assert {geom.get("conaffinity") for geom in geoms} == {"0"}
            assert {body.get("mocap") for body in bodies} == {None if moves else "true"}
            assert {body.get("gravcomp") for body in bodies} == {"1" if moves else None}
            assert root.find("worldbody/geom") is None


def test_short_steps_have_the_very_spring_and_damper() -> None:
    cfg = ContactCfg(friction=0.5, damping_ratio=0.3)
    (stiffness, damping), (impedance, *_) = solver_numbers(cfg, 1e-6)
    assert -stiffness == pytest.approx(cfg.stiffness, rel=1e-3)
    assert -damping == pytest.approx(cfg.damping, rel=1e-3)
    assert impedance == pytest.approx(1e-4, rel=1.0)


@pytest.mark.parametrize("dt", [1e-5, 1e-3, 4e-3, 0.02, 1.0])
@pytest.mark.parametrize("sinking", [1e-5, 1e-3, 0.05])
@pytest.mark.parametrize("damping_ratio", [0.0, 0.5, 1.0, 4.0])
def test_no_motion_is_too_fast_for_its_step(dt: float, sinking: float, damping_ratio: float) -> None:
    """``dt b / d <= 1``, an equality where damping is above critical, and ``dt² k / d <= 1 / 4``; MuJoCo's limits of d
    hold. At its largest impedance MuJoCo leaves no more softening: the bounds are then kept by that alone, to its
    1e-4."""
    cfg = ContactCfg(friction=0.5, sinking=sinking, damping_ratio=damping_ratio)
    (stiffness, damping), (impedance, *_) = solver_numbers(cfg, dt)
    assert 1e-4 <= impedance <= 1.0 - 1e-4
    if contact_softness(cfg, dt) > 1e-4:
        assert dt * -damping / impedance <= 1.0 + 1e-9
        assert dt**2 * -stiffness / impedance <= 0.25 + 1e-9
        if damping_ratio >= 1.0 and impedance > 1e-4:
            assert dt * -damping / impedance == pytest.approx(1.0)
