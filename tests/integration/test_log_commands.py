"""``aerial-gym log``: exit status, JSON and files."""

import json
from pathlib import Path

import numpy as np
import pytest

from aerial_gym.cli.main import main
from aerial_gym.sim2real.findings import Finding
from aerial_gym.sim2real.wording import text
from tests.unit.sim2real.flat_flights import flight
from tests.unit.sim2real.ulog_files import topics, write_ulog


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Commands at 10 Hz and attitude at 20 Hz, PX4's default."""
    results = topics(flight(5, seconds=6.0, rate=200.0))
    stamp = results.pop("esc_status")["timestamp"][::10]
    results["actuator_motors"] = {"timestamp": stamp} | {f"control[{i}]": np.full(stamp.size, 0.5) for i in range(4)}
    results["vehicle_attitude"] = {key: values[::5] for key, values in results["vehicle_attitude"].items()}
    return write_ulog(tmp_path_factory.mktemp("logs") / "flight.bin", results)


def test_inspect_states_rates_and_their_consequences(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["log", "inspect", str(log), "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert (content["format"], len(content["flights"])) == ("ulog", 1)
    assert content["flights"][0]["streams"]["rotor_command"]["rate_hz"] == pytest.approx(10.0, rel=1e-3)
    assert any("10 Hz" in note for note in content["flights"][0]["notes"])
    assert main(["log", "inspect", str(log)]) == 0
    assert "vehicle_attitude[0]" in capsys.readouterr().out


def test_convert_and_plot_write_files(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["log", "convert", str(log), "--to", "csv", "--out", str(tmp_path)]) == 0
    assert Path(capsys.readouterr().out.strip()).exists()
    page = tmp_path / "flight.html"
    assert main(["log", "plot", str(log), "--out", str(page)]) == 0
    assert page.read_text(encoding="utf-8").count("<figure>") == 1


@pytest.mark.parametrize("form", ["ulg", "csv"])
def test_plot_draws_a_log_without_rotors_and_names_them(form: str, tmp_path: Path) -> None:
    table = flight(5, seconds=6.0, rate=200.0)
    results = {name: values for name, values in topics(table).items() if name != "esc_status"}
    if form == "ulg":
        write_ulog(tmp_path / "a.ulg", results)
    else:
        table.drop(columns=[f"rotor_{n}" for n in range(1, 5)]).to_csv(tmp_path / "a.csv", index=False)
    assert main(["log", "plot", str(tmp_path / f"a.{form}"), "--out", str(tmp_path / "page.html")]) == 0
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert page.count("<figure>") == 1
    quantities = ["rotor_speed", "rotor_command", *(["battery"] if form == "csv" else [])]
    assert text(Finding("quantities_absent", "", {"quantities": quantities})) in page
    assert main(["log", "inspect", str(tmp_path / f"a.{form}"), "--json"]) != 0  # comparisons still need rotors


def test_a_file_that_is_no_log_is_a_wrong_request(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.ulg").write_bytes(b"\x00\x01" * 600)
    for file in ("a.ulg", "none.ulg"):
        assert main(["log", "inspect", str(tmp_path / file)]) == 2
        assert file in capsys.readouterr().err
