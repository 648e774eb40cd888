"""Benchmarks of control: which robots fly, what drives are told, and the cells of tables."""

import json
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
from benchmarks.control.control_table import (
    BEGIN,
    END,
    ControlTableCmd,
    Refusal,
    controllers_table,
    fly_all,
    joints_table,
    refusals_table,
    steps_table,
    wind_table,
)
from benchmarks.control.robot_table import table_robots

FLIGHT = ControlFlight(
    robot="magpie", controller="magpie_position_control", law="position", sim="base_sim", error=0.0058, settling_s=4.7,
    overshoot=0.0, tilt_rad=0.1, wind_error=0.4946, wind_largest=0.51, limit_share=0.92, limit_settling_s=inf,
    limit_overshoot=0.046, limit_error=180.0, response=(0.5, 1.0),
)  # fmt: skip


def test_steps_by_robot_with_lost_vehicles_and_refusals() -> None:
    foreign = replace(FLIGHT, robot="lmf2", overshoot=0.08, error=1e-5)
    refusals = [
        Refusal("tinyprop", "magpie_position_control", "base_sim", "robot tinyprop ... is nearly unstable"),
        Refusal("base_rov", "magpie_position_control", "base_sim", "law 'position': moves sideways by leaning"),
    ]
    rows = steps_table([FLIGHT, foreign], refusals, ["magpie_position_control", "magpie_rates_control"]).splitlines()
    assert rows == [
        "| robot | `magpie_position_control` |", "| --- | --- |", "| `magpie` | 4.7, 0%, 0.0058, **lost** |",
        "| `lmf2` | 4.7, 8%, < 0.001 |", "| `tinyprop` | refused |", "| `base_rov` | unfit |",
    ]  # fmt: skip
    refusals += [replace(r, controller="magpie_velocity_control") for r in refusals]
    names = "`magpie_position_control`, `magpie_velocity_control`"
    assert refusals_table(refusals).splitlines()[-1] == f"| {names} | `base_rov` | `tinyprop` |"


def test_controllers_are_compared_over_their_robots_at_each_sim() -> None:
    law = replace(FLIGHT, controller="lee_position_control", limit_error=0.0)
    rest = [replace(law, robot=f"r{i}", settling_s=2.0 + i, overshoot=0.01 * i, error=0.1 * i) for i in range(3)]
    lost = replace(rest[0], sim="base_sim_2ms", limit_error=11.0)
    foreign = replace(FLIGHT, robot="lmf2", error=9.0)
    rows = controllers_table([*rest, lost, foreign]).splitlines()
    assert rows[2:] == ["| `lee_position_control` | 3 | 0.2 m (`r2`) | 3, 2% | 2, 0%, 1 lost | - |"]


def test_error_in_wind_and_of_joints_by_controller() -> None:
    law = replace(FLIGHT, controller="lee_position_control", wind_error=0.49, wind_largest=0.5)
    falls = replace(law, controller="px4_position_control", wind_error=0.1)
    rows = wind_table([law, replace(law, robot="lmf2", wind_error=0.45), replace(law, law="rates"), falls, wet(law)])
    assert rows.splitlines()[2:] == [
        "| `lee_position_control` | 2 | 0.47 m | 0.49 m (`magpie`) | 94% |",
        "| `px4_position_control` | 1 | 0.1 m | 0.1 m (`magpie`) | 20% |",
    ]
    held = replace(FLIGHT, robot="morphy", controller="lee_position_control", error=0.091, limit_error=0.1)
    fell = replace(held, controller="lee_rates_control", error=inf, tilt_rad=2.0, overshoot=inf, limit_error=inf)
    assert joints_table([held, fell]).splitlines()[-1] == "| `morphy` | 2 | 1 | 1 | 1 | 0.091 |"


def wet(flight: ControlFlight) -> ControlFlight:
    return replace(flight, wind_error=nan, wind_largest=nan)


def test_what_is_refused_is_not_flown() -> None:
    flights, refusals = fly_all(["base_rov"], ["lee_position_control"])
    assert (flights, [r.sim for r in refusals]) == ([], ["base_sim", "base_sim_2ms", "base_sim_4ms"])
    assert all(r.of_kind and r.refused.startswith("law 'position': moves sideways") for r in refusals)


def test_the_page_is_written_between_its_marks(tmp_path, monkeypatch, capsys) -> None:
    path = tmp_path / "control.md"
    path.write_text(f"before\n{BEGIN}\nof before\n{END}\nafter\n", encoding="utf-8")
    bent = replace(FLIGHT, robot="morphy", controller="lee_position_control", error=inf, overshoot=inf)
    refused = Refusal("morphy", "fully_actuated_control", "base_sim", "law ...")
    monkeypatch.setattr(
        control_table, "fly_all", lambda _robots, _laws, sims=None: ([bent], [refused]) if sims else ([FLIGHT], [])
    )
    ControlTableCmd(json=True, write=path, out=tmp_path).run()
    text = path.read_text(encoding="utf-8")
    assert text.startswith(f"before\n{BEGIN}\n## ")
    assert text.endswith(f"{END}\nafter\n")
    assert "2 flights in all tables; " in text
    assert "`magpie_*` from `magpie`" in text
    assert "of before" not in text
    assert "| `morphy` | 1 | 0 | 1 | 1 | inf |" in text
    row = json.loads(capsys.readouterr().out.partition("\n")[0])
    assert (row["limit_error"], row["limit_settling_s"]) == (180.0, None)
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
