"""Ways to look at new shapes: turning by itself, a movie of that, what a slider moves as heat, a gallery of draws."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from PySide6.QtCore import Qt, QTimer, Signal
from PySide6.QtGui import QPixmap
from PySide6.QtWidgets import QFrame, QGridLayout, QWidget

from shapeforge.viewer.mesh_worker import Made, Wish
from shapeforge.viewer.qt.controls import Clickable
from shapeforge.viewer.qt.icons import refresh
from shapeforge.viewer.qt.view3d import View3D
from shapeforge.viewer.qt.widgets import ElidedLabel, Picture, button, column, framed, label, row, scrolled
from shapeforge.viewer.redrawing import Redrawing, is_whole
from shapeforge.viewer.sculptor import Recipe
from shapeforge.viewer.sculpture import apart_words

SPIN_MS, SPIN_DEGREES = 40, 2.0
CARDS, COLUMNS = 12, (2, 3, 4, 6)
CARD, GAP, NAME = (174, 138), 12, 28  # pixels: the smallest picture, between cards, below the picture


class Spin:
    """Turns the camera of a view around the shape, a little at a time, until told to stop or until a hand turns it."""

    def __init__(self, view: View3D) -> None:
        self._view = view
        self._timer = QTimer(view, interval=SPIN_MS)
        self._timer.timeout.connect(self._turn)

    @property
    def is_on(self) -> bool:
        """Whether it turns now."""
        return self._timer.isActive()

    def set_on(self, on: bool) -> None:
        """Begin, or stop where it is."""
        if on:
            self._timer.start()
        else:
            self._timer.stop()

    def _turn(self) -> None:
        if self._view._drag is not None or not self._view.isVisible():
            return  # a hand is at it
        camera = self._view.scene.camera
        x, y, z = np.array(camera.GetPosition()) - np.array(camera.GetFocalPoint())
        azimuth, elevation = math.atan2(x, z), math.atan2(y, math.hypot(x, z))
        self._view.turn_to(math.degrees(azimuth) + SPIN_DEGREES, math.degrees(elevation))


class GalleryCard(Clickable):
    """One draw of the gallery."""

    def __init__(self, text: str, size: tuple[int, int]) -> None:
        self.picture = Picture(size)
        self.name = ElidedLabel(text, "caption")
        inside = column(self.picture, row(self.name, margins=(8, 0, 8, 0)), spacing=2, margins=(0, 0, 0, 6))
        super().__init__(inside, "card", tooltip="Click to take this one")
        self.setFixedSize(size[0] + 2, size[1] + NAME)


def card_layout(width: int, height: int) -> tuple[int, tuple[int, int]]:
    """How many columns of cards, and pictures of which size, show CARDS best in so many pixels; never below CARD."""
    best = (2, CARD)
    for columns in COLUMNS:
        rows = CARDS // columns
        wide = (width - GAP * (columns - 1)) // columns - 14 // columns - 2
        tall = (height - GAP * (rows - 1)) // rows - NAME
        fit = min(wide / CARD[0], max(tall / CARD[1], 1.0))
        if wide >= CARD[0] and fit >= best[1][0] / CARD[0]:
            best = columns, (int(fit * CARD[0]), int(fit * CARD[1]))
    return best


class Gallery(QFrame):
    """A dozen draws side by side: points at first, meshes as they are made; a click takes one."""

    chosen = Signal(int)
    closed = Signal()
    again = Signal()

    def __init__(self) -> None:
        super().__init__()
        self.setObjectName("centre")
        self.recipes: list[Recipe] = []
        self.made: dict[int, Made] = {}
        self.cards: list[GalleryCard] = []
        self.card_size = CARD
        more = button("Another dozen", icon="dice", tooltip="Twelve other draws")
        more.clicked.connect(self.again.emit)
        close = button(icon="close", kind="tool", tooltip="Back to the shape (Escape)")
        close.clicked.connect(self.closed.emit)
        head = framed(row(label("Gallery", "heading"), label("click one to take it", "caption"), None, more, close,
                          margins=(16, 8, 16, 8)))  # fmt: skip
        self._grid = QGridLayout()
        self._grid.setSpacing(GAP)
        self._grid.setContentsMargins(16, 8, 16, 16)
        self._grid.setAlignment(Qt.AlignmentFlag.AlignTop | Qt.AlignmentFlag.AlignHCenter)
        holder = QWidget()
        holder.setLayout(self._grid)
        whole = column(head, scrolled(holder), spacing=0)
        whole.setStretch(1, 1)
        self.setLayout(whole)
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)

    def keyPressEvent(self, event: Any) -> None:
        if event.key() == Qt.Key.Key_Escape:
            self.closed.emit()
        else:
            super().keyPressEvent(event)

    def show_recipes(self, recipes: list[Recipe], names: list[str], theme: str) -> None:
        """Cards for these draws, without meshes so far."""
        self.recipes, self.made = recipes, {}
        for card in self.cards:
            card.setParent(None)
            card.deleteLater()
        columns, self.card_size = card_layout(self.width() - 32, self.height() - 72)
        self.cards = []
        for i, name in enumerate(names):
            card = GalleryCard(name, self.card_size)
            card.clicked.connect(lambda i=i: self.chosen.emit(i))
            self._grid.addWidget(card, i // columns, i % columns)
            self.cards.append(card)
        refresh(self, theme)

    def show_pictures(self, picture: Callable[[int], QPixmap | None]) -> None:
        """Pictures that there are by now."""
        for i, card in enumerate(self.cards):
            card.picture.set_pixmap(picture(i))


class Shows:
    """Ties spinning, movies, heat and the gallery to the Synthesize place."""

    def __init__(self, place: Any) -> None:
        self.place = place
        self.spin = Spin(place.view)
        self.gallery = Gallery()
        self.gallery.setVisible(False)
        self.gallery.chosen.connect(self._take)
        self.gallery.closed.connect(lambda: self.show_gallery(False))
        self.gallery.again.connect(lambda: self.show_gallery(True))
        self.heated: int | None = None
        """The slider whose movement is shown as heat."""
        self._trials: list[Redrawing] = []
        self._looked_at: dict[int, Made] = {}

    # ---- turning -------------------------------------------------------------------------------------------------

    def toggle_spin(self) -> None:
        """Begin to turn, or stop."""
        self.spin.set_on(not self.spin.is_on)

    def export_movie(self) -> None:
        """One turn of the mesh as .gif, .webp or animated .png."""
        from shapeforge.viewer.movies import FORMATS, turntable, write_movie
        from shapeforge.viewer.qt.thumbnails import beside_qt

        place = self.place
        path = place.actions.desk.choose_save("Export a movie (gif, webp or png)", f"{place.sculptor.recipe.label}.gif")
        if path is None or place.made is None:
            return
        if path.suffix.lower() not in FORMATS:
            path = path.with_suffix(".gif")
        layer = place.sculptor.mesh_layer(place.made.shape)
        pictures: list[np.ndarray] = []

        def take() -> np.ndarray:
            pictures.extend(turntable(layer, theme=place.session.theme))
            return pictures[0]

        beside_qt(take)
        write_movie(path, pictures)
        place.session.say(f"Saved {path.name}: one turn, {len(pictures)} pictures", "ok")

    # ---- heat ----------------------------------------------------------------------------------------------------

    def heat(self, index: int | None) -> None:
        """Show how far a slider moves every point of the shape, from the low to the high end; None: the parts again."""
        if index != self.heated:
            self.heated = index
            self.place._show()

    # ---- gallery -------------------------------------------------------------------------------------------------

    def show_gallery(self, on: bool) -> None:
        """A dozen new draws instead of the shape, or the shape again."""
        place = self.place
        place.view.setVisible(not on)
        self.gallery.setVisible(on)
        place.gallery_button.setChecked(on)
        if not on:
            place.worker.ask_besides([])
            place.centre.setFocus()
            return
        recipes, names, wanted = [], [], []
        sculptor = place.sculptor
        self._trials, self._looked_at = [], {}
        for number in range(CARDS):
            drawn = self._drawn()
            self._trials.append(Redrawing(sculptor.draws, drawn))
            recipes.append(drawn)
            names.append(drawn.origin)
            wanted.append(self._wish(number, drawn, preview=True))
        self.gallery.show_recipes(recipes, names, place.session.theme)
        place.worker.ask_besides(wanted)
        self.show_pictures()
        self.gallery.setFocus()

    def _drawn(self, number: int | None = None, turn: int = 0) -> Recipe:
        """The next draw, or another in place of one, its mesh made as that of the shape in hand."""
        sculptor = self.place.sculptor
        drawn, now = sculptor.drawn(number, turn), sculptor.recipe
        return replace(drawn, route=now.route, union=now.union)

    def _wish(self, card: int, drawn: Recipe, *, preview: bool) -> Wish:
        sculptor = self.place.sculptor
        points, exists, symmetric = (ask(drawn) for ask in (sculptor.points, sculptor.exists, sculptor.symmetric))
        return Wish(card, points, exists, preview, route=drawn.route, symmetric=symmetric)

    def _look_at(self, card: int, made: Made) -> None:
        """A mesh came for a card: show it, or try another draw in its place.

        Previews do not hold parts together: one with a gap is made again as it would be taken before it is judged.
        """
        trial, gallery, again = self._trials[card], self.gallery, self.place.worker.ask_besides_too
        if made.preview and not is_whole(made):
            again(self._wish(card, trial.recipe, preview=False))
        elif trial.take(made):
            trial.tried.append(self._drawn(trial.number, trial.turn))
            gallery.recipes[card] = trial.recipe
            again(self._wish(card, trial.recipe, preview=False))
        else:
            gallery.recipes[card], gallery.made[card] = trial.result()
            if apart_words(gallery.made[card].shape.measures):
                gallery.cards[card].name.setText(f"draw {trial.number}, parts stay apart")

    def leave_gallery(self) -> None:
        """Back to the shape, if the gallery hides it: it has just been changed."""
        if self.gallery.isVisibleTo(self.place.centre):
            self.show_gallery(False)

    def show_pictures(self) -> None:
        """The gallery's cards with what there is by now."""
        if self.gallery.isVisible():
            for card, made in self.place.worker.made_besides().items():
                if self._looked_at.get(card) is not made:
                    self._looked_at[card] = made
                    self._look_at(card, made)
            self.gallery.show_pictures(self._picture)

    def _picture(self, i: int) -> QPixmap | None:
        from shapeforge.viewer.display import View
        from shapeforge.viewer.pictures import take_picture

        sculptor, theme, recipe = self.place.sculptor, self.place.session.theme, self.gallery.recipes[i]
        made = self.gallery.made.get(i)

        def take() -> np.ndarray:
            layer: Any = (
                sculptor.points_layer(sculptor.points(recipe), 2.0) if made is None else sculptor.mesh_layer(made.shape)
            )
            return take_picture(View((layer,)), self.gallery.card_size, theme, transparent=True)

        return self.place.thumbnails.pixmap(("gallery", id(recipe), made is None, theme, sculptor.inks.tobytes(),
                                            self.place.session.mesh_colours), take)  # fmt: skip

    def _take(self, i: int) -> None:
        recipe = self.gallery.recipes[i]
        self.show_gallery(False)
        self.place.take_up(recipe)
