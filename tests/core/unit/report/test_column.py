from itertools import combinations

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text
from PIL import Image

from mavfi.report.html.report_page import drawn
from mavfi.report.style import COLUMN, PAGE, fit_to_column, write_figure


def width_of(path):
    with Image.open(path) as image:
        return image.width


def test_each_figure_is_written(runs, tmp_path):
    for one in drawn(runs):
        paths = write_figure(one.figure, tmp_path, one.name)
        assert [path.suffix for path in paths] == [".pdf", ".png"]
        assert paths[0].read_bytes().startswith(b"%PDF")
        assert width_of(paths[1]) in (round(600 * COLUMN), round(600 * PAGE))


@pytest.mark.parametrize(("panels", "width"), [(1, COLUMN), (2, COLUMN), (4, PAGE)])
def test_figures_have_the_width_of_a_column_or_of_the_page(tmp_path, panels, width):
    figure = Figure(figsize=(9, 4), layout="constrained")
    for axes in np.atleast_1d(figure.subplots(1, panels)):
        axes.plot([0, 1], [0, 1], label="a")
        axes.set_xlabel("a label that is longer than such a narrow figure is wide, so that it has to be folded")
    write_figure(figure, tmp_path, "one")
    assert width_of(tmp_path / "one.png") == round(600 * width)
    assert all(text.get_fontsize() <= 7 for axes in figure.axes for text in axes.texts)


def wide(count):
    """A figure for screens: rows with long names, columns with long names, numbers, long labels, a long legend."""
    figure = Figure(figsize=(9, 4), layout="constrained")
    left, right = figure.subplots(1, 2)
    names = [f"name of a row {place}" for place in range(count)]
    for place, name in enumerate(names):
        left.plot([0, 100_000], [place, place], label=name)
        right.plot([place], [100.0 * place], "o")
        right.annotate("300", (place, 100.0 * place), (0, -9), textcoords="offset points", ha="center", fontsize=6.5)
    left.set_yticks(range(count), names)
    left.set_xticks(range(0, 100_001, 10_000))
    right.set_xticks(range(count), names)
    left.set_xlabel("flight time of missions that succeed (s)")
    right.set_xlabel("missions that succeed or arrive late")
    right.set_ylabel("a label that is longer than such a low panel is high")
    left.set_title("a title longer than its panel")
    figure.legend(loc="outside upper left", ncols=4)
    return figure


def texts_of(figure):
    """Every visible text with its extent; tick labels of a panel only within its limits."""
    figure.draw_without_rendering()
    found = [text for text in figure.findobj(Text) if text.get_text() and text.get_visible()]
    for axis in (axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)):
        low, high = sorted(axis.get_view_interval())
        unseen = {id(tick.label1) for tick in axis.get_major_ticks() if not low <= tick.get_loc() <= high}
        found = [text for text in found if id(text) not in unseen]
    return [(text.get_text(), text.get_window_extent()) for text in found]


def check_texts(figure):
    texts = texts_of(figure)
    page = figure.bbox.padded(1.0)
    assert not [name for name, box in texts if not (page.contains(box.x0, box.y0) and page.contains(box.x1, box.y1))]
    assert not [
        (one, other)
        for (one, box), (other, further) in combinations(texts, 2)
        if box.padded(-1.0).overlaps(further.padded(-1.0))
    ]


@pytest.mark.parametrize("count", [3, 6, 9])
def test_no_text_lies_over_another_or_outside_the_figure(count):
    figure = wide(count)
    fit_to_column(figure)
    check_texts(figure)
    assert figure.get_figwidth() == COLUMN


def test_no_text_of_the_figures_of_a_campaign_lies_over_another(runs):
    for one in drawn(runs):
        fit_to_column(one.figure)
        check_texts(one.figure)


def test_wide_lines_remain_wider_than_narrow_ones():
    figure = Figure(figsize=(9, 4), layout="constrained")
    axes = figure.subplots()
    lines = [*axes.plot([0, 1], [0, 1], linewidth=5.0), *axes.plot([0, 1], [0, 1], linewidth=1.5)]
    fit_to_column(figure)
    assert [line.get_linewidth() for line in lines] == [2.5, 0.75]


def test_the_note_below_a_figure_stays():
    figure = Figure(figsize=(9, 4), layout="constrained")
    figure.subplots(1, 2)
    figure.supxlabel("bar: quartiles")
    fit_to_column(figure)
    assert figure.get_supxlabel() == "bar: quartiles"
