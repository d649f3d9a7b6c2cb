"""The part of an instrumented kernel that counts, resolves and injects: hand-written IR, and the layout of its memory.

A counter runs over the values that the kernel writes.  Each block adds the number of its sites before it runs and
compares with a threshold; only beyond it `mavfi_slow` is called, which decides by the mode.
"""

from enum import IntEnum

Control = IntEnum(
    "Control",
    "COUNTER THRESHOLD MODE TARGET BUDGET INJECTED REPORT STOP HISTOGRAM TRACE TRACE_ROOM TRACE_LENGTH "
    "EVENTS EVENT_COUNT NEXT_EVENT EVENT_BLOCKS EVENT_OFFSETS",
    start=0,
)
"""Words of the control block `mavfi_control` (64 bits each), in order."""
Mode = IntEnum("Mode", "INJECT PROFILE RESOLVE LOCATE", start=0)
"""Behaviour beyond the threshold."""


WORDS = 32
NEVER = 2**63 - 1
"""A threshold or index that is not reached."""
MASK_BYTES = 512
"""Room for each of the masks `mavfi_keep` and `mavfi_flip`, and of the values before and after in the report."""
REPORT_WORDS = 3
"""The report begins with: injected?, block, offset.  Parents share its memory with forked children: it outlives
a crash."""
REPORT_BYTES = 8 * REPORT_WORDS + 2 * MASK_BYTES
HANG_EXIT = 77
"""Exit status of a process whose kernel used up its budget of instructions."""


def address(word: Control) -> str:
    """A constant pointer to a word of the control block."""
    return f"getelementptr (i8, ptr @mavfi_control, i64 {8 * word})"


def _load(name: str, word: Control, kind: str = "i64") -> str:
    return f"  %{name} = load volatile {kind}, ptr {address(word)}"


def _store(value: str, word: Control) -> str:
    return f"  store volatile i64 {value}, ptr {address(word)}"


RUNTIME = f"""
@mavfi_control = global [{WORDS} x i64] zeroinitializer, align 64
@mavfi_keep = global [{MASK_BYTES} x i8] zeroinitializer, align 64
@mavfi_flip = global [{MASK_BYTES} x i8] zeroinitializer, align 64
@mavfi_unseen = global [{2 * MASK_BYTES} x i8] zeroinitializer, align 64
define i64 @mavfi_slow(i64 %after, i64 %n, i64 %block) noinline {{
entry:
  %base = sub i64 %after, %n
{_load("mode", Control.MODE)}
  switch i64 %mode, label %inject [ i64 {Mode.PROFILE:d}, label %profile
                                    i64 {Mode.RESOLVE:d}, label %resolve
                                    i64 {Mode.LOCATE:d}, label %locate ]
inject:
{_load("done", Control.INJECTED)}
  %over = icmp ne i64 %done, 0
  br i1 %over, label %exhausted, label %change
change:
{_load("target", Control.TARGET)}
  %offset = sub i64 %target, %base
{_store("1", Control.INJECTED)}
{_load("report", Control.REPORT, "ptr")}
  store volatile i64 1, ptr %report
  %report.block = getelementptr i64, ptr %report, i64 1
  store volatile i64 %block, ptr %report.block
  %report.offset = getelementptr i64, ptr %report, i64 2
  store volatile i64 %offset, ptr %report.offset
{_load("budget", Control.BUDGET)}
{_store("%budget", Control.THRESHOLD)}
  ret i64 %offset
exhausted:
{_load("stop", Control.STOP, "ptr")}
  call void %stop(i32 {HANG_EXIT})
  ret i64 -1
profile:
{_load("histogram", Control.HISTOGRAM, "ptr")}
  %bin = getelementptr i64, ptr %histogram, i64 %block
  %before = load i64, ptr %bin
  %now = add i64 %before, 1
  store i64 %now, ptr %bin
{_load("length", Control.TRACE_LENGTH)}
{_load("room", Control.TRACE_ROOM)}
  %fits = icmp ult i64 %length, %room
  br i1 %fits, label %note, label %profiled
note:
{_load("trace", Control.TRACE, "ptr")}
  %entry.address = getelementptr i32, ptr %trace, i64 %length
  %short = trunc i64 %block to i32
  store i32 %short, ptr %entry.address
  %longer = add i64 %length, 1
{_store("%longer", Control.TRACE_LENGTH)}
  br label %profiled
profiled:
  ret i64 -1
resolve:
{_load("count", Control.EVENT_COUNT)}
{_load("events", Control.EVENTS, "ptr")}
{_load("blocks", Control.EVENT_BLOCKS, "ptr")}
{_load("offsets", Control.EVENT_OFFSETS, "ptr")}
{_load("first", Control.NEXT_EVENT)}
  br label %loop
loop:
  %i = phi i64 [ %first, %resolve ], [ %following, %record ]
  %more = icmp ult i64 %i, %count
  br i1 %more, label %look, label %finished
look:
  %event.address = getelementptr i64, ptr %events, i64 %i
  %event = load i64, ptr %event.address
  %here = icmp ult i64 %event, %after
  br i1 %here, label %record, label %later
record:
  %block.address = getelementptr i64, ptr %blocks, i64 %i
  store i64 %block, ptr %block.address
  %place = sub i64 %event, %base
  %offset.address = getelementptr i64, ptr %offsets, i64 %i
  store i64 %place, ptr %offset.address
  %following = add i64 %i, 1
  br label %loop
later:
{_store("%i", Control.NEXT_EVENT)}
{_store("%event", Control.THRESHOLD)}
  ret i64 -1
finished:
{_store("%i", Control.NEXT_EVENT)}
{_store(str(NEVER), Control.THRESHOLD)}
  ret i64 -1
locate:
{_load("passed", Control.HISTOGRAM, "ptr")}
  %pass.address = getelementptr i64, ptr %passed, i64 %block
  %pass = load i64, ptr %pass.address
  %next.pass = add i64 %pass, 1
  store i64 %next.pass, ptr %pass.address
{_load("cursors", Control.EVENT_BLOCKS, "ptr")}
  %cursor.address = getelementptr i64, ptr %cursors, i64 %block
  %cursor = load i64, ptr %cursor.address
{_load("passes", Control.EVENTS, "ptr")}
  %wanted.address = getelementptr i64, ptr %passes, i64 %cursor
  %wanted = load i64, ptr %wanted.address
  %now.wanted = icmp eq i64 %pass, %wanted
  br i1 %now.wanted, label %found, label %located
found:
{_load("starts", Control.EVENT_OFFSETS, "ptr")}
  %start.address = getelementptr i64, ptr %starts, i64 %cursor
  store i64 %base, ptr %start.address
  %next.cursor = add i64 %cursor, 1
  store i64 %next.cursor, ptr %cursor.address
  br label %located
located:
  ret i64 -1
}}
"""
