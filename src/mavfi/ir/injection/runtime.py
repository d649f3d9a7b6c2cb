"""Runtime of an instrumented kernel, which counts, resolves and injects: hand-written IR and its memory layout.

A counter runs over the values that the kernel writes.  Each block first adds the number of its sites and compares with
a threshold; only beyond it is `mavfi_slow` called, which acts according to the mode.  After the injection every block
exceeds the threshold, and its slow copy checks every memory access.
"""

from enum import IntEnum

from mavfi.ir.forked import HANG_EXIT, WILD_EXIT
from mavfi.ir.injection.arena import BASE, CONSTANTS, LINE, SIZE


class ControlWord(IntEnum):
    """Words of the control block `mavfi_control` (64 bits each), by index."""

    COUNTER = 0  # values written so far
    THRESHOLD = 1  # counter beyond which `mavfi_slow` is called
    MODE = 2  # a `RunMode`
    TARGET = 3  # dynamic index of the fault (INJECT)
    BUDGET = 4  # counter beyond which an injected call is a hang (INJECT)
    INJECTED = 5  # 1 after the injection
    REPORT = 6  # address of the report, see `REPORT_WORDS`
    STOP = 7  # address of `_exit`
    HISTOGRAM = 8  # address of the execution counts of all blocks (PROFILE)
    TRACE = 9  # address of the executed blocks, in order (PROFILE)
    TRACE_ROOM = 10  # largest length of the trace
    TRACE_LENGTH = 11  # its present length
    EVENTS = 12  # address of the wanted dynamic indices (RESOLVE)
    EVENT_COUNT = 13  # number of wanted dynamic indices
    NEXT_EVENT = 14  # position of the next wanted dynamic index
    EVENT_BLOCKS = 15  # address of their blocks (RESOLVE)
    EVENT_OFFSETS = 16  # address of their offsets in these (RESOLVE)
    PLANNED = 17  # 1 if the call uses planned memory, see `arena`
    FRAME = 18  # first free address for stack frames
    HEAP = 19  # first free address for arrays


class RunMode(IntEnum):
    """Behaviour beyond the threshold."""

    INJECT = 0  # change one value, then check budget and memory accesses
    PROFILE = 1  # count the executions of each block, and note their order
    RESOLVE = 2  # find block and offset of dynamic indices


WORDS = 32
"""Size of the control block."""
NEVER = 2**63 - 1
"""A threshold or index that is never reached."""
MASK_BYTES = 512
"""Size of each of the masks `mavfi_keep` and `mavfi_flip`, and of the values before and after in the report."""
REPORT_WORDS = 4
"""The report begins with: injected?, block, offset, in planned memory?  Parents share it with forked children: it
survives a crash."""
REPORT_BYTES = 8 * REPORT_WORDS + 2 * MASK_BYTES
"""Size of the report: its words, then the value before and the value after."""


def word_address(word: ControlWord) -> str:
    """Constant pointer to a word of the control block."""
    return f"getelementptr (i8, ptr @mavfi_control, i64 {8 * word})"


def _load(name: str, word: ControlWord, kind: str = "i64") -> str:
    """IR that loads a word of the control block."""
    return f"  %{name} = load volatile {kind}, ptr {word_address(word)}"


def _store(value: str, word: ControlWord) -> str:
    """IR that stores a word of the control block."""
    return f"  store volatile i64 {value}, ptr {word_address(word)}"


# ---- What happens beyond the threshold.
# `mavfi_slow` is called with the counter after the block (`%after`), the number of sites of the block (`%n`) and the
# number of the block.  It returns the offset of the site to be injected, or -1.  Each mode is a part of its body.

_INJECT = f"""
inject:                 ; before the injection, or already after it?
{_load("done", ControlWord.INJECTED)}
  %before.it = icmp eq i64 %done, 0
  br i1 %before.it, label %change, label %injected
change:                 ; the target is in this block: report it first, since the fault may crash the process
{_load("target", ControlWord.TARGET)}
  %offset = sub i64 %target, %base
{_store("1", ControlWord.INJECTED)}
{_load("report", ControlWord.REPORT, "ptr")}
  store volatile i64 1, ptr %report
  %report.block = getelementptr i64, ptr %report, i64 1
  store volatile i64 %block, ptr %report.block
  %report.offset = getelementptr i64, ptr %report, i64 2
  store volatile i64 %offset, ptr %report.offset
                        ; from now on, every block comes here, and checks its memory accesses
{_store("0", ControlWord.THRESHOLD)}
  ret i64 %offset
injected:               ; a kernel that writes more values than its budget hangs
{_load("budget", ControlWord.BUDGET)}
  %over = icmp ugt i64 %after, %budget
  br i1 %over, label %exhausted, label %going
exhausted:
{_load("stop", ControlWord.STOP, "ptr")}
  call void %stop(i32 {HANG_EXIT})
  ret i64 -1
going:
  ret i64 -1
"""

