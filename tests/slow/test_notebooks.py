"""Notebooks of ``examples/notebooks`` run in a kernel of their own, and are kept without outputs."""

import json
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
NOTEBOOKS = sorted((ROOT / "examples" / "notebooks").glob("*.ipynb"))
CELL_S = 1800.0  # Longest time of a cell [s]


@pytest.mark.slow
@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(notebook: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    nbclient = pytest.importorskip("nbclient", reason="nbclient is not installed: pip install 'aerial-gym[dev]'")
    nbformat = pytest.importorskip("nbformat")
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    book = nbformat.read(notebook, as_version=4)
    resources = {"metadata": {"path": str(tmp_path)}}
    nbclient.NotebookClient(book, timeout=CELL_S, kernel_name="python3", resources=resources).execute()
    if notebook.stem == "identify":
        verdict = json.loads((tmp_path / "corrected" / "verdict.json").read_text(encoding="utf-8"))
        (effect,) = verdict["effects"]
        assert effect["name"] == "rotor_drag"
        assert [effect["params"][axis] for axis in ("dx", "dy")] == pytest.approx([0.15, 0.15], abs=0.01)
        harder = json.loads((tmp_path / "harder" / "verdict.json").read_text(encoding="utf-8"))
        assert harder["verdict"] == "ambiguous"
        assert "weak_motor" in [effect["name"] for effect in harder["effects"]]


def test_there_are_three_notebooks_without_outputs() -> None:
    assert [path.stem for path in NOTEBOOKS] == ["identify", "own_task", "train_and_look"]
    for path in NOTEBOOKS:
        cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
        assert not [cell for cell in cells if cell.get("outputs") or cell.get("execution_count")], path.name
