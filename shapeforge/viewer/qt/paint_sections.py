"""Sections of the Paint inspector below the palette: the brush, scribbles, and what comes next."""

from __future__ import annotations

import numpy as np
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QBoxLayout, QFrame, QSlider, QWidget

from shapeforge.viewer.actions import Actions, next_to_paint
from shapeforge.viewer.painter import BRUSH_LIMITS, Painter
from shapeforge.viewer.qt.bind import Binding, action_button, keep_enabled
from shapeforge.viewer.qt.controls import Segments, Switch
from shapeforge.viewer.qt.widgets import button, column, heading, icon_label, label, row, section, shortened
from shapeforge.viewer.readiness import starts_from_proposal
from shapeforge.viewer.session import Session

SIZE_STEPS = 200


class BrushSection(QWidget):
    """Size and reach of the brush, where the fill stops, and mirroring."""

    def __init__(self, session: Session, actions: Actions) -> None:
        super().__init__()
        self.session, self.actions = session, actions
        self.size = QSlider(Qt.Orientation.Horizontal)
        self.size.setRange(0, SIZE_STEPS)
        self.size.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.size.setToolTip("Radius of the brush, in percent of the shape's size  ([ and ], or the wheel)")
        self.size.valueChanged.connect(self._size_slid)
        self.size_value = label("", "strong")
        self.size_value.setFixedWidth(44)
        self.size_value.setAlignment(Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter)
        self.reach = Segments((("surface", "Surface", ""), ("through", "Through", "")), self.session.reach)
        for value in ("surface", "through"):
            self.reach.button(value).setMinimumWidth(96)
        self.reach.button("through").setToolTip("Paint what lies behind, too, within the brush's size")
        self.reach.chosen.connect(lambda value: setattr(self.session, "reach", value))
        self.reach.button("surface").setToolTip("Paint what is seen: along the surface, or what the lasso sees")
        self.fill = Segments((("creases", "Creases", ""), ("patch", "Patch", "")), self.session.fill_to)
        for value in ("creases", "patch"):
            self.fill.button(value).setMinimumWidth(96)
        self.fill.button("creases").setToolTip("Fill stops where the surface bends sharply  (Shift+F changes)")
        self.fill.button("patch").setToolTip(
            "Fill stops where the surface folds inward or its thickness changes: for rounded shapes  (Shift+F changes)"
        )
        self.fill.chosen.connect(lambda value: setattr(self.session, "fill_to", value))
        self.mirror = Switch(self.session.mirror, tooltip="Paint the opposite side too  (M)")
        self.mirror.clicked.connect(lambda: self.actions.run("mirror"))
        self.mirror_error = label("", "caption")
        box = section(
            label("Brush", "heading"),
            _named("Size", self.size, self.size_value),
            _named("Reach", self.reach, None),
            _named("Fill to", self.fill, None),
            _named("Mirror", self.mirror, label("left ↔ right"), None, self.mirror_error),
        )
        self.setLayout(column(box, spacing=0))

    def _size_slid(self, value: int) -> None:
        low, high = BRUSH_LIMITS
        size = low * (high / low) ** (value / SIZE_STEPS)
        if abs(np.log(size / self.session.brush_size)) > 0.5 * np.log(high / low) / SIZE_STEPS:
            self.session.brush_size = float(size)

    def show_brush(self) -> None:
        """Show size and reach."""
        low, high = BRUSH_LIMITS
        self.size_value.setText(f"{100 * self.session.brush_size:.1f}%")
        place = round(SIZE_STEPS * np.log(self.session.brush_size / low) / np.log(high / low))
        self.size.blockSignals(True)
        self.size.setValue(int(place))
        self.size.blockSignals(False)
        self.reach.set_value(self.session.reach)
        self.fill.set_value(self.session.fill_to)

    def show_mirror(self, painter: Painter) -> None:
        """Show whether the painter's shape has a mirror plane, and how good."""
        plane = painter.mirror_plane
        self.mirror.setEnabled(plane is not None)
        self.mirror_error.setText(f"±{100 * plane[2]:.1f}%" if plane is not None else "not symmetric")
        self.mirror_error.setToolTip("Mean distance between the shape and its mirror image, of its size")


def scribble_section(actions: Actions, binding: Binding) -> QWidget:
    """What the Scribble tool does, and the button that does it at once."""
    about = "One stroke on each part with the Scribble tool: pieces like it follow, one leg speaks for four."
    words = label(about, "caption", wrap=True)
    complete = action_button(actions, "complete", binding)
    return section(heading("Scribble", "", label("S", "keycap")), words, complete, line=False)


class NextSection(QFrame):
    """The foot of the inspector: fit the family, or why that cannot be done yet and what to paint next."""

    def __init__(self, session: Session, actions: Actions, binding: Binding) -> None:
        super().__init__()
        self.session, self.actions = session, actions
        self.setObjectName("bar")
        self.fit = button("Fit the family", kind="primary")
        self.fit.clicked.connect(lambda: self.actions.run("fit_family"))
        keep_enabled(self.fit, self.actions, "fit_family", binding)
        self.fit_icon = icon_label("info", "warning", 14)
        self.fit_why = label("", "caption", wrap=True)
        self.go_exemplar = button("", kind="link")
        self.go_exemplar.clicked.connect(lambda: self.actions.run("paint_next"))
        why = row(self.fit_icon, self.fit_why, spacing=8)
        why.setAlignment(self.fit_icon, Qt.AlignmentFlag.AlignTop)
        why.setStretch(1, 1)
        self.setLayout(
            column(label("Next", "heading"), self.fit, why, self.go_exemplar, spacing=8, margins=(16, 12, 16, 16))
        )

    def show_next(self, verdict: tuple[bool, str], present: str | None) -> None:
        """Say whether the family can be fitted, or its fit taken up again, and, if not, why; ``present`` is painted."""
        if self.session.project is None:
            return
        can, why = verdict
        proposed = starts_from_proposal(self.session)
        done = (
            "The fit starts from the proposed parts; paint is evidence." if proposed else "Every exemplar is painted."
        )
        again = can and self.actions.verdict("refit")[0]
        self.fit.setText("Refit from here" if again else "Fit the family")
        self.fit_why.setText("The fit is taken up again with this paint." if again else done if can else why)
        self.fit_icon.setVisible(not can)
        following = None if proposed else next_to_paint(self.session)
        self.go_exemplar.setVisible(following is not None and following != present)
        self.go_exemplar.setText(f"Paint {shortened(following or '')}")
        self.go_exemplar.setToolTip(f"Go to {following}, the next exemplar without paint" if following else "")


def _named(name: str, *widgets: QWidget | None) -> QBoxLayout:
    title = label(name, "text2")
    title.setFixedWidth(64)
    return row(title, *widgets, spacing=8)