_PROFILE = f"""
profile:                ; histogram[block] += 1
{_load("histogram", ControlWord.HISTOGRAM, "ptr")}
  %bin = getelementptr i64, ptr %histogram, i64 %block
  %before = load i64, ptr %bin
  %now = add i64 %before, 1
  store i64 %now, ptr %bin
                        ; append the block to the trace if there is room
{_load("length", ControlWord.TRACE_LENGTH)}
{_load("room", ControlWord.TRACE_ROOM)}
  %fits = icmp ult i64 %length, %room
  br i1 %fits, label %note, label %profiled
note:
{_load("trace", ControlWord.TRACE, "ptr")}
  %entry.address = getelementptr i32, ptr %trace, i64 %length
  %short = trunc i64 %block to i32
  store i32 %short, ptr %entry.address
  %longer = add i64 %length, 1
{_store("%longer", ControlWord.TRACE_LENGTH)}
  br label %profiled
profiled:
  ret i64 -1
"""

_RESOLVE = f"""
resolve:                ; the wanted indices are sorted: go on where the last call has stopped
{_load("count", ControlWord.EVENT_COUNT)}
{_load("events", ControlWord.EVENTS, "ptr")}
{_load("blocks", ControlWord.EVENT_BLOCKS, "ptr")}
{_load("offsets", ControlWord.EVENT_OFFSETS, "ptr")}
{_load("first", ControlWord.NEXT_EVENT)}
  br label %loop
loop:
  %i = phi i64 [ %first, %resolve ], [ %following, %record ]
  %more = icmp ult i64 %i, %count
  br i1 %more, label %look, label %finished
look:                   ; is the next wanted index in this block?
  %event.address = getelementptr i64, ptr %events, i64 %i
  %event = load i64, ptr %event.address
  %here = icmp ult i64 %event, %after
  br i1 %here, label %record, label %later
record:                 ; yes: note the block, and the offset in it
  %block.address = getelementptr i64, ptr %blocks, i64 %i
  store i64 %block, ptr %block.address
  %event.offset = sub i64 %event, %base
  %offset.address = getelementptr i64, ptr %offsets, i64 %i
  store i64 %event.offset, ptr %offset.address
  %following = add i64 %i, 1
  br label %loop
later:                  ; no: run fast up to the block that contains it
{_store("%i", ControlWord.NEXT_EVENT)}
{_store("%event", ControlWord.THRESHOLD)}
  ret i64 -1
finished:               ; no wanted index is left: run fast to the end
{_store("%i", ControlWord.NEXT_EVENT)}
{_store(str(NEVER), ControlWord.THRESHOLD)}
  ret i64 -1
"""

RUNTIME = f"""
@mavfi_control = global [{WORDS} x i64] zeroinitializer, align 64
@mavfi_keep = global [{MASK_BYTES} x i8] zeroinitializer, align 64
@mavfi_flip = global [{MASK_BYTES} x i8] zeroinitializer, align 64
@mavfi_unseen = global [{2 * MASK_BYTES} x i8] zeroinitializer, align 64
define i64 @mavfi_slow(i64 %after, i64 %n, i64 %block) noinline {{
entry:                  ; counter before the block
  %base = sub i64 %after, %n
{_load("mode", ControlWord.MODE)}
  switch i64 %mode, label %inject [ i64 {RunMode.PROFILE:d}, label %profile
                                    i64 {RunMode.RESOLVE:d}, label %resolve ]
{_INJECT}
{_PROFILE}
{_RESOLVE}
}}
"""
"""The control block and masks, and `mavfi_slow`; values of sites that are not injected go to `mavfi_unseen`."""

# ---- Memory of a planned call: its arrays are allocated in the arena, without Python's reference counts.

_ARENA_REFERENCES = 1 << 32
"""Offset of the reference counts of arrays in the arena: they never become 0, so Python never frees such an array."""
_ARRAY_HEADER = 64
"""Bytes before an array, starting with Numba's `MemInfo`: references, destructor and its argument, data, size,
allocator."""


def _planned(yes: str, no: str) -> str:
    """IR that branches on whether the call uses planned memory."""
    return f"""{_load("planned", ControlWord.PLANNED)}
  %is.planned = icmp ne i64 %planned, 0
  br i1 %is.planned, label %{yes}, label %{no}"""


