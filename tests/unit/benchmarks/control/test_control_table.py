"""Benchmarks of control: which robots fly, what drives are told, and the cells of tables."""

from dataclasses import replace
from math import inf, nan, pi

import pytest
import torch

from aerial_gym.robots import ROBOTS
from benchmarks.control import control_table
from benchmarks.control.control_flights import (
    ControlFlight,
    DriveCommands,
    holds_shape,
    robots_by_dynamics,
    time_to_settle_and_overshoot,
)
from benchmarks.control.control_table import BEGIN, END, ControlTableCmd, Refusal, fly_all
from benchmarks.control.robot_table import table_robots

FLIGHT = ControlFlight(
    robot="magpie", controller="magpie_position_control", law="position", sim="base_sim", error=0.0058, settling_s=4.7,
    overshoot=0.0, tilt_rad=0.1, wind_error=0.4946, wind_largest=0.51, limit_share=0.92, limit_settling_s=inf,
    limit_overshoot=0.046, limit_error=180.0, response=(0.5, 1.0),
)  # fmt: skip


def test_what_is_refused_is_not_flown() -> None:
    flights, refusals = fly_all(["base_rov"], ["lee_position_control"])
    assert (flights, [r.sim for r in refusals]) == ([], ["base_sim", "base_sim_2ms", "base_sim_4ms"])
    assert all(r.of_kind and r.refused.startswith("law 'position': moves sideways") for r in refusals)


def test_the_page_is_written_between_its_marks(tmp_path, monkeypatch) -> None:
    path = tmp_path / "control.md"
    path.write_text(f"before\n{BEGIN}\nof before\n{END}\nafter\n", encoding="utf-8")
    bent = replace(FLIGHT, robot="morphy", controller="lee_position_control", error=inf, overshoot=inf)
    refused = Refusal("morphy", "fully_actuated_control", "base_sim", "law ...")
    monkeypatch.setattr(
        control_table, "fly_all", lambda _robots, _laws, sims=None: ([bent], [refused]) if sims else ([FLIGHT], [])
    )
    ControlTableCmd(write=path, out=tmp_path).run()
    text = path.read_text(encoding="utf-8")
    assert text.startswith(f"before\n{BEGIN}\n## ")
    assert text.endswith(f"{END}\nafter\n")
    assert "2 flights in all tables; " in text
    assert "`magpie_*` from `magpie`" in text
    assert "of before" not in text
    assert "| `morphy` | 1 | 0 | 1 | 1 | inf |" in text
    assert (tmp_path / "control_steps.png").stat().st_size > 10_000


LEVEL = {"robot_orientation": torch.tensor([[0.0, 0.0, 0.0, 1.0]]), "robot_body_angvel": torch.zeros(1, 3)}


def drive_commands(robot: str) -> list[float]:
    actions = torch.zeros(1, 9)
    DriveCommands(ROBOTS.get(robot), 0.01).write_commands(LEVEL, actions)
    return actions[0].tolist()


def test_robots_that_bend_fly_with_their_drives_and_not_on_a_stand() -> None:
    bend = robots_by_dynamics(bend=True)
    assert not set(bend) & set(robots_by_dynamics())
    assert "morphy_fixed_base" not in bend
    assert [name for name in bend if not holds_shape(ROBOTS.get(name))][:2] == ["snakey", "snakey5"]
    assert table_robots()[-5:] == ["morphy", "snakey", "snakey5", "snakey6", "tilt_tricopter"]
    turned = [0.0, 0.0, 0.0, pi / 2, 0.0, pi / 2, 0.0, pi / 2, 0.0]
    torch.testing.assert_close(drive_commands("snakey_position"), turned, rtol=1e-6, atol=0)
    torch.testing.assert_close(drive_commands("tilt_tricopter"), [*[0.0] * 8, 0.1012477], rtol=1e-5, atol=0)
    assert drive_commands("morphy") == drive_commands("x500") == [0.0] * 9


def test_figures_of_a_response() -> None:
    """Overshoot to 1.3, back within 2 % from the fifth sample of 20 ms on; what ends elsewhere has not settled."""
    assert time_to_settle_and_overshoot([0.5, 1.3, 0.9, 1.01, 1.0, 1.0]) == pytest.approx((0.08, 0.3))
    assert time_to_settle_and_overshoot([0.5, 0.5])[0] == inf
    assert time_to_settle_and_overshoot([0.5, 1.0, nan, nan]) == (inf, inf)
