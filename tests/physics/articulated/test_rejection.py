"""What of a vehicle with joints is no vehicle: refused where it is built, in words that name it."""

from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from aerial_gym.config.joint import DriveCfg, JointCfg, JointsCfg, LinkCfg, SpringCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import ConfigError
from aerial_gym.physics.articulated.articulation import build_articulation
from aerial_gym.physics.model import check_effects
from aerial_gym.robots import ROBOTS
from tests.builders import simulation

EMPTY = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def wheel(moment: float) -> LinkCfg:
    across = max(moment, 1e-6)
    return LinkCfg(
        mass=0.02, com=(0.1, 0.05, 0.0), inertia=((moment, 0.0, 0.0), (0.0, across, 0.0), (0.0, 0.0, across))
    )


def about_x(name: str, **rest: object) -> JointCfg:
    return JointCfg(name=name, axis=(1.0, 0.0, 0.0), position=(0.04, 0.05, 0.0), **rest)


def make_robot(*layout: JointCfg, floating: bool = True) -> RobotCfg:
    plain = ROBOTS.get("morphy_stiff")
    body = replace(plain.body, inertia=((1e-3, 0.0, 0.0), (0.0, 1e-3, 0.0), (0.0, 0.0, 1.5e-3)))
    return replace(plain, body=body, joints=JointsCfg(layout=layout, floating=floating, source="test"))


def build(robot: RobotCfg) -> None:
    build_articulation(robot, like=torch.zeros(1))


@pytest.mark.parametrize("floating", [True, False])
def test_a_joint_that_turns_no_inertia_is_refused(floating: bool) -> None:
    """The acceleration under an effort would be infinite; a drive or dry friction is at its limit then, and holds nothing."""
    drive = DriveCfg(mode="velocity", damping=0.1, limit=0.2, command_range=(-1.0, 1.0))
    rubs = SpringCfg(friction=0.1)
    for joint in (about_x("spin", link=wheel(0.0)), about_x("spin", link=wheel(0.0), drive=drive, spring=rubs)):
        with pytest.raises(ConfigError, match="robot: spin can move in the reference pose without moving any mass"):
            build(make_robot(joint, floating=floating))


def test_two_joints_about_one_axis_are_refused_together() -> None:
    """They may turn against each other, and nothing that weighs anything moves."""
    with pytest.raises(ConfigError, match="robot: one, other can move in the reference pose without"):
        build(make_robot(about_x("one"), about_x("other", parent="one", link=wheel(1e-6))))


def test_an_inertia_a_spring_or_a_damper_is_enough() -> None:
    """1e-9 kg m² is a ball of 20 g of a third of a millimetre; a spring without mass is where its forces balance."""
    build(make_robot(about_x("spin", link=wheel(1e-9))))
    for spring in (SpringCfg(damping=1e-4), SpringCfg(stiffness=0.1)):
        build(make_robot(about_x("spin", link=wheel(0.0), spring=spring)))
        build(make_robot(about_x("one", spring=spring), about_x("other", parent="one", link=wheel(1e-6))))


def test_a_wheel_at_the_origin_of_its_body_has_a_size() -> None:
    link = LinkCfg(mass=0.02, com=(0.0, 0.0, 0.0), inertia=((1e-5, 0.0, 0.0), (0.0, 1e-5, 0.0), (0.0, 0.0, 1e-5)))
    build(make_robot(JointCfg(name="spin", axis=(0.0, 0.0, 1.0), position=(0.0, 0.0, 0.0), link=link)))


def test_links_must_leave_a_body_for_the_base() -> None:
    heavy = LinkCfg(mass=0.3, com=(0.1, 0.0, 0.0), inertia=EMPTY)
    with pytest.raises(ConfigError, match=r"its links weigh 0\.3 kg, the whole 0\.29 kg"):
        build(make_robot(about_x("arm", link=heavy)))
    far = LinkCfg(mass=0.1, com=(1.0, 0.0, 0.0), inertia=EMPTY)
    with pytest.raises(ConfigError, match=r"body\.inertia without the links .* no body has"):
        build(make_robot(about_x("arm", link=far)))


def test_a_link_has_the_inertia_of_a_body() -> None:
    """A plate has ``Jz = Jx + Jy``, and no body has more; a point has none."""

    def link(x: float, y: float, z: float) -> LinkCfg:
        return LinkCfg(mass=0.1, com=(0.0, 0.0, 0.0), inertia=((x, 0.0, 0.0), (0.0, y, 0.0), (0.0, 0.0, z)))

    for moments in ((1e-6, 2e-6, 3e-6), (0.0, 0.0, 0.0), (0.0, 1e-6, 1e-6)):
        link(*moments)
    with pytest.raises(
        ConfigError, match=r"LinkCfg\.inertia = .*: principal moments .* violate the triangle inequality"
    ):
        link(1e-6, 2e-6, 4e-6)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("added_inertia", {"x": 0.01, "y": 0.01, "z": 0.01}),
        ("added_mass", {"x": 0.1, "y": 0.1, "z": 0.1}),
        ("joint_spring", {"compliance": 0.1, "tau": 0.02, "hinge": 0.4}),
    ],
)
def test_effects_for_rigid_vehicles_are_refused_by_name(name: str, values: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match=f"effect {name}: is for rigid vehicles, and this one has joints"):
        check_effects(replace(ROBOTS.get("morphy"), effects={name: values}, effects_source="test"))


@pytest.mark.parametrize(
    ("robot", "drawn", "refused"),
    [
        ("snakey", "body.mass: {low: 0.5, high: 1.1}", True),
        ("morphy", "body.mass: {low: 0.9, high: 1.1}", False),
        ("morphy", "body.inertia: {low: 0.3, high: 1.1}", True),
        ("morphy", "body.inertia: {low: 0.95, high: 1.05}", False),
    ],
)
def test_draws_must_leave_a_base_that_weighs_something(robot: str, drawn: str, refused: bool, tmp_path: Path) -> None:
    """Rods carry 0.92 of a snake's 1.225 kg; arms have 4.3e-4 of the 8.5e-4 kg m² of Morphy about x."""
    (tmp_path / "drawn.yaml").write_text(f"extends: {robot}\nrandomize:\n  {drawn}\n")
    outcome = pytest.raises(ConfigError, match=r"randomize: body\..* narrower ranges") if refused else nullcontext()
    with outcome:
        simulation(str(tmp_path / "drawn.yaml"), sim="base_sim_2ms", env="empty_env_2ms", backend="torch")
