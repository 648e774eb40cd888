"""Registries and the Global Tensor Dictionary."""

import pytest
import torch

from aerial_gym.errors import DuplicateNameError, OwnershipError, ShapeError, UnknownNameError
from aerial_gym.registry import GlobalTensorDictionary, Registry, TensorSpec


def spec(key: str = "speed", shape: tuple[str | int, ...] = ("E", 3)) -> TensorSpec:
    return TensorSpec(key=key, shape=shape, unit="m/s", frame="world", owner="physics", meaning="how fast")


def test_registry_returns_entries_and_lists_names() -> None:
    registry: Registry[int] = Registry("number")
    registry.register("two", 2)
    registry.register("one", 1)
    assert registry.get("two") == 2
    assert registry.names() == ("one", "two")
    assert list(registry) == ["two", "one"]
    assert "one" in registry
    assert len(registry) == 2


def test_registry_refuses_a_second_entry_and_helps_with_a_missing_one() -> None:
    registry: Registry[int] = Registry("robot")
    registry.register("quad_x", 1)
    with pytest.raises(DuplicateNameError, match="robot 'quad_x' is registered already"):
        registry.register("quad_x", 2)
    with pytest.raises(UnknownNameError, match="no robot 'quadx'. Did you mean 'quad_x'\\? Known: quad_x"):
        registry.get("quadx")
    with pytest.raises(UnknownNameError, match="Known: none"):
        Registry("robot").get("a")


def test_gtd_allocates_once_and_refuses_replacement() -> None:
    gtd = GlobalTensorDictionary(device="cpu", sizes={"E": 4})
    tensor = gtd.declare(spec())
    assert tensor.shape == (4, 3)
    assert gtd["speed"] is tensor
    with pytest.raises(OwnershipError, match=r"gtd\['speed'\]\[:\] = value"):
        gtd["speed"] = torch.ones(4, 3)
    gtd["speed"][:] = 1.0
    assert tensor.sum() == 12
    with pytest.raises(DuplicateNameError, match="declared already, by physics"):
        gtd.declare(spec())


def test_gtd_takes_views_and_checks_them() -> None:
    gtd = GlobalTensorDictionary(device="cpu", sizes={"E": 4})
    root = gtd.declare(spec("root", ("E", 13)))
    view = gtd.declare(spec("position"), view=root[:, :3])
    view.fill_(2.0)
    assert root[:, :3].eq(2.0).all()
    with pytest.raises(ShapeError, match=r"view is \(4, 2\)"):
        gtd.declare(spec("other"), view=root[:, :2])
    with pytest.raises(ShapeError, match="float64"):
        gtd.declare(spec("other"), view=root[:, :3].double())


def test_gtd_names_unknown_keys_letters_and_sizes() -> None:
    gtd = GlobalTensorDictionary(device="cpu", sizes={"E": 4})
    with pytest.raises(UnknownNameError, match="no GTD key 'a'. Known: none"):
        gtd["a"]
    with pytest.raises(ShapeError, match="shape letter 'Q' has no size. Known: E"):
        gtd.declare(spec(shape=("E", "Q")))
    with pytest.raises(ShapeError, match="size E = 5: it is 4 already"):
        gtd.define_size("E", 5)


def test_gtd_prints_its_schema() -> None:
    gtd = GlobalTensorDictionary(device="cpu", sizes={"E": 4})
    gtd.declare(spec())
    head, row = str(gtd).splitlines()
    assert head.split() == ["key", "shape", "dtype", "unit", "frame", "owner", "meaning"]
    assert row.split("  ")[0] == "speed"
    assert "(E, 3) = (4, 3)" in row
    assert "float32" in row
    assert row.endswith("how fast")
    assert gtd.spec("speed").unit == "m/s"


def test_an_entry_for_later_is_made_once_and_only_when_requested() -> None:
    registry: Registry[list[int]] = Registry("list")
    made: list[int] = []
    registry.register_later("one", lambda: made.append(1) or [1], summary=lambda: "a one")
    assert (registry.names(), len(registry), "one" in registry) == (("one",), 1, True)
    assert registry.summaries() == {"one": "a one"}
    assert made == []
    assert registry.get("one") is registry.get("one")
    assert made == [1]
    with pytest.raises(DuplicateNameError, match="'one' is registered already"):
        registry.register_later("one", list)
