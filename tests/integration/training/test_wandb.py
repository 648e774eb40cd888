"""Scalars to Weights & Biases, offline: what TensorBoard gets, from every trainer and over a resume."""

import json
import struct
from collections.abc import Iterator
from pathlib import Path

import pytest

from aerial_gym.cli.main import main
from tests.repetitions import rare_values

pytest.importorskip("wandb", reason="wandb is not installed: pip install 'aerial-gym[wandb]'")
pytest.importorskip("tensorboardX", reason="tensorboardX is not installed: pip install 'aerial-gym[wandb]'")
place = "tensorboard.backend.event_processing.event_accumulator"
event_accumulator = pytest.importorskip(place, reason="tensorboard is not installed")


def entries(content: bytes) -> Iterator[bytes]:
    """Give the entries of a .wandb file: a log of LevelDB, in blocks of 32 KiB of pieces, behind a header of 7 bytes. A
    piece is a check sum, its length, and whether it is a whole entry (1), the first, a middle or the last piece (2, 3,
    4)."""
    place, entry = 7, b""
    while place + 7 <= len(content):
        if (left := 32768 - place % 32768) < 7:
            place += left
            continue
        _, length, kind = struct.unpack_from("<IHB", content, place)
        if kind == 0:
            return
        entry += content[place + 7 : place + 7 + length]
        place += 7 + length
        if kind in (1, 4):
            yield entry
            entry = b""


def wandb_scalars(out: Path) -> dict[str, set[int]]:
    """Return the steps of each scalar in the files that wait to be sent."""
    from wandb.proto import wandb_internal_pb2

    result: dict[str, set[int]] = {}
    for file in out.glob("wandb/offline-run-*/*.wandb"):
        for data in entries(file.read_bytes()):
            record = wandb_internal_pb2.Record()
            record.ParseFromString(data)
            items = {item.key or "/".join(item.nested_key): item.value_json for item in record.history.item}
            for name in items.keys() - {"global_step", "_step", "_runtime", "_timestamp"}:
                result.setdefault(name, set()).add(int(json.loads(items["global_step"])))
    return result


def tensorboard_scalars(out: Path) -> dict[str, set[int]]:
    """Return the steps of each scalar in TensorBoard's files."""
    result: dict[str, set[int]] = {}
    for folder in {file.parent for file in out.rglob("events.out.tfevents*")}:
        events = event_accumulator.EventAccumulator(str(folder), size_guidance={"scalars": 0}).Reload()
        for name in events.Tags()["scalars"]:
            result.setdefault(name, set()).update(each.step for each in events.Scalars(name))
    return result


@pytest.mark.slow
@pytest.mark.parametrize("trainer", rare_values(["ppo", "rl_games", "sample_factory"], ("rl_games", "sample_factory")))
def test_every_scalar_of_tensorboard_is_sent(trainer: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if trainer != "ppo":
        pytest.importorskip(trainer, reason=f"{trainer} is not installed: pip install 'aerial-gym[rl]'")
    monkeypatch.setenv("WANDB_MODE", "offline")
    out, limits = tmp_path / "run", ("--max-time-s", "40", "--wandb", "hover")
    asked = ("--trainer", trainer, "--num-envs", "128", "--device", "cpu", "--max-env-steps", "9000", *limits)
    assert main(["train", *asked, "--out", str(out)]) == 0
    first = json.loads((out / "wandb.json").read_text())
    assert first["project"] == "hover"
    assert main(["train", "--out", str(out), "--resume", "--max-env-steps", "18000", *limits]) == 0
    assert json.loads((out / "wandb.json").read_text()) == first
    assert wandb_scalars(out) == tensorboard_scalars(out) != {}
