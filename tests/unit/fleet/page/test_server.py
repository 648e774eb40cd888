"""Pages are escaped, confined to this machine and to the tables, and right while tables are written."""

import shutil
from collections.abc import Callable
from pathlib import Path
from threading import Thread
from urllib.parse import quote

import pytest
from deltalake import DeltaTable, write_deltalake

from aerial_gym.errors import ConfigError
from aerial_gym.fleet.page.server import PageServer
from tests.unit.fleet.page.fleet_tables import HOSTILE, add_rows, flight_row, make_tables, verdict_row, write_fleet
from tests.unit.fleet.page.servers import FLIGHTS, VEHICLES, Client

Open = Callable[[Path], Client]
PATHS = ("/", "/vehicles/alpha", f"/vehicles/{quote(VEHICLES[2], safe='')}", "/flights/0000000011", "/flights/bad2")


@pytest.mark.parametrize("path", PATHS)
def test_pages_escape_texts_of_logs_and_allow_no_script(client: Client, path: str) -> None:
    response = client.request(path)
    body = response.read().decode()
    assert response.status == 200
    assert "&lt;script&gt;alert(1)" in body
    assert "<script" not in body
    rules = response.headers["Content-Security-Policy"]
    assert "default-src 'none'" in rules
    assert "script-src" not in rules
    assert "http:" not in body.replace("http://127.0.0.1", "")
    assert "https:" not in body


def test_requests_with_texts_are_escaped_and_answered(client: Client) -> None:
    """Options of an address reach the page as text, and queries as parameters."""
    attack = quote(f"'; DROP TABLE current; --{HOSTILE}", safe="")
    body = client.page(f"/?text={attack}&verdict={attack}&sort={attack}&down={attack}&page={attack}")
    assert "<script" not in body
    assert "No vehicle fits this filter." in body
    assert client.json("fleet")["num_vehicles"] == len(VEHICLES)
    assert "<script" not in client.page(f"/vehicles/alpha?effect={attack}&axis={attack}&page=99999999999")


@pytest.mark.parametrize(
    "path", ["/vehicles/nobody", "/flights/nothing", "/else", "/vehicles", "/vehicles/a/b/c", f"/{HOSTILE}"]
)
def test_an_unknown_address_is_refused_with_a_sentence(client: Client, path: str) -> None:
    for prefix in ("", "/api"):
        response = client.request(prefix + quote(path))
        body = response.read().decode()
        assert response.status == 404
        assert "the tables hold no such vehicle, flight or report" in body
        assert prefix or "<script" not in body


def test_another_host_name_is_refused(client: Client) -> None:
    """A name of another site that leads to this machine must not read the tables."""
    assert client.request("/", Host=f"evil.example:{client.server.server_port}").status == 403
    assert client.request("/api/fleet", Host="127.0.0.1").status == 403
    assert client.request("/", Host=f"localhost:{client.server.server_port}").status == 200
    assert client.request("/", "POST").status == 501
    head = client.request("/", "HEAD")
    assert (head.status, head.read()) == (200, b"")
    assert client.server.server_address[0] == "127.0.0.1"


def test_only_reports_in_their_folder_are_served(tmp_path: Path, open_tables: Open) -> None:
    out = write_fleet(tmp_path / "tables", ["alpha", "..", "../up", "linked", "none"], 3)
    for folder in (out / "reports" / "alpha", out / "up", out / "reports" / "up", tmp_path / "outside"):
        folder.mkdir(parents=True)
        (folder / "report.html").write_text("<script>1</script>", encoding="utf-8")
    (out / "report.html").write_text("secret", encoding="utf-8")
    (out / "reports" / "linked").symlink_to(tmp_path / "outside")
    client = open_tables(out)
    report = client.request("/vehicles/alpha/report")
    assert (report.status, report.read()) == (200, b"<script>1</script>")
    assert report.headers["Content-Security-Policy"].startswith("sandbox allow-scripts; default-src 'none'")
    assert 'href="/vehicles/alpha/report"' in client.page("/vehicles/alpha")
    for name in ("..", "../up", "linked", "none", "up", "../../outside", "/etc", "alpha/../up"):
        response = client.request(f"/vehicles/{quote(name, safe='')}/report")
        assert response.status == 404, name
        assert b"secret" not in response.read()
    assert client.json("vehicles/%2E%2E")["report"]["exists"] is False
    assert client.request("/../fleet.json").status == 404
    assert client.request("/style.css/../../server.py").status == 404


