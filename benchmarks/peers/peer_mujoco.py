# pyright: reportAttributeAccessIssue=false
"""MuJoCo's C engine, float64: one step of one free body with four thrust sites is one ``mj_step`` of 0.002 s, CPU only.

A step holds: four site forces with their reaction torques (no rotor lag, no controller), the drag of the inertia box in air
(quadratic, and viscous), collision detection switched off, semi-implicit Euler or RK4. 50 steps of every body are made in
one call of ``mujoco.rollout``, which keeps the states of all steps.
"""

import mujoco
import numpy as np
from mujoco import rollout

from benchmarks.peers.timing import StepBlock, parse_request, report_rates

STEPS = 50
DT_S = 0.002
ARM = 0.13
MASS = 0.25
CLIMB = 1.01  # Thrust in weights


def main() -> None:
    request = parse_request(__doc__)
    model = mujoco.MjModel.from_xml_string(quadrotor("RK4" if request.case == "rk4" else "Euler"))
    data = [mujoco.MjData(model) for _ in range(request.threads)]
    full = mujoco.mjtState.mjSTATE_FULLPHYSICS
    first = np.zeros(mujoco.mj_stateSize(model, full))
    mujoco.mj_getState(model, data[0], first, full)
    initial, models = np.tile(first, (request.num_envs, 1)), [model] * request.num_envs
    control = np.full((request.num_envs, STEPS, model.nu), CLIMB * MASS * 9.81 / 4.0)
    states = np.zeros((request.num_envs, STEPS, first.size))
    with rollout.Rollout(nthread=request.threads if request.threads > 1 else 0) as pool:

        def run() -> None:
            pool.rollout(models, data, states[:, -1].copy(), control, state=states)

        def restart() -> None:
            states[:, -1] = initial

        batch = StepBlock(
            steps=STEPS,
            dt=DT_S,
            run=run,
            restart=restart,
            wait=lambda: None,
            heights=lambda: states[:, -1, 3].tolist(),  # time, x, y, z
        )
        report_rates(request, batch, version=mujoco.__version__, call=f"{STEPS} (rollout)")


def quadrotor(integrator: str) -> str:
    """Return the model of a 0.25 kg quadrotor in still air."""
    hubs = [(ARM, -ARM), (-ARM, -ARM), (-ARM, ARM), (ARM, ARM)]
    sites = "".join(f'<site name="hub{i}" pos="{x} {y} 0"/>' for i, (x, y) in enumerate(hubs))
    motors = "".join(f'<motor site="hub{i}" gear="0 0 1 0 0 {0.01 * (-1) ** i}"/>' for i in range(4))
    return f"""<mujoco>
      <option timestep="{DT_S}" integrator="{integrator}" density="1.225" viscosity="1.8e-5">
        <flag contact="disable"/>
      </option>
      <worldbody><body pos="0 0 1"><freejoint/>
        <inertial pos="0 0 0" mass="{MASS}" diaginertia="4.225e-4 4.225e-4 8.45e-4"/>{sites}
      </body></worldbody>
      <actuator>{motors}</actuator>
    </mujoco>"""


if __name__ == "__main__":
    main()
