"""Registries, the Global Tensor Dictionary, and its guarded tensors."""

import copy
import io
import operator
import pickle
from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
import torch
from torch import Tensor

from aerial_gym.errors import DuplicateNameError, OwnershipError, ShapeError, UnknownNameError
from aerial_gym.registry import GlobalTensorDictionary, Registry, TensorSpec
from tests.refusals import assert_refused


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
    assert_refused(DuplicateNameError, "robot 'quad_x' is registered already", registry.register, "quad_x", 2)
    assert_refused(UnknownNameError, "no robot 'quadx'. Did you mean 'quad_x'\\? Known: quad_x", registry.get, "quadx")
    with pytest.raises(UnknownNameError, match="Known: none"):
        Registry("robot").get("a")


def test_texts_of_registry_and_gtd_are_short_and_a_near_key_is_offered() -> None:
    registry: Registry[int] = Registry("number")
    registry.register("two", 2)
    assert repr(registry) == "Registry: 1 entries of kind number: two"
    gtd = GlobalTensorDictionary(device="cpu", sizes={"E": 4})
    gtd.declare(spec())
    assert repr(gtd) == "GlobalTensorDictionary: 1 tensors on cpu, E = 4; print shows all"
    assert "how fast" in str(gtd)
    assert_refused(UnknownNameError, "no GTD key 'sped'. Did you mean 'speed'\\? Known: speed", gtd.__getitem__, "sped")


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
    assert_refused(ShapeError, "size E = 5: it is 4 already", gtd.define_size, "E", 5)


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
    assert_refused(DuplicateNameError, "'one' is registered already", registry.register_later, "one", list)


def _augment(name: str, t: Tensor) -> None:
    getattr(operator, name)(t, 2.0)


AUGMENTED = ("iadd", "isub", "imul", "itruediv", "ifloordiv", "imod", "ipow")
WRITES: dict[str, Callable[[Tensor], object]] = {
    "one element": lambda t: t.__setitem__((0, 0), 5.0),
    "a slice": lambda t: t.__setitem__(slice(None), 5.0),
    "a mask": lambda t: t.__setitem__(t > 2.0, 5.0),
    "numbers at indices": lambda t: t.__setitem__(torch.tensor([0]), 5.0),
    "a view": lambda t: t[1].fill_(5.0),
    "a view of a view": lambda t: t.view(-1)[1:].unsqueeze(0).mT.zero_(),
    "a part of a split": lambda t: t.split(1, dim=-1)[0].zero_(),
    "a row of an iteration": lambda t: next(iter(t)).zero_(),
    "data": lambda t: t.data.fill_(5.0),
    "detached": lambda t: t.detach().fill_(5.0),
    "in place": lambda t: t.add_(1.0),
    **{f"augmented {name}": partial(_augment, name) for name in AUGMENTED},
    "copy": lambda t: t.copy_(torch.zeros(2, 3)),
    "random numbers": lambda t: t.normal_(),
    "out": lambda t: torch.add(torch.ones(2, 3), 1.0, out=t),
    "a function in place": lambda t: torch.nn.functional.relu(t, inplace=True),
    "an initialiser": lambda t: torch.nn.init.zeros_(t),
    "a list of tensors": lambda t: torch._foreach_add_([t], 1.0),
    "other memory": lambda t: t.set_(torch.zeros(2, 3).untyped_storage()),
    "another size": lambda t: t.resize_(7),
    "another shape": lambda t: t.unsqueeze_(0),
}
RESHAPED = ("other memory", "another size", "another shape")


def dictionary() -> tuple[GlobalTensorDictionary, Tensor]:
    gtd = GlobalTensorDictionary(device="cpu", sizes={"E": 2})
    told = {"unit": "kg", "frame": "-", "owner": "robot", "meaning": "a parameter"}
    plain = gtd.declare(TensorSpec(key="mass", shape=("E", 3), **told))
    plain.copy_(torch.arange(6.0).reshape(2, 3))
    return gtd, plain


def make_refusal() -> tuple[Tensor, Tensor]:
    gtd, plain = dictionary()
    gtd.refuse("mass", "write something else")
    return gtd["mass"], plain