def _allocation(name: str, parameters: str) -> str:
    """IR of a function that allocates an array; null if the arena is full, which Numba turns into a MemoryError."""
    # The IR has two paths.  In a planned call it takes memory from the arena, writes the header as Numba writes it, see
    # `_ARRAY_HEADER`, and returns the header's address; in any other call it calls Numba's function.
    return f"""
define ptr @mavfi_{name}({parameters}) noinline {{
entry:
{_planned("in_arena", "elsewhere")}
in_arena:
  %total = add i64 %size, {_ARRAY_HEADER}
  %at = call ptr @mavfi_room(i64 %total)
  %is.null = icmp eq ptr %at, null
  br i1 %is.null, label %done, label %write
write:                  ; references, destructor and its argument, data, size, allocator
  store i64 {_ARENA_REFERENCES + 1}, ptr %at
  %destructor = getelementptr i8, ptr %at, i64 8
  store i64 0, ptr %destructor
  %argument = getelementptr i8, ptr %at, i64 16
  store i64 0, ptr %argument
  %data = getelementptr i8, ptr %at, i64 {_ARRAY_HEADER}
  %data.address = getelementptr i8, ptr %at, i64 24
  store ptr %data, ptr %data.address
  %size.address = getelementptr i8, ptr %at, i64 32
  store i64 %size, ptr %size.address
  %allocator = getelementptr i8, ptr %at, i64 40
  store i64 0, ptr %allocator
  br label %done
done:
  ret ptr %at
elsewhere:
  %result = call ptr @{name}({parameters})
  ret ptr %result
}}
"""


_SYMBOLS = {
    "NRT_Allocate": ("ptr", "i64"),
    "NRT_Free": ("void", "ptr"),
    "NRT_MemInfo_alloc": ("ptr", "i64"),
    "NRT_MemInfo_alloc_aligned": ("ptr", "i64, i32"),
    "NRT_MemInfo_call_dtor": ("void", "ptr"),
    "NRT_adapt_ndarray_from_python": ("i32", "ptr, ptr"),
}
"""Functions of Numba's runtime called by those below: result and parameters."""
REPLACED = (
    "NRT_Allocate",
    "NRT_Free",
    "NRT_MemInfo_alloc",
    "NRT_MemInfo_alloc_aligned",
    "NRT_adapt_ndarray_from_python",
    "NRT_decref",
    "NRT_incref",
)
"""Functions of Numba's runtime that are replaced in kernels by ours, with the prefix `mavfi_`."""


def declarations(text: str) -> str:
    """Declarations of `_SYMBOLS` that a module lacks."""
    return "\n".join(
        f"declare {result} @{name}({parameters})"
        for name, (result, parameters) in _SYMBOLS.items()
        if f" @{name} (" not in text and f" @{name}(" not in text
    )


# Checks of memory accesses and of the stack: `mavfi_check` is called before each access on the slow path.
_CHECKS = f"""
define void @mavfi_check(ptr %pointer, i64 %size) noinline {{
entry:                  ; only accesses of a planned call, after the injection, and of more than no byte
{_load("planned", ControlWord.PLANNED)}
{_load("injected", ControlWord.INJECTED)}
  %both = and i64 %planned, %injected
  %checked = icmp ne i64 %both, 0
  %nothing = icmp eq i64 %size, 0
  %wanted = select i1 %nothing, i1 false, i1 %checked
  br i1 %wanted, label %test, label %fine
test:                   ; BASE <= address and address + size <= BASE + SIZE, without overflow
  %address = ptrtoint ptr %pointer to i64
  %offset = sub i64 %address, {BASE}
  %last = sub i64 {SIZE}, %size
  %large = icmp ugt i64 %size, {SIZE}
  %beyond = icmp ugt i64 %offset, %last
  %wild = or i1 %large, %beyond
  br i1 %wild, label %stop, label %fine
stop:                   ; the status tells the parent of a wild access
{_load("end.process", ControlWord.STOP, "ptr")}
  call void %end.process(i32 {WILD_EXIT})
  br label %fine
fine:
  ret void
}}
define void @mavfi_overflow(i64 %end) noinline {{
entry:                  ; stack frames end where the constants begin
  %fits = icmp ule i64 %end, {CONSTANTS}
  br i1 %fits, label %fine, label %stop
stop:
{_load("end.process", ControlWord.STOP, "ptr")}
  call void %end.process(i32 {WILD_EXIT})
  br label %fine
fine:
  ret void
}}
"""

