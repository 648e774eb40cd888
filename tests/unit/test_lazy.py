"""Names that are loaded when first used, and what is said about them before."""

import gc
import importlib.util
import sys
from pathlib import Path

import pytest

from aerial_gym.lazy import ImportPath, call_after_import, pause_garbage_collection
from aerial_gym.physics import BACKENDS, EFFECTS


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A package with one module, neither of them imported yet."""
    folder = tmp_path / "some_package"
    folder.mkdir()
    (folder / "__init__.py").write_text(
        "from typing import TYPE_CHECKING\n"
        "from aerial_gym.lazy import exports\n"
        "if TYPE_CHECKING:\n"
        "    from some_package.part import Thing\n"
        "__getattr__, __dir__ = exports(__name__, __file__)\n"
    )
    (folder / "part.py").write_text(
        'class Thing:\n    """Does it. And more.\n\n    More.\n    """\n\n'
        'class Other:\n    """No."""\n\n    summary = "the other one"\n'
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    for name in ("some_package", "some_package.part"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    return "some_package"


def test_a_name_is_loaded_when_it_is_first_used(package: str) -> None:
    module = importlib.import_module(package)
    assert "some_package.part" not in sys.modules
    assert "Thing" in dir(module)
    assert module.Thing is sys.modules["some_package.part"].Thing
    with pytest.raises(AttributeError, match="no attribute 'Think'. Known: Thing"):
        _ = module.Think


def test_a_summary_is_read_without_importing(package: str) -> None:
    assert ImportPath(f"{package}.part:Thing").summary() == "Does it. And more."
    assert ImportPath(f"{package}.part:Other").summary() == "the other one"
    assert "some_package.part" not in sys.modules
    assert type(ImportPath(f"{package}.part:Other").make()).__name__ == "Other"


def test_summaries_read_from_sources_are_those_of_the_objects() -> None:
    for name, summary in EFFECTS.summaries().items():
        assert EFFECTS.get(name).name == name
        assert EFFECTS.get(name).summary == summary
    for name, summary in BACKENDS.summaries().items():
        assert (BACKENDS.get(name).__doc__ or "").splitlines()[0] == summary


def test_garbage_is_looked_for_again_after_imports() -> None:
    with pause_garbage_collection():
        assert not gc.isenabled()
    assert gc.isenabled()
    assert gc.get_freeze_count() > 0  # of what was imported
    gc.unfreeze()
    gc.disable()
    try:
        with pause_garbage_collection():
            pass
        assert not gc.isenabled()
    finally:
        gc.enable()


def test_a_function_is_called_once_a_module_is_imported(package: str) -> None:
    calls: list[bool] = []
    call_after_import(f"{package}.part", lambda: calls.append(hasattr(sys.modules[f"{package}.part"], "Other")))
    importlib.import_module(package)
    importlib.util.find_spec(f"{package}.part")  # to look for a module is not to import it
    assert calls == []
    importlib.import_module(f"{package}.part")
    assert calls == [True]  # at the end of the import
    call_after_import(f"{package}.part", lambda: calls.append(False))
    assert calls == [True, False]  # it is imported already
    assert not any(type(finder).__name__ == "_ImportHook" for finder in sys.meta_path)
