"""What notebooks show: figures, and pages in frames of their own; neither needs IPython."""

import base64
import gzip
import io

from matplotlib.figure import Figure

from mavfi.report import style

_DOTS_PER_INCH = 110
_FRAME_HEIGHT = 640
"""Height of a page in a notebook (CSS pixels); what is below the scene and its controls is reached by scrolling."""
_COMPACT = """<style>
.wrap { max-width: none; padding: .5rem .5rem 1rem; } h1 { font-size: 1.2rem; } .lead { font-size: .95rem; }
.stage canvas { height: clamp(240px, 100vh - 15rem, 620px); } footer { display: none; }
</style></head>"""
"""Style of a page in so small a frame: the scene leaves room for its controls."""
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
