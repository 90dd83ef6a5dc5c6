"""The window's own line icons: a 16-px grid, 1.5-px strokes, round caps, one colour; drawn here, so no font is needed.

A widget that shows an icon is told the icon's name and the colour token (`set_icon`); when the theme changes,
`refresh` redraws all of them in the new colours.
"""

from __future__ import annotations

from functools import lru_cache

from PySide6.QtCore import QByteArray, QRectF, QSize, Qt
from PySide6.QtGui import QIcon, QPainter, QPixmap
from PySide6.QtSvg import QSvgRenderer
from PySide6.QtWidgets import QAbstractButton, QLabel, QWidget

from shapeforge.viewer import palette

# Path data on the 16-px grid; a leading "F" fills instead of stroking (play, stop and star only).
_PATHS: dict[str, tuple[str, ...]] = {
    "logo": ("M8 1.6 L13.6 4.8 V11.2 L8 14.4 L2.4 11.2 V4.8 Z", "M2.4 4.8 L8 8 L13.6 4.8 M8 8 V14.4"),
    "collection": ("M2 2.5h4.5v4.5H2z M9.5 2.5H14v4.5H9.5z M2 9.5h4.5V14H2z M9.5 9.5H14V14H9.5z",),
    "paint": (
        "M13.6 2.4 L7.2 8.2 a1.4 1.4 0 0 0 -.1 1.9 a1.4 1.4 0 0 0 1.9 .1 L14.2 3.2 Z",
        "M6.2 9.4 c-2 0 -2.6 1.4 -2.6 2.4 c0 1 -.8 1.7 -1.8 1.7 c2.6 1.4 6.6 .6 6.6 -2.2",
    ),
    "fit": ("M2.2 13.6 c2.8 0 3.2 -8.4 5.8 -8.4 s3 8.4 5.8 8.4", "M8 12.5V1.8 M5.8 3.8 L8 1.6 l2.2 2.2"),
    "correspondence": ("M8 3.8a4.2 4.2 0 1 0 0 8.4 a4.2 4.2 0 1 0 0 -8.4", "M8 1.2v4 M8 10.8v4 M1.2 8h4 M10.8 8h4"),
    "synthesize": (
        "M3.5 2v4.2 M3.5 9.8V14 M8 2v7.2 M8 12.8V14 M12.5 2v2.2 M12.5 7.8V14",
        "M3.5 6.2a1.8 1.8 0 1 0 0 3.6 a1.8 1.8 0 1 0 0 -3.6",
        "M8 9.2a1.8 1.8 0 1 0 0 3.6 a1.8 1.8 0 1 0 0 -3.6",
        "M12.5 4.2a1.8 1.8 0 1 0 0 3.6 a1.8 1.8 0 1 0 0 -3.6",
    ),
    "search": ("M7 2.2a4.8 4.8 0 1 0 0 9.6 a4.8 4.8 0 1 0 0 -9.6", "M10.5 10.5 L14 14"),
    "undo": ("M5.4 3 L2.4 6 l3 3", "M2.6 6h7a3.8 3.8 0 0 1 0 7.6H6"),
    "redo": ("M10.6 3 l3 3 l-3 3", "M13.4 6h-7a3.8 3.8 0 0 0 0 7.6H10"),
    "camera": ("M1.8 5.2h2.8l1.2-1.9h4.4l1.2 1.9h2.8v7.6H1.8z", "M8 6.6a2.2 2.2 0 1 0 0 4.4 a2.2 2.2 0 1 0 0 -4.4"),
    "more": (
        "FM3.2 6.9a1.15 1.15 0 1 0 0 2.3 a1.15 1.15 0 1 0 0 -2.3 M8 6.9a1.15 1.15 0 1 0 0 2.3 a1.15 1.15 0 1 0 0 -2.3"
        " M12.8 6.9a1.15 1.15 0 1 0 0 2.3 a1.15 1.15 0 1 0 0 -2.3",
    ),
    "map": (
        "M8 1.8v3.4 M8 10.8v3.4 M1.8 8h3.4 M10.8 8h3.4",
        "M4.2 4.2 l.01 .01 M11.8 4.2 l.01 .01 M4.2 11.8 l.01 .01 M11.8 11.8 l.01 .01",
    ),
    "grid": ("M2.5 2.5h4v4h-4z M9.5 2.5h4v4h-4z M2.5 9.5h4v4h-4z M9.5 9.5h4v4h-4z",),
    "down": ("M4 6.2 L8 10.2 l4 -4",),
    "up": ("M4 9.8 L8 5.8 l4 4",),
    "right": ("M6.2 4 L10.2 8 l-4 4",),
    "left": ("M9.8 4 L5.8 8 l4 4",),
    "plus": ("M8 3v10 M3 8h10",),
    "minus": ("M3 8h10",),
    "close": ("M4 4l8 8 M12 4l-8 8",),
    "lasso": (
        "M8 2.4c3.4 0 6 1.7 6 4s-2.6 4-6 4 -6-1.7-6-4 2.6-4 6-4z",
        "M4.6 9.6c-1.4 .6 -1.6 2.6 .2 2.6 c1.2 0 1.6 -1 1.2 -1.9 M5.4 12.2 c.2 1 -.2 1.8 -1.2 2.2",
    ),
    "swap": ("M2.2 5.4h11 M10.6 2.8l2.6 2.6-2.6 2.6", "M13.8 10.8h-11 M5.4 8.2l-2.6 2.6 2.6 2.6"),
    "rotate": ("M13.8 7.4c0-1.9-2.6-3.4-5.8-3.4S2.2 5.5 2.2 7.4s2.6 3.4 5.8 3.4", "M6.2 8.8l2 2-2 2"),
    "eye": (
        "M1.6 8S4 3.8 8 3.8 14.4 8 14.4 8 12 12.2 8 12.2 1.6 8 1.6 8z",
        "M8 6.2a1.8 1.8 0 1 0 0 3.6 a1.8 1.8 0 1 0 0 -3.6",
    ),
    "eye_off": ("M1.6 8S4 3.8 8 3.8 14.4 8 14.4 8 12 12.2 8 12.2 1.6 8 1.6 8z", "M3 13L13 3"),
    "check": ("M3 8.6l3.4 3.4L13 4.8",),
    "lock": ("M4 7.2h8v6H4z", "M5.6 7.2V5.2a2.4 2.4 0 0 1 4.8 0v2"),
    "unlock": ("M4 7.2h8v6H4z", "M5.6 7.2V5.2a2.4 2.4 0 0 1 4.6 -.9"),
    "error": ("M8 1.8a6.2 6.2 0 1 0 0 12.4 a6.2 6.2 0 1 0 0 -12.4", "M5.8 5.8l4.4 4.4 M10.2 5.8l-4.4 4.4"),
    "warning": ("M8 2L14.6 13.6H1.4z", "M8 6.4v3.2 M8 11.6v.05"),
    "info": ("M8 1.8a6.2 6.2 0 1 0 0 12.4 a6.2 6.2 0 1 0 0 -12.4", "M8 7.4v3.6 M8 5v.05"),
    "help": (
        "M8 1.8a6.2 6.2 0 1 0 0 12.4 a6.2 6.2 0 1 0 0 -12.4",
        "M6.2 6.3a1.9 1.9 0 1 1 2.6 1.9c-.6 .3-.8 .6-.8 1.2 M8 11.4v.05",
    ),
    "sun": (
        "M8 5.2a2.8 2.8 0 1 0 0 5.6 a2.8 2.8 0 1 0 0 -5.6",
        "M8 1.4v1.2 M8 13.4v1.2 M1.4 8h1.2 M13.4 8h1.2 M3.3 3.3l.9 .9 M11.8 11.8l.9 .9 M3.3 12.7l.9-.9 M11.8 4.2l.9-.9",
    ),
    "moon": ("M13.4 9.6A5.8 5.8 0 1 1 6.4 2.6a4.6 4.6 0 0 0 7 7z",),
    "keyboard": ("M1.6 4h12.8v8H1.6z", "M4.2 6.6v.05 M6.7 6.6v.05 M9.2 6.6v.05 M11.8 6.6v.05 M5 9.6h6"),
    "play": ("FM5 3.2 L12.6 8 L5 12.8 Z",),
    "pause": ("M5.6 3.4v9.2 M10.4 3.4v9.2",),
    "stop": ("FM4 4h8v8H4z",),
    "step": ("M4 3.6L9.6 8 4 12.4z", "M12 3.6v8.8"),
    "star": ("FM8 1.9l1.9 3.9 4.3 .6-3.1 3 .7 4.3L8 11.7l-3.8 2 .7-4.3-3.1-3 4.3-.6z",),
    "link": (
        "M6.6 9.4a2.6 2.6 0 0 0 3.7 0l2.3-2.3a2.6 2.6 0 0 0-3.7-3.7l-.9 .9",
        "M9.4 6.6a2.6 2.6 0 0 0-3.7 0L3.4 8.9a2.6 2.6 0 0 0 3.7 3.7l.9-.9",
    ),
    "home": ("M2.2 7.6L8 2.4l5.8 5.2", "M3.8 6.4v7.2h3v-3.4h2.4v3.4h3V6.4"),
    "folder": ("M1.8 3.6h4.4l1.4 1.8h6.6v7.4H1.8z",),
    "import": ("M8 2.2v7.4 M5 6.8l3 3 3-3", "M2.4 10.4v3.2h11.2v-3.2"),
    "export": ("M8 9.8V2.4 M5 5.2l3-3 3 3", "M2.4 10.4v3.2h11.2v-3.2"),
    "brush": (
        "M13.6 2.4 L7.2 8.2 a1.4 1.4 0 0 0 -.1 1.9 a1.4 1.4 0 0 0 1.9 .1 L14.2 3.2 Z",
        "M6.2 9.4 c-2 0 -2.6 1.4 -2.6 2.4 c0 1 -.8 1.7 -1.8 1.7 c2.6 1.4 6.6 .6 6.6 -2.2",
    ),
    "eraser": ("M9.4 2.8l4 4-6.4 6.4H4.6L2.4 11z", "M5.8 6.4l4 4 M7 13.4h6.6"),
    "fill": (
        "M7.6 2.2l5.4 5.4-5 5-5.4-5.4z M5.2 4.6L3.4 2.8 M2.8 7.6h10",
        "M14 10.4c.8 1.2 1 1.6 1 2.2a1 1 0 0 1-2 0c0-.6 .2-1 1-2.2z",
    ),
    "piece": ("M7 3.2l4.4 2.4v4.8L7 12.8 2.6 10.4V5.6z M2.6 5.6L7 8l4.4-2.4 M7 8v4.8", "M13 1.6v3.2 M11.4 3.2h3.2"),
    "scribble": ("M1.8 11.2c1-4 2.6-7 3.8-6.4s-1.4 6 0 6.6 2.4-6 3.6-5.4-.8 4.8 .4 5.2 1.8-2.4 4.2-3",),
    "eyedropper": ("M9 4.4l2.6 2.6-6 6H3v-2.6z", "M10.2 3.2l1-1a1.7 1.7 0 0 1 2.6 2.6l-1 1 M8 3.6L12.4 8"),
    "mirror": ("M8 1.6v12.8", "M6 3.6v8.8H1.6z M10 3.6v8.8h4.4z"),
    "pin": (
        "M8 14.2S3.4 9.6 3.4 6.4a4.6 4.6 0 0 1 9.2 0C12.6 9.6 8 14.2 8 14.2z",
        "M8 5a1.5 1.5 0 1 0 0 3 a1.5 1.5 0 1 0 0 -3",
    ),
    "ruler": ("M10.8 1.8l3.4 3.4-9 9-3.4-3.4z M8.6 4l1.4 1.4 M6.4 6.2l1.8 1.8 M4.2 8.4l1.4 1.4",),
    "sort": ("M3.4 2.6v10.6 M1.4 11.2l2 2 2-2", "M7.4 3.6h7 M7.4 7h5 M7.4 10.4h3"),
    "overlay": ("M6 4.2a3.9 3.9 0 1 0 0 7.8 a3.9 3.9 0 1 0 0 -7.8 M10 4.2a3.9 3.9 0 1 0 0 7.8 a3.9 3.9 0 1 0 0 -7.8",),
    "dice": ("M2.4 2.4h11.2v11.2H2.4z", "M5.4 5.4v.05 M10.6 5.4v.05 M8 8v.05 M5.4 10.6v.05 M10.6 10.6v.05"),
    "cube": ("M8 1.8l5.4 3.1v6.2L8 14.2l-5.4-3.1V4.9z", "M2.6 4.9L8 8l5.4-3.1 M8 8v6.2"),
    "between": (
        "M3 6.4a1.6 1.6 0 1 0 0 3.2 a1.6 1.6 0 1 0 0 -3.2 M13 6.4a1.6 1.6 0 1 0 0 3.2 a1.6 1.6 0 1 0 0 -3.2",
        "M4.8 8h6.4",
    ),
    "target": (
        "M8 2.2a5.8 5.8 0 1 0 0 11.6 a5.8 5.8 0 1 0 0 -11.6",
        "M8 6.4a1.6 1.6 0 1 0 0 3.2 a1.6 1.6 0 1 0 0 -3.2",
    ),
    "trash": ("M2.8 4.4h10.4 M6 4.2V2.4h4v1.8", "M4 4.6l.7 9h6.6l.7-9 M6.8 7v4 M9.2 7v4"),
    "copy": ("M5.4 5.4h8v8h-8z", "M10.4 5.2V2.6H2.6v7.8h2.6"),
    "clock": ("M8 1.8a6.2 6.2 0 1 0 0 12.4 a6.2 6.2 0 1 0 0 -12.4", "M8 4.6V8l2.4 1.6"),
}


