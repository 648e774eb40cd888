"""The story: what the policy sees of the independent plant, and how its flights are scored."""

from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from aerial_gym import task_registry
from aerial_gym.config import family_files
from aerial_gym.rl_training.policies.body import NetworkBodyCfg
from aerial_gym.rl_training.policies.policy import Policy
from aerial_gym.task.terms.observations import OBSERVATIONS
from benchmarks.story.__main__ import ROBOT, TASK
from benchmarks.story.setpoint_flight import (
    CONTROL_RATE,
    HIDDEN,
    SETPOINTS,
    STAY_S,
    PolicyPilot,
    draw_setpoints,
    fly_setpoints,
    nominal_vehicle,
    tracking_errors,
    true_vehicle,
)
from benchmarks.undeclared.sensors import NO_BIAS, Sample
from benchmarks.undeclared.trajectories import Reference


class RecordingPolicy(Policy):
    def forward(self, observation: dict[str, torch.Tensor]) -> torch.Tensor:
        self.seen = observation["observations"]
        return torch.zeros(len(self.seen), 4)


def recorder() -> RecordingPolicy:
    return RecordingPolicy(NetworkBodyCfg(shapes={"observations": (15,)}, hidden_layers=(8, 8), activation="relu"), 4)


def reference(position: np.ndarray) -> Reference:
    empty = np.zeros((1, len(position), 3))
    rates = dict.fromkeys(("velocity", "acceleration", "jerk"), empty)
    rates |= dict.fromkeys(("yaw", "yaw_rate"), empty[..., 0])
    return Reference(position=position[None], excite=np.zeros((1, len(position), 4)), **rates)


def test_the_policy_sees_what_its_task_shows() -> None:
    rng = np.random.default_rng(0)
    turn = Rotation.from_quat(rng.normal(size=(5, 4)))
    position, target, velocity, rate = rng.normal(size=(4, 5, 3))
    policy = recorder()
    pilot = PolicyPilot(policy, nominal_vehicle(ROBOT))
    seen = {"position": position, "velocity": velocity, "rate": rate, "rotation": turn.as_matrix()}
    sample = Sample(acc=np.zeros((5, 3)), rotor=np.zeros((5, 4)), **seen)
    pilot.command(sample, reference(target), 0)
    values = {"target_position": target, "robot_position": position, "robot_orientation": turn.as_quat()}
    values |= {"robot_linvel": velocity, "robot_body_angvel": rate}
    tensors = {name: torch.from_numpy(value).float() for name, value in values.items()}
    entries = task_registry.get(TASK).observations["policy"]
    terms = [OBSERVATIONS.get(entry.term) for entry in entries]
    shown = torch.cat([term.value(*(tensors[name] for name in term.reads)) for term in terms], dim=-1)
    torch.testing.assert_close(policy.seen, shown, atol=1e-6, rtol=1e-6)


def test_the_middle_of_its_actions_is_the_middle_of_the_thrusts() -> None:
    """0.7 N, between 0.2 and 1.2 N; held for four ticks of the plant, as the policy decides 100 times a second."""
    declared = nominal_vehicle(ROBOT)
    policy = recorder()
    pilot = PolicyPilot(policy, declared)
    unit_rows = np.ones((2, 3))
    unit_quantities = dict.fromkeys(("position", "velocity", "rate", "acc"), unit_rows)
    sample = Sample(rotation=np.tile(np.eye(3), (2, 1, 1)), rotor=np.ones((2, 4)), **unit_quantities)
    first = pilot.command(sample, reference(unit_rows), 0)
    np.testing.assert_allclose(first**2 * 3.25852e-7, 0.7, rtol=1e-6)
    policy.seen = torch.zeros(0)
    assert np.array_equal(pilot.command(sample, reference(unit_rows), 3), first)
    assert policy.seen.numel() == 0


def test_the_vehicle_is_that_of_the_file_and_hides_what_it_says(tmp_path: Path) -> None:
    """Hover of the file's own comment, 1675.5 rad/s; what is hidden within two deviations of a careful declaration."""
    declared = nominal_vehicle(ROBOT)
    assert declared.hover_speed() == pytest.approx(1675.5, abs=0.5)
    true, _ = true_vehicle(declared, seed=7)
    np.testing.assert_allclose(true.com[:2], [HIDDEN["com_offset"]["x"], HIDDEN["com_offset"]["y"]], atol=0.0006)
    shares = true.thrust_coeff / declared.thrust_coeff
    np.testing.assert_allclose(shares, [1.0, 1.0, 1.0, 0.92], atol=0.008)
    other = tmp_path / "other.yaml"
    other.write_text((family_files("robots")["tinyprop"]).read_text() + "effects: {rotor_drag: {dx: 0.1}}\n")
    with pytest.raises(ValueError, match="has effects or a thrust map that is no square"):
        nominal_vehicle(other)


@pytest.mark.slow
def test_a_vehicle_that_only_falls_is_lost() -> None:
    """0.7 N a rotor carry 77 % of the weight: it falls by ½ (1 - 0.766) g t², 1.5 m after 1.1 s."""
    declared = nominal_vehicle(ROBOT)
    points = draw_setpoints(2, seed=0)
    points[1:] = points[0]
    record = fly_setpoints(recorder(), declared=declared, true=declared, bias=NO_BIAS, points=points, seed=0)
    height = record.position[:, 0, 2] - points[0, 0, 2]
    tick = round(1.1 * CONTROL_RATE)
    share = 4.0 * 0.7 / (declared.mass * 9.81)
    assert height[tick] == pytest.approx(-0.5 * (1.0 - share) * 9.81 * 1.1**2, rel=0.1)  # rotors lag by 47 ms
    assert tracking_errors(record, points).lost == 1.0
    assert len(record.position) == SETPOINTS * round(STAY_S * CONTROL_RATE)
