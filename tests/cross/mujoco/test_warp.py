"""MuJoCo Warp as a backend, in float32: in free flight beside the torch backend, and at rest on the ground in closed form."""

import pytest
import torch

from aerial_gym.config.contact import ContactCfg
from aerial_gym.control import CONTROLLERS
from aerial_gym.math.random import Randomness
from aerial_gym.physics import BACKENDS, TorchBackend
from tests.cross.mujoco.test_environments import WEIGHT, put_down
from tests.cross.mujoco.test_flight import by_env
from tests.cross.test_backends import NUDGES, as_type, assert_agreement, build, perturb, random_actions, start_state
from tests.physics.contact_rig import BALL, FEET, GRAVITY, MASS, GroundRig, start
from tests.physics.vehicles import F64, asymmetric_robot

pytest.importorskip("mujoco_warp", reason="MuJoCo Warp is not installed: pip install 'aerial-gym[mujoco-warp]'")

DT, STEPS = 0.004, 50


def fly(backend, dtype: torch.dtype, *, adjust=None, nudges=(0,)):
    """Return the state after 0.2 s of flight, of a batch of 6 for each nudge."""
    model, law = build(
        asymmetric_robot(), CONTROLLERS.get("no_control"), 6, dtype, ("rotor_drag",), adjust, copies=len(nudges)
    )
    backend.allocate(model, law, integrator="euler", random=Randomness(6 * len(nudges)))
    state = perturb(as_type(start_state(model, 6), dtype), nudges)
    backend.step(state, random_actions(law, model, 6).to(dtype).repeat(len(nudges), 1), DT, STEPS)
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
        backend.step(state, random_actions(law, model, 2).float(), DT, 5)
        ends.append(state)
    assert torch.equal(ends[0].position[0], ends[1].position[0])
    assert ends[1].position[1].isnan().all()


def test_a_robot_at_rest_shows_its_weight_and_no_crash() -> None:
    sim = put_down("mujoco_warp")
    torch.testing.assert_close(sim.gtd["robot_contact_force"], WEIGHT, rtol=1e-2, atol=1e-2)
    assert not sim.gtd["crashes"].any()
