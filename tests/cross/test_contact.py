"""Contact in the fused kernel and in scenes against the torch reference, and against an independent engine (MuJoCo)."""

import pytest
import torch

from aerial_gym.assets.sweep import NEAR
from aerial_gym.config.environment import ContactCfg
from aerial_gym.config.shape import ShapeCfg
from aerial_gym.interop.launches import one_thread
from aerial_gym.math.quaternion import quat_normalize
from aerial_gym.physics import BodyState, TorchBackend, WarpBackend
from tests.physics.contact_rig import FEET, GroundRig, ObstacleRig, obstacle, start
from tests.physics.vehicles import F64, asymmetric_robot

ROUGH = ContactCfg(friction=0.5)


def low_starts(count: int, dtype: torch.dtype) -> BodyState:
    """Return slightly tilted vehicles that are about to land, or have just done so, with speeds and spins of order one."""
    g = torch.Generator().manual_seed(2)
    q = torch.cat((0.1 * torch.randn(count, 3, dtype=F64, generator=g), torch.ones(count, 1, dtype=F64)), dim=-1)
    v, w = (0.5 * torch.randn(count, 3, dtype=F64, generator=g) for _ in range(2))
    height = 0.03 + 0.02 * torch.randn(count, dtype=F64, generator=g)
    return start(count, height=height, dtype=dtype, attitude=quat_normalize(q), lin_vel=v, ang_vel=w)


@pytest.mark.parametrize("integrator", ["euler", pytest.param("rk4", marks=pytest.mark.slow)])
def test_one_step_on_the_ground_is_that_of_torch(integrator: str, request: pytest.FixtureRequest) -> None:
    """Fused kernel and scene (a plane) against float64 torch: 64 vehicles with an offset centre of mass, one step of 10 ms.
    Float32 with the penalty R loses about ``PENALTY`` of 1e-7; a branch on the very edge may fall to the other side. The
    ground is tested at the poses, a scene also along the step and from a distance of ``NEAR`` on. What it flags beside is
    flagged by ground in steps of 0.1 ms, here a foot that leaves the ground, or by ground with feet larger by ``NEAR``."""
    if integrator == "rk4":
        request.getfixturevalue("optimise_kernels")
    count, robot = 64, asymmetric_robot()
    with one_thread():
        truth = GroundRig(
            TorchBackend(), ROUGH, low_starts(count, F64), spheres=FEET, robot=robot, integrator=integrator
        )
        truth.run(0.01, 0.01)
    fused = GroundRig(
        WarpBackend(), ROUGH, low_starts(count, torch.float32), spheres=FEET, robot=robot, integrator=integrator
    )
    fused.run(0.01, 0.01)
    scenes = [
        ObstacleRig(
            [ShapeCfg(kind="plane")], obstacle(count), ROUGH, low_starts(count, torch.float32), spheres=FEET,
            robot=robot, integrator=integrator, backend=backend,
        )
        for backend in (WarpBackend(), TorchBackend())
    ]  # fmt: skip
    for scene in scenes:
        scene.run(0.01)
    larger = tuple((x, y, z, radius + float(NEAR)) for x, y, z, radius in FEET)
    touches = truth.crashes
    for feet, dt in ((larger, 0.01), (FEET, 1e-4)):
        ground = GroundRig(
            TorchBackend(), ROUGH, low_starts(count, F64), spheres=feet, robot=robot, integrator=integrator
        )
        ground.run(0.01, dt)
        touches = touches | ground.crashes
    touched = truth.impulse[:, 2] > 0.0
    assert 16 < touched.sum() < 64
    for rig in (fused, *scenes):
        assert bool((rig.crashes | ~truth.crashes).all())
        assert bool((~rig.crashes | (truth.crashes if rig is fused else touches)).all())
        error = (torch.cat(rig.state.tensors(), -1) - torch.cat(truth.state.tensors(), -1)).abs().amax(dim=1)
        assert error.sort().values[:-1].max() < 2e-4  # all but one on an edge
        assert (rig.impulse - truth.impulse).abs().amax(dim=1).sort().values[:-1].max() < 1e-4
