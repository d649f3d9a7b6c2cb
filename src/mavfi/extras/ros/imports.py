"""Import finder for ROS's Python modules in folders whose other packages must stay invisible.

On `PYTHONPATH`, such a folder would put its NumPy before this project's.  This finder is at the end of `sys.meta_path`,
after all packages installed in this environment, and finds only allowed names.
"""

import sys
from collections.abc import Callable, Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from types import ModuleType


class Finder(MetaPathFinder):
    """Finds allowed modules in folders.

    Args:
        folders: Where they are, in order of preference.
        is_allowed: Whether a top-level name may be imported from there.
    """

    def __init__(self, folders: Sequence[Path], is_allowed: Callable[[str], bool]) -> None:
        self.folders = [str(folder) for folder in folders]
        self._is_allowed = is_allowed

    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """The spec of an allowed top-level module, otherwise None."""
        if path is not None or not self._is_allowed(fullname):
            return None
        return PathFinder.find_spec(fullname, self.folders)

    def enable(self) -> None:
        """Use this finder in this process, unless one for the same folders is in use."""
        for finder in sys.meta_path:
            if isinstance(finder, Finder) and finder.folders == self.folders:
                return
        sys.meta_path.append(self)
