"""Content of the pages: counts, sorting, filters, pages, histories, and the command of a report."""

import json
import shlex
from collections.abc import Callable
from pathlib import Path
from urllib.parse import quote, urlencode

import numpy as np
import pytest

from tests.unit.fleet.page.fleet_tables import add_rows, flight_row, make_tables, verdict_row, write_fleet
from tests.unit.fleet.page.servers import FLIGHTS, VEHICLES, Client

Open = Callable[[Path], Client]
COLUMN = {
    "vehicle": "vehicle",
    "since": "onset_flight",
    "evidence": "log_e",
    "flights": "flights",
    "firmware": "firmware",
}


def test_the_first_screen_counts_flights_refusals_and_changes(client: Client) -> None:
    fleet = client.json("fleet")
    assert (fleet["flights"], fleet["refused"]) == (len(VEHICLES) * FLIGHTS, 3)
    assert (fleet["num_vehicles"], fleet["num_changed"]) == (len(VEHICLES), 2)
    assert fleet["reasons"][0] == {"reason": "ends after the header", "logs": 2}
    assert [change["text"].split(",")[0] for change in fleet["changes"]] == ["vehicle alpha", "vehicle bravo"]
    assert fleet["verdicts"] == {
        "changed": 1,
        "ambiguous": 1,
        "shared": 0,
        "campaign": 0,
        "no_change": len(VEHICLES) - 2,
        "too_few_flights": 0,
        "not_testable": 0,
        "": 0,
    }
    assert sum(row["vehicles"] for row in fleet["cohorts"]) == len(VEHICLES)
    assert "rotor 3: -3.1 % (± 0.6 %) thrust since flight 9" in client.page("/")


def test_the_table_states_cause_size_and_onset_of_changed_vehicles(client: Client) -> None:
    first, second, third, *_ = client.json("fleet")["vehicles"]
    assert (first["vehicle"], first["cause"], first["size"]) == ("alpha", "weak motor, rotor 3", "-3.1 ± 0.6 %")
    assert (first["onset_low"], first["onset_flight"], first["onset_high"]) == (8, 9, 10)
    assert (second["cause"], second["size"]) == ("com offset", "x +0.0060 ± 0.0008 m")
    assert (third["cause"], third["size"]) == (None, None)


def test_significant_differences_between_firmware_versions_are_sentences(tmp_path: Path, open_tables: Open) -> None:
    out = write_fleet(tmp_path, ["alpha"], 4)
    one = {
        "firmware": ["1.14", "1.15"],
        "effect": "weak_motor",
        "rotor": 2,
        "parameters": ["scale"],
        "difference": [-0.02],
    }
    one |= {"low": [-0.03], "high": [-0.01], "rejected": True, "leading": True}
    (out / "cohorts.json").write_text(json.dumps([one, one | {"rejected": False}, one | {"leading": False}]))
    text = "firmware 1.15 against 1.14: weak motor, rotor 2: scale -0.02 (-0.03 to -0.01)"
    client = open_tables(out)
    assert client.json("fleet")["differences"] == [text]
    assert text in client.page("/")


@pytest.mark.parametrize(("sort", "column"), COLUMN.items())
@pytest.mark.parametrize("down", ["0", "1"])
def test_the_table_is_sorted_over_all_pages_with_unknown_values_last(
    client: Client, sort: str, column: str, down: str
) -> None:
    pages = [client.json(f"fleet?sort={sort}&down={down}&page={page}")["vehicles"] for page in (1, 2)]
    values = [row[column] for rows in pages for row in rows]
    known = [value for value in values if value is not None]
    assert [len(rows) for rows in pages] == [50, len(VEHICLES) - 50]
    assert values == sorted(known, reverse=down == "1") + [None] * (len(values) - len(known))
    assert len({row["vehicle"] for rows in pages for row in rows}) == len(VEHICLES)


def test_sizes_are_sorted_in_units_of_each_effect(client: Client) -> None:
    """6 mm are 1.2 moderate changes of the centre of mass (5 mm), 3.1 % are 0.62 of one of a motor (5 %)."""
    rows = client.json("fleet?sort=size&down=1")["vehicles"]
    assert [(row["vehicle"], round(row["scales"], 2)) for row in rows[:2]] == [("bravo", 1.2), ("alpha", 0.62)]


