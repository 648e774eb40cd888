"""Water on links on the fused backend against the torch reference, and on MuJoCo's; the bound is that of ``test_link_drag``."""

from dataclasses import replace

import pytest
import torch

from aerial_gym.config.randomize import RandomizeCfg
from aerial_gym.config.robot import RobotCfg
from aerial_gym.errors import CapabilityError
from aerial_gym.physics import BACKENDS, TorchBackend
from aerial_gym.physics.warp_backend import WarpBackend
from aerial_gym.robots import ROBOTS
from tests.builders import simulation
from tests.cross.test_joints import FACTOR, ROUND_OFF, odd_tree
from tests.cross.test_link_drag import OF_ALL, fly
from tests.physics.articulated.test_link_buoyancy import make_joints, under_water
from tests.repetitions import frequent_values

BUOYANCY = {"force": 0.5, "x": 0.01, "slide.force": 2.0, "slide.z": 0.05, "base.y": -0.03}

ADDED = {"mx": 0.05, "my": 0.1, "mz": 0.2, "slide.mx": 0.3, "jx": 1e-3, "jz": 2e-3, "base.my": 0.6}

ALL = {"link_buoyancy": BUOYANCY, "link_added_mass": ADDED, "link_drag": OF_ALL}

ON_A_STAND = {"link_buoyancy": {"left.force": 2.0, "left.z": 0.1}}

CASES = {
    "a slide on a hinge": (under_water(make_joints(), {"link_buoyancy": BUOYANCY}), ()),
    "added mass": (under_water(make_joints(), {"link_added_mass": ADDED}), ()),
    "all in a current": (under_water(make_joints(), ALL), ("constant_wind",)),
    "on a stand": (under_water(make_joints(), ON_A_STAND, floating=False), ()),
    "all on a stand": (under_water(make_joints(), ALL, floating=False), ("constant_wind",)),
    "with drives": (replace(odd_tree(), effects=ALL, effects_source="test"), ("gusts", "rotor_drag", "buoyancy")),
}


@pytest.mark.parametrize("case", frequent_values(CASES, ("all in a current",)))
def test_the_fused_step_in_water_is_that_of_the_reference(case: str) -> None:
    robot, rest = CASES[case]
    exact = fly(TorchBackend(), robot, rest, torch.float64)
    singles = [fly(TorchBackend(), robot, rest, torch.float32, nudge=nudge * 2.0**-24) for nudge in (0, 1)]
    fused = fly(WarpBackend(), robot, rest, torch.float32)
    without = fly(TorchBackend(), replace(robot, effects={}), rest, torch.float64)
    for place, (right, own, *roughs) in enumerate(zip(exact, fused, *singles, strict=True)):
        away = max(float((rough - right).abs().max()) for rough in roughs)
        allowed = FACTOR * away + ROUND_OFF * float(right.abs().max().clamp_min(1.0))
        assert bool(right.isfinite().all())
        assert float((own - right).abs().max()) <= allowed
        if place in (3, 6) and (place == 6 or "stand" not in case):  # angular velocity, rates of joints
            assert float((without[place] - right).abs().max()) > 100.0 * allowed


def test_mujoco_carries_links_as_torch_does() -> None:
    """On a free base and on a stand; both hold the force through a step, and round."""
    pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'aerial-gym[mujoco]'")
    for case in ("a slide on a hinge", "on a stand"):
        robot, rest = CASES[case]
        ends = [fly(backend, robot, rest, torch.float64) for backend in (TorchBackend(), BACKENDS.get("mujoco")())]
        for one, other in zip(*ends, strict=True):
            torch.testing.assert_close(one, other, rtol=1e-9, atol=1e-9)
    with pytest.raises(CapabilityError, match="backend mujoco: bodies of MuJoCo have one mass along all axes"):
        fly(BACKENDS.get("mujoco")(), CASES["added mass"][0], (), torch.float64)


def test_a_reset_draws_the_buoyancy_of_a_link() -> None:
    """Morphy on a stand under water, its arms let go: the more water one displaces, the higher it is then."""
    values = {"azimuth_1.force": 0.1, "azimuth_1.z": 0.0}
    drawn = RandomizeCfg(how="value", distribution="uniform", low=0.05, high=0.3)
    robot: RobotCfg = replace(
        ROBOTS.get("morphy_fixed_base"), effects={"link_buoyancy": values}, effects_source="test", sensors=(),
        randomize={"effects.link_buoyancy.azimuth_1.force": drawn},
    )  # fmt: skip
    env = simulation(robot, sim="base_sim_2ms", num_envs=8, seed=1, backend="torch")
    env.reset()
    env.gtd["robot_orientation"][:] = torch.tensor([0.0, 0.0, 0.0, 1.0])
    env.gtd["dof_position"].zero_()
    env.gtd["dof_velocity"].zero_()
    env.step(torch.zeros(8, 4))
    draws = env.robot_manager.draws()["effects.link_buoyancy.azimuth_1.force"]
    torch.testing.assert_close(env.gtd["effect_link_buoyancy"][:, 0], draws)
    raised = -env.gtd["dof_position"][:, robot.joints.names.index("elevation_1")]
    order = draws.argsort()
    assert len(set(draws.tolist())) == 8
    assert bool((raised[order].diff() > 0.0).all())
