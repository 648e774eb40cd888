"""The tables of ``benchmarks.control.control_table``: what stands in their cells, and what is written to a page."""

import json
from dataclasses import replace
from math import inf, nan
from pathlib import Path

import pytest

from benchmarks.control import control_table
from benchmarks.control.control_flights import Flight
from benchmarks.control.control_table import (
    BEGIN,
    END,
    Refusal,
    fly_all,
    foreign_table,
    refusals_table,
    sims_table,
    table,
    wind_table,
)

FLIGHT = Flight(
    robot="magpie", controller="magpie_position_control", law="position", sim="base_sim", error=0.0058, settling_s=4.7,
    overshoot=0.0, tilt_rad=0.1, wind_error=0.4946, wind_largest=0.51, limit_share=0.92, limit_settling_s=inf,
    limit_overshoot=0.046, limit_error=180.0, response=(0.5, 1.0),
)  # fmt: skip


def test_a_row_says_what_came_of_the_flights_and_who_was_lost() -> None:
    row = table([FLIGHT]).splitlines()[-1]
    assert row == (
        "| `magpie` | `magpie_position_control` | 0.0058 m | 4.7 s, 0% | 0.49, 0.51 m | 92%, > 10 s, 5%, 1.8e+02 m **lost** |"
    )
    wet = replace(FLIGHT, wind_error=nan, error=1e-5, tilt_rad=2.0, limit_error=0.1, limit_settling_s=5.0)
    assert "| < 0.001 m **fell** | 4.7 s, 0% | - | 92%, 5 s, 5%, 0.1 m |" in table([wet])


def test_gains_on_another_vehicle_stand_in_a_table_of_their_own() -> None:
    foreign = replace(FLIGHT, robot="lmf2", overshoot=0.08)
    refusals = [
        Refusal("tinyprop", "magpie_position_control", "base_sim", "robot tinyprop ... is nearly unstable"),
        Refusal("base_rov", "magpie_position_control", "base_sim", "law 'position': moves sideways by leaning"),
    ]
    assert "lmf2" not in table([FLIGHT, foreign])
    rows = foreign_table(
        [FLIGHT, foreign, *(replace(FLIGHT, robot=r.robot, controller="pid") for r in refusals)], refusals
    )
    assert "| `lmf2` | - | 4.7 s, 8%, 0.0058 m | - | - |" in rows
    assert "| `tinyprop` | - | refused | - | - |" in rows
    assert "| `base_rov` | - | not for it | - | - |" in rows
    refusals += [replace(r, controller="magpie_velocity_control") for r in refusals]
    names = "`magpie_position_control`, `magpie_velocity_control`"
    assert refusals_table(refusals).splitlines()[-1] == f"| {names} | `base_rov` | `tinyprop` | - | - |"


def test_sims_are_compared_over_the_robots_of_a_controller() -> None:
    law = replace(FLIGHT, controller="lee_position_control", limit_error=0.0)
    others = [replace(law, robot=f"r{i}", settling_s=2.0 + i, overshoot=0.01 * i) for i in range(3)]
    lost = replace(others[0], sim="base_sim_2ms", limit_error=11.0)
    assert "| `lee_position_control` | 3: 3 s, 2% | 1: 2 s, 0%, 1 lost | - |" in sims_table([*others, lost])


def test_what_is_left_of_the_error_in_wind_by_controller() -> None:
    law = replace(FLIGHT, controller="lee_position_control", wind_error=0.49, wind_largest=0.5)
    falls = replace(law, controller="px4_position_control", wind_error=0.1)
    rows = wind_table([law, replace(law, robot="lmf2", wind_error=0.45), replace(law, law="rates"), falls, wet(law)])
    assert rows.splitlines()[2:] == [
        "| `lee_position_control` | 2 | 94% | 90% (`lmf2`) |",
        "| `px4_position_control` | 1 | 20% | 20% (`magpie`) |",
    ]


def wet(flight: Flight) -> Flight:
    return replace(flight, wind_error=nan, wind_largest=nan)


def test_what_is_refused_is_not_flown() -> None:
    flights, refusals = fly_all(["base_rov"], ["lee_position_control"])
    assert flights == []
    assert [r.sim for r in refusals] == ["base_sim", "base_sim_2ms", "base_sim_4ms"]
    assert all(r.of_kind and r.refused.startswith("law 'position': moves sideways") for r in refusals)


def test_the_page_is_written_between_its_marks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "control.md"
    path.write_text(f"before\n{BEGIN}\nof before\n{END}\nafter\n", encoding="utf-8")
    bent = replace(FLIGHT, robot="morphy", controller="lee_position_control", error=inf, overshoot=inf)
    refused = Refusal("morphy", "fully_actuated_control", "base_sim", "law ...")
    monkeypatch.setattr(
        control_table, "fly_all", lambda _robots, _laws, sims=None: ([bent], [refused]) if sims else ([FLIGHT], [])
    )
    monkeypatch.setattr("sys.argv", ["control_table", "--json", "--write", str(path), "--out", str(tmp_path)])
    control_table.main()
    text = path.read_text(encoding="utf-8")
    assert text.startswith(f"before\n{BEGIN}\n2 flights; ")
    assert text.endswith(f"{END}\nafter\n")
    assert "`magpie_*` of `magpie`" in text
    assert "of before" not in text
    assert "| `morphy` | `lee_position_control` | inf m | **lost** |" in text
    assert "Not flown: `morphy_fixed_base`, whose base is on a stand; `snakey`, `snakey_effort`, `snakey5`," in text
    assert "- `fully_actuated_control`: `morphy`" in text
    row = json.loads(capsys.readouterr().out.partition("\n")[0])
    assert (row["limit_error"], row["limit_settling_s"]) == (180.0, None)
    assert (tmp_path / "control_steps.png").stat().st_size > 10_000
