"""The report is one page that stands alone, shows every shape, and never shows what is not there."""

from __future__ import annotations

import base64
import io
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from PIL import Image

from shapeforge.deformation.components import PartCounts
from shapeforge.generative.units import bundles
from shapeforge.viewer import likeness, svg
from shapeforge.viewer.pictures import close_studio
from shapeforge.viewer.report import chosen_shapes, report_text, write_report
from shapeforge.viewer.report_html import table
from shapeforge.viewer.report_measures import flattened
from shapeforge.viewer.report_sections import BUNDLES, fit, parts, phases_of, recorded_movement
from tests.viewer.learned_family import learned_family


@pytest.fixture(scope="module", autouse=True)
def studio():
    yield
    close_studio()


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A project with everything in it, whose name needs escaping."""
    return learned_family(tmp_path_factory, "chairs & <more>")


class Page(HTMLParser):
    """Collects what a page is made of."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.images: list[dict] = []
        self.addresses: list[str] = []
        self.anchors: set[str] = set()
        self.open: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        found = dict(attributes)
        if tag == "img":
            self.images.append(found)
        self.addresses += [found[key] for key in ("src", "href", "data", "action") if key in found]
        if "id" in found:
            self.anchors.add(found["id"])
        if tag not in ("img", "meta", "line", "rect", "circle", "polyline", "br", "wbr"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        if tag in ("line", "rect", "circle", "polyline", "meta", "img"):
            return
        assert self.open and self.open[-1] == tag, f"</{tag}> closes <{self.open[-1:]}>"
        self.open.pop()


def pictures_of(page):
    for image in page.images:
        kind, data = image["src"].split(",", 1)
        assert kind == "data:image/png;base64"
        yield image, np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGBA"))


def test_page_before_the_fit_has_no_empty_sections(grouped, tmp_path):
    text = write_report(grouped, tmp_path / "new folder" / "report.html").read_text(encoding="utf-8")
    assert Page(text).anchors == {"overview", "groups", "shapes", "problems"}
    assert "empty.obj" in text, "the file that could not be read is named"
    assert not list((tmp_path / "new folder").glob("*.tmp"))


def test_without_opengl_it_says_what_to_install(grouped, tmp_path, monkeypatch):
    monkeypatch.setattr("shapeforge.viewer.report.find_library", lambda name: None)
    monkeypatch.setattr("sys.platform", "linux")
    with pytest.raises(RuntimeError, match="libEGL is missing.*apt install"):
        write_report(grouped, tmp_path / "report.html")
    assert not list(tmp_path.glob("*.html*"))


def test_page_stands_alone_and_is_whole(whole):
    text = report_text(whole)
    page = Page(text)
    assert not page.open, f"left open: {page.open}"
    assert page.anchors >= {"overview", "groups", "shapes", "parts", "fit", "family", "new", "measures"}
    for address in page.addresses:
        assert address.startswith(("data:image/", "#")), address[:80]
    assert not re.search(r"url\(|@import|<script|<link|https?://(?!www\.w3\.org)", text)
    assert str(whole.path.parent) not in text, "a path of the maker's machine is in the page"
    assert "prefers-color-scheme:dark" in text
    assert "chairs &amp; &lt;more&gt;" in text and "<more>" not in text
    for anchor in [a[1:] for a in page.addresses if a.startswith("#")]:
        assert anchor in page.anchors


def test_every_shape_is_there_three_times_and_looks_different(whole):
    text = report_text(whole)
    page = Page(text)
    by_alt = {image["alt"]: picture for image, picture in pictures_of(page)}
    for name in whole.names:
        given, parts, places = (by_alt[f"{name}, {words}"] for words in ("as given", "parts", "correspondence"))
        for picture in (given, parts, places):
            solid = picture[picture[..., 3] > 200]
            assert 0.02 < len(solid) / picture[..., 0].size < 0.9, name
        assert np.ptp(given[given[..., 3] > 200][:, :3].astype(int), axis=1).max() < 40, "as given is grey"
        colourful = parts[parts[..., 3] > 200][:, :3].astype(int)
        assert (np.ptp(colourful, axis=1) > 80).mean() > 0.5
        assert not np.array_equal(parts, places)
    found = bundles(whole.machine(), whole.observations(), BUNDLES)
    for shown, words in ((whole.directions(), ("low end", "high end")), (found, ("at 0", "at ½", "at 1"))):
        assert shown and all(f"{one.name}, {end}" in by_alt for one in shown for end in words)
        assert sum(image["alt"].endswith(words[0]) for image in page.images) == len(shown)
        assert all(text.count(f"<small>{end}</small>") == len(shown) for end in words)
    low, half, high = (by_alt[f"{found[0].name}, {end}"].astype(int) for end in ("at 0", "at ½", "at 1"))
    assert not np.array_equal(low, half) and not np.array_equal(half, high), "a bundle must be seen to do something"
    for name in whole.draws()["names"]:
        assert name in by_alt


def test_components_and_copies_of_every_part_are_told(whole, monkeypatch):
    name = whole.fit_names[1]
    counts = PartCounts(
        np.array([4, *[0] * (whole.part_of_point.max())]), np.array([2, *[0] * whole.part_of_point.max()])
    )
    asked = whole.part_counts
    monkeypatch.setattr(type(whole), "part_counts", lambda self, one: counts if one == name else asked(one))
    text = parts(whole, whole.fit_names[:3])
    for one in whole.fit_names[:3]:
        cells = re.search(rf"<tr><td>{one}</td>(.*?)</tr>", text).group(1)
        found = [re.sub("<.*?>", "", cell) for cell in cells.split("</td>")[:-1]]
        if one == name:
            assert found == ["4 + 2", *["–"] * (len(found) - 1)]
        else:
            assert found == [str(n or "–") for n in asked(one).components.tolist()]


def test_every_picture_has_words_and_a_size(whole):
    for image, picture in pictures_of(Page(report_text(whole))):
        assert image["alt"] and (int(image["height"]), int(image["width"])) == picture.shape[:2]


def test_measures_given_are_shown_beside_the_baseline(whole):
    corr = {"0.05": 0.75, "0.1": 0.9}
    figures = {
        "left_out": ["chair <1>"],
        "segmentation": {
            "faces": 0.912345,
            "n": 2,
            "shapes": {"x": {"faces": 0.111}},
            "affine_transfer": {"faces": 0.8},
        },
        "correspondence": {"corr": corr, "affine_transfer": {"corr": {"0.05": 0.5, "0.1": 0.6}}},
        "other": {"what <it> is": 1234567.0},
    }
    text = report_text(whole, measures=figures)
    Page(text)
    row = re.search(r"<tr><td>faces with the true part</td>(.*?)</tr>", text).group(1)
    assert re.findall(r"[\d.]+", row) == ["0.912", "0.800"]
    assert "<td>corr@0.05</td><td class=n>0.750</td><td class=n>0.500</td>" in text
    assert "0.111" not in text, "figures of single shapes would drown the rest"
    assert "chair &lt;1&gt;" in text and "what &lt;it&gt; is" in text and "1\u202f234\u202f567" in text
    assert "landmarks within it (%)" in text
    assert flattened({"a": {"b_c": 1.5}, "list": [1, 2]}) == [("a: b c", "1.5")]


def test_movement_is_that_of_the_recorded_rounds(whole):
    moved = recorded_movement(whole)
    name = whole.fit_names[0]
    rounds = [np.asarray(points, float) for points in whole.rounds(name)]
    assert len(moved) == len(rounds) - 1 >= 1
    for k in range(len(moved)):
        if rounds[k].shape == rounds[k + 1].shape:
            assert moved[k, 0] == pytest.approx(np.linalg.norm(rounds[k + 1] - rounds[k], axis=1).mean())


def test_few_of_many_shapes_keep_the_exemplars(grouped):
    exemplars = {grouped.names[t] for t in grouped.groups.exemplars}
    few = len(exemplars) + 2
    shown = chosen_shapes(grouped, few)
    assert len(shown) == few and exemplars <= set(shown)
    assert chosen_shapes(grouped, few) == shown
    assert set(chosen_shapes(grouped, 100)) == set(grouped.names)
    assert f"{few} of {len(grouped.names)} shapes" in report_text(grouped, most=few)


# -- pictures and plots -----------------------------------------------------------------------------------------------


def test_small_palette_keeps_the_picture_and_blackens_shadows():
    rng = np.random.default_rng(0)
    picture = np.zeros((40, 40, 4), np.uint8)
    picture[5:20, 5:35] = [86, 180, 233, 255]
    picture[5:20, 5:35, :3] += rng.integers(0, 9, (15, 30, 3), dtype=np.uint8)
    picture[25:30] = [0, 0, 0, 60]
    picture[19, 5:35, 3] = 128
    data = likeness.data_address(picture).split(",", 1)[1]
    again = np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGBA")).astype(int)
    assert np.abs(again[5:19, 5:35] - picture[5:19, 5:35]).max() <= 8
    assert (again[25:30, :, :3] == 0).all() and np.abs(again[25:30, :, 3] - 60).max() <= 8
    assert (again[0, :, 3] == 0).all() and np.abs(again[19, 5:35, 3] - 128).max() < 24


def test_blended_colours_are_exact_on_the_places():
    places = np.random.default_rng(1).normal(size=(50, 3))
    colours = np.random.default_rng(2).integers(0, 255, (50, 3)).astype(np.uint8)
    np.testing.assert_array_equal(likeness.blended(places, colours, places), colours)
    one = likeness.blended(places[:1], colours[:1], places)
    assert (one == colours[0]).all()


@pytest.mark.parametrize(("low", "high"), [(0.0, 1.0), (-3.2, 17.1), (0.0021, 0.0134), (5.0, 5.0), (-1e5, 2e5)])
def test_ticks_are_round_and_cover(low, high):
    ticks = svg.nice_ticks(low, high)
    assert ticks[0] <= low and ticks[-1] >= high and 3 <= len(ticks) <= 8
    steps = np.diff(ticks)
    np.testing.assert_allclose(steps, steps[0])
    mantissa = steps[0] / 10 ** np.floor(np.log10(steps[0]))
    assert min(abs(mantissa - m) for m in (1, 2, 2.5, 5, 10)) < 1e-6


def test_curve_draws_what_it_is_given():
    text = svg.curve([0, 1, 2], [svg.Series("a<b", [3.0, 1.0, np.nan])], x_label="round", y_label="nats", title="t & u")
    points = re.search(r'points="([^"]+)"', text).group(1).split()
    (x0, y0), (x1, y1) = (map(float, p.split(",")) for p in points)
    assert x0 < x1 and y0 < y1, "a falling curve goes down the page, and the unknown value is left out"
    assert "t &amp; u" in text and "nats" in text
    with pytest.raises(ValueError, match="series: wanted lines of 2 values"):
        svg.curve([0, 1], [svg.Series("a", [1.0])], x_label="", y_label="", title="")


def test_a_curve_is_cut_where_another_phase_begins():
    words = {"x_label": "", "y_label": "", "title": ""}
    energy = [svg.Series("energy", [3.0, 2.0, 1.0, 4.0, 3.0])]
    text = svg.curve([1, 2, 3, 4, 5], energy, **words, phases=(3.5, "exemplars", "fa<mily"))
    lines = [[float(p.split(",")[0]) for p in found.split()] for found in re.findall(r'points="([^"]+)"', text)]
    divider = float(re.search(r'class="divider" x1="([\d.]+)"', text).group(1))
    assert [len(line) for line in lines] == [3, 2] and lines[0][-1] < divider < lines[1][0]
    assert ">exemplars</text>" in text and ">fa&lt;mily</text>" in text
    whole = svg.curve([1, 2, 3, 4, 5], energy, **words)
    assert len(re.findall("<polyline", whole)) == 1 and "divider" not in whole


def test_the_fit_s_curves_are_cut_where_the_family_s_rounds_begin(whole):
    begun, page = whole.fit().family_from, fit(whole)
    assert phases_of(begun, len(whole.round_figures()) - 1) == (begun + 0.5, "exemplars", "family")
    assert page.count('class="divider"') == page.count("<svg") >= 1 and "another sum" in page
    assert phases_of(-1, 8) is None and phases_of(8, 8) is None, "no round of the family so far"


def test_histogram_bars_fill_their_bins():
    text = svg.histogram([1, 0, 4], [-1, 0, 1, 2], title="h", width=90, height=44)
    heights = [float(h) for h in re.findall(r'<rect[^>]*height="([\d.]+)"', text)]
    assert heights == [10.0, 0.0, 40.0]
    assert '<line x1="30.0"' in text
    with pytest.raises(ValueError, match="edges: wanted 3 edges for 2 bars"):
        svg.histogram([1, 2], [0, 1], title="")


def test_headings_stand_above_the_numbers_of_their_column():
    made = table([["a", "1", "–"], ["b", "2 + 1", "30 %"], ["3", "", "x"]], ("shape", "long part", "mixed"))
    assert "<th>shape</th><th class=n>long part</th><th>mixed</th>" in made
    assert "<td class=n>2 + 1</td><td class=n>30 %</td>" in made and "<td>x</td>" in made
