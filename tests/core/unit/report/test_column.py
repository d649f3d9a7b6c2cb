from itertools import combinations

import pytest
from matplotlib.text import Text
from PIL import Image

from mavfi.report.html.report_page import drawn
from mavfi.report.style import COLUMN, PAGE, fit_to_column, write_figure, write_talk_figure


def width_of(path):
    with Image.open(path) as image:
        return image.width


def test_each_figure_is_written(runs, tmp_path):
    for shown in drawn(runs):
        paths = write_figure(shown.figure, tmp_path, shown.name)
        assert [path.suffix for path in paths] == [".pdf", ".png"]
        assert paths[0].read_bytes().startswith(b"%PDF")
        assert width_of(paths[1]) in (round(600 * COLUMN), round(600 * PAGE))


def test_figures_for_talks_have_the_shape_of_a_slide(runs, tmp_path):
    for shown in drawn(runs):
        picture, pixels = write_talk_figure(shown.figure, tmp_path, shown.name)
        assert (picture.name, pixels.name) == (f"{shown.name}-talk.svg", f"{shown.name}-talk.png")
        with Image.open(pixels) as image:
            assert image.width * 9 == pytest.approx(image.height * 16, rel=1e-3) and image.width >= 2559
        check_texts(shown.figure)


def texts_of(figure):
    """Every visible text with its extent; tick labels of a panel only within its limits."""
    figure.draw_without_rendering()
    texts = [text for text in figure.findobj(Text) if text.get_text() and text.get_visible()]
    for axis in (axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)):
        low, high = sorted(axis.get_view_interval())
        unseen = {id(tick.label1) for tick in axis.get_major_ticks() if not low <= tick.get_loc() <= high}
        texts = [text for text in texts if id(text) not in unseen]
    return [(text.get_text(), text.get_window_extent()) for text in texts]


def check_texts(figure):
    texts = texts_of(figure)
    page = figure.bbox.padded(1.0)
    assert not [name for name, box in texts if not (page.contains(box.x0, box.y0) and page.contains(box.x1, box.y1))]
    assert not [
        (text, other)
        for (text, box), (other, further) in combinations(texts, 2)
        if box.padded(-1.0).overlaps(further.padded(-1.0))
    ]


def test_no_text_of_the_figures_of_a_campaign_lies_over_another(runs):
    for shown in drawn(runs):
        fit_to_column(shown.figure)
        check_texts(shown.figure)