@pytest.mark.parametrize(
    ("options", "names"),
    [
        ({"text": "ALPHA"}, {"alpha"}), ({"text": "rotor 3"}, {"alpha"}), ({"verdict": "ambiguous"}, {"bravo"}),
        ({"text": "%"}, set()), ({"text": "script"}, {"alpha", "bravo", VEHICLES[2]}),
        ({"text": "v5", "verdict": "changed"}, set()),
    ],
)  # fmt: skip
def test_filters_are_plain_texts(client: Client, options: dict[str, str], names: set[str]) -> None:
    table = client.json(f"fleet?{urlencode(options)}")
    rows = {row["vehicle"] for row in table["vehicles"]}
    assert rows - {VEHICLES[1]} == names - {VEHICLES[1]}
    assert table["matches"] == len(rows)


def test_a_page_of_5000_vehicles_is_as_small_as_one_of_100(tmp_path: Path, open_tables: Open) -> None:
    out, names = make_tables(tmp_path), [f"v{n:04d}" for n in range(5000)]
    add_rows(out, "flights", [flight_row(f"hash{n}", name, n % 100) for n, name in enumerate(names)])
    key = {"robot_hash": "robot", "model_version": "0.2.0-abc"}
    add_rows(out, "verdicts", [key | {"vehicle": name} | verdict_row(9, name, 4, 3) for name in names])
    client = open_tables(out)
    assert len(client.page("/")) < 60_000
    last = client.json("fleet?sort=vehicle&page=999")
    assert (last["page"], last["pages"], last["vehicles"][-1]["vehicle"]) == (100, 100, "v4999")


def test_a_vehicle_shows_its_causes_first_and_then_effects_by_evidence(client: Client) -> None:
    """Payload mass is 15 log odds less probable for the first vehicle, and not told apart for the second one."""
    first, second = client.json("vehicles/alpha"), client.json("vehicles/bravo")
    assert [cause["candidate"] for cause in first["causes"]] == [True, False]
    assert [cause["candidate"] for cause in second["causes"]] == [True, True]
    assert [one["effect"] for one in first["effects"] if one["is_cause"]] == ["weak_motor"]
    assert [one["effect"] for one in second["effects"][:2]] == ["com_offset", "payload_mass"]
    scores = [one["score"] for one in first["effects"][1:]]
    assert scores == sorted(scores, reverse=True)
    assert "These flights do not tell apart: com offset, payload mass." in client.page("/vehicles/bravo")
    assert "do not tell apart:" not in client.page("/vehicles/alpha")


def test_a_vehicle_shows_its_flights_values_firmware_and_the_fleet(client: Client) -> None:
    vehicle = client.json("vehicles/bravo")
    assert [flight["number"] for flight in vehicle["shown_flights"]] == list(range(FLIGHTS, 0, -1))
    assert vehicle["updates"] == [{"number": 6, "before": "1.14.3", "after": "1.15.0"}]
    offset = vehicle["effects"][0]
    assert [one["number"] for one in offset["history"]] == list(range(1, FLIGHTS + 1))
    assert [one["name"] for one in offset["history"][0]["parameters"]] == ["x", "y", "z"]
    band = offset["fleet"]["x"]
    assert band["vehicles"] == len(VEHICLES)
    assert band["low"] < band["median"] < band["high"]
    values = [client.json(f"vehicles/{quote(name, safe='')}")["effects"] for name in VEHICLES[:3]]
    own = {one["effect"]: one["fleet"] for one in values[2]}["com_offset"]["x"]
    assert own["median"] == band["median"]
    assert own["value"] != band["value"]


