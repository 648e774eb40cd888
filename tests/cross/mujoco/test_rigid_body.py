"""The rigid body with tilted rotors and an offset centre of mass against an independent engine (MuJoCo)."""

import numpy as np
import pytest
import torch

from aerial_gym.math.quaternion import quat_multiply, quat_normalize
from aerial_gym.physics import INTEGRATORS, advance, build_model, vehicle_from_config
from aerial_gym.physics.rotor_maps import POLYNOMIAL
from tests.physics.vehicles import F64, SpeedControl, asymmetric_robot, random_state

mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install 'aerial-gym[dev]'")


def mujoco_model(robot, torque_per_thrust: np.ndarray):
    """Return a free body whose sites push along the rotor axes and turn it by the drag torque."""
    (ixx, ixy, ixz), (_, iyy, iyz), (_, _, izz) = robot.body.inertia
    sites, motors = "", ""
    for i, mount in enumerate(robot.mounts.layout):
        sites += (
            f'<site name="r{i}" pos="{" ".join(map(str, mount.position))}" zaxis="{" ".join(map(str, mount.axis))}"/>'
        )
        motors += f'<general site="r{i}" gear="0 0 1 0 0 {-mount.spin * torque_per_thrust[i]}"/>'
    return mujoco.MjModel.from_xml_string(f"""
      <mujoco><option timestep="1e-4" integrator="RK4" gravity="0 0 -9.81" density="0" viscosity="0"/>
      <worldbody><body name="b"><freejoint/>
        <inertial pos="{" ".join(map(str, robot.body.com))}" mass="{robot.body.mass}"
          fullinertia="{ixx} {iyy} {izz} {ixy} {ixz} {iyz}"/>{sites}
      </body></worldbody><actuator>{motors}</actuator></mujoco>""")


def test_flight_under_constant_thrusts_agrees_with_mujoco() -> None:
    """0.5 s from random states; both integrate with RK4, ours at 1 ms: truncation stays below 1e-7."""
    robot, count = asymmetric_robot(), 6
    model = build_model(vehicle_from_config(robot, num_envs=count, dtype=F64))
    state = random_state(count, seed=7)
    thrust = POLYNOMIAL.evaluate(model.vehicle.thrust_map, state.rotor_speed)
    torque = POLYNOMIAL.evaluate(model.vehicle.torque_map, state.rotor_speed)
    end = advance(model, INTEGRATORS["rk4"], SpeedControl(), state, state.rotor_speed, 1e-3, 500)
    for i in range(count):
        m = mujoco_model(robot, (torque[i] / thrust[i]).numpy())
        data = mujoco.MjData(m)
        attitude = state.attitude[i].numpy()
        data.qpos[:] = np.concatenate((state.position[i].numpy(), attitude[[3, 0, 1, 2]]))
        data.qvel[:] = np.concatenate((state.lin_vel[i].numpy(), state.ang_vel[i].numpy()))
        data.ctrl[:] = thrust[i].numpy()
        for _ in range(5000):
            mujoco.mj_step(m, data)
        np.testing.assert_allclose(end.position[i].numpy(), data.qpos[:3], atol=1e-6)
        np.testing.assert_allclose(end.lin_vel[i].numpy(), data.qvel[:3], atol=1e-6)
        np.testing.assert_allclose(end.ang_vel[i].numpy(), data.qvel[3:], atol=1e-6)
        reference = quat_normalize(torch.tensor(data.qpos[[4, 5, 6, 3]]))
        inverse = end.attitude[i] * torch.tensor([-1.0, -1.0, -1.0, 1.0], dtype=F64)
        turn = quat_multiply(inverse, reference)
        assert turn[:3].norm().item() < 1e-6