@pytest.mark.parametrize("way", WRITES)
@pytest.mark.parametrize("mode", [torch.no_grad, torch.inference_mode])
def test_a_refused_write_raises_and_changes_nothing(way: str, mode: Callable) -> None:
    shown, plain = make_refusal()
    with mode(), pytest.raises(OwnershipError, match="'mass'"):
        WRITES[way](shown)
    assert torch.equal(plain, torch.arange(6.0).reshape(2, 3))


@pytest.mark.parametrize("way", [way for way in WRITES if way not in RESHAPED])
@pytest.mark.parametrize("mode", [torch.no_grad, torch.inference_mode])
def test_a_watched_write_goes_through_and_is_noticed(way: str, mode: Callable) -> None:
    gtd, plain = dictionary()
    noticed: list[bool] = []
    gtd.watch("mass", lambda: noticed.append(True))
    expected = torch.arange(6.0).reshape(2, 3)
    with mode():
        torch.manual_seed(0)
        WRITES[way](gtd["mass"])
        torch.manual_seed(0)
        WRITES[way](expected)
    assert noticed
    assert torch.equal(plain, expected)


def test_reading_is_not_a_write_and_gives_plain_tensors() -> None:
    gtd, plain = dictionary()
    noticed: list[bool] = []
    gtd.watch("mass", lambda: noticed.append(True))
    shown = gtd["mass"]
    for result in (
        shown * 2.0, shown.clone(), torch.cat((shown, plain)), shown[shown > 2.0], shown @ plain.T, shown.double(),
        torch.where(shown > 1.0, shown, plain), copy.deepcopy(shown), pickle.loads(pickle.dumps(shown)),
    ):  # fmt: skip
        assert type(result) is Tensor
    plain_copy = torch.zeros(2, 3).copy_(shown)
    assert torch.equal(plain_copy, plain)
    assert (shown[0, 1].item(), shown.tolist(), float(shown[1, 2])) == (1.0, plain.tolist(), 5.0)
    assert repr(shown) == repr(plain)
    assert shown.data_ptr() == plain.data_ptr()
    torch.save(shown, io.BytesIO())
    assert not noticed


def test_it_shows_what_the_owner_writes() -> None:
    shown, plain = make_refusal()
    view = shown[:, 1]
    plain.fill_(7.0)
    assert shown.tolist() == plain.tolist()
    assert view.tolist() == [7.0, 7.0]


def test_gradients_flow_past_it() -> None:
    shown, plain = make_refusal()
    x = torch.ones(2, 3, requires_grad=True)
    (x * shown).sum().backward()
    assert torch.equal(x.grad, plain)


@pytest.mark.slow
def test_compiled_functions_read_it() -> None:
    shown, plain = make_refusal()

    @torch.compile(backend="aot_eager")
    def scale_first(a: Tensor, b: Tensor) -> Tensor:
        return 2.0 * a + b

    assert torch.equal(scale_first(shown, plain), 3.0 * plain)


def test_arrays_of_it_are_read_only_and_dlpack_shares_the_memory() -> None:
    shown, plain = make_refusal()
    for array in (shown.numpy(), np.asarray(shown)):
        assert array.__array_interface__["data"][0] == plain.data_ptr()
        with pytest.raises(ValueError, match="read-only"):
            array[0, 0] = 1.0
    assert np.asarray(shown, dtype=np.float64).dtype == np.float64
    np.array(shown)[0, 0] = 1.0  # a copy
    assert plain[0, 0] == 0.0
    assert np.from_dlpack(shown).__array_interface__["data"][0] == plain.data_ptr()
    assert torch.from_dlpack(shown).data_ptr() == plain.data_ptr()


@pytest.mark.parametrize("way", RESHAPED)
def test_memory_and_shape_stay_where_writes_are_taken(way: str) -> None:
    gtd, plain = dictionary()
    gtd.watch("mass", lambda: None)
    with pytest.raises(AttributeError):
        WRITES[way](gtd["mass"])
    with pytest.raises(AttributeError):
        gtd["mass"].data = torch.zeros(2, 3)
    assert plain.shape == (2, 3)


def test_the_table_marks_it() -> None:
    gtd, plain = dictionary()
    assert "read-only" not in str(gtd)
    gtd.refuse("mass", "write something else")
    assert "read-only" in str(gtd)
    assert gtd.plain("mass") is plain
    assert gtd.spec("mass").key == "mass"
    assert list(gtd.state_tensors().values()) == [plain] or gtd.state_tensors()["mass"] is plain
