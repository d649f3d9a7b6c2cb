import csv

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from mavfi.reports.figure_files import COLUMN, PAGE, drawn_data, write_figure
from mavfi.reports.figures import links
from mavfi.reports.html.report_page import drawn


def width_of(path):
    with Image.open(path) as image:
        return image.width


def test_each_figure_is_written_with_its_data(runs, tmp_path):
    for one in drawn(runs):
        paths = write_figure(one.figure, tmp_path, one.name)
        assert [path.suffix for path in paths] == [".pdf", ".png", ".csv"]
        assert paths[0].read_bytes().startswith(b"%PDF")
        assert width_of(paths[1]) in (round(600 * COLUMN), round(600 * PAGE))
        assert list(csv.DictReader(paths[2].read_text(encoding="utf-8").splitlines()))


def test_the_data_of_the_success_figure_are_its_rates(runs):
    success = next(one.figure for one in drawn(runs) if one.name == "success")
    rows = {(row["series"], row["x_label"]): row for row in drawn_data(success)}
    faulty = rows["fault", "sparse"]
    judged = runs.injected.where("judged", setting="fi", population="sign_exponent")
    assert faulty["y"] == np.mean(judged["success"]) and faulty["low"] < faulty["y"] <= faulty["high"]


def test_lines_bars_images_and_marks_are_read_from_a_figure():
    figure = Figure(layout="constrained")
    left, right = figure.subplots(1, 2)
    left.plot([1, 2], [3, 4], label="line")
    left.bar([0.0], [2.0], label="bar")
    links.points(left, [9.0], [9.0], ["#runs?a=b"])  # invisible: no data
    right.scatter([5.0], [6.0], label="mark")
    right.imshow([[0.25, 0.5]])
    rows = [(row["series"], row["x"], row["y"]) for row in drawn_data(figure)]
    assert rows == [("bar", 0.0, 2.0), ("line", 1.0, 3.0), ("line", 2.0, 4.0), ("mark", 5.0, 6.0),
                    ("0.25", 0.0, 0.0), ("0.5", 1.0, 0.0)]  # fmt: skip


@pytest.mark.parametrize(("panels", "width"), [(1, COLUMN), (2, COLUMN), (4, PAGE)])
def test_figures_have_the_width_of_a_column_or_of_the_page(tmp_path, panels, width):
    figure = Figure(figsize=(9, 4), layout="constrained")
    for axes in np.atleast_1d(figure.subplots(1, panels)):
        axes.plot([0, 1], [0, 1], label="a")
        axes.set_xlabel("a label that is longer than such a narrow figure is wide, so that it has to be folded")
    write_figure(figure, tmp_path, "one")
    assert width_of(tmp_path / "one.png") == round(600 * width)
    assert all(text.get_fontsize() <= 7 for axes in figure.axes for text in axes.texts)
