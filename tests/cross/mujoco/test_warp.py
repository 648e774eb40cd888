"""MuJoCo Warp as a backend, in float32: in free flight beside the torch backend, and at rest on the ground in closed form."""

import pytest
import torch

from aerial_gym.config.environment import ContactCfg
from aerial_gym.control import CONTROLLERS
from aerial_gym.math.random import Randomness
from aerial_gym.physics import BACKENDS, TorchBackend
from aerial_gym.physics.articulated.steppers import implicit_euler
from aerial_gym.physics.articulated.tree import Links
from aerial_gym.physics.mujoco.warp_engine import WarpTrees
from tests.cross.mujoco.test_bending import (
    DT,
    G,
    assert_bends_alone_as_in_a_batch,
    assert_same,
    flies_as_on_torch,
    on_a_stand,
    spring,
)
from tests.cross.mujoco.test_flight import by_env
from tests.cross.test_backends import NUDGES, as_type, assert_agreement, build, perturb, random_actions, start_state
from tests.cross.test_joints_in_single_precision import WITH_JOINTS, assert_one_step_within_bound
from tests.physics.articulated.trees import random_links, random_motion, random_tree
from tests.physics.contact_rig import BALL, FEET, GRAVITY, MASS, GroundRig, start
from tests.physics.vehicles import F64, asymmetric_robot
from tests.repetitions import frequent_values

pytest.importorskip("mujoco_warp", reason="MuJoCo Warp is not installed: pip install 'aerial-gym[mujoco-warp]'")

FLIGHT_DT, STEPS = 0.004, 50


def fly(backend, dtype: torch.dtype, *, adjust=None, nudges=(0,)):
    """Return the state after 0.2 s of flight, of a batch of 6 for each nudge."""
    model, law = build(
        asymmetric_robot(), CONTROLLERS.get("no_control"), 6, dtype, ("rotor_drag",), adjust, copies=len(nudges)
    )
    backend.allocate(model, law, integrator="euler", random=Randomness(6 * len(nudges)))
    state = perturb(as_type(start_state(model, 6), dtype), nudges)
    backend.step(state, random_actions(law, model, 6).to(dtype).repeat(len(nudges), 1), FLIGHT_DT, STEPS)
    return state


@pytest.mark.parametrize("adjust", [None, by_env])
def test_free_flight_is_as_far_from_float64_as_float32_is(adjust) -> None:
    exact = fly(TorchBackend(), F64, adjust=adjust)
    singles = fly(TorchBackend(), torch.float32, adjust=adjust, nudges=range(NUDGES))
    assert_agreement(exact, singles, fly(BACKENDS.get("mujoco_warp")(), torch.float32, adjust=adjust))


@pytest.mark.parametrize("spheres", [BALL, FEET])
def test_weight_presses_each_contact_as_deep_as_the_file_says(spheres) -> None:
    """m g = n K m depth for n contacts; float32 keeps a height of 0.1 m to 1e-8 m, of depths from 0.25 mm on."""
    cfg = ContactCfg(friction=0.5)
    rig = GroundRig(BACKENDS.get("mujoco_warp")(), cfg, start(height=0.1, dtype=torch.float32), spheres=spheres)
    rig.run(1.0, 0.01)
    lowest = min(z - r for _, _, z, r in spheres)
    assert -(rig.state.position[0, 2].item() + lowest) == pytest.approx(cfg.sinking / len(spheres), rel=1e-3)
    assert rig.impulse[0, 2].item() == pytest.approx(MASS * GRAVITY, rel=1e-3)


def test_a_row_that_is_not_finite_stays_so_and_alone() -> None:
    model, law = build(asymmetric_robot(), CONTROLLERS.get("no_control"), 2, torch.float32)
    ends = []
    for ill in (False, True):
        backend, state = BACKENDS.get("mujoco_warp")(), as_type(start_state(model, 2), torch.float32)
        backend.allocate(model, law, integrator="euler")
        if ill:
            state.ang_vel[1, 0] = torch.nan
        backend.step(state, random_actions(law, model, 2).float(), FLIGHT_DT, 5)
        ends.append(state)
    assert torch.equal(ends[0].position[0], ends[1].position[0])
    assert ends[1].position[1].isnan().all()


@pytest.mark.parametrize("name", frequent_values(WITH_JOINTS, ("morphy", "snakey")))
def test_one_step_is_off_by_no_more_than_the_condition_of_the_mass_matrix_allows(name: str) -> None:
    """Beside torch in float64, by the bound of ``test_joints_in_single_precision``: drives, springs, rotors on links."""
    assert_one_step_within_bound(name, BACKENDS.get("mujoco_warp")())


@pytest.mark.parametrize("floating", [True, False])
def test_trees_with_branches_and_weights_of_their_own_move_as_by_implicit_euler(floating: bool) -> None:
    """Forces on links; 50 steps, each off by some units of float32 times the condition of the mass matrix, 1e2: 1e-4."""
    tree = random_tree(6, 5, floating=floating)
    links, first = random_links(tree, 3, 5), random_motion(tree, 3, 5)
    first = first if floating else on_a_stand(first)
    wrench = torch.randn(3, tree.num_links, 6, generator=torch.Generator().manual_seed(1), dtype=F64)
    law = spring(6, stiffness=0.4, quadratic=0.7, damping=0.05, rest=0.1)
    bodies, actual, reference = WarpTrees(tree, 3, DT), first, first
    for _ in range(50):
        actual = implicit_euler(tree, links, (law,), actual, DT, gravity=G, wrench=wrench)
        reference = bodies.move(tree, links, (law,), reference, DT, gravity=G, wrench=wrench)
    assert_same(actual, reference, bound=1e-4)
    heavier = Links(mass=2.0 * links.mass, com=links.com, inertia=links.inertia)
    again = implicit_euler(tree, heavier, (law,), actual, DT, gravity=G, wrench=wrench)
    assert_same(again, bodies.move(tree, heavier, (law,), actual, DT, gravity=G, wrench=wrench), bound=1e-5)


def test_environments_bend_alone_as_in_a_batch_and_what_is_not_finite_stays_so() -> None:
    assert_bends_alone_as_in_a_batch(WarpTrees)


@pytest.mark.parametrize("robot", frequent_values(WITH_JOINTS, ("morphy_fixed_base", "tilt_tricopter")))
def test_every_robot_with_joints_flies_as_on_torch(robot: str) -> None:
    flies_as_on_torch(robot, "mujoco_warp")
