"""Sizes, fonts and the style sheet of the window, all made from the tokens of `palette`."""

from __future__ import annotations

from functools import lru_cache
from importlib import resources

from PySide6.QtGui import QFont, QFontDatabase
from PySide6.QtWidgets import QWidget

from shapeforge.viewer import palette

# The frame is the same in all five places, so that nothing moves when the place changes (pixels).
RAIL, HEADER, TOOL_ROW, INSPECTOR, STRIP = 80, 48, 44, 312, 104
MINIMUM_SIZE = (1280, 800)
PADDING = 16


@lru_cache(maxsize=1)
def family() -> str:
    """Name of the text font: the bundled Inter (OFL), so that the window looks the same everywhere."""
    for entry in (resources.files(__package__) / "fonts").iterdir():
        if entry.name.endswith(".otf"):
            QFontDatabase.addApplicationFontFromData(entry.read_bytes())
    return "Inter" if "Inter" in QFontDatabase.families() else QFont().defaultFamily()


def font(pixels: int = 13, weight: int = 400) -> QFont:
    """The text font with tabular figures, ``pixels`` high; weights 400 text, 500 controls, 600 headings."""
    result = QFont([family(), "DejaVu Sans"])
    result.setPixelSize(pixels)
    result.setWeight(QFont.Weight(weight))
    # Hinted stems of small text are a whole pixel wide: regular text would look bold.
    result.setHintingPreference(QFont.HintingPreference.PreferNoHinting)
    result.setFeature(QFont.Tag("tnum"), 1)
    return result


def colours(widget: QWidget) -> dict[str, str]:
    """The colour tokens of the theme that the widget's window is shown in."""
    return palette.tokens(widget.window().property("theme") or "dark")


def style_sheet(theme: palette.Theme) -> str:
    """The Qt style sheet of a theme."""
    # Wrapped in braces twice where Qt wants a brace: the template is an ordinary format string.
    return _TEMPLATE.format(**palette.tokens(theme), **_metrics())


def _metrics() -> dict[str, int]:
    return {"radius": 5, "pad": PADDING}


