"""Effects sorted by kind."""

import torch

from aerial_gym.physics import EFFECTS
from aerial_gym.physics.effects import EffectsByKind, LoadEffect, WindEffect, WrenchEffect


def some() -> EffectsByKind:
    """Return a load, a drag, a wind and another drag, in this order, each with parameters of its number."""
    names = ("slung_payload", "rotor_drag", "constant_wind", "quadratic_drag")
    return EffectsByKind((EFFECTS.get(name), torch.full((2, 3), float(i))) for i, name in enumerate(names))


def effect_names(effects: EffectsByKind) -> list[str]:
    return [effect.name for effect, _ in effects]


def test_effects_of_a_kind_keep_their_order() -> None:
    effects = some()
    assert [effect.name for effect, _ in effects[WrenchEffect]] == ["rotor_drag", "quadratic_drag"]
    assert [effect.name for effect, _ in effects[WindEffect]] == ["constant_wind"]
    assert EffectsByKind()[WindEffect] == ()


def test_forces_come_by_kind_and_the_load_last() -> None:
    forces = some().step_effects
    assert [effect.name for effect, _ in forces] == ["constant_wind", "rotor_drag", "quadratic_drag", "slung_payload"]
    assert [float(params[0, 0]) for _, params in forces] == [2.0, 1.0, 3.0, 0.0]
    assert LoadEffect.order == max(effect.order or 0 for effect in map(EFFECTS.get, EFFECTS))
    assert some().names_with_memory == ("slung_payload",)


def test_changes_make_others() -> None:
    effects = some()
    assert effect_names(effects.exclude(LoadEffect)) == ["rotor_drag", "constant_wind", "quadratic_drag"]
    assert effect_names(effects.with_effect(EFFECTS.get("gusts"), torch.zeros(2, 2)))[-1] == "gusts"
    doubled = effects.with_params(lambda effect, params: params * (2.0 if isinstance(effect, WindEffect) else 1.0))
    assert [float(params[0, 0]) for _, params in doubled] == [0.0, 1.0, 4.0, 3.0]
    assert effect_names(effects) == effect_names(doubled)


def test_places_follow_one_another_without_a_gap() -> None:
    names = ("battery_sag", "joint_spring", "constant_wind")
    effects = EffectsByKind((EFFECTS.get(name), torch.zeros(2, len(EFFECTS.get(name).parameters))) for name in names)
    places = effects.places(num_rotors=5)
    assert [place.effect.name for place in places] == ["constant_wind", "joint_spring", "battery_sag"]
    assert [place.params for place in places] == [slice(0, 3), slice(3, 6), slice(6, 7)]
    assert [place.memory for place in places] == [slice(0, 0), slice(0, 5), slice(5, 7)]