def test_empty_tables_have_a_page_that_says_so(tmp_path: Path, open_tables: Open) -> None:
    client = open_tables(make_tables(tmp_path))
    assert "The tables hold no flights yet." in client.page("/")
    assert client.json("fleet")["flights"] == 0
    assert client.request("/vehicles/alpha").status == 404


def test_wrong_requests_name_the_remedy(tmp_path: Path, fleet: Path, client: Client) -> None:
    with pytest.raises(ConfigError, match="holds no fleet tables. Make them with: aerial-gym fleet run"):
        PageServer(tmp_path, 0)
    with pytest.raises(ConfigError, match="Choose another with --port"):
        PageServer(fleet, client.server.server_port)
    with pytest.raises(ConfigError, match="Choose another with --port"):
        PageServer(fleet, 70_000)


def test_pages_are_right_while_the_tables_are_written(tmp_path: Path, open_tables: Open) -> None:
    """Each answer is a state of the tables between two commits, and the last commit is shown."""
    out, commits = write_fleet(tmp_path, ["alpha"], 4), 8
    client, seen = open_tables(out), list[int]()

    def write() -> None:
        for number in range(commits):
            add_rows(out, "flights", [flight_row(f"new{number}{k}", "new", 10 * number + k) for k in range(5)])

    writer = Thread(target=write)
    writer.start()
    while writer.is_alive():
        seen.append(client.json("fleet")["flights"])
        client.page("/vehicles/alpha")
    writer.join()
    seen.append(client.json("fleet")["flights"])
    assert seen == sorted(seen)
    assert {(count - 4) % 5 for count in seen} == {0}
    assert seen[-1] == 4 + 5 * commits


def test_a_table_that_is_rewritten_and_cleaned_is_read_again(tmp_path: Path, open_tables: Open) -> None:
    """Old files vanish after a rewrite: the page is that of the new ones, and a lost table is said."""
    out = write_fleet(tmp_path, ["alpha"], 4)
    client = open_tables(out)
    before = client.json("vehicles/alpha")["effects"]
    write_deltalake(out / "evidence", DeltaTable(out / "evidence").to_pyarrow_table(), mode="overwrite")
    DeltaTable(out / "evidence").vacuum(retention_hours=0, dry_run=False, enforce_retention_duration=False)
    assert client.json("vehicles/alpha")["effects"] == before
    assert client.server.store.snapshot() is client.server.store.snapshot()
    shutil.rmtree(out / "evidence")
    response = client.request("/api/vehicles/alpha")
    assert response.status == 503
    assert b"The tables cannot be read" in response.read()


def test_a_run_in_progress_hides_no_verdict(tmp_path: Path, open_tables: Open) -> None:
    """Flights of a new model count once, and a vehicle shows its old verdict until the new one is written."""
    out = write_fleet(tmp_path, ["alpha"], 6)
    new = {"model_version": "0.3.0-def"}
    add_rows(out, "flights", [flight_row(f"00000{number:05d}", "alpha", number) | new for number in range(3)])
    client = open_tables(out)
    fleet, vehicle = client.json("fleet"), client.json("vehicles/alpha")
    assert (fleet["flights"], vehicle["flights"], vehicle["verdict"]) == (6, 6, "changed")
    key = {"vehicle": "alpha", "robot_hash": "robot"} | new
    add_rows(out, "verdicts", [key | verdict_row(5, "alpha", 4, 3)])
    vehicle = client.json("vehicles/alpha")
    assert (vehicle["flights"], vehicle["verdict"], len(vehicle["all_flights"])) == (3, "too_few_flights", 3)


def test_the_style_serves_both_colour_schemes_and_print(client: Client) -> None:
    style = client.page("/style.css")
    assert "prefers-color-scheme: dark" in style
    assert "@media print" in style
    assert "url(" not in style
    assert client.json("vehicles/alpha")["flights"] == FLIGHTS
