"""The way between two shapes: the bar from A to B, and what it makes of the shape in hand."""

from __future__ import annotations

from typing import Any

from PySide6.QtCore import Qt, Signal
from PySide6.QtWidgets import QFrame, QSlider

from shapeforge.viewer.qt.controls import Choice
from shapeforge.viewer.qt.widgets import Picture, button, label, row
from shapeforge.viewer.sculptor import Recipe

AB_STEPS = 100


class BetweenBar(QFrame):
    """A at the left, B at the right, and how far from one to the other."""

    moved = Signal(float)
    released = Signal()
    ends_chosen = Signal(str, str)

    def __init__(self) -> None:
        super().__init__()
        self.setObjectName("bar")
        self.setFixedHeight(56)
        self.pictures = (Picture((44, 44)), Picture((44, 44)))
        self.choices = (Choice("A", (), ""), Choice("B", (), ""))
        self.choices[0].chosen.connect(lambda name: self.ends_chosen.emit(name, self.ends[1]))
        self.choices[1].chosen.connect(lambda name: self.ends_chosen.emit(self.ends[0], name))
        self.ends: tuple[str, str] = ("", "")
        self.slider = QSlider(Qt.Orientation.Horizontal)
        self.slider.setRange(0, AB_STEPS)
        self.slider.setAccessibleName("Between A and B")
        self.slider.valueChanged.connect(lambda value: self.moved.emit(value / AB_STEPS))
        self.slider.sliderReleased.connect(self.released)
        self.value = label("50%", "strong")
        self.value.setFixedWidth(40)
        swap = button(icon="swap", kind="tool", tooltip="Exchange A and B")
        swap.clicked.connect(lambda: self.ends_chosen.emit(self.ends[1], self.ends[0]))
        box = row(self.pictures[0], self.choices[0], self.slider, self.value, self.choices[1], self.pictures[1], swap,
                  spacing=10, margins=(16, 5, 16, 5))  # fmt: skip
        box.setStretch(2, 1)
        self.setLayout(box)

    def set_ends(self, names: tuple[str, ...], ends: tuple[str, str]) -> None:
        """The shapes to choose from, and A and B."""
        self.ends = ends
        for choice, name in zip(self.choices, ends, strict=True):
            choice.set_options(tuple((n, n) for n in names), name)

    def set_share(self, share: float) -> None:
        """Show how far from A to B (0..1), without telling."""
        self.slider.blockSignals(True)
        self.slider.setValue(round(share * AB_STEPS))
        self.slider.blockSignals(False)
        self.value.setText(f"{share:.0%}")


class Between:
    """Ties the bar to the Synthesize place: ``ends`` are A and B (None: not between two shapes)."""

    def __init__(self, place: Any) -> None:
        self.place = place
        self.ends: tuple[str, str] | None = None
        self.share = 0.5
        self._in_drag = False
        self.bar = BetweenBar()
        self.bar.setVisible(False)
        self.bar.moved.connect(self._moved)
        self.bar.released.connect(self._released)
        self.bar.ends_chosen.connect(self._choose)

    def toggle(self) -> None:
        """Begin, between the two shapes selected or the nearest one and one unlike it; or end."""
        place = self.place
        if self.ends is not None:
            self.end()
            place.wanted()
            return
        names = place.sculptor.shape_names
        chosen = [name for name in place.session.selected if name in names][:2]
        first = chosen[0] if chosen else place.sculptor.nearest(place.points)[0]
        ends = chosen if len(chosen) == 2 else [first, place.sculptor.other_end(first)]
        self._choose(ends[0], ends[1])
        self._released()

    def end(self) -> None:
        """The shape in hand is no longer between two."""
        self.ends = None
        self.bar.setVisible(False)
        self.place.between_button.setChecked(False)

    def end_if_left(self) -> None:
        """Undo or the history may have led to a shape that is not between A and B."""
        if self.ends is not None and self.place.sculptor.recipe.origin != " – ".join(self.ends):
            self.end()

    @property
    def is_dragged(self) -> bool:
        """Its slider is in hand."""
        return self.bar.slider.isSliderDown()

    def show_ends(self) -> None:
        """Pictures of A and B."""
        if self.ends is not None:
            for picture, name in zip(self.bar.pictures, self.ends, strict=True):
                picture.set_pixmap(self.place.thumbnails.shape(name, (88, 88), parts="fitted"))

    def _choose(self, first: str, second: str) -> None:
        self.ends = (first, second)
        self.bar.set_ends(self.place.sculptor.shape_names, self.ends)
        self.bar.setVisible(True)
        self.place.between_button.setChecked(True)
        self._moved(self.share)
        self.show_ends()
        if not self.is_dragged:
            self.place.after_step()

    def _moved(self, share: float) -> None:
        """Every move replaces the item of the history that this drag makes; letting go keeps it."""
        if self.ends is None:
            return
        self.share = share
        self.bar.set_share(share)
        place, sculptor = self.place, self.place.sculptor
        first, second = (sculptor.base_of(name) for name in self.ends)
        recipe = Recipe(
            f"A–B {share:.0%}", sculptor.between(first, second, share), origin=" – ".join(self.ends),
            route=sculptor.recipe.route, union=sculptor.recipe.union,
        )  # fmt: skip
        if sculptor.recipe.origin == recipe.origin and self.is_dragged and self._in_drag:
            sculptor.recipes[sculptor.done] = recipe
            place.session.sliders, place.session.pins = {}, {}
        else:
            sculptor.start(recipe)
        self._in_drag = self.is_dragged
        place.wanted()

    def _released(self) -> None:
        self._in_drag = False
        self.place.after_step()
