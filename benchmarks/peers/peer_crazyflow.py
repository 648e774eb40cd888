# pyright: reportMissingImports=false
"""Crazyflow (JAX): one step of one drone is 1/500 s of its first-principles model.

A step holds: rotor lag with separate coefficients for rise and fall, linear drag, gyroscopic terms of the rotors, the
stepper (explicit Euler, or RK4 in case ``rk4``), and clipping at the floor. ``plant`` and ``rk4`` command rotor speeds;
``attitude`` runs the Mellinger attitude loop and the mixer in every step. 100 steps are fused by the package itself
(``lax.scan`` inside ``Sim.step``): compare with our fused substeps.

Needs ``crazyflow``, which imports casadi for its symbolic models. Where that wheel (92 MB) cannot go, a module ``casadi``
on PYTHONPATH that answers every attribute with itself is enough; the JAX simulation does not use it.
"""

from importlib.metadata import version

import jax
import jax.numpy as jnp
import numpy as np
from crazyflow.sim import Sim

from benchmarks.peers.timing import StepBlock, parse_request, report_rates

FREQ_HZ = 500
FUSED_STEPS = 100
CLIMB = 1.02  # Commanded thrust in weights: a slow climb, so that no drone rests on the floor


def main() -> None:
    request = parse_request(__doc__)
    control = "attitude" if request.case == "attitude" else "rotor_vel"
    worlds = request.num_envs // request.vehicles
    sim = Sim(
        n_worlds=worlds, n_drones=request.vehicles, control=control, dynamics="first_principles",
        integrator="rk4" if request.case == "rk4" else "euler", freq=FREQ_HZ, attitude_freq=FREQ_HZ,
        device="gpu" if request.device == "cuda" else "cpu",
    )  # fmt: skip
    thrust, speed = hover(sim)
    command = jnp.zeros((worlds, request.vehicles, 4))
    command = command.at[..., 3].set(thrust) if control == "attitude" else command + speed
    stage = getattr(sim, f"{control}_control")

    def restart() -> None:
        sim.reset()
        states = sim.data.states
        pos = states.pos.at[..., 2].set(1.0)
        rotors = jnp.zeros_like(states.rotor_vel) + speed
        sim.data = sim.data.replace(states=states.replace(pos=pos, rotor_vel=rotors))

    def run() -> None:
        stage(command)
        sim.step(FUSED_STEPS)

    batch = StepBlock(
        steps=FUSED_STEPS, dt=1.0 / FREQ_HZ, run=run, restart=restart,
        wait=lambda: jax.block_until_ready(sim.data.states.pos),
        heights=lambda: np.asarray(sim.data.states.pos[..., 2]).ravel().tolist(),
    )  # fmt: skip
    versions = f"{version('crazyflow')}, jax {jax.__version__} on {sim.device}"
    report_rates(request, batch, version=versions, call=f"{FUSED_STEPS} (lax.scan)")


def hover(sim: Sim) -> tuple[float, float]:
    """Return collective thrust [N] and rotor speed [rpm] of a slow climb, from the package's own parameters."""
    params = sim.data.params
    thrust = CLIMB * 9.81 * float(np.ravel(params.mass)[0])
    c0, c1, c2 = (float(c) for c in np.ravel(params.rpm2thrust)[:3])
    return thrust, (-c1 + (c1 * c1 + 4.0 * c2 * (thrust / 4.0 - c0)) ** 0.5) / (2.0 * c2)


if __name__ == "__main__":
    main()