def test_the_median_of_the_fleet_is_that_of_the_table(client: Client, fleet: Path) -> None:
    from deltalake import DeltaTable

    table = DeltaTable(fleet / "vehicles").to_pyarrow_table().to_pylist()
    values = [row["value"] for row in table if (row["effect"], row["parameter"]) == ("rotor_drag", "dy")]
    effects = {one["effect"]: one for one in client.json("vehicles/alpha")["effects"]}
    band = effects["rotor_drag"]["fleet"]["dy"]
    assert [band["low"], band["median"], band["high"]] == pytest.approx(np.quantile(values, [0.05, 0.5, 0.95]))


def test_a_flight_shows_its_evidence_checks_and_neighbours(client: Client) -> None:
    flight = client.json("flights/0000000004")
    assert (flight["number"], flight["previous"], flight["next"]) == (5, "0000000003", "0000000005")
    scores = [one["score"] for one in flight["effects"]]
    assert scores == sorted(scores, reverse=True)
    assert {one["name"]: one["text"].split(" ± ")[1][-2:] for one in flight["effects"][0]["parameters"]}
    refused = client.json("flights/bad0")
    assert (refused["number"], refused["reason"], refused["effects"]) == (0, "ends after the header", [])
    assert refused["start_time"] is None


def test_findings_are_sentences_and_unknown_ones_keep_their_code(tmp_path: Path, open_tables: Open) -> None:
    out = make_tables(tmp_path)
    known = {"code": "declared_explains", "subject": "", "values": {}}
    findings = [known, {"code": "of_tomorrow", "subject": "gyro", "values": {}}, {"code": "effect_found"}]
    add_rows(out, "flights", [flight_row("hash", "alpha", 0) | {"checks": json.dumps(findings)}])
    first, *rest = open_tables(out).json("flights/hash")["checks"]
    assert first.endswith(".")
    assert rest == ["gyro: of tomorrow", "effect found"]


def test_the_report_is_of_flights_on_one_side_of_the_change(tmp_path: Path, open_tables: Open) -> None:
    """The change is since flight 9 of 12: flights 9 to 11 predict flight 12, and flights 3 to 8 predict flight 2."""
    client = open_tables(write_fleet(tmp_path, ["a b; rm"], FLIGHTS))
    words = shlex.split(client.json(f"vehicles/{quote('a b; rm')}")["report"]["command"])
    assert words[:4] == ["aerial-gym", "close-loop", "--robot", "ROBOT.yaml"]
    train, test = words[words.index("--train") + 1 : words.index("--test")], words[words.index("--test") + 1]
    assert train == [f"logs/a b; rm/{number - 1:04d}.ulg" for number in (9, 10, 11)]
    assert test == "logs/a b; rm/0011.ulg"
    assert words[-1] == str(tmp_path / "reports" / "a b%3B rm")
    words = shlex.split(client.json("flights/0000000001")["report"]["command"])
    numbers = [int(Path(word).stem) + 1 for word in words[words.index("--train") + 1 : words.index("--test")]]
    assert numbers == [1, 3, 4, 5, 6, 7]


def test_a_limit_is_crossed_at_a_flight_if_a_log_states_no_time(
    tmp_path: Path, client: Client, open_tables: Open
) -> None:
    assert "crosses the limit of the run at 2027-04-05 00:00 UTC (median)" in client.page("/vehicles/bravo")
    out, key = make_tables(tmp_path), {"vehicle": "bravo", "robot_hash": "robot", "model_version": "0.2.0-abc"}
    add_rows(
        out,
        "flights",
        [flight_row(f"h{n}", "bravo", n) | {"start_time": float("nan"), "order": float(n)} for n in range(8)],
    )
    add_rows(out, "verdicts", [key | verdict_row(1, "bravo", 5, 8) | {"crosses_limit_at": 31.2}])
    body = open_tables(out).page("/vehicles/bravo")
    assert "crosses the limit of the run at flight 31 (median)" in body
    assert "Show over time" not in body


def test_a_single_flight_has_no_command_for_a_report(tmp_path: Path, open_tables: Open) -> None:
    client = open_tables(write_fleet(tmp_path, ["alpha"], 1))
    assert client.json("vehicles/alpha")["report"] == {"exists": False, "command": ""}
    assert "A report needs at least two flights" in client.page("/vehicles/alpha")
