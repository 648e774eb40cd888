# pyright: reportMissingImports=false
"""RotorPy's batched torch simulator, float64: one step of one drone is 0.01 s of ``BatchedMultirotor.step``.

A step holds: rotor speed commands, first-order lag, rotor drag, translational lift, RK4 (four derivative evaluations through
torchdiffeq), normalisation of the quaternion, and a draw of motor noise (of size zero here). One call is one step of all
drones. Needs ``rotorpy torch torchdiffeq roma tqdm``.
"""

from importlib.metadata import version

import torch
from rotorpy.vehicles.crazyflie_params import quad_params
from rotorpy.vehicles.multirotor import BatchedMultirotor, BatchedMultirotorParams

from benchmarks.peers.timing import StepBlock, parse_request, report_rates

STEPS = 5
DT_S = 0.01
CLIMB = 1.01  # Commanded thrust in weights


def main() -> None:
    request = parse_request(__doc__)
    torch.set_num_threads(request.threads)
    torch.set_grad_enabled(False)
    device, count = torch.device(request.device), request.num_envs
    speed = (CLIMB * quad_params["mass"] * 9.81 / 4.0 / quad_params["k_eta"]) ** 0.5  # [rad/s]
    start = start_state(count, speed, device)
    sim = BatchedMultirotor(
        BatchedMultirotorParams([dict(quad_params) for _ in range(count)], count, device),
        count,
        start,
        device,
        integrator="rk4",
    )
    command = {"cmd_motor_speeds": torch.full_like(start["rotor_speeds"], speed)}
    rows = torch.arange(count, device=device)
    state = dict(start)

    def restart() -> None:
        state.update({key: value.clone() for key, value in start.items()})

    def run() -> None:
        for _ in range(STEPS):
            state.update(sim.step(state, command, DT_S, rows))

    batch = StepBlock(
        steps=STEPS, dt=DT_S, run=run, restart=restart,
        wait=torch.cuda.synchronize if device.type == "cuda" else lambda: None,
        heights=lambda: state["x"][:, 2].tolist(),
    )  # fmt: skip
    about = f"{version('rotorpy')}, torch {torch.__version__}, float64"
    report_rates(request, batch, version=about, call="1")


def start_state(count: int, speed: float, device: torch.device) -> dict[str, torch.Tensor]:
    """Return drones at the origin, level, still, with rotors at ``speed`` [rad/s]."""
    zeros = torch.zeros(count, 3, dtype=torch.float64, device=device)
    attitude = torch.zeros(count, 4, dtype=torch.float64, device=device)
    attitude[:, 3] = 1.0
    rotors = torch.full((count, 4), speed, dtype=torch.float64, device=device)
    start = {key: zeros.clone() for key in ("x", "v", "w", "wind")}
    return {**start, "q": attitude, "rotor_speeds": rotors}


if __name__ == "__main__":
    main()
