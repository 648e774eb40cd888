"""Elements of an XML file that an importer does not use, one line for each kind."""

from collections.abc import Container, Iterable, Iterator, Mapping
from typing import Any
from xml.etree.ElementTree import Element

Tags = Mapping[str, Any]
"""Tags that are used, each with those used within it."""


def unread_elements(
    root: Element, used: Tags, *, left_out: Container[Element] = (), named: Container[Element] = ()
) -> Iterator[str]:
    """Yield the unused elements: ``sensor: front (camera), imu (imu)``, or ``limit of axis: rotor_0_joint``.

    Args:
        left_out: Elements that are not used although their tags are.
    """
    yield from by_kind(_pairs(root, used, root.get("name", ""), left_out, named))


def by_kind(pairs: Iterable[tuple[str, str]]) -> Iterator[str]:
    """Yield one line for each kind, with the names of that kind: ``kind: name, name``."""
    names_by_kind: dict[str, dict[str, None]] = {}
    for kind, name in pairs:
        names_by_kind.setdefault(kind, {})[name] = None
    for kind, names in names_by_kind.items():
        yield f"{kind}: {', '.join(names)}"


def _pairs(
    element: Element, used: Tags, owner: str, left_out: Container[Element], named: Container[Element]
) -> Iterator[tuple[str, str]]:
    for child in element:
        if child in named:
            continue
        inner = used.get(child.tag)
        if inner is None or child in left_out:
            yield _element_name(child, element, owner)
        else:
            yield from _pairs(child, inner, child.get("name") or child.get("reference") or owner, left_out, named)


def _element_name(element: Element, parent: Element, owner: str) -> tuple[str, str]:
    """Return the kind of an element and its name, or its owner's name."""
    name = element.get("name") or element.get("reference") or element.findtext("uri") or element.get("filename")
    more = element.get("type") or element.get("filename")
    if name is None:
        return f"{element.tag} of {parent.tag}", owner or parent.tag
    return element.tag, name if more in (None, name) else f"{name} ({more})"