_TEMPLATE = """
* {{ font-size: 13px; color: {text}; outline: none; }}
QWidget#root, QWidget#rail, QDialog {{ background: {window}; }}
QDialog {{ border: 1px solid {separator_strong}; }}
QWidget#rail {{ border-right: 1px solid {separator}; }}
QWidget#header {{ background: {panel}; border-bottom: 1px solid {separator}; }}
QWidget#toolrow {{ background: {panel}; border-bottom: 1px solid {separator}; }}
QWidget#inspector {{ background: {panel}; border-left: 1px solid {separator}; }}
QWidget#strip {{ background: {panel}; border-top: 1px solid {separator}; }}
QWidget#centre, QWidget#start {{ background: {view}; }}
QWidget#panel, QScrollArea#panel, QScrollArea#panel > QWidget > QWidget {{ background: {panel}; border: none; }}
QWidget#view_row {{ background: {view}; border-bottom: 1px solid {separator}; }}
QWidget#view_foot {{ background: {view}; }}
QWidget#bar {{ background: {panel}; border-top: 1px solid {separator}; }}
QFrame#hline {{ background: {separator}; max-height: 1px; min-height: 1px; border: none; }}
QFrame#vline {{ background: {separator}; max-width: 1px; min-width: 1px; border: none; }}
QLabel {{ background: transparent; }}
QLabel[role="heading"] {{ font-weight: 600; }}
QLabel[role="title"] {{ font-size: 15px; font-weight: 600; }}
QLabel[role="large"] {{ font-size: 22px; font-weight: 600; }}
QLabel[role="text2"] {{ color: {text_2}; }}
QLabel[role="strong"] {{ font-weight: 500; }}
QLabel[role="off"] {{ color: {text_off}; }}
QLabel[role="warning"] {{ color: {warning}; }}
QLabel[role="caption"] {{ color: {text_2}; font-size: 11px; }}
QLabel[role="caption_off"] {{ color: {text_off}; font-size: 11px; }}
QLabel[role="caption_ok"] {{ color: {ok}; font-size: 11px; }}
QLabel[role="caption_warning"] {{ color: {warning}; font-size: 11px; }}
QLabel[role="caption_error"] {{ color: {error}; font-size: 11px; }}
QLabel[role="keycap"] {{ color: {text_2}; font-size: 11px; border: 1px solid {separator_strong};
  border-radius: 3px; padding: 0px 5px; min-height: 16px; max-height: 16px; }}
QPushButton {{ background: {control}; border: 1px solid {control}; border-radius: {radius}px; padding: 0 12px;
  min-height: 28px; max-height: 28px; font-weight: 500; }}
QPushButton:hover {{ background: {control_hover}; border-color: {control_hover}; }}
QPushButton:pressed {{ background: {separator_strong}; }}
QPushButton:focus {{ border-color: {accent}; }}
QPushButton:disabled {{ background: transparent; color: {text_off}; border-color: {separator}; }}
QPushButton:checked {{ background: {accent_ground}; border-color: {accent_ground}; color: {accent_text}; }}
QPushButton[kind="primary"] {{ background: {accent}; border-color: {accent}; color: {on_accent}; font-weight: 600; }}
QPushButton[kind="primary"]:hover {{ background: {accent_text}; border-color: {accent_text}; }}
QPushButton[kind="primary"]:focus {{ border-color: {text}; }}
QPushButton[kind="primary"]:disabled {{ background: transparent; color: {text_off}; border-color: {separator}; }}
QPushButton[kind="link"] {{ background: transparent; border: none; color: {accent_text}; padding: 0;
  font-weight: 400; }}
QPushButton[kind="link"]:hover, QPushButton[kind="link"]:focus {{ color: {text}; }}
QPushButton[kind="link"]:disabled {{ color: {text_off}; }}
QPushButton[kind="crumb"] {{ background: transparent; border: none; color: {text_2}; padding: 0; font-weight: 400; }}
QPushButton[kind="crumb"]:hover, QPushButton[kind="crumb"]:focus {{ color: {text}; }}
QPushButton[kind="crumb"]:disabled {{ color: {text}; font-weight: 600; }}
QPushButton[kind="icon"] {{ background: transparent; border: 1px solid transparent; padding: 0;
  min-width: 28px; max-width: 28px; }}
QPushButton[kind="icon"]:hover {{ background: {control_hover}; }}
QPushButton[kind="icon"]:checked {{ background: {accent_ground}; }}
QPushButton[kind="icon"]:focus {{ border-color: {accent}; }}
QPushButton[kind="tool"] {{ padding: 0; min-width: 28px; max-width: 28px; }}
QPushButton[kind="segment"] {{ background: transparent; border: 1px solid transparent; color: {text_2};
  padding: 0 11px; font-weight: 500; }}
QPushButton[kind="segment"]:hover {{ color: {text}; }}
QPushButton[kind="segment"]:checked {{ background: {accent_ground}; color: {text}; }}
QPushButton[kind="segment"]:focus {{ border-color: {accent}; }}
QPushButton[kind="segment"]:disabled {{ color: {text_off}; }}
QFrame#segments {{ background: {control}; border-radius: {radius}px; }}
QFrame#card {{ background: {control}; border: 1px solid {separator}; border-radius: {radius}px; }}
QFrame#card[current="true"] {{ border-color: {accent}; background: {accent_ground}; }}
QFrame#card:hover {{ border-color: {separator_strong}; }}
QFrame#card[current="true"]:hover {{ border-color: {accent}; }}
QFrame#note {{ background: {control}; border: 1px solid {separator_strong}; border-radius: {radius}px; }}
QFrame#sheet {{ background: {panel}; border: 1px solid {separator_strong}; }}
QFrame#preview {{ background: {view}; border-radius: {radius}px; }}
QFrame#row {{ background: transparent; border-radius: {radius}px; }}
QFrame#row:hover {{ background: {control}; }}
QFrame#row[current="true"] {{ background: {accent_ground}; }}
QFrame#row:focus {{ border: 1px solid {accent}; }}
QFrame#drop {{ border: 1px dashed {separator_strong}; border-radius: 8px; background: transparent; }}
QFrame#drop[over="true"] {{ border-color: {accent}; background: {accent_ground}; }}
QLineEdit {{ background: {window}; border: 1px solid {separator}; border-radius: {radius}px; padding: 0 8px;
  min-height: 28px; max-height: 28px; selection-background-color: {accent}; selection-color: {on_accent}; }}
QLineEdit:focus {{ border-color: {accent}; }}
QAbstractItemView {{ background: {control}; border: 1px solid {separator_strong}; border-radius: {radius}px;
  selection-background-color: {accent_ground}; selection-color: {text}; padding: 4px; }}
QTableWidget {{ background: {panel}; alternate-background-color: {panel}; border: 1px solid {separator};
  padding: 0; selection-background-color: {control}; }}
QTableWidget::item {{ padding: 0 8px; border: none; }}
QTableWidget::indicator {{ width: 14px; height: 14px; border: 1px solid {separator_strong}; border-radius: 3px;
  background: {control}; }}
QTableWidget::indicator:checked {{ background: {accent}; border-color: {accent}; }}
QComboBox {{ background: {control}; color: {text}; border: 1px solid {separator}; border-radius: {radius}px;
  padding: 0 8px; min-height: 28px; }}
QHeaderView {{ background: {panel}; border: none; }}
QHeaderView::section {{ background: {panel}; color: {text_2}; border: none; border-bottom: 1px solid {separator};
  padding: 6px 8px; font-size: 11px; }}
QMenu {{ background: {control}; border: 1px solid {separator_strong}; padding: 4px; }}
QMenu::item {{ padding: 6px 24px 6px 10px; border-radius: 4px; background: transparent; }}
QMenu::item:selected {{ background: {accent_ground}; color: {text}; }}
QMenu::item:disabled {{ color: {text_off}; }}
QMenu::separator {{ height: 1px; background: {separator}; margin: 4px 6px; }}
QMenu::icon {{ padding-left: 8px; }}
QToolTip {{ background: {tooltip}; color: {tooltip_text}; border: 1px solid {separator_strong}; padding: 3px 5px;
  font-size: 11px; }}
QScrollBar:vertical {{ background: transparent; width: 10px; margin: 0; border: none; }}
QScrollBar::handle:vertical {{ background: {separator_strong}; border-radius: 3px; min-height: 24px; margin: 2px; }}
QScrollBar:horizontal {{ background: transparent; height: 10px; margin: 0; border: none; }}
QScrollBar::handle:horizontal {{ background: {separator_strong}; border-radius: 3px; min-width: 24px; margin: 2px; }}
QScrollBar::add-line, QScrollBar::sub-line {{ width: 0; height: 0; }}
QScrollBar::add-page, QScrollBar::sub-page {{ background: transparent; }}
QSlider::groove:horizontal {{ height: 4px; background: {separator_strong}; border-radius: 2px; }}
QSlider::sub-page:horizontal {{ background: {accent}; border-radius: 2px; }}
QSlider::handle:horizontal {{
  background: #FFFFFF; border: 1px solid {separator_strong}; width: 12px; height: 12px;
  margin: -5px 0; border-radius: 7px;
}}
QSlider::handle:horizontal:disabled {{ background: {text_off}; }}
QSlider::sub-page:horizontal:disabled {{ background: {separator_strong}; }}
QProgressBar {{ background: {separator_strong}; border: none; border-radius: 2px; max-height: 4px; min-height: 4px; }}
QProgressBar::chunk {{ background: {accent}; border-radius: 2px; }}
"""
