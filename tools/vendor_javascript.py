"""Renew the JavaScript libraries that reports inline: three.js (bundled, only what `scene.js` uses) and uPlot.

Needs npm, to fetch packages of exactly these versions; nothing of them is run but esbuild, which bundles.
Run it as `python -m tools.vendor_javascript`; it writes src/mavfi/report/html/vendor/.
"""

import platform
import shutil
import subprocess
import tarfile
import tempfile
from pathlib import Path

VENDOR = Path(__file__).parents[1] / "src" / "mavfi" / "report" / "html" / "vendor"
VERSIONS = {"three": "0.187.0", "uplot": "1.6.32", "@esbuild/linux-x64": "0.28.2"}
ENTRY = """\
export {
  BoxGeometry, BufferGeometry, Color, ConeGeometry, DirectionalLight, Float32BufferAttribute, Group, HemisphereLight,
  InstancedMesh, LineBasicMaterial, LineSegments, Matrix4, Mesh, MeshBasicMaterial, MeshLambertMaterial,
  OctahedronGeometry, PerspectiveCamera, PlaneGeometry, Quaternion, Scene, SphereGeometry, TorusGeometry, Vector3,
  WebGLRenderer,
} from "three";
export { OrbitControls } from "three/addons/controls/OrbitControls.js";
export { Line2 } from "three/addons/lines/Line2.js";
export { LineGeometry } from "three/addons/lines/LineGeometry.js";
export { LineMaterial } from "three/addons/lines/LineMaterial.js";
"""


def fetch(name: str, version: str, folder: Path) -> Path:
    """Fetch and unpack a package of the npm registry; gives its folder."""
    command = ["npm", "pack", "--silent", f"{name}@{version}"]
    archive = subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True).stdout.split()[-1]
    target = folder / "node_modules" / name
    target.mkdir(parents=True)
    with tarfile.open(folder / archive) as content:
        content.extractall(target, filter="data")
    return target / "package"


def with_licence(name: str, package: Path, code: str) -> str:
    """Code below the name, version and licence of its package."""
    licence = (package / "LICENSE").read_text(encoding="utf-8").strip()
    return f"/*!\n{name} {VERSIONS[name]}\n\n{licence}\n*/\n{code.strip()}\n"


def main() -> None:
    """Write the folder from scratch."""
    if platform.machine() != "x86_64":
        raise SystemExit("vendor_javascript: esbuild is fetched for x86-64 Linux")
    VENDOR.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        # fetch the packages, and bundle what the scene uses of three.js
        packages = {name: fetch(name, version, folder) for name, version in VERSIONS.items()}
        (folder / "entry.js").write_text(ENTRY, encoding="utf-8")
        command: list[str | Path] = [
            packages["@esbuild/linux-x64"] / "bin" / "esbuild",
            "entry.js",
            "--bundle",
            "--minify",
            "--format=iife",
            "--global-name=THREE",
            "--target=es2020",
            "--legal-comments=none",
            "--log-level=warning",
            f"--alias:three={packages['three'] / 'build' / 'three.module.js'}",
            f"--alias:three/addons={packages['three'] / 'examples' / 'jsm'}",
        ]
        bundle = subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True).stdout

        # write both libraries with their licences; uPlot comes as one file already
        uplot = (packages["uplot"] / "dist" / "uPlot.iife.min.js").read_text(encoding="utf-8")
        style = (packages["uplot"] / "dist" / "uPlot.min.css").read_text(encoding="utf-8")
        for name, package, code in (("three", "three", bundle), ("uplot", "uplot", uplot)):
            shutil.copy(packages[package] / "LICENSE", VENDOR / f"{name}.LICENSE")
            (VENDOR / f"{name}.min.js").write_text(with_licence(name, packages[package], code), encoding="utf-8")
        (VENDOR / "uplot.min.css").write_text(style, encoding="utf-8")


if __name__ == "__main__":
    main()
