"""What tests of the Synthesize place do again and again."""

from __future__ import annotations

from PySide6.QtCore import Qt

LEFT, NONE = Qt.MouseButton.LeftButton, Qt.KeyboardModifier.NoModifier
LONG = 30_000


def layer_kinds(place) -> list[type]:
    return [type(layer) for layer in place.view.shown.views[0].layers]


def wait_for_mesh(place, qtbot) -> None:
    def there() -> bool:
        if place.session.status_kind == "error":  # not an AssertionError, for which Qt's clock would be run down
            raise RuntimeError(place.session.status)
        return place.made is not None and not place.made.preview

    qtbot.waitUntil(there, timeout=LONG)
