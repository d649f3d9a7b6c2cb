"""What a notebook shows, in a kernel: flights, figures, tables, progress, errors."""

import json

import nbformat
import pytest

from tools.build_notebook import NOTEBOOK, PAGE, execute, notebook

CELLS = {
    "flight": "import mavfi\n"
    "flight = mavfi.fly(goal=(20.0, 0.0, 3.0), seed=1, fault='state:planning.waypoint.x:bit=62@3')\n"
    "flight",
    "plot": "flight.plot()",
    "error": "mavfi.fly(enviroment='dense')",
    "runs": "size = {'environments': ('sparse',), 'missions': 1, 'faults': 1, 'null_runs': 0}\n"
    "campaign = mavfi.Campaign(name='few', mission={'goal': (20.0, 0.0, 3.0)}, **size)\n"
    "runs = mavfi.run(campaign, 'few', workers=1)\n"
    "runs",
    "figure": "mavfi.figure(runs, 'success')",
    "table": "mavfi.table(runs, 'success')",
}


@pytest.fixture(scope="module")
def outputs():
    """Outputs of the cells by name, of a kernel that shows figures of pyplot as files would have them."""
    cells = [nbformat.v4.new_code_cell(source, id=name) for name, source in CELLS.items()]
    cells[list(CELLS).index("error")].metadata["tags"] = ["raises-exception"]
    executed = execute(nbformat.v4.new_notebook(cells=cells))
    return {cell.id: cell.outputs for cell in executed.cells}


def test_a_flight_shows_itself_in_a_frame_of_its_own(outputs):
    (output,) = outputs["flight"]
    assert output.data["text/plain"].startswith("<FlightResult: sparse, seed 1, fault in planning.waypoint.x: sdc, ")
    assert (
        output.data["text/html"].startswith('<iframe srcdoc="')
        and 'sandbox="allow-scripts"' in output.data["text/html"]
    )
    assert len(output.data["text/html"]) < 400_000


@pytest.mark.parametrize("name", ["plot", "figure"])
def test_figures_show_a_picture(outputs, name):
    (output,) = outputs[name]
    assert len(output.data["image/png"]) > 10_000


def test_runs_and_tables_show_rows_after_one_line_of_progress(outputs):
    progress, rows = outputs["runs"]
    assert progress.data == {"text/plain": "few: 4 of 4 runs"}
    assert rows.data["text/plain"].startswith("<Runs: campaign few ") and "<table" in rows.data["text/html"]
    assert "<table" in outputs["table"][0].data["text/html"]


def test_an_error_of_the_user_is_one_line(outputs):
    (output,) = outputs["error"]
    assert output.output_type == "error"
    (line,) = output.traceback
    assert line.startswith("BadInputError: enviroment: unknown argument (did you mean 'environment'?)")


def is_wanted(output):
    """Whether an output is neither text of stderr nor a figure of which only the name is shown."""
    if output["output_type"] == "stream":
        return output["name"] != "stderr"
    return "image/png" in output["data"] or "Figure size" not in output["data"]["text/plain"]


def answers_of(cells):
    """Sources of the cells, and what each answers as text."""
    return [
        (cell["cell_type"], cell["source"], [output["data"]["text/plain"] for output in cell.get("outputs", ())])
        for cell in cells
    ]


def test_the_stored_notebook_has_the_code_of_the_page_and_shows_pictures():
    stored = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    page = notebook(PAGE.read_text(encoding="utf-8")).cells
    sources = ["".join(cell["source"]) for cell in stored if cell["cell_type"] == "code"]
    assert sources == [cell.source for cell in page if cell.cell_type == "code"], "run `make docs`"
    stored_outputs = [output for cell in stored for output in cell.get("outputs", ())]
    assert all(is_wanted(output) for output in stored_outputs)
    assert sum("image/png" in output.get("data", {}) for output in stored_outputs) == 2
    assert any("<iframe" in "".join(output.get("data", {}).get("text/html", "")) for output in stored_outputs)


@pytest.mark.slow
@pytest.mark.long
def test_the_notebook_is_the_page_with_what_its_blocks_answer():
    stored = nbformat.read(NOTEBOOK, as_version=4).cells
    executed = execute(notebook(PAGE.read_text(encoding="utf-8"))).cells
    assert answers_of(executed) == answers_of(stored), "run `make docs`"
    assert all(is_wanted(output) for cell in executed for output in cell.get("outputs", ()))
