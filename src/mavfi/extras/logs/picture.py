"""A picture of judged recordings: the fields that raised alarms, over time, with the alarms."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from mavfi.extras.logs.recording import LogRecording, values_of
from mavfi.extras.logs.watch import JudgedLog, LogWatch
from mavfi.report import style

_MAX_RECORDINGS = 3
_MAX_FIELDS = 3
"""Largest numbers of recordings in a picture, and of fields of each."""
_WIDTH = 9.0
_HEIGHT = 1.5
"""Width of the picture, and height of a field (in)."""
_BAND_ALPHA = 0.45
_MARGIN_S = 0.05
"""Least width of an alarm event on either side (s)."""


def draw_alarms(
    path: Path, log_watches: Sequence[LogWatch], recordings: Sequence[LogRecording], judged: Sequence[JudgedLog]
) -> None:
    """Draw the fields that raise most alarms in the recordings with most alarm events; by default the first ones.

    Args:
        path: File of the picture.
        log_watches: What judged each recording.
        recordings: The recordings.
        judged: What was found in each.
    """
    order = sorted(range(len(judged)), key=lambda index: -judged[index].events)
    panels = []
    for index in order[:_MAX_RECORDINGS]:
        panels += [(index, *field) for field in _fields_of(log_watches[index], judged[index])]
    with style.house_style():
        figure = Figure(figsize=(_WIDTH, _HEIGHT * len(panels) + 0.6), layout="constrained")
        axes = np.atleast_1d(figure.subplots(len(panels), 1))
        for axis, (index, topic, field) in zip(axes, panels, strict=True):
            _draw_field(axis, recordings[index], judged[index], topic, field)
        axes[-1].set_xlabel("time in the recording (s)")
        figure.supylabel("values in the units of the recording", fontsize=8.5)
        band = Patch(color=style.ALARM, alpha=_BAND_ALPHA, linewidth=0, label="alarm event")
        figure.legend(handles=[band], loc="outside upper right", fontsize=8.5)
        style.write(figure, path)


def _fields_of(log_watch: LogWatch, judged: JudgedLog) -> list[tuple[str, str]]:
    """Topic and name of the fields to draw."""
    alarms = list(judged.alarms)
    if judged.fault_alarm is not None:
        alarms.append(judged.fault_alarm)
    named = Counter((alarm.topic, name) for alarm in alarms for name in alarm.fields)
    monitored = [(name, field) for name, topic in log_watch.selection.topics.items() for field in topic.names]
    chosen = [field for field, _ in named.most_common() if field in monitored]
    return (chosen or monitored)[:_MAX_FIELDS]


def _draw_field(axis: Axes, recording: LogRecording, judged: JudgedLog, topic: str, field: str) -> None:
    """A field over time, with alarm events that name it, the start of the known fault and the first alarm after it."""
    messages = [message for message in recording.messages if message.topic == topic]
    start_us = recording.messages[0].time_us
    times = np.array([1e-6 * (message.time_us - start_us) for message in messages])
    values, _ = values_of(messages, [field])
    axis.plot(times, values[:, 0], color=style.INK, linewidth=0.8)
    for event in judged.event_list:
        if field in event.fields and topic in event.topics:
            begin = 1e-6 * (event.begin_us - start_us)
            end = 1e-6 * (event.end_us - start_us)
            axis.axvspan(begin - _MARGIN_S, end + _MARGIN_S, color=style.ALARM, alpha=_BAND_ALPHA, linewidth=0)
    alarm = judged.fault_alarm
    if alarm is not None and alarm.topic == topic and field in alarm.fields:
        _mark(axis, "first alarm", 1e-6 * (alarm.time_us - start_us), style.ALARM)
    if recording.onset_us is not None:
        _mark(axis, "fault", 1e-6 * (recording.onset_us - start_us), style.INJECTION)
    axis.set_title(f"{recording.name}: {topic} {field}", fontsize=8.5)
    # A corrupted value of 1e30 would flatten all others.
    finite = values[np.isfinite(values)]
    if len(finite):
        low, high = np.quantile(finite, (0.001, 0.999))
        spare = max(0.3 * float(high - low), 1e-9)
        axis.set_ylim(low - spare, high + spare)
        _name_extreme(axis, times, values[:, 0])


def _name_extreme(axis: Axes, times: np.ndarray, values: np.ndarray) -> None:
    """Mark where the curve leaves the axes farthest, with the value there; a value that is not finite is left out."""
    bottom, top = axis.get_ylim()
    beyond = np.where(np.isfinite(values), np.maximum(values - top, bottom - values), 0.0)
    farthest = int(np.argmax(beyond))
    if beyond[farthest] <= 0:
        return
    edge = top
    marker = "^"
    into_axes = -9
    if values[farthest] < bottom:
        edge = bottom
        marker = "v"
        into_axes = 9
    axis.plot(times[farthest], edge, marker, color=style.INK, markersize=6, clip_on=False)
    text = f"{values[farthest]:.3g}"
    axis.annotate(
        text, (times[farthest], edge), (-8, into_axes), textcoords="offset points", fontsize=8, ha="right", va="center"
    )


def _mark(axis: Axes, text: str, time_s: float, colour: str) -> None:
    """Draw a dashed line at an instant, with its meaning at the top."""
    axis.axvline(time_s, color=colour, linestyle="--", linewidth=1.8)
    above = axis.get_xaxis_transform()  # time (s), and share of the height
    axis.annotate(text, (time_s, 1.0), (3, -9), xycoords=above, textcoords="offset points", fontsize=8)
