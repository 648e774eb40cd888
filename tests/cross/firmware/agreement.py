"""Differences of our controllers from the firmware on the golden vectors of this folder, as a table: ``python -m
tests.cross.firmware.agreement [--write docs/results/firmware.md]``."""

import argparse
import platform
from pathlib import Path

import torch
from torch import Tensor

from tests.cross.firmware import crazyflie_pairs, px4_pairs

BEGIN, END = "<!-- table: begin, by python -m tests.cross.firmware.agreement -->", "<!-- table: end -->"


def pairs() -> dict[str, tuple[Tensor, Tensor]]:
    """Return the outputs of ours and of the firmware, by quantity."""
    vectors = px4_pairs.read_vectors()
    position = {f"PX4: {name}": pair[:2] for name, pair in px4_pairs.position_pairs(vectors).items()}
    return {
        "PX4: normalised torque": px4_pairs.rate_pair(vectors)[:2],
        "PX4: body-rate setpoint of attitude control [rad/s]": px4_pairs.attitude_pair(vectors), **position,
        "PX4: motor signals of the mixer": px4_pairs.mixer_pair(), **_crazyflie(),
    }  # fmt: skip


def _crazyflie() -> dict[str, tuple[Tensor, Tensor]]:
    vectors = crazyflie_pairs.read_vectors()
    actual, reference = crazyflie_pairs.lee_pair(vectors)
    lifts = reference[:, 0] > 1e-3
    result = {
        "Crazyflie, Lee: thrust [N]": (actual[:, :1], reference[:, :1]),
        "Crazyflie, Lee: torque [N m] where thrust is along the body": (actual[lifts, 1:], reference[lifts, 1:]),
    }
    actual, reference = crazyflie_pairs.lee_integral_pair(vectors)
    lifts = (reference[..., 0] > 1e-2).all(0)
    result["Crazyflie, Lee with integrals: thrust [N]"] = actual[:, lifts, :1], reference[:, lifts, :1]
    result["Crazyflie, Lee with integrals: torque [N m]"] = actual[:, lifts, 1:], reference[:, lifts, 1:]
    for name, pair in (("Mellinger", crazyflie_pairs.mellinger_pair), ("PID", crazyflie_pairs.pid_pair)):
        actual, reference = pair(vectors)
        result[f"Crazyflie, {name}: thrust [counts]"] = actual[..., :1], reference[..., :1]
        result[f"Crazyflie, {name}: moments [whole counts]"] = actual[..., 1:], reference[..., 1:]
    actual, reference = crazyflie_pairs.brescianini_pair(vectors)
    result["Crazyflie, Brescianini: thrust [N]"] = actual[..., :1], reference[..., :1]
    result["Crazyflie, Brescianini: torque [N m]"] = actual[..., 1:], reference[..., 1:]
    reduced = crazyflie_pairs.brescianini_reduced_pair(vectors)
    result["Crazyflie, Brescianini: rates of the reduced attitude, world [rad/s]"] = reduced
    return result | {"Crazyflie: motors [whole counts]": crazyflie_pairs.power_pair(vectors)}


def table() -> str:
    """Return the table with hardware and versions."""
    lines = [
        "| | states | largest value | largest difference | 99 % below | median |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for name, (actual, reference) in pairs().items():
        error = (actual - reference).abs().amax(-1).flatten()
        tail = float(error.kthvalue(int(0.99 * error.numel())).values)
        figures = (float(reference.abs().max()), float(error.max()), tail, float(error.median()))
        lines.append(f"| {name} | {error.numel():,} | " + " | ".join(f"{x:.2g}" for x in figures) + " |")
    made_on = f"{platform.machine()} CPU, torch {torch.__version__.split('+')[0]}; ours in float64, theirs in float32."
    return "\n".join((*lines, "", made_on, ""))


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--write", type=Path, help="page in which the table stands")
    args = parser.parse_args()
    if args.write is None:
        print(table())
        return
    head, rest = args.write.read_text(encoding="utf-8").split(BEGIN)
    args.write.write_text(f"{head}{BEGIN}\n{table()}{END}{rest.split(END)[1]}", encoding="utf-8")


if __name__ == "__main__":
    main()