def names() -> tuple[str, ...]:
    """Names of all icons."""
    return tuple(_PATHS)


@lru_cache(maxsize=1024)
def _drawn(name: str, colour: str, size: int, ratio: float) -> QPixmap:
    shapes = []
    for path in _PATHS[name]:
        if path.startswith("F"):
            shapes.append(f'<path d="{path[1:]}" fill="{colour}" stroke="{colour}" stroke-width=".6"/>')
        else:
            shapes.append(f'<path d="{path}"/>')
    # The stroke stays 1.5 px on the screen whatever the icon's size.
    svg = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 16 16" fill="none" stroke="{colour}" '
        f'stroke-width="{1.4 * 16 / size:.3f}" stroke-linecap="round" stroke-linejoin="round">{"".join(shapes)}</svg>'
    )
    pixmap = QPixmap(round(size * ratio), round(size * ratio))
    pixmap.setDevicePixelRatio(ratio)
    pixmap.fill(Qt.GlobalColor.transparent)
    painter = QPainter(pixmap)
    QSvgRenderer(QByteArray(svg.encode())).render(painter, QRectF(0, 0, size, size))
    painter.end()
    return pixmap


def pixmap(name: str, colour: str, size: int = 16, ratio: float = 2.0) -> QPixmap:
    """The icon ``name`` in "#RRGGBB", ``size`` logical pixels square, drawn for a screen of ``ratio``."""
    if name not in _PATHS:
        raise ValueError(f"name must be one of the icons ({', '.join(_PATHS)}), got {name!r}")
    return _drawn(name, colour, size, ratio)


