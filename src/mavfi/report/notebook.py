"""What notebooks show: figures, pages in frames of their own, and a line of progress; without importing IPython."""

import base64
import gzip
import io
import sys
import time
from datetime import timedelta
from typing import Any, Self

from matplotlib.figure import Figure

from mavfi.campaign.ledger import Progress
from mavfi.report import style

_DOTS_PER_INCH = 110
_FRAME_HEIGHT = 640
"""Height of a page in a notebook (CSS pixels); what is below the scene and its controls is reached by scrolling."""
_COMPACT = """<style>
.wrap { max-width: none; padding: .5rem .5rem 1rem; } h1 { font-size: 1.2rem; } .lead { font-size: .95rem; }
.stage canvas { height: clamp(240px, 100vh - 15rem, 620px); } footer { display: none; }
</style></head>"""
"""Style of a page in so small a frame: the scene leaves room for its controls."""
_UPDATE_EVERY = 0.5
"""Least interval between updates of the progress (s): a notebook keeps up with a few messages a second."""
_LOADER = """<!DOCTYPE html><script>
(async () => {
  const bytes = Uint8Array.from(atob("%s"), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  const page = await new Response(stream).text();
  document.open(); document.write(page); document.close();
})();
</script>"""
"""A page that unpacks another one into its place."""


class NotebookFigure(Figure):
    """A figure that notebooks show.

    IPython shows those of pyplot only, and only where its backend is that of notebooks; ours are made without pyplot,
    so that they neither need nor change a backend.
    """

    @staticmethod
    def of(figure: Figure) -> "NotebookFigure":
        """The figure itself, shown in notebooks from now on."""
        figure.__class__ = NotebookFigure
        assert isinstance(figure, NotebookFigure)
        return figure

    def _repr_png_(self) -> bytes:
        """The picture in a notebook."""
        buffer = io.BytesIO()
        with style.house_style():
            self.savefig(buffer, format="png", dpi=_DOTS_PER_INCH)
        return buffer.getvalue()


def framed(page: str) -> str:
    """A page as an element of another one, from which its styles and scripts are apart.

    It is compressed: the library for three dimensions alone has 0.6 MB, which each output of a notebook would repeat.

    Args:
        page: HTML.
    """
    compact_page = page.replace("</head>", _COMPACT, 1)
    # a time stamp in the archive would change the notebook with every execution
    packed = base64.b64encode(gzip.compress(compact_page.encode(), mtime=0)).decode()
    document = (_LOADER % packed).replace("&", "&amp;").replace('"', "&quot;")
    return (
        f'<iframe srcdoc="{document}" sandbox="allow-scripts" loading="lazy" '
        f'style="width: 100%; height: {_FRAME_HEIGHT}px; border: 0"></iframe>'
    )


class ProgressLine:
    """Progress of a campaign in one line that is updated: in a notebook, or on stderr of a terminal; else nowhere.

    It is called with the progress after every run.
    """

    def __init__(self, label: str) -> None:
        """Prepare without showing anything.

        Args:
            label: What is being flown.
        """
        self._label = label
        self._output = _output_of_notebook()
        self._is_shown = self._output is not None or sys.stderr.isatty()
        self._has_line = False
        self._started = time.perf_counter()
        self._next_update = 0.0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._has_line and self._output is None:
            sys.stderr.write("\n")

    def __call__(self, progress: Progress) -> None:
        """Show the progress if the last update is old enough, or if it is complete."""
        now = time.perf_counter()
        if not self._is_shown or (now < self._next_update and not progress.complete):
            return
        self._next_update = now + _UPDATE_EVERY
        self._write(f"{self._label}: {self._text(progress, now - self._started)}")
        self._has_line = True

    def _text(self, progress: Progress, elapsed_s: float) -> str:
        """Runs that are done, and the time left at the mean rate of this session, which has lasted `elapsed_s`."""
        if progress.compiling and not progress.flown:
            return "compiling kernels and flying the first mission ..."
        text = f"{progress.done} of {progress.total} runs"
        if progress.complete or not progress.flown:
            return text
        left_s = elapsed_s * (progress.total - progress.done) / progress.flown
        return f"{text}, {timedelta(seconds=round(left_s))} left"

    def _write(self, line: str) -> None:
        """Replace the line that was shown."""
        if self._output is None:
            sys.stderr.write(f"\r{line}\x1b[K")
            sys.stderr.flush()
        elif self._has_line:
            self._output.update({"text/plain": line}, raw=True)
        else:
            self._output.display({"text/plain": line}, raw=True)


def _output_of_notebook() -> Any:  # noqa: ANN401 - IPython is no dependency
    """A display of a notebook whose content can be replaced; None outside of notebooks."""
    ipython = sys.modules.get("IPython")
    if ipython is None or getattr(ipython.get_ipython(), "kernel", None) is None:
        return None
    from IPython.display import DisplayHandle

    return DisplayHandle()
