"""Extension of griffe: the comment behind a field or constant is its docstring on the pages of the Python API."""

from typing import Any

import griffe

from docs.generate.markdown import trailing_comment


class TrailingComments(griffe.Extension):
    """Gives attributes without a docstring the comment at the end of their last line."""

    def on_attribute_instance(self, *, attr: griffe.Attribute, **_: Any) -> None:
        """Add the docstring of an attribute of a class or module."""
        if attr.docstring is None and attr.lines:
            text = trailing_comment(attr.lines[-1])
            attr.docstring = griffe.Docstring(text, parent=attr) if text else None