def icon(name: str, theme: palette.Theme = "dark", role: str = "text_2", size: int = 16, gap: int = 0) -> QIcon:
    """The icon ``name`` in the colour token ``role``; its disabled form is drawn in the token "text_off".

    ``gap`` pixels stay free at its right (negative: left), towards the words of a button.
    """
    colours = palette.tokens(theme)
    result = QIcon(_with_gap(pixmap(name, colours[role], size), size, gap))
    result.addPixmap(_with_gap(pixmap(name, colours["text_off"], size), size, gap), QIcon.Mode.Disabled)
    return result


def _with_gap(drawn: QPixmap, size: int, gap: int) -> QPixmap:
    if gap == 0:
        return drawn
    ratio = drawn.devicePixelRatio()
    wide = QPixmap(round((size + abs(gap)) * ratio), round(size * ratio))
    wide.setDevicePixelRatio(ratio)
    wide.fill(Qt.GlobalColor.transparent)
    painter = QPainter(wide)
    painter.drawPixmap(max(-gap, 0), 0, drawn)
    painter.end()
    return wide


def set_icon(widget: QAbstractButton | QLabel, name: str, role: str = "text_2", size: int = 16) -> None:
    """Show an icon on a button or a label, now and after every change of the theme (see `refresh`)."""
    widget.setProperty("icon_name", name)
    widget.setProperty("icon_role", role)
    widget.setProperty("icon_size", size)
    _show(widget, widget.window().property("theme") or "dark")


def _show(widget: QAbstractButton | QLabel, theme: palette.Theme) -> None:
    name, role, size = (widget.property(key) for key in ("icon_name", "icon_role", "icon_size"))
    if isinstance(widget, QLabel):
        widget.setPixmap(pixmap(name, palette.tokens(theme)[role], size))
    else:
        gap = 0 if not widget.text() else -4 if widget.layoutDirection() == Qt.LayoutDirection.RightToLeft else 4
        widget.setIcon(icon(name, theme, role, size, gap))
        widget.setIconSize(QSize(size + abs(gap), size))


def refresh(root: QWidget, theme: palette.Theme) -> None:
    """Redraw every icon below ``root`` in the colours of ``theme``."""
    for kind in (QAbstractButton, QLabel):
        for widget in root.findChildren(kind):
            if widget.property("icon_name"):
                _show(widget, theme)
