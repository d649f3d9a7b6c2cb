"""Draw the Mermaid diagrams of the documentation as SVG files, which the site shows: it loads no script from elsewhere.

Needs npm, to fetch Mermaid of exactly this version, and Chromium.  Run it as `python -m tools.draw_diagrams` after a
change of a diagram; it writes docs/images/diagrams.
"""

import hashlib
import json
import re
import shutil
import subprocess
import tempfile
from pathlib import Path

from tools.markers import DOCS, IMAGES, ROOT

MERMAID = "mermaid@11.17.2"
DIAGRAM = re.compile(r"^```mermaid\n(.*?)^```$", re.MULTILINE | re.DOTALL)
FOLDER = IMAGES / "diagrams"
PAGE = """<script src="package/dist/mermaid.min.js"></script><body><script>
mermaid.initialize({startOnLoad: false, theme: "neutral", htmlLabels: false, flowchart: {htmlLabels: false}});
mermaid.render("diagram", DIAGRAM).then(({svg}) => {document.body.innerHTML = svg});
</script>"""


def picture_of(diagram: str) -> str:
    """The picture of a diagram, relative to the root of the repository; its name is a hash of the diagram."""
    name = hashlib.sha256(diagram.encode()).hexdigest()[:12]
    return (FOLDER / f"{name}.svg").relative_to(ROOT).as_posix()


def main() -> None:
    """Write the folder from scratch."""
    shutil.rmtree(FOLDER, ignore_errors=True)
    FOLDER.mkdir(parents=True)
    diagrams = [text for page in sorted(DOCS.rglob("*.md")) for text in DIAGRAM.findall(page.read_text("utf-8"))]
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        subprocess.run(["npm", "pack", "--silent", MERMAID], cwd=folder, check=True, stdout=subprocess.DEVNULL)
        shutil.unpack_archive(next(folder.glob("*.tgz")), folder)
        page = folder / "page.html"
        for diagram in diagrams:
            page.write_text(PAGE.replace("DIAGRAM", json.dumps(diagram)), encoding="utf-8")
            command = ["chromium", "--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=20000"]
            document = subprocess.run(
                [*command, "--dump-dom", page.as_uri()], check=True, capture_output=True, text=True
            ).stdout
            match = re.search(r"<svg.*</svg>", document, re.DOTALL)
            if match is None or 'class="error-text"' in match[0]:
                raise SystemExit(f"draw_diagrams: not drawn:\n{diagram}")
            (ROOT / picture_of(diagram)).write_text(match[0] + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
