"""Draw docs/images/logs.png: alarms in a recorded flight around a known motor fault.

Run as `make pictures LOGS=FOLDER`, with the folder of `make results NAME=real-logs`; without one the picture remains
unchanged.
"""

import os
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from mavfi.flight_logs.watch import LogWatch, Recording, read_recording, select
from mavfi.reports import style
from tools.drawing import save
from tools.markers import IMAGES
from tools.real_logs import FAULT

FILES = "rflymad_*.ulg"
SHOWN = "rflymad_2_2000000001.ulg"
BEFORE_S, AFTER_S = 1.0, 1.0
SIGNALS = (
    ("vehicle_angular_velocity", tuple(f"xyz[{axis}]" for axis in range(3)), "rates (rad/s)"),
    ("actuator_outputs", tuple(f"output[{motor}]" for motor in range(4)), "outputs (µs)"),
)
LINES = ((style.BLUE, "-"), (style.ORANGE, "--"), (style.GREEN, "-."), (style.INK, ":"))


def signal(recording: Recording, topic: str, field: str, zero_us: int) -> np.ndarray:
    """Times from an instant (s) and values of a number. Shape (2, n)."""
    own = [message for message in recording.messages if message.topic == topic]
    values = [message.layout.locate(message.data, field).value(message.data) for message in own]
    return np.array([[1e-6 * (message.time_us - zero_us) for message in own], values])


def main() -> None:
    """Train on the normal parts of the other flights, judge one flight to its end, and draw it."""
    folder = Path(os.environ.get("LOGS", ""))
    paths = sorted(folder.glob(FILES)) if os.environ.get("LOGS") else []
    if not paths:
        print(f"docs/images/logs.png is left as it is: no {FILES}; allowed: make pictures LOGS=FOLDER")
        return
    recordings = {path.name: read_recording(path, FAULT) for path in paths}
    shown, onset_us = recordings[SHOWN], recordings[SHOWN].onset_us
    assert onset_us is not None  # each flight of this set has a fault
    watch = LogWatch(
        "gaussian", "tuned", select([one.normal for one in recordings.values()]),
        [one.normal for name, one in recordings.items() if name != SHOWN],
    )  # fmt: skip
    alarms = watch.judge(replace(shown, onset_us=None)).alarms
    times = np.array([1e-6 * (alarm.time_us - onset_us) for alarm in alarms])
    with style.house_style():
        figure, panels = plt.subplots(
            3, 1, figsize=(9.6, 5.8), sharex=True, layout="constrained", height_ratios=(1.4, 1.4, 1.5)
        )
        for panel, (topic, fields, label) in zip(panels, SIGNALS, strict=False):
            for field, (colour, dashes) in zip(fields, LINES, strict=False):
                panel.plot(*signal(shown, topic, field, onset_us), dashes, color=colour, linewidth=1.1, label=field)
            panel.set(ylabel=label, title=topic)
            panel.legend(loc="upper left", ncols=2, fontsize=8)
        topics = list(dict.fromkeys(alarm.topic for alarm in alarms))
        heights = [topics.index(alarm.topic) for alarm in alarms]
        panels[2].plot(times, heights, "|", color=style.INK, markersize=9)
        panels[2].set_yticks(range(len(topics)), topics, fontsize=8)
        early = times < -BEFORE_S
        normal_s = 1e-6 * (onset_us - shown.messages[0].time_us)
        title = f"alarms, by topic ({early.sum()} more in the {normal_s - BEFORE_S:.0f} s before)"
        panels[2].set(
            title=title if early.any() else "alarms, by topic",
            ylim=(len(topics) - 0.4, -0.6),
            xlim=(-BEFORE_S, AFTER_S),
        )
        panels[2].set_xlabel("time from the motor fault (s)")
        for panel in panels:
            panel.axvline(0.0, color=style.GREY, linewidth=1.2)
        panels[0].annotate("motor fault", (0.0, -3.5), (-5, 0), textcoords="offset points", ha="right")
        text = f"{SHOWN}: Gaussian detector (tuned), trained on {len(recordings) - 1} other flights"
        figure.suptitle(text, x=0.01, ha="left", fontweight="bold")
        save(figure, "logs.png", IMAGES)
        first = times[times >= 0.0].min()
        print(
            f"{(times < 0.0).sum()} alarms before the fault, {(times >= 0.0).sum()} after it, the first {first:.2f} s"
        )


if __name__ == "__main__":
    main()
