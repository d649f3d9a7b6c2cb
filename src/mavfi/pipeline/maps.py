"""Occupancy maps of kernel `octomap`: a dense array, OctoMap's octree with equal occupancy, or a user's own class."""

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from mavfi.errors import BadInputError, MavfiError
from mavfi.kernels.perception import octree
from mavfi.kernels.perception.key_sets import KeyFrame
from mavfi.kernels.perception.octomap import UpdateRule, insert_scan, undo_scan
from mavfi.kernels.perception.octree import Octree
from mavfi.pipeline.functions import PLAIN, KernelFunctions
from mavfi.pipeline.memory import ArrayChange, Changes, Keeper, OpaqueKeeper, common_length
from mavfi.plugins import build, load_object, reason

FIRST_CAPACITY = 1 << 14
"""Initial capacity of an octree (nodes), doubled on demand."""


class OccupancyMap(Keeper, Protocol):
    """A map that integrates scans, and supports rollback; its rollback data is part of what it saves."""

    @property
    def log_odds(self) -> np.ndarray:
        """Log-odds of every voxel of the grid, 0 = unknown. Shape (size,), float32."""

    def insert(self, points: np.ndarray, origin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Integrate a scan.

        Args:
            points: World frame (m). Shape (n, 3), float32.
            origin: Sensor position, world frame (m). Shape (3,).

        Returns:
            Indices of the updated voxels, free ones first (int32), and their new log-odds (float32).
        """

    def mark(self) -> None:
        """Save the current map for `rollback`."""

    def rollback(self) -> None:
        """Restore the map of the last mark."""


Scan = tuple[np.ndarray, np.ndarray] | None
"""Points and origin of an integrated scan; None = the last scan was undone."""


class ScanArrays:
    """Work arrays of `insert_scan` for a map that is zero at first, and their `Scratch`: the scans so far.

    `insert_scan` writes them before it reads them, so they are no memory.  With a fault it may read what earlier scans
    left there; to restore that, the scans are integrated again.

    Attributes:
        log_odds: The map. Shape (nx * ny * nz,), float32.
        stamp: See `insert_scan`. Same shape, int32.
        touched: See `insert_scan`. One longer, int32.
        before: See `insert_scan`. Same shape, float32.
        number: Number of scans so far, undone ones included.
    """

    def __init__(self, frame: KeyFrame, rule: UpdateRule, max_range: float) -> None:
        self._settings = (frame, rule, max_range)
        size = frame.nx * frame.ny * frame.nz
        self.log_odds = np.zeros(size, np.float32)
        self.stamp = np.zeros(size, np.int32)
        self.touched = np.zeros(size + 1, np.int32)
        self.before = np.zeros(size, np.float32)
        self.number = 0
        self._count = 0
        self._scans: list[Scan] = []
        self._replica: ScanArrays | None = None  # in which the scans are integrated again

    def _all(self) -> tuple[np.ndarray, ...]:
        """All work arrays, in an order that `fill` relies on."""
        return self.log_odds, self.stamp, self.touched, self.before

    def integrate(self, points: np.ndarray, origin: np.ndarray, insert: Callable[..., int]) -> int:
        """Integrate a scan by a function like `insert_scan`; returns the number of updated voxels."""
        frame, rule, max_range = self._settings
        self.number += 1
        self._count = insert(
            points, origin, max_range, frame, rule, self.log_odds, self.stamp, self.number, self.touched, self.before
        )
        return self._count

    def note(self, scan: Scan) -> None:
        """Append a scan to those that are integrated again."""
        self._scans.append(scan)

    def save(self) -> tuple[Scan, ...]:
        """See `Scratch.save`."""
        return tuple(self._scans)

    def restore(self, saved: tuple[Scan, ...]) -> None:
        """See `Scratch.restore`."""
        self._scans = list(saved)

    def fill(self) -> None:
        """See `Scratch.fill`.

        Raises:
            MavfiError: The scans do not lead to the current map.
        """
        if self._replica is None:
            self._replica = ScanArrays(*self._settings)
        replica = self._replica
        replica._repeat(self._scans)
        if replica.log_odds.tobytes() != self.log_odds.tobytes():
            raise MavfiError("a map differs from its scans")
        for array, content in zip(self._all(), replica._all(), strict=True):
            array[:] = content
        self.number = replica.number

    def _repeat(self, scans: Sequence[Scan]) -> None:
        """Integrate scans; those that have been integrated already are not repeated."""
        if common_length(self._scans, scans) < len(self._scans):
            for array in self._all():
                array[:] = 0
            self.number = 0
            self._scans = []
        for scan in scans[len(self._scans) :]:
            self._scans.append(scan)
            if scan is None:
                undo_scan(self.log_odds, self.touched, self.before, self._count)
            else:
                self.integrate(*scan, insert_scan)


class DenseMap:
    """Log-odds in a dense array.

    Args:
        frame: Geometry of the grid.
        rule: Update rule.
        max_range: Sensor range (m).
        functions: Compiled functions that it calls.
        rewindable: Whether any `save` can be restored; otherwise only the last scan can be undone.
    """

    def __init__(
        self,
        frame: KeyFrame,
        rule: UpdateRule,
        max_range: float,
        functions: KernelFunctions = PLAIN,
        *,
        rewindable: bool = False,
    ) -> None:
        self._functions = functions
        self._rewindable = rewindable
        self._arrays = ScanArrays(frame, rule, max_range)
        self.log_odds = self._arrays.log_odds
        self._changes = Changes(self.log_odds)
        self._can_undo = False
        self.scratch = (self._arrays,)

    def insert(self, points: np.ndarray, origin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Integrate a scan, and store the previous values of its voxels."""
        arrays = self._arrays
        count = arrays.integrate(points, origin, self._functions.insert_scan)
        voxels = arrays.touched[:count].copy()
        before = arrays.before[:count].copy()
        after = self.log_odds[voxels]  # of a voxel outside of the grid, due to a fault: an IndexError
        if self._rewindable:  # most voxels are clamped already: unchanged ones are not stored
            arrays.note((points, origin))
            changed = np.flatnonzero(before.view(np.uint32) != after.view(np.uint32))
            self._changes.note(voxels[changed], before[changed], after[changed])
        else:
            self._changes.forget()
            self._changes.note(voxels, before, after)
        self._can_undo = True
        return voxels, after

    def _put(self, voxels: np.ndarray, log_odds: np.ndarray) -> None:
        """Write log-odds to the map, as `Changes.take_back` requires."""
        self.log_odds[voxels] = log_odds

    def mark(self) -> None:
        """Commit the scans so far: rollback does not reach beyond this point."""
        self._can_undo = False

    def rollback(self) -> None:
        """Undo the last scan; its stamp is not reused, as the stamp counter is not restored."""
        if self._can_undo:
            self._changes.take_back(len(self._changes) - 1, self._put)
            if self._rewindable:
                self._arrays.note(None)
        self._can_undo = False

    def save(self) -> tuple[tuple[ArrayChange, ...], bool]:
        """All scans so far, and whether the last one can be undone; stamps only need to be unused ones."""
        return self._changes.save(), self._can_undo

    def restore(self, saved: tuple[tuple[ArrayChange, ...], bool]) -> None:
        """Restore the result of `save`."""
        changes, self._can_undo = saved
        self.log_odds[:] = self._changes.restore(changes)

    def same(self, saved: tuple[tuple[ArrayChange, ...], bool]) -> bool:
        """Whether the map, and the map after a rollback, equal those of `save`."""
        changes, takes_back = saved
        return self._can_undo == takes_back and self._changes.same(changes, int(takes_back))

    def arrays(self) -> dict[str, np.ndarray]:
        """Log-odds of the voxels; stamps are no memory, as they only need to be unused ones."""
        return {"log_odds": self.log_odds}


class OctreeMap:
    """Log-odds in an octree that grows on demand; arguments as of `DenseMap`.

    Attributes:
        tree: Nodes of the octree.
    """

    def __init__(
        self,
        frame: KeyFrame,
        rule: UpdateRule,
        max_range: float,
        functions: KernelFunctions = PLAIN,
        *,
        rewindable: bool = False,
    ) -> None:
        del rewindable  # nodes are copied whole
        self._frame = frame
        self._rule = rule
        self._range = max_range
        self._functions = functions
        self._size = frame.nx * frame.ny * frame.nz
        self._largest = octree.largest_tree(frame)
        self.tree = octree.new_octree(min(FIRST_CAPACITY, self._largest))
        self._marked = octree.compact_copy(self.tree)
        self._stamp = np.zeros(self._size, np.int32)
        self._touched = np.zeros(self._size + 1, np.int32)
        self._stamps = 0

    @property
    def log_odds(self) -> np.ndarray:
        """Log-odds of every voxel of the grid, read from the tree, 0 = unknown. Shape (size,), float32."""
        dense = np.zeros(self._size, np.float32)
        octree.to_dense(self.tree, self._frame, dense)
        return dense

    def insert(self, points: np.ndarray, origin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Integrate a scan; voxels beyond the largest tree, reached only with corrupted nodes, are dropped."""
        self._stamps += 1
        n_free, count = self._functions.collect(
            points, origin, self._range, self._frame, self._stamp, self._stamps, self._touched
        )
        voxels = self._touched[:count]
        after = np.zeros(count, np.float32)
        done = 0
        while True:  # with a tree of twice the size whenever it is full
            done = self._functions.update_voxels(self.tree, self._frame, self._rule, voxels, n_free, done, after)
            capacity = len(self.tree.log_odds)
            if done == count or capacity >= self._largest:
                return voxels[:done], after[:done]
            larger = octree.new_octree(min(2 * capacity, self._largest))
            octree.copy_into(self.tree, larger)
            self.tree = larger

    def mark(self) -> None:
        """Copy the nodes: they are so small and numerous that an undo log would cost more."""
        self._marked = octree.compact_copy(self.tree)

    def rollback(self) -> None:
        """Restore all nodes; capacity allocated since then is cleared."""
        octree.copy_into(self._marked, self.tree)

    def save(self) -> tuple[Octree, Octree]:
        """Copies of the current nodes and of those at the last mark (immutable)."""
        return octree.compact_copy(self.tree), self._marked

    def restore(self, saved: tuple[Octree, Octree]) -> None:
        """Restore the nodes of `save`; capacity has no effect on results."""
        nodes, self._marked = saved
        if len(nodes.log_odds) > len(self.tree.log_odds):
            self.tree = octree.new_octree(len(nodes.log_odds))
        octree.copy_into(nodes, self.tree)

    def same(self, saved: tuple[Octree, Octree]) -> bool:
        """Whether the nodes, including their positions in memory, are identical now and at the last mark."""
        nodes, marked = saved
        return _same_nodes(octree.compact_copy(self.tree), nodes) and _same_nodes(self._marked, marked)

    def arrays(self) -> dict[str, np.ndarray]:
        """Children and log-odds of all nodes used so far, and the counters."""
        used = len(octree.compact_copy(self.tree).log_odds)
        tree = self.tree
        return {"children": tree.children[:used], "log_odds": tree.log_odds[:used], "counters": tree.counters}


def _same_nodes(nodes: Octree, others: Octree) -> bool:
    """Whether two trees have the same bits."""
    return nodes is others or all(a.tobytes() == b.tobytes() for a, b in zip(nodes, others, strict=True))


class GuardedMap(OpaqueKeeper[OccupancyMap]):
    """A user's map whose return values are validated before use."""

    def __init__(self, name: str, inner: OccupancyMap, size: int) -> None:
        super().__init__(inner)
        self._name = name
        self._size = size

    @property
    def log_odds(self) -> np.ndarray:
        """Log-odds of every voxel of the grid, 0 = unknown. Shape (size,), float32."""
        try:
            values = np.asarray(self.content.log_odds)
        except AttributeError:
            raise self._wrong("lacks log_odds") from None
        if values.shape != (self._size,):
            raise self._wrong(f"log_odds has shape {values.shape}; allowed: ({self._size},)")
        if values.dtype != np.float32:
            raise self._wrong(f"log_odds is {values.dtype}; allowed: float32")
        return values

    def insert(self, points: np.ndarray, origin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Integrate a scan.

        Raises:
            BadInputError: The map raised, or its return value does not conform to `OccupancyMap.insert`.
        """
        try:
            voxels, log_odds = map(np.asarray, self.content.insert(points, origin))
        except MavfiError:
            raise
        except Exception as error:  # noqa: BLE001 - any exception of a user's map
            raise self._wrong(f"insert raised {reason(error)}") from None
        if voxels.ndim != 1 or voxels.shape != log_odds.shape:
            raise self._wrong(f"insert gave shapes {voxels.shape} and {log_odds.shape}; allowed: (n,) and (n,)")
        if voxels.dtype != np.int32 or log_odds.dtype != np.float32:
            raise self._wrong(f"insert gave {voxels.dtype} and {log_odds.dtype}; allowed: int32 and float32")
        if len(voxels) > 0:
            low = int(voxels.min())
            high = int(voxels.max())
            if low < 0 or high >= self._size:
                raise self._wrong(f"insert gave voxels from {low} to {high}; allowed: 0 to {self._size - 1}")
        return voxels, log_odds

    def mark(self) -> None:
        """Save the current map for `rollback`."""
        self.content.mark()

    def rollback(self) -> None:
        """Restore the map of the last mark."""
        self.content.rollback()

    def _wrong(self, text: str) -> BadInputError:
        """The error about a value of the user's map."""
        return BadInputError(f"map {self._name!r}: {text}")


GROUP = "mavfi.maps"
"""Entry-point group of map classes."""
MAPS: dict[str, Callable[..., OccupancyMap]] = {"dense": DenseMap, "octree": OctreeMap}
"""Shipped map classes, by `MapConfig.kind`."""
_SHIPPED = {kind: f"{__name__}:{factory.__name__}" for kind, factory in MAPS.items()}
"""Addresses of the shipped classes, by kind."""


def find_map(kind: str) -> Callable[..., OccupancyMap]:
    """Find a map class, called with grid, update rule and range, see `make_map`.

    Args:
        kind: A shipped kind, an entry point of the group `mavfi.maps`, or "package:Class".

    Raises:
        BadInputError: It does not exist or cannot be imported.
    """
    factory: Callable[..., OccupancyMap] = load_object("map", kind, GROUP, _SHIPPED)
    return factory


_METHODS = {"insert": "points, origin", "mark": "", "rollback": ""}
"""Parameters of a map's methods."""


def make_map(
    kind: str,
    frame: KeyFrame,
    rule: UpdateRule,
    max_range: float,
    functions: KernelFunctions = PLAIN,
    *,
    rewindable: bool = False,
) -> OccupancyMap:
    """Construct an empty map.

    Args:
        kind: See `find_map`.
        frame: Geometry of the grid in OctoMap's keys.
        rule: Log-odds of a hit and a miss, and their clamps.
        max_range: Length of a ray without a return (m).
        functions: Compiled functions that the shipped kinds call.
        rewindable: Whether it must be restorable to any earlier instant; a user's own map is always copied whole.

    Raises:
        BadInputError: It cannot be constructed, or lacks a method.
    """
    if kind in MAPS:
        return MAPS[kind](frame, rule, max_range, functions, rewindable=rewindable)
    user_map = build("map", kind, find_map(kind), frame, rule, max_range, needs=_METHODS)
    guarded = GuardedMap(kind, user_map, frame.nx * frame.ny * frame.nz)
    _ = guarded.log_odds  # validated before the first scan
    return guarded
