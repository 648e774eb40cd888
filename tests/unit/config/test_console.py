"""Console of progress bars."""

import pytest

from aerial_gym.config import console


@pytest.mark.parametrize("widgets", [None, object()])
def test_bars_are_text_in_a_notebook_without_widgets(widgets: object, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rich.console._is_jupyter", lambda: True)
    monkeypatch.setattr(console, "find_spec", lambda _: widgets)
    chosen = console.progress_console()
    assert chosen.is_jupyter == (widgets is not None)
    assert chosen.is_terminal or widgets is not None


def test_bars_are_left_out_of_a_file(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rich.console._is_jupyter", lambda: False)
    assert not console.progress_console().is_terminal