# The heap: `mavfi_room` takes memory from it; the functions of Numba's runtime use it in a planned call.
_HEAP = f"""
define ptr @mavfi_room(i64 %size) noinline {{
entry:                  ; a multiple of a cache line, if the rest of the arena is large enough
{_load("heap", ControlWord.HEAP)}
  %more = add i64 %size, {LINE - 1}
  %rounded = and i64 %more, -{LINE}
  %left = sub i64 {BASE + SIZE}, %heap
  %fits.rounded = icmp ule i64 %rounded, %left
                        ; a size near 2^64 would be rounded to a small one
  %sane = icmp ule i64 %size, {SIZE}
  %fits = and i1 %fits.rounded, %sane
  br i1 %fits, label %take, label %none
take:                   ; advance the heap
  %next = add i64 %heap, %rounded
{_store("%next", ControlWord.HEAP)}
  %at = inttoptr i64 %heap to ptr
  ret ptr %at
none:
  ret ptr null
}}
define ptr @mavfi_NRT_Allocate(i64 %size) noinline {{
entry:
{_planned("in_arena", "elsewhere")}
in_arena:
  %at = call ptr @mavfi_room(i64 %size)
  ret ptr %at
elsewhere:
  %result = call ptr @NRT_Allocate(i64 %size)
  ret ptr %result
}}
define void @mavfi_NRT_Free(ptr %at) noinline {{
entry:
{_planned("in_arena", "elsewhere")}
in_arena:
  call void @mavfi_reference(ptr %at)
  ret void
elsewhere:
  call void @NRT_Free(ptr %at)
  ret void
}}
define void @mavfi_reference(ptr %at) noinline {{
entry:                  ; null has no header
  %is.null = icmp eq ptr %at, null
  br i1 %is.null, label %fine, label %test
test:
  call void @mavfi_check(ptr %at, i64 {_ARRAY_HEADER})
  br label %fine
fine:
  ret void
}}
{_allocation("NRT_MemInfo_alloc", "i64 %size")}
{_allocation("NRT_MemInfo_alloc_aligned", "i64 %size, i32 %alignment")}
"""

# Counts of references to arrays, whose headers are checked like other memory.
_REFERENCES = f"""
define void @mavfi_NRT_incref(ptr %at) noinline {{
entry:
  call void @mavfi_reference(ptr %at)
  %is.null = icmp eq ptr %at, null
  br i1 %is.null, label %done, label %count
count:
  %before = atomicrmw add ptr %at, i64 1 monotonic
  br label %done
done:
  ret void
}}
define void @mavfi_NRT_decref(ptr %at) noinline {{
entry:                  ; a corrupted pointer is a wild access
  call void @mavfi_reference(ptr %at)
  %is.null = icmp eq ptr %at, null
  br i1 %is.null, label %done, label %count
count:
  %before = atomicrmw sub ptr %at, i64 1 acq_rel
{_planned("in_arena", "elsewhere")}
in_arena:               ; nobody else holds this array
  %unused = icmp eq i64 %before, {_ARENA_REFERENCES + 1}
  br i1 %unused, label %look, label %done
look:                   ; only the newest array can be given back: the heap is a stack
  %size.address = getelementptr i8, ptr %at, i64 32
  %size = load i64, ptr %size.address
  %more = add i64 %size, {_ARRAY_HEADER + LINE - 1}
  %rounded = and i64 %more, -{LINE}
  %address = ptrtoint ptr %at to i64
  %end = add i64 %address, %rounded
{_load("heap", ControlWord.HEAP)}
  %newest = icmp eq i64 %end, %heap
  br i1 %newest, label %free, label %done
free:
{_store("%address", ControlWord.HEAP)}
  br label %done
elsewhere:              ; as Numba does it
  %last = icmp eq i64 %before, 1
  br i1 %last, label %destroy, label %done
destroy:
  call void @NRT_MemInfo_call_dtor(ptr %at)
  br label %done
done:
  ret void
}}
define i32 @mavfi_NRT_adapt_ndarray_from_python(ptr %object, ptr %array) noinline {{
entry:
  %status = call i32 @NRT_adapt_ndarray_from_python(ptr %object, ptr %array)
  %good = icmp eq i32 %status, 0
  br i1 %good, label %look, label %done
look:                   ; arguments of a planned call lie in the arena, and outlive it
{_planned("detach", "done")}
detach:                 ; without owner, the kernel counts no references to it
  %held = load ptr, ptr %array
  store ptr null, ptr %array
  %parent = getelementptr i8, ptr %array, i64 8
  store ptr null, ptr %parent
  %is.null = icmp eq ptr %held, null
  br i1 %is.null, label %done, label %release
release:                ; the reference that the conversion has taken
  %before = atomicrmw sub ptr %held, i64 1 acq_rel
  %last = icmp eq i64 %before, 1
  br i1 %last, label %destroy, label %done
destroy:
  call void @NRT_MemInfo_call_dtor(ptr %held)
  br label %done
done:
  ret i32 %status
}}
"""

MEMORY = f"{_CHECKS}{_HEAP}{_REFERENCES}"
"""Numba's runtime for kernels: a planned call allocates arrays in the arena, without Python's reference counts."""
